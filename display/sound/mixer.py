"""Mixer of sounds and the loudspeakers that play them.

Voices are added block by block and limited. The mixer is fed by one thread and read by another, without a lock.
"""

from __future__ import annotations

import contextlib
import ctypes
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from core.errors import BadInput
from display.sound.body_sound import RATE

VOICES = 32  # at once; more make the oldest end
LOUD = 0.6  # from which on peaks are bent, towards 1


@dataclass
class Voice:
    """A sound (N,) that is played with a gain (2,), left and right; `at` is the next sample, negative: a delay."""

    sound: np.ndarray
    gain: np.ndarray
    at: int = 0


class Mixer:
    """`play` puts a voice into a queue (appending to a deque is atomic); `mix` takes it from there."""

    def __init__(self):
        self._queue: deque[Voice] = deque()
        self._voices: list[Voice] = []

    def play(self, sound: np.ndarray, gain: tuple[float, float], *, delay: int = 0) -> None:
        """Start a sound with the next block, or `delay` samples later."""
        self._queue.append(Voice(sound, np.asarray(gain, np.float32), -delay))

    def mix(self, count: int) -> np.ndarray:
        """The next samples (count, 2) float32, within -1..1."""
        while self._queue:
            self._voices.append(self._queue.popleft())
        del self._voices[:-VOICES]
        out = np.zeros((count, 2), np.float32)
        for voice in self._voices:
            first = max(-voice.at, 0)
            piece = voice.sound[max(voice.at, 0) : max(voice.at + count, 0)]
            out[first : first + len(piece)] += piece[:, None] * voice.gain
            voice.at += count
        self._voices = [v for v in self._voices if v.at < len(v.sound)]
        return limited(out)


def limited(x: np.ndarray) -> np.ndarray:
    """Soft clipping: samples above LOUD are compressed smoothly towards 1."""
    over = np.maximum(np.abs(x) - LOUD, 0.0)
    return np.where(over > 0, np.sign(x) * (LOUD + (1 - LOUD) * np.tanh(over / (1 - LOUD))), x).astype(np.float32)


SILENT = ctypes.CFUNCTYPE(None, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p)(
    lambda *message: None
)  # a handler of ALSA's errors, which must outlive it
BUFFER = 40  # [ms]: less would break off while the program holds Python's lock; an impact is heard that much later


class AudioDevice:
    """Plays what `mix` (count -> (count, 2) float32) gives, in a thread of its own, until `close`.

    `backends` of miniaudio; None: those of the platform. Raises BadInput without the package or a device.
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
    """Keep ALSA from printing that there is no device."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL("libasound.so.2").snd_lib_error_set_handler(SILENT)


def blocks_of(mix: Callable[[int], np.ndarray]) -> Iterator[bytes]:
    """Generator for miniaudio: it is sent the number of samples, and yields their bytes."""
    count = yield b""
    while True:
        count = yield mix(count).tobytes()
