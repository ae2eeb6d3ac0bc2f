"""Contact of finger capsules with soft and rigid bodies: forces, what a hand passes through, and rigid bodies.

Each sample (sim/contact/finger_capsules.py) has a contact constraint with the tet that is nearest to it, which
sim/contact/nearest_tet.py finds and sim/contact/narrow_phase.py evaluates, and another one with the nearest rigid
body. With u = displacement / substeps the motion of a sample at c in this substep and r its radius, it asks for

    phi(c) - r + n . (u - y) >= 0,   y the motion of the body there,

compliantly and with bounded force (`fingertip_spring` in sim/contact/response.py). A hand passes through a body that
it holds, and through one that it has let go until they are apart.
"""

import numpy as np
import taichi as ti
from taichi.math import vec3

from core.fields import FieldGroup
from core.vocabulary import Hand
from sim.contact.broad_phase import outside_box
from sim.contact.constraints import FORCE_STEP, ContactConstraints
from sim.contact.finger_capsules import MAX_SAMPLE_FORCE, SAMPLES_PER_HAND, FingerCapsules
from sim.contact.static_shapes import UNKNOWN_DISTANCE, known
from sim.hands.grasp import MAX_HAND_FORCE
from sim.rigid.rigid_bodies import FREE, RigidShapes


@ti.data_oriented
class FingerContact:
    """Sample p has the constraints first_finger + p (soft bodies) and begin + p (rigid bodies).

    rigid_body i32[N]: the rigid body that a sample may touch, -1 none
    pressed i64[H], total i64[H,3]: sum of force magnitudes, and force, of a hand in FORCE_STEP
    """

    def __init__(
        self, capsules: FingerCapsules, constraints: ContactConstraints, begin: int, shapes: RigidShapes | None
    ):
        self.state, self.capsules, self.bounds = capsules.state, capsules, capsules.bounds
        self.constraints, self.begin = constraints, begin
        self.shapes, self.coupled = shapes, shapes is not None
        self.rigid_bodies = shapes.rigid_bodies if self.coupled else None
        self.hands, self.count = capsules.hands, capsules.count
        self.on_soft = begin > constraints.first_finger
        H, group = self.hands, FieldGroup()
        self.rigid_body = group.scalar(self.count, dtype=ti.i32)
        self.pressed, self.total = group.scalar(H, dtype=ti.i64), group.scalar(H, 3, dtype=ti.i64)
        self._group = group
        group.build()
        self.reset()

    def reset(self) -> None:
        """Forget all contacts."""
        self.capsules.reset()
        self.rigid_body.fill(-1)

    def begin_frame(self, hands: list[Hand | None], held: list[int], dt: float) -> None:
        """Move the capsules to their new poses over dt [s]; held[h] is the body in hand h, -1 for none."""
        was_present = self.capsules.present
        self.capsules.begin_frame(hands, held, dt)
        if was_present and not self.capsules.present:
            self.reset()

    @ti.kernel
    def begin_search(self):
        """Find the capsules' boxes, and limit each hand's force; the bodies' bounds must be up to date."""
        f = self.capsules
        f.sweep()
        for h in range(self.hands):
            self.pressed[h] = 0
        for p in range(self.count):
            _, strength = self._force(p)
            if strength > 0.0:
                ti.atomic_add(self.pressed[p // SAMPLES_PER_HAND], ti.cast(strength / FORCE_STEP, ti.i64))
        for h in range(self.hands):
            pressed = ti.cast(self.pressed[h], ti.f32) * FORCE_STEP
            f.limit[h] = ti.min(f.limit[h] * MAX_HAND_FORCE / ti.max(pressed, 1e-3), 1.0)
            f.overlaps[h] = 0
            if f.held[h] >= 0:
                f.spared[h] = f.held[h]

    @ti.kernel
    def end_search(self):
        """Find the rigid bodies that samples may touch; after the search for tets."""
        f = self.capsules
        for p in range(self.count if ti.static(self.coupled) else 0):
            if ti.static(self.coupled):
                self._find_rigid_body(p)
        for h in range(self.hands):
            if f.held[h] < 0 and f.overlaps[h] == 0:
                f.spared[h] = -1

    @ti.func
    def _find_rigid_body(self, p):
        """Make sample p's second constraint a candidate, with the nearest free rigid body if one is near."""
        s = self.state
        f = self.capsules
        r, body, least = self.begin + p, -1, UNKNOWN_DISTANCE
        if f.radius[p] > 0.0:
            x = f.position(p, True)
            for b in range(s.body_count[None]):
                max_distance = f.radius[p] + self.bounds.max_speed[b] * s.detect_dt[None] + f.displacement[p].norm()
                outside = outside_box(self.bounds.low[b], self.bounds.high[b], x)
                if self.rigid_bodies.kind[b] == FREE and outside < max_distance:
                    phi, _ = self.shapes.distance(b, x, vec3(0.0))
                    if not known(phi):
                        phi = outside
                    if f.spares(p, b):
                        f.note_overlap(p, phi)
                    elif phi < ti.min(max_distance, least):
                        body, least = b, phi
        if body != self.rigid_body[p]:
            self.constraints.clear_impulse(r)
        self.rigid_body[p] = body
        if body >= 0:
            self.constraints.add_candidate(r)

    @ti.func
    def evaluate(self, r):
        """Update constraint r with a rigid body; returns whether its shape has a distance there."""
        p, f = r - self.begin, self.capsules
        table = self.constraints
        b, x = self.rigid_body[p], f.position(p, False)
        phi, n = self.shapes.distance(b, x, vec3(0.0))
        usable = known(phi)
        if usable:
            table.set_vertex_count(r, 0)
            table.body_count[r] = 1
            table.set_body(r, 0, b, x - phi * n, -1.0)
            f.set_push(r, p, MAX_SAMPLE_FORCE, table)
            closing_speed = self.bounds.max_speed[b] + f.speed_of(p)
            table.set_contact(r, phi - f.radius[p], n, ti.sqrt(self.state.frictions(b)), closing_speed)
        return usable

    @ti.func
    def _force(self, p):
        """Force [N] of sample p on the bodies in the last substep, and the sum of the magnitudes on each."""
        table = self.constraints
        per_force = ti.max(self.state.dt[None], 1e-9) ** 2
        force, strength = vec3(0.0), 0.0
        if ti.static(self.on_soft):
            impulse = table.impulse[table.first_finger + p]
            force, strength = impulse / per_force, impulse.norm() / per_force
        if ti.static(self.coupled):
            impulse = table.impulse[self.begin + p]
            force, strength = force + impulse / per_force, strength + impulse.norm() / per_force
        return force, strength

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
        for p in range(self.count):
            force, _ = self._force(p)
            for axis in ti.static(range(3)):
                ti.atomic_add(self.total[p // SAMPLES_PER_HAND, axis], ti.cast(-force[axis] / FORCE_STEP, ti.i64))

    def warm_up(self) -> None:
        """See Solver.warm_up."""
        self.begin_search()
        self.end_search()
        self._sum()
        self.total.to_numpy()
