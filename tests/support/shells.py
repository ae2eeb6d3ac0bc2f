"""Splats of known shapes: thin discs of Gaussians on a surface, as a capture leaves them."""

import numpy as np

from assets.gaussians import Gaussians
from core.camera import directions_around
from core.rotation import turns_to
from core.spherical_harmonics import C0


def shell(points, normals, *, sigma, opacity=0.9, colour=0.5) -> Gaussians:
    """Discs of standard deviation `sigma` (a tenth as thick) at points (N, 3), across normals (N, 3).

    sigma, opacity and colour (grey) may be one number or (N,).
    """
    n = len(points)
    sigma = np.broadcast_to(sigma, n)
    scales = np.log(np.stack([sigma, sigma, 0.1 * sigma], 1))
    opacity = np.broadcast_to(opacity, n)
    sh = np.repeat((np.broadcast_to(colour, n)[:, None, None] - 0.5) / C0, 3, 2)
    return Gaussians.of(points, turns_to(normals, np.zeros(n)), scales, np.log(opacity / (1 - opacity)), sh)


def ball(n=3000, *, radius=1.0, open_below=-0.75, **options) -> Gaussians:
    """A ball of which nobody photographed the underside: nothing lies below y = open_below radius."""
    normals = directions_around(n)
    normals = normals[normals[:, 1] > open_below]
    return shell(radius * normals, normals, sigma=2.5 * radius / n**0.5, **options)


def ring(n=4000, *, major=1.0, minor=0.25, **options) -> Gaussians:
    """A torus about the y axis, closed."""
    turns = np.random.default_rng(0).uniform(0, 2 * np.pi, (n, 2))
    u, v = turns.T
    axis = np.stack([np.cos(u), 0 * u, np.sin(u)], 1)
    normals = np.cos(v)[:, None] * axis + np.sin(v)[:, None] * [0, 1, 0]
    sigma = 2.5 * (major * minor * np.pi / n) ** 0.5
    return shell(major * axis + minor * normals, normals, sigma=sigma, **options)


def toy(n=3000) -> Gaussians:
    """A drop standing on its blunt end, +y up: below, Gaussians are large, dark and opaque, as in captures."""
    d = directions_around(n)
    points = d * np.array([0.8, 1.0, 0.8])
    points[:, 1] = np.maximum(points[:, 1], -0.6)
    underside = d[:, 1] < -0.6
    keep = ~underside | (np.arange(n) % 6 == 0)
    sigma = np.where(underside, 0.11, 0.045)
    normals = np.where(underside[:, None], [0, -1, 0], d)
    colour = np.where(underside, 0.25, 0.5 + 0.15 * d[:, 1])
    g = shell(points, normals, sigma=sigma, opacity=np.where(underside, 0.97, 0.85), colour=colour)
    return g.select(keep)
