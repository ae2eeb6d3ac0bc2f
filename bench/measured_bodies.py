"""Bodies of `bench scene` at any size: splats and implicit shapes, prepared once and kept without their Gaussians.

An asset file NAME_VERTICES.h5 a body, of about 0.8 MB for 20,000 vertices: cage, distance grid, and one Gaussian, since
an asset has one. What a solver measures depends on nothing else.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from assets.asset import Asset
from assets.file_access import make_folder
from assets.gaussians import Gaussians
from assets.splat_files import read_gaussians
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from prepare.cage.cage_generation import cage_of
from prepare.cage.component_cages import Grid
from prepare.cage.level_set import contact_grid
from prepare.pipeline import VERSION, Options, prepare

UNDER_SURFACE = (-1.5, -0.5)  # [grid cells] nodes at this distance must lie inside the cage
POINT = Gaussians.of(np.zeros((1, 3)), np.eye(4)[:1], np.full((1, 3), -5.0), np.zeros(1), np.zeros((1, 1, 3)))


def torus(p, centre, axis, major, minor):
    """Signed distance (...) of points (..., 3) to a torus about an axis (0, 1 or 2)."""
    d = p - np.asarray(centre)
    along = d[..., axis]
    across = np.sqrt(np.maximum((d**2).sum(-1) - along**2, 0))
    return np.hypot(across - major, along) - minor


def ellipsoid(p, centre, radii):
    """Not a distance, but zero on the ellipsoid and of slope about one there."""
    q, r = p - np.asarray(centre), np.asarray(radii)
    k0, k1 = np.linalg.norm(q / r, axis=-1), np.linalg.norm(q / r**2, axis=-1)
    return k0 * (k0 - 1) / np.maximum(k1, 1e-9)


def brick(p, centre, half):
    """Signed distance of a box."""
    q = np.abs(p - np.asarray(centre)) - np.asarray(half)
    return np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(-1), 0)


def capsule(p, a, b, radius):
    """Signed distance of a capsule."""
    a, b = np.asarray(a), np.asarray(b)
    t = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(p - a - t[..., None] * (b - a), axis=-1) - radius


def ball(p):
    """Signed distance of a ball of 24 cm."""
    return np.linalg.norm(p, axis=-1) - 0.12


def mug(p):
    """A mug of 12 cm with walls of 1 cm and a handle."""
    r, y = np.hypot(p[..., 0], p[..., 2]), p[..., 1]
    outer = np.maximum(r - 0.045, np.abs(y) - 0.06)
    inner = np.maximum(r - 0.035, -0.048 - y)
    handle = np.maximum(torus(p, (0.052, 0, 0), 2, 0.03, 0.007), 0.04 - r)
    return np.minimum(np.maximum(outer, -inner), handle)


def ring(p):
    """A thin ring that lies on a board of 22 cm."""
    return np.minimum(torus(p, (0, 0.0145, 0), 1, 0.07, 0.005), brick(p, (0, 0, 0), (0.11, 0.01, 0.11)))


def bunny(p):
    """A rabbit of 28 cm with thin ears."""
    body = np.minimum(ellipsoid(p, (0, 0, 0), (0.08, 0.075, 0.07)), ellipsoid(p, (0.05, 0.08, 0), (0.045,) * 3))
    ears = [ellipsoid(p, (0.04, 0.15, side * 0.025), (0.014, 0.055, 0.005)) for side in (-1, 1)]
    return np.minimum(body, np.minimum(*ears))


def slanted_capsule(p):
    """A capsule of 10 cm by 24 cm."""
    return capsule(p, (-0.07, 0, 0), (0.07, 0.03, 0), 0.05)


SHAPES = {  # signed distance, and half the side of a cube about the origin that holds the shape [m]
    "ball": (ball, 0.13),
    "mug": (mug, 0.1),
    "ring": (ring, 0.12),
    "bunny": (bunny, 0.22),
    "capsule": (slanted_capsule, 0.13),
}


def body_name(asset: str) -> str:
    """Name of an asset: a shape of SHAPES, a file's without its extension, or a body in the folder."""
    return asset if asset in SHAPES else Path(asset).stem


def stripped_body(asset: str, vertices: int, folder: Path) -> Asset:
    """The asset as a body of about this many vertices, from the folder, or made and kept there. Taichi must be running.

    asset  one of SHAPES, a splat file, or the name of a body that is in the folder; a prepared .h5 is taken as it is
    Raises BadInput where there is none, or no cage of this size.
    """
    made_by = f"vrgs prepare {VERSION}"
    if Path(asset).suffix == ".h5":
        return with_cage(Path(asset))
    path = folder / f"{body_name(asset)}_{vertices}.h5"
    if path.is_file():
        kept = with_cage(path)
        if kept.provenance.get("made_by") == made_by or not (asset in SHAPES or Path(asset).is_file()):
            return kept
    if asset in SHAPES:
        body = shape_body(asset, vertices)
    elif Path(asset).is_file():
        body = prepare(read_gaussians(Path(asset)), Options(vertices))
    else:
        raise BadInput(f"{asset}: neither a splat file nor a shape ({', '.join(SHAPES)}), and there is no {path}")
    kept = {"cage": body.cage, "sdf": body.sdf, "material": body.material}
    stripped = Asset(POINT, **kept, provenance={"made_by": made_by, "source": Path(asset).name})
    make_folder(folder)
    stripped.save(path)
    return stripped


def with_cage(path: Path) -> Asset:
    """The asset of a file that has a cage and a distance grid. Raises BadInput."""
    asset = Asset.load(path)
    if asset.cage is None or asset.sdf is None:
        raise BadInput(f"{path}: has no cage to simulate (make one: python vrgs.py prepare)")
    return asset


def shape_body(name: str, vertices: int) -> Asset:
    """A shape of SHAPES with a cage as `prepare` makes them, its lowest point at y = 0."""
    distance, reach = SHAPES[name]
    ends = np.array([[-reach] * 3, [reach] * 3])
    inside = np.argwhere(distance(ends[0] + 2 * reach / 96 * np.moveaxis(np.indices((97,) * 3), 0, -1)) < 0)
    grid = Grid.over(ends[0] + 2 * reach / 96 * inside, vertices)
    nodes = grid.origin + grid.spacing * np.moveaxis(np.indices(grid.shape), 0, -1)
    phi = (distance(nodes) / grid.spacing).astype(np.float32)
    near = np.argwhere((phi > UNDER_SURFACE[0]) & (phi < UNDER_SURFACE[1])).astype(np.float64)
    cage = cage_of(phi, near, vertices, lambda done: None)
    low = grid.origin.copy()
    low[1] -= (grid.origin + grid.spacing * cage.vertices)[:, 1].min()
    cage = replace(cage, vertices=(low + grid.spacing * cage.vertices).astype(np.float32))
    return Asset(POINT, cage, sdf=contact_grid([DistanceGrid(phi * grid.spacing, low, grid.spacing)]))
