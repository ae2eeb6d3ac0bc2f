"""Edges of a mesh, and Gaussians that end at them: nothing sticks out over an edge or round a corner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from studio.shapes import Mesh

CREASE = np.cos(np.radians(38))  # faces that meet at a sharper angle form an edge
INSET = 0.30  # distance of a row of Gaussians from its edge, over the spacing
REACH = 0.6  # standard deviation towards an edge over the distance to it
PIECE = 0.12  # [m] long edges are cut: long Gaussians are sorted wrongly against what stands before them
NEIGHBOURS = 40  # edge points looked at: two sides of some ten spacings of edge


@dataclass(frozen=True)
class HalfEdges:
    """Edges, each once for every face that ends there: from a to b (E, 3), the face on the left; its normal;
    length of the whole edge that a piece belongs to (E,), and distance of the piece's two ends from the corners
    where that edge begins and ends (E, 2), infinite where it goes on smoothly."""

    a: np.ndarray
    b: np.ndarray
    normals: np.ndarray
    whole: np.ndarray
    to_corner: np.ndarray


@dataclass(frozen=True)
class EdgePoints:
    """Points along edges (N, 3), each for a stretch of `half` [m] (N,) to both sides; the edge's unit direction
    and the normal of the face that ends there."""

    points: np.ndarray
    directions: np.ndarray
    normals: np.ndarray
    half: np.ndarray
    apart: float  # [m] by which opposite normals count as apart in the search for the edges of the same face
    tree: cKDTree | None


def edges_of(mesh: Mesh) -> HalfEdges:
    """Creases and open borders of a mesh, in pieces."""
    normal = face_normals(mesh)
    half = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    face = np.tile(np.arange(len(mesh.faces)), 3)
    _, inverse, count = np.unique(
        np.sort(half, 1) @ np.array([len(mesh.vertices), 1]), return_inverse=True, return_counts=True
    )
    first, last = np.empty(len(count), int), np.empty(len(count), int)
    first[inverse[::-1]], last[inverse] = face[::-1], face
    use = ((count == 1) | ((normal[first] * normal[last]).sum(1) < CREASE))[inverse]
    a, b, normal = mesh.vertices[half[use, 0]], mesh.vertices[half[use, 1]], normal[face[use]]
    whole = np.linalg.norm(b - a, axis=1)
    corner = ~_goes_on(half[use], (b - a) / np.maximum(whole, 1e-12)[:, None], normal)
    e, start, stop = _parts(whole, PIECE)
    at = (b - a)[e]
    to_corner = np.where(corner[e], np.stack([start, 1 - stop], 1) * whole[e, None], np.inf)
    return HalfEdges(a[e] + start[:, None] * at, a[e] + stop[:, None] * at, normal[e], whole[e], to_corner)


def _goes_on(half: np.ndarray, direction: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Whether each half edge continues smoothly on its face before its begin and after its end, (E, 2)."""
    result = np.zeros((len(half), 2), bool)
    order = np.argsort(half[:, 0], kind="stable")
    starts = half[order, 0]
    first = np.searchsorted(starts, half[:, 1])
    for k in range(int(np.bincount(half[:, 0]).max()) if len(half) else 0):  # edges that start where this one ends
        at = np.minimum(first + k, len(half) - 1)
        other = order[at]
        same = (starts[at] == half[:, 1]) & ((direction * direction[other]).sum(1) > 0.8)
        same &= (normal * normal[other]).sum(1) > 0.8
        result[same, 1] = True
        result[other[same], 0] = True
    return result


def points_along(edges: HalfEdges, spacing: np.ndarray) -> EdgePoints:
    """Points at half the spacing (E,) along the edges."""
    length, direction = _directions(edges)
    e, start, stop = _parts(length, 0.5 * spacing)
    points = edges.a[e] + 0.5 * (start + stop)[:, None] * (edges.b - edges.a)[e]
    half = 0.5 * (stop - start) * length[e]
    apart = 3 * float(spacing.max()) if len(spacing) else 0.0
    tree = cKDTree(np.concatenate([points, apart * edges.normals[e]], 1)) if len(points) else None
    return EdgePoints(points, direction[e], edges.normals[e], half, apart, tree)


def rows_along(edges: HalfEdges, spacing: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rows of points just inside the faces: points, normals, covariances (N, 3, 3) and spacings (N,).

    Long edges are straight, so their points are farther apart; each end has one more, small one.
    """
    length, direction = _directions(edges)
    inward = np.cross(edges.normals, direction)
    step = 0.95 * spacing * np.clip(edges.whole / (8 * spacing), 1, 2)
    e, start, stop = _parts(length, step)
    t, width = 0.5 * (start + stop), (stop - start) * length[e]
    for side, at in enumerate((0.0, 1.0)):
        k = np.flatnonzero((edges.to_corner[:, side] == 0) & (length > 2 * spacing))
        e, width = np.concatenate([e, k]), np.concatenate([width, 0.6 * spacing[k]])
        t = np.concatenate([t, np.abs(at - INSET * spacing[k] / length[k])])
    to_corner = (edges.to_corner[e] + np.stack([t, 1 - t], 1) * length[e, None]).min(1)
    width = np.minimum(width, 0.45 * to_corner)  # tighter, as spikes at corners show
    points = edges.a[e] + t[:, None] * (edges.b - edges.a)[e] + INSET * spacing[e, None] * inward[e]
    d, i = direction[e], inward[e]
    covariance = width[:, None, None] ** 2 * d[:, :, None] * d[:, None]
    covariance += (REACH * INSET * spacing[e, None, None]) ** 2 * i[:, :, None] * i[:, None]
    return points, edges.normals[e], covariance, spacing[e]


def clearance(edges: EdgePoints, points: np.ndarray, normals: np.ndarray, reach: float) -> np.ndarray:
    """Distance (N,) to the nearest edge of the same face within `reach`, else infinite."""
    if edges.tree is None or not len(points):
        return np.full(len(points), np.inf)
    distance, _ = _nearby(edges, points, normals, 6, np.full(len(points), reach))
    return distance.min(1)


def confine(edges: EdgePoints, points: np.ndarray, normals: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Covariances (N, 3, 3) narrowed so that no Gaussian reaches far over the nearest two edges of its face."""
    if edges.tree is None:
        return covariance
    covariance, row = covariance.copy(), np.arange(len(points))
    widest = np.sqrt(np.trace(covariance, axis1=1, axis2=2))
    distance, towards = _nearby(edges, points, normals, NEIGHBOURS, 2.2 * widest)
    first = None
    for _ in range(2):
        k = distance.argmin(1)
        near, u = distance[row, k], towards[row, k]
        hit = np.isfinite(near)
        which, u, limit = row[hit], u[hit], (REACH * near[hit]) ** 2
        across = np.einsum("nij,nj->ni", covariance[which], u)
        variance = (u * across).sum(1).clip(1e-16)
        shrink = (1 - limit / variance).clip(0) / variance
        covariance[which] -= shrink[:, None, None] * across[:, :, None] * across[:, None]
        first = towards[row, k] if first is None else first
        alike = np.abs((towards * first[:, None]).sum(2)) > 0.8
        distance = np.where(alike, np.inf, distance)
    return covariance


def face_normals(mesh: Mesh) -> np.ndarray:
    """Unit normals (F, 3)."""
    v = mesh.vertices[mesh.faces]
    normal = np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0])
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-20)


def _nearby(edges: EdgePoints, points, normals, count: int, reach: np.ndarray):
    """Distance (N, count) to edges of the same face (infinite: another face, or out of reach), and the unit
    direction towards them in the face."""
    count = min(count, len(edges.points))
    near = edges.tree.query(np.concatenate([points, edges.apart * normals], 1), k=[*range(1, count + 1)], workers=2)[1]
    offset = edges.points[near] - points[:, None]
    far = np.linalg.norm(offset, axis=2)
    d = edges.directions[near]
    along = (offset * d).sum(2)
    offset -= along[..., None] * d
    height = (offset * normals[:, None]).sum(2)
    offset -= height[..., None] * normals[:, None]
    distance = np.linalg.norm(offset, axis=2)
    other = ((edges.normals[near] * normals[:, None]).sum(2) < 0.8) | (np.abs(height) > 0.15 * far + 1e-4)
    other |= (far > reach[:, None]) | (np.abs(along) > 1.6 * edges.half[near])  # beside the edge, not past its end
    return np.where(other, np.inf, distance), offset / np.maximum(distance, 1e-12)[..., None]


def _directions(edges: HalfEdges) -> tuple[np.ndarray, np.ndarray]:
    along = edges.b - edges.a
    length = np.linalg.norm(along, axis=1)
    return length, along / np.maximum(length, 1e-12)[:, None]


def _parts(length: np.ndarray, step) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cut lengths into equal parts of about `step`: index of the whole, and where each part starts and stops (0..1)."""
    n = np.maximum(np.ceil(length / step - 0.3), 1).astype(int)
    e = np.repeat(np.arange(len(n)), n)
    k = np.arange(len(e)) - np.repeat(np.cumsum(n) - n, n)
    return e, k / n[e], (k + 1) / n[e]
