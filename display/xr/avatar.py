"""The player's avatar: hands or controllers, the finger that pokes, the ray that points, corners of the selected body.
The hands alone are those of a scripted player, in any display.

Everything is drawn at the pose that the solver used, not at a later one: a hand must not slip on what it holds. The
Gaussians are modelled by studio/avatar_model.py; the skin of a hand is bound to its 26 joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

from assets.gaussians import Gaussians
from core.rotation import matrices_from_quaternions, pose_matrix
from core.vocabulary import BodyState, Hand, Vec3
from display.edit import selection_marker
from display.xr.actions import FINGER_LENGTH, Controller
from display.xr.hand_joints import BONE_ENDS, FINGERS, JOINT_COUNT, PALM, THUMB_TIP, WRIST, HandJoints, posed
from display.xr.poses import rotation_facing
from render.skinned_props import Skin

MODELS = Path(__file__).with_name("avatar.npz")
GAUSSIAN_FIELDS = ("means", "quats", "log_scales", "logit_opacities", "sh")
# Indices of the parts: the joints of both hands, then each side's (left, right) controller.
CONTROLLER, FINGER, FINGERTIP = 2 * JOINT_COUNT, 2 * JOINT_COUNT + 2, 2 * JOINT_COUNT + 4
RAY, TARGET = 2 * JOINT_COUNT + 6, 2 * JOINT_COUNT + 7
CORNERS = TARGET + 1
PART_COUNT = CORNERS + 8
BIND_BENDS = (0.0, 0.02, 0.02, 0.02, 0.02)  # of the model hand's fingers: apart
METACARPALS = [f[0] for f in FINGERS[1:]]
MAX_SCALE, MIN_SCALE = 1.6, 0.6  # of a bone's length and thickness, against the model
TARGET_HEIGHT = 0.03  # [m] over the floor, on which a carpet may lie
HOLDING = (0.5, 0.42, 0.42, 0.46, 0.5)  # bend of each finger of a scripted hand that holds something, thumb first
SHOULDERS = np.array([[-0.2, -0.3, 0.1], [0.2, -0.3, 0.1]])  # [m] of a scripted player, from the eye: right, up, back
GRASP_DEPTH, MAX_GRASP_DEPTH = 0.6, 0.3  # of a hand's reach, [m]: how far what it holds is from its fingers


def skins() -> list[Skin]:
    """Skins of all props; those without a shadow first, as World requires."""
    with np.load(MODELS) as file:
        models = {name: file[name] for name in file.files}

    def skin(name: str, first: int, *, solid: bool = True) -> Skin:
        gaussians = Gaussians.of(*(models[f"{name}_{field}"] for field in GAUSSIAN_FIELDS))
        part = first + models[f"{name}_part"].astype(int)
        return Skin(gaussians, models[f"{name}_normal"], part, models[f"{name}_weight"], solid)

    glowing = [("ray", RAY), ("target", TARGET), *(("corner", CORNERS + k) for k in range(8))]
    shaded = [("hand_left", 0), ("hand_right", JOINT_COUNT)]
    for side in (0, 1):
        shaded += [("controller", CONTROLLER + side), ("finger", FINGER + side), ("fingertip", FINGERTIP + side)]
    return [*(skin(*which, solid=False) for which in glowing), *(skin(*which) for which in shaded)]


def scripted_skins() -> list[Skin]:
    """Skins of the two hands of a scripted player, posed by `scripted_poses`."""
    return [skin for skin in skins() if skin.part.max() < CONTROLLER and skin.solid]


def scripted_poses(hands: Sequence[Hand], eye: Vec3, target: Vec3) -> np.ndarray:
    """Poses (52, 3, 4) of a scripted player's hands, as one who looks from `eye` to `target` [m] would hold them.

    They come from the shoulders, and touch from this side what they hold. A hand that holds nothing is hidden: scripts
    leave it in the air where it let go.
    """
    poses = np.full((2 * JOINT_COUNT, 3, 4), np.nan)
    back = np.subtract(eye, target) * [1.0, 0.0, 1.0]
    looking = rotation_facing(back / max(np.linalg.norm(back), 1e-6), (0.0, 1.0, 0.0), np.array([1.0, 0.0, 0.0]))
    for k, hand in enumerate(hands[:2]):
        if not hand.grip:
            continue
        side = k if len(hands) > 1 else 1
        at = np.array(hand.position, np.float64)
        away = np.add(eye, looking @ SHOULDERS[side]) - at
        away /= max(np.linalg.norm(away), 1e-6)
        turn = matrices_from_quaternions(np.array(hand.rotation)) @ rotation_facing(
            away, (0.0, 1.0, 0.0), looking[:, 0]
        )
        joints = posed(HOLDING, left=side == 0)
        grasp = 0.5 * (joints.position[THUMB_TIP] + joints.position[FINGERS[2][-1]])
        touched = at + min(GRASP_DEPTH * hand.reach, MAX_GRASP_DEPTH) * away
        joints = joints.transformed(pose_matrix(touched - turn @ grasp, turn))
        poses[JOINT_COUNT * side : JOINT_COUNT * (side + 1)] = skinning_transforms(joints, left=side == 0)
    return poses


def hidden() -> np.ndarray:
    """Poses of all parts, (PART_COUNT, 3, 4), when nothing is shown."""
    return np.full((PART_COUNT, 3, 4), np.nan)


def show_hand(poses: np.ndarray, h: int, c: Controller, world_from_play: np.ndarray, extension: float) -> None:
    """Out: the poses of side h: a bare hand, or a controller whose finger is stretched by `extension`, 0 to 1."""
    if c.joints is not None:
        joints = c.joints.transformed(world_from_play)
        poses[JOINT_COUNT * h : JOINT_COUNT * (h + 1)] = skinning_transforms(joints, left=h == 0)
    elif c.grip is not None:
        grip = world_from_play @ c.grip
        poses[CONTROLLER + h] = grip[:3]
        if extension > 0.0:
            finger = pose_matrix(grip[:3, 3], (world_from_play @ c.pointer)[:3, :3])
            tip = pose_matrix((0.0, 0.0, -FINGER_LENGTH * extension), np.eye(3))
            poses[FINGER + h] = (finger @ np.diag([1.0, 1.0, extension, 1.0]))[:3]
            poses[FINGERTIP + h] = (finger @ tip)[:3]


def show_ray(poses: np.ndarray, start: np.ndarray, end: np.ndarray) -> None:
    """Out: the ray from start (3,) to a place on the floor (3,) [m], and the target there."""
    length = max(float(np.linalg.norm(end - start)), 1e-6)
    facing = rotation_facing((start - end) / length, (0.0, 1.0, 0.0), np.array([1.0, 0.0, 0.0]))
    poses[RAY] = np.column_stack([facing * [1.0, 1.0, length], start])
    poses[TARGET] = np.column_stack([np.eye(3), end + [0.0, TARGET_HEIGHT, 0.0]])


def show_corners(poses: np.ndarray, body: BodyState) -> None:
    """Out: the corners around a body."""
    at, length = selection_marker.corners(body)
    sides = np.minimum(length, 0.5 * (at[-1] - at[0]))
    for k, signs in enumerate(selection_marker.SIGNS):
        poses[CORNERS + k] = np.column_stack([np.diag(-signs * sides), at[k]])


def skinning_transforms(joints: HandJoints, *, left: bool) -> np.ndarray:
    """Transform (26, 3, 4) of the skin by each joint, from the bind pose to `joints`.

    A bone of another length or thickness than the model's stretches its skin.
    """
    bind, thickness, length = bind_pose(left)
    a, b = BONE_ENDS
    scale = np.ones((JOINT_COUNT, 3))
    scale[a, :2] = ((joints.radius[a] + joints.radius[b]) / thickness)[:, None]
    scale[a, 2] = np.linalg.norm(joints.position[b] - joints.position[a], axis=1) / length
    scale = np.clip(scale, MIN_SCALE, MAX_SCALE)
    scale[[PALM, WRIST]] = scale[METACARPALS, 2].mean()
    A = joints.rotation @ (scale[:, :, None] * np.swapaxes(bind.rotation, 1, 2))
    return np.concatenate([A, (joints.position - np.einsum("jrc,jc->jr", A, bind.position))[..., None]], axis=2)


@cache
def bind_pose(left: bool) -> tuple[HandJoints, np.ndarray, np.ndarray]:
    """Joints of the bind pose, and of each of its bones the sum of the radii at its ends and its length [m], (19,)."""
    bind, (a, b) = posed(BIND_BENDS, left=left), BONE_ENDS
    return bind, bind.radius[a] + bind.radius[b], np.linalg.norm(bind.position[b] - bind.position[a], axis=1)
