"""A hand's skeleton, and how it looks with its fingers bent: for what is drawn, and for tests.

In the frame of the wrist: -z to the fingers, +y out of the back of the hand, +x to the right. Sizes are those of a
grown-up's hand, 19 cm long.
"""

from __future__ import annotations

import numpy as np

from display.xr.hand_joints import COUNT, FINGERS, PALM, WRIST, Joints, pose_of

# Of a right hand [m]: where each finger's metacarpal and knuckle are, the lengths of its phalanges up to the middle of
# the tip, how it points aside [rad], and the radii [mm] from the metacarpal to the tip.
LONG = (
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
BENDS = np.radians([[82.0, 100.0, 66.0], [16.0, 34.0, 44.0]])  # of a fist: finger's joints; thumb's, from its root
ACROSS = np.array([0.62, -0.62, 0.15])  # where the thumb goes when it bends
RELAXED = (0.15, 0.22, 0.24, 0.28, 0.32)  # how far each finger is bent when nobody does anything, thumb first
MIRROR = np.diag([-1.0, 1.0, 1.0])


def posed(bent=RELAXED, *, left: bool = False, frame: np.ndarray | None = None) -> Joints:
    """A hand whose fingers are bent by these shares of a fist's, thumb first; `frame` (4, 4) is where its wrist is."""
    position, rotation, radius = np.zeros((COUNT, 3)), np.tile(np.eye(3), (COUNT, 1, 1)), np.zeros(COUNT)
    radius[[PALM, WRIST]] = PALM_RADIUS, WRIST_RADIUS
    for finger, share, (root, knuckle, lengths, aside, radii) in zip(FINGERS[1:], bent[1:], LONG, strict=True):
        j = list(finger)
        radius[j] = np.multiply(radii, 1e-3)
        position[j[0]], position[j[1]] = root, knuckle
        rotation[j[0]] = along(np.subtract(knuckle, root))
        turn = about((0.0, 1.0, 0.0), aside * (1.0 - 0.8 * min(share, 1.0)))
        for k, length in enumerate(lengths):
            turn = turn @ about((1.0, 0.0, 0.0), -BENDS[0, k] * share)
            rotation[j[k + 1]] = turn
            position[j[k + 2]] = position[j[k + 1]] - length * turn[:, 2]
        rotation[j[-1]] = turn
    j, (points, radii) = list(FINGERS[0]), THUMB
    radius[j], ways = radii, np.diff(points, axis=0)
    axis = np.cross(ways.sum(0), ACROSS)
    turn, position[j[0]] = np.eye(3), points[0]
    for k, way in enumerate(ways):
        turn = turn @ about(axis, BENDS[1, k] * bent[0])
        rotation[j[k]] = turn @ along(way)
        position[j[k + 1]] = position[j[k]] + turn @ way
    rotation[j[-1]] = rotation[j[-2]]
    position[PALM] = 0.5 * (position[FINGERS[2][0]] + position[FINGERS[2][1]])
    joints = Joints(position, rotation, radius)
    if left:
        joints = Joints(position @ MIRROR, MIRROR @ rotation @ MIRROR, radius)
    return joints.moved(np.eye(4) if frame is None else frame)


def held_by(pose: np.ndarray, bent, *, left: bool) -> Joints:
    """The hand around a controller with this grip pose (4, 4): OpenXR has its x out of a left palm, -z through the fist
    to the thumb's side, y as the back of the fingers looks."""
    # In the frame of a right palm that is straight ahead, the fist's axis runs across the palm, from +x to -x.
    axes = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]).T
    wrist = pose_of(np.zeros(3), axes)
    return posed(bent, left=left, frame=pose @ wrist)


def about(axis, angle: float) -> np.ndarray:
    """Rotation matrix about an axis by an angle [rad] (Rodrigues)."""
    x, y, z = np.asarray(axis, np.float64) / np.linalg.norm(axis)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K


def along(way) -> np.ndarray:
    """A rotation whose -z is this way, its y as near to up as can be."""
    back = -np.asarray(way, np.float64) / np.linalg.norm(way)
    side = np.cross((0.0, 1.0, 0.0), back)
    side /= np.linalg.norm(side)
    return np.column_stack([side, np.cross(back, side), back])
