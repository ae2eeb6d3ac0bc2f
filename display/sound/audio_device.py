"""The machine's loudspeakers, by the optional package miniaudio (requirements-sound.txt)."""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from core.errors import BadInput
from display.sound.body_sound import RATE

SILENT = ctypes.CFUNCTYPE(None, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p)(
    lambda *message: None
)  # a handler of ALSA's errors, which must outlive it
BUFFER = 40  # [ms]: less would break off while the program holds Python's lock; an impact is heard that much later


class AudioDevice:
    """Plays what `mix` (count -> (count, 2) float32) gives, in a thread of its own, until `close`.

    `backends` of miniaudio; unset: the platform's. Raises BadInput where there is no package or no device.
    """

    def __init__(self, mix: Callable[[int], np.ndarray], backends: Sequence | None = None):
        try:
            import miniaudio
        except ImportError as e:
            raise BadInput("no sound: the package miniaudio is not installed (pip install miniaudio)") from e
        real = [b for b in miniaudio.Backend if b is not miniaudio.Backend.NULL]
        silence_alsa()
        form = {"output_format": miniaudio.SampleFormat.FLOAT32, "nchannels": 2, "sample_rate": RATE}
        try:
            self._device = miniaudio.PlaybackDevice(**form, buffersize_msec=BUFFER, backends=list(backends or real))
            blocks = blocks_of(mix)
            next(blocks)
            self._device.start(blocks)
        except miniaudio.MiniaudioError as e:
            raise BadInput("no sound: there is no audio device") from e

    def close(self) -> None:
        """Stop playing. Further calls do nothing."""
        self._device.close()


def silence_alsa() -> None:
    """Keep ALSA, where it is the system's, from writing to the terminal that there is no device."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL("libasound.so.2").snd_lib_error_set_handler(SILENT)


def blocks_of(mix: Callable[[int], np.ndarray]) -> Iterator[bytes]:
    """Generator as miniaudio wants it: it is sent the number of samples that are due, and gives their bytes."""
    count = yield b""
    while True:
        count = yield mix(count).tobytes()
