"""The skinned body of a .glb: its nodes, the skin, one animation, and the mesh with its colours.

Khronos, glTF 2.0 Specification: 3.5.3 transformations, 3.7.3 skins, 3.11 animations, appendix C interpolation.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from assets.animation import decompose, slerp
from assets.formats.gltf import GlbFile

NODES_MAX = 4096
TRIANGLES_MAX = 5_000_000
SAMPLE_RATE = 60.0  # [1/s] of keyframes: about the frame rate of a screen, so interpolation loses nothing
DURATION_MAX = 600.0  # [s] of an animation
STORED_WEIGHT_TOLERANCE = 0.05  # of a vertex's weights before they are normalised


@dataclass(frozen=True)
class SkinnedMesh:
    """A skinned mesh in its bind pose, as stored.

    vertices (V, 3) [m]; faces (F, 3) int64; joints (V, K) int64, into the skin's list; weights (V, K), rows sum to 1
    colours  linear RGB in 0..1 of each corner of each face, (F, 3, 3), by which a texture is multiplied
    uv       (F, 3, 2) texture coordinates, or NaN;  texture  index into `textures`, (F,), -1 for none
    textures [(H, W, 3) uint8]
    """

    vertices: np.ndarray
    faces: np.ndarray
    joints: np.ndarray
    weights: np.ndarray
    colours: np.ndarray
    uv: np.ndarray
    texture: np.ndarray
    textures: list[np.ndarray]


@dataclass(frozen=True)
class Rig:
    """A skeleton and its motion. Parents come before their children.

    names     of the nodes, [J];  parents (J,) int64, -1 for none
    joints    node of each joint of the skin, (S,);  inverse_bind (S, 4, 4)
    rest      local translation (J, 3), rotation wxyz (J, 4), scale (J, 3) of the file's nodes
    frames    the same of each sampled frame, (F, J, 3), (F, J, 4), (F, J, 3); frame k is at k / fps
    fps       [1/s];  animation  its name
    """

    names: list[str]
    parents: np.ndarray
    joints: np.ndarray
    inverse_bind: np.ndarray
    rest: tuple[np.ndarray, np.ndarray, np.ndarray]
    frames: tuple[np.ndarray, np.ndarray, np.ndarray]
    fps: float
    animation: str


def read_rig(path: str | Path, fps: float = SAMPLE_RATE) -> tuple[Rig, GlbFile, int]:
    """The first skin of a .glb and its first animation, sampled, with the open file and the skin's index.

    Raises BadInput.
    """
    file = GlbFile(path)
    nodes = file.list(file.json, "nodes")
    if not 0 < len(nodes) <= NODES_MAX:
        raise file.error(f"has {len(nodes)} nodes, expected 1 to {NODES_MAX}")
    if not file.list(file.json, "skins"):
        raise file.error("has no skin: a rigged mesh is needed")
    order, parents = _order(file, len(nodes))
    place = np.empty(len(nodes), np.int64)
    place[order] = np.arange(len(nodes))
    rest = [np.stack(x) for x in zip(*(_local(file, file.item("nodes", int(k))) for k in order), strict=True)]
    skin = file.item("skins", 0)
    joints = file.list(skin, "joints")
    for j in joints:
        file.item("nodes", j)
    if not joints or len(set(joints)) != len(joints):
        raise file.error("the skin names no joints, or one of them twice")
    bind = np.tile(np.eye(4), (len(joints), 1, 1))
    if "inverseBindMatrices" in skin:
        flat = file.accessor(skin["inverseBindMatrices"], kinds=("MAT4",))
        if len(flat) < len(joints):
            raise file.error(f"has {len(flat)} inverse bind matrices for {len(joints)} joints")
        bind = np.swapaxes(flat[: len(joints)].reshape(-1, 4, 4), 1, 2)  # they are stored by columns
    if (np.abs(np.linalg.det(bind[:, :3, :3])) < 1e-12).any() or (bind[:, 3] != [0, 0, 0, 1]).any():
        raise file.error("an inverse bind matrix cannot be inverted")
    frames, rate, name = _sampled(file, rest, place, fps)
    names = [str(nodes[k].get("name", f"node {k}"))[:100] for k in order]
    rig = Rig(names, np.where(parents[order] < 0, -1, place[parents[order]]), place[joints], bind, tuple(rest), frames,
              rate, name)  # fmt: skip
    return rig, file, 0


def _order(file: GlbFile, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Node indices with parents before their children, and the parent of each node, -1 for none."""
    parents = np.full(count, -1, np.int64)
    children = [file.list(file.item("nodes", k), "children") for k in range(count)]
    for k, mine in enumerate(children):
        for c in mine:
            file.item("nodes", c)
            if parents[c] >= 0:
                raise file.error(f"node {c} has two parents")
            parents[c] = k
    order = [k for k in range(count) if parents[k] < 0]
    for k in order:  # grows while it is walked
        order += children[k]
    if len(order) != count:
        raise file.error("its nodes form a ring")
    return np.array(order), parents


def _local(file: GlbFile, node: dict) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Translation, rotation wxyz and scale of a node."""
    if "matrix" in node:
        m = file.numbers(node, "matrix", tuple(np.eye(4).ravel())).reshape(4, 4).T
        t, q, s, off = decompose(m[None])
        if off[0] > 1e-3:
            raise file.error("a node's matrix shears, or mirrors")
        return t[0], q[0], s[0]
    q = file.numbers(node, "rotation", (0.0, 0.0, 0.0, 1.0))[[3, 0, 1, 2]]
    if not 1e-3 < np.linalg.norm(q) < 1e3:
        raise file.error("a node's rotation is no quaternion")
    scale = file.numbers(node, "scale", (1.0, 1.0, 1.0))
    return file.numbers(node, "translation", (0.0, 0.0, 0.0)), q / np.linalg.norm(q), scale


def _sampled(file: GlbFile, rest: list[np.ndarray], place: np.ndarray, fps: float):
    """The first animation, sampled at a whole number of frames at about `fps`: (t, q, s), its rate and name."""
    animations = file.list(file.json, "animations")
    if not animations:
        raise file.error("has no animation")
    animation = file.item("animations", 0)
    samplers, channels = file.list(animation, "samplers"), []
    for c in file.list(animation, "channels"):
        target = c.get("target") if isinstance(c, dict) else None
        if not isinstance(target, dict):
            raise file.error("an animation's channel is damaged")
        path = target.get("path")
        if path not in ("translation", "rotation", "scale") or "node" not in target:
            continue  # weights of morph targets
        file.item("nodes", target["node"])
        s = file.integer(c, "sampler", len(samplers) - 1)
        if not isinstance(samplers[s], dict):
            raise file.error("an animation's sampler is damaged")
        channels.append((int(place[target["node"]]), path, samplers[s]))
    if not channels:
        raise file.error("its animation moves no node")
    times = {id(s): _times(file, s) for _, _, s in channels}
    begin, end = min(t[0] for t in times.values()), max(t[-1] for t in times.values())
    if not 0 < end - begin <= DURATION_MAX:
        raise file.error(f"its animation lasts {end - begin:.3g} s; more than 0 to {DURATION_MAX:g} s can be played")
    count = max(round((end - begin) * fps), 2)
    at = begin + (end - begin) * np.arange(count + 1) / count  # the last repeats the first, if the motion is periodic
    frames = [np.tile(x, (count + 1, 1, 1)) for x in rest]
    for node, path, sampler in channels:
        kind = ("translation", "rotation", "scale").index(path)
        frames[kind][:, node] = _channel(file, sampler, times[id(sampler)], at, kind == 1)
    return tuple(frames), count / (end - begin), str(animation.get("name", ""))[:100]


def _times(file: GlbFile, sampler: dict) -> np.ndarray:
    """Ascending times [s] of a sampler."""
    times = file.accessor(sampler.get("input"), kinds=("SCALAR",))[:, 0]
    if (np.diff(times) <= 0).any():
        raise file.error("the times of an animation do not rise")
    return times


def _channel(file: GlbFile, sampler: dict, times: np.ndarray, at: np.ndarray, rotation: bool) -> np.ndarray:
    """A channel's values at the times `at`: (n, 3), or quaternions wxyz (n, 4)."""
    kind = sampler.get("interpolation", "LINEAR")
    if kind not in ("LINEAR", "STEP", "CUBICSPLINE"):
        raise file.error(f"interpolation {str(kind)[:20]!r} is unknown")
    cubic = kind == "CUBICSPLINE"
    values = file.accessor(sampler.get("output"), kinds=("VEC4",) if rotation else ("VEC3",),
                           count=len(times) * (3 if cubic else 1))  # fmt: skip
    if rotation:
        values = values[:, [3, 0, 1, 2]]
    before = np.searchsorted(times, at, "right").clip(1, max(len(times) - 1, 1)) - 1
    after = np.minimum(before + 1, len(times) - 1)
    step = np.maximum(times[after] - times[before], 1e-12)
    u = ((at - times[before]) / step).clip(0, 1)[:, None]
    if cubic:  # Hermite, with tangents for each second
        into, points, out = values[0::3], values[1::3], values[2::3]
        h = [2 * u**3 - 3 * u**2 + 1, u**3 - 2 * u**2 + u, 3 * u**2 - 2 * u**3, u**3 - u**2]
        found = h[0] * points[before] + h[1] * step[:, None] * out[before]
        found = found + h[2] * points[after] + h[3] * step[:, None] * into[after]
    elif kind == "STEP":
        found = values[np.where(u[:, 0] >= 1, after, before)]
    elif rotation:
        norm = np.linalg.norm(values, axis=1, keepdims=True)
        values = values / np.maximum(norm, 1e-12)
        found = slerp(values[before], values[after], u)
    else:
        found = (1 - u) * values[before] + u * values[after]
    if rotation:
        norm = np.linalg.norm(found, axis=1, keepdims=True)
        if (norm < 1e-6).any():
            raise file.error("an animation's rotation is no quaternion")
        found = found / norm
    return found


def read_mesh(file: GlbFile, skin: int, joints: int) -> SkinnedMesh:
    """All triangles bound to the skin of `joints` joints, with their colours. Raises BadInput."""
    found, textures, known, faces, vertices = [], [], {}, 0, 0
    for node in file.list(file.json, "nodes"):
        if node.get("skin") != skin or "mesh" not in node:
            continue
        for p in file.list(file.item("meshes", node["mesh"]), "primitives"):
            arrays = _primitive(file, p, joints, textures, known)
            faces += len(arrays[1])
            arrays[1] += vertices
            vertices += len(arrays[0])
            if faces > TRIANGLES_MAX:
                raise file.error(f"has more than {TRIANGLES_MAX} triangles")
            found.append(arrays)
    if not found:
        raise file.error("no mesh is bound to its skin")
    return SkinnedMesh(*(np.concatenate(x) for x in zip(*found, strict=True)), textures)


def _primitive(file: GlbFile, p, joints: int, textures: list, known: dict) -> list[np.ndarray]:
    """The arrays of a Mesh for one primitive; its texture is added to `textures` unless it is `known`."""
    attributes = p.get("attributes") if isinstance(p, dict) else None
    if not isinstance(attributes, dict) or p.get("mode", 4) != 4:
        raise file.error("a mesh is not made of triangles")
    x = file.accessor(attributes.get("POSITION"), kinds=("VEC3",))
    n = len(x)
    if "indices" in p:
        index = file.accessor(p["indices"], kinds=("SCALAR",), integer=True)[:, 0]
    else:
        index = np.arange(n)
    if len(index) % 3 or index.max() >= n:
        raise file.error("the triangles of a mesh name a vertex that is not there")
    faces = index.reshape(-1, 3)
    vertex_joints = file.accessor(attributes.get("JOINTS_0"), kinds=("VEC4",), integer=True, count=n)
    weights = file.accessor(attributes.get("WEIGHTS_0"), kinds=("VEC4",), count=n)
    total = weights.sum(1, keepdims=True)
    if (weights < 0).any() or (np.abs(total - 1) > STORED_WEIGHT_TOLERANCE).any():
        raise file.error("the skin's weights of a vertex are negative or do not sum to 1")
    if vertex_joints[weights > 0].max() >= joints:
        raise file.error(f"a vertex follows a joint outside 0..{joints - 1}")
    vertex_joints = np.where(weights > 0, vertex_joints, 0)
    material = file.item("materials", p["material"]) if "material" in p else {}
    pbr = material.get("pbrMetallicRoughness", {})
    if not isinstance(pbr, dict):
        raise file.error("a material is damaged")
    linear = np.tile(file.numbers(pbr, "baseColorFactor", (1.0,) * 4)[:3], (n, 1))
    if "COLOR_0" in attributes:
        linear = linear * file.accessor(attributes["COLOR_0"], kinds=("VEC3", "VEC4"), count=n)[:, :3]
    colours = linear[faces]
    uv, texture = np.full((len(faces), 3, 2), np.nan), np.full(len(faces), -1)
    base = pbr.get("baseColorTexture")
    if isinstance(base, dict) and f"TEXCOORD_{base.get('texCoord', 0)}" in attributes:
        source = file.item("textures", base.get("index")).get("source")
        file.item("images", source)
        if source not in known:
            textures.append(file.image(source))
            known[source] = len(textures) - 1
        uv = file.accessor(attributes[f"TEXCOORD_{base.get('texCoord', 0)}"], kinds=("VEC2",), count=n)[faces]
        texture[:] = known[source]
    return [x, faces, vertex_joints, weights / total, colours, uv, texture]


def srgb_from_linear(linear: np.ndarray) -> np.ndarray:
    """Display values in 0..1 of linear light in 0..1 (IEC 61966-2-1, sRGB)."""
    linear = np.clip(linear, 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def linear_from_srgb(display: np.ndarray) -> np.ndarray:
    """Linear light in 0..1 of display values in 0..1, the inverse of `srgb_from_linear`."""
    return np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)
