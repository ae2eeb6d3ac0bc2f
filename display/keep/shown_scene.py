"""A running scene as it is now, read from the device: its Gaussians as they are drawn, its bodies' cages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from assets.gaussians import Gaussians, axes_of, symmetric_matrices
from core.errors import BadInput
from core.rotation import best_fit_rotation, matrices_from_quaternions
from core.spherical_harmonics import C0, rotate_sh
from display.world import World
from sim.model import BodyModel

OPACITY_EDGE = 1e-7  # to 0 and 1: a logit is finite


def shown_gaussians(world: World, body: int | None, *, shadows: bool) -> Callable[[], Gaussians]:
    """Read the Gaussians of room and bodies as the last picture showed them, without hands; or those of a body.

    Returns what makes a splat of them. Raises BadInput.
    """
    device = world.device
    spans = [(0, device.still), (device.first, device.splats.count)]
    if body is not None:
        spans = [world.registry.gaussian_span(body)]
    return gaussians_of(world, spans, shadows=shadows)


def gaussians_of(world: World, spans: Sequence[tuple[int, int]], *, shadows: bool) -> Callable[[], Gaussians]:
    """As `shown_gaussians`, of these spans of the splats: axes from covariances, harmonics turned into the world.

    In shadow, v (1/2 + SH) = 1/2 + SH' with SH' = v SH + (v - 1) / 2 in degree 0.
    """
    device, splats = world.device, world.device.splats
    which = np.concatenate([np.arange(*span) for span in spans])
    if len(which) == 0:
        raise BadInput("there is nothing to export: the scene has no Gaussians")
    told = {"sort": device.trained_sort, "antialias": device.renderer.rasterizer.projection.antialias}
    all_opacities, all_harmonics, _ = splats.read(0, splats.count)
    opacities, harmonics = all_opacities[which].astype(np.float64), all_harmonics[which]
    fields = (splats.mean, splats.cov, splats.rotation, splats.visibility)
    mean, cov, rotation, visibility = (field.to_numpy()[which] for field in fields)

    def splat() -> Gaussians:
        quats, log_scales = axes_of(symmetric_matrices(cov))
        opacity, sh = np.clip(opacities, OPACITY_EDGE, 1 - OPACITY_EDGE), harmonics.copy()
        turned = (np.abs(rotation[:, 0]) < 1.0 - 1e-7) & (sh[:, 1:] != 0).any((1, 2))
        sh[turned] = rotate_sh(sh[turned], matrices_from_quaternions(rotation[turned]))
        if shadows:
            sh *= visibility[:, None, None]
            sh[:, 0] += (0.5 / C0) * (visibility[:, None] - 1.0)
        logits = np.log(opacity / (1 - opacity))
        return Gaussians.of(mean, quats, log_scales, logits, sh, **told)

    return splat


@dataclass(frozen=True)
class MovingBody:
    """A body as it is: its model, positions [m] and velocities [m/s] of its vertices, (V, 3) float64, and D_m^-1 of its
    tets [1/m], (T, 3, 3)."""

    model: BodyModel
    index: int
    x: np.ndarray
    v: np.ndarray
    rest_inverse: np.ndarray


def moving_bodies(world: World, body: int | None) -> list[MovingBody]:
    """All simulated bodies, or one."""
    solver = world.device.solver
    state, begin, rests = solver.snapshot(), solver.vertex_offset, solver.rest_inverses()
    x, v = (state[high].astype(np.float64) + state[low] for high, low in (("x", "x_lo"), ("v", "v_lo")))
    return [
        MovingBody(model, k, x[begin[k] : begin[k + 1]], v[begin[k] : begin[k + 1]], rests[k])
        for k, model in enumerate(solver.body_models)
        if body in (None, k)
    ]


def fitted_pose(body: MovingBody) -> tuple[np.ndarray, np.ndarray]:
    """Rotation R (3, 3) and t (3,) [m] with which R rest + t fits the body's vertices best, weighted by mass."""
    x, rest, weights = body.x, body.model.shape.vertices, body.model.mass
    centre, c = np.average(x, axis=0, weights=weights), np.average(rest, axis=0, weights=weights)
    R = best_fit_rotation(((x - centre) * weights[:, None]).T @ (rest - c))
    return R, centre - R @ c
