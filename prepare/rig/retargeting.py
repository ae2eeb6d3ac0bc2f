"""Retargeting: a rig's motion on a body with bones of other lengths, in another rest pose.

Each bone has a frame [d, h, d x h]: d along it, h the axis about which it bends. In the rig d and h are constant in the
joint's own frame and are measured over the whole motion, so that no pose of the rig needs to resemble the body's; in
the body they follow from the landmarks. Then a bone's rotation from the body's rest pose is

    Q_j(t) = Y  R_j(t) [d h d x h]_rig  [d h d x h]_body^T,     Y the rotation about +y from where the rig faces

and joints move as x_j = x_parent + Q_parent (p_j - p_parent): lengths are constant.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from assets.animation import Pose, slerp, world_matrices
from assets.formats.gltf import Rig
from assets.orientation import turned_about_up
from core.errors import BadInput
from core.rotation import conjugate_quaternions, multiply_quaternions
from prepare.rig.landmarks import ARM, LEG, SIDES, TREE, Landmarks, match_joints

BONES = list(TREE)
PARENTS = np.array([-1 if TREE[n] is None else BONES.index(TREE[n]) for n in BONES])
CHEST_FRACTION = 0.36  # of the line from pelvis to neck, where the rig does not tell
MIN_BEND = 0.2  # sine of the angle below which a limb at rest does not tell its hinge axis
UP = np.array([0.0, 1.0, 0.0])
CLAVICLE_FRACTION = 0.2  # of the line from the neck to the shoulder


@dataclass(frozen=True)
class Retargeted:
    """A body's own skeleton, of BONES, with the rig's motion.

    rest       joints in the rest pose, in the asset's frame [m], (J, 3); their axes are the asset's
    tips       ends of the last bones, {name: (3,)}
    frames     local translation, rotation, scale of each frame, (F, J, ...)
    residual   distance [m] of each landmark from its joint, as bones have equal lengths left and right
    """

    rest: np.ndarray
    tips: dict[str, np.ndarray]
    frames: Pose
    residual: dict[str, float]


def frame_of(d: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Axes (..., 3, 3) with columns d, h orthogonal to d, and d x h; any h where it is along d."""
    d = d / np.maximum(np.linalg.norm(d, axis=-1, keepdims=True), 1e-12)
    other = np.eye(3)[np.argmin(np.abs(d), axis=-1)]
    h = h - (h * d).sum(-1, keepdims=True) * d
    weak = np.linalg.norm(h, axis=-1, keepdims=True) < 1e-6
    h = np.where(weak, other - (other * d).sum(-1, keepdims=True) * d, h)
    h = h / np.linalg.norm(h, axis=-1, keepdims=True)
    return np.stack([d, h, np.cross(d, h)], -1)


def rest_skeleton(joints: dict[str, int], landmarks: Landmarks, world: np.ndarray) -> tuple:
    """Rest joints of the body (J, 3), tips, and residuals; left and right bones get equal lengths."""
    p = landmarks.points
    hips = 0.5 * (p["left_hip"] + p["right_hip"])
    x = world[:, :, :3, 3]

    def length(a: str, b: str) -> float:
        return float(np.linalg.norm(x[:, joints[a]] - x[:, joints[b]], axis=1).mean())

    down, up = length("pelvis", "chest"), length("chest", "neck")
    at = np.clip(down / max(down + up, 1e-12), 0.15, 0.6) if down + up > 0 else CHEST_FRACTION
    place = {"pelvis": hips, "chest": hips + at * (p["neck"] - hips), "neck": p["neck"]}
    place["spine"] = 0.5 * (hips + place["chest"])
    place["head"] = p["neck"] + 0.3 * (p["head_top"] - p["neck"])
    tips = {"head": p["head_top"]}
    for chain, tip in ((ARM, "hand"), (LEG, "foot")):
        names = (*chain, tip)
        for s in SIDES:
            place[f"{s}_{chain[0]}"] = p[f"{s}_{chain[0]}"]
        for a, b in itertools.pairwise(names):
            bones = {s: p[f"{s}_{b}"] - p[f"{s}_{a}"] for s in SIDES}
            mean = np.mean([np.linalg.norm(bone) for bone in bones.values()])
            for s, bone in bones.items():
                if np.linalg.norm(bone) < 1e-9:
                    raise BadInput(f"the landmarks {s}_{a} and {s}_{b} are at one place")
                end = place[f"{s}_{a}"] + mean * bone / np.linalg.norm(bone)
                if b == tip:
                    tips[f"{s}_{a}"] = end
                else:
                    place[f"{s}_{b}"] = end
    for s in SIDES:
        place[f"{s}_clavicle"] = p["neck"] + CLAVICLE_FRACTION * (p[f"{s}_shoulder"] - p["neck"])
    residual = {n: float(np.linalg.norm(place[n] - p[n])) for n in BONES if n in joints and n in p}
    return np.array([place[n] for n in BONES]), tips, residual


def retarget(rig: Rig, landmarks: Landmarks) -> Retargeted:
    """Skeleton and motion of a body with these landmarks. Raises BadInput."""
    joints = match_joints(rig, landmarks.joints)
    world = world_matrices(rig.parents, rig.frames)
    rest, tips, residual = rest_skeleton(joints, landmarks, world)
    body = {n: rest[k] for k, n in enumerate(BONES)}
    x = {n: world[:, k, :3, 3] for n, k in joints.items()}
    rotations = bone_rotations(joints, world, x, body)
    yaw = facing_rotation(x, body)
    quats = {n: continuous(Rotation.from_matrix(yaw @ r).as_quat()[:, [3, 0, 1, 2]]) for n, r in rotations.items()}
    quats["spine"] = slerp(quats["pelvis"], quats["chest"], 0.5)
    quats["neck"] = slerp(quats["chest"], quats["head"], 0.5)
    for s in SIDES:
        quats.setdefault(f"{s}_clavicle", quats["chest"])
    frames = len(world)
    local = np.empty((frames, len(BONES), 4))
    for k, n in enumerate(BONES):
        local[:, k] = (
            quats[n] if TREE[n] is None else multiply_quaternions(conjugate_quaternions(quats[TREE[n]]), quats[n])
        )
    steps = np.array([rest[k] - (rest[PARENTS[k]] if PARENTS[k] >= 0 else 0) for k in range(len(BONES))])
    translations = np.tile(steps, (frames, 1, 1))
    middle = 0.5 * (x["left_hip"] + x["right_hip"])
    translations[:, 0] = rest[0] + leg_ratio(x, body) * (middle - middle.mean(0)) @ yaw.T
    return Retargeted(rest, tips, (translations, local, np.ones_like(translations)), residual)


def bone_rotations(joints: dict[str, int], world: np.ndarray, x: dict, body: dict) -> dict[str, np.ndarray]:
    """R_j(t) [d h d x h]_rig [d h d x h]_body^T of each bone, (F, 3, 3).

    world  joint matrices of the rig (F, J, 4, 4);  x  its joints (F, 3) by name;  body  rest joints (3,) by name
    """
    R = world[:, :, :3, :3]
    R = R / np.maximum(np.linalg.norm(R, axis=2, keepdims=True), 1e-12)
    found: dict[str, np.ndarray] = {}

    def own(joint: str, v: np.ndarray, weight=None) -> np.ndarray:
        """Mean (3,) of directions v (F, 3) in a joint's own frame."""
        v = np.einsum("fji,fj->fi", R[:, joints[joint]], v)
        v = v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-12)
        return np.average(v, axis=0, weights=weight)

    def rotate(joint: str, d, h, d_body, h_body) -> None:
        """Align [d h]_body with [d h]_rig, given in each frame (F, 3) or in the joint's own frame (3,)."""
        d, h = (own(joint, v) if v.ndim == 2 else v for v in (d, h))
        found[joint] = R[:, joints[joint]] @ frame_of(d, h) @ frame_of(d_body, h_body).T

    body_hips = body["left_hip"] - body["right_hip"]
    body_shoulders = body["left_shoulder"] - body["right_shoulder"]
    left = own("chest", x["left_shoulder"] - x["right_shoulder"])
    lateral = R[:, joints["chest"]] @ left
    forward = np.cross(lateral, x["neck"] - x["chest"])
    body_forward = np.cross(body_shoulders, body["neck"] - body["chest"])
    hips = x["left_hip"] - x["right_hip"]
    rotate("pelvis", x["chest"] - x["pelvis"], hips, body["chest"] - body["pelvis"], body_hips)
    rotate("chest", x["neck"] - x["chest"], left, body["neck"] - body["chest"], body_shoulders)
    rotate("head", x["head"] - x["neck"], lateral, UP, body_shoulders)
    for s in SIDES:
        clavicle = f"{s}_clavicle"
        if clavicle in joints:
            body_clavicle = body[f"{s}_shoulder"] - body[clavicle]
            rotate(clavicle, x[f"{s}_shoulder"] - x[clavicle], forward, body_clavicle, body_forward)
        for (a, b, c), bend in ((ARM, 1.0), (LEG, -1.0)):
            a, b, c = (f"{s}_{n}" for n in (a, b, c))
            upper, lower = x[b] - x[a], x[c] - x[b]
            axis = np.cross(upper, lower)
            weight = np.linalg.norm(axis, axis=1) ** 2 + 1e-12
            d1, d2 = body[b] - body[a], body[c] - body[b]
            usual = np.cross(d1, bend * body_forward)  # forearms bend forwards, shins backwards
            hinge, sine = np.cross(d1, d2), np.linalg.norm(np.cross(d1, d2))
            sine /= np.linalg.norm(d1) * np.linalg.norm(d2)
            hinge = hinge if sine > MIN_BEND and hinge @ usual > 0 else usual
            h1, h2 = own(a, axis, weight), own(b, axis, weight)
            rotate(a, upper, h1, d1, hinge)
            rotate(b, lower, h2, d2, hinge)
            # Hand and foot rotate relative to their mean orientation.
            relative = R[:, joints[b]].swapaxes(1, 2) @ R[:, joints[c]]
            mean = Rotation.from_matrix(relative).mean().as_matrix()
            found[c] = R[:, joints[b]] @ relative @ mean.T @ R[:, joints[b]].swapaxes(1, 2) @ found[b]
    return found


def facing_rotation(x: dict, body: dict) -> np.ndarray:
    """Y: rotation (3, 3) about +y from the rig's mean facing direction to the body's."""
    facing = np.cross((x["left_hip"] - x["right_hip"]).mean(0), UP)
    target = np.cross(body["left_hip"] - body["right_hip"], UP)
    return turned_about_up(np.arctan2(target[0], target[2]) - np.arctan2(facing[0], facing[2]))


def leg_ratio(x: dict, body: dict) -> float:
    """Length of the body's left leg over that of the rig's."""
    bones = (("left_hip", "left_knee"), ("left_knee", "left_ankle"))
    rig_leg = sum(np.linalg.norm(x[b] - x[a], axis=1).mean() for a, b in bones)
    return sum(np.linalg.norm(body[b] - body[a]) for a, b in bones) / rig_leg


def continuous(q: np.ndarray) -> np.ndarray:
    """Quaternions (F, 4) with signs such that each is near the one before."""
    flips = np.cumprod(np.r_[1.0, np.where((q[1:] * q[:-1]).sum(1) < 0, -1.0, 1.0)])
    return q * flips[:, None]
