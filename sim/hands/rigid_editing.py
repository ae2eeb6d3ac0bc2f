"""Rigid editing (interaction "transform"): grasped bodies follow the hands exactly while time stands still.

A body in one hand follows it rigidly. A body in two hands follows both, and its size with them:

    x = m + s R (x_0 - m_0),   s = |q_2 - q_1| / |p_2 - p_1|,   m the middle of the hands q; m_0 of p, at the grasp

with R the shortest rotation that takes the line of the hands then to their line now. When a hand lets go, the body has
its own size again, about the point about which a rescaled one stays (its foot, or its centre of mass if the other hand
holds it on), and `take_scaling` says by how much it is to be rescaled.
"""

from dataclasses import dataclass

import numpy as np
import taichi as ti

from core.fields import FieldGroup
from core.rotation import matrices_from_quaternions, rotation_between
from core.vocabulary import Hand
from sim.state import State

MIN_SCALE, MAX_SCALE = 0.25, 4.0  # times as large, in one go
MIN_HAND_DISTANCE = 0.03  # [m]; hands that began closer together would scale by their trembling
MIN_CHANGE = 0.02  # of the size; smaller changes are ignored


@dataclass
class TwoHandGrasp:
    """Hands h and k on a body: their positions when they took it (2, 3) [m], and how it has changed since."""

    h: int
    k: int
    positions: np.ndarray
    factor: float = 1.0
    rotation: np.ndarray = None  # R, (3, 3)
    middle: np.ndarray = None  # m, (3,)


@ti.data_oriented
class RigidEditing:
    """Places grasped bodies relative to where they were grasped, so that no error accumulates.

    start vec3[V]: where the vertices of a body were when it was grasped [m]
    """

    def __init__(self, state: State):
        self.state, self._group = state, FieldGroup()
        self.start = self._group.vector(state.V)
        self._group.build()
        self._grasps: dict[int, tuple[int, np.ndarray]] = {}  # hand -> body, hand_from_world at the grasp
        self._poses: dict[int, np.ndarray] = {}  # hand -> world_from_hand after the last step, of those that hold
        self._held: dict[int, np.ndarray] = {}  # the same of those that go on holding what was changed
        self._pairs: dict[int, TwoHandGrasp] = {}  # body -> both hands on it
        self._scaling: tuple[int, float] | None = None

    def step(self, hands: list[Hand | None], grasped: list[int]) -> bool:
        """Move the bodies in the hands; grasped[h] is the body in hand h, -1 for none. Return if any has moved."""
        pairs = set(self._pairs)
        alone = self._scale(hands, grasped)
        for h, hand in enumerate(hands):
            body = alone[h] if h < len(alone) else -1
            if body < 0:
                self._grasps.pop(h, None)
            elif self._grasps.get(h, (-1,))[0] != body:
                begin = self._held.get(h)
                self._grasps[h] = (body, np.linalg.inv(world_from_hand(hand) if begin is None else begin))
                for other, (held, _) in self._grasps.items():
                    if held == body and other in self._poses:  # it held on before: from here on too
                        self._grasps[other] = (body, np.linalg.inv(self._poses[other]))
                self._keep(body)
        moved = set()
        for h, (body, hand_from_world) in sorted(self._grasps.items()):
            if body not in moved and h < len(hands):
                M = world_from_hand(hands[h]) @ hand_from_world
                self._place(body, M[:3, :3], M[:3, 3])
                moved.add(body)
        self._held = {}
        self._poses = {h: world_from_hand(hands[h]) for h in self._grasps if h < len(hands)}
        return bool(moved or pairs or self._pairs)

    def reset(self, *, held: bool = False) -> None:
        """Forget where bodies were grasped; with `held`, bodies in hands continue from where the hands are."""
        self._grasps.clear()
        self._pairs, self._scaling = {}, None
        self._held = self._poses if held else {}

    def end(self) -> None:
        """End all scaling by two hands."""
        for body in list(self._pairs):
            self._end_pair(body, alone=False)

    def take_scaling(self) -> tuple[int, float] | None:
        """Return the body that two hands have scaled and its factor, once; None if there is none."""
        scaling, self._scaling = self._scaling, None
        return scaling

    def warm_up(self) -> None:
        """See Solver.warm_up."""
        self._keep(-1)
        self._place(-1, np.eye(3), np.zeros(3))
        for field in (self.state.body_of_vertex, self.start, self.state.mass):
            field.to_numpy()

    def _scale(self, hands: list[Hand | None], grasped: list[int]) -> list[int]:
        """Move the bodies that two hands hold; returns `grasped` without them."""
        holding: dict[int, list[int]] = {}
        for h, body in enumerate(grasped[: len(hands)]):
            if body >= 0 and hands[h] is not None:
                holding.setdefault(body, []).append(h)
        for body, pair in list(self._pairs.items()):
            if holding.get(body, [])[:2] != [pair.h, pair.k]:
                self._end_pair(body, alone=body in holding)
        alone = list(grasped)
        for body, by in holding.items():
            if len(by) < 2:
                continue
            positions = np.array([hands[h].position for h in by[:2]], np.float64)
            if body not in self._pairs:
                if np.linalg.norm(positions[1] - positions[0]) < MIN_HAND_DISTANCE:
                    continue
                self._pairs[body] = TwoHandGrasp(*by[:2], positions)
                self._keep(body)
            self._follow(self._pairs[body], body, positions)
            for h in by:
                alone[h] = -1
        return alone

    def _follow(self, pair: TwoHandGrasp, body: int, positions: np.ndarray) -> None:
        before, now = pair.positions[1] - pair.positions[0], positions[1] - positions[0]
        lengths = np.linalg.norm(before), np.linalg.norm(now)
        pair.factor = float(np.clip(lengths[1] / lengths[0], MIN_SCALE, MAX_SCALE))
        if lengths[1] > 1e-9:
            pair.rotation = rotation_between(before, now)
        pair.middle = positions.mean(0)
        A = pair.factor * pair.rotation
        self._place(body, A, pair.middle - A @ pair.positions.mean(0))

    def _end_pair(self, body: int, *, alone: bool) -> None:
        """Restore a body's own size; `alone`: one hand still holds it."""
        pair, s = self._pairs.pop(body), self.state
        n = s.sizes.vertices
        mine = s.body_of_vertex.to_numpy()[:n] == body
        x, mass = self.start.to_numpy()[:n][mine].astype(np.float64), s.mass.to_numpy()[:n][mine]
        fixed = np.average(x, axis=0, weights=mass)
        if not alone:  # its foot, as it is turned now
            up = pair.rotation.T @ (0.0, 1.0, 0.0)
            fixed = fixed + up * ((x - fixed) @ up).min()
        to = pair.middle + pair.factor * pair.rotation @ (fixed - pair.positions.mean(0))
        self._place(body, pair.rotation, to - pair.rotation @ fixed)
        if abs(pair.factor - 1.0) > MIN_CHANGE:
            self._scaling = (body, pair.factor)

    @ti.kernel
    def _keep(self, body: ti.i32):
        """Remember where a body is now: `_place` moves it from there."""
        s = self.state
        for i in range(s.V):
            if i < s.vertex_count[None] and s.body_of_vertex[i] == body:
                self.start[i] = s.x[i]

    def _place(self, body: int, A: np.ndarray, t: np.ndarray) -> None:
        """Put a body at A start + t, A (3, 3), t (3,) [m], at rest."""
        self._put(body, ti.Matrix(A.tolist()), ti.Vector(t.tolist()))

    @ti.kernel
    def _put(self, body: ti.i32, A: ti.types.matrix(3, 3, ti.f32), t: ti.types.vector(3, ti.f32)):
        s = self.state
        for i in range(s.V):
            if i < s.vertex_count[None] and s.body_of_vertex[i] == body:
                s.x[i] = A @ self.start[i] + t
                s.x_lo[i].fill(0.0)
                s.v[i].fill(0.0)
                s.v_lo[i].fill(0.0)


def world_from_hand(hand: Hand) -> np.ndarray:
    """Pose of a hand as a 4x4 matrix, float64."""
    M = np.eye(4)
    M[:3, :3] = matrices_from_quaternions(hand.rotation)
    M[:3, 3] = hand.position
    return M
