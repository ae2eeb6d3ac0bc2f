"""The player's avatar: hands or controllers, the finger that pokes, the ray that points, corners of the selected body.

Everything is drawn at the pose that the solver used, not at a later one: a hand must not slip on what it holds. Hands,
controllers and finger are modelled by studio/avatar_model.py; the skin of a hand is bound to its 26 joints.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from assets.gaussians import Gaussians
from core.vocabulary import BodyState
from display.edit import selection_marker
from display.xr.actions import FINGER_LENGTH, Controller
from display.xr.hand_joints import BONE_ENDS, FINGERS, JOINT_COUNT, PALM, WRIST, HandJoints, posed
from display.xr.poses import pose_matrix
from render.skinned_props import Skin

MODELS = Path(__file__).with_name("avatar.npz")
# Indices of the parts: the joints of both hands, then each side's (left, right) controller.
CONTROLLER, FINGER, FINGERTIP = 2 * JOINT_COUNT, 2 * JOINT_COUNT + 2, 2 * JOINT_COUNT + 4
RAY, TARGET = 2 * JOINT_COUNT + 6, 2 * JOINT_COUNT + 7
CORNERS = TARGET + 1
PART_COUNT = CORNERS + 8
SPACING = 0.0034  # [m] between Gaussians
SIGMA, THICKNESS = 0.8 * SPACING, 0.0005  # [m] standard deviations: no gap shows the far side
OPAQUE = 0.99
BIND_BENDS = (0.0, 0.02, 0.02, 0.02, 0.02)  # of the model hand's fingers: apart
METACARPALS = [f[0] for f in FINGERS[1:]]
MAX_SCALE, MIN_SCALE = 1.6, 0.6  # of a bone's length and thickness, against the model
RAY_COLOUR = np.array([1.0, 0.83, 0.45])
TARGET_RADIUS, RAY_RADIUS = 0.11, 0.0016  # [m]
TARGET_HEIGHT = 0.03  # [m] over the floor, on which a carpet may lie
RAY_GAUSSIANS = 40
STROKE_GAUSSIANS, STROKE_RADIUS = 8, 0.04  # of a corner; the radius relative to the stroke's length


def skins() -> list[Skin]:
    """Skins of all props; those without a shadow first, as World requires."""
    made = [ray_skin(), target_skin(), *(corner_skin(CORNERS + k) for k in range(8))]
    with np.load(MODELS) as file:
        models = {name: file[name].astype(np.float64) for name in file.files}
    weight = models["hand_weight"] / models["hand_weight"].sum(1, keepdims=True)
    for side, mirror in enumerate(((-1, 1, 1), (1, 1, 1))):
        x, n = models["hand_x"] * mirror, models["hand_n"] * mirror
        part = models["hand_part"].astype(int) + JOINT_COUNT * side
        made.append(Skin(discs(x, n, SIGMA, THICKNESS, models["hand_colour"], OPAQUE), n, part, weight))
    for side in (0, 1):
        for name, first in (("controller", CONTROLLER), ("finger", FINGER), ("fingertip", FINGERTIP)):
            x, n, colour = (models[f"{name}_{what}"] for what in ("x", "n", "colour"))
            made.append(one_part(discs(x, n, SIGMA, THICKNESS, colour, OPAQUE), n, first + side, solid=True))
    return made


def discs(x, n, width: float, thickness: float, colour, opacity) -> Gaussians:
    """Flat Gaussians at x (N, 3), with normals n (N, 3); standard deviations [m]."""
    scales = np.tile(np.log([width, width, thickness]), (len(x), 1))
    opacity = np.broadcast_to(opacity, len(x))
    logit = np.log(opacity / np.maximum(1.0 - opacity, 1e-6))
    return Gaussians.of(x, rotations_to(n), scales, logit, ((colour - 0.5) / 0.28209479)[:, None, :])


def rotations_to(n: np.ndarray) -> np.ndarray:
    """Quaternions wxyz (N, 4) of the shortest rotations from z to the unit vectors n (N, 3)."""
    q = np.column_stack([1.0 + n[:, 2], -n[:, 1], n[:, 0], np.zeros(len(n))])
    q[q[:, 0] < 1e-9] = 0.0, 1.0, 0.0, 0.0
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def one_part(gaussians, n, part: int, *, solid: bool) -> Skin:
    """Gaussians that one part carries."""
    parts, weight = np.full((len(n), 4), part), np.zeros((len(n), 4))
    weight[:, 0] = 1.0
    return Skin(gaussians, n, parts, weight, solid)


def ray_skin() -> Skin:
    """A thin ray along -z, 1 m long when its part has scale 1, fading to its end."""
    t = (np.arange(RAY_GAUSSIANS) + 0.5) / RAY_GAUSSIANS
    x, n = t[:, None] * [0.0, 0.0, -1.0], np.tile([0.0, 0.0, 1.0], (RAY_GAUSSIANS, 1))
    g = discs(x, n, RAY_RADIUS, 0.5 / RAY_GAUSSIANS, np.tile(RAY_COLOUR, (RAY_GAUSSIANS, 1)), 0.75 - 0.45 * t)
    return one_part(g, np.zeros_like(x), RAY, solid=False)


def target_skin() -> Skin:
    """Rings on the floor, around +y."""
    a = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    rings = [(TARGET_RADIUS, 0.85), (0.9 * TARGET_RADIUS, 0.6), (0.2 * TARGET_RADIUS, 0.7)]
    x = np.concatenate([r * np.column_stack([np.cos(a), 0 * a, np.sin(a)]) for r, _ in rings])
    opacity = np.repeat([o for _, o in rings], len(a))
    n = np.tile([0.0, 1.0, 0.0], (len(x), 1))
    g = discs(x, n, 0.006, 0.002, np.tile(RAY_COLOUR, (len(x), 1)), opacity)
    return one_part(g, 0 * n, TARGET, solid=False)


def corner_skin(part: int) -> Skin:
    """Three strokes from the origin along the axes, 1 m long when the part has scale 1."""
    t = (np.arange(STROKE_GAUSSIANS) + 0.5) / STROKE_GAUSSIANS
    axes = np.repeat(np.eye(3), STROKE_GAUSSIANS, axis=0)
    x = axes * np.tile(t, 3)[:, None]
    colour = np.tile(selection_marker.COLOUR, (len(x), 1))
    g = discs(x, axes, STROKE_RADIUS, 0.5 / STROKE_GAUSSIANS, colour, np.full(len(x), 0.95))
    return one_part(g, np.zeros_like(x), part, solid=False)


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
    back = (start - end) / length
    side = np.cross((0.0, 1.0, 0.0), back)
    side = side / np.linalg.norm(side) if np.linalg.norm(side) > 1e-6 else np.array([1.0, 0.0, 0.0])
    poses[RAY] = np.column_stack([side, np.cross(back, side), length * back, start])
    poses[TARGET] = np.column_stack([np.eye(3), end + [0.0, TARGET_HEIGHT, 0.0]])


def show_corners(poses: np.ndarray, body: BodyState) -> None:
    """Out: the corners around a body."""
    at, length = selection_marker.corners(body)
    sides = np.minimum(length, 0.5 * (at[-1] - at[0]))
    for k, signs in enumerate(selection_marker.SIGNS):
        poses[CORNERS + k] = np.column_stack([np.diag(-signs * sides), at[k]])


def skinning_transforms(joints: HandJoints | None, *, left: bool) -> np.ndarray:
    """Transform (26, 3, 4) of the skin by each joint, from the bind pose to `joints`; NaN, hidden, if None.

    A bone of another length or thickness than the model's stretches its skin.
    """
    if joints is None:
        return np.full((JOINT_COUNT, 3, 4), np.nan)
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
