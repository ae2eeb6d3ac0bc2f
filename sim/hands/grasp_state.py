"""Grasps as values that can be saved and restored, their selection, and the limits of a hand (NumPy only)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from core.rotation import matrices_from_quaternions
from core.vocabulary import Hand

SPRING_OMEGA = 2.0 * math.pi * 20.0  # [rad/s] of the whole body on its springs: stiffer than an arm, softer than a pin
MIN_SPRING_MASS = 0.2  # [kg]; lighter bodies are held as firmly, with 3 N/mm, so that they too can be squeezed
MAX_HAND_FORCE = 80.0  # [N] of one hand: a firm pull
MIN_GRASP_VERTICES = 4  # one more than fix a body's attitude
MAX_WIDENING = 1.5  # times the reach, where a coarse cage has fewer vertices within reach


@dataclass(frozen=True, eq=False)
class Grasp:
    """One hand's grasp: some vertices (n,) of a body, and their positions in the hand's frame [m], (n, 3)."""

    body: int
    vertices: np.ndarray
    positions: np.ndarray


PoseHistory = tuple[tuple[float, tuple[float, ...]], ...]  # ages [s] and poses (position, quaternion), oldest first


@dataclass(frozen=True)
class GraspState:
    """State of all hands: grasps (None for nothing), last inputs, pose histories, and times since when each is lost."""

    grasps: tuple[Grasp | None, ...]
    last: tuple[Hand | None, ...]
    histories: tuple[PoseHistory, ...]
    lost: tuple[float, ...]

    @classmethod
    def none(cls, hands: int) -> GraspState:
        """State of open hands that were never tracked."""
        return cls((None,) * hands, (None,) * hands, ((),) * hands, (0.0,) * hands)

    def renumbered(self, index: list[int | None]) -> GraspState:
        """The same after bodies were renumbered: index[old] is the new one, None if it is gone, and so is the grasp."""
        kept = [None if g is None or index[g.body] is None else replace(g, body=index[g.body]) for g in self.grasps]
        return replace(self, grasps=tuple(kept))

    def shifted(self, body: int, shift: np.ndarray) -> GraspState:
        """The same after the vertices of a body were moved by (V, 3) [m], so that the hands do not pull them back."""
        grasps = list(self.grasps)
        for h, grasp in enumerate(grasps):
            if grasp is not None and grasp.body == body:
                world_from_hand = matrices_from_quaternions(unit(self.last[h].rotation))
                grasps[h] = replace(grasp, positions=grasp.positions + shift[grasp.vertices] @ world_from_hand)
        return replace(self, grasps=tuple(grasps))


def unit(quaternion) -> np.ndarray:
    """The quaternion (4,), normalised, float64."""
    q = np.asarray(quaternion, np.float64)
    return q / np.linalg.norm(q)


def pose(hand: Hand) -> np.ndarray:
    """Position and unit quaternion of a hand, (7,)."""
    return np.concatenate([np.asarray(hand.position, np.float64), unit(hand.rotation)])


def has_pose(hand: Hand) -> bool:
    """True if a hand has a finite pose."""
    values = np.array([*hand.position, *hand.rotation], np.float64)
    return bool(np.isfinite(values).all() and np.linalg.norm(values[3:]) > 1e-6)


def extended(history: PoseHistory, dt: float, hand: Hand, max_age: float) -> PoseHistory:
    """The history after dt [s], with the hand's pose of now and without poses older than max_age [s]."""
    aged = ((age + dt, at) for age, at in history)
    return (*((age, at) for age, at in aged if age <= max_age + 1e-6), (0.0, tuple(pose(hand).tolist())))


def find_grasp(hand: Hand, x: np.ndarray, offsets: np.ndarray, ids: np.ndarray, weights: np.ndarray) -> Grasp | None:
    """Grasp of a closing hand: the vertices within reach of the nearest body that is within reach itself.

    x (V, 3) are all vertices [m], of body b those from offsets[b] to offsets[b+1]; ids, weights (P, 3) the samples of
    the surfaces. A coarse mesh may have few vertices within reach, or none of the triangle that is touched.
    """
    position, nearest = np.asarray(hand.position, np.float64), (np.inf, -1)
    offsets = np.asarray(offsets)
    filled = np.flatnonzero(np.diff(offsets))
    if len(filled) == 0:
        return None
    low, high = (extreme.reduceat(x, offsets[filled], axis=0) for extreme in (np.minimum, np.maximum))
    outside = np.linalg.norm(np.maximum(np.maximum(low - position, position - high), 0.0), axis=1)
    for body in filled[outside <= hand.reach]:
        mine = x[offsets[body] : offsets[body + 1]]
        distance = lengths(mine - position)
        of_body = (ids[:, 0] >= offsets[body]) & (ids[:, 0] < offsets[body + 1])
        own = ids[of_body] - offsets[body]
        surface = lengths(np.einsum("pk,pkc->pc", weights[of_body], mine[own]) - position)
        least = min(distance.min(), surface.min(initial=np.inf))
        if least <= hand.reach and least < nearest[0]:
            nearest = least, body, mine, distance, own, surface
    if nearest[1] < 0:
        return None
    _, body, mine, distance, own, surface = nearest
    taken = np.flatnonzero(distance <= hand.reach)
    if len(taken) < MIN_GRASP_VERTICES:
        taken = np.argsort(distance, kind="stable")[:MIN_GRASP_VERTICES]
        taken = taken[distance[taken] <= MAX_WIDENING * hand.reach]
    if len(taken) == 0:
        taken = np.unique(own[np.argmin(surface)])
    positions = (mine[taken] - position) @ matrices_from_quaternions(unit(hand.rotation))
    return Grasp(int(body), taken, positions)


def lengths(v: np.ndarray) -> np.ndarray:
    """Lengths of vectors (N, 3); np.linalg.norm takes seven times as long."""
    return np.sqrt(np.einsum("nc,nc->n", v, v))
