"""Reading of triangle meshes with their colours: .obj, .glb, .gltf, .stl, .off, and .ply with faces.

trimesh parses the files, which are untrusted: whatever it raises becomes BadInput, and all arrays are checked.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from assets.file_access import file_size
from assets.gaussians import MAGNITUDE_MAX
from core.errors import BadInput

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
    if visual.kind == "vertex":
        colours = displayed(np.asarray(visual.vertex_colors)[:, :3] / 255.0, linear)[faces]
    elif visual.kind == "face":
        colours = np.repeat(displayed(np.asarray(visual.face_colors)[:, None, :3] / 255.0, linear), 3, axis=1)
    elif visual.kind == "texture" and visual.material is not None:
        return textured(vertices, faces, visual, linear)
    return MeshPart(vertices, faces, colours)


def textured(vertices: np.ndarray, faces: np.ndarray, visual, linear: bool) -> MeshPart:
    """Triangles of a material: its texture, if it and the coordinates are there, times its colour."""
    material = visual.material
    image = getattr(material, "baseColorTexture", None) if hasattr(material, "baseColorFactor") else material.image
    factor = getattr(material, "baseColorFactor", None) if hasattr(material, "baseColorFactor") else material.diffuse
    own = None if factor is None else displayed(np.asarray(factor, np.float64).ravel()[:3] / 255.0, linear)
    colour = own if own is not None else np.full(3, 1.0 if image is not None else GREY)
    if image is not None and own is not None and not linear:
        colour = np.ones(3)  # the diffuse colour of an .obj stands for its texture where that is missing
    colours = np.broadcast_to(colour, (len(faces), 3, 3))
    if image is None or visual.uv is None or np.shape(visual.uv) != (len(vertices), 2):
        return MeshPart(vertices, faces, colours)
    pixels = np.array(image.convert("RGBA"))
    return MeshPart(vertices, faces, colours, np.asarray(visual.uv, np.float64)[faces], pixels)


def displayed(values: np.ndarray, linear: bool) -> np.ndarray:
    """Display values in 0..1 of colours in 0..1."""
    from assets.formats.gltf_skin import srgb_from_linear

    return srgb_from_linear(values) if linear else values


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
    uv = np.nan_to_num(np.einsum("nk,nkd->nd", weights, part.uv[face]))
    factor = min(1.0, 1.0 / (max(texels_per_length(part), 1e-30) * spacing))
    size = max(1, round(width * factor)), max(1, round(height * factor))
    texture = cv2.resize(part.texture, size, interpolation=cv2.INTER_AREA) if factor < 1.0 else part.texture
    u, v = (uv[:, 0] % 1.0) * size[0] - 0.5, (1.0 - uv[:, 1] % 1.0) * size[1] - 0.5
    left, top = np.floor(u).astype(int), np.floor(v).astype(int)
    s, t = (u - left)[:, None], (v - top)[:, None]
    at = [texture[(top + j) % size[1], (left + i) % size[0]] / 255.0 for j in (0, 1) for i in (0, 1)]
    return rgba * ((1 - t) * ((1 - s) * at[0] + s * at[1]) + t * ((1 - s) * at[2] + s * at[3]))


def texels_per_length(part: MeshPart) -> float:
    """Texels along a unit of length of the surface, on average."""
    height, width = part.texture.shape[:2]
    a, b, c = np.moveaxis(part.vertices[part.faces], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    p, q, r = np.moveaxis(np.nan_to_num(part.uv), 1, 0)
    d, e = q - p, r - p
    return float(np.sqrt(np.abs(d[:, 0] * e[:, 1] - d[:, 1] * e[:, 0]).sum() * width * height / max(area, 1e-30)))
