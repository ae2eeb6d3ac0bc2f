"""Which bone each bit of a person belongs to, its tets and its Gaussians, and where neighbouring bits hold together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from assets.asset import Cage
from assets.gaussians import Gaussians
from core.rotation import matrices_from_quaternions
from prepare.rig.joint_names import SIDES, TREE
from prepare.rig.landmarks import Held, Landmarks
from prepare.rig.retargeting import BONES, Fitted
from prepare.rig.solid_segmentation import Solid, held_by_hands

# Radii of what lies about a bone, shares of the stature: a place belongs to the bone whose flesh it is least far from
RADIUS = {"pelvis": 0.065, "spine": 0.075, "chest": 0.075, "neck": 0.035, "head": 0.06, "clavicle": 0.035}
RADIUS |= {"shoulder": 0.036, "elbow": 0.032, "wrist": 0.022, "hip": 0.05, "knee": 0.035, "ankle": 0.025}
TRUNK = {"pelvis", "spine", "chest", "neck", "head", "left_clavicle", "right_clavicle"}
LIMBS = (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))
CHEST_HALF = 0.04  # of the stature: a chest is so much wider to each side than it is deep
PELVIS = 0.4  # of the way to the joints of the hips: beyond, its radius would reach for a hanging hand
SHOULDER_END = 0.7  # of the clavicle: the ball of the shoulder goes with the arm
ROOT_REACH = {"shoulder": 0.3, "hip": 0.42}  # of a limb's bone: about its joint so far, it holds to the trunk
LIMB_REACH = 0.5  # of the shorter bone: about their joint so far, two of a limb hold together
THINNEST = 0.02  # of the stature: what is nearer to a bone than that counts as so far
REACHES = 1.5  # standard deviations: so far a Gaussian is seen
SHORTER = (0.7, 0.5, 0.35, 0.25, 0.15)  # of its length, until it lies in its part
SAMPLES = np.array([[0.25] * 4, *(0.125 + 0.5 * np.eye(4))])  # of a tet, at which it is looked up in the solid


@dataclass(frozen=True)
class Parts:
    """To which joint what belongs: tets (T,), Gaussians (N,); and joined(a, b, centre) of rig_cut.cut."""

    tets: np.ndarray
    gaussians: np.ndarray
    joined: Callable


@dataclass(frozen=True)
class Bones:
    """Segments (a, b) [m], which of BONES each is of (n,), and the radius of what lies about it [m] (n,)."""

    segments: list[tuple[np.ndarray, np.ndarray]]
    owner: np.ndarray
    radius: np.ndarray


@dataclass(frozen=True)
class Person:
    """A solid person's parts.

    label  the bone of each point of the solid, (n,);  distance  from it [m], (n,);  held  what its hands hold
    """

    solid: Solid
    label: np.ndarray
    distance: np.ndarray
    held: list[Held]

    def of_tets(self, cage: Cage) -> np.ndarray:
        """The bone of each tet, (T,): of most of it."""
        corners = cage.vertices[cage.tets].astype(np.float64)
        near = self.solid.tree.query(np.einsum("sk,tkd->tsd", SAMPLES, corners).reshape(-1, 3))[1]
        label = self.label[near].reshape(len(cage.tets), -1)
        votes = np.zeros((len(label), len(BONES)))
        np.add.at(votes, (np.arange(len(label))[:, None], label), 1.0)
        return np.argmax(votes, axis=1)

    def of_points(self, points: np.ndarray) -> np.ndarray:
        """The bone of points (n, 3) [m], (n,)."""
        return self.label[self.solid.tree.query(points, workers=-1)[1]]

    def off_bone(self, points: np.ndarray) -> np.ndarray:
        """How far points (n, 3) [m] are from the bone that they belong to, through the solid [m], (n,)."""
        return self.distance[self.solid.tree.query(points)[1]]


def bones_of(fitted: Fitted, height: float) -> Bones:
    """What of a person lies about which line."""
    at = {n: fitted.rest[k] for k, n in enumerate(BONES)}
    found: list[tuple[str, np.ndarray, np.ndarray]] = []
    for a, b in (("pelvis", "spine"), ("spine", "chest"), ("chest", "neck"), ("neck", "head")):
        found.append((a, at[a], at[b]))
    hips = 0.5 * (at["left_hip"] + at["right_hip"])
    ends = (hips + PELVIS * (at[f"{s}_hip"] - hips) for s in SIDES)
    found += [("pelvis", *ends), ("head", at["head"], fitted.tips["head"])]
    across = at["left_shoulder"] - at["right_shoulder"]
    across = CHEST_HALF * height * across / np.linalg.norm(across)
    for middle in (at["chest"], 0.5 * (at["chest"] + at["neck"])):
        found.append(("chest", middle - across, middle + across))
    for s in SIDES:
        inner, shoulder = at[f"{s}_clavicle"], at[f"{s}_shoulder"]
        found.append((f"{s}_clavicle", inner, inner + SHOULDER_END * (shoulder - inner)))
        found += [(f"{s}_{a}", at[f"{s}_{a}"], at[f"{s}_{b}"]) for a, b in LIMBS]
        found += [(f"{s}_{a}", at[f"{s}_{a}"], fitted.tips[f"{s}_{a}"]) for a in ("wrist", "ankle")]
    radius = [height * RADIUS[n.rpartition("_")[2]] for n, _, _ in found]
    owner = [BONES.index(n) for n, _, _ in found]
    return Bones([(a, b) for _, a, b in found], np.array(owner), np.array(radius))


def parted(solid: Solid, fitted: Fitted, marks: Landmarks, height: float) -> Person:
    """Each point of the solid to the bone from whose radius it is least far; what is held goes with who holds it."""
    bones = bones_of(fitted, height)
    ways = solid.ways(bones.segments)
    first = np.argmin(ways - bones.radius, axis=1)
    label = bones.owner[first]
    distance = np.take_along_axis(ways, first[:, None], 1)[:, 0]
    held = marks.held
    if held is None:
        hands = {s: (fitted.rest[BONES.index(f"{s}_wrist")], fitted.tips[f"{s}_wrist"]) for s in SIDES}
        held = []
        for side, mine, balls in held_by_hands(solid, (ways / bones.radius).min(1), hands, height):
            held += [Held(f"{side}_hand", *ball) for ball in balls]
            label[mine] = BONES.index(f"{side}_wrist")
    for h in held:
        label[np.linalg.norm(solid.points - h.center, axis=1) < h.radius] = BONES.index(h.joint)
    return Person(solid, label, np.maximum(distance, THINNEST * height), held)


def shortened(g: Gaussians, person: Person, joined: Callable) -> tuple[Gaussians, int]:
    """Gaussians that do not reach from their part to another one that is cut from it: a long one that was hidden under
    an arm is a spike when the arm has gone. And how many had to be made shorter."""
    k = np.argmax(g.log_scales, axis=1)
    rows = np.arange(len(g))
    sigma = np.exp(g.log_scales[rows, k].astype(np.float64))
    long = np.flatnonzero(REACHES * sigma > person.solid.spacing)
    means = g.means[long].astype(np.float64)
    axis = matrices_from_quaternions(g.quats[long].astype(np.float64))[np.arange(len(long)), :, k[long]]
    own = person.of_points(means)
    share, left = np.ones(len(long)), np.ones(len(long), bool)
    for smaller in SHORTER:
        ends = means + np.array([[[REACHES]], [[-REACHES]]]) * (share * sigma[long])[:, None] * axis
        for end in ends:
            there = person.of_points(end[left])
            apart = (there != own[left]) & ~joined(there, own[left], end[left])
            share[np.flatnonzero(left)[apart]] = smaller
        left &= share == smaller
    scales = g.log_scales.copy()
    most = np.log(share * sigma[long]).astype(np.float32)
    scales[long] = np.where((share < 1)[:, None], np.minimum(scales[long], most[:, None]), scales[long])
    return replace(g, log_scales=scales), int((share < 1).sum())


def meets(fitted: Fitted) -> Callable:
    """joined(a, b, centre) of rig_cut.cut: trunk with trunk; a limb with it, or with its own next bone, about the
    joint between."""
    at = {n: fitted.rest[k] for k, n in enumerate(BONES)}
    trunk = np.array([n in TRUNK for n in BONES])
    tree = np.array([-1 if TREE[n] is None else BONES.index(TREE[n]) for n in BONES])
    length, reach = np.full(len(BONES), np.inf), np.zeros(len(BONES))
    for s in SIDES:
        for a, b in LIMBS:
            j = BONES.index(f"{s}_{a}")
            length[j] = np.linalg.norm(at[f"{s}_{a}"] - at[f"{s}_{b}"])
            reach[j] = ROOT_REACH.get(a, 0.0) * length[j]

    def joined(a: np.ndarray, b: np.ndarray, centre: np.ndarray) -> np.ndarray:
        result = trunk[a] & trunk[b]
        for lower, upper in ((a, b), (b, a)):
            off = np.linalg.norm(centre - fitted.rest[lower], axis=1)
            root = ~trunk[lower] & trunk[tree[lower]]
            result |= root & trunk[upper] & (off < reach[lower])
            shorter = np.minimum(length[lower], length[upper])
            result |= ~trunk[lower] & (tree[lower] == upper) & ~trunk[upper] & (off < LIMB_REACH * shorter)
        return result

    return joined
