"""From the Gaussians of a capture to an asset that can be simulated (VR-GS, Sec. 4)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from assets.asset import Asset, Cage, CageEmbedding
from assets.gaussians import Gaussians
from assets.up_axis import body_size, guess_up_axis, rotation_to_up
from core.errors import BadInput
from core.material import DEFAULT_MATERIAL, Material
from core.tetmesh import tet_volumes
from prepare.cage.cage import ANGLE_MIN, INSIDE_MIN, TOLERANCE, check_count, share_inside
from prepare.cage.component_cages import (
    LEAST,
    Grid,
    cages_of,
    embedded_in,
    extent_of,
    grids_of,
    joined,
    members,
    mesher_of,
    opaque,
    parts_of,
)
from prepare.cage.filling import DENSE, density_of, solid_cells
from prepare.cage.level_set import contact_grid, level_sets, volume_of
from prepare.cage.mesh_quality import smallest_angle
from prepare.cage.meshers import check_mesher
from prepare.checkpoints import Checkpoints, arrays_of, gaussians_of
from prepare.cleaning import clean, clean_pieces
from prepare.progress import Progress
from prepare.report_pictures import Made

VERSION = 4  # of what this pipeline makes; raise it when the same splat would give another asset

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
    pieces: bool = False,
    progress: Progress | None = None,
    look: Callable[[Made], None] | None = None,
    say: Callable[[str], None] | None = None,
    kept: Checkpoints | None = None,
) -> Asset:
    """Make a splat simulatable: cage, embedding, distance grid, material. Taichi must be running.

    vertices  of the cage, hit within 15 %
    scale     largest extent [m]; None: the file's if a hand could hold that, else 0.25
    up        axis of the file that points up, "+x" to "-z"; None: guessed
    material  a name of core.material; None: plush
    mesher    a name of MESHERS; stuffing makes the cage where another cannot, and `say` is told why
    adaptive  smaller tets where the shape is thin or curved, larger ones deep inside; False: all alike
    pieces    a cage for each piece of the splat, all in one asset; False: the largest alone
    progress  called with a stage of STAGES and the share of it that is done
    kept      what finished stages of a run that was stopped made
    look      called for each piece with what the stages before its cage made
    Out.      the asset: +y up, centred in x and z, its lowest point at y = 0; provenance["figures"] tells its quality
    Raises    BadInput where the splat holds no solid object or no good cage was found.
    """
    begin = time.perf_counter()
    report = progress or (lambda stage, done: None)
    elastic = Material.named(material or DEFAULT_MATERIAL)
    check_count(vertices)
    check_mesher(mesher)
    body_size(1.0, scale)
    if up is not None:
        rotation_to_up(up)

    kept = kept or Checkpoints()
    guessed = up is None

    def cleaned() -> dict:
        report("clean", 0.0)
        if pieces:
            g, number, counts = clean_pieces(gaussians)
        else:
            g, counts = clean(gaussians)
            number = np.zeros(len(g), int)
        report("orient", 0.0)
        axis, sure = guess_up_axis(g) if guessed else (up, 1.0)
        return arrays_of(g.transformed(rotation_to_up(axis)), counts=counts, up=axis, sure=sure) | {"cluster": number}

    arrays = kept.stage("orient", cleaned)
    cluster = arrays["cluster"]
    g, found = gaussians_of(arrays)
    counts, up = found["counts"], found["up"]
    grids, clusters = grids_of(g, cluster, vertices), members(cluster)

    def filled(mine: np.ndarray, grid: Grid) -> dict:
        density = density_of(g.select(mine), grid.origin, grid.spacing, grid.shape)
        return {"solid": solid_cells(density), "shell": density > DENSE}

    def staged(stage: str, make: Callable[[int], dict]) -> list[dict]:
        """What a stage makes of each cluster."""
        made = []
        for k in range(len(grids)):

            def one(k=k) -> dict:
                report(stage, k / len(grids))
                return make(k)

            made.append(kept.stage(f"{stage}{k or ''}", one))
        return made

    cells = staged("fill", lambda k: filled(clusters[k], grids[k]))
    least = LEAST if pieces else 1.0
    shapes = staged("surface", lambda k: {"phi": level_sets(cells[k]["solid"], least)})
    parts = [
        replace(part, cluster=k)
        for k, (mine, grid, shape) in enumerate(zip(clusters, grids, shapes, strict=True))
        for part in parts_of(g, mine, grid, shape["phi"])
    ]

    how = {"adaptive": adaptive, "say": say, "kept": kept.stage}
    caged = cages_of(parts, g, vertices, mesher, partial(report, "cage"), **how)
    used = mesher_of(caged)
    if used != mesher and say and "cage" in kept.resumed:
        say(f"{mesher} failed in the run before; the cage was made by {used} instead")

    if pieces:
        counts["specks"] += len(parts) - len(caged)
    mine = np.concatenate([c.part.mine for c in caged])
    counts |= {"stray": counts["kept"] - len(mine), "kept": len(mine)}
    longest, foot = extent_of(caged)
    size = body_size(longest, scale)
    factor = size / longest
    cage, first = joined(caged, lambda x: (x - foot) * factor)
    g = g.select(mine).transformed(np.eye(3), -factor * foot, factor)

    def placed() -> dict:
        report("embed", 0.0)
        return vars(embedded_in(cage, first, g, [len(c.part.mine) for c in caged]))

    embedded = CageEmbedding(**kept.stage("embed", placed))

    report("contact", 0.0)
    made = [
        Made(
            cells[p.cluster]["shell"],
            cells[p.cluster]["solid"],
            p.phi * (p.grid.spacing * factor),
            (p.grid.origin - foot) * factor,
            p.grid.spacing * factor,
        )
        for p in (c.part for c in caged)
    ]
    grid = contact_grid([(m.phi, m.origin, m.spacing) for m in made])
    figures = measure(cage, g.means[opaque(g)], vertices)
    figures["mesher"] = used
    figures["pieces"] = len(caged)
    figures["cells"] = "adaptive" if adaptive and used != "tetgen" else "uniform"
    figures["filled"] = sum(volume_of(c.part.phi) * (c.part.grid.spacing * factor) ** 3 for c in caged)
    figures["seconds"] = round(time.perf_counter() - begin, 2)
    provenance = {
        "made_by": f"vrgs prepare {VERSION}",
        "options": {"vertices": vertices, "scale": scale, "up": None if guessed else up, "material": material}
        | ({} if mesher == "stuffing" else {"mesher": mesher})
        | ({} if adaptive else {"cells": "uniform"})
        | ({"pieces": True} if pieces else {}),
        "up": up,
        "up_sure": round(found["sure"], 2),
        "size": size,
        "metres_per_unit": factor,
        "moved": (-factor * foot).tolist(),  # [m], after the turn to +y and the scaling
        "counts": counts,
        "figures": figures,
    }
    for m in made if look else ():
        look(m)
    report("contact", 1.0)
    return Asset(g, cage, embedded, grid, elastic, provenance)


def measure(cage: Cage, surface_points: np.ndarray, wanted: int) -> dict:
    """The cage's figures. Raises BadInput, naming the figure, if it must not be simulated.

    surface_points  centres of the opaque Gaussians (N, 3) [m]
    """
    volume = tet_volumes(cage.vertices, cage.tets)
    figures = {
        "vertices": len(cage.vertices),
        "tets": len(cage.tets),
        "min_dihedral": round(smallest_angle(cage.vertices, cage.tets), 2),
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
