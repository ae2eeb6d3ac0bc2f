"""Blows to bodies, and their sound.

A blow is found in the velocities of the bodies. Its sound is that of the modes of the body and of what it falls on,
as an impulse excites them (modal synthesis).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from core.material import Material
from core.vocabulary import BodyState

RATE = 48_000  # [1/s] samples
MODES = 12  # the lowest of a body
HIGHEST = 16_000.0  # [Hz] that is synthesised
LOSS_MODULUS, LOSS_MAX = 2e6, 0.5  # [Pa]; eta = LOSS_MODULUS / E: in woods and polymers loss falls as stiffness grows
USUAL_DAMPING = 2.0  # [1/s], the damping of a Material to which these losses belong
RIGID_YOUNG = 1e8  # [Pa] of a rigid body, of which no stiffness is known: wood's here
BOARD = np.array([96.0, 157.0, 243.0, 361.0, 518.0])  # [Hz] of a table top or floor, what things fall on
BOARD_LOSS, BOARD_SHARE = 0.08, 0.4  # how loud it is beside the body
AUDIBLE_FROM = 120.0  # [Hz]: things of this size radiate less below
LENGTH_MAX, FADE = 0.8, 0.005  # [s]


@dataclass(frozen=True)
class Modes:
    """Modes: frequencies [Hz], decay rates [1/s] and amplitudes, each (K,); `attack` [s] is half the contact's time."""

    frequency: np.ndarray
    decay: np.ndarray
    amplitude: np.ndarray
    attack: float


def body_modes(extents: np.ndarray, material: Material, *, rigid: bool = False) -> Modes:
    """Modes that a blow to a body excites.

    f = c/2 |(i/a, j/b, k/c)| of a free block of extents a, b, c [m], c = sqrt(E / rho): they go as sqrt(E/rho)/L.
    The contact lasts for half a swing of the body as a spring with its mass, T = pi L / c; above 1/T it excites less.
    """
    young = RIGID_YOUNG if rigid else material.young
    speed = np.sqrt(young / material.density)
    orders = np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), -1).reshape(-1, 3)[1:]
    own = np.sort(0.5 * speed * np.linalg.norm(orders / np.maximum(extents, 1e-3), axis=1))[:MODES]
    loss = min(LOSS_MODULUS / young * material.damping / USUAL_DAMPING, LOSS_MAX)
    frequency = np.concatenate([own, BOARD])
    decay = np.pi * frequency * np.concatenate([np.full(len(own), loss), np.full(len(BOARD), BOARD_LOSS)])
    time = np.pi * float(np.max(extents)) / speed
    amplitude = 1 / (1 + 2 * frequency * time)
    amplitude *= frequency**2 / (frequency**2 + AUDIBLE_FROM**2)
    amplitude[: len(own)] /= np.sqrt(np.arange(1, len(own) + 1))
    amplitude[len(own) :] *= BOARD_SHARE
    heard = frequency < HIGHEST
    return Modes(frequency[heard], decay[heard], amplitude[heard], float(np.clip(0.5 * time, 0.0005, 0.02)))


def waveform(modes: Modes) -> np.ndarray:
    """Sound (N,) float32 of a blow of unit loudness: sum a e^(-d t) sin(2 pi f t), faded in and out.

    The peak is the square root of the sum of the modes: this compresses the range of loudness, as ears do.
    """
    length = min(LENGTH_MAX, 7.0 / max(float(modes.decay.min()), 1e-3))
    t = np.arange(int(RATE * length)) / RATE
    swing = np.exp(-np.outer(modes.decay, t)) * np.sin(2 * np.pi * np.outer(modes.frequency, t))
    sound = modes.amplitude @ swing
    rise = np.clip(t / modes.attack, 0, 1)
    sound *= 0.5 - 0.5 * np.cos(np.pi * rise)
    sound *= np.clip((length - t) / FADE, 0, 1)
    return (sound / np.sqrt(max(float(np.abs(sound).max()), 1e-9))).astype(np.float32)


SPEED_MIN = 0.2  # [m/s] of a fall from 2 mm: slower blows, and the shaking of soft bodies, are not heard
SUPPORT = 2.0  # times gravity's push in a frame: what a body that rests, rolls or sways gets from the ground
FORGET = 0.08  # [s] after a blow, which lasts for some frames where bodies are soft, until a lesser one is heard


class Impacts:
    """`detect` once a frame. Held bodies and those moved by the program make no sound."""

    def __init__(self):
        self.forget()

    def forget(self) -> None:
        """Forget the last frame: bodies were moved by something other than the simulation."""
        self._velocity: np.ndarray | None = None  # (B, 3) [m/s] of the last frame
        self._free = self._heard = np.empty(0)  # (B,) not held then; speed [m/s] that was heard and still rings

    def detect(self, bodies: Sequence[BodyState], dt: float, gravity: Sequence[float]) -> list[tuple[int, float]]:
        """Index of each body that was struck in the frame of `dt` [s], and the speed [m/s] of the blow.

        Contacts have changed the velocity by dv - g dt, along n. A body that hits something had been moving against n
        with the speed that counts; one that is hit was not, and the change itself counts, less what bears its weight. A
        change that is no larger than that is none.
        """
        velocity = np.array([b.velocity for b in bodies]).reshape(-1, 3)
        free = np.array([not (b.held or b.driven) for b in bodies], bool)
        before, was_free, heard = self._velocity, self._free, self._heard
        self._velocity, self._free = velocity, free
        if before is None or len(before) != len(velocity) or dt <= 0.0:
            self._heard = np.zeros(len(velocity))
            return []
        fall = dt * np.asarray(gravity)
        change = velocity - before - fall
        size = np.linalg.norm(change, axis=1)
        closing = -np.einsum("bi,bi->b", before, change) / np.maximum(size, 1e-9)
        beyond = size - SUPPORT * np.linalg.norm(fall)
        speed = np.where(closing > SPEED_MIN, closing, beyond)
        heard = np.where(beyond > 0, heard, heard * np.exp(-dt / FORGET))
        struck = free & was_free & (beyond > 0) & (speed > SPEED_MIN) & (speed > heard) & np.isfinite(speed)
        self._heard = np.where(struck, speed, heard)
        return [(int(k), float(speed[k])) for k in np.flatnonzero(struck)]
