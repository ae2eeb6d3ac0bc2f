"""Sampling of surfaces with surfels (flat Gaussians to be): blue noise in the faces, fine rows along the edges."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.optimize import nnls

from core.mesh_sampling import (
    CREASE_COSINE,
    Mesh,
    blue_noise,
    clip_to_edges,
    distance_to_edges,
    edges_of,
    face_normals,
    points_along,
    rows_along,
)
from core.program import in_threads
from studio.detail import SHIPPED, Detail
from studio.shapes import Surface, welded

CANDIDATES, ROUNDS = 4, 3  # random points per squared spacing and round; after three rounds gaps are rare
SIGMA_OVER_SPACING = 0.95  # closes the surface even where neighbours are farthest apart
SIGMA_OVER_LEAF = 0.3  # standard deviation over the length of a leaf
GOLDEN_ANGLE = np.pi * (3 - 5**0.5)  # between a point of a sunflower's spiral and the next
RADIUS_RATIO = 1.3  # sampling radii are rounded down to powers of this
MIN_SPACING_RATIO = 0.55  # lower bound of the spacing on thin tubes, over the surface's own


@dataclass(frozen=True)
class Viewer:
    """Places from which a room is seen.

    eye      where the player stands [m]; reflections are baked for this point, and surfels are densest near it
    corners  of the space that the player's head moves in [m]; surfaces that face none of them are sampled coarsely
    """

    eye: tuple[float, float, float]
    corners: tuple[tuple[float, float, float], ...]

    def sees(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Mask (N,) of the points whose surface faces at least one of the corners."""
        return np.max([((np.asarray(e) - points) * normals).sum(1) for e in self.corners], axis=0) > 0


@dataclass(frozen=True)
class Surfels:
    """Surface elements, each of which becomes a Gaussian.

    points, normals  [m] and unit, (N, 3)
    tangents         unit, (N, 3): direction of the first standard deviation
    sigma            standard deviations along and across the tangent [m], (N, 2)
    surface          index of the surface, (N,)
    """

    points: np.ndarray
    normals: np.ndarray
    tangents: np.ndarray
    sigma: np.ndarray
    surface: np.ndarray

    def __len__(self) -> int:
        return len(self.points)

    def select(self, index: np.ndarray) -> Surfels:
        """Subset by an index array or mask."""
        return Surfels(*(getattr(self, f.name)[index] for f in fields(self)))


def join_surfels(sets: list[Surfels]) -> Surfels:
    """Concatenation of sets of surfels."""
    return Surfels(*(np.concatenate([getattr(c, f.name) for c in sets]) for f in fields(Surfels)))


def sample_surfaces(
    surfaces: list[Surface], rng: np.random.Generator, detail: Detail = SHIPPED, viewer: Viewer | None = None
) -> Surfels:
    """Surfels of all surfaces. Without a viewer all surfaces must be `uniform`, as those of things that move.

    Their number is `detail.gaussians` times the surfaces' own within 3 %; below 1 only roughly.
    """

    def sampled(density: float) -> Surfels:
        scaled = [replace(s, spacing=s.spacing / density) for s in surfaces]
        own = rng.spawn(len(scaled))
        sets = in_threads(lambda i: sample_surface(scaled[i], i, own[i], viewer, density**2), range(len(scaled)))
        return join_surfels(sets)

    if detail.gaussians <= 1:
        return sampled(detail.gaussians**0.5)
    # At x times the density along a line, faces and leaves hold a x^2 surfels, edges and thin parts b x; two samplings
    # tell both.
    low, high = 1.0, 2**0.5
    counts = [len(sampled(low)), len(sampled(high))]
    (a, b), _ = nnls(np.array([[low**2, low], [high**2, high]]), np.array(counts, float))  # a box is nearly all edges
    wanted = detail.gaussians * counts[0]
    density = 2 * wanted / (b + np.sqrt(b * b + 4 * a * wanted))
    for _ in range(4):
        surfels = sampled(density)
        ratio = len(surfels) / wanted
        if abs(ratio - 1) < 0.03:
            break
        density /= ratio**0.5
    return surfels


def sample_surface(
    surface: Surface, index: int, rng: np.random.Generator, viewer: Viewer | None = None, per_leaf: float = 1.0
) -> Surfels:
    """Surfels of one surface, numbered `index`; denser near the player and where the player can look.

    per_leaf  mean number of surfels for each leaf, if the surface is of leaves; at least 1

    Works in a space compressed along the grain, in which elongated Gaussians are round.
    """
    if surface.leaves:
        return _surfels_of_leaves(surface, index, per_leaf, rng)
    a = np.array([1.0, 0.0, 0.0])
    if surface.grain is not None:
        a = surface.rotation @ np.asarray(surface.grain, float)
    compress = np.eye(3) - (1 - 1 / surface.stretch) * np.outer(a, a)
    stretch = np.eye(3) + (surface.stretch - 1) * np.outer(a, a)
    world = surface.world
    edges = edges_of(Mesh(world.vertices @ compress, world.faces))
    edge_normals = _unit(edges.normals @ compress)  # in the world: normals transform by the inverse transpose
    edge_spacing = _spacing(0.5 * (edges.a + edges.b) @ stretch, edge_normals, surface, viewer)
    edge_points = points_along(edges, edge_spacing)

    mesh = subdivided(world, max(12 * surface.spacing, 0.12))
    centre, normal = mesh.vertices[mesh.faces].mean(1), face_normals(mesh)
    corner_normals = _unit(smooth_normals(mesh, normal) @ stretch)
    v = (mesh.vertices @ compress)[mesh.faces]
    spacing = np.minimum(
        _spacing(centre, normal, surface, viewer),
        _curvature_limit(v, corner_normals, surface.spacing).clip(MIN_SPACING_RATIO * surface.spacing),
    )
    area = 0.5 * np.linalg.norm(np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0]), axis=1)
    level = np.floor(np.log(spacing / spacing.min()) / np.log(RADIUS_RATIO) + 1e-9)
    points, normals, radii = [], [], []
    for k in np.repeat(np.unique(level), ROUNDS):
        s = spacing.min() * RADIUS_RATIO**k
        face = np.flatnonzero(level == k)
        count = rng.poisson(CANDIDATES * area[face].sum() / s**2) + 1
        pick = face[np.searchsorted(np.cumsum(area[face]) / area[face].sum(), rng.random(count)).clip(0, len(face) - 1)]
        b = _barycentric(rng, count)
        p = np.einsum("nk,nkd->nd", b, v[pick])
        n = _unit(np.einsum("nk,nkd->nd", b, corner_normals[pick]))
        free = distance_to_edges(edge_points, p, n, 2 * s) >= 0.62 * s
        p, n = p[free], n[free]
        keep = blue_noise(p, n, s, (np.concatenate(points), np.concatenate(normals)) if points else None)
        points.append(p[keep])
        normals.append(n[keep])
        radii.append(np.full(keep.sum(), s))
    p, n, s = (np.concatenate(x) for x in (points, normals, radii))
    covariance = (surface.width * SIGMA_OVER_SPACING * s[:, None, None]) ** 2 * (np.eye(3) - n[:, :, None] * n[:, None])
    row_p, row_covariance, row_edge = rows_along(edges, edge_spacing)
    p, n = np.concatenate([p, row_p]), np.concatenate([n, edges.normals[row_edge]])
    covariance = clip_to_edges(edge_points, p, n, np.concatenate([covariance, row_covariance]))
    sigma, axes = np.linalg.eigh(stretch @ covariance @ stretch)
    normals = _unit(n @ compress)
    tangents = _unit(axes[..., 2] - (axes[..., 2] * normals).sum(1, keepdims=True) * normals)
    sigma = np.sqrt(sigma[:, [2, 1]].clip(1e-8))
    return Surfels(p @ stretch, normals, tangents, sigma, np.full(len(p), index))


def _surfels_of_leaves(surface: Surface, index: int, per_leaf: float, rng: np.random.Generator) -> Surfels:
    """About `per_leaf` surfels for each rectangle of `leaf_mesh`, which together are as round and wide as one.

    They lie on a sunflower's spiral: the k-th of n at a radius of R sqrt(k / n) standard deviations of the leaf, and
    each is R / sqrt(n) wide, where R^2 ((n - 1) / 4n + 1 / n) = 1 gives all of them about the leaf's own variance.
    """
    corner = surface.world.vertices.reshape(-1, 4, 3)
    a, b = corner[:, 1] - corner[:, 0], corner[:, 3] - corner[:, 0]
    centre, normal, tangent = corner.mean(1), _unit(np.cross(a, b)), _unit(a)
    sigma = SIGMA_OVER_LEAF * surface.width * np.stack([np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)], 1)
    number = np.full(len(centre), max(int(per_leaf), 1))
    if per_leaf > 1:
        number += rng.random(len(centre)) < per_leaf % 1
    leaf = np.repeat(np.arange(len(centre)), number)
    k, n = np.arange(len(leaf)) - np.repeat(np.cumsum(number) - number, number), number[leaf]
    wide = np.sqrt(n / ((n - 1) / 4 + 1))
    u, v = np.sqrt(k / n) * wide * np.stack([np.cos(GOLDEN_ANGLE * k), np.sin(GOLDEN_ANGLE * k)])
    u, v = ((x - (np.bincount(leaf, x) / number)[leaf]) * own for x, own in zip((u, v), sigma[leaf].T, strict=True))
    points = centre[leaf] + u[:, None] * tangent[leaf] + v[:, None] * _unit(b)[leaf]
    own = sigma[leaf] * (wide / np.sqrt(n))[:, None]
    return Surfels(points, normal[leaf], tangent[leaf], own, np.full(len(leaf), index))


def _spacing(points: np.ndarray, normals: np.ndarray, surface: Surface, viewer: Viewer | None) -> np.ndarray:
    """Spacing (N,) [m]: grows with the distance to the player, doubles where the player cannot look."""
    if surface.uniform:
        return np.full(len(points), surface.spacing)
    if viewer is None:
        raise ValueError(f"{surface.name}: a surface without a viewer must be uniform")
    distance = np.linalg.norm(points - np.asarray(viewer.eye), axis=1)
    factor = np.clip(distance / 1.5, 0.85, 2.6)
    if surface.translucency is None:
        factor = factor * np.where(viewer.sees(points, normals), 1.0, 2.0)
    return surface.spacing * factor


def _curvature_limit(vertices: np.ndarray, normals: np.ndarray, spacing: float) -> np.ndarray:
    """Largest spacing (F,) [m] at which flat Gaussians follow a curved surface: half its radius of curvature."""
    along = np.linalg.norm(vertices - np.roll(vertices, 1, 1), axis=2)
    turning = np.linalg.norm(normals - np.roll(normals, 1, 1), axis=2)
    return 0.5 / np.maximum((turning / np.maximum(along, 0.3 * spacing)).max(1), 1e-6)


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Normalised vectors (..., 3)."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-20)


def subdivided(mesh: Mesh, longest: float) -> Mesh:
    """Split triangles until no edge exceeds `longest` [m]."""
    import trimesh

    v, f = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, max_edge=longest, max_iter=12)
    return welded(Mesh(v, f))


def smooth_normals(mesh: Mesh, normal: np.ndarray) -> np.ndarray:
    """Normals (F, 3, 3) at corners: of the faces, with normals (F, 3), that meet without a crease, weighted by area."""
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
        agree = (normal[face[one]] * normal[face[two]]).sum(1) > CREASE_COSINE
        total[one[agree]] += (normal * area[:, None])[face[two[agree]]]
    total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-20)
    return total.reshape(-1, 3, 3)


def _barycentric(rng: np.random.Generator, count: int) -> np.ndarray:
    """Uniform random barycentric coordinates (count, 3) in a triangle."""
    r, t = np.sqrt(rng.random(count)), rng.random(count)
    return np.stack([1 - r, r * (1 - t), r * t], 1)
