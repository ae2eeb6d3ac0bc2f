"""Segmentation of a person's solid, tets and Gaussians by bone, measured through the solid, and what its hands hold.

The cage's tets are coarser than the gap between an arm and the side it hangs at; the grid that the cage was made from
is not, and Gaussians lie on its surface. The cage is cut open where it joins what the skeleton does not: a hand and the
hip it rests on, the two thighs. Each tet belongs to a joint; faces between tets of joints that do not meet there are
duplicated, and so are their vertices.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from assets.asset import Cage
from assets.gaussians import Gaussians
from core.rotation import matrices_from_quaternions
from core.tetmesh import boundary_surface, shared_face_pairs, tet_faces
from prepare.rig.landmarks import SIDES, TREE, Held, Landmarks, Solid, distance_to_segment
from prepare.rig.retargeting import BONES, Retargeted

# Radii of the flesh about a bone, relative to the stature: a point belongs to the bone whose radius it exceeds least.
RADIUS = {"pelvis": 0.065, "spine": 0.075, "chest": 0.075, "neck": 0.035, "head": 0.06, "clavicle": 0.035}
RADIUS |= {"shoulder": 0.036, "elbow": 0.032, "wrist": 0.022, "hip": 0.05, "knee": 0.035, "ankle": 0.025}
TRUNK = {"pelvis", "spine", "chest", "neck", "head", "left_clavicle", "right_clavicle"}
LIMB_BONES = (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))
CHEST_HALF_WIDTH = 0.04  # of the stature: a chest is wider than deep by this to each side
PELVIS_END = 0.4  # of the line to the hip joints: beyond, its radius would include a hanging hand
SHOULDER_END = 0.7  # of the clavicle: the ball of the shoulder goes with the arm
ROOT_RADIUS = {"shoulder": 0.3, "hip": 0.42}  # of a limb's bone: within, about its joint, it is joined to the trunk
LIMB_RADIUS = 0.5  # of the shorter bone: within, about their joint, two bones of a limb are joined
MIN_DISTANCE = 0.02  # of the stature: smaller distances from a bone count as this
VISIBLE_SIGMAS = 1.5  # standard deviations to which a Gaussian is visible
SHORTENINGS = (0.7, 0.5, 0.35, 0.25, 0.15)  # of a Gaussian's length, tried in turn until it lies in its segment
TET_SAMPLES = np.array([[0.25] * 4, *(0.125 + 0.5 * np.eye(4))])  # barycentric, looked up in the solid

EXCESS_RADII = 1.6  # of bones: a person's flesh, boots and jackets lie within, but for patches
MIN_HELD = 0.015  # of the solid: such patches are smaller
HAND_DISTANCE = 0.06  # of the height: a held object is this near to a hand
BALL_TOLERANCE = 0.12  # of a ball's radius, root mean square: an object with smaller deviation is a ball
BALL_COVERAGE, MAX_BALLS = 0.9, 12

Joined = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]  # (joints a, joints b, centres (n, 3)) -> mask (n,)


@dataclass(frozen=True)
class Segments:
    """Joint that each tet (T,) and each Gaussian (N,) follows, and where segments of two joints are connected."""

    tets: np.ndarray
    gaussians: np.ndarray
    joined: Joined


@dataclass(frozen=True)
class SegmentedPerson:
    """A person's solid by bones.

    bone      index into BONES of each point of the solid, (n,)
    distance  geodesic distance from that bone [m], (n,)
    held      objects in the hands
    """

    solid: Solid
    bone: np.ndarray
    distance: np.ndarray
    held: list[Held]

    def bone_of_tets(self, cage: Cage) -> np.ndarray:
        """Bone of most of each tet, (T,)."""
        corners = cage.vertices[cage.tets].astype(np.float64)
        near = self.solid.tree.query(np.einsum("sk,tkd->tsd", TET_SAMPLES, corners).reshape(-1, 3))[1]
        bone = self.bone[near].reshape(len(cage.tets), -1)
        votes = np.zeros((len(bone), len(BONES)))
        np.add.at(votes, (np.arange(len(bone))[:, None], bone), 1.0)
        return np.argmax(votes, axis=1)

    def bone_of_points(self, points: np.ndarray) -> np.ndarray:
        """Bone of points (n, 3) [m], (n,)."""
        return self.bone[self.solid.tree.query(points, workers=-1)[1]]

    def bone_distance(self, points: np.ndarray) -> np.ndarray:
        """Geodesic distance [m] of points (n, 3) [m] from the bone they belong to, (n,)."""
        return self.distance[self.solid.tree.query(points)[1]]


def bone_segments(
    body: Retargeted, height: float
) -> tuple[list[tuple[np.ndarray, np.ndarray]], np.ndarray, np.ndarray]:
    """Axes of a person's flesh: segments (a, b) [m], the bone of each (n,), and the radius about it [m] (n,)."""
    at = {n: body.rest[k] for k, n in enumerate(BONES)}
    found: list[tuple[str, np.ndarray, np.ndarray]] = []
    for a, b in (("pelvis", "spine"), ("spine", "chest"), ("chest", "neck"), ("neck", "head")):
        found.append((a, at[a], at[b]))
    hips = 0.5 * (at["left_hip"] + at["right_hip"])
    ends = (hips + PELVIS_END * (at[f"{s}_hip"] - hips) for s in SIDES)
    found += [("pelvis", *ends), ("head", at["head"], body.tips["head"])]
    across = at["left_shoulder"] - at["right_shoulder"]
    across = CHEST_HALF_WIDTH * height * across / np.linalg.norm(across)
    for middle in (at["chest"], 0.5 * (at["chest"] + at["neck"])):
        found.append(("chest", middle - across, middle + across))
    for s in SIDES:
        inner, shoulder = at[f"{s}_clavicle"], at[f"{s}_shoulder"]
        found.append((f"{s}_clavicle", inner, inner + SHOULDER_END * (shoulder - inner)))
        found += [(f"{s}_{a}", at[f"{s}_{a}"], at[f"{s}_{b}"]) for a, b in LIMB_BONES]
        found += [(f"{s}_{a}", at[f"{s}_{a}"], body.tips[f"{s}_{a}"]) for a in ("wrist", "ankle")]
    radius = [height * RADIUS[n.rpartition("_")[2]] for n, _, _ in found]
    bone = [BONES.index(n) for n, _, _ in found]
    return [(a, b) for _, a, b in found], np.array(bone), np.array(radius)


def segment_person(solid: Solid, body: Retargeted, landmarks: Landmarks, height: float) -> SegmentedPerson:
    """Assign each point of the solid to the bone whose radius it exceeds least; held objects follow the hand."""
    segments, bone_of_segment, radius = bone_segments(body, height)
    distances = solid.geodesic_distances(segments)
    first = np.argmin(distances - radius, axis=1)
    bone = bone_of_segment[first]
    distance = np.take_along_axis(distances, first[:, None], 1)[:, 0]
    held = landmarks.held
    if held is None:
        hands = {s: (body.rest[BONES.index(f"{s}_wrist")], body.tips[f"{s}_wrist"]) for s in SIDES}
        held = []
        for side, own, balls in held_by_hands(solid, (distances / radius).min(1), hands, height):
            held += [Held(f"{side}_hand", *ball) for ball in balls]
            bone[own] = BONES.index(f"{side}_wrist")
    for h in held:
        bone[np.linalg.norm(solid.points - h.center, axis=1) < h.radius] = BONES.index(h.joint)
    return SegmentedPerson(solid, bone, np.maximum(distance, MIN_DISTANCE * height), held)


def held_by_hands(solid: Solid, radii: np.ndarray, hands: dict, height: float) -> list[tuple[str, np.ndarray, list]]:
    """Objects held by hands: components of the solid next to a hand that no bone's radius explains.

    radii  distance of each point from its nearest bone in radii of that bone, (n,)
    hands  {side: (wrist, tip) [m]};  height  [m] of the person
    Out.   [(side, indices of the component's points, covering balls [(centre (3,), radius) [m]])]
    """
    far = np.flatnonzero(radii > EXCESS_RADII)
    count, component = connected_components(solid.graph[far][:, far], directed=False)
    result = []
    for p in range(count):
        own = far[component == p]
        if len(own) < MIN_HELD * len(solid.points):
            continue
        near = {s: distance_to_segment(solid.points[own], *ends).min() for s, ends in hands.items()}
        side = min(near, key=near.get)
        if near[side] < HAND_DISTANCE * height:
            result.append((side, own, covering_balls(solid, own)))
    return result


def covering_balls(solid: Solid, own: np.ndarray) -> list[tuple[np.ndarray, float]]:
    """Balls (centre, radius) [m] that cover these points of the solid: one if they form a ball, else several."""
    x, depth = solid.points[own], solid.depth[own]
    shell = x[depth < 1.1 * solid.spacing]
    if len(shell) > 3:  # |x|^2 = 2 c x + r^2 - |c|^2
        fit = np.linalg.lstsq(np.c_[2 * shell, np.ones(len(shell))], (shell**2).sum(1), rcond=None)[0]
        center, radius = fit[:3], float(np.sqrt(max(fit[3] + fit[:3] @ fit[:3], 0.0)))
        off = np.linalg.norm(shell - center, axis=1) - radius
        inside = np.linalg.norm(x - center, axis=1) < radius + solid.spacing
        if np.sqrt((off**2).mean()) < BALL_TOLERANCE * radius and inside.mean() > BALL_COVERAGE:
            return [(center, radius + 0.5 * solid.spacing)]  # nodes are inside
    result, uncovered = [], np.ones(len(own), bool)
    while uncovered.mean() > 1 - BALL_COVERAGE and len(result) < MAX_BALLS:
        k = np.flatnonzero(uncovered)[np.argmax(depth[uncovered])]
        result.append((x[k], float(depth[k] + solid.spacing)))
        uncovered &= np.linalg.norm(x - x[k], axis=1) >= result[-1][1]
    return result


def shortened(g: Gaussians, person: SegmentedPerson, joined: Joined) -> Gaussians:
    """Gaussians that do not extend into a segment cut from theirs.

    A long Gaussian hidden under an arm would be a spike once the arm has moved.
    """
    k = np.argmax(g.log_scales, axis=1)
    sigma = np.exp(g.log_scales.max(axis=1).astype(np.float64))
    long = np.flatnonzero(VISIBLE_SIGMAS * sigma > person.solid.spacing)
    means = g.means[long].astype(np.float64)
    axis = matrices_from_quaternions(g.quats[long].astype(np.float64))[np.arange(len(long)), :, k[long]]
    own = person.bone_of_points(means)
    factor, left = np.ones(len(long)), np.ones(len(long), bool)
    for smaller in SHORTENINGS:
        ends = means + np.array([[[VISIBLE_SIGMAS]], [[-VISIBLE_SIGMAS]]]) * (factor * sigma[long])[:, None] * axis
        for end in ends:
            there = person.bone_of_points(end[left])
            apart = (there != own[left]) & ~joined(there, own[left], end[left])
            factor[np.flatnonzero(left)[apart]] = smaller
        left &= factor == smaller
    scales = g.log_scales.copy()
    largest = np.log(factor * sigma[long]).astype(np.float32)
    scales[long] = np.where((factor < 1)[:, None], np.minimum(scales[long], largest[:, None]), scales[long])
    return replace(g, log_scales=scales)


def skeleton_adjacency(body: Retargeted) -> Joined:
    """Pairs of joined segments: trunk with trunk; a limb with it, or with its own next bone, about the joint."""
    at = {n: body.rest[k] for k, n in enumerate(BONES)}
    trunk = np.array([n in TRUNK for n in BONES])
    tree = np.array([-1 if TREE[n] is None else BONES.index(TREE[n]) for n in BONES])
    length, root_radius = np.full(len(BONES), np.inf), np.zeros(len(BONES))
    for s in SIDES:
        for a, b in LIMB_BONES:
            j = BONES.index(f"{s}_{a}")
            length[j] = np.linalg.norm(at[f"{s}_{a}"] - at[f"{s}_{b}"])
            root_radius[j] = ROOT_RADIUS.get(a, 0.0) * length[j]

    def joined(a: np.ndarray, b: np.ndarray, centre: np.ndarray) -> np.ndarray:
        result = trunk[a] & trunk[b]
        for lower, upper in ((a, b), (b, a)):
            off = np.linalg.norm(centre - body.rest[lower], axis=1)
            root = ~trunk[lower] & trunk[tree[lower]]
            result |= root & trunk[upper] & (off < root_radius[lower])
            shorter = np.minimum(length[lower], length[upper])
            result |= ~trunk[lower] & (tree[lower] == upper) & ~trunk[upper] & (off < LIMB_RADIUS * shorter)
        return result

    return joined


MAX_ROUNDS = 20  # of giving disconnected fragments to their neighbours; each removes some


def cut(cage: Cage, label: np.ndarray, joined: Joined) -> tuple[Cage, np.ndarray, np.ndarray]:
    """Open the cage between tets that belong to joints which do not meet there.

    label   joint of each tet, (T,)
    joined  joined(a, b, centre): mask of where tets of joints a and b (n,) stay connected at face centres (n, 3)
    Out.    the cage, still connected; the labels, changed for fragments, (T,); the old index of each vertex
    """
    shared = shared_face_pairs(cage.tets)
    pairs, centre = shared // 4, cage.vertices.astype(np.float64)[tet_faces(cage.tets)[shared[:, 0]]].mean(1)
    label, T = label.copy(), len(cage.tets)

    def kept_pairs() -> np.ndarray:
        a, b = label[pairs[:, 0]], label[pairs[:, 1]]
        return (a == b) | joined(a, b, centre)

    for _ in range(MAX_ROUNDS):
        kept = kept_pairs()
        count, fragment = connected_components(coo_matrix((np.ones(kept.sum()), pairs[kept].T), shape=(T, T)), False)
        if count == 1:
            break
        # A disconnected fragment takes the label it touches most.
        main = np.argmax(np.bincount(fragment))
        over = pairs[~kept]
        over = np.concatenate([over, over[:, ::-1]])
        over = over[(fragment[over[:, 0]] != main) & (fragment[over[:, 0]] != fragment[over[:, 1]])]
        if not len(over):  # fragments that met in a vertex or an edge only
            break
        votes = np.zeros((count, int(label.max()) + 1), int)
        np.add.at(votes, (fragment[over[:, 0]], label[over[:, 1]]), 1)
        for p in np.flatnonzero(votes.any(1)):
            label[fragment == p] = np.argmax(votes[p])
    tets, source = split_vertices(cage.tets, pairs[kept_pairs()])
    return Cage(cage.vertices[source], tets.astype(np.int32), boundary_surface(tets)), label, source


def split_vertices(tets: np.ndarray, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tets (T, 4) that share a vertex only if kept faces connect them, and the old index of each new vertex.

    kept  pairs of tets whose common face stays, (n, 2)
    """
    corner = np.arange(4 * len(tets)).reshape(-1, 4)
    links = []
    for i in range(4):
        for j in range(4):
            same = tets[kept[:, 0], i] == tets[kept[:, 1], j]
            links.append(np.stack([corner[kept[same, 0], i], corner[kept[same, 1], j]], 1))
    links = np.concatenate(links)
    graph = coo_matrix((np.ones(len(links)), links.T), shape=(corner.size,) * 2)
    _, group = connected_components(graph, False)
    _, first, group = np.unique(group, return_index=True, return_inverse=True)
    order = np.argsort(tets.ravel()[first], kind="stable")  # old vertices keep their order
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return rank[group].reshape(-1, 4), tets.ravel()[first[order]]
