"""Soft shapes as implicit surfaces: ellipsoids, limbs, and their smooth union (Quilez, "smooth minimum").

A shape gives at points (N, 3) [m] a signed distance (N,) [m], negative inside and exact to first order at the surface
(but for the taper of limbs), its gradient (N, 3), and a direction of growth (N, 3), along which hair is combed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from studio.shapes import smooth_curve

Field = tuple[np.ndarray, np.ndarray, np.ndarray]  # distance, gradient, growth
Shape = Callable[[np.ndarray], Field]

TIP = 1e-9  # [m] below which a direction is not defined


def unit(vectors: np.ndarray) -> np.ndarray:
    """Normalised vectors (..., 3)."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), TIP)


def ellipsoid(centre, radii, rotation=None, growth=(0.0, -0.3, -1.0)) -> Shape:
    """Ellipsoid with its axes along the columns of `rotation`; hair grows along `growth`."""
    centre, radii = np.asarray(centre, float), np.broadcast_to(np.asarray(radii, float), 3)
    rotation = np.eye(3) if rotation is None else np.asarray(rotation)

    def field(p):
        q = (p - centre) @ rotation
        inner, outer = np.linalg.norm(q / radii, axis=1), np.linalg.norm(q / radii**2, axis=1)
        distance = np.where(outer > TIP, inner * (inner - 1) / np.maximum(outer, TIP), -radii.min())
        return distance, unit(q / radii**2) @ rotation.T, np.broadcast_to(np.asarray(growth, float), p.shape)

    return field


def limb(path, radii, flat: float = 1.0, across=(0.0, 0.0, 1.0), count: int = 0) -> Shape:
    """Round limb along a smooth curve through `path` (K, 3) with `radii` (K,); hair grows from its start to its end.

    flat   thickness along the direction `across` over that along the others
    count  points of the curve; 0: three a given one
    """
    nodes = np.concatenate([np.asarray(path, float), np.asarray(radii, float)[:, None]], 1)
    nodes = smooth_curve(nodes, count or 3 * len(nodes) - 2)
    axis = unit(np.asarray(across, float))
    squash = np.eye(3) + (1 / flat - 1) * np.outer(axis, axis)  # symmetric: maps the flat limb onto the round one
    x, r = nodes[:, :3] @ squash, nodes[:, 3]
    a, step = x[:-1], np.diff(x, axis=0)
    length2 = np.maximum((step**2).sum(1), TIP)

    def field(p):
        q = p @ squash
        best = np.full(len(q), np.inf)
        away, segment = np.zeros_like(q), np.zeros(len(q), np.int64)
        for k in range(len(a)):
            t = ((q - a[k]) @ step[k] / length2[k]).clip(0, 1)
            out = q - a[k] - t[:, None] * step[k]
            d = np.sqrt((out**2).sum(1)) - (r[k] + t * (r[k + 1] - r[k]))
            nearer = d < best
            best[nearer], away[nearer], segment[nearer] = d[nearer], out[nearer], k
        slope = unit(away) @ squash
        steep = np.maximum(np.linalg.norm(slope, axis=1), 1.0)
        return best / steep, unit(slope), unit(np.diff(nodes[:, :3], axis=0))[segment]

    return field


def mirrored(shape: Shape) -> Shape:
    """The shape's mirror image in the plane x = 0."""
    flip = np.array([-1.0, 1.0, 1.0])

    def field(p):
        distance, gradient, growth = shape(p * flip)
        return distance, gradient * flip, growth * flip

    return field


def smooth_union(fields: list[Field], widths: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Distance (N,) and gradient (N, 3) of a union whose seams are rounded over the width of each next shape [m]."""
    distance, gradient, _ = fields[0]
    for (other, slope, _), width in zip(fields[1:], widths[1:], strict=True):
        h = (0.5 + 0.5 * (distance - other) / width).clip(0, 1)
        distance = distance + h * (other - distance) - width * h * (1 - h)
        gradient = gradient + h[:, None] * (slope - gradient)
    return distance, unit(gradient)
