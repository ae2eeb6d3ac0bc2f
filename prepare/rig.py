"""From a prepared body and a rig to a body that moves: cage, weights, embedding, motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_matrix, eye

from assets.animation import Animation, Local, looped, skin, world_of
from assets.asset import Asset, Cage, Embedded
from assets.errors import BadInput
from assets.gltf_rig import Rig
from assets.locate import Locator
from prepare.embed import FURTHEST, embed
from prepare.rig_cut import cut
from prepare.rig_fit import BONES, PARENTS, Fitted, fit
from prepare.rig_landmarks import Landmarks, to_segment
from prepare.rig_names import SIDES, TREE
from prepare.rig_weights import EDGES, HOLD, bone_distances, diffused, firm, least_volumes, strongest

# Radii of what lies about a bone, shares of the stature: a vertex belongs to the bone from which it is fewest radii off
RADIUS = {"pelvis": 0.065, "spine": 0.075, "chest": 0.075, "neck": 0.035, "head": 0.06, "clavicle": 0.035}
RADIUS |= {"shoulder": 0.036, "elbow": 0.032, "wrist": 0.03, "hip": 0.05, "knee": 0.035, "ankle": 0.025}
TRUNK = {"pelvis", "spine", "chest", "neck", "head", "left_clavicle", "right_clavicle"}
SHOULDER_END = 0.7  # of the clavicle: the ball of the shoulder goes with the arm
ROOT_REACH, LIMB_REACH = 0.42, 0.5  # of a limb's bone: about its joint so far, it holds together with what it hangs on
LOOP = 0.3  # [s] in which a motion that does not come round is led to its start
JUMP = (0.01, 0.02)  # [statures], [rad]: what is less comes round by itself
REACH = 1.0  # edges: what is so near a tet of its own part follows that
SHAPES = 48  # frames of the motion in which tets are looked at


@dataclass(frozen=True)
class Skeleton:
    """What moves a cage: joints as in Animation, and the share of each in each vertex."""

    names: list[str]
    parents: np.ndarray
    inverse_bind: np.ndarray
    rest: Local
    frames: Local
    fps: float


def dance(asset: Asset, rig: Rig, marks: Landmarks) -> Asset:
    """A standing person with the motion of a rig that is not its own. Raises BadInput."""
    fitted = fit(rig, marks)
    label, distance, joined, nearest = bones_of(asset.cage, fitted, marks)
    cage, label, source = cut(asset.cage, label, joined)
    V, J = len(cage.vertices), len(BONES)
    votes = np.bincount(cage.tets.ravel().astype(np.int64) * J + np.repeat(label, 4), minlength=V * J).reshape(V, J)
    target = np.eye(J)[np.argmax(votes, axis=1)]
    weights = diffused(cage.vertices, cage.tets, HOLD / distance[source] ** 2, target)
    steps = fitted.rest - np.where((PARENTS >= 0)[:, None], fitted.rest[PARENTS], 0.0)
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (J, 1))
    inverse = np.tile(np.eye(4), (J, 1, 1))
    inverse[:, :3, 3] = -fitted.rest
    rest = (steps, upright, np.ones((J, 3)))
    own = Skeleton(BONES, PARENTS, inverse, rest, fitted.frames, rig.fps)
    parts = Parts(label, nearest(asset.gaussians.means.astype(np.float64)), joined)
    moving = animated(asset, cage, parts, own, weights, on_ground=True)
    residual = {k: [round(v, 4) for v in values] for k, values in fitted.residual.items()}
    of_rig = {
        "motion": rig.animation,
        "landmarks": {k: {"at": np.round(v, 4).tolist(), "from": marks.source[k]} for k, v in marks.points.items()},
        "residual": residual,
    }
    return with_provenance(moving, of_rig)


@dataclass(frozen=True)
class Parts:
    """To which joint what belongs: tets (T,), Gaussians (N,); and joined(a, b, centre) of rig_cut.cut."""

    tets: np.ndarray
    gaussians: np.ndarray
    joined: Callable


def bones_of(cage: Cage, fitted: Fitted, marks: Landmarks) -> tuple[np.ndarray, np.ndarray, Callable, Callable]:
    """The bone (of BONES) of each tet (T,), each vertex's distance from its own [m] (V,), what holds together, and a
    function that tells the bone of points (n, 3)."""
    at = {n: fitted.rest[k] for k, n in enumerate(BONES)}
    low, high = cage.vertices[:, 1].min(), cage.vertices[:, 1].max()
    H = float(high - low)
    child = {"pelvis": "spine", "spine": "chest", "chest": "neck", "neck": "head"}
    segments, owner, radius = [], [], []

    def add(name: str, a, b, r: float | None = None) -> None:
        segments.append((a, b))
        owner.append(BONES.index(name))
        radius.append(r or H * RADIUS[name.split("_")[-1]])

    for a, b in child.items():
        add(a, at[a], at[b])
    add("pelvis", at["left_hip"], at["right_hip"])
    add("head", at["head"], fitted.tips["head"])
    for s in SIDES:
        neck_side, shoulder = at[f"{s}_clavicle"], at[f"{s}_shoulder"]
        add(f"{s}_clavicle", neck_side, neck_side + SHOULDER_END * (shoulder - neck_side))
        for a, b in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle")):
            add(f"{s}_{a}", at[f"{s}_{a}"], at[f"{s}_{b}"])
        for a in ("wrist", "ankle"):
            add(f"{s}_{a}", at[f"{s}_{a}"], fitted.tips[f"{s}_{a}"])
    holder = {"hand": "wrist", "foot": "ankle", "head_top": "head"}
    for by, centre, r in marks.held:
        side, _, limb = by.partition("_")
        add(holder.get(by) or f"{side}_{holder.get(limb, limb)}" if by != "neck" else "neck", centre, centre, r)
    segments = [tuple(np.asarray(p, np.float64) for p in s) for s in segments]
    distance = bone_distances(cage.vertices, cage.tets, segments)
    if not np.isfinite(distance).all():
        raise BadInput("the cage is in several pieces, some of which no bone reaches")
    relative = np.full((len(cage.vertices), len(BONES)), np.inf)
    for k, j in enumerate(owner):
        relative[:, j] = np.minimum(relative[:, j], distance[:, k] / radius[k])
    middles = cage.vertices[cage.tets].mean(1)
    by_tet = relative[cage.tets].mean(1)
    for by, centre, r in marks.held:  # what is held is told by its sphere alone
        side, _, limb = by.partition("_")
        name = holder.get(by) or f"{side}_{holder.get(limb, limb)}" if by != "neck" else "neck"
        by_tet[np.linalg.norm(middles - centre, axis=1) < r, BONES.index(name)] = 0.0
    nearest = np.take_along_axis(distance, np.argmin(distance / radius, axis=1)[:, None], 1)[:, 0]
    trunk = np.array([n in TRUNK for n in BONES])
    length = np.full(len(BONES), np.inf)
    for s in SIDES:
        for a, b in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle")):
            length[BONES.index(f"{s}_{a}")] = np.linalg.norm(at[f"{s}_{a}"] - at[f"{s}_{b}"])
    tree = np.array([-1 if TREE[n] is None else BONES.index(TREE[n]) for n in BONES])

    def joined(a: np.ndarray, b: np.ndarray, centre: np.ndarray) -> np.ndarray:
        """Trunk with trunk; a limb with the trunk, or with its own next bone, about the joint between."""
        result = trunk[a] & trunk[b]
        for lower, upper in ((a, b), (b, a)):
            off = np.linalg.norm(centre - fitted.rest[lower], axis=1)
            root = ~trunk[lower] & trunk[tree[lower]]
            result |= root & trunk[upper] & (off < ROOT_REACH * length[lower])
            shorter = np.minimum(length[lower], length[upper])
            result |= ~trunk[lower] & (tree[lower] == upper) & ~trunk[upper] & (off < LIMB_REACH * shorter)
        return result

    def bone(points: np.ndarray) -> np.ndarray:
        off = np.stack([to_segment(points, a, b) / r for (a, b), r in zip(segments, radius, strict=True)], 1)
        for k in range(len(segments) - len(marks.held), len(segments)):
            off[:, k] = np.where(off[:, k] < 1, 0.0, off[:, k])
        return np.array(owner)[np.argmin(off, axis=1)]

    return np.argmin(by_tet, axis=1), np.maximum(nearest, 0.02 * H), joined, bone


def animated(asset: Asset, cage: Cage, parts: Parts, own: Skeleton, weights: np.ndarray, *, on_ground: bool) -> Asset:
    """The asset with this cage, cut or not, its Gaussians embedded anew, and the motion. Raises BadInput.

    weights  share of each joint in each vertex, (V, J)
    """
    frames = come_round(own, float(np.ptp(cage.vertices[:, 1])))
    joints, strong = strongest(weights)
    matrices = world_of(own.parents, frames) @ own.inverse_bind
    picked = np.linspace(0, len(matrices), min(SHAPES, len(matrices)), endpoint=False).astype(int)
    shapes = np.stack(
        [cage.vertices.astype(np.float64)] + [skin(cage.vertices, joints, strong, matrices[k]) for k in picked]
    )
    if on_ground:
        lift = shapes[0, :, 1].min() - shapes[1:, :, 1].min()
        frames[0][:, 0, 1] += lift
        shapes[1:, :, 1] += lift
    surface = np.unique(cage.surface)
    driven, crushed = firm(strong, cage.tets, surface, shapes)
    g = asset.gaussians
    embedded = embed(g.means, g.quats, np.exp(g.log_scales), cage.vertices, cage.tets)
    embedded, mended = within(embedded, g.means.astype(np.float64), cage, parts)
    motion = Animation(
        list(own.names),
        np.asarray(own.parents, np.int32),
        own.inverse_bind,
        own.rest,
        frames,
        own.fps,
        surface.astype(np.int32),
        joints[surface],
        strong[surface],
        driven[surface],
    )
    figures = {
        "joints": len(own.names),
        "frames": len(frames[0]),
        "seconds": round(float(motion.duration), 3),
        "driven": int(driven.sum()),
        "surface": len(surface),
        "added_vertices": len(cage.vertices) - len(asset.cage.vertices),
        "least_volume_driven": round(crushed, 3),
        "least_volume_skinned": round(float(least_volumes(cage.tets, shapes).min()), 3),
        "largest_stretch_skinned": round(largest_stretch(cage.tets, shapes), 2),
        "kept_to_their_part": mended,
    }
    moving = replace(asset, cage=cage, embedded=embedded, animation=motion)
    return with_provenance(moving, figures)


def come_round(own: Skeleton, size: float) -> Local:
    """The frames of a motion without the last, which is the first again, or is made so."""
    t, q, s = (np.array(x) for x in own.frames)
    if own.fps <= 0 or len(t) < 2:
        raise BadInput("the motion has no frames")
    angle = 2 * np.arccos(np.abs((q[0] * q[-1]).sum(-1)).clip(0, 1)).max()
    if np.abs(t[0] - t[-1]).max() < JUMP[0] * size and angle < JUMP[1]:
        return t[:-1], q[:-1], s[:-1]
    return looped((t, q, s), LOOP, own.fps)


def within(embedded: Embedded, means: np.ndarray, cage: Cage, parts: Parts) -> tuple[Embedded, int]:
    """No Gaussian hangs on both sides of a cut: those that would follow one tet of their own part; and how many do.

    Tets are coarse. What lies in a tet of another part, but near one of its own, follows the latter.
    """
    where = Locator(cage.vertices, cage.tets)
    home = where.find(means)
    out = np.flatnonzero(home < 0)
    if len(out):
        home[out] = where.nearest(means[out])[0]
    edge = where.size(home, means)
    label, wanted = parts.tets, parts.gaussians
    astray = np.flatnonzero((label[home] != wanted) & ~parts.joined(label[home], wanted, means))
    moved = np.zeros(len(means), bool)
    for j in np.unique(wanted[astray]):
        mine, own = astray[wanted[astray] == j], np.flatnonzero(label == j)
        if len(own):
            part = Locator(cage.vertices, cage.tets[own])
            tet, foot = part.nearest(means[mine])
            near = np.linalg.norm(means[mine] - foot, axis=1) < REACH * edge[mine]
            home[mine[near]], moved[mine[near]] = own[tet[near]], True
    V, ends = len(cage.vertices), cage.tets[:, EDGES].reshape(-1, 2)
    link = coo_matrix((np.ones(len(ends)), ends.T), shape=(V, V))
    link = (link + link.T + eye(V)).tocsr()
    link = (link @ link).tocsr()
    which, corner = np.nonzero(label[embedded.host] != label[home][:, None])
    a, b = cage.tets[home[which]], cage.tets[embedded.host[which, corner]]
    linked = np.zeros(len(which), bool)
    for i in range(4):
        for j in range(4):
            linked |= np.asarray(link[a[:, i], b[:, j]]).ravel() > 0
    moved[which[~linked]] = True
    torn = np.flatnonzero(moved)
    host, weights = embedded.host.copy(), embedded.weights.copy()
    if len(torn):
        x = np.einsum("nkj,nkjd->nkd", weights[torn].astype(np.float64), cage.vertices[cage.tets[host[torn]]])
        w = where.weights(np.repeat(home[torn], 4), x.reshape(-1, 3)).reshape(-1, 4, 4)
        middle = w.mean(1, keepdims=True)
        spread = w - middle
        far = np.maximum(np.abs(middle - 0.25).max((1, 2)) / FURTHEST, 1.0)[:, None, None]
        middle = 0.25 + (middle - 0.25) / far  # far outside: towards the tet
        spread /= np.maximum(np.abs(spread).max((1, 2)), 1.0)[:, None, None]
        host[torn], weights[torn] = home[torn][:, None], middle + spread
    return Embedded(host, weights), len(torn)


def largest_stretch(tets: np.ndarray, shapes: np.ndarray) -> float:
    """Of an edge of the tets in shapes (F, V, 3), of 1 in the first."""
    ends = np.unique(np.sort(tets[:, EDGES].reshape(-1, 2), axis=1), axis=0)
    length = [np.linalg.norm(x[ends[:, 0]] - x[ends[:, 1]], axis=1) for x in shapes]
    return float(max((n / length[0]).max() for n in length))


def with_provenance(asset: Asset, of_rig: dict) -> Asset:
    """The asset with more said under "rig"."""
    return replace(asset, provenance=asset.provenance | {"rig": asset.provenance.get("rig", {}) | of_rig})
