"""The solver: all bodies of a scene, stepped a frame at a time (VR-GS, Sec. 4.1)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import taichi as ti

from core.errors import BadInput
from core.fields import destroy_fields
from core.material import Material
from core.rotation import best_fit_rotation, quaternions_from_matrices
from core.vocabulary import BodyState, Hand
from sim.bodies import RigidBody, SoftBody
from sim.contact.contact_samples import skin_of
from sim.contact.static_shapes import Shape
from sim.contacts import Contacts
from sim.elastic.damping import Damping
from sim.elastic.energy import Elasticity
from sim.elastic.modal_correction import body_modes
from sim.elastic.plastic_flow import INTERVAL, PlasticFlow, checked_rest_shapes
from sim.elastic.vbd import VBDSubsteps, body_colors
from sim.elastic.vbd_persistent import PersistentVBD
from sim.elastic.xpbd import PersistentXPBD, XPBDSubsteps
from sim.hands.grasp import Grasps, GraspState, RigidGrasp
from sim.hands.rigid_editing import RigidEditing
from sim.kinematic_targets import KinematicTargets
from sim.model import BodyModel, Capacity, Model, body_index, models_of, motion_in_float32
from sim.recovery import NonFiniteRecovery, Untangling
from sim.reductions import Observation, ReductionBlocks, Reductions
from sim.rigid.rigid_bodies import MAX_RIGID_SUBSTEP, RigidBodies, passes_for
from sim.sleeping import Sleeping
from sim.state import MOTION, State, motion_of
from sim.time_step import STABILITY_LIMIT, SWEEPS, Integration, Schedule, choose_integration

MAX_FRAME_DT = 1 / 20  # [s] after a hitch the bodies fall behind rather than the frame rate
INTERACTIONS = ("physics", "transform")
WARM_UP_SUBSTEP = 1e-6  # [s] of the substeps that only compile; stable for any body


class Solver:
    """Simulation of `bodies` among static `colliders`.

    substep [s] is forced, or None for what suits the integrator: "xpbd", "vbd", or by "auto" the cheaper one
    (sim/time_step.py). collision_passes is the number of searches for contacts a frame; hands is how many may grip;
    frame_dt [s] is the usual frame. With interaction "transform" gripped bodies follow the hand rigidly and nothing
    else moves. `capacity` is for bodies that are added later (see sim/model.py). Without contacts, bodies pass through
    all else and no hand grips: to measure elasticity alone; without self_contact a body passes through itself. With
    fingers, the capsules of a hand (`Hand.touch`) push the bodies. With `sleep`, bodies that rest are not simulated
    until something reaches them (sim/sleeping.py); without contacts none sleeps. `kinematic` moves kinematic bodies and
    pinned vertices (sim/kinematic_targets.py).
    """

    def __init__(
        self,
        bodies: list[SoftBody | RigidBody],
        colliders: Sequence[Shape] = (),
        *,
        gravity=(0.0, -9.81, 0.0),
        substep: float | None = None,
        collision_passes: int = 1,
        hands: int = 2,
        interaction: str = "physics",
        contacts: bool = True,
        self_contact: bool = True,
        frame_dt: float = 1 / 60,
        integrator: str = "auto",
        capacity: Capacity = Capacity(),
        fingers: bool = False,
        sleep: bool = True,
    ):
        if not bodies and not capacity.grows:
            raise BadInput("nothing to simulate: no body has a cage and a material")
        if collision_passes < 1:
            raise BadInput(f"collision_passes must be at least 1, not {collision_passes}")
        self._frame_dt, self._wanted_integrator, self._wanted_substep = frame_dt, integrator, substep
        self.collision_passes, self.interaction = collision_passes, interaction
        self.gravity = tuple(float(g) for g in gravity)
        first = Model(models_of(bodies))
        self._with_rigid = first.rigid or capacity.rigid
        s = self.state = State(first.sizes, capacity)
        self.x, self.v = s.x, s.v
        blocks = self._blocks = ReductionBlocks(s)
        self._reductions = Reductions(s, blocks)
        grasps = Grasps(s, hands) if contacts else None
        passes = passes_for(self._choose_integration(first, rigid=True).substep)
        rigid = self.rigid_bodies = RigidBodies(s, RigidGrasp(s, grasps), passes=passes) if self._with_rigid else None
        self.contacts: Contacts | None = None
        if contacts:
            self.contacts = Contacts(
                s,
                first,
                list(colliders),
                blocks,
                grasps,
                self_contact=self_contact,
                capacity=capacity,
                rigid_bodies=rigid,
                fingers=fingers,
            )
        self._constraints = [c for c in (self.contacts, self.rigid_bodies) if c is not None]
        self._sleeping = Sleeping(s, self._reductions, self.contacts if sleep else None, self.rigid_bodies)
        self.elasticity, self.damping = Elasticity(s), Damping(s, blocks, self.contacts and self.contacts.forces)
        self.plastic_flow = PlasticFlow(s, self.elasticity)
        self.untangling = Untangling(s, self._reductions, self.damping)
        self.kinematic = KinematicTargets(s, self.rigid_bodies)
        self._recovery = NonFiniteRecovery(s)
        self._rigid_editing = RigidEditing(s)
        self._integrators: dict = {}  # each made at its first use
        self._last_schedule = (0, 0.0)  # substeps of the last frame, and their length [s]
        self._load(first)
        self.reset()

    # Stepping

    def step(self, dt: float, hands: Sequence[Hand] = ()) -> None:
        """Advance by a frame of dt [s], clamped to [0, MAX_FRAME_DT], at whose end the hands are as given."""
        dt = min(max(float(dt), 0.0), MAX_FRAME_DT)
        if self.interaction == "transform":
            self._step_transform(dt, hands)
            return
        self._rigid_editing.end()
        if dt == 0.0 or not self._model.bodies:
            return
        most, substep = self.integrator.max_substeps, self._integration.substep
        if self.plastic_flow.active:
            most = min(most, max(1, math.floor(INTERVAL / substep + 1e-6)))
        schedule = Schedule.of(dt / substep, self.collision_passes, most)
        if self._all_sleep(dt, hands, schedule.total_substeps):
            self._last_schedule = (0, 0.0)
            return
        self._begin_frame(dt, schedule.total_substeps)
        launch_dt = dt / sum(schedule.launches)
        for launches in schedule.launches:
            self._find_contacts(dt)
            for _ in range(launches):
                self.untangling.run(launch_dt)
                self.damping.run(launch_dt)
                self.integrator.run(schedule.substeps)  # each: predict, elasticity, contacts and hands, commit
                self.plastic_flow.run(self.integrator.patches)
        self._recovery.recover()
        self.kinematic.end_frame()
        self._sleeping.end_frame(dt)

    def _all_sleep(self, dt: float, hands: Sequence[Hand], substeps: int) -> bool:
        """Take the hands of this frame, and wake what they or targets move; return whether nothing is awake."""
        if self.contacts is not None:
            self.contacts.begin_frame(hands, dt, substeps)
        moved = self._grasped_bodies() | self.kinematic.driven_bodies | self.untangling.occupied
        return self._sleeping.begin_frame(moved, tuple(self.gravity))

    def _begin_frame(self, dt: float, substeps: int) -> None:
        self.state.begin_frame(dt / substeps, dt / self.collision_passes, substeps, *self.gravity)
        self._last_schedule = (substeps, dt / substeps)
        self.kinematic.begin_frame(dt)
        if self.rigid_bodies is not None:
            self.rigid_bodies.begin_frame()
        if self.untangling.begin_frame(self._grasped_bodies(), self.kinematic.bodies, dt):
            self._restart_contacts(self._grasps())
        self._reductions.forget()

    def _find_contacts(self, dt: float) -> None:
        for c in self._constraints:
            c.detect()
        self._sleeping.search(dt)

    def _step_transform(self, dt: float, hands: Sequence[Hand]) -> None:
        """Let gripped bodies follow the hands, while time stands still."""
        grasped, tracked = [], hands
        if self.contacts is not None:
            self.contacts.begin_frame(hands, dt, 0)
            grasped, tracked = self.contacts.hands.grasped_bodies(), list(self.contacts.hands.last)
        if self._rigid_editing.step(tracked, grasped):
            self.wake()
        if any(b >= 0 and self._model.bodies[b].body.rigid for b in grasped):
            self._fit_rigid_bodies()
        self._last_schedule = (0, 0.0)

    @property
    def interaction(self) -> str:
        """ "physics", or "transform": gripped bodies follow the hand rigidly and time stands still."""
        return self._interaction

    @interaction.setter
    def interaction(self, value: str) -> None:
        if value not in INTERACTIONS:
            raise BadInput(f"interaction must be one of {', '.join(INTERACTIONS)}, not {value!r}")
        self._interaction = value

    # Observing

    def bodies(self) -> list[BodyState]:
        """Centroid, velocity, bounds and axis of each body, and whether a hand holds it."""
        return self._reductions.bodies(self._held())

    def observe(self) -> Observation:
        """`bodies`, and whether any vertex moved by 1e-5 m, with one wait for the device when they are wanted."""
        return self._reductions.observe(self._held())

    def pick(self, origin, direction) -> tuple[float, int] | None:
        """Distance [m] along a ray to the nearest surface triangle and its body's index, or None."""
        return self._reductions.pick(origin, direction)

    def hand_forces(self) -> list[np.ndarray]:
        """Force of each hand on the body it holds in the last substep [N], (3,) each; zero for an open hand."""
        return [] if self.contacts is None else self.contacts.hand_forces()

    def touch_forces(self) -> list[np.ndarray]:
        """Force of each hand's finger capsules on bodies it does not grasp, in the last substep [N], (3,) each.

        Empty without fingers.
        """
        return [] if self.contacts is None else self.contacts.touch_forces()

    def contact_forces(self) -> np.ndarray:
        """Force of all contacts on each body in the last substep [N], (B, 3)."""
        return np.zeros((len(self._model.bodies), 3)) if self.contacts is None else self.contacts.forces.per_body()

    def place_static(self, shapes: Sequence[Shape]) -> None:
        """Put the static shapes, the same ones as at first, where these are; all bodies wake."""
        if self.contacts is not None:
            self.contacts.static_shapes.place(list(shapes))
        self.wake()

    def wake(self) -> None:
        """Wake all bodies: after a change that the solver cannot see, such as of `x` or `v`."""
        self._reductions.forget()
        self._sleeping.restore(None)

    def take_scaling(self) -> tuple[int, float] | None:
        """Body and factor for `rescale`, if two hands have just scaled a body in "transform"; each only once."""
        return self._rigid_editing.take_scaling()

    @property
    def body_models(self) -> tuple[BodyModel, ...]:
        """The bodies, with their shapes."""
        return self._model.bodies

    def rest_inverses(self) -> list[np.ndarray]:
        """D_m^-1 of each body's tets [1/m] as plastic flow has left them, (T, 3, 3) each."""
        rests = self.plastic_flow.read()
        return [s.inverse for s in self._model.shapes] if rests is None else self._model.split_tets(rests)

    @property
    def vertex_offset(self) -> list[int]:
        """First vertex of each body, and the end of the last, (B+1,)."""
        return self._model.vertex_begin.tolist()

    @property
    def simulated(self) -> bool:
        """True if the last step simulated anything: if time passed, and not all bodies slept."""
        return self._last_schedule[0] > 0

    @property
    def stats(self) -> dict:
        """Sizes, substeps of the last frame, dt sqrt(max kappa) with its limit; `finite` reads the device back.

        `asleep` counts the bodies that sleep (sim/sleeping.py), `recovered` those that were not finite and were
        restored (sim/recovery.py).
        """
        substeps, dt = self._last_schedule
        dt = float(dt or self._integration.substep)
        return {
            "vertices": self.state.sizes.vertices,
            "tets": self.state.sizes.tets,
            "substeps": substeps,
            "dt": dt,
            "stability": dt * math.sqrt(self._model.kappas.max(initial=0.0)),
            "stability_limit": STABILITY_LIMIT,
            "integrator": self._integration.integrator,
            "iterations": self.integrator.iterations,
            "collision_passes": self.collision_passes,
            "finite": self._reductions.finite(),
            "asleep": int(self._asleep().sum()),
            "recovered": int(self._recovery.count[None]),
        }

    # Editing: bodies keep their order, their indices stay compact, and those that are not edited keep their motion and
    # the hands' grasps. BadInput, and nothing has changed, if a body cannot be simulated or the capacity is exceeded.
    # Contacts begin without impulses.

    def add(self, body: SoftBody | RigidBody) -> int:
        """Add a body at its start; return its index."""
        return self.add_all([body])

    def derived(self, body: SoftBody | RigidBody, known: Sequence[BodyModel] = ()) -> BodyModel:
        """A body with the tables that take long, as `known` ones have them; a thread may do it, on the host alone."""
        model = BodyModel.of(body, list(known))
        body_colors(Model([model]))
        body_modes(Model([model]))
        if self.contacts is not None:
            model.shape.root.once(skin_of, self.contacts.samples.spacing)
        return model

    def add_all(self, bodies: Sequence[SoftBody | RigidBody], known: Sequence[BodyModel] = ()) -> int:
        """Add bodies at their start, all or none, some of them like `known` ones; return the index of the first."""
        models, motions, rests, grasps = self._in_motion()
        first = len(models)
        for body in bodies:
            models.append(BodyModel.of(body, [*known, *models]))
        starts = [m.start for m in models[first:]]
        self._change(models, [*motions, *starts], [*rests, *(None for _ in starts)], grasps)
        return first

    def remove(self, i: int) -> None:
        """Remove body i; a hand that holds it opens, and the later bodies move up by one."""
        models, motions, rests, grasps = self._in_motion()
        i = body_index(i, models)
        new_index = [k - (k > i) if k != i else None for k in range(len(models))]
        del models[i], motions[i], rests[i]
        self._change(models, motions, rests, None if grasps is None else grasps.renumbered(new_index))

    def duplicate(self, i: int, offset) -> int:
        """Copy body i as it is deformed and moves now, at `offset` (3,) [m] from it; return the copy's index.

        The copy starts, if it is reset, with the rotation nearest to its shape.
        """
        models, motions, rests, grasps = self._in_motion()
        i = body_index(i, models)
        model, (x, v) = models[i], positions_and_velocities(motions[i])
        rest, center = model.shape.vertices, model.shape.center
        c = np.average(x, axis=0, weights=model.mass)
        R = best_fit_rotation(((x - c) * model.mass[:, None]).T @ (rest - center))
        origin = c - R @ center
        position = origin + np.asarray(offset, np.float64)
        copy = model.placed(tuple(quaternions_from_matrices(R).tolist()), tuple(position.tolist()))
        moved = motion_in_float32((x - origin) + position, v)
        self._change([*models, copy], [*motions, moved], [*rests, rests[i]], grasps)
        return len(models)

    def rescale(self, i: int, factor: float, *, about=None) -> None:
        """Make body i `factor` times as large about its centre of mass, or a point; velocities stay.

        Mass, stiffness bounds, distance grid and contact samples follow. Hands go on holding the same vertices.
        """
        models, motions, rests, grasps = self._in_motion()
        i = body_index(i, models)
        model, (x, v) = models[i], positions_and_velocities(motions[i])
        if not (np.isfinite(factor) and factor > 0.0):
            raise BadInput(f"{model.body.name}: cannot be scaled by {factor}")
        center = np.average(x, axis=0, weights=model.mass) if about is None else np.asarray(about, np.float64)
        shift = (factor - 1.0) * (x - center)
        moved = motion_in_float32(x + shift, v)
        moved[3] = motions[i][3]
        models[i], motions[i], rests[i] = model.scaled(factor), moved, None if rests[i] is None else rests[i] / factor
        self._change(models, motions, rests, None if grasps is None else grasps.shifted(i, shift))

    def displace(self, i: int, matrix: np.ndarray, *, rest: bool = False) -> None:
        """Move body i as it is by a rigid motion (4, 4) of the world; its velocities turn too, or `rest` ends them."""
        models, motions, rests, grasps = self._in_motion()
        i, M = body_index(i, models), np.asarray(matrix, np.float64)
        R = M[:3, :3]
        if M.shape != (4, 4) or not np.isfinite(M).all() or np.abs(R @ R.T - np.eye(3)).max() > 1e-6:
            raise BadInput(f"{models[i].body.name}: the matrix is not a rigid motion")
        x, v = positions_and_velocities(motions[i])
        shift = x @ (R.T - np.eye(3)) + M[:3, 3]
        motions[i] = motion_in_float32(x + shift, 0.0 * v if rest else v @ R.T)
        self._change(models, motions, rests, None if grasps is None else grasps.shifted(i, shift))

    def set_material(self, i: int, material: Material) -> None:
        """Give body i another material. What plastic flow has made of it, it keeps only in one that yields."""
        models, motions, rests, grasps = self._in_motion()
        i = body_index(i, models)
        models[i] = models[i].with_material(material)
        self._change(models, motions, rests, grasps)

    def reset(self, body_models: Sequence[BodyModel] | None = None) -> None:
        """Put all bodies, or these instead, back at their starts; grasps and contacts are forgotten."""
        models = self._model.bodies if body_models is None else body_models
        self._change(models, [m.start for m in models], [None] * len(models), None)
        self._sleeping.restore(np.array([m.body.asleep for m in models], bool))
        self.untangling.restore(None)

    def snapshot(self) -> dict:
        """Return all that `restore` needs: x, x_lo, v, v_lo (V, 3), bodies, grasps, untangling, asleep (B,).

        And rest_inverse, D_m^-1 of all tets (T, 3, 3) [1/m], or None where no body yields.

        Impulses of contacts are not kept: a restored state evolves identically each time, but contacts converge
        to their loads again in the first substeps.
        """
        motion = dict(zip(MOTION, self.state.read_motion(), strict=True))
        return {
            **motion,
            "bodies": self._model.bodies,
            "grasps": self._grasps(),
            "untangling": self.untangling.snapshot(),
            "asleep": self._asleep(),
            "rest_inverse": self.plastic_flow.read(),
        }

    def restore(self, snapshot: dict) -> None:
        """Go on from a snapshot.

        Only "x" and "v" are needed. Without "bodies" these are as now, without "grasps" hands are open, without
        "asleep" all are awake, without "rest_inverse" rest shapes are as they were made, and what fp32 cannot hold of
        float64 values goes to x_lo and v_lo.
        """
        models = tuple(snapshot.get("bodies", self._model.bodies))
        motion = motion_of(snapshot, sum(len(m.shape.vertices) for m in models))
        rests = snapshot.get("rest_inverse")
        if rests is not None:
            checked_rest_shapes(Model(models), rests)
        self._set_bodies(models, motion, rests, snapshot.get("grasps"))
        self.untangling.restore(snapshot.get("untangling"))
        self._sleeping.restore(snapshot.get("asleep"))
        self._rigid_editing.reset()

    def warm_up(self) -> None:
        """Compile all that may be needed later: steps with either integrator, grasps, throws, picks, edits; `reset`.

        So the user waits before the first picture, and never during play.
        """
        self.state.read_motion()
        for part in (self._rigid_editing, self.untangling, self.plastic_flow, *self._constraints):
            part.warm_up()
        self.pick((0.0, 0.0, 0.0), (0.0, 1.0, 0.0))
        self.observe()
        wanted = ("xpbd", "vbd") if self._wanted_integrator == "auto" else (self._integration.integrator,)
        for name in wanted if self._model.bodies else ():  # those that these bodies can come to need
            integrator = self._made_integrator(name)
            integrator.load(self._model)
            self._all_sleep(WARM_UP_SUBSTEP, (), 1)
            self._begin_frame(WARM_UP_SUBSTEP, 1)
            self._find_contacts(WARM_UP_SUBSTEP)
            self.damping.run(WARM_UP_SUBSTEP)
            integrator.run(1)
            self._recovery.recover()
            self._sleeping.end_frame(WARM_UP_SUBSTEP)
            integrator.reset()
        self.kinematic.end_frame()
        self.reset()

    def destroy(self) -> None:
        """Give the device memory back; the solver must not be used after."""
        destroy_fields(self)

    # Internals

    def _choose_integration(self, model: Model, *, rigid: bool) -> Integration:
        """Choose for these bodies; rigid ones limit the substep. BadInput if what is forced does not suit."""
        kappas = model.kappas
        chosen = choose_integration(
            float(kappas.max(initial=0.0)),
            frame_dt=self._frame_dt,
            integrator=self._wanted_integrator,
            substep=self._wanted_substep,
            stiffest=model.bodies[int(np.argmax(kappas))].body.name if model.bodies else "nothing",
            crossing_time=model.crossing_time,
            device="cuda" if ti.cfg.arch == ti.cuda else "cpu",
        )
        longest = MAX_RIGID_SUBSTEP * SWEEPS[chosen.integrator]
        return replace(chosen, substep=min(chosen.substep, longest)) if rigid else chosen

    def _made_integrator(self, name: str):
        """The integrator "xpbd" or "vbd", made at its first use; on CUDA a persistent kernel."""
        if name not in self._integrators:
            parts = self.state, self.elasticity, self._constraints, self.rigid_bodies
            if ti.cfg.arch != ti.cuda:
                made = XPBDSubsteps(*parts) if name == "xpbd" else VBDSubsteps(*parts, self._blocks)
            elif name == "xpbd":
                made = PersistentXPBD(*parts)
            else:
                made = PersistentVBD(*parts, self._blocks, per_multiprocessor=2)
                if not made.fits():
                    made.destroy()
                    made = PersistentVBD(*parts, self._blocks)
            self._integrators[name] = made
        return self._integrators[name]

    def _load(self, model: Model) -> None:
        """Take other bodies, whose motion is still to be set; BadInput, and nothing has changed, if that cannot be."""
        integration = self._choose_integration(model, rigid=self._with_rigid)
        self.state.check_capacity(model.sizes)
        for c in self._constraints:
            c.check_capacity(model)
        self._model, self._integration = model, integration
        self.integrator = self._made_integrator(integration.integrator)
        parts = (self.state, self.elasticity, self._blocks, self._reductions, self.integrator, self.untangling)
        for part in (*parts, self.plastic_flow, self.kinematic, *self._constraints):
            part.load(model)

    def _set_bodies(self, models: tuple[BodyModel, ...], motion, rests, grasps: GraspState | None) -> None:
        if self._model.bodies != models:
            self._load(Model(models))
        self.state.write_motion(motion)
        self.plastic_flow.write(rests, self.integrator.patches)
        self._reductions.forget()
        self._recovery.begin()
        self.kinematic.end_frame()
        self._restart_contacts(grasps)
        self._sleeping.restore(None)

    def _in_motion(self) -> tuple[list[BodyModel], list[np.ndarray], list, GraspState | None]:
        """The bodies; the motion of each (x, x_lo, v, v_lo: (4, V, 3) float32), D_m^-1 if one yields; the grasps."""
        models, rests = list(self._model.bodies), self.plastic_flow.read()
        motions = np.split(self.state.read_motion(), self._model.vertex_begin[1:-1], axis=1) if models else []
        return models, motions, [None] * len(models) if rests is None else self._model.split_tets(rests), self._grasps()

    def _change(self, models: Sequence[BodyModel], motions: list, rests: list, grasps: GraspState | None) -> None:
        """Take edited bodies, with the motion of each, and D_m^-1 of its tets, None: as they were made."""
        motion = np.concatenate([np.zeros((4, 0, 3), np.float32), *motions], axis=1)
        as_made = all(r is None for r in rests)
        whole = [m.shape.inverse if r is None else r for m, r in zip(models, rests, strict=True) if not as_made]
        self._set_bodies(tuple(models), motion, None if as_made else np.concatenate(whole), grasps)
        self._rigid_editing.reset(held=True)

    def _restart_contacts(self, grasps: GraspState | None) -> None:
        """Forget all contacts; hands hold `grasps`, or nothing."""
        if self.rigid_bodies is not None:
            self._fit_rigid_bodies()
        for c in self._constraints:
            c.reset()
        if self.contacts is not None and grasps is not None:
            self.contacts.hands.set_state(grasps)
        self.integrator.reset()

    def _fit_rigid_bodies(self) -> None:
        """Put the rigid bodies where their vertices are."""
        x, x_lo, v, v_lo = self.state.read_motion().astype(np.float64)
        self.rigid_bodies.set_motion(x + x_lo, v + v_lo)

    def _grasps(self) -> GraspState | None:
        return None if self.contacts is None else self.contacts.hands.get_state()

    def _asleep(self) -> np.ndarray:
        return self._reductions.flags()[1, : len(self._model.bodies)] > 0

    def _grasped_bodies(self) -> set[int]:
        return set() if self.contacts is None else {*self.contacts.hands.grasped_bodies()} - {-1}

    def _held(self) -> list[bool]:
        grasped = self._grasped_bodies()
        return [b in grasped for b in range(len(self._model.bodies))]


def positions_and_velocities(motion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions [m] and velocities [m/s] of a motion (4, V, 3), in double precision, (V, 3) each."""
    m = motion.astype(np.float64)
    return m[0] + m[1], m[2] + m[3]
