"""Rollouts: candidates of one body, which differ in material and start, simulated side by side in one solver."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from core.errors import BadInput
from core.material import Material
from core.tetmesh import boundary_surface
from core.vocabulary import Plane
from sim.bodies import SoftBody
from sim.model import BodyModel
from sim.solver import Solver

FRAME = 1 / 60  # [s] longest step between two searches for contacts


@dataclass(frozen=True)
class Candidate:
    """A material, and positions [m] and velocities [m/s] at the start, (V, 3) each, in the world."""

    material: Material
    positions: np.ndarray
    velocities: np.ndarray


class Rollouts:
    """Up to `count` candidates at a time of a cage, which never meet; `held` vertices stay where they start.

    vertices, tets   of the cage [m], (V, 3), (T, 4);   held  vertices (H,)
    planes     (P, 4): normal n and offset d [m] of n x >= d; what touches one rubs at the friction of its own material
    apart      [m] from one candidate to the next where there are planes: longer than the body and its way
    substep    [s] of the integrator, None as the solver chooses. VBD's does not depend on the material unless that is
               very stiff: so a difference between two candidates is one of theirs, not of the method's
    """

    def __init__(
        self,
        vertices: np.ndarray,
        tets: np.ndarray,
        held: np.ndarray,
        count: int,
        *,
        planes: np.ndarray = np.zeros((0, 4)),
        gravity: Sequence[float] = (0.0, -9.81, 0.0),
        apart: float = 1.0,
        integrator: str = "vbd",
        substep: float | None = None,
    ):
        self.count, self.vertices = count, len(vertices)
        surface = boundary_surface(tets)
        self._body = SoftBody("candidate", vertices, tets, surface, Material(1e5, 0.3, 1e3))
        bodies = [replace(self._body, pinned=held) for _ in range(count)]
        self._held = BodyModel.of(bodies[0], [])
        self._free = BodyModel(self._body, self._held.shape)
        self._offsets = np.zeros((count, 1, 3))
        if len(planes):
            self._offsets[:, 0] = apart * np.arange(count)[:, None] * level_direction(planes, gravity)
        normals = np.asarray(planes, np.float64)[:, :3]
        floors = [Plane(tuple(n * d), tuple(n), friction=1.0) for n, d in zip(normals, planes[:, 3], strict=True)]
        self._solver = Solver(
            bodies,
            floors,
            gravity=gravity,
            contacts=bool(len(planes)),
            self_contact=False,
            hands=0,
            sleep=False,
            integrator=integrator,
            substep=substep,
        )

    def hold(self, held: np.ndarray) -> None:
        """Hold other vertices (H,) from the next run on."""
        self._held = BodyModel(replace(self._body, pinned=held), self._held.shape)

    def run(
        self,
        candidates: Sequence[Candidate],
        times: np.ndarray,
        observe: Callable[[np.ndarray], np.ndarray],
        release: float = math.inf,
    ) -> np.ndarray:
        """The results of `observe` for the positions (C, V, 3) [m] at each of the times (F,) [s], stacked: (F, C, ...).

        Pinned vertices are let go at `release` [s], counted as the times are.
        """
        if not 1 <= len(candidates) <= self.count:
            raise BadInput(f"{len(candidates)} candidates, where up to {self.count} fit")
        offsets = self._offsets[: len(candidates)]
        x, v = (np.stack([getattr(c, name) for c in candidates]) for name in ("positions", "velocities"))
        now, free = float(times[0]), release <= times[0]
        self._set(candidates, x + offsets, v, free)
        found = []
        for time in times:
            if now < release < time and not free:
                self._advance(release - now)
                now = release
            if now >= release and not free:
                free = True
                self._set(candidates, *self._motion(), free, self._solver.snapshot()["rest_inverse"])
            self._advance(time - now)
            now = float(time)
            found.append(observe(self._motion()[0] - offsets))
        return np.stack(found)

    def _set(self, candidates: Sequence[Candidate], x, v, free: bool, rest_inverse: np.ndarray | None = None) -> None:
        model = self._free if free else self._held
        models = [model.with_material(of_pair(c.material)) for c in candidates]
        held = (model.inv_mass == 0.0)[:, None]
        motion = {"x": x.reshape(-1, 3), "v": np.where(held, 0.0, v).reshape(-1, 3)}
        self._solver.restore({**motion, "bodies": models, "rest_inverse": rest_inverse})

    def _motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions [m] and velocities [m/s] (C, V, 3) float64."""
        q = self._solver.snapshot()
        x, v = (q[k].astype(np.float64) + q[f"{k}_lo"] for k in ("x", "v"))
        return x.reshape(-1, self.vertices, 3), v.reshape(-1, self.vertices, 3)

    def _advance(self, seconds: float) -> None:
        steps = math.ceil(seconds / FRAME - 1e-6)
        for _ in range(steps):
            self._solver.step(seconds / steps)

    def destroy(self) -> None:
        """Give the device memory back."""
        self._solver.destroy()


def of_pair(material: Material) -> Material:
    """The material that rubs at this one's friction against a plane of friction 1: contacts take the root of both."""
    return replace(material, friction=material.friction**2, kinetic_friction=material.sliding_friction**2)


def level_direction(planes: np.ndarray, gravity: Sequence[float]) -> np.ndarray:
    """Unit vector (3,) along all planes (P, 4), across gravity where one is. Raises BadInput if planes leave none."""
    normals = np.asarray(planes, np.float64)[:, :3]
    for rows in (np.vstack([normals, np.asarray(gravity, np.float64) / 9.81]), normals):
        direction = np.linalg.svd(rows)[2][-1]
        if np.abs(rows @ direction).max() < 1e-6:
            return direction
    raise BadInput("three planes that meet in a corner leave no room for candidates side by side")
