"""From the Gaussians of a capture to an asset that can be simulated (VR-GS, Sec. 4)."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np

from assets.asset import SIZE_RANGE, Asset, Cage, CageEmbedding
from assets.gaussians import Gaussians
from assets.orientation import FRONT_SURE, front_of, most_likely, rotation_to_up, turned_about_up, up_probabilities
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.material import DEFAULT_MATERIAL, Material
from core.tetmesh import tet_volumes
from prepare.cage.cage_generation import (
    ANGLE_MIN,
    INSIDE_MIN,
    VERTEX_RANGE,
    VERTEX_TOLERANCE,
    NoSoundCage,
    check_count,
)
from prepare.cage.component_cages import (
    MIN_COMPONENT,
    Component,
    ComponentCage,
    Grid,
    check_mesher,
    cluster_grids,
    component_cages,
    components_of,
    embedded_in,
    extent_of,
    joined_cage,
    surface_mask,
)
from prepare.cage.embedding_hosts import fraction_inside
from prepare.cage.level_set import (
    DENSE,
    ComponentSolid,
    contact_grid,
    density_of,
    level_sets,
    solid_cells,
    volume_of,
)
from prepare.cage.mesh_quality import smallest_angle
from prepare.cleaning import clean, clean_components
from prepare.progress import Checkpoints, Progress, arrays_of, gaussians_of, no_progress
from prepare.standing import flap_of, suitable_material

VERSION = 10  # of the pipeline's results; raise it when the same splat would give another asset

PLAUSIBLE_SIZE = (0.05, 0.6)  # [m] largest extent of objects for the hand; beyond, units are arbitrary
DEFAULT_SIZE = 0.25  # [m]

# Of a cage from elsewhere: flatter tets are noise in float32, and a cage that holds less is not one of this splat
GIVEN_ANGLE_MIN, GIVEN_INSIDE_MIN = 2.0, 0.8  # [degrees], of the opaque Gaussians

STEPS = ("clean", "orient", "fill", "surface", "cage", "embed", "contact")
Made = TypeVar("Made")


@dataclass(frozen=True)
class Options:
    """Options of a preparation.

    vertices  of the cage, met within 15 %
    scale     largest extent [m]; None: the file's if a hand could hold that, else 0.25
    up        axis of the file that points up, "+x" to "-z"; None: guessed
    material  a name of core.material; None: plush, stiffened where the shape needs it (prepare/standing.py)
    mesher    a name of component_cages.MESHERS; stuffing makes the cage where another fails
    adaptive  smaller tets where the shape is thin or curved, larger ones deep inside; False: all alike
    pieces    a cage for each connected component of the splat, all in one asset; False: the largest alone
    metres    the splat is in metres and keeps its size; then `scale` is None
    front     turn about the vertical [degrees] once it is upright; None: its front comes to +z if the guess is sure
    """

    vertices: int = 2000
    scale: float | None = None
    up: str | None = None
    material: str | None = None
    mesher: str = "stuffing"
    adaptive: bool = True
    pieces: bool = False
    metres: bool = False
    front: float | None = 0.0

    def check(self) -> None:
        """Raise BadInput for a value that cannot be used."""
        Material.named(self.material or DEFAULT_MATERIAL)
        check_count(self.vertices)
        check_mesher(self.mesher)
        if self.metres and self.scale is not None:
            raise BadInput("a splat in metres has its size already")
        body_size(1.0, self.scale)
        if self.up is not None:
            rotation_to_up(self.up)

    def provenance(self) -> dict:
        """The options as an asset records them: the first four, and what differs from the defaults."""
        found = {"vertices": self.vertices, "scale": self.scale, "up": self.up, "material": self.material}
        found |= {} if self.mesher == "stuffing" else {"mesher": self.mesher}
        found |= {} if self.adaptive else {"cells": "uniform"}
        found |= {"pieces": True} if self.pieces else {}
        found |= {"front": self.front} if self.front is not None and self.front != 0.0 else {}
        return found | ({"metres": True} if self.metres else {})


def prepare(
    gaussians: Gaussians,
    options: Options | None = None,
    *,
    given: Cage | None = None,
    progress: Progress = no_progress,
    look: Callable[[ComponentSolid], None] | None = None,
    say: Callable[[str], None] | None = None,
    checkpoints: Checkpoints | None = None,
) -> Asset:
    """Make a splat simulatable: cage, embedding, distance grid, material. Taichi must be running.

    given        a cage in the splat's coordinates to take instead of making one
    look         called for each component with the solid its cage was made from
    say          told why a mesher was replaced
    checkpoints  results of finished steps of a run that was stopped
    Out.         the asset: +y up, centred in x and z, its lowest point at y = 0; its figures are in the provenance
    Raises BadInput where the splat holds no solid object or no good cage was found.
    """
    begin = time.perf_counter()
    options, kept = options or Options(), checkpoints or Checkpoints()
    if given is not None:
        options = replace(options, vertices=int(np.clip(len(given.vertices), *VERTEX_RANGE)), pieces=False)
    options.check()
    oriented = kept.step("orient", partial(clean_and_orient, gaussians, options, progress))
    g, found = gaussians_of(oriented)
    components = fill_components(g, oriented["cluster"], options, progress, kept)
    if given is not None:
        x = given.vertices.astype(np.float64) @ np.array(found["rotation"]).T
        cages = [ComponentCage(components[0], Cage(x, given.tets, given.surface), "given")]
    else:
        cages = component_cages(
            components,
            g,
            options.vertices,
            options.mesher,
            partial(progress, "cage"),
            adaptive=options.adaptive,
            say=say,
            checkpoint=kept.step,
        )
    used = " and ".join(sorted({c.mesher for c in cages}))
    if given is None and used != options.mesher and say and "cage" in kept.resumed:
        say(f"{options.mesher} failed in the run before; the cage was made by {used} instead")

    counts = found["counts"]
    if options.pieces:
        counts["specks"] += len(components) - len(cages)
    own = np.concatenate([c.component.indices for c in cages])
    flap = np.concatenate([c.component.in_flap(g.select(c.component.indices)) for c in cages])
    counts |= {"stray": counts["kept"] - len(own), "kept": len(own), "flap": int(flap.sum())}
    longest, foot = extent_of(cages)
    size = body_size(longest, longest if options.metres else options.scale)
    factor = size / longest
    cage, first = joined_cage(cages, lambda x: (x - foot) * factor)
    g = g.select(own).transformed(np.eye(3), -factor * foot, factor)

    def embed() -> dict:
        progress("embed", 0.0)
        return vars(embedded_in(cage, first, g, [len(c.component.indices) for c in cages]))

    embedded = CageEmbedding(**kept.step("embed", embed))

    progress("contact", 0.0)
    solids = [solid_of(c.component, foot, factor) for c in cages]
    grid = contact_grid([s.distance for s in solids])
    figures = measure(cage, g.means[surface_mask(g) & ~flap], options.vertices, given=given is not None)
    figures |= {
        "mesher": used,
        "pieces": len(cages),
        "cells": "given" if given is not None else "adaptive" if options.adaptive and used != "tetgen" else "uniform",
        "filled": sum(volume_of(c.component.phi) * (c.component.grid.spacing * factor) ** 3 for c in cages),  # [m^3]
        "seconds": round(time.perf_counter() - begin, 2),
    }
    provenance = {
        "made_by": f"vrgs prepare {VERSION}",
        "options": options.provenance(),
        "up": found["up"],
        "up_sure": round(found["sure"], 2),
        "up_probabilities": {up: round(p, 3) for up, p in found["chances"].items()},
        "size": size,
        "metres_per_unit": factor,
        "moved": (-factor * foot).tolist(),  # [m], after the rotation to +y and the scaling
        "counts": counts,
        "figures": figures,
    } | ({"front": found["front"]} if found["front"] else {})
    if options.material is None:
        material, provenance["material"] = suitable_material(cage.vertices, cage.tets)
    else:
        material = Material.named(options.material)
    for solid in solids if look else ():
        look(solid)
    progress("contact", 1.0)
    return Asset(g, cage, embedded, grid, material, provenance)


def of_first_sound_cage(counts: Sequence[int], make: Callable[[int], Made], say: Callable[[str], None]) -> Made:
    """`make` of the first number of vertices with which the shape has a sound cage. Raises BadInput if none does."""
    for count, following in zip(counts, [*counts[1:], None], strict=True):
        try:
            return make(count)
        except NoSoundCage as e:
            if following is None:
                raise BadInput(f"{e}; --vertices N makes a finer cage") from e
            say(f"{e}; trying {following} vertices")
    raise ValueError("no number of vertices is given")


def body_size(longest: float, scale: float | None) -> float:
    """Size [m] of an object whose largest extent in the file is `longest`: `scale` if given, else that if plausible."""
    if scale is None:
        return longest if PLAUSIBLE_SIZE[0] <= longest <= PLAUSIBLE_SIZE[1] else DEFAULT_SIZE
    if not SIZE_RANGE[0] <= scale <= SIZE_RANGE[1]:
        raise BadInput(f"a size of {scale:g} m is out of range ({SIZE_RANGE[0]} to {SIZE_RANGE[1]:g})")
    return float(scale)


def clean_and_orient(gaussians: Gaussians, options: Options, progress: Progress) -> dict[str, np.ndarray]:
    """The object's own Gaussians rotated to +y up, as arrays; `cluster` is the connected component of each (N,), and
    `rotation` (3, 3) what has turned them."""
    progress("clean", 0.0)
    if options.pieces:
        g, cluster, counts = clean_components(gaussians)
    else:
        g, counts = clean(gaussians)
        cluster = np.zeros(len(g), int)
    progress("orient", 0.0)
    chances = up_probabilities(g) if options.up is None else {options.up: 1.0}
    up, sure = most_likely(chances)
    upright = rotation_to_up(up)
    g, front = g.transformed(upright), {}
    angle = -np.radians(options.front or 0.0)
    if options.front is None:
        angle, front_sure = front_of(g)
        front = {
            "angle": round(float(np.degrees(angle)), 1),
            "sure": round(front_sure, 2),
            "turned": front_sure >= FRONT_SURE,
        }
        angle = angle if front["turned"] else 0.0
    turned = turned_about_up(-angle)
    g, rotation = g.transformed(turned), (turned @ upright).tolist()
    about = {"counts": counts, "up": up, "sure": sure, "chances": chances, "front": front, "rotation": rotation}
    return arrays_of(g, **about) | {"cluster": cluster}


def fill_components(
    g: Gaussians, cluster: np.ndarray, options: Options, progress: Progress, kept: Checkpoints
) -> list[Component]:
    """Fill each cluster of Gaussians, given by number (N,), and split what is solid into connected components."""
    clusters = [np.flatnonzero(cluster == k) for k in range(int(cluster.max()) + 1)]
    grids = cluster_grids(g, clusters, options.vertices)

    def of_each_cluster(step: str, make: Callable[[int], dict]) -> list[dict]:
        def one(k: int) -> dict:
            progress(step, k / len(grids))
            return make(k)

        return [kept.step(f"{step}{k or ''}", partial(one, k)) for k in range(len(grids))]

    least = MIN_COMPONENT if options.pieces else 1.0
    cells = of_each_cluster("fill", lambda k: fill(g.select(clusters[k]), grids[k]))
    shapes = of_each_cluster("surface", lambda k: {"phi": level_sets(cells[k]["solid"], least)})
    found = zip(clusters, grids, cells, shapes, strict=True)
    return [c for own, grid, filled, shape in found for c in components_of(g, own, grid, filled, shape["phi"])]


def fill(g: Gaussians, grid: Grid) -> dict[str, np.ndarray]:
    """Cells (X, Y, Z) bool of a cluster: the dense `shell`, the `solid` that it encloses with it, both without a `flap`
    that would carry it."""
    density = density_of(g, grid.origin, grid.spacing, grid.shape)
    solid = solid_cells(density)
    flap = flap_of(solid)
    return {"solid": solid & ~flap, "shell": (density > DENSE) & ~flap, "flap": flap}


def solid_of(component: Component, foot: np.ndarray, factor: float) -> ComponentSolid:
    """The component's solid in the asset's frame."""
    grid, cells = component.grid, component.cells
    spacing = grid.spacing * factor
    distance = DistanceGrid(component.phi * spacing, (grid.origin - foot) * factor, spacing)
    return ComponentSolid(cells["shell"], cells["solid"], distance)


def measure(cage: Cage, surface_points: np.ndarray, wanted: int, *, given: bool = False) -> dict:
    """Figures of the cage. Raises NoSoundCage, naming the figure, if it must not be simulated.

    surface_points  centres of the opaque Gaussians that the cage should hold (N, 3) [m]
    given           it was not made here: it may be coarser, with any number of vertices
    """
    least_angle, least_inside = (GIVEN_ANGLE_MIN, GIVEN_INSIDE_MIN) if given else (ANGLE_MIN, INSIDE_MIN)
    volume, count = tet_volumes(cage.vertices, cage.tets), len(cage.vertices)
    angle = round(smallest_angle(cage.vertices, cage.tets), 2)
    inside = round(fraction_inside(cage.vertices, cage.tets, surface_points), 5)
    if not (volume > 0).all():
        raise NoSoundCage(f"the cage is not sound: {int((volume <= 0).sum())} tets have no positive volume")
    if angle < least_angle:
        raise NoSoundCage(f"the cage is not sound: its smallest dihedral angle is {angle} degrees")
    if inside < least_inside:
        hint = ": does it have the splat's coordinates?" if given else f" of {wanted} vertices"
        raise NoSoundCage(f"only {inside:.2%} of the opaque Gaussians are inside the cage{hint}")
    if not given and abs(count - wanted) > VERTEX_TOLERANCE * wanted:
        raise NoSoundCage(f"the cage has {count} vertices, {wanted} were asked for")
    tets = len(cage.tets)
    return {"vertices": count, "tets": tets, "min_dihedral": angle, "inside": inside, "volume": float(volume.sum())}
