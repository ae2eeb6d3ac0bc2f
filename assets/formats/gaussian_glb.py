"""Splats as .glb: binary glTF 2.0 with the Khronos extension KHR_gaussian_splatting, read from untrusted sources.

A primitive of points is a set of Gaussians: POSITION, ROTATION (xyzw), SCALE (standard deviations [m], not their logs;
logs in drafts before 2026), OPACITY (not a logit) and SH_DEGREE_l_COEF_n, red, green and blue of a coefficient, with
the basis of the .ply. +y is up. Several nodes are several objects, called by their names. `sortingMethod`
cameraDistance is our order radial; what the extension has no word for stands in `extras`.
"""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np

from assets.file_access import atomic_write, open_input
from assets.formats import gltf
from assets.formats.packing import ALPHA_EPSILON, to_bytes
from assets.gaussians import (
    SH_COUNTS,
    SORTS,
    Gaussians,
    Report,
    axes_of,
    concatenate,
    drawable_gaussians,
    is_object_name,
    usable_view,
)
from core.errors import BadInput
from core.rotation import matrices_from_quaternions
from core.spherical_harmonics import C0, rotate_sh

SORTING = {"cameraDistance": "radial", "zDepth": "z"}
KNOWN = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display", "projection": "perspective"}
POSITION = "POSITION"
ROTATION, SCALE, OPACITY = (f"{gltf.SPLATTING}:{name}" for name in ("ROTATION", "SCALE", "OPACITY"))
COEFFICIENTS = [f"{gltf.SPLATTING}:SH_DEGREE_{degree}_COEF_{n}" for degree in range(4) for n in range(2 * degree + 1)]
SCALE_MIN = float(np.finfo(np.float32).tiny)  # [m] so that the log of a flat Gaussian's is finite
UNIFORM = 1e-5  # of a node's scale: by less, its axes differ by rounding
ARRAY_BUFFER = 34962  # of glTF: vertex attributes
REPEATS = 16  # bytes in memory for one of the file, at most: 4 for what is stored as bytes, and nodes that share a mesh
ROW_BYTES = 4 * (3 + 4 + 3 + 1)  # of a Gaussian in memory, without harmonics


def has_splats(path: Path) -> bool:
    """True for a .glb whose JSON names the extension."""
    with open_input(path) as file:
        size = int.from_bytes(file.read(16)[12:16], "little")
        return f'"{gltf.SPLATTING}"'.encode() in file.read(min(size, gltf.JSON_MAX) + 4)


def read_glb(path: str | Path, report: Report = print) -> Gaussians:
    """All Gaussians of a .glb, where its nodes place them. Raises BadInput.

    `report` takes a line if some were dropped, and for each thing that is not drawn as the file says.
    """
    file, said = gltf.GlbFile(path), set()
    nodes = file.list(file.json, "nodes")
    if len(nodes) > gltf.NODES_MAX:
        raise file.error(f"has {len(nodes)} nodes, at most {gltf.NODES_MAX} are read")
    order, parents = gltf.node_order(file, len(nodes))
    world, sets, room = np.tile(np.eye(4), (len(nodes), 1, 1)), [], REPEATS * file.path.stat().st_size
    for k in order.tolist():
        t, q, s = gltf.local_pose(file, nodes[k])
        world[k, :3, :3], world[k, :3, 3] = matrices_from_quaternions(q[None])[0] * s, t
        if parents[k] >= 0:
            with np.errstate(over="ignore", invalid="ignore"):  # refused below
                world[k] = world[parents[k]] @ world[k]
        primitives = file.list(file.item("meshes", nodes[k]["mesh"]), "primitives") if "mesh" in nodes[k] else []
        for primitive in primitives:
            about = _extension(file, primitive)
            if about is None:
                said.add("its meshes and points that are no splats")
                continue
            said |= {f"its {key} {about[key]!r:.40}" for key, known in KNOWN.items() if about.get(key, known) != known}
            g = _primitive(file, primitive["attributes"], about, report)
            room -= len(g) * (ROW_BYTES + 12 * g.sh.shape[1])
            if room < 0:
                raise file.error("its nodes show the same Gaussians more often than a file of its size may")
            sets.append((nodes[k], _placed(file, g, world[k])))
    if not sets:
        raise file.error("holds no Gaussians")
    if said:
        report(f"{file.path}: ignored {', '.join(sorted(said))}")
    found = concatenate([_named(node, g, len(sets) > 1) for node, g in sets])
    found.check(str(file.path))
    return found


def _extension(file: gltf.GlbFile, primitive) -> dict | None:
    """The extension of a primitive, if it has it."""
    extensions = primitive.get("extensions") if isinstance(primitive, dict) else None
    about = extensions.get(gltf.SPLATTING) if isinstance(extensions, dict) else None
    if about is None:
        return None
    if not isinstance(about, dict) or not isinstance(primitive.get("attributes"), dict) or primitive.get("mode") != 0:
        raise file.error("a primitive of splats is damaged")
    return about


def _primitive(file: gltf.GlbFile, attributes: dict, about: dict, report: Report) -> Gaussians:
    """The Gaussians of a primitive, in the frame of its node."""
    degree = max((d for d in range(4) if COEFFICIENTS[d * d] in attributes), default=0)
    names = COEFFICIENTS[: SH_COUNTS[degree]]
    for name in (POSITION, ROTATION, SCALE, OPACITY, *names):
        if name not in attributes:
            raise file.error(f"its splats lack the attribute {name}")
    means = file.accessor(attributes[POSITION], kinds=("VEC3",)).astype(np.float32)
    n = len(means)
    sh = np.empty((n, SH_COUNTS[degree], 3), np.float32)
    for k, name in enumerate(names):
        sh[:, k] = file.accessor(attributes[name], kinds=("VEC3",), count=n)
    quats = file.accessor(attributes[ROTATION], kinds=("VEC4",), count=n)[:, [3, 0, 1, 2]]
    scales = file.accessor(attributes[SCALE], kinds=("VEC3",), count=n)
    alpha = file.accessor(attributes[OPACITY], kinds=("SCALAR",), count=n)[:, 0].clip(ALPHA_EPSILON, 1 - ALPHA_EPSILON)
    logs = scales if (scales < 0).any() else np.log(np.maximum(scales, SCALE_MIN))
    extras = about.get("extras") if isinstance(about.get("extras"), dict) else {}
    sort = extras.get("sort") if extras.get("sort") in SORTS else SORTING.get(str(about.get("sortingMethod")), "radial")
    told = {"sort": sort, "antialias": extras.get("antialias") is True, "view": usable_view(extras.get("view"))}
    logits = np.log(alpha / (1 - alpha))
    return drawable_gaussians(file.path, means, quats, logs, logits, sh, report, **told)


def _placed(file: gltf.GlbFile, g: Gaussians, world: np.ndarray) -> Gaussians:
    """The Gaussians of a node with the transformation `world` (4, 4), which may stretch and mirror them."""
    if np.array_equal(world, np.eye(4)):
        return g
    if not np.isfinite(world).all() or np.linalg.cond(world[:3, :3]) > 1 / UNIFORM:
        raise file.error("the transformation of a node is not finite, or flattens what it shows")
    u, scale, vt = np.linalg.svd(world[:3, :3])
    rotation = u @ vt
    with np.errstate(over="ignore", invalid="ignore"):  # refused by `check`
        if scale[0] - scale[2] <= UNIFORM * scale[0] and np.linalg.det(rotation) > 0:
            return g.transformed(rotation, world[:3, 3], float(scale.mean()))
        half = world[:3, :3] @ (matrices_from_quaternions(g.quats) * np.exp(g.log_scales.astype(np.float64))[:, None])
        sigma = half @ half.transpose(0, 2, 1)
        if not np.isfinite(sigma).all():
            raise file.error("the transformation of a node is too large")
        means = g.means @ world[:3, :3].T + world[:3, 3]
        trained = {"sort": g.sort, "antialias": g.antialias}
        return Gaussians.of(means, *axes_of(sigma), g.logit_opacities, rotate_sh(g.sh, rotation), **trained)


def _named(node: dict, g: Gaussians, several: bool) -> Gaussians:
    """The Gaussians as an object of a node's name, if there are several nodes or the node says so."""
    extras, name = node.get("extras"), node.get("name")
    one = isinstance(extras, dict) and extras.get("object") is True
    if not (several or one) or not isinstance(name, str) or not is_object_name(name):
        return g
    return replace(g, object_id=np.ones(len(g), np.uint16), objects=(name,))


def object_order(g: Gaussians) -> np.ndarray:
    """Order (N,) in which `write_glb` stores Gaussians: object by object."""
    return np.argsort(g.object_id, kind="stable")


def write_glb(path: str | Path, g: Gaussians) -> None:
    """Write a .glb, a node an object, all float32 and in the axes that the Gaussians have. Raises BadInput."""
    blobs, views, accessors, meshes, nodes, begin = [], [], [], [], [], 0
    extras = {"sort": g.sort} if g.sort else {}
    extras |= {"antialias": True} if g.antialias else {}
    extras |= {"view": g.view} if g.view else {}
    method = next((method for method, sort in SORTING.items() if sort == g.sort), "cameraDistance")
    about = KNOWN | {"sortingMethod": method, **({"extras": extras} if extras else {})}
    for index in np.unique(g.object_id).tolist():
        part, attributes = g.select(g.object_id == index), {}
        alpha = part.opacities.astype(np.float64)[:, None]
        colour = to_bytes(255 * np.concatenate([part.sh[:, 0] * C0 + 0.5, alpha], axis=1))
        columns = {POSITION: part.means, "COLOR_0": colour, ROTATION: part.quats[:, [1, 2, 3, 0]]}
        columns |= {SCALE: np.exp(part.log_scales.astype(np.float64)), OPACITY: alpha}
        columns |= {name: part.sh[:, k] for k, name in enumerate(COEFFICIENTS[: g.sh.shape[1]])}
        for name, values in columns.items():
            integer = values.dtype == np.uint8
            blobs.append(values.tobytes() if integer else values.astype("<f4").tobytes())
            views.append({"buffer": 0, "byteOffset": begin, "byteLength": len(blobs[-1]), "target": ARRAY_BUFFER})
            begin += len(blobs[-1])
            attributes[name] = len(accessors)
            kind = {"componentType": 5121, "normalized": True} if integer else {"componentType": 5126}
            kind["type"] = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[values.shape[1]]
            accessors.append({"bufferView": len(views) - 1, "count": len(part), **kind})
        limits = {"min": part.means.min(0).tolist(), "max": part.means.max(0).tolist()}
        accessors[attributes[POSITION]] |= limits
        meshes.append({"primitives": [{"attributes": attributes, "mode": 0, "extensions": {gltf.SPLATTING: about}}]})
        name = g.objects[index - 1] if 0 < index <= len(g.objects) else f"object_{index}"
        nodes.append({"mesh": len(nodes)} | ({"name": name, "extras": {"object": True}} if index else {}))
    if begin > gltf.FILE_MAX - gltf.JSON_MAX:
        raise BadInput(f"{path}: {len(g)} Gaussians are too many for a .glb of at most {gltf.FILE_MAX} bytes")
    scene = {"asset": {"version": "2.0", "generator": "VR-GS"}, "extensionsUsed": [gltf.SPLATTING], "scene": 0}
    scene |= {"scenes": [{"nodes": list(range(len(nodes)))}], "nodes": nodes, "meshes": meshes}
    scene |= {"buffers": [{"byteLength": begin}], "bufferViews": views, "accessors": accessors}
    text = json.dumps(scene, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    with atomic_write(path) as beside, open(beside, "wb") as file:
        file.write(struct.pack("<4sIIII", gltf.GLB_MAGIC, 2, 28 + len(text) + begin, len(text), gltf.JSON_CHUNK) + text)
        file.write(struct.pack("<II", begin, gltf.BINARY_CHUNK))
        file.writelines(blobs)
