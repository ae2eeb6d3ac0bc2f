"""The solver: all elastic bodies of a scene, stepped a frame at a time (VR-GS, Sec. 4.1)."""

import math
from dataclasses import replace

import numpy as np
import taichi as ti

from core.errors import BadInput
from core.fields import destroy_fields
from scenes.scene import BodyState, Hand
from sim.body_editing import Editing
from sim.body_model import BodyModel
from sim.boundaries import Boundaries
from sim.contact.contacts import Contacts
from sim.contact.static_shapes import Shape
from sim.elastic.damping import Damping
from sim.elastic.energy import Elasticity
from sim.elastic.time_step import LIMIT, Plan, choose_plan
from sim.elastic.untangling import Untangling
from sim.elastic.vbd import VBDSubsteps
from sim.elastic.xpbd import XPBDSubsteps
from sim.hands.transform import Transform
from sim.kinematic_targets import KinematicTargets
from sim.model import Capacity, Model
from sim.recovery import NonFiniteRecovery
from sim.reductions import ReductionBlocks, Reductions
from sim.rigid.rigid_bodies import LONGEST_SUBSTEP, MOST_PASSES, PASS, RigidBodies
from sim.rigid.rigid_body import RigidBody
from sim.soft_body import SoftBody
from sim.state import State

LONGEST_FRAME = 1 / 20  # [s] after a hitch the bodies fall behind rather than the frame rate
INTERACTIONS = ("physics", "transform")


class Solver(Editing, Boundaries):
    """Simulates `bodies`.

    substep [s] and iterations (full sweeps a substep) are forced, or None for what suits the path: "jacobi", "descent",
    or by "auto" the cheaper one (sim/elastic/time_step.py). collision_passes is how often a frame contacts are searched; hands
    is how many may grip; frame_dt [s] is the usual frame. With interaction "transform" gripped bodies follow the hand
    rigidly and nothing else moves.
    room says how much more than `bodies` there may come to be (see sim/model.py, and sim/body_editing.py for how).
    Without contacts, bodies pass through all else and no hand grips: to measure elasticity alone; without self_contact
    a body passes through itself. With fingers, what hands touch with (`Hand.touch`) pushes the bodies.
    """

    def __init__(
        self,
        bodies: list[SoftBody | RigidBody],
        colliders: list[Shape] = (),
        *,
        gravity=(0.0, -9.81, 0.0),
        substep: float | None = None,
        iterations: int | None = None,
        collision_passes: int = 1,
        hands: int = 2,
        interaction: str = "physics",
        contacts: bool = True,
        self_contact: bool = True,
        frame_dt: float = 1 / 60,
        path: str = "auto",
        room: Capacity | float | None = None,
        fingers: bool = False,
    ):
        room = Capacity.of(room)
        if not bodies and not room.grows:
            raise BadInput("nothing to simulate: no body has a cage and a material")
        if collision_passes < 1:
            raise BadInput(f"collision_passes must be at least 1, not {collision_passes}")
        self._wanted = {"frame_dt": frame_dt, "path": path, "substep": substep, "iterations": iterations}
        self.collision_passes, self.interaction = collision_passes, interaction
        self.gravity = tuple(float(g) for g in gravity)
        self._parts: list[BodyModel] = []
        for b in bodies:
            self._parts.append(BodyModel.of(b, self._parts))
        first = Model(self._parts)
        self._movers: RigidBodies | None = None
        self._with_rigid = first.rigid or room.rigid
        plan = self._choose(first)
        s = self.state = State(first.sizes, room)
        self.x, self.v, self.rest, self.inv_mass, self.tets, self.body_of_vertex = (
            s.x, s.v, s.rest, s.inv_mass, s.tets, s.body_of_vertex,
        )  # fmt: skip
        self._elastic, self._chunks = Elasticity(s), ReductionBlocks(s)
        self._damping, self._summary, self._transform = (
            Damping(s, self._chunks),
            Reductions(s, self._chunks),
            Transform(s),
        )
        self._mending, self._driven = Untangling(s, self._summary, self._damping), KinematicTargets(s)
        self._rescue = NonFiniteRecovery(s)
        if self._with_rigid:
            passes = min(max(math.ceil(plan.substep / PASS), 1), MOST_PASSES)
            self._movers = RigidBodies(s, hands=hands if contacts else 0, passes=passes)
        options = {"hands": hands, "self_contact": self_contact, "room": room, "movers": self._movers}
        options["fingers"] = fingers
        contact = [Contacts(s, first, list(colliders), self._chunks, **options)] if contacts else []
        self._contacts, self._constraints = contact, [*contact, *([self._movers] if self._with_rigid else [])]
        self._paths, self._taken = {}, set()
        self._last = (0, 0.0)  # substeps and their length in the last frame
        self._open()
        self._load(first)
        self.reset()

    def _choose(self, assembly: Model) -> Plan:
        """Path, substep and sweeps for these bodies; BadInput if what was asked for does not suit them."""
        kappas = assembly.kappas
        stiffest = assembly.parts[int(np.argmax(kappas))].body.name if assembly.parts else "nothing"
        how = {"stiffest": stiffest, "crossing": assembly.crossing}
        plan = choose_plan(float(kappas.max(initial=0.0)), **how, **self._wanted)
        return replace(plan, substep=min(plan.substep, LONGEST_SUBSTEP)) if self._with_rigid else plan

    def _take(self, plan: Plan) -> None:
        """Step by this plan from now on; a path is compiled when it is first taken."""
        self._plan = plan
        if plan.path not in self._paths:
            parts = self.state, self._elastic, self._constraints, self._movers
            if plan.path == "descent":
                substeps = VBDSubsteps(*parts, self._chunks, iterations=plan.iterations)
            elif ti.cfg.arch == ti.cuda and plan.iterations == 1 and self._movers is None:
                from sim.elastic.xpbd_persistent import PersistentXPBD

                substeps = PersistentXPBD(self.state, self._constraints)
            else:
                substeps = XPBDSubsteps(*parts, iterations=plan.iterations)
            self._paths[plan.path] = substeps
        self._substeps = self._paths[plan.path]

    def _load(self, assembly: Model) -> None:
        """Take other bodies, whose motion is still to be set; BadInput, and nothing has changed, if that cannot be."""
        plan = self._choose(assembly)
        self.state.check_capacity(assembly.sizes)
        for c in self._constraints:
            c.check_capacity(assembly)
        self._parts = assembly.parts
        self._kappa = float(assembly.kappas.max(initial=0.0))
        self.vertex_offset = assembly.vertex_begin.tolist()
        self._take(plan)
        parts = (self.state, self._elastic, self._chunks, self._summary, self._substeps, self._mending)
        for part in (*parts, *self._constraints):
            part.load(assembly)

    def step(self, dt: float, hands: list[Hand] = ()) -> None:
        """Advance by a frame of dt [s], clamped to [0, LONGEST_FRAME]."""
        dt = min(max(float(dt), 0.0), LONGEST_FRAME)
        if self.interaction == "transform":
            self._step_transform(dt, hands)
            return
        if self._transform.stretch.pairs:
            self._transform.stretch.end()
        if dt == 0.0 or not self._parts:
            return
        n = max(self.collision_passes, math.ceil(dt / self._plan.substep - 1e-6))
        pieces = max(self.collision_passes, -(-n // self._substeps.max_substeps))
        length = -(-n // pieces)
        n = pieces * length
        self.state.begin_frame(dt / n, dt / self.collision_passes, n, ti.Vector(self.gravity))
        self._driven.begin_frame(dt)
        for c in self._constraints:
            c.begin_frame(hands, dt, n)
        if self._mending.begin_frame(self._gripped(), self._driven.bodies, dt):
            self._forget()
        for p in range(pieces):
            if p == 0 or p * self.collision_passes // pieces != (p - 1) * self.collision_passes // pieces:
                for c in self._constraints:
                    c.detect()
            self._mending.run(dt / pieces)
            self._damping.run(dt / pieces)
            self._substeps.run(length)
        self._taken.add(self._plan.path)
        self._rescue.run(0)
        self._driven.end_frame()
        self._last = (n, dt / n)

    def _step_transform(self, dt: float, hands: list[Hand]) -> None:
        gripped = []
        for c in self._contacts:
            c.begin_frame(hands, dt, 0)
            gripped, hands = c.grasped_bodies(), c.tracked_hands()
        self._transform.step(hands, gripped)
        if any(b >= 0 and self._parts[b].body.rigid for b in gripped):
            self._fit()
        self._last = (0, 0.0)

    @property
    def fresh(self) -> bool:
        """Whether the next step takes a path for the first time, and compiles it for seconds."""
        return self._plan.path not in self._taken

    def hand_forces(self) -> list[np.ndarray]:
        """Force of each hand on what it holds [N], (3,) each, in the last substep; zero for an open hand."""
        return [force for c in self._contacts for force in c.hand_forces()]

    def touch_forces(self) -> list[np.ndarray]:
        """Force of each hand's `touch` on what it does not hold [N], (3,), in the last substep; [] without fingers."""
        return [force for c in self._contacts for force in c.touch_forces()]

    def stretched(self) -> tuple[int, float] | None:
        """With interaction "transform": a body that two hands have just made larger or smaller, and how many times, for
        `rescale`; None if there is none, and each only once."""
        return self._transform.stretch.take_finished()

    def bodies(self) -> list[BodyState]:
        """Centroid, velocity, bounds, axis of each body, and whether a hand holds it."""
        held = self._gripped()
        return self._summary.bodies([b in held for b in range(len(self._parts))])

    def contact_forces(self) -> np.ndarray:
        """Force of all contacts on each body in the last substep [N], (B, 3)."""
        total = np.zeros((len(self._parts), 3))
        for c in self._contacts:
            total += c.forces.per_body(c.rows)
        return total

    def _gripped(self) -> set[int]:
        return {b for c in self._contacts for b in c.grasped_bodies()}

    def pick(self, origin, direction) -> tuple[float, int] | None:
        """Distance [m] along a ray to the nearest surface triangle and its body's index, or None."""
        return self._summary.pick(origin, direction)

    def moved(self) -> bool:
        """Whether any vertex moved more than 1e-5 m since this last returned True."""
        return self._summary.moved()

    def observe(self) -> tuple[bool, list[BodyState]]:
        """`moved` and `bodies`, with one wait for the device instead of two."""
        held = self._gripped()
        moved, bodies, self._mending.seen = self._summary.observe([b in held for b in range(len(self._parts))])
        return moved, bodies

    def destroy(self) -> None:
        """Give the device memory back; the solver must not be used after."""
        destroy_fields(self)

    @property
    def interaction(self) -> str:
        """ "physics", or "transform": gripped bodies follow the hand rigidly and time stands still."""
        return self._interaction

    @interaction.setter
    def interaction(self, value: str) -> None:
        if value not in INTERACTIONS:
            raise BadInput(f"interaction must be one of {', '.join(INTERACTIONS)}, not {value!r}")
        self._interaction = value

    @property
    def stats(self) -> dict:
        """Sizes, substeps of the last frame, dt sqrt(max kappa) with its limit; `finite` reads the device back;
        `rescued`: how often a body that was not finite was put back (sim/recovery.py)."""
        n, dt = self._last
        dt_or_planned = float(dt or self._plan.substep)
        return {
            "vertices": self.state.sizes.vertices,
            "tets": self.state.sizes.tets,
            "substeps": n,
            "dt": dt_or_planned,
            "stability": dt_or_planned * math.sqrt(self._kappa),
            "stability_limit": LIMIT,
            "path": self._plan.path,
            "iterations": self._plan.iterations,
            "collision_passes": self.collision_passes,
            "finite": self._summary.finite(),
            "rescued": int(self._rescue.count[None]),
        }
