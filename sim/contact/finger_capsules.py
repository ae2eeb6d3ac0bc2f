"""Finger capsules: samples on the capsules of the hands, their motion in a frame, and their swept boxes.

A capsule is a row of up to SAMPLES_PER_CAPSULE samples on its axis, a radius apart or less.
"""

import numpy as np
import taichi as ti
from taichi.math import vec3

from core.fields import FieldGroup, Upload
from core.vocabulary import Hand
from sim.contact.broad_phase import CONTACT_MARGIN, BodyBounds, gap_of_boxes
from sim.contact.response import MAX_RECOVERY_SPEED
from sim.model import MAX_BODIES
from sim.state import State

CAPSULES_PER_HAND = 20  # its 19 bones, and one to spare
SAMPLES_PER_CAPSULE = 8
SAMPLES_PER_HAND = CAPSULES_PER_HAND * SAMPLES_PER_CAPSULE
NOWHERE = 1e9  # [m], bounds of an empty box
MIN_RADIUS, MAX_RADIUS = 0.002, 0.05  # [m]; others are clamped
MAX_SAMPLE_FORCE = 10.0  # [N]: 30 to 40 of a fingertip
# A soft body yields to less: E r^2 presses a ball of radius r about half of r deep (Hertz); more would crush its cells.
YOUNG_PER_MU = 2.6  # E = 2 (1 + nu) mu
MAX_FINGER_SPEED = 10.0  # [m/s]; faster capsules were lost by the tracking and are placed instead of swept


@ti.data_oriented
class FingerCapsules:
    """Capsules of up to `hands` hands; sample p is one of hand p // SAMPLES_PER_HAND.

    start vec3[N], displacement vec3[N] [m]: of a sample at the frame's begin, and in the frame
    radius f32[N] [m]: 0 is no sample;   held i32[H]: the body that a hand holds, -1 none
    low, high vec3[H C] [m]: box of what a capsule may touch until the next search;   speed f32[H] [m/s]: of a hand
    reach f32[H C] [m]: largest sum of a sample's radius and its motion until then
    spared i32[H]: a body that a hand passes through, -1 none;   overlaps i32[H]: whether it does so at a search
    limit f32[H]: fraction of each sample's greatest force that keeps the hand below MAX_HAND_FORCE
    """

    def __init__(self, state: State, bounds: BodyBounds, hands: int):
        self.state, self.bounds = state, bounds
        self.hands, self.count = max(hands, 1), max(hands, 1) * SAMPLES_PER_HAND
        self.capsules = self.hands * CAPSULES_PER_HAND
        H, N, C, group = self.hands, self.count, self.capsules, FieldGroup()
        with group.interleaved(N):
            self.start, self.displacement, self.radius = group.vector(), group.vector(), group.scalar()
        self.low, self.high, self.reach = group.vector(C), group.vector(C), group.scalar(C)
        self.speed, self.limit = group.scalar(H), group.scalar(H)
        self.held, self.spared, self.overlaps = (group.scalar(H, dtype=ti.i32) for _ in range(3))
        self._group = group
        group.build()
        self._upload = Upload([self.start, self.displacement, self.radius, self.held])
        self._upload([np.zeros(0)] * 3 + [[-1] * H])
        self.reset()

    def reset(self) -> None:
        """Forget all capsules."""
        self.before = self.now = np.zeros((self.hands, CAPSULES_PER_HAND, 7))  # at begin and end of the frame
        self.present = False
        self.radius.fill(0.0)
        self.low.fill(NOWHERE)
        self.high.fill(-NOWHERE)
        self.spared.fill(-1)
        self.limit.fill(1.0)

    def begin_frame(self, hands: list[Hand | None], held: list[int], dt: float) -> None:
        """Move the capsules to their new poses over dt [s].

        A capsule that is new, or was faster than MAX_FINGER_SPEED, is placed without sweeping.
        """
        if not self.present and not any(hand is not None and hand.touch for hand in hands):
            return
        before = self.now
        now = self.now = np.stack([capsules_of(h) for h in [*hands, *[None] * self.hands][: self.hands]])
        self.present = bool(now[..., 6].any())
        if not self.present:
            return
        motion = np.linalg.norm(capsule_ends(now) - capsule_ends(before), axis=-1).max(-1)
        new = (motion > MAX_FINGER_SPEED * dt) | (before[..., 6] == 0.0)
        self.before = before = np.where(new[..., None], now, before)
        length = np.linalg.norm(now[..., 3:6] - now[..., :3], axis=-1)
        counts = np.clip(np.ceil(length / np.maximum(now[..., 6], MIN_RADIUS)) + 1, 1, SAMPLES_PER_CAPSULE)
        radii = np.where(np.arange(SAMPLES_PER_CAPSULE) < counts[..., None], now[..., 6:], 0.0)
        starts, ends = (sample_positions(capsule_ends(c), counts) for c in (before, now))
        held = [*held, *[-1] * self.hands][: self.hands]
        self._upload([starts.reshape(-1, 3), (ends - starts).reshape(-1, 3), radii.reshape(-1), held])

    def may_touch(self, low: np.ndarray, high: np.ndarray) -> bool:
        """Return whether a capsule may touch one of these boxes (B, 3) [m] in the frame that has begun."""
        there = self.now[..., 6] > 0.0
        ends = np.concatenate([capsule_ends(self.before), capsule_ends(self.now)], axis=2)[there]
        margin = self.now[there][:, None, 6:] + CONTACT_MARGIN
        apart = np.maximum(low - ends.max(1, keepdims=True), ends.min(1, keepdims=True) - high) - margin
        return bool((apart.max(-1) <= 0.0).any())

    @ti.func
    def speed_of(self, p):
        """Speed [m/s] of the hand of sample p."""
        return self.speed[p // SAMPLES_PER_HAND]

    @ti.func
    def elapsed(self, searching: ti.template()):
        """Fraction of the frame before the substep in progress; in a search, before the next one."""
        s = self.state
        return ti.cast(s.substep_index[None] + ti.static(int(searching)), ti.f32) / ti.cast(s.substeps[None], ti.f32)

    @ti.func
    def position(self, p, searching: ti.template()):
        """Position [m] of sample p at that time (see `elapsed`)."""
        return self.start[p] + self.elapsed(searching) * self.displacement[p]

    @ti.func
    def spares(self, p, b):
        """True if the hand of sample p passes through body b."""
        return self.spared[p // SAMPLES_PER_HAND] == b

    @ti.func
    def note_overlap(self, p, distance):
        """Note in a search how far [m] sample p is from a body that its hand passes through."""
        if distance < self.radius[p]:
            self.overlaps[p // SAMPLES_PER_HAND] = 1

    @ti.func
    def set_push(self, r, p, max_force, constraints: ti.template()):
        """Let sample p push in constraint r, with at most max_force [N]."""
        k, n = r - constraints.first_finger, ti.cast(self.state.substeps[None], ti.f32)
        constraints.finger_motion[k] = self.displacement[p] / n
        constraints.max_force[k] = max_force * self.limit[p // SAMPLES_PER_HAND]

    @ti.func
    def sweep(self):
        """Boxes of the capsules until the next search; they widen the bounds of bodies. Outermost level of a kernel."""
        s = self.state
        f, part = self.elapsed(True), s.detect_dt[None] / (s.dt[None] * ti.cast(s.substeps[None], ti.f32))
        for h in range(self.hands):
            self.speed[h] = 0.0
        for c in range(self.capsules):
            low, high, speed, reach = vec3(NOWHERE), vec3(-NOWHERE), 0.0, 0.0
            for p in range(c * SAMPLES_PER_CAPSULE, (c + 1) * SAMPLES_PER_CAPSULE):
                if self.radius[p] > 0.0:
                    a = self.start[p] + f * self.displacement[p]
                    b = a + part * self.displacement[p]
                    low = ti.min(low, a - self.radius[p], b - self.radius[p])
                    high = ti.max(high, a + self.radius[p], b + self.radius[p])
                    motion = self.displacement[p].norm() * part
                    speed, reach = ti.max(speed, motion / s.detect_dt[None]), ti.max(reach, self.radius[p] + motion)
            self.low[c], self.high[c], self.reach[c] = low, high, reach
            ti.atomic_max(self.speed[c // CAPSULES_PER_HAND], speed)
        for b in range(MAX_BODIES):
            if b < s.body_count[None]:
                box = self.bounds
                margin, gain = box.max_speed[b] * s.detect_dt[None] + CONTACT_MARGIN, 0.0
                for c in range(self.capsules):
                    if gap_of_boxes(self.low[c], self.high[c], box.low[b] - margin, box.high[b] + margin) <= 0.0:
                        gain = ti.max(gain, self.speed[c // CAPSULES_PER_HAND] + MAX_RECOVERY_SPEED)
                box.v_min[b] -= gain
                box.v_max[b] += gain
                box.speed_gain[b] += gain
                box.max_speed[b] += gain


def capsules_of(hand: Hand | None) -> np.ndarray:
    """Ends and radius [m] of a hand's finger capsules, (CAPSULES_PER_HAND, 7); radius 0 where there is no valid one."""
    table = np.zeros((CAPSULES_PER_HAND, 7))
    if hand is not None:
        for row, touch in zip(table, hand.touch, strict=False):
            values = np.array([*touch.a, *touch.b, touch.radius], np.float64)
            if np.isfinite(values).all() and touch.radius > 0.0:
                row[:] = [*values[:6], np.clip(touch.radius, MIN_RADIUS, MAX_RADIUS)]
    return table


def capsule_ends(capsules: np.ndarray) -> np.ndarray:
    """Both ends of capsules (H, C, 7), (H, C, 2, 3)."""
    return capsules[..., :6].reshape(*capsules.shape[:2], 2, 3)


def sample_positions(ends: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Samples of capsules, `counts` (H, C) on each, evenly spaced: (H, C, SAMPLES_PER_CAPSULE, 3)."""
    f = np.minimum(np.arange(SAMPLES_PER_CAPSULE) / np.maximum(counts[..., None] - 1, 1), 1.0)[..., None]
    return (1 - f) * ends[..., :1, :] + f * ends[..., 1:, :]
