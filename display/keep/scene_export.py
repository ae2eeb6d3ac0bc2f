"""A running scene as files for other programs: its Gaussians as they are drawn now, its cages, its surfaces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from assets.formats.vtu import write_surfaces, write_vtu
from assets.gaussians import Gaussians, axes_of
from assets.splat_files import WRITERS, kind_to_write, write_gaussians
from core.errors import BadInput
from core.program import USD, check_usd
from core.rotation import best_fit_rotation, matrices_from_quaternions
from core.spherical_harmonics import C0, rotate_sh
from core.tetmesh import tet_volumes
from display.world import World
from sim.model import BodyModel
from sim.time_step import lame

OPACITY_EDGE = 1e-7  # to 0 and 1: a logit is finite
CAGES = {".vtu", ".obj"}


def export_suffix(path: str | Path) -> str:
    """Kind of file that a name asks for: a suffix of CAGES, or a key of WRITERS. Raises BadInput."""
    suffix = Path(path).suffix.lower()
    if suffix not in CAGES and suffix not in WRITERS:
        raise BadInput(f"{path}: cannot write {suffix!r}; written are {', '.join([*WRITERS, *sorted(CAGES)])}")
    return suffix if suffix in CAGES else kind_to_write(path)


def exporter(world: World, path: Path, *, body: int | None = None, shadows: bool = True) -> Callable[[], None]:
    """Read a world, as it is now, for a file of the kind of its name; returns what writes it.

    body     only this one; None: all, and where Gaussians are written the room too
    shadows  let their colours be as dark as they are shown

    Raises BadInput, now or when it is written.
    """
    suffix = path.suffix.lower()
    if body is not None and not 0 <= body < len(world.bodies()):
        raise BadInput(f"there is no body {body} to export")
    if suffix == ".html":
        from display.keep.played_page import PlayedPage

        page = PlayedPage(world, path.stem.replace("_", " "), body=body, shadows=shadows)
        page.take(0.0)
        return page.writer(path)
    if suffix in USD:
        check_usd(f"{path}: OpenUSD")
        from display.keep.usd_export import SceneStage

        return partial(SceneStage(world, body, shadows=shadows).write, path)
    suffix = export_suffix(path)
    if suffix in CAGES:
        bodies = moving_bodies(world, body)
        if not bodies:
            raise BadInput("there is nothing to export: the scene has no bodies with a cage")
        return lambda: write_cages(path, bodies, suffix)
    shown = shown_gaussians(world, body, shadows=shadows)
    return lambda: write_gaussians(path, shown())


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
        quats, log_scales = axes_of(cov[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3))
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
    """A body as it is: its model, and positions [m] and velocities [m/s] of its vertices, (V, 3) float64."""

    model: BodyModel
    index: int
    x: np.ndarray
    v: np.ndarray


def moving_bodies(world: World, body: int | None) -> list[MovingBody]:
    """All simulated bodies, or one."""
    solver = world.device.solver
    state, begin = solver.snapshot(), solver.vertex_offset
    x, v = (state[high].astype(np.float64) + state[low] for high, low in (("x", "x_lo"), ("v", "v_lo")))
    return [
        MovingBody(model, k, x[begin[k] : begin[k + 1]], v[begin[k] : begin[k + 1]])
        for k, model in enumerate(solver.body_models)
        if body in (None, k)
    ]


def write_cages(path: Path, bodies: Sequence[MovingBody], suffix: str) -> None:
    """Write the surfaces as .obj, or the tets as .vtu, with the fields of `cage_fields`. Raises BadInput."""
    if suffix == ".obj":
        write_surfaces(
            path, [(f"{Path(b.model.body.name).stem}_{b.index}", b.x, b.model.shape.surface) for b in bodies]
        )
        return
    first = np.cumsum([0, *(len(b.x) for b in bodies)])
    fields = [cage_fields(b) for b in bodies]
    point_fields, cell_fields = (
        {name: np.concatenate([f[kind][name] for f in fields]) for name in fields[0][kind]} for kind in (0, 1)
    )
    tets = np.concatenate([b.model.shape.solid + k for b, k in zip(bodies, first, strict=False)])
    points = np.concatenate([b.x for b in bodies])
    write_vtu(path, points, tets, point_fields=point_fields, cell_fields=cell_fields)


def cage_fields(body: MovingBody) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Fields of vertices and of tets.

    displacement  from the rest shape where it fits best [m];   velocity [m/s]
    body          index;   volume_ratio  J = det F, 1 at rest;   von_mises_stress  of the Cauchy stress [Pa], 0 if rigid
    """
    model, x, shape = body.model, body.x, body.model.shape
    rest, tets = shape.vertices, shape.solid
    R, t = fitted_pose(body)
    ratio = tet_volumes(x, tets) / tet_volumes(rest, tets)
    stress = np.zeros(len(tets))
    if not shape.rigid:
        edges = np.swapaxes(x[tets][:, 1:] - x[tets][:, :1], 1, 2)
        stress = von_mises(edges @ shape.inverse, *lame(model.material))
    points = {"displacement": x - (rest @ R.T + t), "velocity": body.v}
    return points, {"body": np.full(len(tets), body.index), "volume_ratio": ratio, "von_mises_stress": stress}


def fitted_pose(body: MovingBody) -> tuple[np.ndarray, np.ndarray]:
    """Rotation R (3, 3) and t (3,) [m] with which R rest + t fits the body's vertices best, weighted by mass."""
    x, rest, weights = body.x, body.model.shape.vertices, body.model.mass
    centre, c = np.average(x, axis=0, weights=weights), np.average(rest, axis=0, weights=weights)
    R = best_fit_rotation(((x - centre) * weights[:, None]).T @ (rest - c))
    return R, centre - R @ c


def von_mises(F: np.ndarray, mu: float, lam: float) -> np.ndarray:
    """Von Mises stress [Pa] of the Cauchy stress P F^T / J of deformation gradients F (T, 3, 3), (T,).

    P as in sim/elastic/energy.py.
    """
    J, I1 = np.linalg.det(F), (F**2).sum((1, 2))
    cofactor = np.cross(F[:, :, [1, 2, 0]], F[:, :, [2, 0, 1]], axis=1)
    P = (mu * (1 - 2 * np.maximum(1 - I1, 0)))[:, None, None] * F + (lam * (J - 1) - mu)[:, None, None] * cofactor
    sigma = P @ np.swapaxes(F, 1, 2) / np.where(np.abs(J) < 1e-6, 1e-6, J)[:, None, None]
    deviator = sigma - np.trace(sigma, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    return np.sqrt(1.5 * (deviator**2).sum((1, 2)))
