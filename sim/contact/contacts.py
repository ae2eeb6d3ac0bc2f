"""All contact of the bodies: with static shapes, with one another, with hands (the protocol is in sim/state.py).

Each search (`detect`) lists the samples that can touch something before the next one; each sweep then takes the
distances anew for these only. On a sample with weights b_i and the motion y = sum_i b_i (dx_i - carry_i),

    phi(x) + n . x_lo + n . y >= 0

is the condition; sim/contact/response.py says what follows. Vertices meet static shapes at once and exactly; points on
triangles, and samples in other bodies, become rows of a system (sim/contact/constraints.py).
"""

import taichi as ti

from scenes.scene import Hand
from sim.constraint import Constraint
from sim.contact.broad_phase import BodyBounds
from sim.contact.constraints import ContactConstraints
from sim.contact.contact_forces import ContactForces
from sim.contact.contact_samples import ContactSamples, spacing_for
from sim.contact.deformable_contact import DeformableContact
from sim.contact.self_collision import SelfCollision, foldable
from sim.contact.static_contact import StaticContact
from sim.contact.static_shapes import Shape, StaticShapes
from sim.contact.swept_bounds import SweptBounds
from sim.hands.fingers import Fingers
from sim.hands.grasp import Grasps, Grips
from sim.model import Capacity, Model, fit
from sim.reductions import ReductionBlocks
from sim.rigid.rigid_bodies import RigidBodies
from sim.rigid.rigid_broad_phase import GROUPS
from sim.rigid.rigid_contact import RigidContacts
from sim.rigid.rigid_shapes import RigidShapes
from sim.state import State


@ti.data_oriented
class Contacts(Constraint):
    """Rows 0..P-1 belong to the samples, the next to pairs, the rest to contact with rigid bodies, if there are any."""

    has_vertex = True

    def __init__(
        self,
        state: State,
        first: Model,
        shapes: list[Shape],
        blocks: ReductionBlocks,
        *,
        hands: int = 2,
        self_contact: bool = True,
        spacing: float | None = None,
        capacity: Capacity = Capacity(),
        movers: RigidBodies | None = None,
        fingers: bool = False,
    ):
        self.state = state
        self.samples = ContactSamples(state, first, spacing_for(shapes) if spacing is None else spacing, capacity)
        self.colliders = StaticShapes(shapes)
        self.hands = Grasps(state, self.samples, hands)
        self.bounds = BodyBounds(state, blocks)
        self.foresight = SweptBounds(state, self.hands, self.bounds)
        meets = [foldable(p.shape) for p in first.bodies if p.body.rigid or not p.body.loose]
        folds = self_contact and (capacity.grows or any(meets))
        self.folding = SelfCollision(state, blocks, self.bounds) if folds else None
        self.pairs = DeformableContact(state, first, self.samples, shapes, self.bounds, self.folding, capacity, fingers)
        self.anything = bool(shapes) or self.pairs.needed
        points = capacity.grows or self.samples.triangle_points(first) > 0
        self.has_pairs = self.pairs.needed or (bool(shapes) and points)
        self.coupled, self.soft = movers is not None, first.soft or capacity.grows
        size = self.samples.capacity + self.pairs.size
        self.begin_rigid, later, self.rigid = size, 0, None
        if self.coupled:
            shapes_of = RigidShapes(movers, self.samples, self.pairs.grids)
            self.rigid = RigidContacts(state, movers, self.samples, self.colliders, shapes_of, self.bounds, size)
            size, later = size + self.rigid.size_of_rows, GROUPS
            self.anything = self.has_pairs = True
        self.fingered, self.fingers, self.begin_fingers = fingers, None, size
        if fingers:
            near = self.rigid.shapes if self.coupled else None
            self.fingers = Fingers(state, self.pairs, self.bounds, size, hands=hands, movers=movers, shapes=near)
            size += self.fingers.size
            self.anything = self.has_pairs = True
        self.rows = ContactConstraints(state, size, movers, size - self.begin_fingers)
        if self.coupled:
            self.rigid.rows = self.rows
            movers.grip.follow(self.hands)
        self.movers, self.forces = movers, ContactForces(state)
        later += self.rows.capacity if self.soft or fingers else 0  # rows between rigid bodies alone are in groups
        self.phase_sizes = (self.rows.capacity,) + (later,) * self.rows.passes
        self.nearby = StaticContact(state, self.samples, self.colliders, self.rows, self.forces, self.bounds.pace)

    def check_capacity(self, model: Model) -> None:
        self.pairs.check_capacity(model)
        self.samples.check_capacity(model)
        if self.anything and not self.has_pairs:
            fit("samples on triangles", self.samples.triangle_points(model), 0)

    def load(self, model: Model) -> None:
        self.samples.load(model)
        self.pairs.load(model)
        if self.coupled:
            self.rigid.load(model)
        self.hands.load(model)
        if self.folding is not None:
            self.folding.load(model)
        self.reset()

    def grasps(self) -> Grips:
        return self.hands.grips()

    def restore_grasps(self, grips: Grips) -> None:
        self.hands.hold(grips)

    def begin_frame(self, hands: list[Hand], dt: float, substeps: int) -> None:
        self.hands.begin_frame(hands, dt, substeps > 0)
        if self.fingers is not None:
            self.fingers.begin_frame(hands, self.hands.gripped(), dt)

    def grasped_bodies(self) -> list[int]:
        return self.hands.gripped()

    def tracked_hands(self) -> list[Hand | None]:
        return list(self.hands.last)

    def hand_forces(self) -> list:
        """Force of each hand [N], (3,)."""
        forces = self.hands.forces()
        if self.coupled:
            forces = [f + g for f, g in zip(forces, self.movers.grip.forces(), strict=True)]
        return forces

    def touch_forces(self) -> list:
        """Force of each hand on what it touches and does not hold [N], (3,)."""
        return [] if self.fingers is None else self.fingers.forces(self.rows)

    def warm_up(self) -> None:
        self.hands.warm_up()
        if self.fingers is not None:
            self.fingers.warm_up()

    def reset(self) -> None:
        self.hands.reset()
        if self.fingers is not None:
            self.fingers.reset()
        self.rows.clear()
        self.nearby.clear()
        if self.coupled:
            self.rigid.reset()

    def detect(self) -> None:
        if self.anything:
            self.bounds.update()
            self.foresight.update()
            if self.fingers is not None and self.fingers.due:
                self.fingers.widen()
            if self.folding is not None:
                self.folding.update()
            self._find()
            self.pairs.detect(self.rows)
            if self.coupled:
                self.rigid.detect()
            if self.fingers is not None and self.fingers.due:
                self.fingers.search(self.rows)

    @ti.kernel
    def _find(self):
        self.rows.listed_count[None] = 0
        for p in range(self.samples.capacity):
            if p < self.samples.count[None]:
                shapes = self.colliders.count[None]
                if ti.static(self.coupled):
                    rigid = self.movers.kind[self.samples.body[p]] != 0
                    shapes = 0 if rigid else shapes  # sim/rigid/rigid_contact.py looks for these
                n = self.nearby.find(p, shapes)
                if self.samples.single[p]:
                    self.forces.forget(self.samples.ids[p][0])
                self.rows.wake[p] = 0
                if n > 0 and not self.samples.single[p]:
                    self.samples.put(p, p, self.rows)
                    self.rows.set_size(p, 3)
                    self.rows.enlist(p)
                else:
                    self.rows.forget(p)

    @ti.func
    def project_vertex(self, i, dx, first: ti.template()):
        """The hands' springs, then vertex i itself out of all shapes near it; the rows' pushes come after."""
        d = dx
        if ti.static(first):
            d = self.hands.pull(i, dx)
        return self.nearby.push_out(i, d, first)

    @ti.func
    def external_displacement(self, i, dx):
        """What the hands' springs add to the free motion of vertex i [m]."""
        return self.hands.pull(i, dx) - dx

    @ti.func
    def project_vertex_implicit(self, i, dx, H, A, prior):
        return self.nearby.push_out_metric(i, dx, H, A, prior)

    @ti.func
    def solve_phase(self, integrator: ti.template(), stage: ti.template(), k, first: ti.template()):
        """What is active of the listed rows claims its share of the masses; then, pass by pass, all take steps.

        In later passes the rows of rigid bodies alone: what soft bodies do to one another waits for the next substep.
        """
        groups = ti.static(GROUPS if self.coupled and stage > 0 else 0)
        if k < groups:
            if ti.static(groups > 0):
                self.rigid.solve(k, stage)
        elif k - groups < self.rows.listed_count[None]:
            r = self.rows.listed[k - groups]
            if ti.static(stage == 0):
                if self.rows.seen[r] != 0:
                    self._claim(r, self.rows.seen[r] == 2, first, integrator)
            elif ti.static(self.soft or self.fingered):
                alone = False
                if ti.static(self.coupled):
                    in_group = self.rows.size[r] == 0 and r < self.begin_fingers
                    alone = in_group or (stage > 1 and self.rows.ends[r] == 0)
                if not alone:
                    self.rows.step(r, stage, integrator)

    @ti.func
    def _claim(self, r, usable, first: ti.template(), integrator: ti.template()):
        if self.begin_rigid <= r < self.begin_fingers and self.rows.size[r] == 0:
            if ti.static(self.coupled):
                self.rigid.claim(r, usable, first, integrator)
        elif ti.static(self.soft or self.fingered):
            self.rows.claim(r, usable, first, integrator)

    @ti.func
    def evaluate(self, k):
        """Take the listed row k anew, unless it is still too far away."""
        if k < self.rows.listed_count[None]:
            r = self.rows.listed[k]
            seen = 0
            if self.state.substep_index[None] >= self.rows.wake[r]:
                usable = False
                if r >= self.begin_fingers:
                    if ti.static(self.fingered):
                        usable = self.fingers.meet(r, self.rows)
                elif r >= self.begin_rigid:
                    if ti.static(self.coupled):
                        usable = self.rigid.meet(r)
                elif ti.static(self.soft):
                    if r < self.samples.capacity:
                        usable = self.nearby.meet(r)
                    elif ti.static(self.pairs.needed):
                        usable = self.pairs.meet(r, self.rows)
                seen = 2 if usable else 1
            self.rows.seen[r] = seen

    @ti.func
    def any_active(self):
        """Whether any row is listed; it stays so until the next search."""
        return self.rows.listed_count[None] > 0

    @ti.func
    def phase_count(self, stage: ti.template()):
        """How many of a stage's elements there are at present."""
        groups = ti.static(GROUPS if self.coupled and stage > 0 else 0)
        return groups + (self.rows.listed_count[None] if ti.static(stage == 0 or self.soft or self.fingered) else 0)

    @ti.func
    def apply_impulses(self, i, dx):
        return dx + self.rows.settle(i)

    def destroy(self) -> None:
        parts = (self.samples, self.colliders, self.rows, self.hands, self.bounds, self.pairs, self.nearby)
        for part in (*parts, self.foresight, self.forces, *filter(None, (self.folding, self.rigid, self.fingers))):
            part.destroy()
