"""What hands hold, as values that can be kept and given back (NumPy only)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from core.rotation import matrices_from_quaternions
from scenes.scene import Hand

FEWEST = 4  # vertices that fix a body's attitude with some to spare
WIDER = 1.5  # times the reach, where a coarse cage has fewer than FEWEST within reach


@dataclass(frozen=True, eq=False)
class Grip:
    """What a hand holds: some vertices (n,) of a body, and their places in the hand's frame [m], (n, 3)."""

    body: int
    vertices: np.ndarray
    places: np.ndarray


Trail = tuple[tuple[float, tuple[float, ...]], ...]  # ages [s] and poses (position, quaternion), the oldest first


@dataclass(frozen=True)
class Grips:
    """What each hand holds, None for nothing; how it last was; its poses of the last moments; since when it is lost."""

    held: tuple[Grip | None, ...]
    last: tuple[Hand | None, ...]
    trails: tuple[Trail, ...]
    lost: tuple[float, ...]

    @classmethod
    def none(cls, hands: int) -> Grips:
        return cls((None,) * hands, (None,) * hands, ((),) * hands, (0.0,) * hands)

    def moved(self, index: list[int | None]) -> Grips:
        """The same after bodies were renumbered: index[old] is the new one, None if it is gone, and so is the grip."""
        held = [g if g is None or index[g.body] is None else replace(g, body=index[g.body]) for g in self.held]
        gone = [g is not None and index[g.body] is None for g in self.held]
        return replace(self, held=tuple(None if out else g for g, out in zip(held, gone, strict=True)))

    def shifted(self, body: int, shift: np.ndarray) -> Grips:
        """The same after the vertices of a body were moved by (V, 3) [m]: the hands do not pull at them for it."""
        held = list(self.held)
        for h, grip in enumerate(held):
            if grip is not None and grip.body == body:
                world_from_hand = matrices_from_quaternions(unit(self.last[h].rotation)[None])[0]
                held[h] = replace(grip, places=grip.places + shift[grip.vertices] @ world_from_hand)
        return replace(self, held=tuple(held))


def unit(quaternion) -> np.ndarray:
    q = np.asarray(quaternion, np.float64)
    return q / np.linalg.norm(q)


def pose(hand: Hand) -> np.ndarray:
    """Position and unit quaternion of a hand, (7,)."""
    return np.concatenate([np.asarray(hand.position, np.float64), unit(hand.rotation)])


def finite(hand: Hand) -> bool:
    """Whether a hand has a pose at all."""
    values = np.array([*hand.position, *hand.rotation], np.float64)
    return bool(np.isfinite(values).all() and np.linalg.norm(values[3:]) > 1e-6)


def longer(trail: Trail, dt: float, hand: Hand, most: float) -> Trail:
    """The trail after dt [s], at whose end the hand is here, without poses older than `most` [s]."""
    aged = ((age + dt, at) for age, at in trail)
    return (*((age, at) for age, at in aged if age <= most + 1e-6), (0.0, tuple(pose(hand).tolist())))


def take(hand: Hand, x: np.ndarray, offsets: np.ndarray, ids: np.ndarray, weights: np.ndarray) -> Grip | None:
    """What a closing hand takes: the vertices within reach of the nearest body that is within reach itself.

    x (V, 3) are all vertices [m], of body b those from offsets[b] to offsets[b+1]; ids, weights (P, 3) the samples of
    the surfaces. A coarse mesh may have few vertices within reach, or none of the triangle that is touched.
    """
    if len(x) == 0:
        return None
    position = np.asarray(hand.position, np.float64)
    away = np.linalg.norm(x - position, axis=1)
    surface = np.linalg.norm((x[ids] * weights[..., None]).sum(1) - position, axis=1)
    first = int(np.argmin(surface))
    touched = int(np.argmin(away)) if away.min() <= surface[first] else int(ids[first, 0])
    if min(away.min(), surface[first]) > hand.reach:
        return None
    body = int(np.searchsorted(offsets, touched, side="right")) - 1
    mine = np.arange(offsets[body], offsets[body + 1])
    taken = mine[away[mine] <= hand.reach]
    if len(taken) < FEWEST:
        nearest = mine[np.argsort(away[mine], kind="stable")][:FEWEST]
        taken = nearest[away[nearest] <= WIDER * hand.reach]
    if len(taken) == 0:
        taken = np.unique(ids[first])
    places = (x[taken] - position) @ matrices_from_quaternions(unit(hand.rotation)[None])[0]
    return Grip(body, taken - int(offsets[body]), places)
