"""Joints of a person, and how a rig's nodes are matched to them by name and hierarchy."""

from __future__ import annotations

import itertools
import re

import numpy as np

from assets.formats.gltf_skin import Rig
from core.errors import BadInput

SIDES = ("left", "right")
ARM, LEG = ("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle")
TREE = {"pelvis": None, "spine": "pelvis", "chest": "spine", "neck": "chest", "head": "neck"}
for _s in SIDES:
    TREE |= {f"{_s}_clavicle": "chest", f"{_s}_shoulder": f"{_s}_clavicle", f"{_s}_elbow": f"{_s}_shoulder"}
    TREE |= {f"{_s}_wrist": f"{_s}_elbow"}
    TREE |= {f"{_s}_hip": "pelvis", f"{_s}_knee": f"{_s}_hip", f"{_s}_ankle": f"{_s}_knee"}


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
    count = descendants(rig.parents)
    tokens = [name_parts(n) for n in rig.names]
    for side in SIDES:
        of_side = [bool({side, side[0]} & set(t)) for t in tokens]
        for chain, keys in ((ARM, ("arm", "upperarm", "shldr")), (LEG, ("leg", "thigh", "upleg", "upperleg", "hip"))):
            first = f"{side}_{chain[0]}"
            if first not in found:
                fits = [k for k, t in enumerate(tokens) if of_side[k] and set(t) & set(keys)]
                if not fits:
                    raise BadInput(f"the rig has no joint for the {side} {chain[0]}; name it under joints in a "
                                   f"landmarks file")  # fmt: skip
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
            raise BadInput("the rig has no joint for the head; name it under joints in a landmarks file")
        found["head"] = heads[0]
    line = ancestors(rig.parents, found["head"])
    found.setdefault("neck", line[max(line.index(found["chest"]) - 1, 0)])
    return found


def descendants(parents: np.ndarray) -> np.ndarray:
    """Number of descendants of each joint, (J,)."""
    count = np.zeros(len(parents), np.int64)
    for j in range(len(parents) - 1, -1, -1):
        if parents[j] >= 0:
            count[parents[j]] += count[j] + 1
    return count


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
