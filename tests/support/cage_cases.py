"""Five splats made from code, as captures leave them: no underside, holes, noise, floaters, thin parts; in metres."""

import numpy as np

from assets.gaussians import Gaussians, concatenate
from tests.support.distance_shapes import SHAPES
from tests.support.shells import shell


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
    """The splat of one of SHAPES: about n Gaussians, the damage of a capture included; +y up."""
    rng = np.random.default_rng(seed)
    distance, reach = SHAPES[name]
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
