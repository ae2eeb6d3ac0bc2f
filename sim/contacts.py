"""The contact pipeline: bodies against static shapes, one another, themselves, and hands.

Each search (`detect`) is a broad phase (sim/contact/broad_phase.py) that lists the samples that can touch something
before the next one. In each substep the narrow phases (sim/contact/narrow_phase.py, sim/rigid/rigid_contact.py,
sim/hands/finger_contact.py) evaluate the distances of these only.
On a sample with weights b_i and the motion y = sum_i b_i (dx_i - x_lo_i),

    phi(x) + n . x_lo + n . y >= 0

is the condition; sim/contact/response.py says what follows. Vertices meet static shapes at once and exactly; points on
triangles, and samples in other bodies, become contact constraints (sim/contact/constraints.py).
"""

import numpy as np
import taichi as ti

from core.vocabulary import Hand
from sim.contact.broad_phase import BodyBounds, SelfCollision, can_fold
from sim.contact.constraints import NO_DISTANCE, NOT_CHECKED, VALID, ContactConstraints, ContactForces
from sim.contact.contact_samples import CapsuleSamples, ContactSamples, QueryPoints, spacing_for
from sim.contact.finger_capsules import FingerCapsules
from sim.contact.narrow_phase import DeformableContact, StaticContact
from sim.contact.static_shapes import MAX_SHAPES, Shape, StaticShapes
from sim.elastic.substep import Constraint
from sim.hands.finger_contact import FingerContact
from sim.hands.grasp import Grasps
from sim.model import MAX_BODIES, Capacity, Model, fit
from sim.rigid.rigid_bodies import RigidBodies, RigidShapes
from sim.rigid.rigid_broad_phase import GROUPS, SLOTS, RigidBroadPhase
from sim.rigid.rigid_contact import RigidContacts
from sim.state import State

FINGER = -2  # in place of a body


@ti.data_oriented
class Contacts(Constraint):
    """All contacts of the bodies, and the hands.

    Of the constraints, 0..P-1 belong to the samples against static shapes, the next, from `begin_rigid` on, to contact
    with rigid bodies, then to points in tets of other bodies, and from `begin_fingers` on to fingers on rigid bodies.
    """

    has_vertex = True

    def __init__(
        self,
        state: State,
        first: Model,
        shapes: list[Shape],
        blocks,
        grasps: Grasps,
        *,
        self_contact: bool,
        capacity: Capacity,
        rigid_bodies: RigidBodies | None,
        fingers: bool,
    ):
        """Allocate for the bodies of `first` and those that `capacity` lets come; `blocks` of sim/reductions.py."""
        self.state, self.hands, self.rigid_bodies = state, grasps, rigid_bodies
        self.coupled, self.soft = rigid_bodies is not None, first.soft or capacity.grows
        self.samples = ContactSamples(state, first, spacing_for(shapes), capacity)
        self.static_shapes = StaticShapes(shapes)
        self.bounds = BodyBounds(state, blocks, grasps)
        foldable = [can_fold(p.shape) for p in first.bodies if p.body.rigid or p.body.self_contact]
        self_collides = self_contact and (capacity.grows or any(foldable))
        self.self_collision = SelfCollision(state, blocks, self.bounds) if self_collides else None
        capsules = FingerCapsules(state, self.bounds, grasps.count) if fingers else None
        self.begin_rigid = self.samples.capacity
        begin = self.begin_rigid + (SLOTS * self.samples.capacity if self.coupled else 0)
        query_points = QueryPoints(self.samples, CapsuleSamples(shapes, self.samples.spacing), self.bounds, capsules)
        self.deformable = DeformableContact(first, query_points, self.self_collision, begin, capacity)
        on_triangles = capacity.grows or self.samples.triangle_points(first) > 0
        self.anything = bool(shapes) or self.deformable.needed or self.coupled or fingers
        self.has_pairs = self.deformable.needed or self.coupled or fingers or (bool(shapes) and on_triangles)
        self.begin_fingers = begin + self.deformable.size
        size = self.begin_fingers + (capsules.count if fingers and self.coupled else 0)
        first_finger = self.deformable.first_finger if fingers else None
        self.constraints = ContactConstraints(state, size, rigid_bodies, first_finger)
        self.forces = ContactForces(state, self.constraints)
        self.static = StaticContact(self.samples, self.static_shapes, self.bounds, self.constraints, self.forces)
        self.rigid_shapes = self.rigid_search = self.rigid = self.fingers = None
        if self.coupled:
            self.rigid_shapes = RigidShapes(rigid_bodies, self.samples, self.deformable.grids)
            self.rigid_search = RigidBroadPhase(self.rigid_shapes, self.static, self.begin_rigid)
            self.rigid = RigidContacts(self.rigid_search)
        self.has_fingers = fingers
        if fingers:
            self.fingers = FingerContact(capsules, self.constraints, self.begin_fingers, self.rigid_shapes)
        self.max_groups = GROUPS if self.coupled else 0  # constraints between rigid bodies alone are solved in groups
        later = size if self.soft or fingers else 0
        self.phase_sizes = (size,) + (later,) * self.constraints.passes

    def check_capacity(self, model: Model) -> None:
        self.deformable.check_capacity(model)
        self.samples.check_capacity(model)
        if self.anything and not self.has_pairs:
            fit("samples on triangles", self.samples.triangle_points(model), 0)

    def load(self, model: Model) -> None:
        self.samples.load(model)
        self.deformable.load(model)
        if self.coupled:
            self.rigid_shapes.load(model)
        self.hands.load(model, self.samples.host_ids, self.samples.host_weights)
        if self.self_collision is not None:
            self.self_collision.load(model)
        self.reset()

    def begin_frame(self, hands: list[Hand], dt: float, substeps: int) -> None:
        self.hands.begin_frame(hands, dt, substeps > 0)
        if self.fingers is not None:
            self.fingers.begin_frame(hands, self.hands.grasped_bodies(), dt)

    def hand_forces(self) -> list[np.ndarray]:
        """Force of each hand on the body it holds [N], (3,)."""
        forces = self.hands.forces()
        if self.coupled:
            forces = [f + g for f, g in zip(forces, self.rigid_bodies.grasp.forces(), strict=True)]
        return forces

    def touch_forces(self) -> list[np.ndarray]:
        """Contact force of each hand's finger capsules on bodies that it does not grasp [N], (3,)."""
        return [] if self.fingers is None else self.fingers.forces()

    def warm_up(self) -> None:
        self.hands.warm_up()
        if self.fingers is not None:
            self.fingers.warm_up()

    def reset(self) -> None:
        self.hands.reset()
        if self.fingers is not None:
            self.fingers.reset()
        self.constraints.clear()
        self.static.clear()
        self.forces.correction.fill(0.0)
        if self.coupled:
            self.rigid_search.reset()

    def detect(self) -> None:
        if self.anything:
            self._begin_search()
            touching = self.fingers is not None and self.fingers.capsules.present
            if touching:
                self.fingers.begin_search()
            self.deformable.detect(self.constraints)
            if self.coupled:
                self.rigid_search.find()
            if touching:
                self.fingers.end_search()

    @ti.kernel
    def _begin_search(self):
        """Bounds of the bodies, and what static shapes are near. One kernel: a call costs as much as all its loops."""
        self.bounds.update()
        if ti.static(self.deformable.self_collides):
            self.self_collision.update()
        if ti.static(self.deformable.needed):
            self.deformable.normals.update()
        self._find_static()

    @ti.func
    def _find_static(self):
        """Find the shapes near each sample. Outermost level of a kernel."""
        self.constraints.candidate_count[None], self.constraints.listed_count[None] = 0, 0
        for p in range(self.samples.capacity):
            if p < self.samples.count[None]:
                count = self.static_shapes.count[None]
                if ti.static(self.coupled):
                    rigid = self.rigid_bodies.kind[self.samples.body[p]] != 0
                    count = 0 if rigid else count  # sim/rigid/rigid_broad_phase.py looks for these
                n = self.static.find(p, count)
                # With a shape near, the force stays until the next substep: it brakes rocking
                if n == 0 and self.samples.on_vertex[p] and not self.state.asleep[self.samples.body[p]]:
                    self.forces.clear(self.samples.ids[p][0])
                self.constraints.next_check[p] = 0
                if n > 0 and not self.samples.on_vertex[p]:
                    self.samples.set_vertices(p, p, self.constraints)
                    self.constraints.set_vertex_count(p, 3)
                    self.constraints.add_candidate(p)
                else:
                    self.constraints.clear_impulse(p)

    @ti.func
    def project_vertex(self, i, dx):
        """XPBD: the increment of vertex i, w > 0, with the hands' springs and out of all shapes near it.

        Runs in the integrator's loop over vertices, with dx in registers; state.dx[i] must not be touched.
        """
        return self.static.project_vertex(i, self.hands.apply_springs(i, dx))

    @ti.func
    def evaluate_vertex(self, i):
        """VBD, at the begin of a substep: evaluate what its sweeps need of the committed state of vertex i."""
        self.static.evaluate_vertex(i)

    @ti.func
    def external_displacement(self, i, dx):
        """VBD, at the begin of a substep: displacement [m] that hands give vertex i if it moves by dx otherwise."""
        return self.hands.apply_springs(i, dx) - dx

    @ti.func
    def project_vertex_implicit(self, i, dx, H, A, prior):
        """VBD: the increment of vertex i, in the metric H [N/m] = A^-1; `prior` [N]: the force of the last sweep.

        Returns it, the force that it took [N], and that force's stiffness [N/m]: along the normal, and as a matrix.
        """
        return self.static.project_vertex_metric(i, dx, H, A, prior)

    @ti.func
    def solve_phase(self, integrator: ti.template(), later: ti.template(), phase, k):
        """Phase 0 activates the candidates that touch; then, pass by pass, all of these take steps.

        In later passes those of rigid bodies alone: what soft bodies do to one another waits for the next substep. In
        VBD all of soft bodies wait for the next sweep: what an impulse moves at once is but its own vertices.
        """
        if k < self.constraints.candidate_count[None]:
            r = self.constraints.candidate[k]
            if ti.static(not later):
                if k == 0:
                    for j in range(1 + self.constraints.passes):
                        self.constraints.changed[j] = 0
                if self.constraints.status[r] != NOT_CHECKED:
                    self._activate(r, self.constraints.status[r] == VALID, integrator)
            elif ti.static(self.soft or self.has_fingers):
                skipped = False
                if ti.static(self.coupled):
                    waits = ti.static(integrator.warm_started) or self.constraints.body_count[r] == 0
                    skipped = self._grouped(r) or (phase > 1 and (waits or not self.constraints.continues(phase)))
                if not skipped:
                    self.constraints.solve(r, phase, integrator)

    @ti.func
    def solve_group(self, phase, g, lane):
        if ti.static(self.coupled):
            self.rigid.solve(self.rigid_search.group[g], phase, lane)

    @ti.func
    def release_group(self, g):
        if ti.static(self.coupled):
            self.rigid_search.active[self.rigid_search.group[g]] = 0

    @ti.func
    def continues(self, phase):
        return self.constraints.continues(phase)

    @ti.func
    def group_count(self):
        count = 0
        if ti.static(self.coupled):
            count = self.rigid_search.group_count[None]
        return count

    @ti.func
    def _activate(self, r, usable, integrator: ti.template()):
        if self._grouped(r):
            if ti.static(self.coupled):
                self.rigid.activate(r, usable, integrator)
        elif ti.static(self.soft or self.has_fingers):
            a, b = self.bodies_of(r)
            alone = a == b or (b < 0 and r >= self.deformable.begin)  # itself, or a capsule
            self.constraints.activate(r, usable, alone, integrator)

    @ti.func
    def _grouped(self, r):
        """True if constraint r is between rigid bodies alone, which are solved in groups."""
        result = False
        if ti.static(self.coupled):
            result = self.begin_rigid <= r < self.deformable.begin and self.constraints.vertex_count[r] == 0
        return result

    @ti.func
    def evaluate(self, k):
        """Narrow phase of the candidate constraint k, unless it is still too far away."""
        if k < self.constraints.candidate_count[None]:
            r = self.constraints.candidate[k]
            status = NOT_CHECKED
            if self.state.substep_index[None] >= self.constraints.next_check[r]:
                usable = False
                if r >= self.begin_fingers:
                    if ti.static(self.has_fingers and self.coupled):
                        usable = self.fingers.evaluate(r)
                elif r >= self.deformable.begin:
                    if ti.static(self.deformable.needed):
                        usable = self.deformable.evaluate(r, self.constraints)
                elif r >= self.begin_rigid:
                    if ti.static(self.coupled):
                        usable = self.rigid.evaluate(r)
                elif ti.static(self.soft):
                    usable = self.static.evaluate(r)
                status = VALID if usable else NO_DISTANCE
            self.constraints.status[r] = status

    @ti.func
    def bodies_of(self, r):
        """The two bodies of candidate constraint r; -1 for a static shape or none, FINGER for a finger."""
        a, b = -1, -1
        if r < self.begin_rigid:
            a = self.samples.body[r]
        elif r < self.deformable.begin:
            if ti.static(self.coupled):
                q = r - self.begin_rigid
                a = self.samples.body[q % self.samples.capacity]
                if self.rigid_search.shape[q] >= MAX_SHAPES:
                    b = self.rigid_search.shape[q] - MAX_SHAPES
        elif r < self.begin_fingers:
            if ti.static(self.deformable.needed):
                p, hosts = r - self.deformable.begin, self.deformable.hosts
                a = self.state.body_of_tet[hosts.host[p]]
                if hosts.points.is_finger(p):
                    b = FINGER
                elif hosts.points.group(p) < MAX_BODIES:
                    b = hosts.points.group(p)
        elif ti.static(self.has_fingers and self.coupled):
            a, b = self.fingers.rigid_body[r - self.begin_fingers], FINGER
        return a, b

    @ti.func
    def any_active(self):
        return self.constraints.candidate_count[None] > 0

    @ti.func
    def phase_count(self, phase: ti.template()):
        return self.constraints.candidate_count[None] if ti.static(phase == 0 or self.soft or self.has_fingers) else 0

    @ti.func
    def apply_impulses(self, i, dx):
        return dx + self.constraints.apply(i)
