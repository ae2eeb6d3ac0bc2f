"""The dance: key poses on the beat, joined by smooth curves, as a rig. Side steps, a full turn, kicks, a curtsy.

A key pose says where the pelvis and the feet are and where the arms point; the angles of legs follow by inverse
kinematics, so that standing feet stay where they are.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.spatial.transform import Rotation

from assets.formats.gltf import Rig
from prepare.rig.landmarks import SIDES
from prepare.rig.retargeting import BONES, PARENTS
from studio.dancer.skeleton import HEIGHT

FPS, BEAT_SECONDS = 30.0, 0.5
# Directions of the left upper arm and forearm in the frame of the chest (+x left, +z forward); mirrored for the right.
ARMS = {
    "low": ((0.55, -0.82, -0.10), (0.05, -0.80, 0.60)),
    "side": ((0.95, -0.22, 0.10), (0.55, 0.62, 0.55)),
    "up": ((0.86, 0.48, 0.10), (-0.30, 0.93, 0.20)),
    "hip": ((0.78, -0.56, -0.28), (-0.30, -0.82, 0.48)),
    "front": ((0.45, -0.42, 0.78), (-0.45, 0.05, 0.88)),
    "skirt": ((0.66, -0.74, 0.05), (0.80, -0.55, 0.22)),
}


@dataclass(frozen=True)
class Key:
    """Pose on a beat; lengths in units of the height, angles in radians.

    sway, dip      of the pelvis: to the left, downwards
    yaw, roll      of the pelvis, and `twist` of the chest against it; `bow` of the chest forwards
    left, right    names of ARMS
    feet           (x, y, z) of the left and the right ankle, from where they are at rest, in the pelvis's direction
    """

    sway: float = 0.0
    dip: float = 0.012
    yaw: float = 0.0
    roll: float = 0.0
    twist: float = 0.0
    bow: float = 0.0
    left: str = "low"
    right: str = "low"
    feet: tuple = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def lifted(left: float = 0.0, right: float = 0.0) -> tuple:
    """Feet at rest, but for their heights."""
    return (0.0, left, 0.0), (0.0, right, 0.0)


WIDE = (0.045, 0.0, 0.0), (-0.045, 0.0, 0.0)
TURN = 2 * np.pi
DANCE = (
    # side steps, arms swinging
    Key(0.05, 0.030, 0.15, 0.05, -0.25, 0.0, "side", "front", WIDE),
    Key(0.00, 0.010, 0.0, 0.0, 0.0, 0.0, "low", "low", lifted(0.0, 0.03)),
    Key(-0.05, 0.030, -0.15, -0.05, 0.25, 0.0, "front", "side", WIDE),
    Key(0.00, 0.010, 0.0, 0.0, 0.0, 0.0, "low", "low", lifted(0.03, 0.0)),
    # a full turn, arms rising, in small steps
    Key(0.0, 0.040, -0.35, 0.0, -0.30, 0.0, "side", "front"),
    Key(0.0, -0.006, 0.30 * TURN, 0.0, 0.15, 0.0, "up", "up", lifted(0.02, 0.0)),
    Key(0.0, -0.006, 0.72 * TURN, 0.0, 0.10, 0.0, "up", "up", lifted(0.0, 0.02)),
    Key(0.0, 0.020, TURN, 0.0, 0.0, 0.0, "side", "side"),
    # two kicks, hands on the hips
    Key(0.03, 0.020, TURN, 0.03, 0.10, 0.0, "hip", "hip", ((0.0, 0.0, 0.0), (0.03, 0.15, 0.18))),
    Key(0.0, 0.035, TURN, 0.0, 0.0, 0.0, "hip", "hip"),
    Key(-0.03, 0.020, TURN, -0.03, -0.10, 0.0, "hip", "hip", ((-0.03, 0.15, 0.18), (0.0, 0.0, 0.0))),
    Key(0.0, 0.030, TURN, 0.0, 0.0, 0.0, "side", "side"),
    # a curtsy, and up with both arms
    Key(0.0, 0.085, TURN, 0.0, 0.0, 0.32, "skirt", "skirt", ((0.01, 0.0, 0.05), (0.0, 0.015, -0.075))),
    Key(0.0, 0.085, TURN, 0.0, 0.0, 0.36, "skirt", "skirt", ((0.01, 0.0, 0.05), (0.0, 0.015, -0.075))),
    Key(0.0, 0.000, TURN, 0.0, 0.0, -0.10, "up", "up", lifted()),
    Key(0.0, 0.015, TURN, 0.0, 0.0, 0.0, "side", "side", lifted(0.0, 0.02)),
)


def dance_rig(at: dict[str, np.ndarray]) -> Rig:
    """Skeleton with joints `at` [m] and the dance, FPS poses a second; the last is the first again."""
    x = np.array([at[n] for n in BONES])
    offsets = np.where((PARENTS >= 0)[:, None], x - x[PARENTS], x)
    count = round(len(DANCE) * BEAT_SECONDS * FPS)
    pose = _curves(np.arange(count + 1) / (BEAT_SECONDS * FPS))
    world = _world_rotations(pose, at)
    local = [world[n] if p < 0 else world[BONES[p]].inv() * world[n] for n, p in zip(BONES, PARENTS, strict=True)]
    rotations = np.stack([r.as_quat(scalar_first=True) for r in local], 1)
    translations = np.tile(offsets, (count + 1, 1, 1))
    translations[:, 0] = _pelvis(pose, at)
    ones = np.ones((count + 1, len(BONES), 3))
    rest = (offsets, np.tile([1.0, 0, 0, 0], (len(BONES), 1)), ones[0])
    inverse = np.tile(np.eye(4), (len(BONES), 1, 1))
    inverse[:, :3, 3] = -x
    return Rig(
        list(BONES), PARENTS, np.arange(len(BONES)), inverse, rest, (translations, rotations, ones), FPS, "dance"
    )


def _curves(beat: np.ndarray) -> dict[str, np.ndarray]:
    """Values of all of a key's fields at times `beat` (F,), by curves through the keys; arms as directions."""
    t = np.arange(len(DANCE) + 1)
    found = {}

    def smooth(values) -> np.ndarray:
        values = np.array([*values, values[0]], float)
        return CubicSpline(t, values, bc_type="periodic")(beat)

    for f in fields(Key)[:6]:
        values = [getattr(k, f.name) for k in DANCE]
        if f.name == "yaw":  # keeps on turning, and must not overshoot
            found["yaw"] = PchipInterpolator(t, [*values, values[0] + TURN])(beat)
        else:
            found[f.name] = smooth(values)
    for k, s in enumerate(SIDES):
        mirror = np.array([1.0 - 2.0 * k, 1.0, 1.0])
        for part in (0, 1):
            d = smooth([mirror * ARMS[getattr(key, s)][part] for key in DANCE])
            found[f"{s}_arm{part}"] = d / np.linalg.norm(d, axis=1, keepdims=True)
        # a foot moves between beats, not while it stands
        found[f"{s}_foot"] = PchipInterpolator(t, np.array([key.feet[k] for key in (*DANCE, DANCE[0])]))(beat)
    return found


def _pelvis(pose: dict, at: dict) -> np.ndarray:
    """Positions (F, 3) [m] of the pelvis."""
    zero = 0 * pose["sway"]
    return at["pelvis"] + HEIGHT * np.stack([pose["sway"], -pose["dip"], zero], 1)


def _world_rotations(pose: dict, at: dict) -> dict[str, Rotation]:
    """Rotation of each bone from its rest pose, in the world."""
    yaw = Rotation.from_rotvec(pose["yaw"][:, None] * [0.0, 1.0, 0.0])
    pelvis = yaw * Rotation.from_euler("zx", np.stack([pose["roll"], 0.25 * pose["bow"]], 1))
    chest = pelvis * Rotation.from_euler("yzx", np.stack([pose["twist"], -1.4 * pose["roll"], 0.75 * pose["bow"]], 1))
    gaze = Rotation.from_rotvec((-0.8 * pose["twist"])[:, None] * [0.0, 1.0, 0.0])
    head = chest * gaze * Rotation.from_rotvec((-0.4 * pose["bow"])[:, None] * [1.0, 0.0, 0.0])
    world = {"pelvis": pelvis, "spine": pelvis * (pelvis.inv() * chest) ** 0.5, "chest": chest, "head": head}
    world["neck"] = chest * (chest.inv() * head) ** 0.5
    centre = _pelvis(pose, at)
    for s in SIDES:
        world[f"{s}_clavicle"] = chest
        for name, end, part in (("shoulder", "elbow", 0), ("elbow", "wrist", 1)):
            rest = at[f"{s}_{end}"] - at[f"{s}_{name}"]
            world[f"{s}_{name}"] = chest * _turned(rest / np.linalg.norm(rest), pose[f"{s}_arm{part}"])
        world[f"{s}_wrist"] = world[f"{s}_elbow"]
        hip = centre + pelvis.apply(at[f"{s}_hip"] - at["pelvis"])
        ankle = yaw.apply(at[f"{s}_ankle"] + HEIGHT * pose[f"{s}_foot"])
        thigh, shin = _leg(at, s, hip, ankle, yaw)
        height = pose[f"{s}_foot"][:, 1]
        point = Rotation.from_rotvec((6.0 * height.clip(0.0, 0.12))[:, None] * [1.0, 0.0, 0.0])  # a lifted foot points
        world[f"{s}_hip"], world[f"{s}_knee"], world[f"{s}_ankle"] = thigh, shin, yaw * point
    return world


def _leg(at: dict, side: str, hip: np.ndarray, ankle: np.ndarray, yaw: Rotation) -> tuple[Rotation, Rotation]:
    """Rotations of thigh and shin that bring the ankle there; the knee points forward. Law of cosines."""
    a, b = at[f"{side}_knee"] - at[f"{side}_hip"], at[f"{side}_ankle"] - at[f"{side}_knee"]
    la, lb = np.linalg.norm(a), np.linalg.norm(b)
    d = ankle - hip
    far = np.linalg.norm(d, axis=1)
    d = d / far[:, None]
    far = np.minimum(far, 0.9995 * (la + lb))
    forward = yaw.apply([0.0, 0.0, 1.0])
    forward -= (forward * d).sum(1, keepdims=True) * d
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    cosine = ((la**2 + far**2 - lb**2) / (2 * la * far)).clip(-1, 1)[:, None]
    upper = cosine * d + np.sqrt(1 - cosine**2) * forward
    lower = (far[:, None] * d - la * upper) / lb
    lower /= np.linalg.norm(lower, axis=1, keepdims=True)
    return tuple(
        _frames(bone, forward) * _frames(rest[None] / np.linalg.norm(rest), np.array([[0.0, 0.0, 1.0]])).inv()
        for bone, rest in ((upper, a), (lower, b))
    )


def _frames(along: np.ndarray, forward: np.ndarray) -> Rotation:
    """Rotations whose first axis is `along` (F, 3), unit, and whose second lies near `forward`."""
    second = forward - (forward * along).sum(1, keepdims=True) * along
    second /= np.linalg.norm(second, axis=1, keepdims=True)
    return Rotation.from_matrix(np.stack([along, second, np.cross(along, second)], 2))


def _turned(rest: np.ndarray, directions: np.ndarray) -> Rotation:
    """The smallest rotations that bring the unit vector `rest` to unit directions (F, 3)."""
    axis = np.cross(rest, directions)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(sine, (directions * rest).sum(1, keepdims=True))
    return Rotation.from_rotvec(angle * axis / np.maximum(sine, 1e-12))
