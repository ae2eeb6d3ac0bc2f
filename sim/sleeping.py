"""Sleeping bodies: what rests is not simulated until something reaches it, in islands as in Box2D, PhysX and Rapier.

A body rests while none of its vertices goes farther than REST_DISTANCE from where it was. At a search for contacts, two
bodies are linked if one of the listed constraints is between them: if they may touch before the next search. Bodies
that are linked, directly or through others, are an island. A kinematic body belongs to the islands that it is linked
with, but does not connect them.

An island falls asleep after a frame in which all its bodies have rested for REST_TIME, and none is held, driven,
untangled or near a finger. A search wakes the island of every body that is awake or near a finger, before the substeps.
So what is awake never meets what sleeps: no contact is solved between them, and none has to know of sleep.
"""

from collections.abc import Iterable

import numpy as np
import taichi as ti

from core.fields import FieldGroup, Upload
from sim.contacts import FINGER, Contacts
from sim.model import MAX_BODIES
from sim.reductions import Reductions
from sim.rigid.rigid_bodies import DRIVEN, FREE, RigidBodies
from sim.state import State

REST_DISTANCE = 5e-4  # [m]: a pixel at arm's length; four times what bodies that press on one another creep in a second
REST_TIME = 1.0  # [s]: a swing of 7 mm that takes 5 s stays within REST_DISTANCE for 0.7 s where it turns
assert MAX_BODIES <= 64


@ti.func
def has(mask, b):
    """True if body b is among the bits of a mask."""
    return ((mask >> b) & 1) != 0


@ti.data_oriented
class Sleeping:
    """Decides which bodies are asleep (State.asleep), on the device; the host learns of it once a frame.

    linked i64[B]: bodies that a body is linked with, as bits;   awake, touched i64: bodies awake, and near a finger
    anchor vec3[V]: where a vertex was when its body's rest began [m];   displaced i32[B]: it moved in this frame
    settles i32[B]: it falls asleep after this frame;   order i32[R]: the candidates r, as -1 - r if both bodies sleep
    """

    def __init__(self, state: State, reductions: Reductions, contacts: Contacts | None, rigid: RigidBodies | None):
        """Without contacts no body ever sleeps: nothing would wake it."""
        self.state, self.reductions, self.contacts, self.rigid = state, reductions, contacts, rigid
        self.enabled, self.coupled = contacts is not None, rigid is not None
        if not self.enabled:
            return
        self.table, g = contacts.constraints, FieldGroup()
        self._group = g
        self.linked, self.awake, self.touched = (g.scalar(*n, dtype=ti.i64) for n in ((MAX_BODIES,), (), ()))
        self.anchor = g.vector(state.V)
        self.displaced, self.settles = (g.scalar(MAX_BODIES, dtype=ti.i32) for _ in range(2))
        self.order, self.kept = g.scalar(self.table.capacity, dtype=ti.i32), g.scalar(dtype=ti.i32)
        g.build()
        self._set = Upload([state.asleep, state.rest_time])
        self._restless: set[int] = set()
        self._gravity: tuple[float, ...] | None = None  # of the last frame [m/s^2]
        self._any_asleep, self._longest_rest = False, 0.0  # [s] of any body, when the frame began
        self._fresh = True  # the anchors are of another time
        self._linked = self._compiled = False  # whether links are known in this frame, and ever were

    def restore(self, asleep: np.ndarray | None) -> None:
        """Let these bodies sleep (B,), and no others; None: wake all. The rest of those begins anew."""
        if self.enabled:
            asleep = np.zeros(MAX_BODIES, bool) if asleep is None else asleep
            self._write(asleep, np.where(asleep, REST_TIME, 0.0))
            self._fresh, self._gravity = True, None

    def _write(self, asleep: np.ndarray, rest_time: np.ndarray) -> None:
        self._set([asleep, rest_time])
        self.reductions.forget()

    def begin_frame(self, restless: set[int], gravity: tuple[float, ...]) -> bool:
        """Wake what is moved other than by contact; return whether all bodies sleep in this frame.

        `restless` bodies, which are held, driven or untangled, stay awake; other gravity wakes all.
        """
        if not self.enabled:
            return False
        last, self._gravity, self._restless = self._gravity, gravity, restless
        flags = self.reductions.flags()[1:, : len(self.reductions.names)]
        asleep, rest_time = flags[0] > 0, flags[1].copy()
        woken = list(restless) if last in (None, gravity) else slice(None)
        if asleep[woken].any():
            asleep[woken], rest_time[woken] = False, 0.0
            self._write(asleep, rest_time)
        self._longest_rest = float(rest_time.max(initial=0.0))
        self._any_asleep = bool(asleep.any())
        if not asleep.all():
            return False
        fingers = self.contacts.fingers
        if fingers is None or not fingers.capsules.present:
            return True
        boxes = self.reductions.boxes()
        return not fingers.capsules.may_touch(boxes[:, 0], boxes[:, 1])

    def search(self, dt: float) -> None:
        """Wake what may be reached before the next search, in a frame of dt [s]: after the contacts' search."""
        if not self.enabled:
            return
        self._linked = self._any_asleep or self._longest_rest + dt >= REST_TIME
        if self._linked or not self._compiled:
            self._wake_islands()
            self._compiled = True

    def end_frame(self, dt: float) -> None:
        """Let islands that rest fall asleep, after a frame of dt [s]."""
        if self.enabled:
            self._settle(dt, bits(self._restless), self._linked, self._fresh)
            self._fresh = False

    @ti.kernel
    def _wake_islands(self):
        s = self.state
        self.awake[None], self.touched[None], self.kept[None] = ti.i64(0), ti.i64(0), 0
        for b in range(MAX_BODIES):
            self.linked[b] = ti.i64(0)
            if s.awake_body(b):
                ti.atomic_or(self.awake[None], ti.i64(1) << b)
        for k in range(self.table.capacity):
            if k < self.table.candidate_count[None]:
                a, b = self.contacts.bodies_of(self.table.candidate[k])
                if b == FINGER:
                    ti.atomic_or(self.touched[None], ti.i64(1) << a)
                elif a >= 0 and b >= 0 and a != b:
                    self._link(a, b)
                    self._link(b, a)
        for b in range(MAX_BODIES):
            if b < s.body_count[None] and s.asleep[b]:  # noqa: SIM102
                if (self._island(b) & (self.awake[None] | self.touched[None])) != 0:
                    s.asleep[b], s.rest_time[b] = 0, 0.0
        for k in range(self.table.capacity):
            if k < self.table.candidate_count[None]:
                r = self.table.candidate[k]
                a, b = self.contacts.bodies_of(r)
                awake = False
                if a >= 0:
                    awake = not s.asleep[a]
                if b >= 0:
                    awake = awake or not s.asleep[b]
                self.order[k] = r if awake else -1 - r
        for k in range(self.table.capacity):
            if k < self.table.candidate_count[None] and self.order[k] >= 0:
                self.table.candidate[ti.atomic_add(self.kept[None], 1)] = self.order[k]
        self.table.listed_count[None] = self.kept[None]
        for k in range(self.table.capacity):
            if k < self.table.candidate_count[None] and self.order[k] < 0:
                self.table.candidate[ti.atomic_add(self.table.listed_count[None], 1)] = -1 - self.order[k]
        self.table.candidate_count[None] = self.kept[None]

    @ti.func
    def _link(self, a, b):
        if not has(self.linked[a], b):
            ti.atomic_or(self.linked[a], ti.i64(1) << b)

    @ti.func
    def _island(self, b):
        """The bodies of the island of b, as bits."""
        found, done = ti.i64(1) << b, ti.i64(0)
        while found != done:
            for c in range(self.state.body_count[None]):
                if has(found & ~done, c):
                    done |= ti.i64(1) << c
                    connects = True  # what a body is linked with belongs to one island, unless it is kinematic
                    if ti.static(self.coupled):
                        connects = self.rigid.kind[c] != DRIVEN
                    if connects:
                        found |= self.linked[c]
        return found

    @ti.kernel
    def _settle(self, dt: ti.f32, restless: ti.i64, linked: ti.i32, fresh: ti.i32):
        s = self.state
        for i in range(s.V):
            if fresh and i < s.vertex_count[None]:
                self.anchor[i] = s.x[i]
                self.displaced[s.body_of_vertex[i]] = 1
            if s.awake_vertex(i):
                b = s.body_of_vertex[i]
                if (s.x[i] - self.anchor[i]).norm_sqr() > REST_DISTANCE * REST_DISTANCE:
                    self.displaced[b] = 1  # all writers write the same
        for b in range(MAX_BODIES):
            if s.awake_body(b):
                s.rest_time[b] += dt
                if self.displaced[b] or has(restless, b):
                    s.rest_time[b] = 0.0
        for b in range(MAX_BODIES):
            if linked and s.awake_body(b):
                island = self._island(b)
                calm = (island & self.touched[None]) == 0
                for c in range(s.body_count[None]):
                    if has(island, c) and s.rest_time[c] < REST_TIME:
                        calm = False
                self.settles[b] = calm
        for i in range(s.V):
            if s.awake_vertex(i):
                b = s.body_of_vertex[i]
                if self.displaced[b]:
                    self.anchor[i] = s.x[i]
                if self.settles[b]:
                    s.v[i], s.v_lo[i], s.dx[i] = 0.0, 0.0, 0.0
        for b in range(MAX_BODIES):
            if self.settles[b]:
                s.asleep[b] = 1
                if ti.static(self.coupled):  # noqa: SIM102
                    if self.rigid.kind[b] == FREE:
                        m = self.rigid
                        m.v[b], m.v_lo[b], m.angular_momentum[b], m.angular_velocity[b] = 0.0, 0.0, 0.0, 0.0
            self.displaced[b], self.settles[b] = 0, 0


def bits(bodies: Iterable[int]) -> int:
    """A set of bodies as the bits of an int64."""
    mask = sum(1 << b for b in set(bodies))
    return mask - (1 << 64) if mask >> 63 else mask
