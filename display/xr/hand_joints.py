"""A hand's 26 joints: its bones as capsules, when it pinches or makes a fist, and that as a controller's inputs.

The order of the joints, and their axes (-z to the fingertip, +y to the back of the hand), are those of the OpenXR
specification (XR_EXT_hand_tracking).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from display.xr.actions import Controller
from display.xr.finger_poke import moved

PALM, WRIST, COUNT = 0, 1, 26
FINGERS = (range(2, 6), range(6, 11), range(11, 16), range(16, 21), range(21, 26))  # thumb first, tips last
THUMB_TIP, INDEX_KNUCKLE, INDEX_TIP = 5, 7, 10
BONES = tuple((j, j + 1) for finger in FINGERS for j in finger[:-1])
BONE_ENDS = np.array(BONES).T
THINNEST, THICKEST = 0.004, 0.025  # [m], radii: a runtime may not know, or say nonsense
PINCHED, PARTED = 0.015, 0.03  # [m] from thumb tip to index tip
FIST, OPEN = np.radians(150.0), np.radians(105.0)  # a finger's bends together; a fist has 220 degrees, rest 60
FORWARD = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, eq=False)
class Joints:
    """Where a hand's joints are in the play space: position (26, 3) [m], rotation (26, 3, 3), radius (26,) [m]."""

    position: np.ndarray
    rotation: np.ndarray
    radius: np.ndarray

    def moved(self, frame: np.ndarray) -> Joints:
        """The same in another space, which sees this one by `frame` (4, 4)."""
        R, t = frame[:3, :3], frame[:3, 3]
        return Joints(self.position @ R.T + t, R @ self.rotation, self.radius)


def bones(joints: Joints) -> np.ndarray:
    """The bones as capsules, (19, 7): two ends and a radius [m]."""
    a, b = BONE_ENDS
    radius = np.clip(joints.radius, THINNEST, THICKEST)
    return np.column_stack([joints.position[a], joints.position[b], 0.5 * (radius[a] + radius[b])])


def curls(joints: Joints) -> np.ndarray:
    """How far each finger is bent, thumb first, (5,) [rad]: the sum of the angles from bone to bone."""
    ways = np.diff(joints.position, axis=0)
    ways /= np.maximum(np.sqrt((ways**2).sum(1, keepdims=True)), 1e-9)
    bends = np.arccos(np.clip((ways[1:] * ways[:-1]).sum(1), -1.0, 1.0))  # number j: at joint j + 1
    return np.array([bends[f[1] - 1 : f[-1] - 1].sum() for f in FINGERS])


def pose_of(position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """(4, 4) of a place and an attitude."""
    m = np.eye(4)
    m[:3, :3], m[:3, 3] = rotation, position
    return m


def aim_of(joints: Joints) -> np.ndarray:
    """Where a hand points, (4, 4): from the knuckle of the index on, away from the wrist, so that pinching keeps it."""
    knuckle = joints.position[INDEX_KNUCKLE]
    way = knuckle - joints.position[WRIST]
    length = np.linalg.norm(way)
    way = way / length if length > 1e-6 else joints.rotation[PALM] @ FORWARD
    side = np.cross(joints.rotation[PALM][:, 1], -way)
    side = side / np.linalg.norm(side) if np.linalg.norm(side) > 1e-3 else joints.rotation[PALM][:, 0]
    return pose_of(knuckle, np.column_stack([side, np.cross(-way, side), -way]))


class HandInput:
    """What one bare hand does, frame by frame, as if it held a controller: a fist grabs, finger and thumb pinch."""

    def __init__(self):
        self._does: str | None = None  # "grab" or "pinch"

    def read(self, joints: Joints | None) -> Controller:
        """The controller that the hand is now. A hand that is not tracked goes on with what it did."""
        if joints is None:
            return Controller()
        palm = pose_of(joints.position[PALM], joints.rotation[PALM])
        tip = 0.5 * (joints.position[THUMB_TIP] + joints.position[INDEX_TIP])
        self._does = self._doing(joints)
        return Controller(
            grip=palm if self._does == "grab" else moved(palm, tip),
            aim=aim_of(joints),
            grab=float(self._does == "grab"),
            pinch=float(self._does == "pinch"),
            fingers=bones(joints),
            tip=tip,
            joints=joints,
        )

    def _doing(self, joints: Joints) -> str | None:
        apart = float(np.linalg.norm(joints.position[THUMB_TIP] - joints.position[INDEX_TIP]))
        _, index, *others = curls(joints)
        bent = min(index, float(np.mean(others)))  # a hand that points with its index does not grab
        if self._does == "grab" and bent > OPEN:
            return "grab"
        if self._does == "pinch" and apart < PARTED:
            return "pinch"
        if bent > FIST:
            return "grab"
        return "pinch" if apart < PINCHED else None
