"""Contact of finger capsules with soft and rigid bodies: search, narrow phase and forces.

Each sample (sim/hands/finger_capsules.py) has a contact constraint with the tet that is nearest to it, along that
body's distance grid as in sim/contact/deformable_contact.py, and another one with the nearest rigid body. With u =
displacement / substeps the motion of a sample at c in this substep and r its radius, its constraint asks for

    phi(c) - r + n . (u - y) >= 0,   y the motion of the body there,

compliantly and with bounded force (`fingertip_spring` in sim/contact/response.py). A hand passes through a body that
it holds, and through one that it has let go until they are apart.
"""

from typing import TYPE_CHECKING

import numpy as np
import taichi as ti
from taichi.math import vec3

from core.fields import FieldGroup
from scenes.scene import Hand
from sim.contact.broad_phase import outside_box
from sim.contact.signed_distance import UNKNOWN_DISTANCE, known
from sim.contact.tet_geometry import NO_TET, distance_outside, face_normals, tet_edges, tet_key, tet_of_key
from sim.hands.finger_capsules import CAPSULES_PER_HAND, SAMPLES_PER_CAPSULE, SAMPLES_PER_HAND, FingerCapsules
from sim.hands.grasp_state import MAX_HAND_FORCE
from sim.rigid.rigid_motion import FREE

if TYPE_CHECKING:
    from sim.contact.broad_phase import BodyBounds
    from sim.contact.constraints import ContactConstraints
    from sim.contact.deformable_contact import DeformableContact
    from sim.state import State

SKIN_FRICTION = 1.0  # coefficient; with a body, as always, the geometric mean
MAX_SAMPLE_FORCE = 10.0  # [N]: 30 to 40 of a fingertip
# A soft body yields to less: E r^2 presses a ball of radius r about half of r deep (Hertz); more would crush its cells.
YOUNG_PER_MU = 2.6  # E = 2 (1 + nu) mu
LIMIT_GROWTH = 1.1  # by which a hand that pressed too hard may press more again from search to search
FORCE_STEP = 1e-6  # [N] of the integer sums of forces


def finger_rows(hands: int, rigid: bool) -> int:
    """Number of constraints of the fingers of this many hands."""
    return max(hands, 1) * SAMPLES_PER_HAND * (2 if rigid else 1)


@ti.data_oriented
class FingerContact:
    """Sample p has the constraints begin + p (soft bodies) and begin + N + p (rigid bodies).

    tet i32[N], rigid_body i32[N]: what a sample may touch, -1 none;   spared i32[H]: a body that a hand passes through
    limit f32[H]: fraction of each sample's greatest force that keeps the hand below MAX_HAND_FORCE
    pressed i64[H], total i64[H,3]: sum of force magnitudes, and force, of a hand in FORCE_STEP
    """

    def __init__(
        self,
        state: "State",
        deformable: "DeformableContact",
        bounds: "BodyBounds",
        constraints: "ContactConstraints",
        begin: int,
        *,
        hands: int,
        rigid_bodies=None,
        shapes=None,
    ):
        """Rigid_bodies and their shapes: None without any."""
        self.state, self.bounds, self.constraints, self.begin = state, bounds, constraints, begin
        self.rigid_bodies, self.shapes, self.coupled = rigid_bodies, shapes, rigid_bodies is not None
        self.deformable = deformable
        self.capsules = FingerCapsules(state, bounds, hands)
        self.hands, self.count = self.capsules.hands, self.capsules.count
        self.size = finger_rows(hands, self.coupled)
        H, N, group = self.hands, self.count, FieldGroup()
        self.tet, self.rigid_body = group.scalar(N, dtype=ti.i32), group.scalar(N, dtype=ti.i32)
        self.key, self.limit = group.scalar(N, dtype=ti.i64), group.scalar(H)
        self.spared, self.overlaps = group.scalar(H, dtype=ti.i32), group.scalar(H, dtype=ti.i32)
        self.pressed, self.total = group.scalar(H, dtype=ti.i64), group.scalar(H, 3, dtype=ti.i64)
        self._group = group
        group.build()
        self._compiled = False
        self.reset()

    def reset(self) -> None:
        """Forget all contacts."""
        self.capsules.reset()
        for field in (self.tet, self.rigid_body, self.spared):
            field.fill(-1)
        self.limit.fill(1.0)

    def begin_frame(self, hands: list[Hand | None], held: list[int], dt: float) -> None:
        """Move the capsules to their new poses over dt [s]; held[h] is the body in hand h, -1 for none."""
        was_present = self.capsules.present
        self.capsules.begin_frame(hands, held, dt)
        if was_present and not self.capsules.present:
            self.reset()

    @property
    def due(self) -> bool:
        """True if there is anything to search for; always at first, so that kernels are compiled before a touch."""
        return self.capsules.present or not self._compiled

    def detect(self) -> None:
        """Make the constraints of samples that may touch something before the next search candidates; after `sweep`."""
        self._find()
        if not self._compiled:
            self._sum()
            self._compiled = True

    @ti.kernel
    def _find(self):
        s = self.state
        for h in range(self.hands):
            self.pressed[h] = 0
        for q in range(self.size):
            strength = self._force(q).norm()
            if strength > 0.0:
                ti.atomic_add(self.pressed[q % self.count // SAMPLES_PER_HAND], ti.cast(strength * 1e6, ti.i64))
        for h in range(self.hands):
            self._limit(h)
            self.overlaps[h] = 0
            if self.capsules.held[h] >= 0:
                self.spared[h] = self.capsules.held[h]
        for p in range(self.count):
            self.key[p] = ti.i64(NO_TET)
        for t in range(s.T):
            if t < s.tet_count[None]:
                self._visit(t)
        for p in range(self.count):
            host, before = tet_of_key(self.key[p]), self.tet[p]
            self.tet[p] = host
            same_body = host >= 0 and before >= 0
            if same_body:
                same_body = s.body_of_tet[host] == s.body_of_tet[before]
            if not same_body:
                self.constraints.clear_impulse(self.begin + p)
            if host >= 0:
                self.constraints.add_candidate(self.begin + p)
        for p in range(self.count if ti.static(self.coupled) else 0):
            if ti.static(self.coupled):
                self._find_rigid_body(p)
        for h in range(self.hands):
            if self.capsules.held[h] < 0 and self.overlaps[h] == 0:
                self.spared[h] = -1

    @ti.func
    def _limit(self, h):
        """Reduce the limit of a hand that pressed with more than MAX_HAND_FORCE."""
        pressed = ti.cast(self.pressed[h], ti.f32) * FORCE_STEP
        if pressed > MAX_HAND_FORCE:
            self.limit[h] *= MAX_HAND_FORCE / pressed
        else:
            self.limit[h] = ti.min(1.0, LIMIT_GROWTH * self.limit[h])

    @ti.func
    def _visit(self, t):
        """Offer tet t to the samples that it may meet until the next search; the lowest (distance, t) wins."""
        s = self.state
        f = self.capsules
        b = s.body_of_tet[t]
        x0, e1, e2, e3 = tet_edges(s, t)
        margin = self.bounds.max_speed[b] * s.detect_dt[None]
        low, high = x0 + ti.min(e1, e2, e3, 0.0) - margin, x0 + ti.max(e1, e2, e3, 0.0) + margin
        if e1.dot(e2.cross(e3)) > 0.0:
            n0, n1, n2, n3 = face_normals(e1, e2, e3)
            for c in range(self.hands * CAPSULES_PER_HAND):
                if f.may_meet(c, low, high):
                    for p in range(c * SAMPLES_PER_CAPSULE, (c + 1) * SAMPLES_PER_CAPSULE):
                        r = f.radius[p]
                        if r > 0.0:
                            outside = distance_outside(f.next_position(p) - x0, e1, n0, n1, n2, n3)
                            if b == self.spared[p // SAMPLES_PER_HAND]:
                                if outside < r:
                                    self.overlaps[p // SAMPLES_PER_HAND] = 1
                            elif outside < r + margin + f.displacement[p].norm():
                                ti.atomic_min(self.key[p], tet_key(outside, t))

    @ti.func
    def _find_rigid_body(self, p):
        """Make sample p's second constraint a candidate if a free rigid body is near: with the nearest."""
        s = self.state
        f = self.capsules
        r, body, least = self.begin + self.count + p, -1, UNKNOWN_DISTANCE
        if f.radius[p] > 0.0:
            x, h = f.next_position(p), p // SAMPLES_PER_HAND
            for b in range(s.body_count[None]):
                max_distance = f.radius[p] + self.bounds.max_speed[b] * s.detect_dt[None] + f.displacement[p].norm()
                outside = outside_box(self.bounds.low[b], self.bounds.high[b], x)
                if self.rigid_bodies.kind[b] == FREE and outside < max_distance:
                    phi, _ = self.shapes.distance(b, x, vec3(0.0))
                    if not known(phi):
                        phi = outside
                    if b == self.spared[h]:
                        if phi < f.radius[p]:
                            self.overlaps[h] = 1
                    elif phi < ti.min(max_distance, least):
                        body, least = b, phi
        if body != self.rigid_body[p]:
            self.constraints.clear_impulse(r)
        self.rigid_body[p] = body
        if body >= 0:
            self.constraints.add_candidate(r)

    @ti.func
    def evaluate(self, r):
        """Update constraint r's distance, normal and vertices; whether the body's shape has a distance there."""
        q = r - self.begin
        usable = False
        if q < self.count:
            usable = self._evaluate_tet(q, r)
        else:
            if ti.static(self.coupled):
                usable = self._evaluate_rigid_body(q - self.count, r)
        return usable

    @ti.func
    def _evaluate_tet(self, p, r):
        s = self.state
        table = self.constraints
        t = self.tet[p]
        thick, phi, normal, b, _X, _beyond = self.deformable.distance(t, self.capsules.position(p))
        usable = table.active[r] != 0  # a tet crushed flat has no normal: its contact stays as it was
        if thick:
            usable = known(phi)
            self.tet[p] = self.deformable.hosts.next_host(t, b)
            if usable:
                body, radius = s.body_of_tet[t], self.capsules.radius[p]
                phi -= radius + self.deformable.set_host(r, 0, t, b, normal, table)
                if ti.static(table.coupled):
                    table.body_count[r] = 0
                self._fill(p, r, body, phi, normal, ti.min(MAX_SAMPLE_FORCE, YOUNG_PER_MU * s.mu[body] * radius**2))
        return usable

    @ti.func
    def _evaluate_rigid_body(self, p, r):
        b, x = self.rigid_body[p], self.capsules.position(p)
        phi, n = self.shapes.distance(b, x, vec3(0.0))
        usable = known(phi)
        if usable:
            self.constraints.set_vertex_count(r, 0)
            self.constraints.body_count[r] = 1
            self.constraints.set_body(r, 0, b, x - phi * n, -1.0)
            self._fill(p, r, b, phi - self.capsules.radius[p], n, MAX_SAMPLE_FORCE)
        return usable

    @ti.func
    def _fill(self, p, r, body, phi, normal, max_force):
        """Write constraint r of sample p with a body at distance phi [m]."""
        k, h, n = r - self.begin, p // SAMPLES_PER_HAND, ti.cast(self.state.substeps[None], ti.f32)
        self.constraints.finger_motion[k] = self.capsules.displacement[p] / n
        self.constraints.max_force[k] = max_force * self.limit[h]
        friction = ti.sqrt(self.state.frictions(body) * SKIN_FRICTION)
        closing_speed = self.bounds.max_speed[body] + self.capsules.speed[h]
        self.constraints.set_contact(r, phi, normal, friction, closing_speed)

    @ti.func
    def _force(self, q):
        """Force [N] of constraint q on the finger in the last substep."""
        dt = ti.max(self.state.dt[None], 1e-9)
        return self.constraints.impulse[self.begin + q] / (dt * dt)

    def forces(self) -> list[np.ndarray]:
        """Contact force of each hand's finger capsules on bodies that it does not grasp [N], (3,)."""
        if not self.capsules.present:
            return [np.zeros(3)] * self.hands
        self._sum()
        return list(self.total.to_numpy() * FORCE_STEP)

    @ti.kernel
    def _sum(self):
        for h, axis in self.total:
            self.total[h, axis] = 0
        for q in range(self.size):
            force = -self._force(q)
            for axis in ti.static(range(3)):
                ti.atomic_add(self.total[q % self.count // SAMPLES_PER_HAND, axis], ti.cast(force[axis] * 1e6, ti.i64))

    def warm_up(self) -> None:
        """See Solver.warm_up; the search does it for itself."""
        self.total.to_numpy()
