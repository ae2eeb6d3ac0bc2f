"""Joints of a hand as OpenXR gives them, and a model hand with its fingers bent by any amount.

The order of the 26 joints, and their axes (-z to the fingertip, +y to the back of the hand), are those of
XR_EXT_hand_tracking. The model's frame is the wrist's: -z to the fingers, +y out of the back of the hand, +x to the
right; its size is an adult's hand, 19 cm long. It is what the drawn hand is bound to, and what tests play with.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from display.xr.poses import pose_matrix, rotation_facing

PALM, WRIST, JOINT_COUNT = 0, 1, 26
FINGERS = (range(2, 6), range(6, 11), range(11, 16), range(16, 21), range(21, 26))  # thumb first, tips last
THUMB_TIP, INDEX_KNUCKLE, INDEX_TIP = 5, 7, 10
BONES = tuple((j, j + 1) for finger in FINGERS for j in finger[:-1])
BONE_ENDS = np.array(BONES).T
MIN_RADIUS, MAX_RADIUS = 0.004, 0.025  # [m] of a joint: a runtime may not know them, or report nonsense
# Of a right hand [m]: positions of each finger's metacarpal and knuckle, the lengths of its phalanges up to the middle
# of the tip, its angle to the side [rad], and the radii [mm] from the metacarpal to the tip.
LONG_FINGERS = (
    ((-17e-3, 1e-3, -24e-3), (-25.5e-3, 3e-3, -88e-3), (42e-3, 25e-3, 18e-3), 0.09, (13, 10.8, 9.2, 8.2, 7.0)),
    ((-3e-3, 3e-3, -22e-3), (-4.5e-3, 5e-3, -92e-3), (46e-3, 29e-3, 19e-3), 0.01, (13, 11.0, 9.4, 8.3, 7.1)),
    ((10e-3, 2e-3, -22e-3), (15e-3, 3e-3, -86e-3), (42e-3, 27e-3, 19e-3), -0.07, (12, 10.2, 8.8, 7.8, 6.7)),
    ((20e-3, -2e-3, -22e-3), (32.5e-3, -2e-3, -76e-3), (33e-3, 20e-3, 17e-3), -0.17, (12, 9.2, 7.8, 6.9, 6.0)),
)
THUMB = (
    ((-0.018, -0.008, -0.016), (-0.042, -0.016, -0.045), (-0.058, -0.021, -0.073), (-0.068, -0.023, -0.095)),
    (0.0150, 0.0125, 0.0105, 0.0080),
)
PALM_RADIUS, WRIST_RADIUS = 0.016, 0.021
FIST_BENDS = np.radians([[82.0, 100.0, 66.0], [16.0, 34.0, 44.0]])  # a finger's joints; the thumb's, from its root
THUMB_BEND_DIRECTION = np.array([0.62, -0.62, 0.15])
RELAXED = (0.15, 0.22, 0.24, 0.28, 0.32)  # bend of each finger of a hand at rest, thumb first
MIRROR = np.diag([-1.0, 1.0, 1.0])


@dataclass(frozen=True, eq=False)
class HandJoints:
    """Joints of a hand: position (26, 3) [m], rotation (26, 3, 3), radius (26,) [m], in the play space."""

    position: np.ndarray
    rotation: np.ndarray
    radius: np.ndarray

    def transformed(self, m: np.ndarray) -> HandJoints:
        """The joints in another space, into which m (4, 4) maps."""
        R, t = m[:3, :3], m[:3, 3]
        return HandJoints(self.position @ R.T + t, R @ self.rotation, self.radius)

    def bones(self) -> np.ndarray:
        """The bones as capsules, (19, 7): two ends and a radius [m]."""
        a, b = BONE_ENDS
        radius = np.clip(self.radius, MIN_RADIUS, MAX_RADIUS)
        return np.column_stack([self.position[a], self.position[b], 0.5 * (radius[a] + radius[b])])

    def pinch_point(self) -> np.ndarray:
        """Middle between the tips of thumb and index, (3,) [m]."""
        return 0.5 * (self.position[THUMB_TIP] + self.position[INDEX_TIP])

    def curls(self) -> np.ndarray:
        """Sum of the angles from bone to bone of each finger, thumb first, (5,) [rad]."""
        directions = np.diff(self.position, axis=0)
        directions /= np.maximum(np.sqrt((directions**2).sum(1, keepdims=True)), 1e-9)
        bends = np.arccos(np.clip((directions[1:] * directions[:-1]).sum(1), -1.0, 1.0))  # number j: at joint j + 1
        return np.array([bends[f[1] - 1 : f[-1] - 1].sum() for f in FINGERS])

    def aim(self) -> np.ndarray:
        """Pointing pose (4, 4): from the index knuckle on, away from the wrist, so that pinching does not move it."""
        knuckle, palm = self.position[INDEX_KNUCKLE], self.rotation[PALM]
        forward = knuckle - self.position[WRIST]
        length = np.linalg.norm(forward)
        back = -forward / length if length > 1e-6 else palm[:, 2]
        return pose_matrix(knuckle, rotation_facing(back, palm[:, 1], palm[:, 0]))


def posed(bends=RELAXED, *, left: bool = False) -> HandJoints:
    """The model hand; `bends` (5,) are fractions of a fist's bend, thumb first."""
    position, rotation, radius = np.zeros((JOINT_COUNT, 3)), np.tile(np.eye(3), (JOINT_COUNT, 1, 1)), np.zeros(26)
    radius[[PALM, WRIST]] = PALM_RADIUS, WRIST_RADIUS
    for finger, bend, (root, knuckle, lengths, aside, radii) in zip(FINGERS[1:], bends[1:], LONG_FINGERS, strict=True):
        j = list(finger)
        radius[j] = np.multiply(radii, 1e-3)
        position[j[0]], position[j[1]] = root, knuckle
        rotation[j[0]] = rotation_along(np.subtract(knuckle, root))
        turn = rotation_about((0.0, 1.0, 0.0), aside * (1.0 - 0.8 * min(bend, 1.0)))
        for k, length in enumerate(lengths):
            turn = turn @ rotation_about((1.0, 0.0, 0.0), -FIST_BENDS[0, k] * bend)
            rotation[j[k + 1]] = turn
            position[j[k + 2]] = position[j[k + 1]] - length * turn[:, 2]
        rotation[j[-1]] = turn
    j, (points, radii) = list(FINGERS[0]), THUMB
    radius[j], bones = radii, np.diff(points, axis=0)
    axis = np.cross(bones.sum(0), THUMB_BEND_DIRECTION)
    turn, position[j[0]] = np.eye(3), points[0]
    for k, bone in enumerate(bones):
        turn = turn @ rotation_about(axis, FIST_BENDS[1, k] * bends[0])
        rotation[j[k]] = turn @ rotation_along(bone)
        position[j[k + 1]] = position[j[k]] + turn @ bone
    rotation[j[-1]] = rotation[j[-2]]
    position[PALM] = 0.5 * (position[FINGERS[2][0]] + position[FINGERS[2][1]])
    if left:
        return HandJoints(position @ MIRROR, MIRROR @ rotation @ MIRROR, radius)
    return HandJoints(position, rotation, radius)


def rotation_about(axis, angle: float) -> np.ndarray:
    """Rotation matrix (3, 3) about an axis (3,) of any length by `angle` [rad]."""
    return Rotation.from_rotvec(angle * np.asarray(axis, np.float64) / np.linalg.norm(axis)).as_matrix()


def rotation_along(direction: np.ndarray) -> np.ndarray:
    """Rotation matrix (3, 3) whose -z is this direction, its y as near to up as can be."""
    return rotation_facing(-direction / np.linalg.norm(direction), (0.0, 1.0, 0.0))
