"""A running scene, as it is now, as a file for other programs: Gaussians, a page, OpenUSD, cages or surfaces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from assets.formats.vtu import write_surfaces, write_vtu
from assets.splat_files import WRITERS, kind_to_write, write_gaussians
from core.errors import BadInput
from core.program import USD, check_usd
from core.tetmesh import tet_volumes
from display.keep.played_page import PlayedPage
from display.keep.shown_scene import MovingBody, fitted_pose, moving_bodies, shown_gaussians
from display.world import World
from sim.time_step import lame

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
        page = PlayedPage(world, path.stem.replace("_", " "), body=body, shadows=shadows)
        page.take(0.0)
        return page.writer(path)
    if suffix in USD:
        check_usd(f"{path}: OpenUSD")
        from display.keep.usd_export import SceneStage  # its package may be missing

        return partial(SceneStage(world, body, shadows=shadows).write, path)
    suffix = export_suffix(path)
    if suffix in CAGES:
        bodies = moving_bodies(world, body)
        if not bodies:
            raise BadInput("there is nothing to export: the scene has no bodies with a cage")
        return lambda: write_cages(path, bodies, suffix)
    shown = shown_gaussians(world, body, shadows=shadows)
    return lambda: write_gaussians(path, shown())


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
        stress = von_mises(edges @ body.rest_inverse, *lame(model.material))
    points = {"displacement": x - (rest @ R.T + t), "velocity": body.v}
    return points, {"body": np.full(len(tets), body.index), "volume_ratio": ratio, "von_mises_stress": stress}


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
