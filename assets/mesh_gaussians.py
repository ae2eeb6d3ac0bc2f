"""Gaussians that cover a triangle mesh: flat ones, evenly apart, narrow along creases and borders, in its colours.

trimesh reads .obj, .glb, .gltf, .stl, .off, and .ply with faces. These are untrusted: whatever it raises becomes
BadInput, and all arrays are checked.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from assets.file_access import file_size
from assets.formats.gltf import srgb_from_linear
from assets.gaussians import MAGNITUDE_MAX, Gaussians, concatenate
from core import mesh_sampling
from core.errors import BadInput
from core.spherical_harmonics import C0
from core.tetmesh import triangle_areas

GREY = 0.7  # display value of a mesh without colours
FACES_MAX = 5_000_000
LINEAR = (".glb", ".gltf")  # whose factors and vertex colours are linear light
ALPHA_MIN = 128  # of 255: a more transparent texel is a hole


@dataclass(frozen=True)
class MeshPart:
    """Triangles of one material.

    vertices, faces  (V, 3) in the file's unit, (F, 3)
    colours          display RGB in 0..1 of each corner of each face, (F, 3, 3), by which a texture is multiplied
    uv               of each corner of each face, (F, 3, 2), v upwards; None without a texture
    texture          (H, W, 4) uint8 RGBA, or None
    """

    vertices: np.ndarray
    faces: np.ndarray
    colours: np.ndarray
    uv: np.ndarray | None = None
    texture: np.ndarray | None = None


def read_triangle_mesh(path: str | Path) -> list[MeshPart]:
    """The parts of a mesh file, placed as its scene has them. Raises BadInput."""
    path = Path(path)
    file_size(path)
    import trimesh

    logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # it reports each texture that is missing
    try:
        loaded = trimesh.load_scene(path, process=False)
        meshes = [m for m in loaded.dump() if isinstance(m, trimesh.Trimesh) and len(m.faces)]
        parts = [part_of(m, linear=path.suffix.lower() in LINEAR) for m in meshes]
    except BadInput:
        raise
    except Exception as e:  # of a parser that knows many formats
        raise BadInput(f"{path}: cannot be read as a mesh ({' '.join(f'{type(e).__name__} {e}'.split())[:100]})") from e
    if not parts:
        raise BadInput(f"{path}: holds no triangles")
    if sum(len(p.faces) for p in parts) > FACES_MAX:
        raise BadInput(f"{path}: has more than {FACES_MAX:,} triangles; make a coarser one")
    for part in parts:
        if part.vertices.shape[1:] != (3,) or part.faces.shape[1:] != (3,):
            raise BadInput(f"{path}: has vertices without three coordinates, or faces that are no triangles")
        if not (np.abs(part.vertices) < MAGNITUDE_MAX).all():  # NaN compares false
            raise BadInput(f"{path}: has vertices that are not finite")
        if part.faces.min() < 0 or part.faces.max() >= len(part.vertices):
            raise BadInput(f"{path}: has triangles whose vertices do not exist")
    return parts


def part_of(mesh, *, linear: bool) -> MeshPart:
    """A mesh of trimesh with its colours; `linear`: its factors are linear light."""
    vertices, faces = np.array(mesh.vertices, np.float64), np.array(mesh.faces, np.int64)
    colours, visual = np.full((len(faces), 3, 3), GREY), mesh.visual
    shown = srgb_from_linear if linear else np.asarray
    if visual.kind == "vertex":
        colours = shown(np.asarray(visual.vertex_colors)[:, :3] / 255.0)[faces]
    elif visual.kind == "face":
        colours = np.repeat(shown(np.asarray(visual.face_colors)[:, None, :3] / 255.0), 3, axis=1)
    elif visual.kind == "texture" and visual.material is not None:
        material = visual.material
        names = "baseColorTexture", "baseColorFactor"  # of glTF; others have an image and a diffuse colour
        names = names if hasattr(material, "baseColorFactor") else ("image", "diffuse")
        image, factor = (getattr(material, name, None) for name in names)
        colour = np.full(3, 1.0 if image is not None else GREY)
        if factor is not None and (image is None or linear):  # in an .obj it stands for a texture that is missing
            colour = shown(np.asarray(factor, np.float64).ravel()[:3] / 255.0)
        colours = np.broadcast_to(colour, (len(faces), 3, 3))
        if image is not None and np.shape(visual.uv) == (len(vertices), 2):
            uv = np.asarray(visual.uv, np.float64)[faces]
            return MeshPart(vertices, faces, colours, uv, np.array(image.convert("RGBA")))
    return MeshPart(vertices, faces, colours)


def texture_colours(part: MeshPart, face: np.ndarray, weights: np.ndarray, spacing: float) -> np.ndarray:
    """Display RGBA (N, 4) in 0..1 of points in faces (N,) with barycentric weights (N, 3), `spacing` apart.

    The texture is averaged to texels as large as the spacing, else points would pick single ones.
    """
    import cv2

    colours = np.einsum("nk,nkd->nd", weights, part.colours[face])
    rgba = np.concatenate([colours, np.ones((len(face), 1))], axis=1)
    if part.texture is None:
        return rgba
    height, width = part.texture.shape[:2]
    corners = np.nan_to_num(part.uv)
    (d, e), area = np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 0), triangle_areas(part.vertices, part.faces).sum()
    covered = 0.5 * np.abs(d[:, 0] * e[:, 1] - d[:, 1] * e[:, 0]).sum() * width * height  # [texels]
    texels_per_length = np.sqrt(covered / max(area, 1e-30))
    factor = min(1.0, 1.0 / (max(texels_per_length, 1e-30) * spacing))
    uv = np.nan_to_num(np.einsum("nk,nkd->nd", weights, part.uv[face]))
    size = max(1, round(width * factor)), max(1, round(height * factor))
    texture = cv2.resize(part.texture, size, interpolation=cv2.INTER_AREA) if factor < 1.0 else part.texture
    u, v = (uv[:, 0] % 1.0) * size[0] - 0.5, (1.0 - uv[:, 1] % 1.0) * size[1] - 0.5
    channels = [map_coordinates(texture[..., c] / 255.0, (v, u), order=1, mode="grid-wrap") for c in range(4)]
    return rgba * np.stack(channels, axis=1)


GAUSSIANS = 60_000
ROWS_MAX = 2 * GAUSSIANS  # of them along edges, about: more where slivers are all edge, without bound
DENSITY = 0.72  # points of blue noise in a squared spacing
CANDIDATES, ROUNDS = 4, 3  # random points per squared spacing and round; after three rounds gaps are rare
SIGMA = 0.9  # standard deviation over the spacing: closed where neighbours are farthest apart
EDGE_CLEARANCE = 0.62  # of the spacing, between points and an edge, along which rows of their own lie
FLATNESS = 0.1  # thickness over width
OPACITY = 4.0  # logit
LENGTH = 1.0  # [m] of the largest extent while it is sampled: edges are split by absolute lengths


def read_mesh_gaussians(path: str | Path, report: Callable[[str], None] = print) -> Gaussians:
    """Gaussians of about GAUSSIANS in number on the mesh of a file, in its unit. Raises BadInput."""
    parts = read_triangle_mesh(path)
    used = np.concatenate([p.vertices[p.faces].reshape(-1, 3) for p in parts])
    low, extent = used.min(0), float(np.ptp(used, axis=0).max())
    if not extent > 0.0:
        raise BadInput(f"{path}: the mesh has no extent")
    unit = LENGTH / extent
    welded = [welded_part(p, low, unit) for p in parts]
    area = sum(triangle_areas(p.vertices, p.faces).sum() for p in welded)
    if not area > 0.0:
        raise BadInput(f"{path}: the mesh has no area")
    edges = [mesh_sampling.edges_of(mesh_sampling.Mesh(p.vertices, p.faces)) for p in welded]
    length = sum(np.linalg.norm(e.b - e.a, axis=1).sum() for e in edges)
    spacing, rng = float(max(np.sqrt(DENSITY * area / GAUSSIANS), length / ROWS_MAX)), np.random.default_rng(0)
    covered = concatenate([cover(p, e, spacing, rng) for p, e in zip(welded, edges, strict=True)])
    if not len(covered):
        raise BadInput(f"{path}: the mesh is transparent")
    return covered.transformed(np.eye(3), low, 1.0 / unit)


def welded_part(part: MeshPart, low: np.ndarray, unit: float) -> MeshPart:
    """The part, scaled, with one vertex at each place, so that seams of the texture are no edges."""
    x = (part.vertices - low) * unit
    _, first, inverse = np.unique(np.round(x * 1e6).astype(np.int64), axis=0, return_index=True, return_inverse=True)
    faces = inverse.reshape(-1)[part.faces]
    whole = triangle_areas(x[first], faces) > 0.0
    uv = None if part.uv is None else part.uv[whole]
    return MeshPart(x[first], faces[whole], part.colours[whole], uv, part.texture)


def cover(part: MeshPart, edges: mesh_sampling.HalfEdges, spacing: float, rng: np.random.Generator) -> Gaussians:
    """Gaussians `spacing` [m] apart on a part, and rows of them along its creases and borders."""
    from trimesh.triangles import points_to_barycentric

    mesh = mesh_sampling.Mesh(part.vertices, part.faces)
    corners, normal = mesh.vertices[mesh.faces], mesh_sampling.face_normals(mesh)
    total = np.cumsum(triangle_areas(mesh.vertices, mesh.faces))
    along = np.full(len(edges.a), spacing)
    edge_points = mesh_sampling.points_along(edges, along)
    points, face = np.zeros((0, 3)), np.zeros(0, int)
    for _ in range(ROUNDS if len(total) else 0):
        count = rng.poisson(CANDIDATES * total[-1] / spacing**2) + 1
        some = np.searchsorted(total, rng.random(count) * total[-1]).clip(0, len(total) - 1)
        r, t = np.sqrt(rng.random(count)), rng.random(count)
        x = np.einsum("nk,nkd->nd", np.stack([1 - r, r * (1 - t), r * t], 1), corners[some])
        free, near = np.ones(count, bool), near_edges(edge_points, x, spacing)
        away = mesh_sampling.distance_to_edges(edge_points, x[near], normal[some[near]], 2 * spacing)
        free[near] = away >= EDGE_CLEARANCE * spacing
        x, some = x[free], some[free]
        kept = mesh_sampling.blue_noise(x, normal[some], spacing, (points, normal[face]))
        points, face = np.concatenate([points, x[kept]]), np.concatenate([face, some[kept]])
    normals = normal[face]
    flat = np.eye(3) - normals[:, :, None] * normals[:, None]
    row_points, row_covariance, row_edge = mesh_sampling.rows_along(edges, along)
    points, face = np.concatenate([points, row_points]), np.concatenate([face, edges.face[row_edge]])
    normals = normal[face]
    covariance = np.concatenate([(SIGMA * spacing) ** 2 * flat, row_covariance])
    near = near_edges(edge_points, points, spacing)
    covariance[near] = mesh_sampling.clip_to_edges(edge_points, points[near], normals[near], covariance[near])
    weights = points_to_barycentric(corners[face], points, method="cross")  # exact for slivers, too
    rgba = texture_colours(part, face, weights, spacing)
    return gaussians_of(points, normals, covariance, rgba, spacing)


def near_edges(edges: mesh_sampling.EdgePoints, points: np.ndarray, spacing: float) -> np.ndarray:
    """Indices of the points near an edge, for which alone the exact search is worth its time."""
    if not len(edges.points):
        return np.zeros(0, int)
    reach = 3.0 * spacing + float(edges.half.max())
    return np.flatnonzero(np.isfinite(cKDTree(edges.points).query(points, distance_upper_bound=reach)[0]))


def gaussians_of(
    points: np.ndarray, normals: np.ndarray, covariance: np.ndarray, rgba: np.ndarray, spacing: float
) -> Gaussians:
    """Flat Gaussians at points with normals (N, 3) and covariances in their planes; transparent ones are left out."""
    there = rgba[:, 3] * 255.0 >= ALPHA_MIN
    points, normals, covariance, rgba = points[there], normals[there], covariance[there], rgba[there]
    variance, axes = np.linalg.eigh(covariance)  # ascending: the normal's comes first
    sigma = np.sqrt(np.maximum(variance[:, 1:], (FLATNESS * spacing) ** 2))
    first = np.cross(axes[:, :, 2], normals)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-12)
    frames = np.stack([first, np.cross(normals, first), normals], -1)
    quats = Rotation.from_matrix(frames).as_quat()[:, [3, 0, 1, 2]]
    scales = np.log(np.column_stack([sigma[:, 0], sigma[:, 1], np.full(len(sigma), FLATNESS * SIGMA * spacing)]))
    sh = ((np.clip(rgba[:, :3], 0.0, 1.0) - 0.5) / C0)[:, None]
    return Gaussians.of(points, quats, scales, np.full(len(points), OPACITY), sh)
