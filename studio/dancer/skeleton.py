"""The dancer's size and joints."""

from __future__ import annotations

import numpy as np

from prepare.rig.landmarks import SIDES

HEIGHT = 0.86  # [m]
# Joints of the left side and the midline in the rest pose, in units of the height; the dancer faces +z.
JOINTS = {
    "pelvis": (0.0, 0.55, 0.0), "spine": (0.0, 0.61, 0.0), "chest": (0.0, 0.67, 0.0), "neck": (0.0, 0.835, 0.0),
    "head": (0.0, 0.865, 0.0), "clavicle": (0.025, 0.81, 0.0), "shoulder": (0.106, 0.798, 0.0),
    "elbow": (0.220, 0.672, 0.0), "wrist": (0.306, 0.556, 0.02), "hand": (0.352, 0.494, 0.036),
    "hip": (0.052, 0.515, 0.0), "knee": (0.060, 0.285, 0.010), "ankle": (0.064, 0.055, -0.004),
    "foot": (0.070, 0.025, 0.092),
}  # fmt: skip


def joint_positions() -> dict[str, np.ndarray]:
    """Positions (3,) [m] of the joints and extremities of both sides, by name."""
    result = {}
    for name, at in JOINTS.items():
        if at[0] == 0.0:
            result[name] = HEIGHT * np.array(at)
        else:
            for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
                result[f"{side}_{name}"] = HEIGHT * np.array([sign * at[0], *at[1:]])
    return result | {"head_top": np.array([0.0, HEIGHT, 0.0])}
