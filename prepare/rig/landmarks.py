"""Where a standing person's joints are: guessed from the solid of its splat, or named in a file.

Lengths are shares of the stature (Winter, Biomechanics and Motor Control of Human Movement, after Drillis & Contini).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from assets.asset import Asset
from core.distance_grid import DistanceGrid
from core.errors import BadInput

LIMBS = ("shoulder", "elbow", "wrist", "hand", "hip", "knee", "ankle", "foot")  # hand, foot: their tips
NAMES = ("head_top", "neck", *(f"{side}_{limb}" for side in ("left", "right") for limb in LIMBS))
FAR = 3.0  # [statures] from the body, beyond which a landmark is a mistake

ANKLE, SHIN, KNEE, HIP, WAIST, CHEST, SHOULDER, NECK = 0.045, 0.1, 0.285, 0.53, 0.62, 0.72, 0.815, 0.855  # heights
UPPER_ARM, FOREARM, HAND = 0.186, 0.146, 0.108  # lengths
HIP_HALF, SHOULDER_HALF, SHOULDER_DEEP = 0.052, 0.115, 0.022  # from the middle; from the side of the shoulders inwards
CORE_SIDE, CORE_FRONT, CORE_LEG = 0.105, 0.08, 0.07  # half axes of the trunk, radius of a thigh
BENT = 0.6  # cosine of the most that a guessed hand is bent at the wrist
SHORTEST_ARM = 0.25  # what stands out less is no arm


@dataclass(frozen=True)
class Held:
    """A ball that goes with a landmark's joint, whatever is near it: centre (3,) and radius [m]."""

    by: str
    center: np.ndarray
    radius: float

    @property
    def joint(self) -> str:
        """The joint of rig_names.TREE that it follows."""
        tips = {"hand": "wrist", "foot": "ankle", "head_top": "head"}
        side, _, limb = self.by.partition("_")
        return tips.get(self.by) or (f"{side}_{tips.get(limb, limb)}" if limb else self.by)


@dataclass(frozen=True)
class Landmarks:
    """Places of NAMES in the asset's frame.

    points  {name: (3,) [m]};  source  {name: "given", "solid" or "proportions"}
    held    what is held, None if that is to be found out
    joints  {name: name of the rig's node}, for rigs whose names do not tell
    """

    points: dict[str, np.ndarray]
    source: dict[str, str]
    held: list[Held] | None
    joints: dict[str, str]


def landmarks_of(asset: Asset, given: dict | None = None, solid: DistanceGrid | None = None) -> Landmarks:
    """Landmarks of a person who stands upright: those `given`, the others guessed from the grid `solid` (default: the
    asset's own, which is coarser than the one that its cage is made from). Raises BadInput."""
    given = given or {}
    grid = solid or asset.sdf
    if grid is None:
        raise BadInput("landmarks cannot be guessed without a distance grid")
    points, source = guess(grid, given)
    low, high = asset.cage.vertices.min(0), asset.cage.vertices.max(0)
    reach = FAR * (high - low).max()
    for name in NAMES:
        if name in given:
            points[name], source[name] = given[name], "given"
            if np.abs(given[name] - (low + high) / 2).max() > reach:
                raise BadInput(f"the landmark {name} lies {reach:.3g} m or more from the body: is it in metres?")
    return Landmarks(points, source, given.get("held"), given.get("joints", {}))


def guess(grid: DistanceGrid, given: dict) -> tuple[dict, dict]:
    """Landmarks from the solid of a grid; what is `given` already leads the others."""
    solid = np.asarray(grid.values, np.float32) < 0
    node, spacing = np.argwhere(solid), float(grid.spacing)
    x = np.asarray(grid.origin) + spacing * node
    deep = ndimage.distance_transform_edt(solid)[tuple(node.T)] * spacing
    foot, top = x[:, 1].min(), x[:, 1].max()
    H = top - foot
    height = (x[:, 1] - foot) / H

    def middle(low: float, high: float) -> np.ndarray:
        """Centre of what is thickest at these heights: what is held beside it counts little."""
        near = (height >= low) & (height < high)
        if not near.any():
            raise BadInput("this is not a standing person: nothing is there at some height; name the landmarks")
        thick = near & (deep > 0.6 * deep[near].max())
        return np.average(x[thick], axis=0, weights=deep[thick])

    legs = {h: two_legs(x[np.abs(height - h) < 0.02], spacing) for h in (ANKLE, SHIN, KNEE)}
    toes = [x[(height < 0.03) & (near_to(x, a) < 0.12 * H)] for a in legs[SHIN]]
    toes = [t.mean(0) - a if len(t) else np.zeros(3) for t, a in zip(toes, legs[SHIN], strict=True)]
    forward = np.sum(toes, axis=0) * [1, 0, 1]
    if "left_hip" in given and "right_hip" in given:
        forward = np.cross(given["left_hip"] - given["right_hip"], [0, 1.0, 0])
    elif np.linalg.norm(forward) < 0.01 * H:  # no toes to see: either way across the legs
        forward = np.cross(legs[KNEE][1] - legs[KNEE][0], [0, 1.0, 0])
    forward = forward / max(np.linalg.norm(forward), 1e-9)
    left = np.cross([0, 1.0, 0], forward)
    legs = {h: (a, b) if (b - a) @ left > 0 else (b, a) for h, (a, b) in legs.items()}  # right, left

    chest, neck = middle(CHEST - 0.03, CHEST + 0.03), middle(NECK - 0.012, NECK + 0.012)
    waist = middle(WAIST - 0.02, WAIST + 0.02)
    knees = 0.5 * (legs[KNEE][0] + legs[KNEE][1])
    pelvis = (0.7 * waist + 0.3 * knees) * [1, 0, 1] + [0, foot + HIP * H, 0]
    found = {"head_top": x[height > 0.985].mean(0), "neck": neck}
    found["head_top"][1] = top
    shoulders = np.abs(height - SHOULDER) < 0.015
    side = np.percentile(np.abs((x[shoulders] - chest) @ left), 97) - SHOULDER_DEEP * H
    level = middle(SHOULDER - 0.015, SHOULDER + 0.015)
    for k, (name, sign) in enumerate((("right", -1.0), ("left", 1.0))):
        found[f"{name}_shoulder"] = level + sign * min(side, SHOULDER_HALF * H) * left
        found[f"{name}_hip"] = pelvis + sign * HIP_HALF * H * left
        found[f"{name}_knee"], ankle = legs[KNEE][k], 0.5 * (legs[ANKLE][k] + legs[SHIN][k])
        ankle[1] = foot + ANKLE * H
        found[f"{name}_ankle"] = ankle
        sole = (height < 0.03) & (near_to(x, ankle) < 0.16 * H)
        tip = np.percentile((x[sole] - ankle) @ forward, 97) if sole.any() else 0.0
        found[f"{name}_foot"] = (ankle + max(tip - 0.02 * H, 0.03 * H) * forward) * [1, 0, 1] + [0, foot + 0.02 * H, 0]
    source = dict.fromkeys(found, "solid")
    found |= {k: v for k, v in given.items() if k in NAMES}
    trunk = {"chest": chest, "pelvis": pelvis, "left": left, "forward": forward}
    for name, sign in (("right", -1.0), ("left", 1.0)):
        arm, how = arm_of(x, height, H, found, trunk, name, sign, spacing)
        found |= {k: v for k, v in arm.items() if k not in found}
        source |= dict.fromkeys(arm, how)
    return found, source


def near_to(x: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Horizontal distance [m]."""
    return np.linalg.norm((x - point)[:, [0, 2]], axis=1)


def two_legs(x: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Centres of the two largest clusters of points (n, 3) of one level."""
    if len(x) < 2:
        raise BadInput("this is not a standing person: no legs are there; name the landmarks")
    cell = np.floor((x[:, [0, 2]] - x[:, [0, 2]].min(0)) / spacing + 0.5).astype(np.int64)
    grid = np.zeros(cell.max(0) + 1, bool)
    grid[tuple(cell.T)] = True
    piece = ndimage.label(grid)[0][tuple(cell.T)]
    size = np.bincount(piece)
    order = np.argsort(size)[::-1]
    if len(order) > 1 and size[order[1]] > 0.25 * size[order[0]]:
        return x[piece == order[0]].mean(0), x[piece == order[1]].mean(0)
    middle = x.mean(0)  # the legs touch: halves across the longer axis
    flat = (x - middle)[:, [0, 2]]
    axis = np.linalg.eigh(flat.T @ flat)[1][:, 1]
    return x[flat @ axis < 0].mean(0), x[flat @ axis >= 0].mean(0)


def arm_of(x, height, H, found: dict, trunk: dict, name: str, sign: float, spacing: float) -> tuple[dict, str]:
    """Elbow, wrist and tip of the hand of one arm, along what stands out from trunk and thighs; and what tells so."""
    shoulder = found[f"{name}_shoulder"]
    share = np.clip((x[:, 1] - trunk["pelvis"][1]) / (trunk["chest"][1] - trunk["pelvis"][1]), 0, 1)[:, None]
    off = x - (trunk["pelvis"] + share * (trunk["chest"] - trunk["pelvis"]))
    side, front = off @ trunk["left"], off @ trunk["forward"]
    core = (side / CORE_SIDE) ** 4 + (front / CORE_FRONT) ** 4 < H**4  # about as a trunk is: a rounded box
    for s in ("left", "right"):
        core |= to_segment(x, found[f"{s}_hip"], found[f"{s}_knee"]) < CORE_LEG * H
    begin = np.linalg.norm(x - shoulder, axis=1)
    arm = ((~core & (height < NECK - 0.02)) | (begin < 0.04 * H)) & (height > KNEE) & (sign * side > -0.04 * H)
    points, start = x[arm], np.argmin(begin[arm])
    way = geodesic(points, start, spacing)
    length = way[np.isfinite(way)].max(initial=0.0)
    lengths = {"elbow": UPPER_ARM, "wrist": UPPER_ARM + FOREARM, "hand": UPPER_ARM + FOREARM + 0.8 * HAND}
    if length < SHORTEST_ARM * H:  # it lies close to the body: it hangs
        down = np.array([0, -1.0, 0])
        return {f"{name}_{k}": shoulder + v * H * down for k, v in lengths.items()}, "proportions"
    scale = min(length / ((UPPER_ARM + FOREARM + HAND) * H), 1.0)
    result = {}
    for k, v in lengths.items():
        band = np.abs(way - v * H * scale) < max(0.012 * H, spacing)
        result[f"{name}_{k}"] = points[band].mean(0)
    elbow, wrist, hand = (result[f"{name}_{k}"] for k in lengths)
    ahead = (wrist - elbow) / max(np.linalg.norm(wrist - elbow), 1e-9)
    if (hand - wrist) @ ahead < BENT * np.linalg.norm(hand - wrist):  # the way led on into what the hand touches
        result[f"{name}_hand"] = wrist + 0.8 * HAND * H * ahead
    return result, "solid"


def to_segment(x: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distance [m] of points (n, 3) from the segment a-b."""
    t = ((x - a) @ (b - a) / max((b - a) @ (b - a), 1e-12)).clip(0, 1)
    return np.linalg.norm(x - a - t[:, None] * (b - a), axis=1)


def geodesic(points: np.ndarray, start: int, spacing: float) -> np.ndarray:
    """Length [m] of the shortest way through grid points (n, 3) from one of them, inf where none leads."""
    from scipy.spatial import cKDTree

    pairs = cKDTree(points).query_pairs(1.75 * spacing, output_type="ndarray")  # all 26 neighbours
    length = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    graph = coo_matrix((length, pairs.T), shape=(len(points),) * 2).tocsr()
    return dijkstra(graph, directed=False, indices=start)
