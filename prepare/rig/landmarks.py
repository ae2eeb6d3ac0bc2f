"""A standing person: its landmarks, estimated from the solid of its splat or read from a file, and the joints of a rig,
matched to a rig's nodes by name and hierarchy.

Lengths are relative to the stature (Winter, Biomechanics and Motor Control of Human Movement, after Drillis & Contini).
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from assets.asset import Asset
from assets.file_access import read_json
from assets.formats.gltf import Rig
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.typed import Range, Shape, from_plain

LIMBS = ("shoulder", "elbow", "wrist", "hand", "hip", "knee", "ankle", "foot")  # hand, foot: their tips
NAMES = ("head_top", "neck", *(f"{side}_{limb}" for side in ("left", "right") for limb in LIMBS))
MAX_LANDMARK_DISTANCE = 3.0  # [body sizes] from the body, beyond which a landmark is a mistake
MAX_FILE_SIZE = 1 << 20  # [bytes] of a landmarks file
GIVE_THEM = "give its joints with --landmarks"
Coordinates = Annotated[np.ndarray, Shape(3), Range(-1e6, 1e6)]  # [m]

ANKLE, SHIN, KNEE, HIP, WAIST, CHEST, SHOULDER, NECK = 0.045, 0.1, 0.285, 0.53, 0.62, 0.72, 0.815, 0.855  # heights
UPPER_ARM, FOREARM, HAND = 0.186, 0.146, 0.108  # lengths
HIP_HALF, SHOULDER_HALF, SHOULDER_DEEP = 0.052, 0.115, 0.022  # from the middle; from the side of the shoulders inwards
CORE_SIDE, CORE_FRONT, CORE_LEG = 0.105, 0.08, 0.07  # half axes of the trunk, radius of a thigh
MIN_WRIST_COSINE = 0.6  # of the largest bend of an estimated hand at the wrist
MIN_ARM = 0.25  # length of an arm that stands out from the body


@dataclass(frozen=True)
class Held:
    """Held object: a ball that follows the joint of the landmark `by`; centre (3,) and radius [m]."""

    by: Literal[*NAMES]
    center: Coordinates
    radius: Annotated[float, Range(1e-6, 1e6)]

    @property
    def joint(self) -> str:
        """Joint of joint_names.TREE that it follows."""
        tips = {"hand": "wrist", "foot": "ankle", "head_top": "head"}
        side, _, limb = self.by.partition("_")
        return tips.get(self.by) or (f"{side}_{tips.get(limb, limb)}" if limb else self.by)


@dataclass(frozen=True)
class Landmarks:
    """Positions of NAMES in the asset's frame.

    points  {name: (3,) [m]};  source  {name: "given", "solid" or "proportions"}
    held    held objects, None if these are to be found
    joints  {name: name of the rig's node}, for rigs with unknown names
    """

    points: dict[str, np.ndarray]
    source: dict[str, str]
    held: list[Held] | None
    joints: dict[str, str]


# half of the 26 neighbours of a node
NEIGHBOURS = [step for step in itertools.product((-1, 0, 1), repeat=3) if step > (0, 0, 0)]


@dataclass(frozen=True)
class Solid:
    """Nodes of a grid inside a body: points (n, 3) [m], spacing [m], depth (n,) [m], and their neighbour graph."""

    points: np.ndarray
    spacing: float
    depth: np.ndarray
    graph: csr_matrix
    tree: cKDTree

    @classmethod
    def of(cls, sdf: DistanceGrid) -> Solid:
        """The nodes with negative distance, connected to their 26 neighbours."""
        inside, spacing = np.pad(np.asarray(sdf.values, np.float32) < 0, 1), float(sdf.spacing)
        node = np.argwhere(inside)
        number = np.full(inside.shape, -1)
        number[inside] = np.arange(len(node))
        rows, columns, lengths = [], [], []
        for step in NEIGHBOURS:
            other = number[tuple((node + step).T)]
            here = np.flatnonzero(other >= 0)
            rows.append(here)
            columns.append(other[here])
            lengths.append(np.full(len(here), spacing * np.linalg.norm(step)))
        ends = np.concatenate(rows), np.concatenate(columns)
        graph = coo_matrix((np.concatenate(lengths), ends), shape=(len(node),) * 2).tocsr()
        points = np.asarray(sdf.origin, np.float64) + spacing * (node - 1)
        return cls(points, spacing, spacing * ndimage.distance_transform_edt(inside)[inside], graph, cKDTree(points))

    def geodesic_distances(self, segments: Sequence) -> np.ndarray:
        """Length [m] of the shortest path through the solid from each segment (a, b) to each point, (n, segments)."""
        result = np.empty((len(self.points), len(segments)))
        for k, (a, b) in enumerate(segments):
            steps = max(int(np.linalg.norm(b - a) / self.spacing), 1) + 1
            start = np.unique(self.tree.query(a + np.linspace(0, 1, steps)[:, None] * (b - a))[1])
            result[:, k] = dijkstra(self.graph, directed=False, indices=start, min_only=True)
        return result


def landmarks_of(asset: Asset, given: dict, grid: DistanceGrid) -> Landmarks:
    """Landmarks of a person who stands upright: those `given`, the others estimated. Raises BadInput.

    grid  the distance grid that the cage was made from, finer than the asset's
    """
    points, source = estimate(Solid.of(grid), given)
    low, high = asset.cage.vertices.min(0), asset.cage.vertices.max(0)
    limit = MAX_LANDMARK_DISTANCE * (high - low).max()
    for name in given.keys() & set(NAMES):
        source[name] = "given"
        if np.abs(given[name] - (low + high) / 2).max() > limit:
            raise BadInput(f"the landmark {name} lies {limit:.3g} m or more from the body: is it in metres?")
    return Landmarks(points, source, given.get("held"), given.get("joints", {}))


def estimate(solid: Solid, given: dict) -> tuple[dict, dict]:
    """Landmarks of a person's solid and how each was found; those `given` guide the others."""
    x, deep, spacing = solid.points, solid.depth, solid.spacing
    foot, top = x[:, 1].min(), x[:, 1].max()
    H = top - foot
    height = (x[:, 1] - foot) / H

    def middle(low: float, high: float) -> np.ndarray:
        """Centre of the thickest part at these heights, so that a held object beside it counts little."""
        near = (height >= low) & (height < high)
        if not near.any():
            raise BadInput(f"this does not look like a standing person: it has gaps at some heights; {GIVE_THEM}")
        thick = near & (deep > 0.6 * deep[near].max())
        return np.average(x[thick], axis=0, weights=deep[thick])

    legs = {h: two_legs(x[np.abs(height - h) < 0.02], spacing) for h in (ANKLE, SHIN, KNEE)}
    toes = [x[(height < 0.03) & (horizontal_distance(x, a) < 0.12 * H)] for a in legs[SHIN]]
    toes = [t.mean(0) - a if len(t) else np.zeros(3) for t, a in zip(toes, legs[SHIN], strict=True)]
    forward = np.sum(toes, axis=0) * [1, 0, 1]
    if "left_hip" in given and "right_hip" in given:
        forward = np.cross(given["left_hip"] - given["right_hip"], [0, 1.0, 0])
    elif np.linalg.norm(forward) < 0.01 * H:  # no toes visible: either direction across the legs
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
        sole = (height < 0.03) & (horizontal_distance(x, ankle) < 0.16 * H)
        tip = np.percentile((x[sole] - ankle) @ forward, 97) if sole.any() else 0.0
        found[f"{name}_foot"] = (ankle + max(tip - 0.02 * H, 0.03 * H) * forward) * [1, 0, 1] + [0, foot + 0.02 * H, 0]
    source = dict.fromkeys(found, "solid")
    found |= {k: v for k, v in given.items() if k in NAMES}
    trunk = {"chest": chest, "pelvis": pelvis, "left": left, "forward": forward}
    for name, sign in (("right", -1.0), ("left", 1.0)):
        arm, how = find_arm(solid, found, trunk, name, sign)
        found |= {k: v for k, v in arm.items() if k not in found}
        source |= dict.fromkeys(arm, how)
    return found, source


def horizontal_distance(x: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Horizontal distance [m] of points x (n, 3) from a point."""
    return np.linalg.norm((x - point)[:, [0, 2]], axis=1)


def two_legs(x: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Centres of the two largest clusters of points (n, 3) of one level."""
    if len(x) < 2:
        raise BadInput(f"this does not look like a standing person: no legs were found; {GIVE_THEM}")
    cell = np.floor((x[:, [0, 2]] - x[:, [0, 2]].min(0)) / spacing + 0.5).astype(np.int64)
    grid = np.zeros(cell.max(0) + 1, bool)
    grid[tuple(cell.T)] = True
    label = ndimage.label(grid)[0][tuple(cell.T)]
    size = np.bincount(label)
    order = np.argsort(size)[::-1]
    if len(order) > 1 and size[order[1]] > 0.25 * size[order[0]]:
        return x[label == order[0]].mean(0), x[label == order[1]].mean(0)
    middle = x.mean(0)  # the legs touch: halves across the longer axis
    flat = (x - middle)[:, [0, 2]]
    axis = np.linalg.eigh(flat.T @ flat)[1][:, 1]
    return x[flat @ axis < 0].mean(0), x[flat @ axis >= 0].mean(0)


def find_arm(solid: Solid, found: dict, trunk: dict, name: str, sign: float) -> tuple[dict, str]:
    """Elbow, wrist and fingertips of one arm, along what stands out from trunk and thighs; and their source."""
    x, spacing, shoulder = solid.points, solid.spacing, found[f"{name}_shoulder"]
    foot, H = x[:, 1].min(), np.ptp(x[:, 1])
    height = (x[:, 1] - foot) / H
    fraction = np.clip((x[:, 1] - trunk["pelvis"][1]) / (trunk["chest"][1] - trunk["pelvis"][1]), 0, 1)[:, None]
    off = x - (trunk["pelvis"] + fraction * (trunk["chest"] - trunk["pelvis"]))
    side, front = off @ trunk["left"], off @ trunk["forward"]
    core = (side / CORE_SIDE) ** 4 + (front / CORE_FRONT) ** 4 < H**4  # a rounded box, about as a trunk is
    for s in ("left", "right"):
        core |= distance_to_segment(x, found[f"{s}_hip"], found[f"{s}_knee"]) < CORE_LEG * H
    begin = np.linalg.norm(x - shoulder, axis=1)
    arm = ((~core & (height < NECK - 0.02)) | (begin < 0.04 * H)) & (height > KNEE) & (sign * side > -0.04 * H)
    arm = np.flatnonzero(arm)
    points, graph = x[arm], solid.graph[arm][:, arm]
    path = dijkstra(graph, directed=False, indices=np.argmin(begin[arm]))  # [m]
    length = path[np.isfinite(path)].max(initial=0.0)
    lengths = {"elbow": UPPER_ARM, "wrist": UPPER_ARM + FOREARM, "hand": UPPER_ARM + FOREARM + 0.8 * HAND}
    if length < MIN_ARM * H:  # it hangs close to the body
        down = np.array([0, -1.0, 0])
        return {f"{name}_{k}": shoulder + v * H * down for k, v in lengths.items()}, "proportions"
    scale = min(length / ((UPPER_ARM + FOREARM + HAND) * H), 1.0)
    result = {}
    for k, v in lengths.items():
        band = np.abs(path - v * H * scale) < max(0.012 * H, spacing)
        result[f"{name}_{k}"] = points[band].mean(0)
    elbow, wrist, hand = (result[f"{name}_{k}"] for k in lengths)
    ahead = (wrist - elbow) / max(np.linalg.norm(wrist - elbow), 1e-9)
    bent = (hand - wrist) @ ahead < MIN_WRIST_COSINE * np.linalg.norm(hand - wrist)
    if bent:  # the path led on into what the hand touches
        result[f"{name}_hand"] = wrist + 0.8 * HAND * H * ahead
    return result, "solid"


def distance_to_segment(x: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distance [m] of points (n, 3) from the segment a-b."""
    t = ((x - a) @ (b - a) / max((b - a) @ (b - a), 1e-12)).clip(0, 1)
    return np.linalg.norm(x - a - t[:, None] * (b - a), axis=1)


def read_landmarks(path: str | Path) -> dict:
    """The JSON object of a landmarks file: {NAME: [x, y, z], ..., "held": [...], "joints": {...}}; coordinates are
    metres in the prepared asset's frame. Raises BadInput."""
    found = from_plain(dict[str, Any], read_json(Path(path), MAX_FILE_SIZE), str(path))
    kinds = {**dict.fromkeys(NAMES, Coordinates), "held": list[Held], "joints": dict[str, str]}
    for name in found.keys() - kinds.keys():
        raise BadInput(f"{path}: {name[:40]!r} is not a landmark; there are {', '.join(kinds)}")
    return {"joints": {}} | {name: from_plain(kinds[name], v, f"{path}: {name}") for name, v in found.items()}


SIDES = ("left", "right")
ARM, LEG = ("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle")
TREE = {"pelvis": None, "spine": "pelvis", "chest": "spine", "neck": "chest", "head": "neck"}
for _s in SIDES:
    TREE |= {f"{_s}_clavicle": "chest", f"{_s}_shoulder": f"{_s}_clavicle", f"{_s}_elbow": f"{_s}_shoulder"}
    TREE |= {f"{_s}_wrist": f"{_s}_elbow"}
    TREE |= {f"{_s}_hip": "pelvis", f"{_s}_knee": f"{_s}_hip", f"{_s}_ankle": f"{_s}_knee"}


NAME_IT = "name it under joints in a landmarks file"


def name_parts(name: str) -> list[str]:
    """Split a joint's name into lower-case parts: "L_armUpper0001" is l, arm, upper, 0001."""
    return [w.lower() for w in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", name)]


def match_joints(rig: Rig, overrides: dict[str, str]) -> dict[str, int]:
    """Node of the rig for each joint of TREE: limbs by their first joint's name, all else by the hierarchy.

    Raises BadInput, naming the joint that is missing.
    """
    found = {}
    for name, node in overrides.items():
        if name not in TREE or node not in rig.names:
            raise BadInput(f"the joint {name[:40]!r} is unknown, or the rig has no node {node[:40]!r}")
        found[name] = rig.names.index(node)
    count = np.zeros(len(rig.parents), np.int64)  # of descendants
    for k in range(len(count)):
        count[ancestors(rig.parents, k)[1:]] += 1
    tokens = [name_parts(n) for n in rig.names]
    for side in SIDES:
        of_side = [bool({side, side[0]} & set(t)) for t in tokens]
        for chain, keys in ((ARM, ("arm", "upperarm", "shldr")), (LEG, ("leg", "thigh", "upleg", "upperleg", "hip"))):
            first = f"{side}_{chain[0]}"
            if first not in found:
                fits = [k for k, t in enumerate(tokens) if of_side[k] and set(t) & set(keys)]
                if not fits:
                    raise BadInput(f"the rig has no joint for the {side} {chain[0]}; {NAME_IT}")
                found[first] = fits[0]  # parents come first
            for above, below in itertools.pairwise(chain):
                if f"{side}_{below}" not in found:
                    children = np.flatnonzero(rig.parents == found[f"{side}_{above}"])
                    if not len(children):
                        raise BadInput(f"the rig has no joint for the {side} {below}")
                    found[f"{side}_{below}"] = int(children[np.argmax(count[children])])
        parent = int(rig.parents[found[f"{side}_shoulder"]])
        if f"{side}_clavicle" not in found and parent >= 0 and of_side[parent]:
            found[f"{side}_clavicle"] = parent
    found.setdefault("pelvis", lowest_common(rig.parents, found["left_hip"], found["right_hip"]))
    found.setdefault("chest", lowest_common(rig.parents, found["left_shoulder"], found["right_shoulder"]))
    if "head" not in found:
        heads = [k for k, t in enumerate(tokens) if "head" in t and found["chest"] in ancestors(rig.parents, k)]
        if not heads:
            raise BadInput(f"the rig has no joint for the head; {NAME_IT}")
        found["head"] = heads[0]
    line = ancestors(rig.parents, found["head"])
    found.setdefault("neck", line[max(line.index(found["chest"]) - 1, 0)])
    return found


def ancestors(parents: np.ndarray, j: int) -> list[int]:
    """Joint j and its ancestors, bottom up."""
    line = [int(j)]
    while parents[line[-1]] >= 0:
        line.append(int(parents[line[-1]]))
    return line


def lowest_common(parents: np.ndarray, a: int, b: int) -> int:
    """Lowest common ancestor of two joints. Raises BadInput."""
    line = ancestors(parents, b)
    for j in ancestors(parents, a):
        if j in line:
            return j
    raise BadInput("the rig's limbs are not connected")
