"""Fingers: capsules that move with the hands and push soft and rigid bodies.

A capsule is a row of up to SPOTS spots on its axis, a radius apart or less. Each is a contact (sim/contact/constraints.py) with the
tet that is nearest to it, along that body's distance grid as in sim/contact/deformable_contact.py, and another one with the rigid body that
is nearest. With u = way / substeps the motion of a spot at c in this substep and r its radius, its row asks for

    phi(c) - r + n . (u - y) >= 0,   y the motion of the body there,

softly and with bounded force (sim/contact/response.py, `press`). A hand passes through what it holds, and through what it has
let go until they are apart.
"""

import numpy as np
import taichi as ti

from core.fields import Upload
from scenes.scene import Hand
from sim.contact.broad_phase import MARGIN, BodyBounds
from sim.contact.constraints import ContactConstraints
from sim.contact.response import PAD_DEPTH, PAD_TIME
from sim.hands.finger_contact import CAPSULES, EACH, SPOTS, FingerContact
from sim.hands.grasp import FORCE
from sim.model import MAX_BODIES
from sim.state import State

THINNEST, THICKEST = 0.002, 0.05  # [m]; others count as these
SWIFTEST = 10.0  # [m/s]; what is faster was lost, or held up, and is there at once instead of hitting what is between
SLACK = 1.1  # by which a hand that pressed too hard, FORCE in all, may press more again from search to search


@ti.data_oriented
class Fingers(FingerContact):
    """Up to `hands` hands. Spot p of hand p // EACH has the rows begin + p (soft) and begin + N + p (rigid).

    origin vec3[N], way vec3[N] [m]: where a spot is at the frame's begin, and how far it goes in it
    radius f32[N] [m]: 0 is no spot;   held, spared i32[H]: the body that a hand holds, and passes through; -1 none
    low, high vec3[H C], swift f32[H] [m/s]: box of what a capsule may touch until the next search, a hand's speed
    share f32[H]: of each spot's greatest force, lest the hand exceed FORCE, by what it `pressed` i64[H] with [1e-6 N]
    total i64[H,3]: force sums [1e-6 N]
    """

    def __init__(self, state: State, pairs, bounds: BodyBounds, begin: int, *, hands: int, movers, shapes):
        self.state, self.bounds, self.begin, self.movers, self.shapes = state, bounds, begin, movers, shapes
        self.hosts, self.grids, self.coupled = pairs.hosts, pairs.grids, movers is not None
        self.hands, self.count = max(hands, 1), max(hands, 1) * EACH
        self.size = self.count * (2 if self.coupled else 1)
        H, N = self.hands, self.count
        self.origin, self.way, self.low, self.high = (ti.Vector.field(3, ti.f32) for _ in range(4))
        self.radius, self.swift, self.share = (ti.field(ti.f32) for _ in range(3))
        self.held, self.spared, self.overlaps, self.tet, self.mover = (ti.field(ti.i32) for _ in range(5))
        self.key, self.total, self.pressed = (ti.field(ti.i64) for _ in range(3))
        self.builder = ti.FieldsBuilder()
        self.builder.dense(ti.i, N).place(self.origin, self.way, self.radius, self.tet, self.mover, self.key)
        self.builder.dense(ti.i, H * CAPSULES).place(self.low, self.high)
        self.builder.dense(ti.i, H).place(self.swift, self.share, self.held, self.spared, self.overlaps, self.pressed)
        self.builder.dense(ti.ij, (H, 3)).place(self.total)
        self.tree = self.builder.finalize()
        self._upload = Upload([self.origin, self.way, self.radius, self.held])
        self._upload([np.zeros(0)] * 3 + [[-1] * H])
        self._compiled = False
        self.reset()

    def reset(self) -> None:
        """Touch nothing."""
        self.last, self.active = np.zeros((self.hands, CAPSULES, 7)), False
        for field in (self.tet, self.mover, self.spared):
            field.fill(-1)
        self.share.fill(1.0)
        self.radius.fill(0.0)

    @property
    def due(self) -> bool:
        """Whether there is anything to search for; the first time always, lest the first touch wait for compilers."""
        return self.active or not self._compiled

    def search(self, rows: ContactConstraints) -> None:
        """List the rows of spots that may touch something before the next search; after `widen`."""
        self.find(rows)
        if not self._compiled:
            self._sum(rows)
            self._compiled = True

    def begin_frame(self, hands: list[Hand | None], held: list[int], dt: float) -> None:
        """Let what the hands touch with go in dt [s] to where it is now; what is new, or was too far, appears there."""
        now = np.stack([capsules_of(hands[h] if h < len(hands) else None) for h in range(self.hands)])
        stale, self.active = self.active, bool(now[..., 6].any())
        before, self.last = self.last, now
        if not self.active:
            if stale:
                self.reset()
            return
        far = np.linalg.norm((now - before)[..., :6].reshape(*now.shape[:2], 2, 3), axis=-1).max(-1) > SWIFTEST * dt
        new = far | (before[..., 6] == 0.0)
        before = np.where(new[..., None], now, before)
        starts, ends, radii = spots_of(before), spots_of(now), np.repeat(now[..., 6:], SPOTS, axis=2)
        along = np.linalg.norm(now[..., 3:6] - now[..., :3], axis=-1)
        needed = np.clip(np.ceil(along / np.maximum(now[..., 6], THINNEST)) + 1, 1, SPOTS)
        radii = np.where(np.arange(SPOTS) < needed[..., None], radii, 0.0)
        starts, ends = (place_spots(e, needed) for e in (starts, ends))
        held = [*held, *[-1] * self.hands][: self.hands]
        self._upload([starts.reshape(-1, 3), (ends - starts).reshape(-1, 3), radii.reshape(-1), held])

    @ti.kernel
    def widen(self):
        """Boxes of the capsules until the next search; bodies there may be pushed: their bounds, up to date, widen."""
        s = self.state
        f, part = self._now(), s.detect_dt[None] / (s.dt[None] * ti.cast(s.substeps[None], ti.f32))
        for h in range(self.hands):
            self.swift[h] = 0.0
        for c in range(self.hands * CAPSULES):
            low, high, swift = ti.Vector([1e9, 1e9, 1e9]), ti.Vector([-1e9, -1e9, -1e9]), 0.0
            for k in range(SPOTS):
                p = c * SPOTS + k
                if self.radius[p] > 0.0:
                    a = self.origin[p] + f * self.way[p]
                    b = a + part * self.way[p]
                    low, high = ti.min(low, a - self.radius[p], b - self.radius[p]), ti.max(high, a, b)
                    high = ti.max(high, a + self.radius[p], b + self.radius[p])
                    swift = ti.max(swift, self.way[p].norm() * part / s.detect_dt[None])
            self.low[c], self.high[c] = low, high
            ti.atomic_max(self.swift[c // CAPSULES], swift)
        for b in range(MAX_BODIES):
            if b < s.body_count[None]:
                box = self.bounds
                margin, more = box.pace[b] * s.detect_dt[None] + MARGIN, 0.0
                for c in range(self.hands * CAPSULES):
                    if self._meets(c, box.low[b] - margin, box.high[b] + margin):
                        more = ti.max(more, self.swift[c // CAPSULES] + PAD_DEPTH / PAD_TIME)
                box.slow[b] -= more
                box.fast[b] += more
                box.extra[b] += more
                box.pace[b] += more

    def forces(self, rows: ContactConstraints) -> list[np.ndarray]:
        """Force of each hand on what it touches in the last substep [N], (3,) each."""
        if not self.active:
            return [np.zeros(3)] * self.hands
        self._sum(rows)
        return list(self.total.to_numpy() * 1e-6)

    @ti.kernel
    def _sum(self, rows: ti.template()):
        for h, axis in self.total:
            self.total[h, axis] = 0
        for q in range(self.size):
            force = -self._force(q, rows)
            for axis in ti.static(range(3)):
                ti.atomic_add(self.total[q % self.count // EACH, axis], ti.cast(force[axis] * 1e6, ti.i64))

    @ti.func
    def _limit(self, h):
        """Let a hand that pressed with more than FORCE press less."""
        pressed = ti.cast(self.pressed[h], ti.f32) * 1e-6
        if pressed > FORCE:
            self.share[h] *= FORCE / pressed
        else:
            self.share[h] = ti.min(1.0, SLACK * self.share[h])

    def warm_up(self) -> None:
        """See Solver.warm_up; the search does it for itself."""
        self.total.to_numpy()

    def destroy(self) -> None:
        self.tree.destroy()


def capsules_of(hand: Hand | None) -> np.ndarray:
    """Ends and radius of what a hand touches with, (CAPSULES, 7) [m]; radius 0 where there is none, or no number."""
    table = np.zeros((CAPSULES, 7))
    if hand is not None:
        for row, touch in zip(table, hand.touch, strict=False):
            values = np.array([*touch.a, *touch.b, touch.radius], np.float64)
            if np.isfinite(values).all() and touch.radius > 0.0:
                row[:] = values
                row[6] = np.clip(touch.radius, THINNEST, THICKEST)
    return table


def spots_of(capsules: np.ndarray) -> np.ndarray:
    """Both ends of capsules (H, C, 7), (H, C, 2, 3)."""
    return capsules[..., :6].reshape(*capsules.shape[:2], 2, 3)


def place_spots(ends: np.ndarray, needed: np.ndarray) -> np.ndarray:
    """Where the spots of capsules are: `needed` (H, C) of them evenly from end to end, (H, C, SPOTS, 3)."""
    f = np.minimum(np.arange(SPOTS) / np.maximum(needed[..., None] - 1, 1), 1.0)[..., None]
    return (1 - f) * ends[..., :1, :] + f * ends[..., 1:, :]
