"""Sound track of a film: the sounds with their times, written as a WAV and joined to the film by ffmpeg."""

from __future__ import annotations

import shutil
import subprocess
import sys
import wave
from pathlib import Path

import numpy as np

from assets.file_access import atomic_write
from display.sound.body_sound import RATE
from display.sound.mixer import Mixer

BLOCK = 4096  # samples mixed at once


class SoundTrack:
    """Collects sounds (`add`); `write` brings them to the film. `always`: without ffmpeg a WAV is left beside it."""

    def __init__(self, film: Path, *, always: bool):
        self.film, self._always, self._length = Path(film), always, 0.0
        self._sounds: list[tuple[float, np.ndarray, tuple[float, float]]] = []

    def add(self, time: float, sound: np.ndarray, gain: tuple[float, float]) -> None:
        """Let a sound begin at a time of the film [s]."""
        self._sounds.append((time, sound, gain))

    def last(self, time: float) -> None:
        """Note that the film reaches up to `time` [s]."""
        self._length = time

    def samples(self) -> np.ndarray:
        """The whole track (N, 2) float32, as long as the film."""
        mixer, count, blocks = Mixer(), round(self._length * RATE), []
        waiting = sorted(self._sounds, key=lambda s: s[0])
        for start in range(0, count, BLOCK):
            while waiting and waiting[0][0] * RATE < start + BLOCK:
                time, sound, gain = waiting.pop(0)
                mixer.play(sound, gain, delay=max(round(time * RATE) - start, 0))
            blocks.append(mixer.mix(min(BLOCK, count - start)))
        return np.concatenate(blocks) if blocks else np.zeros((0, 2), np.float32)

    def write(self) -> None:
        """Join the track to the film, if that was finished and anything was heard."""
        ffmpeg = shutil.which("ffmpeg")
        if not (self._sounds and self.film.is_file()) or (ffmpeg is None and not self._always):
            return
        track = self.film.with_suffix(".wav")
        if ffmpeg is None:
            with atomic_write(track) as beside:
                write_wav(beside, self.samples())
            print(f"{track}: the sound of {self.film.name}; there is no ffmpeg to join them", file=sys.stderr)
            return
        part = self.film.with_name(f".{self.film.stem}.sound.wav")
        try:
            write_wav(part, self.samples())
            with atomic_write(self.film) as beside:
                inputs = ["-i", str(self.film), "-i", str(part), "-c:v", "copy", "-c:a", "aac", "-b:a", "160k"]
                command = [ffmpeg, "-v", "error", "-y", *inputs, "-f", "mp4", str(beside)]
                subprocess.run(command, check=True, capture_output=True, stdin=subprocess.DEVNULL)
        except (subprocess.CalledProcessError, OSError) as e:
            print(f"{self.film}: stays without sound (ffmpeg: {last_line(e)})", file=sys.stderr)
        finally:
            part.unlink(missing_ok=True)


def last_line(error: Exception) -> str:
    """The last line of ffmpeg, or the system's reason."""
    said = (getattr(error, "stderr", None) or b"").decode(errors="replace").strip().splitlines()
    return said[-1] if said else str(error)


def write_wav(path: Path, samples: np.ndarray) -> None:
    """Write samples (N, 2) within -1..1 as a WAV of 16 bits."""
    with wave.open(str(path), "wb") as file:
        file.setnchannels(2)
        file.setsampwidth(2)
        file.setframerate(RATE)
        file.writeframes((samples * 32767).astype("<i2").tobytes())
