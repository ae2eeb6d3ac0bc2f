"""A synthetic room of any number of Gaussians, and the two eyes of a person standing in it."""

from __future__ import annotations

import numpy as np

from assets.gaussians import Gaussians
from core.camera import Camera
from core.morton import morton_order

ROOM_SIZE = (6.0, 3.0, 5.0)  # [m]
EYES_APART = 0.064  # [m]
SIGMA = 0.0085  # [m] median of the two long axes: about 6 tiles of 16 px a Gaussian in stereo, as in captured rooms
BATCH = 1 << 18  # Gaussians whose harmonics are generated at a time: ten million in float64 at once would take 4 GB
SIZES = {"0.305M": 305_000, "1.313M": 1_313_000, "2.526M": 2_526_000}  # the paper's fox, animal crossing and bear


def room(count: int, degree: int = 3, seed: int = 1) -> Gaussians:
    """`count` flat Gaussians on walls, boxes and balls, most of them opaque, along a Z-order curve."""
    rng = np.random.default_rng(seed)
    points, normals = surfaces(count, rng)
    points += normals * rng.normal(0, 0.004, (count, 1))
    log_scales = np.log(SIGMA) + rng.normal(0, 0.6, (count, 3))
    log_scales[:, 2] -= rng.uniform(0.7, 3.0, count)
    tilt = normals + rng.normal(0, 0.15, (count, 3))
    # rotation of +z to the normal, after a random rotation about +z
    w = tilt / np.linalg.norm(tilt, axis=1, keepdims=True)
    to = np.stack([1 + w[:, 2], -w[:, 1], w[:, 0], np.zeros(count)], 1)
    to[w[:, 2] < -0.999] = [0, 1, 0, 0]
    half = rng.uniform(0, np.pi, count)
    quats = times(to, np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], 1))
    opaque = rng.random(count) < 0.6
    logits = np.where(opaque, rng.normal(3.0, 1.5, count), rng.normal(-1.5, 1.2, count))
    sh = np.empty((count, (degree + 1) ** 2, 3), np.float32)
    for begin in range(0, count, BATCH):
        sh[begin : begin + BATCH] = rng.normal(0, 0.06, sh[begin : begin + BATCH].shape)
    sh[:, 0] = patterns(points) + rng.normal(0, 0.25, (count, 3))
    order = morton_order(points)
    return Gaussians.of(*(np.asarray(a, np.float32)[order] for a in (points, quats, log_scales, logits, sh)))


def surfaces(count: int, rng) -> tuple[np.ndarray, np.ndarray]:
    """Points and unit normals, each (count, 3), uniform over all surfaces of the room."""
    pieces = [("box", np.zeros(3), np.array(ROOM_SIZE), -1.0)]
    for _ in range(14):
        size = rng.uniform(0.2, 0.9, 3)
        at = rng.uniform(0, 1, 3) * (np.array(ROOM_SIZE) - size) * (1, 0.3, 1)
        pieces.append(("box", at, size, 1.0))
    for _ in range(10):
        r = rng.uniform(0.1, 0.35)
        pieces.append(("ball", rng.uniform(r, np.array(ROOM_SIZE) - r), np.full(3, r), 1.0))
    areas = [4 * np.pi * s[0] ** 2 if k == "ball" else 2 * (s * np.roll(s, 1)).sum() for k, _, s, _ in pieces]
    which = rng.choice(len(pieces), count, p=np.array(areas) / sum(areas))
    points, normals = np.empty((count, 3)), np.zeros((count, 3))
    for k, (kind, at, size, side) in enumerate(pieces):
        mine = np.flatnonzero(which == k)
        if kind == "ball":
            n = rng.normal(size=(len(mine), 3))
            n /= np.linalg.norm(n, axis=1, keepdims=True)
            points[mine], normals[mine] = at + size * n, n
        else:
            faces = size.prod() / size
            axis = rng.choice(3, len(mine), p=faces / faces.sum())
            far = rng.integers(0, 2, len(mine))
            u = rng.random((len(mine), 3))
            u[np.arange(len(mine)), axis] = far
            points[mine] = at + u * size
            normals[mine, axis] = side * (2 * far - 1)
    return points, normals


def patterns(points: np.ndarray) -> np.ndarray:
    """Colours (N, 3) as SH of degree 0: stripes and checks, which make errors visible."""
    phases = np.array([0.0, 2.1, 4.2])
    return 1.2 * np.sin(2.5 * points + phases) * np.sign(np.sin(6 * points.sum(axis=1)))[:, None]


def times(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Products of quaternions wxyz, (N, 4)."""
    w, v, x, u = a[:, :1], a[:, 1:], b[:, :1], b[:, 1:]
    return np.concatenate([w * x - (v * u).sum(1, keepdims=True), w * u + x * v + np.cross(v, u)], 1)


def eyes(width: int = 1800, height: int = 1920, *, turn: float = 0.0) -> list[Camera]:
    """Left and right camera of someone 1.6 m tall near a corner, EYES_APART; `turn` [rad] to the side."""
    forward = np.array([np.cos(0.6 + turn), -0.15, np.sin(0.6 + turn)])
    z = forward / np.linalg.norm(forward)
    x = np.cross(z, [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z])
    cameras = []
    for side in (-0.5, 0.5):
        pose = np.eye(4)
        pose[:3, :3] = rotation
        pose[:3, 3] = -rotation @ (np.array([0.9, 1.6, 0.9]) + side * EYES_APART * x)
        f = 0.5 * width  # 90 degrees wide, like a headset
        cameras.append(Camera(width, height, f, f, 0.5 * width, 0.5 * height, pose))
    return cameras
