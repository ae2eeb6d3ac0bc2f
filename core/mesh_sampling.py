"""Triangle meshes and points on them: blue noise, edges with surfels along them, and covariances clipped so that no
Gaussian extends over an edge or corner.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree


@dataclass(frozen=True)
class Mesh:
    """Vertices [m], (V, 3); triangles (F, 3), counter-clockwise seen from outside."""

    vertices: np.ndarray
    faces: np.ndarray

    def moved(self, rotation=None, translation=(0.0, 0.0, 0.0)) -> Mesh:
        """The mesh after x -> rotation @ x + translation."""
        v = self.vertices if rotation is None else self.vertices @ np.asarray(rotation).T
        return Mesh(v + np.asarray(translation), self.faces)


def blue_noise(points: np.ndarray, normals: np.ndarray, radius: float, taken: tuple | None) -> np.ndarray:
    """Mask of points such that no two on the same side of a sheet are nearer than `radius` [m].

    Points come in random order; a point is kept if it precedes its undecided neighbours and if none of the
    points (with normals) already `taken` is near.
    """
    undecided = np.ones(len(points), bool)
    if taken is not None and len(taken[0]) and len(points):
        near = cKDTree(taken[0]).query(points, k=4, distance_upper_bound=radius)[1]
        there = near < len(taken[0])
        side = (taken[1][np.where(there, near, 0)] * normals[:, None]).sum(2) > 0.2
        undecided &= ~(there & side).any(1)
    candidates = np.flatnonzero(undecided)
    pairs = candidates[cKDTree(points[candidates]).query_pairs(radius, output_type="ndarray")]
    pairs = pairs[(normals[pairs[:, 0]] * normals[pairs[:, 1]]).sum(1) > 0.2]
    keep = np.zeros(len(points), bool)
    while undecided.any():
        pairs = pairs[undecided[pairs].all(1)]
        later = np.zeros(len(points), bool)
        later[pairs.max(1)] = True
        chosen = undecided & ~later
        keep |= chosen
        undecided &= ~chosen
        undecided[pairs[chosen[pairs[:, 0]], 1]] = False
        undecided[pairs[chosen[pairs[:, 1]], 0]] = False
    return keep


CREASE_COSINE = np.cos(np.radians(38))  # faces whose normals differ by a larger angle form an edge
ROW_INSET = 0.30  # distance of a row of Gaussians from its edge, over the spacing
SIGMA_OVER_EDGE_DISTANCE = 0.6  # standard deviation towards an edge over the distance to it
MAX_SEGMENT = 0.12  # [m] of an edge: longer Gaussians would be sorted wrongly against objects in front of them
EDGE_NEIGHBOURS = 40  # edge points examined per Gaussian: about ten spacings of edge to either side
SAME_FACE_COSINE = 0.8  # of the angle between the normals of a point and of an edge of its face


@dataclass(frozen=True)
class HalfEdges:
    """Segments of edges, one for each adjacent face.

    a, b         ends of the segment [m], (E, 3), with the face on its left
    face         index of the face, (E,);  normals  unit normals of the faces, (E, 3)
    whole        lengths of the edges that the segments belong to [m], (E,)
    to_corner    distances of both ends from the corners where the edge begins and ends [m], (E, 2); infinite where
                 the edge continues smoothly
    """

    a: np.ndarray
    b: np.ndarray
    face: np.ndarray
    normals: np.ndarray
    whole: np.ndarray
    to_corner: np.ndarray


@dataclass(frozen=True)
class EdgePoints:
    """Points along edges [m], (N, 3), with a search tree.

    directions, normals    unit direction of the edge and unit normal of the adjacent face, (N, 3)
    half                   half length of edge that a point stands for [m], (N,)
    apart                  distance [m] in the search space between opposite normals, which separates a sheet's sides
    """

    points: np.ndarray
    directions: np.ndarray
    normals: np.ndarray
    half: np.ndarray
    apart: float
    tree: cKDTree | None


def edges_of(mesh: Mesh) -> HalfEdges:
    """Creases and open borders of a mesh, in segments of at most about MAX_SEGMENT."""
    normal = face_normals(mesh)
    half = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    face = np.tile(np.arange(len(mesh.faces)), 3)
    _, inverse, count = np.unique(
        np.sort(half, 1) @ np.array([len(mesh.vertices), 1]), return_inverse=True, return_counts=True
    )
    first, last = np.empty(len(count), int), np.empty(len(count), int)
    first[inverse[::-1]], last[inverse] = face[::-1], face
    use = ((count == 1) | ((normal[first] * normal[last]).sum(1) < CREASE_COSINE))[inverse]
    a, b, face = mesh.vertices[half[use, 0]], mesh.vertices[half[use, 1]], face[use]
    normal = normal[face]
    whole = np.linalg.norm(b - a, axis=1)
    corner = ~_continues_smoothly(half[use], (b - a) / np.maximum(whole, 1e-12)[:, None], normal)
    e, start, stop = _split_evenly(whole, MAX_SEGMENT)
    at = (b - a)[e]
    to_corner = np.where(corner[e], np.stack([start, 1 - stop], 1) * whole[e, None], np.inf)
    return HalfEdges(a[e] + start[:, None] * at, a[e] + stop[:, None] * at, face[e], normal[e], whole[e], to_corner)


def _continues_smoothly(half: np.ndarray, direction: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Mask (E, 2): the half edge continues smoothly on its face before its start, after its end."""
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
    """Points along the edges at half the spacing (E,) [m]."""
    length, direction = _directions(edges)
    e, start, stop = _split_evenly(length, 0.5 * spacing)
    points = edges.a[e] + 0.5 * (start + stop)[:, None] * (edges.b - edges.a)[e]
    half = 0.5 * (stop - start) * length[e]
    apart = 3 * float(spacing.max()) if len(spacing) else 0.0
    tree = cKDTree(np.concatenate([points, apart * edges.normals[e]], 1)) if len(points) else None
    return EdgePoints(points, direction[e], edges.normals[e], half, apart, tree)


def rows_along(edges: HalfEdges, spacing: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of surfels just inside the faces: points (N, 3), covariances (N, 3, 3), and the edge (N,) of each.

    Long edges are straight, so their points are farther apart; each end gets one additional, small surfel.
    """
    length, direction = _directions(edges)
    inward = np.cross(edges.normals, direction)
    step = 0.95 * spacing * np.clip(edges.whole / (8 * spacing), 1, 2)
    e, start, stop = _split_evenly(length, step)
    t, width = 0.5 * (start + stop), (stop - start) * length[e]
    for side, at in enumerate((0.0, 1.0)):
        k = np.flatnonzero((edges.to_corner[:, side] == 0) & (length > 2 * spacing))
        e, width = np.concatenate([e, k]), np.concatenate([width, 0.6 * spacing[k]])
        t = np.concatenate([t, np.abs(at - ROW_INSET * spacing[k] / length[k])])
    to_corner = (edges.to_corner[e] + np.stack([t, 1 - t], 1) * length[e, None]).min(1)
    width = np.minimum(width, 0.45 * to_corner)  # tighter than at edges: spikes at corners are conspicuous
    points = edges.a[e] + t[:, None] * (edges.b - edges.a)[e] + ROW_INSET * spacing[e, None] * inward[e]
    d, i = direction[e], inward[e]
    covariance = width[:, None, None] ** 2 * d[:, :, None] * d[:, None]
    covariance += (SIGMA_OVER_EDGE_DISTANCE * ROW_INSET * spacing[e, None, None]) ** 2 * i[:, :, None] * i[:, None]
    return points, covariance, e


def distance_to_edges(edges: EdgePoints, points: np.ndarray, normals: np.ndarray, max_distance: float) -> np.ndarray:
    """Distance (N,) [m] to the nearest edge of the same face; infinite beyond `max_distance`."""
    if edges.tree is None or not len(points):
        return np.full(len(points), np.inf)
    distance, _ = _nearest_edges(edges, points, normals, 6, np.full(len(points), max_distance))
    return distance.min(1)


def clip_to_edges(edges: EdgePoints, points: np.ndarray, normals: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Covariances (N, 3, 3) narrowed so that no Gaussian extends far over the two nearest edges of its face."""
    if edges.tree is None:
        return covariance
    covariance, row = covariance.copy(), np.arange(len(points))
    widest = np.sqrt(np.trace(covariance, axis1=1, axis2=2))
    distance, towards = _nearest_edges(edges, points, normals, EDGE_NEIGHBOURS, 2.2 * widest)
    first = None
    for _ in range(2):
        k = distance.argmin(1)
        near, u = distance[row, k], towards[row, k]
        hit = np.isfinite(near)
        clipped, u, limit = row[hit], u[hit], (SIGMA_OVER_EDGE_DISTANCE * near[hit]) ** 2
        across = np.einsum("nij,nj->ni", covariance[clipped], u)
        variance = (u * across).sum(1).clip(1e-16)
        shrink = (1 - limit / variance).clip(0) / variance
        covariance[clipped] -= shrink[:, None, None] * across[:, :, None] * across[:, None]
        first = towards[row, k] if first is None else first
        alike = np.abs((towards * first[:, None]).sum(2)) > 0.8
        distance = np.where(alike, np.inf, distance)
    return covariance


def face_normals(mesh: Mesh) -> np.ndarray:
    """Unit normals (F, 3)."""
    v = mesh.vertices[mesh.faces]
    normal = np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0])
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-20)


def _nearest_edges(edges: EdgePoints, points, normals, count: int, max_distance: np.ndarray):
    """Distances (N, count) [m] to edges of the same face and unit directions (N, count, 3) to them in the face.

    The distance is infinite for edges of another face or beyond `max_distance` (N,).
    """
    count = min(count, len(edges.points))
    distance, towards = np.full((len(points), count), np.inf), np.zeros((len(points), count, 3))
    if not len(points):
        return distance, towards
    # Beyond this distance in the space of the tree, an edge is either too far or of another face.
    bound = np.sqrt(float(max_distance.max()) ** 2 + 2 * (1 - SAME_FACE_COSINE) * edges.apart**2)
    query = np.concatenate([points, edges.apart * normals], 1)
    near = edges.tree.query(query, k=[*range(1, count + 1)], distance_upper_bound=bound)[1]
    some = np.flatnonzero(near[:, 0] < len(edges.points))
    points, normals, near, limit = points[some], normals[some], near[some], max_distance[some, None]
    other = near == len(edges.points)
    near[other] = 0
    offset = edges.points[near] - points[:, None]
    far = np.linalg.norm(offset, axis=2)
    d = edges.directions[near]
    along = (offset * d).sum(2)
    offset -= along[..., None] * d
    height = (offset * normals[:, None]).sum(2)
    offset -= height[..., None] * normals[:, None]
    across = np.linalg.norm(offset, axis=2)
    other |= (edges.normals[near] * normals[:, None]).sum(2) < SAME_FACE_COSINE
    other |= (np.abs(height) > 0.15 * far + 1e-4) | (far > limit)
    other |= np.abs(along) > 1.6 * edges.half[near]  # beside the edge, not past its end
    distance[some], towards[some] = np.where(other, np.inf, across), offset / np.maximum(across, 1e-12)[..., None]
    return distance, towards


def _directions(edges: HalfEdges) -> tuple[np.ndarray, np.ndarray]:
    """Lengths (E,) [m] and unit directions (E, 3)."""
    along = edges.b - edges.a
    length = np.linalg.norm(along, axis=1)
    return length, along / np.maximum(length, 1e-12)[:, None]


def _split_evenly(length: np.ndarray, step) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Divide lengths into equal intervals of about `step`: index of the length, start and stop (0..1) of each."""
    n = np.maximum(np.ceil(length / step - 0.3), 1).astype(int)
    e = np.repeat(np.arange(len(n)), n)
    k = np.arange(len(e)) - np.repeat(np.cumsum(n) - n, n)
    return e, k / n[e], (k + 1) / n[e]
