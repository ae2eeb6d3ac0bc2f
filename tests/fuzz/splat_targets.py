"""Readers of splats, meshes, skinned meshes and images, with sound samples of each format."""

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import trimesh

from assets.formats.gltf import PIXELS_MAX, read_mesh, read_rig
from assets.images import decode_image, read_image_header
from assets.mesh_gaussians import read_triangle_mesh, texture_colours
from assets.splat_files import read_gaussians, write_gaussians
from tests.fuzz.mutations import BYTES, Files, inside_gzip, mutated_json, saved, several
from tests.support import splat_encoders as encode
from tests.support.glb import bar, packed
from tests.support.samples import some_gaussians
from tests.support.splat_encoders import sog_files


def silent(line: str) -> None:
    """Take a report."""


def splat_samples(suffix: str) -> Callable[[Path], list[Files]]:
    def samples(folder: Path) -> list[Files]:
        g = some_gaussians(14, 1)
        match suffix:
            case ".ply":
                text = np.array(list(encode.properties(g).values())).T
                forms = [encode.ply_bytes(encode.properties(some_gaussians(9, d))) for d in (0, 3)]
                forms += [encode.compressed_bytes(some_gaussians(270, 1)), encode.compressed_bytes(g, order=">")]
                names = encode.properties(g)
                head = ["ply", "format ascii 1.0", f"element vertex {len(g)}", *(f"property float {n}" for n in names)]
                lines = [" ".join(f"{v:.5g}" for v in row) for row in text]
                forms.append("\n".join([*head, "end_header", *lines, ""]).encode())
            case ".splat":
                forms = [encode.splat_bytes(g)]
            case ".ksplat":
                forms = [encode.ksplat_bytes([some_gaussians(20, 1)], level) for level in (0, 1, 2)]
            case ".spz":
                version_3 = saved(folder, "s.spz", lambda path: write_gaussians(path, g))["s.spz"]
                forms = [version_3, encode.spz_4_bytes(version_3)]
                forms.append(encode.spz_bytes(1, b"\0\0\0\x3c\0\0", rotation=b"\x80" * 3))
            case _:
                forms = [encode.zipped(encode.sog_files(g, version)) for version in (1, 2)]
        return [{f"splat{suffix}": data} for data in forms]

    return samples


def unzipped_sog(folder: Path) -> list[Files]:
    return [sog_files(some_gaussians(14, 1), version) for version in (1, 2)]


def read_splat(path: Path) -> None:
    read_gaussians(path, silent).check(str(path))


def inside_gzip_only(rng: np.random.Generator, files: Files) -> Files:
    data = next(iter(files.values()))
    return (inside_gzip if data[:2] == b"\x1f\x8b" else several(BYTES))(rng, files)


def inside_sog(rng: np.random.Generator, files: Files) -> Files:
    if "meta.json" in files and rng.random() < 0.5:
        return files | {"meta.json": mutated_json(rng, files["meta.json"])}
    return several(BYTES)(rng, files)


def mesh_samples(folder: Path) -> list[Files]:
    """A box in each of the formats of triangle meshes, one of them with a texture."""
    box = trimesh.creation.box()
    kinds = ("obj", "stl", "off", "ply", "glb")
    made = [box.export(file_type=kind, **({"encoding": "ascii"} if kind == "ply" else {})) for kind in kinds]
    texts = [text.encode() if isinstance(text, str) else text for text in made]
    found = [{f"mesh.{kind}": text} for kind, text in zip(kinds, texts, strict=True)]
    uv = b"".join(b"vt %.2f %.2f\n" % (k / 8, 1 - k / 8) for k in range(8))
    faces = b"".join(b"f " + b" ".join(b"%d/%d" % (v + 1, v + 1) for v in face) + b"\n" for face in box.faces.tolist())
    points = b"".join(b"v %.2f %.2f %.2f\n" % tuple(v) for v in box.vertices.tolist())
    material = b"newmtl m\nKd 0.5 0.4 0.3\nmap_Kd image.png\n"
    textured = b"mtllib mesh.mtl\nusemtl m\n" + points + uv + faces
    found.append({"mesh.obj": textured, "mesh.mtl": material, "image.png": image_samples(folder)[0]["image.png"]})
    return found


def read_mesh_file(path: Path) -> None:
    for part in read_triangle_mesh(path):
        with np.errstate(all="ignore"):
            texture_colours(part, np.zeros(3, int), np.full((3, 3), 1 / 3), 0.01)


def glb_samples(folder: Path) -> list[Files]:
    builder, scene = bar()
    return [{"rig.glb": packed(json.dumps(scene).encode(), builder.binary)}]


def inside_glb(rng: np.random.Generator, files: Files) -> Files:
    """The JSON or the buffer of a .glb mutated, in a sound container."""
    ((name, data),) = files.items()
    size = int.from_bytes(data[12:16], "little")
    text, binary = data[20 : 20 + size], data[28 + size :]
    if rng.random() < 0.7:
        text = mutated_json(rng, text)
    else:
        binary = several(BYTES)(rng, {"": binary})[""]
    return {name: packed(text, binary)}


def read_skinned_glb(path: Path) -> None:
    rig, file = read_rig(path)
    read_mesh(file, len(rig.joints))


def image_samples(folder: Path) -> list[Files]:
    pixels = np.random.default_rng(0).integers(0, 255, (20, 30, 3), np.uint8)
    kinds = (".png", ".jpg", ".webp")
    return [{f"image{kind}": cv2.imencode(kind, pixels)[1].tobytes()} for kind in kinds]


def read_image(path: Path) -> None:
    data = path.read_bytes()
    header = read_image_header(data)
    if header is not None and 0 < header.width * header.height <= PIXELS_MAX:
        decode_image(data)
