"""Cover meshes with flat Gaussians: blue noise in the faces, fine rows along the edges."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from scipy.spatial import cKDTree

from prepare.model.layout import EYE, EYES
from prepare.model.shapes import Mesh, Part

CREASE = np.cos(np.radians(38))  # faces that meet at a sharper angle form an edge
CANDIDATES = 10  # random points drawn for each one that stays; more leave fewer gaps
WIDTH = 0.80  # standard deviation over the distance of neighbours: closed at an opacity of 0.95
LEVEL = 1.3  # sampling radii are rounded down to powers of this


@dataclass(frozen=True)
class Cover:
    """Surface points to become Gaussians.

    points, normals  [m] and unit, (N, 3)
    tangents         unit, (N, 3): direction of the first standard deviation
    sigma            standard deviations along and across the tangent [m], (N, 2)
    part             index of the part, (N,)
    """

    points: np.ndarray
    normals: np.ndarray
    tangents: np.ndarray
    sigma: np.ndarray
    part: np.ndarray

    def __len__(self) -> int:
        return len(self.points)

    def select(self, which: np.ndarray) -> Cover:
        """The points of an index array or mask."""
        return Cover(*(getattr(self, f.name)[which] for f in fields(self)))


def join_covers(covers: list[Cover]) -> Cover:
    """All covers as one."""
    return Cover(*(np.concatenate([getattr(c, f.name) for c in covers]) for f in fields(Cover)))


def cover(part: Part, index: int, rng: np.random.Generator) -> Cover:
    """Points for one part; denser near the player and where the player can look."""
    mesh = part.world
    a = np.array([1.0, 0.0, 0.0])
    if part.grain is not None:
        a = np.asarray(part.grain, float) if part.rotation is None else part.rotation @ np.asarray(part.grain, float)
    squeeze = np.eye(3) - (1 - 1 / part.stretch) * np.outer(a, a)  # makes drawn-out neighbours round
    edges = _edge_rows(mesh, part, a)
    mesh = _divided(mesh, 12 * part.spacing)
    v = mesh.vertices[mesh.faces]
    normal = _face_normals(mesh)
    spacing = _spacing(v.mean(1), normal, part)
    corner_normals = _corner_normals(mesh, normal)

    flat = v @ squeeze
    area = 0.5 * np.linalg.norm(np.cross(flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]), axis=1)
    level = np.floor(np.log(spacing / spacing.min()) / np.log(LEVEL) + 1e-9)
    edge_tree = cKDTree(edges["points"]) if len(edges["points"]) else None
    points, normals, radii, clearances, edge_dirs = [], [], [], [], []
    for k in np.unique(level):
        s = spacing.min() * LEVEL**k
        face = np.flatnonzero(level == k)
        count = rng.poisson(CANDIDATES * 0.66 * area[face].sum() / s**2) + 1
        pick = face[np.searchsorted(np.cumsum(area[face]) / area[face].sum(), rng.random(count)).clip(0, len(face) - 1)]
        b = _barycentric(rng, count)
        p = np.einsum("nk,nkd->nd", b, v[pick])
        n = np.einsum("nk,nkd->nd", b, corner_normals[pick])
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        clearance, direction = np.full(count, np.inf), np.zeros((count, 3))
        if edge_tree is not None:
            distance, near = edge_tree.query(p, distance_upper_bound=4 * s)
            hit = np.isfinite(distance)
            direction[hit] = edges["directions"][near[hit]]
            offset = p[hit] - edges["points"][near[hit]]
            off = offset - (offset * direction[hit]).sum(1, keepdims=True) * direction[hit]
            clearance[hit] = np.linalg.norm(off, axis=1)
            keep = ~(clearance < 0.62 * s)
            p, n, clearance, direction = p[keep], n[keep], clearance[keep], direction[keep]
        keep = _blue_noise(p @ squeeze, n, s, np.concatenate(points) @ squeeze if points else None)
        points.append(p[keep])
        normals.append(n[keep])
        radii.append(np.full(keep.sum(), s))
        clearances.append(clearance[keep])
        edge_dirs.append(direction[keep])
    p, n, s, clearance, direction = (np.concatenate(x) for x in (points, normals, radii, clearances, edge_dirs))

    tangent = a - (n @ a)[:, None] * n if part.stretch > 1 else _any_tangent(n, rng)
    weak = np.linalg.norm(tangent, axis=1) < 0.05
    tangent[weak] = _any_tangent(n[weak], rng)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    along = np.linalg.norm(tangent @ squeeze, axis=1)  # 1/stretch along the grain, 1 across it
    sigma = WIDTH * np.stack([s / along, s], 1)
    upright = np.linalg.norm(np.cross(direction, n), axis=1) < 0.2
    near = (clearance < 2.2 * s) & ~upright  # turn along the edge and stay on this side of it
    tangent[near] = direction[near] - (direction[near] * n[near]).sum(1, keepdims=True) * n[near]
    tangent[near] /= np.linalg.norm(tangent[near], axis=1, keepdims=True)
    drawn = 1 / np.linalg.norm(tangent[near] @ squeeze, axis=1)
    across = 1 / np.linalg.norm(np.cross(n[near], tangent[near]) @ squeeze, axis=1)
    sigma[near] = np.stack([WIDTH * s[near] * drawn, np.minimum(WIDTH * s[near] * across, 0.55 * clearance[near])], 1)

    rows = Cover(
        edges["rows"], edges["normals"], edges["row_directions"], edges["sigma"], np.full(len(edges["rows"]), index)
    )
    return join_covers([Cover(p, n, tangent, sigma, np.full(len(p), index)), rows])


def _spacing(points: np.ndarray, normals: np.ndarray, part: Part) -> np.ndarray:
    """Distance of neighbours [m]: grows with the distance to the player, doubles where no player looks."""
    if part.fixed:
        return np.full(len(points), part.spacing)
    distance = np.linalg.norm(points - np.asarray(EYE), axis=1)
    factor = np.clip(distance / 1.5, 0.85, 2.6)
    if part.through is None:
        facing = np.max([((np.asarray(e) - points) * normals).sum(1) for e in EYES], axis=0)
        factor = factor * np.where(facing < 0, 2.0, 1.0)
    return part.spacing * factor


def _face_normals(mesh: Mesh) -> np.ndarray:
    v = mesh.vertices[mesh.faces]
    normal = np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0])
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-20)


def _divided(mesh: Mesh, longest: float) -> Mesh:
    """Split triangles until no edge exceeds `longest` [m], so that the spacing can vary over them."""
    import trimesh

    v, f = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, max_edge=max(longest, 0.12), max_iter=12)
    v, inverse = np.unique(np.round(v, 7), axis=0, return_inverse=True)
    f = inverse.reshape(-1)[f]
    return Mesh(v, f[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])])


def _corner_normals(mesh: Mesh, normal: np.ndarray) -> np.ndarray:
    """Normals (F, 3, 3) at the corners, averaged over faces that meet there without a crease."""
    v = mesh.vertices[mesh.faces]
    area = np.linalg.norm(np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0]), axis=1)
    corner = mesh.faces.reshape(-1)
    face = np.repeat(np.arange(len(v)), 3)
    order = np.argsort(corner, kind="stable")
    total = np.zeros((len(corner), 3))
    longest = np.bincount(corner).max()
    for shift in range(-longest + 1, longest):  # partners around the same vertex lie next to each other
        i = np.arange(max(0, -shift), len(order) - max(0, shift))
        one, two = order[i], order[i + shift]
        same = corner[one] == corner[two]
        one, two = one[same], two[same]
        agree = (normal[face[one]] * normal[face[two]]).sum(1) > CREASE
        total[one[agree]] += (normal * area[:, None])[face[two[agree]]]
    total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-20)
    return total.reshape(-1, 3, 3)


def _edge_rows(mesh: Mesh, part: Part, grain: np.ndarray) -> dict:
    """Rows of narrow points just inside both faces of every crease and along open borders."""
    normal = _face_normals(mesh)
    half = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    face = np.tile(np.arange(len(mesh.faces)), 3)
    key = np.sort(half, 1) @ np.array([len(mesh.vertices), 1])
    _, inverse, count = np.unique(key, return_inverse=True, return_counts=True)
    first = np.full(len(count), -1)
    first[inverse[::-1]] = face[::-1]
    last = np.full(len(count), -1)
    last[inverse] = face
    crease = (count == 1) | ((normal[first] * normal[last]).sum(1) < CREASE)
    use = crease[inverse]
    half, normal = half[use], normal[face[use]]
    a, b = mesh.vertices[half[:, 0]], mesh.vertices[half[:, 1]]

    def spread(step):
        """Index of the edge and position 0..1 of points `step` [m] apart along all edges."""
        n = np.maximum(np.ceil(np.linalg.norm(b - a, axis=1) / step - 0.3), 1).astype(int)
        e = np.repeat(np.arange(len(n)), n)
        k = np.arange(len(e)) - np.repeat(np.cumsum(n) - n, n)
        return e, k / n[e], (k + 1) / n[e]

    e, begin, end = spread(0.3)  # pieces short enough for one spacing each
    a, b, normal = a[e] + begin[:, None] * (b - a)[e], a[e] + end[:, None] * (b - a)[e], normal[e]
    length = np.linalg.norm(b - a, axis=1)
    direction = (b - a) / np.maximum(length, 1e-12)[:, None]
    inward = np.cross(normal, direction)
    s = _spacing(0.5 * (a + b), normal, part)
    squeezed = direction - (1 - 1 / part.stretch) * (direction @ grain)[:, None] * grain
    drawn = 1 / np.maximum(np.linalg.norm(squeezed, axis=1), 1e-9)
    e, begin, end = spread(0.95 * s * drawn)
    t = 0.5 * (begin + end)
    f, begin, end = spread(0.5 * s)
    u = 0.5 * (begin + end)
    rows = a[e] + t[:, None] * (b - a)[e] + 0.26 * s[e, None] * inward[e]
    sigma = np.stack([np.minimum(WIDTH * s * drawn, np.maximum(0.5 * length, 0.25 * s))[e], 0.24 * s[e]], 1)
    return {
        "rows": rows,
        "normals": normal[e],
        "row_directions": direction[e],
        "sigma": sigma,
        "points": a[f] + u[:, None] * (b - a)[f],
        "directions": direction[f],
    }


def _blue_noise(points: np.ndarray, normals: np.ndarray, radius: float, taken: np.ndarray | None) -> np.ndarray:
    """Mask of points of which no two on the same side of a sheet are nearer than `radius`.

    Points are in random order; a point stays if it comes first among its undecided neighbours.
    """
    undecided = np.ones(len(points), bool)
    if taken is not None and len(taken):
        undecided &= cKDTree(taken).query(points, distance_upper_bound=0.9 * radius)[0] > 0.9 * radius
    pairs = cKDTree(points).query_pairs(radius, output_type="ndarray")
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


def _barycentric(rng: np.random.Generator, count: int) -> np.ndarray:
    r, t = np.sqrt(rng.random(count)), rng.random(count)
    return np.stack([1 - r, r * (1 - t), r * t], 1)


def _any_tangent(normals: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    t = np.cross(normals, rng.normal(size=normals.shape))
    return t / np.maximum(np.linalg.norm(t, axis=1, keepdims=True), 1e-12)
