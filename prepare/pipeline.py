"""From the Gaussians of a capture to an asset that can be simulated (VR-GS, Sec. 4)."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np

from assets.asset import Asset, Cage, Embedded
from assets.errors import BadInput
from assets.gaussians import Gaussians
from assets.materials import DEFAULT, material_named
from assets.orient import guess_up, metres, rotation_to_up
from prepare.cage import ANGLE_MIN, INSIDE_MIN, TOLERANCE, check_count, share_inside
from prepare.checkpoints import Checkpoints, arrays_of, gaussians_of
from prepare.clean import FEWEST, clean
from prepare.fill import DENSE, density_of, solid_cells
from prepare.hosts import embed_on_device
from prepare.levelset import contact_grid, level_set, volume_of
from prepare.meshers import MESHERS, check_mesher, mesh
from prepare.progress import Progress
from prepare.quality import dihedral_angles, volumes
from prepare.report_pictures import Made

VERSION = 2  # of what this pipeline makes; raise it when the same splat would give another asset
NODES = 96  # of the grid on the longest side for 2,000 vertices: seven a lattice cell
NODES_RANGE = (64, 192)  # with the border below fill.CELLS_MAX
NODES_POWER = 0.2  # of the number of vertices; 1/3 would keep seven, but four are enough and memory is not
BORDER = 1 / 8  # of the grid, left free on each side for what closing and widening add
STRAY = 0.05  # of the extent: what lies this far off the surface belongs to another piece
OPAQUE = 0.5

STAGES = ("clean", "orient", "fill", "surface", "cage", "embed", "contact")


def prepare(
    gaussians: Gaussians,
    *,
    vertices: int = 2000,
    scale: float | None = None,
    up: str | None = None,
    material: str | None = None,
    mesher: str = "stuffing",
    adaptive: bool = True,
    progress: Progress | None = None,
    look: Callable[[Made], None] | None = None,
    say: Callable[[str], None] | None = None,
    kept: Checkpoints | None = None,
) -> Asset:
    """Make a splat simulatable: cage, embedding, distance grid, material. Taichi must be running.

    vertices  of the cage, hit within 15 %
    scale     largest extent [m]; None: the file's if a hand could hold that, else 0.25
    up        axis of the file that points up, "+x" to "-z"; None: guessed
    material  a name of assets.materials; None: plush
    mesher    a name of MESHERS; stuffing makes the cage where another cannot, and `say` is told why
    adaptive  smaller tets where the shape is thin or curved, larger ones deep inside; False: all alike
    progress  called with a stage of STAGES and the share of it that is done
    kept      what finished stages of a run that was stopped made
    look      called with what the stages before the cage made
    Out.      the asset: +y up, centred in x and z, its lowest point at y = 0; provenance["figures"] tells its quality
    Raises    BadInput where the splat holds no solid object or no good cage was found.
    """
    begin = time.perf_counter()
    report = progress or (lambda stage, done: None)
    properties = material_named(material or DEFAULT)
    check_count(vertices)
    check_mesher(mesher)
    metres(1.0, scale)
    if up is not None:
        rotation_to_up(up)

    kept = kept or Checkpoints()
    guessed = up is None

    def cleaned() -> dict:
        report("clean", 0.0)
        g, counts = clean(gaussians)
        report("orient", 0.0)
        axis = guess_up(g) if guessed else up
        return arrays_of(g.transformed(rotation_to_up(axis)), counts=counts, up=axis)

    g, found = gaussians_of(kept.stage("orient", cleaned))
    counts, up = found["counts"], found["up"]

    seen = g.means[opaque(g)].astype(np.float64)
    low, high = seen.min(0), seen.max(0)
    nodes = int(np.clip(NODES * (vertices / 2000) ** NODES_POWER, *NODES_RANGE))
    spacing = float((high - low).max()) / nodes
    origin = low - BORDER * nodes * spacing
    shape = tuple(int(k) for k in np.ceil((high - low) / spacing + 2 * BORDER * nodes) + 1)

    def filled() -> dict:
        report("fill", 0.0)
        density = density_of(g, origin, spacing, shape)
        return {"solid": solid_cells(density), "shell": density > DENSE}

    cells = kept.stage("fill", filled)

    def surfaced() -> dict:
        report("surface", 0.0)
        return {"phi": level_set(cells["solid"])}

    phi = kept.stage("surface", surfaced)["phi"]
    inside = np.argwhere(phi < 0)
    longest = spacing * float((np.ptp(inside, axis=0) + 1).max())
    g = g.select(near(phi, (g.means - origin) / spacing, STRAY * nodes))
    counts |= {"stray": counts["kept"] - len(g), "kept": len(g)}

    points = (g.means[opaque(g)].astype(np.float64) - origin) / spacing

    def meshed() -> dict:
        report("cage", 0.0)
        share = partial(report, "cage")
        cage, used = mesh(mesher, phi, points, vertices, share, adaptive=adaptive, say=say)
        return {**vars(cage), "tetgen": np.array(used == "tetgen")}

    found = kept.stage("cage", meshed)
    cage, used = Cage(found["vertices"], found["tets"], found["surface"]), MESHERS[int(found["tetgen"])]
    if used != mesher and say and "cage" in kept.resumed:
        say(f"{mesher} failed in the run before; the cage was made by {used} instead")
    size = metres(longest, scale)
    factor = size / longest
    middle = (cage.vertices.min(0) + cage.vertices.max(0)) / 2
    foot = np.array([middle[0], cage.vertices[:, 1].min(), middle[2]], np.float64)  # grid cells
    cage = Cage(((cage.vertices - foot) * spacing * factor).astype(np.float32), cage.tets, cage.surface)
    moved = -factor * (origin + spacing * foot)
    g = g.transformed(np.eye(3), moved, factor)

    def placed() -> dict:
        report("embed", 0.0)
        return vars(embed_on_device(g.means, g.quats, np.exp(g.log_scales), cage.vertices, cage.tets))

    embedded = Embedded(**kept.stage("embed", placed))

    report("contact", 0.0)
    grid = contact_grid(phi * (spacing * factor), -foot * spacing * factor, spacing * factor)
    figures = measure(cage, g.means[opaque(g)], vertices)
    figures["mesher"] = used
    figures["filled"] = volume_of(phi) * (spacing * factor) ** 3
    figures["seconds"] = round(time.perf_counter() - begin, 2)
    provenance = {
        "made_by": f"vrgs prepare {VERSION}",
        "options": {"vertices": vertices, "scale": scale, "up": None if guessed else up, "material": material}
        | ({} if mesher == "stuffing" else {"mesher": mesher}),
        "up": up,
        "size": size,
        "metres_per_unit": factor,
        "moved": moved.tolist(),  # [m], after the turn to +y and the scaling
        "counts": counts,
        "figures": figures,
    }
    if look:
        size_of_cell = spacing * factor
        look(Made(cells["shell"], cells["solid"], phi * size_of_cell, -foot * size_of_cell, size_of_cell))
    report("contact", 1.0)
    return Asset(g, cage, embedded, grid, properties, provenance)


def opaque(g: Gaussians) -> np.ndarray:
    """Mask (N,) of the Gaussians that make up the surface: opacity above a half; all of them in a faint splat."""
    mask = g.opacities > OPAQUE
    return mask if mask.sum() >= FEWEST else np.ones(len(g), bool)


def near(phi: np.ndarray, points: np.ndarray, reach: float) -> np.ndarray:
    """Mask (N,) of points (N, 3) whose grid node has phi below `reach`; all in grid cells."""
    node = np.rint(points.clip(-1e9, 1e9)).astype(np.int64)
    within = ((node >= 0) & (node < phi.shape)).all(1)
    mask = np.zeros(len(points), bool)
    mask[within] = phi[tuple(node[within].T)] < reach
    return mask


def measure(cage: Cage, surface_points: np.ndarray, wanted: int) -> dict:
    """The cage's figures. Raises BadInput, naming the figure, if it must not be simulated.

    surface_points  centres of the opaque Gaussians (N, 3) [m]
    """
    volume = volumes(cage.vertices, cage.tets)
    figures = {
        "vertices": len(cage.vertices),
        "tets": len(cage.tets),
        "min_dihedral": round(float(dihedral_angles(cage.vertices, cage.tets).min()), 2),
        "inside": round(share_inside(cage, surface_points), 5),
        "volume": float(volume.sum()),
    }
    if not (volume > 0).all():
        raise BadInput(f"the cage is not sound: {int((volume <= 0).sum())} tets have no positive volume")
    if figures["min_dihedral"] < ANGLE_MIN:
        raise BadInput(f"the cage is not sound: its smallest dihedral angle is {figures['min_dihedral']} degrees")
    if figures["inside"] < INSIDE_MIN:
        raise BadInput(f"the cage holds only {figures['inside']:.1%} of the opaque Gaussians; ask for more vertices")
    if abs(len(cage.vertices) - wanted) > TOLERANCE * wanted:
        raise BadInput(f"the cage has {len(cage.vertices)} vertices, {wanted} were asked for")
    return figures
