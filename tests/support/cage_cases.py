"""Five splats made from code, as captures leave them: no underside, holes, noise, floaters, thin parts; in metres."""

import numpy as np

from assets.gaussians import Gaussians, concatenate
from tests.support.shells import shell

CASES = ("ball", "mug", "ring", "bunny", "capsule")


def torus(p, centre, axis, major, minor):
    d = p - np.asarray(centre)
    along = d[..., axis]
    across = np.sqrt(np.maximum((d**2).sum(-1) - along**2, 0))
    return np.hypot(across - major, along) - minor


def ellipsoid(p, centre, radii):
    """Not a distance, but zero on the ellipsoid and of slope about one there."""
    q, r = p - np.asarray(centre), np.asarray(radii)
    k0, k1 = np.linalg.norm(q / r, axis=-1), np.linalg.norm(q / r**2, axis=-1)
    return k0 * (k0 - 1) / np.maximum(k1, 1e-9)


def brick(p, centre, half):
    q = np.abs(p - np.asarray(centre)) - np.asarray(half)
    return np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(-1), 0)


def capsule(p, a, b, radius):
    a, b = np.asarray(a), np.asarray(b)
    t = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(p - a - t[..., None] * (b - a), axis=-1) - radius


def mug(p):
    r, y = np.hypot(p[..., 0], p[..., 2]), p[..., 1]
    outer = np.maximum(r - 0.045, np.abs(y) - 0.06)
    inner = np.maximum(r - 0.035, -0.048 - y)
    handle = np.maximum(torus(p, (0.052, 0, 0), 2, 0.03, 0.007), 0.04 - r)
    return np.minimum(np.maximum(outer, -inner), handle)


def bunny(p):
    body = np.minimum(ellipsoid(p, (0, 0, 0), (0.08, 0.075, 0.07)), ellipsoid(p, (0.05, 0.08, 0), (0.045,) * 3))
    ears = [ellipsoid(p, (0.04, 0.15, side * 0.025), (0.014, 0.055, 0.005)) for side in (-1, 1)]
    return np.minimum(body, np.minimum(*ears))


DISTANCES = {  # and the corners of a box round the shape
    "ball": (lambda p: np.linalg.norm(p, axis=-1) - 0.12, 0.13),
    "mug": (mug, 0.1),
    "ring": (
        lambda p: np.minimum(torus(p, (0, 0.0145, 0), 1, 0.07, 0.005), brick(p, (0, 0, 0), (0.11, 0.01, 0.11))),
        0.12,
    ),
    "bunny": (bunny, 0.22),
    "capsule": (lambda p: capsule(p, (-0.07, 0, 0), (0.07, 0.03, 0), 0.05), 0.13),
}


def surface_points(distance, reach: float, n: int, rng) -> tuple[np.ndarray, np.ndarray]:
    """About evenly spread points (n, 3) [m] of the surface within a cube of half size `reach`, and normals (n, 3)."""
    band, found, have = 0.002, [], 0
    while have < n:
        p = rng.uniform(-reach, reach, (200_000, 3))
        p = p[np.abs(distance(p)) < band]
        for _ in range(3):
            p, normal = _step(distance, p)
        found.append(np.concatenate([p, normal], 1))
        have += len(p)
    both = np.concatenate(found)[:n]
    return both[:, :3], both[:, 3:]


def _step(distance, p):
    h = 1e-5
    slope = np.stack([distance(p + h * e) - distance(p - h * e) for e in np.eye(3)], 1) / (2 * h)
    length = np.linalg.norm(slope, axis=1, keepdims=True)
    normal = slope / np.maximum(length, 1e-9)
    return p - distance(p)[:, None] / np.maximum(length, 0.3) * normal, normal


def case(name: str, n: int = 20_000, seed: int = 0) -> Gaussians:
    """The splat of a shape of CASES: about n Gaussians, the damage of a capture included; +y up."""
    rng = np.random.default_rng(seed)
    distance, reach = DISTANCES[name]
    points, normals = surface_points(distance, reach, n, rng)
    keep = normals[:, 1] > -0.85  # nobody saw what faces the floor
    keep |= points[:, 1] > points[:, 1].min() + 0.01
    noise = {"ball": 0.002, "capsule": 0.003}.get(name, 0.0005)
    if name == "capsule":  # two holes, where something stood in front
        for spot in ((0, 0.06, 0.03), (0.1, 0.02, -0.04)):
            keep &= np.linalg.norm(points - np.asarray(spot), axis=1) > 0.018
    points, normals = points[keep], normals[keep]
    area = (2 * reach) ** 2 * 1.5  # about right for all five
    sigma = 1.2 * (area / n) ** 0.5
    opacity = rng.uniform(0.6, 0.95, len(points))
    body = shell(points + rng.normal(0, noise, points.shape), normals, sigma=sigma, opacity=opacity)
    if name not in ("ball", "capsule"):
        return body
    few = max(len(body) // 100, 30)
    away = rng.normal(size=(few, 3))
    away *= (rng.uniform(1.7, 3.0, few) * reach / np.linalg.norm(away, axis=1))[:, None]
    floaters = shell(away, np.tile([0.0, 1.0, 0.0], (few, 1)), sigma=2 * sigma, opacity=0.7)
    return concatenate([body, floaters])
