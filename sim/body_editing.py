"""Changing which bodies there are while the solver runs: the same fields and kernels, other contents.

Each change makes a new list of parts (sim/body_model.py), which reuses what is known of the meshes; all arrays are joined
and uploaded anew, and those bodies that stay keep their motion and the hands' grips. Contacts begin without impulses.
"""

from __future__ import annotations

import numpy as np

from core.errors import BadInput
from core.fields import Download, Upload
from core.material import Material
from core.rotation import matrices_from_quaternions, quaternions_from_matrices
from sim.body_model import BodyModel, motion
from sim.kinematic_targets import KinematicTargets
from sim.model import Model
from sim.recovery import NonFiniteRecovery
from sim.reductions import best_rotation
from sim.rigid.rigid_bodies import RigidBodies
from sim.soft_body import SoftBody

ASIDE = 0.01  # [m] between a body and its copy


class Editing:
    """The solver's methods that change its bodies, and `snapshot` and `restore`. Indices stay compact.

    BadInput, and nothing has changed, if a body cannot be simulated or there is no room for it.
    """

    _parts: list[BodyModel]
    _movers: RigidBodies | None
    _driven: KinematicTargets
    _rescue: NonFiniteRecovery

    @property
    def _bodies(self) -> list[SoftBody]:
        return [p.body for p in self._parts]

    def _open(self) -> None:
        s = self.state
        self._write, self._read = (kind([s.x, s.x_lo, s.v, s.v_lo]) for kind in (Upload, Download))

    def add(self, body: SoftBody) -> int:
        """A further body, at its start; its index."""
        part = BodyModel.of(body, self._parts)
        self._change([*self._parts, part], [*self._motions(), part.start], self._grips())
        return len(self._parts) - 1

    def remove(self, i: int) -> None:
        """Take body i away; a hand that holds it opens, and the later bodies move up by one."""
        i = self._index(i)
        index = [k - (k > i) if k != i else None for k in range(len(self._parts))]
        motions, parts = self._motions(), list(self._parts)
        del motions[i], parts[i]
        self._change(parts, motions, [g.moved(index) for g in self._grips()])

    def duplicate(self, i: int, *, position=None, rotation=None, aside=None) -> int:
        """A copy of body i as it is deformed and moves now; its index.

        Its frame is put at `position` [m] with `rotation` (wxyz), where None is body i's; with neither given the copy
        stands beside it, along x, or by `aside` (3,) [m]. The frame of a deformed body is that of the rotation nearest
        to its shape.
        """
        i = self._index(i)
        part, m = self._parts[i], self._motions()[i].astype(np.float64)
        x, v, rest, center = m[0] + m[1], m[2] + m[3], part.shape.vertices, part.shape.center
        c = np.average(x, axis=0, weights=part.mass)
        R = best_rotation(((x - c) * part.mass[:, None]).T @ (rest - center))
        origin = c - R @ center
        if position is None:
            beside = (np.ptp(x[:, 0]) + ASIDE) if rotation is None else 0.0
            position = origin + ([beside, 0.0, 0.0] if aside is None else np.asarray(aside, np.float64))
        turn = np.eye(3)
        if rotation is not None:
            q = np.asarray(rotation, np.float64)
            turn = matrices_from_quaternions((q / np.linalg.norm(q))[None])[0] @ R.T
        start = tuple(quaternions_from_matrices(turn @ R).tolist()), tuple(np.asarray(position, np.float64).tolist())
        copy = motion((x - origin) @ turn.T + np.asarray(position, np.float64), v @ turn.T)
        self._change([*self._parts, part.placed(*start)], [*self._motions(), copy], self._grips())
        return len(self._parts) - 1

    def rescale(self, i: int, factor: float, *, about=None) -> None:
        """Make body i `factor` times as large about its centre of mass, or a point; velocities stay.

        Mass, stiffness bounds, distance grid and contact samples follow. Hands go on holding the same vertices.
        """
        if not (np.isfinite(factor) and factor > 0.0):
            raise BadInput(f"{self._parts[i].body.name}: cannot be scaled by {factor}")
        i = self._index(i)
        parts, motions = list(self._parts), self._motions()
        m = motions[i].astype(np.float64)
        x = m[0] + m[1]
        center = np.average(x, axis=0, weights=parts[i].mass) if about is None else np.asarray(about, np.float64)
        shift = (factor - 1.0) * (x - center)
        parts[i], motions[i] = parts[i].scaled(factor), motion(x + shift, m[2] + m[3])
        motions[i][3] = m[3]
        self._change(parts, motions, [g.shifted(i, shift) for g in self._grips()])

    def displace(self, i: int, matrix: np.ndarray) -> None:
        """Put body i elsewhere as it is, by a rigid motion (4, 4) of the world; its velocities turn with it."""
        i, M = self._index(i), np.asarray(matrix, np.float64)
        R = M[:3, :3]
        if M.shape != (4, 4) or not np.isfinite(M).all() or np.abs(R @ R.T - np.eye(3)).max() > 1e-6:
            raise BadInput(f"{self._parts[i].body.name}: cannot be moved by what is no rigid motion")
        motions = self._motions()
        m = motions[i].astype(np.float64)
        x = m[0] + m[1]
        shift = x @ (R.T - np.eye(3)) + M[:3, 3]
        motions[i] = motion(x + shift, (m[2] + m[3]) @ R.T)
        self._change(self._parts, motions, [g.shifted(i, shift) for g in self._grips()])

    def set_material(self, i: int, material: Material) -> None:
        """Let body i be of another material from now on."""
        parts, i = list(self._parts), self._index(i)
        parts[i] = parts[i].with_material(material)
        self._change(parts, self._motions(), self._grips())

    def warm_up(self) -> None:
        """Compile what a first grip, throw, look or change needs, by calls that change nothing: at the start, lest the
        user wait for it in the midst of play."""
        self._read(0)
        for part in (self._transform, self._mending, *self._constraints):
            part.warm_up()
        self.pick((0.0, 0.0, 0.0), (0.0, 1.0, 0.0))

    def snapshot(self) -> dict:
        """All that `restore` needs to go on from here: x, v, carry, v_lo (V, 3), bodies, grips, what is mending.

        Impulses of contacts are not kept: what is restored goes on the same way each time, but contacts find their
        loads anew in the first substeps.
        """
        values = self._read(self.state.sizes.vertices)
        arrays = dict(zip(("x", "x_lo", "v", "v_lo"), values, strict=True))
        others = {"bodies": tuple(self._parts), "grips": tuple(self._grips()), "mending": self._mending.kept()}
        return {**arrays, **others}

    def restore(self, snapshot: dict, *, editing: bool = False) -> None:
        """Go on from a snapshot. Only "x" and "v" are needed; without "bodies" these are as now, without "grips" hands
        are open, and what fp32 cannot hold of float64 values goes to the carries."""
        parts = list(snapshot.get("bodies", self._parts))
        n, values = sum(len(p.shape.vertices) for p in parts), []
        for name, low in (("x", "x_lo"), ("v", "v_lo")):
            value = np.asarray(snapshot[name])
            if value.shape != (n, 3) or not np.isfinite(value).all():
                raise BadInput(f"snapshot: {name} must be finite and of shape {(n, 3)}, not {value.shape}")
            high = value.astype(np.float32)
            values += [high, snapshot.get(low, value - high)]
        if parts != self._parts:
            self._load(Model(parts))
        if not editing:
            self._mending.hold(snapshot.get("mending", np.zeros((4, len(parts)))))
        self._write(values)
        self._rescue.run(1)
        self._driven.reset()
        self._forget(snapshot.get("grips", ()))
        self._transform.reset(held=editing)

    @property
    def parts(self) -> tuple[BodyModel, ...]:
        """The bodies that there are, with their shapes."""
        return tuple(self._parts)

    def reset(self, parts: tuple[BodyModel, ...] | None = None) -> None:
        """All bodies, or those that these `parts` were, back at their starts; grips and contacts are forgotten."""
        parts = self._parts if parts is None else list(parts)
        self._change(parts, [p.start for p in parts], [])
        self._mending.reset()

    def _forget(self, grips=None) -> None:
        """Contacts begin anew; hands hold `grips`, or what they hold now."""
        grips = self._grips() if grips is None else grips
        if self._movers is not None:
            self._fit()
        for c in self._constraints:
            c.reset()
        for c, held in zip(self._contacts, grips, strict=False):
            c.restore_grasps(held)
        self._substeps.reset()

    def _fit(self) -> None:
        """Let the rigid bodies be where their vertices are."""
        x, x_lo, v, v_lo = self._read(self.state.sizes.vertices).astype(np.float64)
        self._movers.fit(x + x_lo, v + v_lo)

    def _index(self, i: int) -> int:
        if not 0 <= i < len(self._parts):
            raise BadInput(f"there is no body {i}, of {len(self._parts)}")
        return int(i)

    def _motions(self) -> list[np.ndarray]:
        """x, x_lo, v, v_lo of each body now, (4, n, 3) float32."""
        values = self._read(self.state.sizes.vertices)
        return np.split(values, np.asarray(self.vertex_offset)[1:-1], axis=1)

    def _grips(self) -> list:
        return [c.grasps() for c in self._contacts]

    def _change(self, parts: list[BodyModel], motions: list[np.ndarray], grips: list) -> None:
        values = np.concatenate([np.zeros((4, 0, 3), np.float32), *motions], axis=1)
        state = dict(zip(("x", "x_lo", "v", "v_lo"), values, strict=True))
        self.restore({**state, "bodies": tuple(parts), "grips": tuple(grips)}, editing=True)
