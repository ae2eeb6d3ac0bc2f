"""Objects of a captured room as bodies: the support of each, its cage, and its place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from assets.asset import Asset, Cage
from assets.gaussians import Gaussians, robust_bounds
from assets.room_folder import RoomObject
from core.errors import BadInput
from core.material import DEFAULT_MATERIAL, MATERIALS, Material
from core.rotation import quaternions_from_matrices, rotation_between
from prepare.cage.cage_generation import NoSoundCage
from prepare.own_weight import bent_by_weight
from prepare.pipeline import Options, prepare
from prepare.progress import Progress, no_progress

SOLID = 0.3  # opacity from which a Gaussian can touch
TOUCH = 0.06  # object sizes: a gap up to this is contact
NEIGHBOURS = 6  # nearest Gaussians of the rest tested for each of the object's
TOUCHES_MIN = 4  # Gaussians in contact; with fewer the object touches nothing
BASE = 0.2  # fraction of an object's height that counts as its foot
MASS_MAX = 3.0  # [kg] of an object without a named material: half of what a hand of 80 N can lift
NOD = 0.003  # object sizes by which its own weight may displace any part; the photographs already show it sagged
HELD = 0.15, 0.45  # least and most of a hanging object, from its support on, that is fixed; fractions of its extent


@dataclass(frozen=True)
class Support:
    """Support of an object: `direction` (3,) leads from there to the object; it stands if that is up.

    level  median of where the object touches it, along the direction [m]
    """

    direction: np.ndarray
    stands: bool
    level: float = 0.0


def support_of(thing: Gaussians, rest: Gaussians) -> Support:
    """The part of the rest of a room [m], +y up, that holds an object.

    It stands if its contacts near the foot surround its centre, as those of a base do; else it hangs, as a trophy on a
    wall does. Raises BadInput if it touches nothing.
    """
    thing, rest = thing.select(thing.opacities > SOLID), rest.select(rest.opacities > SOLID)
    own, others = thing.means.astype(np.float64), rest.means.astype(np.float64)
    low, high = robust_bounds(own)
    size, touch = float((high - low).max()), np.zeros(0, int)
    if len(others):
        away, at = cKDTree(others).query(own, k=min(NEIGHBOURS, len(others)))
        away, at = away.reshape(len(own), -1), at.reshape(len(own), -1)
        reach = TOUCH * size + widths(thing)[:, None] + widths(rest)[at]
        touch = np.flatnonzero((away < reach).any(axis=1))
    if len(touch) < TOUCHES_MIN:
        raise BadInput("touches nothing that holds it up; photograph what it stands on, or mark it as background")
    centre, touching = np.median(own, axis=0), own[touch]
    foot = touching[touching[:, 1] < low[1] + BASE * (high[1] - low[1])][:, [0, 2]]
    if len(foot) >= TOUCHES_MIN and holds_centre(foot, middle_of(own)[[0, 2]]):
        return Support(np.array([0.0, 1.0, 0.0]), True)
    away = centre - touching.mean(0)
    if np.linalg.norm(away) < 1e-3 * size:
        return Support(np.array([0.0, 1.0, 0.0]), True)
    away /= np.linalg.norm(away)
    return Support(away, False, float(np.median(touching @ away)))


def middle_of(points: np.ndarray) -> np.ndarray:
    """Centre of mass (3,) of the convex hull of points (N, 3): their own is where most details are."""
    apex = points.mean(axis=0)  # within: the hull is a cone over each of its triangles
    triangles = points[ConvexHull(points, qhull_options="QJ").simplices]
    volumes = np.abs(np.linalg.det(triangles - apex))
    return 0.25 * apex + 0.75 * volumes @ triangles.mean(axis=1) / volumes.sum()


def widths(g: Gaussians) -> np.ndarray:
    """Two standard deviations [m] along the middle axis of each Gaussian, (N,): how far its disc is seen."""
    return 2.0 * np.exp(np.sort(g.log_scales, axis=1)[:, 1].astype(np.float64))


def holds_centre(points: np.ndarray, centre: np.ndarray) -> bool:
    """True if a point (2,) lies within the convex hull of points (N, 2)."""
    angle = np.sort(np.arctan2(*(points - centre).T))
    return bool(np.diff(angle, append=angle[0] + 2 * np.pi).max() < np.pi)  # they are not in a half plane


def object_body(
    name: str,
    file: str,
    thing: Gaussians,
    support: Support,
    *,
    vertices: Sequence[int],
    material: str | None = None,
    progress: Progress = no_progress,
    say: Callable[[str], None] = print,
) -> tuple[Asset, RoomObject]:
    """The body of an object's Gaussians in the room [m], and its place; +y of its asset leads away from what holds it.

    file      of its asset, in the room's folder
    vertices  of the cage; the next number where a shape finds no sound cage with one
    Raises BadInput if there is no cage for it.
    """
    turn = rotation_between(support.direction, (0.0, 1.0, 0.0))
    thing, wanted = (
        replace(thing.transformed(turn), object_id=np.zeros(len(thing), np.uint16), objects=()),
        list(vertices),
    )
    while True:
        options = Options(wanted.pop(0), up="+y", material=material, metres=True)
        try:
            asset = prepare(thing, options, progress=progress, say=say)
            break
        except NoSoundCage as e:
            if not wanted:
                raise BadInput(str(e)) from e
            say(f"{name}: {e}; trying {wanted[0]} vertices")
    position = -turn.T @ np.array(asset.provenance["moved"])
    heights = asset.cage.vertices[:, 1]
    held = support.level + asset.provenance["moved"][1]  # of what touches: its farthest end may be a thin tail
    fixed = None if support.stands else float(np.clip(held, *(heights.min() + np.multiply(HELD, np.ptp(heights)))))
    if material is None:
        light = liftable(asset.material, float(asset.cage.volumes().sum()))
        asset = replace(asset, material=steady(light, asset.cage, turn @ [0.0, -1.0, 0.0], fixed))
    rotation = tuple(map(float, quaternions_from_matrices(turn.T)))
    return asset, RoomObject(name, file, tuple(map(float, position)), rotation, fixed)


def liftable(material: Material, volume: float) -> Material:
    """The material of a body of this volume [m^3] that a hand can lift, as if it were hollow: lighter, and softer
    in proportion, since it carries less weight."""
    share = min(1.0, MASS_MAX / (material.density * volume))
    young = max(material.young * share, min(material.young, MATERIALS[DEFAULT_MATERIAL].young))
    return replace(material, density=share * material.density, young=young)


def steady(material: Material, cage: Cage, down: np.ndarray, fixed_below: float | None) -> Material:
    """The material, stiffened if the weight of a body along `down` (3,) would move a part of it by more than NOD: else
    it would not stay as it was photographed, even before anybody touches it."""
    held = None if fixed_below is None else cage.vertices[:, 1] < fixed_below
    moved = np.linalg.norm(bent_by_weight(cage.vertices, cage.tets, material, down, held), axis=1).max()
    needed = material.young * float(moved / (NOD * np.ptp(cage.vertices, axis=0).max()))
    return replace(material, young=max(material.young, min(needed, MATERIALS["wood"].young)))


def object_files(names: Sequence[str]) -> list[str]:
    """File names of objects in a room's folder, for any names."""
    files = []
    for k, name in enumerate(names):
        stem = "".join(c if c.isascii() and (c.isalnum() or c in "_-") else "_" for c in name)[:60]
        stem = stem if stem.strip("_-") else f"object_{k + 1}"
        files.append(f"objects/{stem}.h5" if f"objects/{stem}.h5" not in files else f"objects/{stem}_{k + 1}.h5")
    return files
