"""Mixer of sounds: voices are added block by block and limited. Fed by one thread, read by another, without a lock."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

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
        """Let a sound begin with the next block, or `delay` samples later."""
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
    """Samples as they are up to LOUD, above it bent towards 1 without a kink."""
    over = np.maximum(np.abs(x) - LOUD, 0.0)
    return np.where(over > 0, np.sign(x) * (LOUD + (1 - LOUD) * np.tanh(over / (1 - LOUD))), x).astype(np.float32)
