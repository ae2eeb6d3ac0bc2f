"""Edits of the set of simulated bodies, as functions from one set in motion to another (NumPy only).

Bodies keep their order and their indices stay compact. What is known of unchanged meshes is reused, and bodies that are
not edited keep their motion and the hands' grasps. All raise BadInput if a body cannot be simulated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from core.errors import BadInput
from core.material import Material
from core.rotation import best_fit_rotation, quaternions_from_matrices
from sim.bodies import SoftBody
from sim.hands.grasp import GraspState
from sim.model import BodyModel, body_index, motion


@dataclass(frozen=True)
class MovingBodies:
    """Bodies, their motions, and the hands' grasps of them.

    motions  x, x_lo, v, v_lo of each body, (4, V, 3) float32;   grasps  None without hands
    """

    models: tuple[BodyModel, ...]
    motions: tuple[np.ndarray, ...]
    grasps: GraspState | None

    @property
    def motion(self) -> np.ndarray:
        """x, x_lo, v, v_lo of all bodies, (4, V, 3)."""
        return np.concatenate([np.zeros((4, 0, 3), np.float32), *self.motions], axis=1)

    def with_body(self, model: BodyModel, motion: np.ndarray) -> MovingBodies:
        """Append a body."""
        return replace(self, models=(*self.models, model), motions=(*self.motions, motion))

    def with_changed(self, i: int, model: BodyModel, motion: np.ndarray, shift: np.ndarray) -> MovingBodies:
        """Replace body i; its vertices moved by `shift` (V, 3) [m], which the hands that hold it follow."""
        models, motions = list(self.models), list(self.motions)
        models[i], motions[i] = model, motion
        grasps = None if self.grasps is None else self.grasps.shifted(i, shift)
        return MovingBodies(tuple(models), tuple(motions), grasps)

    def motion_of(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        """Positions [m] and velocities [m/s] of body i, (V, 3) float64 each."""
        m = self.motions[i].astype(np.float64)
        return m[0] + m[1], m[2] + m[3]


def added(bodies: MovingBodies, body: SoftBody) -> MovingBodies:
    """Append a body at its start."""
    model = BodyModel.of(body, bodies.models)
    return bodies.with_body(model, model.start)


def removed(bodies: MovingBodies, i: int) -> MovingBodies:
    """Remove body i; a hand that holds it opens, and the later bodies move up by one."""
    i = body_index(i, len(bodies.models))
    kept = [k for k in range(len(bodies.models)) if k != i]
    new_index = [k - (k > i) if k != i else None for k in range(len(bodies.models))]
    grasps = None if bodies.grasps is None else bodies.grasps.renumbered(new_index)
    return MovingBodies(tuple(bodies.models[k] for k in kept), tuple(bodies.motions[k] for k in kept), grasps)


def duplicated(bodies: MovingBodies, i: int, offset) -> MovingBodies:
    """Append a copy of body i as it is deformed and moves now, at `offset` (3,) [m] from it.

    It starts, if it is reset, with the rotation nearest to its shape.
    """
    i = body_index(i, len(bodies.models))
    model, (x, v) = bodies.models[i], bodies.motion_of(i)
    rest, center = model.shape.vertices, model.shape.center
    c = np.average(x, axis=0, weights=model.mass)
    R = best_fit_rotation(((x - c) * model.mass[:, None]).T @ (rest - center))
    origin = c - R @ center
    position = origin + np.asarray(offset, np.float64)
    start = tuple(quaternions_from_matrices(R).tolist()), tuple(position.tolist())
    return bodies.with_body(model.placed(*start), motion((x - origin) + position, v))


def rescaled(bodies: MovingBodies, i: int, factor: float, *, about=None) -> MovingBodies:
    """Make body i `factor` times as large about its centre of mass, or a point; velocities stay."""
    i = body_index(i, len(bodies.models))
    model, (x, v) = bodies.models[i], bodies.motion_of(i)
    if not (np.isfinite(factor) and factor > 0.0):
        raise BadInput(f"{model.body.name}: cannot be scaled by {factor}")
    center = np.average(x, axis=0, weights=model.mass) if about is None else np.asarray(about, np.float64)
    shift = (factor - 1.0) * (x - center)
    moved = motion(x + shift, v)
    moved[3] = bodies.motions[i][3]
    return bodies.with_changed(i, model.scaled(factor), moved, shift)


def displaced(bodies: MovingBodies, i: int, matrix: np.ndarray, *, rest: bool = False) -> MovingBodies:
    """Move body i as it is by a rigid motion (4, 4) of the world; its velocities turn with it, or end with `rest`."""
    i, M = body_index(i, len(bodies.models)), np.asarray(matrix, np.float64)
    R, model = M[:3, :3], bodies.models[i]
    if M.shape != (4, 4) or not np.isfinite(M).all() or np.abs(R @ R.T - np.eye(3)).max() > 1e-6:
        raise BadInput(f"{model.body.name}: the matrix is not a rigid motion")
    x, v = bodies.motion_of(i)
    shift = x @ (R.T - np.eye(3)) + M[:3, 3]
    return bodies.with_changed(i, model, motion(x + shift, 0.0 * v if rest else v @ R.T), shift)


def with_material(bodies: MovingBodies, i: int, material: Material) -> MovingBodies:
    """Give body i another material."""
    models, i = list(bodies.models), body_index(i, len(bodies.models))
    models[i] = models[i].with_material(material)
    return replace(bodies, models=tuple(models))
