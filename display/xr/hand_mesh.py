"""A hand to look at: a skin of flat Gaussians over the bones of display/xr/hand_skeleton.py, bound to 26 joints.

The skin is the surface of bones of varying thickness, which flow into one another within a finger and into the palm,
but not from finger to finger: phi = min over fingers of smin(palm, smin(phalanges)), with the smooth minimum
smin(d) = -k log sum exp(-d / k).
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from assets.gaussians import Gaussians
from display.xr.hand_joints import BONES, COUNT, FINGERS, PALM, WRIST, Joints
from display.xr.hand_skeleton import posed
from render.skinned_props import Skin

SPACING = 0.0034  # [m] between Gaussians
WIDTH = 0.8  # spacings: standard deviation of a Gaussian, so that no gap shows the far side
SEEDS = 6  # points to choose from, for each that is taken
ROUND = 0.0035  # [m]: k
FLAT = 0.0005  # [m], the thickness of a Gaussian
REACH = 0.0035  # [m] over which the pull of a bone fades into the next one's
COLOUR = np.array([0.87, 0.73, 0.63])  # light and warm, of nobody in particular
NAIL, CREASE = np.array([0.96, 0.84, 0.77]), 0.10
CUFF = 0.045  # [m] of forearm
SPREAD = (0.0, 0.02, 0.02, 0.02, 0.02)  # bent, of the bound hand: fingers apart
STARTS, ENDS = np.array(BONES).T
ROOTS = [f[0] for f in FINGERS[1:]]
LARGEST, SMALLEST = 1.6, 0.6  # of the model, a bone's length and thickness


def skins() -> list[Skin]:
    """The Gaussians of a left and of a right hand, whose joints are the parts 0..25 and 26..51."""
    joints = posed(SPREAD)
    x, n, owner = surface(joints)
    part, weight = weights(joints, x, owner)
    colour = paint(joints, x, n)
    opacity = np.full(len(x), 0.99)
    result = []
    for side, mirror in enumerate(((-1, 1, 1), (1, 1, 1))):
        g = discs(x * mirror, n * mirror, WIDTH * SPACING, FLAT, colour, opacity)
        result.append(Skin(g, n * mirror, part + COUNT * side, weight))
    return result


def discs(x, n, width: float, thickness: float, colour, opacity) -> Gaussians:
    """Flat Gaussians at x (N, 3), with normals n (N, 3); standard deviations [m]."""
    quats = facing(n)
    scales = np.tile(np.log([width, width, thickness]), (len(x), 1))
    logit = np.log(opacity / np.maximum(1.0 - opacity, 1e-6))
    return Gaussians.of(x, quats, scales, logit, ((colour - 0.5) / 0.28209479)[:, None, :])


def facing(n: np.ndarray) -> np.ndarray:
    """Quaternions wxyz (N, 4) that turn z to the unit vectors n (N, 3), the shortest way."""
    q = np.column_stack([1.0 + n[:, 2], -n[:, 1], n[:, 0], np.zeros(len(n))])
    q[q[:, 0] < 1e-9] = 0.0, 1.0, 0.0, 0.0
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def limbs(joints: Joints) -> list[list[tuple]]:
    """(a, b, radius at a, radius at b) of what makes up the palm, then each finger."""
    p, r = joints.position, joints.radius
    palm = [(p[f[0]], p[f[1]], 0.95 * r[f[0]], 1.08 * r[f[1]]) for f in FINGERS]
    knuckles = [p[f[1]] - [0, 0.0015, 0] for f in FINGERS[1:]]
    palm += [(a, b, 0.0105, 0.0105) for a, b in pairwise(knuckles)]
    down = np.array([0.0, -0.006, 0.0])
    heel = [p[f[0]] + down for f in FINGERS[1:]]
    palm += [(a, b, 0.0125, 0.0125) for a, b in pairwise(heel)]
    middle = [0.5 * (p[f[0]] + p[f[1]]) + [0, -0.004, 0] for f in FINGERS[1:]]
    palm += [(a, b, 0.0115, 0.0115) for a, b in pairwise(middle)]
    palm += [(p[2] + [0.003, -0.002, 0], p[3] + [0.008, 0, 0.006], 0.016, 0.0125)]  # the ball of the thumb
    palm += [(heel[-1], middle[-1] + [0.002, -0.003, 0.01], 0.0135, 0.0115)]  # and of the little finger
    palm += [(p[3], middle[0] + [-0.004, 0.001, -0.004], 0.009, 0.0085)]  # the web between thumb and index
    for side in (-0.011, 0.011):
        end = np.array([side * 0.95, -0.002, CUFF])
        palm.append((np.array([side, -0.002, -0.012]), end, 0.0165, 0.0175))
    return [palm, *([(p[a], p[a + 1], r[a], r[a + 1]) for a in f[1:-1]] for f in FINGERS)]


def cone(x, a, b, ra: float, rb: float) -> np.ndarray:
    """Distance of points from a limb, about: its radius goes evenly from ra to rb."""
    way = b - a
    t = np.clip((x - a) @ way / max(way @ way, 1e-12), 0.0, 1.0)
    return np.linalg.norm(x - a - t[:, None] * way, axis=1) - (ra + t * (rb - ra))


def smooth_min(d: np.ndarray, k: float) -> np.ndarray:
    """-k log sum exp(-d / k) over the rows of d."""
    low = d.min(0)
    return low - k * np.log(np.exp(-(d - low) / k).sum(0))


def distance(groups, x) -> np.ndarray:
    """phi of the docstring above, (N,)."""
    palm, *fingers = [smooth_min(np.array([cone(x, *limb) for limb in g]), ROUND) for g in groups]
    return np.min([smooth_min(np.array([palm, f]), ROUND) for f in fingers], axis=0)


def gradient(groups, x, step: float = 2e-4) -> np.ndarray:
    """Unit gradient of `distance`, (N, 3), by differences at the corners of a tetrahedron."""
    corners = np.array([[1, -1, -1], [-1, -1, 1], [-1, 1, -1], [1, 1, 1]], np.float64)
    g = sum(distance(groups, x + step * c)[:, None] * c for c in corners)
    return g / np.maximum(np.linalg.norm(g, axis=1, keepdims=True), 1e-12)


def apart(x, least: float) -> np.ndarray:
    """Indices of points (N, 3) that are `least` [m] or more from one another, taken in order."""
    taken, free = [], np.ones(len(x), bool)
    for k, near in enumerate(cKDTree(x).query_ball_point(x, least)):
        if free[k]:
            taken.append(k)
            free[near] = False
    return np.array(taken)


def surface(joints: Joints) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Evenly spaced points of the skin (N, 3) [m], outward normals (N, 3), and the finger of each, 0 for the palm."""
    groups, rng = limbs(joints), np.random.default_rng(0)
    seeds, owner = [], []
    for k, group in enumerate(groups):
        for a, b, ra, rb in group:
            area = 2 * np.pi * max(ra, rb) * (np.linalg.norm(b - a) + 2 * max(ra, rb))
            count = int(SEEDS * area / SPACING**2)
            way = rng.normal(size=(count, 3))
            t = rng.uniform(-0.15, 1.15, count).clip(0, 1)[:, None]
            seeds.append(a + t * (b - a) + (ra + t * (rb - ra)) * way / np.linalg.norm(way, axis=1, keepdims=True))
            owner.append(np.full(count, k))
    x, owner = np.concatenate(seeds), np.concatenate(owner)
    order = rng.permutation(len(x))
    x, owner = x[order], owner[order]
    outside = distance(groups, x) > -0.010  # what is deeper inside other limbs is no skin
    x, owner = x[outside], owner[outside]
    few = apart(x, 0.4 * SPACING)
    x, owner = x[few], owner[few]
    for _ in range(3):
        x = x - distance(groups, x)[:, None] * gradient(groups, x)
    good = np.abs(distance(groups, x)) < 4e-4
    x, owner = x[good], owner[good]
    few = apart(x, 0.9 * SPACING)
    x, owner = x[few], owner[few]
    return x, gradient(groups, x), owner


def weights(joints: Joints, x, owner) -> tuple[np.ndarray, np.ndarray]:
    """Which joints carry each point, (N, 4), and how much, (N, 4): the bones near it, of its finger or the palm."""
    p, r = joints.position, joints.radius
    away = np.full((len(x), COUNT), 1.0)
    for k, f in enumerate(FINGERS, start=1):
        for j in f[:-1]:
            allowed = (owner == k) | (j == f[0]) | ((owner == 0) & (j == f[1]))
            d = cone(x, p[j], p[j + 1], r[j], r[j + 1])
            away[:, j] = np.where(allowed, d, 1.0)
    away[:, WRIST] = cone(x, p[WRIST] + [0, 0, 0.1], p[WRIST], 0.02, 0.02)
    pull = np.exp(-(away - away.min(1, keepdims=True)) / REACH)
    part = np.argsort(-pull, axis=1)[:, :4]
    weight = np.take_along_axis(pull, part, axis=1)
    weight[weight < 0.02] = 0.0
    return part, weight / weight.sum(1, keepdims=True)


def paint(joints: Joints, x, n) -> np.ndarray:
    """Colours (N, 3): darker in hollows and at the joints, nails, a paler palm."""
    groups = limbs(joints)
    open_ = np.clip(distance(groups, x + 0.009 * n) / 0.009, 0.0, 1.0)[:, None]
    colour = COLOUR * (0.70 + 0.30 * open_)
    colour = colour * (1.0 + 0.05 * np.clip(-n[:, 1:2], -1.0, 1.0))
    p = joints.position
    for f in FINGERS:
        for j in f[2:-1]:
            way = joints.rotation[j][:, 2]
            line = np.abs((x - p[j]) @ way)
            close = np.linalg.norm(x - p[j], axis=1) < 1.6 * joints.radius[j]
            colour = colour * (1.0 - CREASE * (np.exp(-((line / 0.0016) ** 2)) * close)[:, None])
        tip, up, way = f[-1], joints.rotation[f[-2]][:, 1], -joints.rotation[f[-2]][:, 2]
        if f is FINGERS[0]:
            up = joints.rotation[f[-2]] @ np.array([-0.5, 0.87, 0.0])
        r = joints.radius[tip]
        d = x - (p[tip] + 0.15 * r * way)
        across, ahead = np.abs(d @ np.cross(up, way)), d @ way
        nail = (n @ up > 0.55) & (across < 0.72 * r) & (np.abs(ahead) < 0.95 * r) & (d @ up > 0)
        colour[nail] = NAIL
    return colour.clip(0.02, 0.98)


def placed(joints: Joints | None, *, left: bool) -> np.ndarray:
    """Where each joint carries the skin, (26, 3, 4): from the bound hand to where the joints are; hidden if None.

    A bone of another length or thickness than the model's stretches its skin.
    """
    if joints is None:
        return np.full((COUNT, 3, 4), np.nan)
    bound, thick, long = measures(left)
    scale = np.ones((COUNT, 3))
    scale[STARTS, :2] = ((joints.radius[STARTS] + joints.radius[ENDS]) / thick)[:, None]
    scale[STARTS, 2] = np.linalg.norm(joints.position[ENDS] - joints.position[STARTS], axis=1) / long
    scale = np.clip(scale, SMALLEST, LARGEST)
    scale[[PALM, WRIST]] = scale[ROOTS, 2].mean()
    A = joints.rotation @ (scale[:, :, None] * np.swapaxes(bound.rotation, 1, 2))
    return np.concatenate([A, (joints.position - np.einsum("jrc,jc->jr", A, bound.position))[..., None]], axis=2)


@cache
def measures(left: bool) -> tuple[Joints, np.ndarray, np.ndarray]:
    """The bound hand, and of each of its bones the sum of the radii at its ends and its length [m], (19,)."""
    bound = posed(SPREAD, left=left)
    long = np.linalg.norm(bound.position[ENDS] - bound.position[STARTS], axis=1)
    return bound, bound.radius[STARTS] + bound.radius[ENDS], long
