"""A rig's motion on a body that is not its own: bones of other lengths, in another pose at rest.

Each bone has a frame [d, h, d x h]: d along it, h the axis about which it bends. In the rig d and h are constant in the
joint's own frame, and are measured over the whole motion, so that no pose of the rig needs to be like the body's; in
the body they follow from the landmarks. Then a bone's turn from the body's pose at rest is

    Q_j(t) = Y  R_j(t) [d h d x h]_rig  [d h d x h]_body^T,     Y the turn about +y from where the rig looks

and joints go x_j = x_parent + Q_parent (p_j - p_parent): lengths are constant.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from assets.animation import Pose, slerp, world_matrices
from assets.formats.gltf_skin import Rig
from core.errors import BadInput
from core.rotation import conjugate_quaternions, multiply_quaternions
from prepare.rig.joint_names import ARM, LEG, SIDES, TREE, named_joints
from prepare.rig.landmarks import Landmarks

BONES = list(TREE)
PARENTS = np.array([-1 if TREE[n] is None else BONES.index(TREE[n]) for n in BONES])
CHEST_AT = 0.36  # of the way from pelvis to neck, where the rig does not tell
STRAIGHT = 0.2  # sine of the angle below which a limb at rest does not tell how it bends
CLAVICLE = 0.2  # of the way from the neck to the shoulder


@dataclass(frozen=True)
class Fitted:
    """A body's own skeleton, of BONES, with the rig's motion.

    rest       joints at rest in the asset's frame [m], (J, 3); their axes are the asset's
    tips       ends of the last bones, {name: (3,)}
    frames     local translation, rotation, scale of each frame, (F, J, ...)
    residual   {landmark: (after a similarity alone, after bones of equal lengths left and right) [m]}
    """

    rest: np.ndarray
    tips: dict[str, np.ndarray]
    frames: Pose
    residual: dict[str, tuple[float, float]]


def frame_of(d: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Axes (..., 3, 3) with columns d, h made upright to d, d x h; any h does where it is along d."""
    d = d / np.maximum(np.linalg.norm(d, axis=-1, keepdims=True), 1e-12)
    other = np.eye(3)[np.argmin(np.abs(d), axis=-1)]
    h = h - (h * d).sum(-1, keepdims=True) * d
    weak = np.linalg.norm(h, axis=-1, keepdims=True) < 1e-6
    h = np.where(weak, other - (other * d).sum(-1, keepdims=True) * d, h)
    h = h / np.linalg.norm(h, axis=-1, keepdims=True)
    return np.stack([d, h, np.cross(d, h)], -1)


def skeleton(rig: Rig, joints: dict[str, int], marks: Landmarks, world: np.ndarray) -> tuple:
    """Joints of the body at rest (J, 3), tips, and the residuals; left and right bones are made equally long."""
    p = marks.points
    hips = 0.5 * (p["left_hip"] + p["right_hip"])
    x = world[:, :, :3, 3]

    def length(a: str, b: str) -> float:
        return float(np.linalg.norm(x[:, joints[a]] - x[:, joints[b]], axis=1).mean())

    down, up = length("pelvis", "chest"), length("chest", "neck")
    at = np.clip(down / max(down + up, 1e-12), 0.15, 0.6) if down + up > 0 else CHEST_AT
    place = {"pelvis": hips, "chest": hips + at * (p["neck"] - hips), "neck": p["neck"]}
    place["spine"] = 0.5 * (hips + place["chest"])
    place["head"] = p["neck"] + 0.3 * (p["head_top"] - p["neck"])
    tips = {"head": p["head_top"]}
    for chain, tip in ((ARM, "hand"), (LEG, "foot")):
        names = (*chain, tip)
        lengths = [
            np.mean([np.linalg.norm(p[f"{s}_{b}"] - p[f"{s}_{a}"]) for s in SIDES])
            for a, b in itertools.pairwise(names)
        ]
        for s in SIDES:
            at_joint = p[f"{s}_{chain[0]}"]
            place[f"{s}_{chain[0]}"] = at_joint
            for a, b, n in zip(names, names[1:], lengths, strict=False):
                way = p[f"{s}_{b}"] - p[f"{s}_{a}"]
                if np.linalg.norm(way) < 1e-9:
                    raise BadInput(f"the landmarks {s}_{a} and {s}_{b} are at one place")
                at_joint = at_joint + n * way / np.linalg.norm(way)
                (tips if b == tip else place)[f"{s}_{b if b != tip else names[-2]}"] = at_joint
            place[f"{s}_clavicle"] = p["neck"] + CLAVICLE * (p[f"{s}_shoulder"] - p["neck"])
    rest = np.array([place[n] for n in BONES])
    shared = [n for n in BONES if n in joints and n in p]
    a, b = x.mean(0)[[joints[n] for n in shared]], np.array([p[n] for n in shared])
    off = np.linalg.norm(similar(a, b) - b, axis=1)
    residual = {n: (float(o), float(np.linalg.norm(place[n] - p[n]))) for n, o in zip(shared, off, strict=True)}
    return rest, tips, residual


def similar(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Points a (n, 3) after the similarity that brings them nearest to b (Umeyama 1991)."""
    ca, cb = a.mean(0), b.mean(0)
    u, s, vt = np.linalg.svd((b - cb).T @ (a - ca))
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    scale = (s * sign).sum() / max(((a - ca) ** 2).sum(), 1e-30)
    return scale * (a - ca) @ (u * sign @ vt).T + cb


def fit(rig: Rig, marks: Landmarks) -> Fitted:
    """The rig's motion on the body of these landmarks. Raises BadInput."""
    joints = named_joints(rig, marks.joints)
    world = world_matrices(rig.parents, rig.frames)
    x, R = world[:, :, :3, 3], world[:, :, :3, :3]
    R = R / np.maximum(np.linalg.norm(R, axis=2, keepdims=True), 1e-12)
    rest, tips, residual = skeleton(rig, joints, marks, world)
    body = {n: rest[k] for k, n in enumerate(BONES)}

    def own(joint: str, v: np.ndarray, weight=None) -> np.ndarray:
        """The mean (3,) of directions v (F, 3) in a joint's own frame."""
        v = np.einsum("fji,fj->fi", R[:, joints[joint]], v)
        v = v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-12)
        return np.average(v, axis=0, weights=weight)

    def at(joint: str) -> np.ndarray:
        return x[:, joints[joint]]

    turns: dict[str, np.ndarray] = {}

    def carry(joint: str, d, h, d_body, h_body) -> None:
        """Turn a bone by [d h]_rig, given in each frame (F, 3) or in the joint's own (3,), against [d h]_body."""
        d, h = (own(joint, v) if v.ndim == 2 else v for v in (d, h))
        turns[joint] = R[:, joints[joint]] @ frame_of(d, h) @ frame_of(d_body, h_body).T

    hips, shoulders = at("left_hip") - at("right_hip"), at("left_shoulder") - at("right_shoulder")
    body_hips = body["left_hip"] - body["right_hip"]
    body_shoulders = body["left_shoulder"] - body["right_shoulder"]
    up = np.array([0, 1.0, 0])
    left = own("chest", shoulders)
    lateral = R[:, joints["chest"]] @ left
    forward = np.cross(lateral, at("neck") - at("chest"))
    body_forward = np.cross(body_shoulders, body["neck"] - body["chest"])
    carry("pelvis", at("chest") - at("pelvis"), hips, body["chest"] - body["pelvis"], body_hips)
    carry("chest", at("neck") - at("chest"), left, body["neck"] - body["chest"], body_shoulders)
    carry("head", at("head") - at("neck"), lateral, up, body_shoulders)
    for s in SIDES:
        clavicle = f"{s}_clavicle"
        if clavicle in joints:
            way = body[f"{s}_shoulder"] - body[clavicle]
            carry(clavicle, at(f"{s}_shoulder") - at(clavicle), forward, way, body_forward)
        for (a, b, c), bend in ((ARM, 1.0), (LEG, -1.0)):
            a, b, c = (f"{s}_{n}" for n in (a, b, c))
            upper, lower = at(b) - at(a), at(c) - at(b)
            axis = np.cross(upper, lower)
            weight = np.linalg.norm(axis, axis=1) ** 2 + 1e-12
            d1, d2 = body[b] - body[a], body[c] - body[b]
            usual = np.cross(d1, bend * body_forward)  # forearms bend forwards, shins backwards
            hinge, sine = np.cross(d1, d2), np.linalg.norm(np.cross(d1, d2))
            sine /= np.linalg.norm(d1) * np.linalg.norm(d2)
            hinge = hinge if sine > STRAIGHT and hinge @ usual > 0 else usual
            h1, h2 = own(a, axis, weight), own(b, axis, weight)
            carry(a, upper, h1, d1, hinge)
            carry(b, lower, h2, d2, hinge)
            # Hand and foot turn about how they are on average.
            beside = R[:, joints[b]].swapaxes(1, 2) @ R[:, joints[c]]
            mean = Rotation.from_matrix(beside).mean().as_matrix()
            turns[c] = R[:, joints[b]] @ beside @ mean.T @ R[:, joints[b]].swapaxes(1, 2) @ turns[b]
    facing = np.cross(hips.mean(0) / np.linalg.norm(hips.mean(0)), up)
    target = np.cross(body_hips, up)
    angle = np.arctan2(target[0], target[2]) - np.arctan2(facing[0], facing[2])
    yaw = Rotation.from_rotvec(angle * up).as_matrix()
    quats = {n: continuous(Rotation.from_matrix(yaw @ t).as_quat()[:, [3, 0, 1, 2]]) for n, t in turns.items()}
    quats["spine"] = slerp(quats["pelvis"], quats["chest"], 0.5)
    quats["neck"] = slerp(quats["chest"], quats["head"], 0.5)
    for s in SIDES:
        quats.setdefault(f"{s}_clavicle", quats["chest"])
    local = np.empty((len(x), len(BONES), 4))
    for k, n in enumerate(BONES):
        local[:, k] = quats[n] if TREE[n] is None else multiply_quaternions(conjugate_quaternions(quats[TREE[n]]), quats[n])
    steps = np.array([rest[k] - (rest[PARENTS[k]] if PARENTS[k] >= 0 else 0) for k in range(len(BONES))])
    moved = np.tile(steps, (len(x), 1, 1))
    rig_leg = np.linalg.norm(at("left_knee") - at("left_hip"), axis=1).mean()
    rig_leg += np.linalg.norm(at("left_ankle") - at("left_knee"), axis=1).mean()
    leg = np.linalg.norm(body["left_knee"] - body["left_hip"]) + np.linalg.norm(body["left_ankle"] - body["left_knee"])
    middle = 0.5 * (at("left_hip") + at("right_hip"))
    moved[:, 0] = rest[0] + leg / rig_leg * (middle - middle.mean(0)) @ yaw.T
    return Fitted(rest, tips, (moved, local, np.ones_like(moved)), residual)


def continuous(q: np.ndarray) -> np.ndarray:
    """Quaternions (F, 4) of one sign: each near the one before."""
    flips = np.cumprod(np.r_[1.0, np.where((q[1:] * q[:-1]).sum(1) < 0, -1.0, 1.0)])
    return q * flips[:, None]
