"""The player's avatar: hands or controllers, the finger that pokes, the ray that points, corners of the selected body.

Everything is drawn at the pose that the solver used, not at a later one: a hand must not slip on what it holds.
"""

from __future__ import annotations

import numpy as np

from core.vocabulary import BodyState
from display.edit import selection_marker
from display.xr import hand_mesh
from display.xr.actions import FINGER_LENGTH, FINGER_RADIUS, Controller
from display.xr.hand_joints import JOINT_COUNT, rotation_about
from display.xr.hand_mesh import SPACING, discs
from display.xr.poses import pose_matrix
from render.skinned_props import Skin

# Indices of the parts: the joints of both hands, then each side's (left, right) controller.
CONTROLLER, FINGER, FINGERTIP = 2 * JOINT_COUNT, 2 * JOINT_COUNT + 2, 2 * JOINT_COUNT + 4
RAY, TARGET = 2 * JOINT_COUNT + 6, 2 * JOINT_COUNT + 7
CORNERS = TARGET + 1
PART_COUNT = CORNERS + 8
HANDLE_RADIUS, RING_RADIUS, TUBE_RADIUS = 0.013, 0.040, 0.0045  # [m] of a controller, its ring and the ring's tube
RING_TILT = -0.75  # [rad] towards the player
HANDLE_COLOUR, RING_COLOUR = np.array([0.22, 0.23, 0.25]), np.array([0.36, 0.37, 0.40])
FINGER_COLOUR, RAY_COLOUR = np.array([0.86, 0.80, 0.72]), np.array([1.0, 0.83, 0.45])
TARGET_RADIUS, RAY_RADIUS = 0.11, 0.0016  # [m]
TARGET_HEIGHT = 0.03  # [m] over the floor, on which a carpet may lie
RAY_GAUSSIANS = 40
STROKE_GAUSSIANS, STROKE_RADIUS = 8, 0.04  # of a corner; the radius relative to the stroke's length
FINE_SPACING = 0.6 * SPACING  # [m] between Gaussians of thin parts


def skins() -> list[Skin]:
    """Skins of all props; those without a shadow first, as World requires."""
    solid = hand_mesh.hand_skins()
    for side in (0, 1):
        solid.append(rigid_skin(*controller_points(), CONTROLLER + side))
        finger = coloured([(*tube(FINGER_LENGTH, lambda _: FINGER_RADIUS), FINGER_COLOUR)])
        solid.append(rigid_skin(*finger, FINGER + side))
        solid.append(rigid_skin(*coloured([(*dome(FINGER_RADIUS), FINGER_COLOUR)]), FINGERTIP + side))
    return [ray_skin(), target_skin(), *(corner_skin(CORNERS + k) for k in range(8)), *solid]


def rigid_skin(x, n, colour, part: int) -> Skin:
    """Rigid, solid skin of flat Gaussians at points x (N, 3) with normals n (N, 3)."""
    return one_part(discs(x, n, 0.8 * SPACING, 0.0005, colour, np.full(len(x), 0.99)), n, part, solid=True)


def one_part(gaussians, n, part: int, *, solid: bool) -> Skin:
    """Gaussians that one part carries."""
    parts, weight = np.full((len(n), 4), part), np.zeros((len(n), 4))
    weight[:, 0] = 1.0
    return Skin(gaussians, n, parts, weight, solid)


def tube(length: float, radius) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals (N, 3) of a tube from the origin along -z; radius(t) [m] at t = 0..1 of its length."""
    around = max(int(2 * np.pi * radius(0.5) / FINE_SPACING), 6)
    z = np.linspace(0.0, 1.0, max(int(length / FINE_SPACING), 2))
    t, a = np.meshgrid(z, 2 * np.pi * np.arange(around) / around, indexing="ij")
    r = np.vectorize(radius)(t)
    n = np.stack([np.cos(a), np.sin(a), 0 * a], -1).reshape(-1, 3)
    return r.reshape(-1, 1) * n + [0, 0, -length] * t.reshape(-1, 1), n


def dome(radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals (N, 3) of the half of a sphere on the side of -z (a Fibonacci lattice)."""
    count = max(int(2 * np.pi * radius**2 / (0.8 * FINE_SPACING**2)), 12)
    k = np.arange(count) + 0.5
    z, a = k / count, np.pi * (1 + 5**0.5) * k
    s = np.sqrt(1 - z**2)
    n = np.column_stack([s * np.cos(a), s * np.sin(a), -z])
    return radius * n, n


def controller_points() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, normals and colours (N, 3) of a handle with a ring around its head, in the frame of the grip pose."""
    x, n = tube(0.095, lambda t: HANDLE_RADIUS * (1.0 + 0.28 * (2 * t - 1) ** 2))
    end, flip = dome(HANDLE_RADIUS * 1.28), np.array([1.0, 1.0, -1.0])
    patches = [(x + [0, 0, 0.052], n, HANDLE_COLOUR), (end[0] + [0, 0, -0.043], end[1], HANDLE_COLOUR)]
    patches.append((end[0] * flip + [0, 0, 0.052], end[1] * flip, HANDLE_COLOUR))
    angles = (np.arange(0, 2 * np.pi, FINE_SPACING / radius) for radius in (RING_RADIUS, TUBE_RADIUS))
    a, b = np.meshgrid(*angles, indexing="ij")
    n = np.stack([np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), np.sin(b)], -1).reshape(-1, 3)
    ring = TUBE_RADIUS * n + RING_RADIUS * np.stack([np.cos(a), np.sin(a), 0 * a], -1).reshape(-1, 3)
    tilt = rotation_about((1.0, 0.0, 0.0), RING_TILT)
    patches.append((ring @ tilt.T + [0, 0.012, -0.055], n @ tilt.T, RING_COLOUR))
    return coloured(patches)


def coloured(patches) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, normals and colours (N, 3) of patches (points, normals, colour)."""
    x, n = (np.concatenate([p[k] for p in patches]) for k in (0, 1))
    return x, n, np.concatenate([np.tile(p[2], (len(p[0]), 1)) for p in patches])


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
        poses[JOINT_COUNT * h : JOINT_COUNT * (h + 1)] = hand_mesh.skinning_transforms(joints, left=h == 0)
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
