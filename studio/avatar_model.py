"""The avatar of players, as Gaussians: hands, controllers, finger, ray, marks; display/xr/avatar.npz.

    python -m studio.avatar_model

The skin of a hand is the zero set of a distance to bones of varying thickness, which blend into one another within a
finger and into the palm, but not from finger to finger: phi = min over fingers of smin(palm, smin(phalanges)), with the
smooth minimum smin(d) = -k log sum exp(-d / k). Its points are bound to the 26 joints of the model hand.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from assets.gaussians import Gaussians
from core.spherical_harmonics import C0
from display.edit import selection_marker
from display.xr.actions import FINGER_LENGTH, FINGER_RADIUS
from display.xr.avatar import BIND_BENDS, GAUSSIAN_FIELDS, MODELS
from display.xr.hand_joints import FINGERS, JOINT_COUNT, WRIST, HandJoints, posed, rotation_about
from render.skinned_props import Skin

SPACING = 0.0034  # [m] between Gaussians
SIGMA, THICKNESS = 0.8 * SPACING, 0.0005  # [m] standard deviations: no gap shows the far side
OPAQUE = 0.99
RAY_COLOUR = np.array([1.0, 0.83, 0.45])
TARGET_RADIUS, RAY_RADIUS = 0.11, 0.0016  # [m]
RAY_GAUSSIANS = 40
STROKE_GAUSSIANS, STROKE_RADIUS = 8, 0.04  # of a corner; the radius relative to the stroke's length
SEEDS_PER_POINT = 6  # points to choose from, for each that is taken
SMOOTHING = 0.0035  # [m]: k
WEIGHT_FALLOFF = 0.0035  # [m] over which the weight of a bone fades into the next one's
SKIN_COLOUR = np.array([0.87, 0.73, 0.63])  # a generic light, warm tone
NAIL_COLOUR, CREASE_DARKENING = np.array([0.96, 0.84, 0.77]), 0.10
FOREARM_LENGTH = 0.045  # [m]
HANDLE_RADIUS, RING_RADIUS, TUBE_RADIUS = 0.013, 0.040, 0.0045  # [m] of a controller, its ring and the ring's tube
RING_TILT = -0.75  # [rad] towards the player
HANDLE_COLOUR, RING_COLOUR = np.array([0.22, 0.23, 0.25]), np.array([0.36, 0.37, 0.40])
FINGER_COLOUR = np.array([0.86, 0.80, 0.72])
FINE_SPACING = 0.6 * SPACING  # [m] between Gaussians of thin parts


def write_models() -> None:
    """Write display/xr/avatar.npz."""
    np.savez_compressed(MODELS, **avatar_models())


def avatar_models() -> dict[str, np.ndarray]:
    """Arrays of all models by NAME_FIELD: Gaussians, normals, parts from 0 on and weights."""
    models = {
        "ray": ray(),
        "target": target(),
        "corner": corner(),
        "hand_left": hand((-1, 1, 1)),
        "hand_right": hand((1, 1, 1)),
        "controller": shaded(*controller_points()),
        "finger": shaded(*coloured([(*tube(FINGER_LENGTH, lambda _: FINGER_RADIUS), FINGER_COLOUR)])),
        "fingertip": shaded(*coloured([(*dome(FINGER_RADIUS), FINGER_COLOUR)])),
    }
    arrays = {}
    for name, model in models.items():
        arrays |= {f"{name}_{field}": getattr(model.gaussians, field) for field in GAUSSIAN_FIELDS}
        arrays |= {f"{name}_normal": model.normal.astype(np.float32), f"{name}_part": model.part.astype(np.uint8)}
        arrays[f"{name}_weight"] = model.weight.astype(np.float32)
    return arrays


def discs(x, n, width: float, thickness: float, colour, opacity) -> Gaussians:
    """Flat Gaussians at x (N, 3), with normals n (N, 3); standard deviations [m]."""
    scales = np.tile(np.log([width, width, thickness]), (len(x), 1))
    opacity = np.broadcast_to(opacity, len(x))
    logit = np.log(opacity / np.maximum(1.0 - opacity, 1e-6))
    return Gaussians.of(x, rotations_to(n), scales, logit, ((colour - 0.5) / C0)[:, None, :])


def rotations_to(n: np.ndarray) -> np.ndarray:
    """Quaternions wxyz (N, 4) of the shortest rotations from z to the unit vectors n (N, 3)."""
    q = np.column_stack([1.0 + n[:, 2], -n[:, 1], n[:, 0], np.zeros(len(n))])
    q[q[:, 0] < 1e-9] = 0.0, 1.0, 0.0, 0.0
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def on_one_part(gaussians: Gaussians, n) -> Skin:
    """Gaussians that the first part carries; n (N, 3) are their normals, 0 where they glow."""
    weight = np.zeros((len(n), 4))
    weight[:, 0] = 1.0
    return Skin(gaussians, n, np.zeros((len(n), 4)), weight)


def ray() -> Skin:
    """A thin ray along -z, 1 m long when its part has scale 1, fading to its end."""
    t = (np.arange(RAY_GAUSSIANS) + 0.5) / RAY_GAUSSIANS
    x, n = t[:, None] * [0.0, 0.0, -1.0], np.tile([0.0, 0.0, 1.0], (RAY_GAUSSIANS, 1))
    g = discs(x, n, RAY_RADIUS, 0.5 / RAY_GAUSSIANS, np.tile(RAY_COLOUR, (RAY_GAUSSIANS, 1)), 0.75 - 0.45 * t)
    return on_one_part(g, 0 * n)


def target() -> Skin:
    """Rings on the floor, around +y."""
    a = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    rings = [(TARGET_RADIUS, 0.85), (0.9 * TARGET_RADIUS, 0.6), (0.2 * TARGET_RADIUS, 0.7)]
    x = np.concatenate([r * np.column_stack([np.cos(a), 0 * a, np.sin(a)]) for r, _ in rings])
    opacity = np.repeat([o for _, o in rings], len(a))
    n = np.tile([0.0, 1.0, 0.0], (len(x), 1))
    return on_one_part(discs(x, n, 0.006, 0.002, np.tile(RAY_COLOUR, (len(x), 1)), opacity), 0 * n)


def corner() -> Skin:
    """Three strokes from the origin along the axes, 1 m long when the part has scale 1."""
    t = (np.arange(STROKE_GAUSSIANS) + 0.5) / STROKE_GAUSSIANS
    axes = np.repeat(np.eye(3), STROKE_GAUSSIANS, axis=0)
    x = axes * np.tile(t, 3)[:, None]
    colour = np.tile(selection_marker.COLOUR, (len(x), 1))
    return on_one_part(discs(x, axes, STROKE_RADIUS, 0.5 / STROKE_GAUSSIANS, colour, 0.95), 0 * axes)


def shaded(x, n, colour) -> Skin:
    """Opaque Gaussians at points x with normals n and colours (N, 3) that the first part carries."""
    return on_one_part(discs(x, n, SIGMA, THICKNESS, colour, OPAQUE), n)


def hand(mirror) -> Skin:
    """The skin of a hand; `mirror` (3,) makes the right one the left one."""
    joints = posed(BIND_BENDS)
    x, n, finger = surface_points(joints)
    part, weight = joint_weights(joints, x, finger)
    g = discs(x * mirror, n * mirror, SIGMA, THICKNESS, paint(joints, x, n), OPAQUE)
    return Skin(g, n * mirror, part, weight)


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


def limb_groups(joints: HandJoints) -> list[list[tuple]]:
    """Limbs (a, b, radius at a, radius at b) of the palm, then of each finger."""
    p, r = joints.position, joints.radius
    palm = [(p[f[0]], p[f[1]], 0.95 * r[f[0]], 1.08 * r[f[1]]) for f in FINGERS]
    knuckles = [p[f[1]] - [0, 0.0015, 0] for f in FINGERS[1:]]
    palm += [(a, b, 0.0105, 0.0105) for a, b in pairwise(knuckles)]
    heel = [p[f[0]] + [0, -0.006, 0] for f in FINGERS[1:]]
    palm += [(a, b, 0.0125, 0.0125) for a, b in pairwise(heel)]
    middle = [0.5 * (p[f[0]] + p[f[1]]) + [0, -0.004, 0] for f in FINGERS[1:]]
    palm += [(a, b, 0.0115, 0.0115) for a, b in pairwise(middle)]
    palm += [(p[2] + [0.003, -0.002, 0], p[3] + [0.008, 0, 0.006], 0.016, 0.0125)]  # the ball of the thumb
    palm += [(heel[-1], middle[-1] + [0.002, -0.003, 0.01], 0.0135, 0.0115)]  # and of the little finger
    palm += [(p[3], middle[0] + [-0.004, 0.001, -0.004], 0.009, 0.0085)]  # the web between thumb and index
    for side in (-0.011, 0.011):
        end = np.array([side * 0.95, -0.002, FOREARM_LENGTH])
        palm.append((np.array([side, -0.002, -0.012]), end, 0.0165, 0.0175))
    return [palm, *([(p[a], p[a + 1], r[a], r[a + 1]) for a in f[1:-1]] for f in FINGERS)]


def limb_distance(x, a, b, ra: float, rb: float) -> np.ndarray:
    """Approximate distance (N,) of points to a limb whose radius goes evenly from ra to rb."""
    axis = b - a
    t = np.clip((x - a) @ axis / max(axis @ axis, 1e-12), 0.0, 1.0)
    return np.linalg.norm(x - a - t[:, None] * axis, axis=1) - (ra + t * (rb - ra))


def smooth_min(d: np.ndarray, k: float) -> np.ndarray:
    """-k log sum exp(-d / k) over the rows of d."""
    low = d.min(0)
    return low - k * np.log(np.exp(-(d - low) / k).sum(0))


def skin_distance(groups, x) -> np.ndarray:
    """phi of the docstring above, (N,)."""
    palm, *fingers = [smooth_min(np.array([limb_distance(x, *limb) for limb in g]), SMOOTHING) for g in groups]
    return np.min([smooth_min(np.array([palm, f]), SMOOTHING) for f in fingers], axis=0)


def skin_normal(groups, x, step: float = 2e-4) -> np.ndarray:
    """Unit gradient of `skin_distance`, (N, 3), by differences at the corners of a tetrahedron."""
    corners = np.array([[1, -1, -1], [-1, -1, 1], [-1, 1, -1], [1, 1, 1]], np.float64)
    g = sum(skin_distance(groups, x + step * c)[:, None] * c for c in corners)
    return g / np.maximum(np.linalg.norm(g, axis=1, keepdims=True), 1e-12)


def poisson_subset(x, min_distance: float) -> np.ndarray:
    """Indices of points of x (N, 3) at least `min_distance` [m] from one another, taken in order."""
    taken, free = [], np.ones(len(x), bool)
    for k, near in enumerate(cKDTree(x).query_ball_point(x, min_distance)):
        if free[k]:
            taken.append(k)
            free[near] = False
    return np.array(taken)


def surface_points(joints: HandJoints) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Evenly spaced points of the skin (N, 3) [m], outward normals (N, 3), and the finger of each, 0 for the palm."""
    groups, rng = limb_groups(joints), np.random.default_rng(0)
    seeds, finger = [], []
    for k, group in enumerate(groups):
        for a, b, ra, rb in group:
            area = 2 * np.pi * max(ra, rb) * (np.linalg.norm(b - a) + 2 * max(ra, rb))
            count = int(SEEDS_PER_POINT * area / SPACING**2)
            n = rng.normal(size=(count, 3))
            t = rng.uniform(-0.15, 1.15, count).clip(0, 1)[:, None]
            seeds.append(a + t * (b - a) + (ra + t * (rb - ra)) * n / np.linalg.norm(n, axis=1, keepdims=True))
            finger.append(np.full(count, k))
    x, finger = np.concatenate(seeds), np.concatenate(finger)

    def keep(chosen) -> None:
        nonlocal x, finger
        x, finger = x[chosen], finger[chosen]

    keep(rng.permutation(len(x)))
    keep(skin_distance(groups, x) > -0.010)  # points deep inside other limbs are not skin
    keep(poisson_subset(x, 0.4 * SPACING))
    for _ in range(3):
        x = x - skin_distance(groups, x)[:, None] * skin_normal(groups, x)
    keep(np.abs(skin_distance(groups, x)) < 4e-4)
    keep(poisson_subset(x, 0.9 * SPACING))
    return x, skin_normal(groups, x), finger


def joint_weights(joints: HandJoints, x, finger) -> tuple[np.ndarray, np.ndarray]:
    """Joints that carry each point, (N, 4), and their weights, (N, 4): bones near it, of its finger or the palm."""
    p, r = joints.position, joints.radius
    distance = np.full((len(x), JOINT_COUNT), 1.0)
    for k, f in enumerate(FINGERS, start=1):
        for j in f[:-1]:
            allowed = (finger == k) | (j == f[0]) | ((finger == 0) & (j == f[1]))
            d = limb_distance(x, p[j], p[j + 1], r[j], r[j + 1])
            distance[:, j] = np.where(allowed, d, 1.0)
    distance[:, WRIST] = limb_distance(x, p[WRIST] + [0, 0, 0.1], p[WRIST], 0.02, 0.02)
    all_weights = np.exp(-(distance - distance.min(1, keepdims=True)) / WEIGHT_FALLOFF)
    joint = np.argsort(-all_weights, axis=1)[:, :4]
    weight = np.take_along_axis(all_weights, joint, axis=1)
    weight[weight < 0.02] = 0.0
    return joint, weight / weight.sum(1, keepdims=True)


def paint(joints: HandJoints, x, n) -> np.ndarray:
    """Colours (N, 3): darker in hollows and at the joints, nails, a paler palm."""
    openness = np.clip(skin_distance(limb_groups(joints), x + 0.009 * n) / 0.009, 0.0, 1.0)[:, None]
    colour = SKIN_COLOUR * (0.70 + 0.30 * openness)
    colour = colour * (1.0 + 0.05 * np.clip(-n[:, 1:2], -1.0, 1.0))
    p = joints.position
    for f in FINGERS:
        for j in f[2:-1]:
            along = np.abs((x - p[j]) @ joints.rotation[j][:, 2])
            close = np.linalg.norm(x - p[j], axis=1) < 1.6 * joints.radius[j]
            colour = colour * (1.0 - CREASE_DARKENING * (np.exp(-((along / 0.0016) ** 2)) * close)[:, None])
        tip, up, forward = f[-1], joints.rotation[f[-2]][:, 1], -joints.rotation[f[-2]][:, 2]
        if f is FINGERS[0]:
            up = joints.rotation[f[-2]] @ np.array([-0.5, 0.87, 0.0])
        r = joints.radius[tip]
        d = x - (p[tip] + 0.15 * r * forward)
        across, ahead = np.abs(d @ np.cross(up, forward)), d @ forward
        nail = (n @ up > 0.55) & (across < 0.72 * r) & (np.abs(ahead) < 0.95 * r) & (d @ up > 0)
        colour[nail] = NAIL_COLOUR
    return colour.clip(0.02, 0.98)


if __name__ == "__main__":
    write_models()
