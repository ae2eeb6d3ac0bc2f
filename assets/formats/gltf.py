"""Reading of binary glTF 2.0 (.glb) from untrusted sources: accessors, images, and a skinned body with its motion.

Khronos, glTF 2.0 Specification: 4.4 the binary container, 3.6.2 accessors, 3.5.3 transformations, 3.7.3 skins, 3.11
animations, appendix C interpolation. One self-contained file: no other file is opened, and each size is checked
against the bytes that are there before memory of that size is allocated.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from assets.animation import decompose, slerp
from assets.file_access import open_input
from assets.gaussians import MAGNITUDE_MAX
from assets.images import decode_image, read_image_header
from core.errors import BadInput
from core.typed import Range, Shape, from_json, from_plain

GLB_MAGIC, GLB_VERSION = b"glTF", 2
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
FILE_MAX = 1 << 30  # [bytes] that are taken into memory
JSON_MAX = 64 << 20  # [bytes]
ITEMS_MAX = 20_000_000  # elements of an accessor
PIXELS_MAX = 8192 * 8192  # of a texture
COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
INDICES = (5121, 5123, 5125)
TYPE_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}  # MAT2 and MAT3 are padded
SPLATTING = "KHR_gaussian_splatting"
HARMLESS_EXTENSIONS = ("KHR_materials_", "KHR_lights_", "KHR_texture_transform", "KHR_mesh_quantization")  # if required


class GlbFile:
    """An open .glb. Every method raises BadInput with one line that names the file and the defect.

    json  the scene description, a dict
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        with open_input(self.path) as file:
            size = self.path.stat().st_size
            if size > FILE_MAX:
                raise self.error(f"has {size} bytes, at most {FILE_MAX} are read")
            data = file.read()
        self.json, self._binary = self._chunks(data)
        for name in self.list(self.json, "extensionsRequired"):
            if not (isinstance(name, str) and (name.startswith(HARMLESS_EXTENSIONS) or name == SPLATTING)):
                raise self.error(f"requires the extension {str(name)[:60]!r}, which is not supported")

    def error(self, defect: str) -> BadInput:
        """The error to raise."""
        return BadInput(f"{self.path}: {defect}")

    def _chunks(self, data: bytes) -> tuple[dict, memoryview]:
        if len(data) < 20 or data[:4] != GLB_MAGIC:
            raise self.error("not a binary glTF file (.glb)")
        version, length, size, kind = struct.unpack_from("<IIII", data, 4)
        if version != GLB_VERSION:
            raise self.error(f"version {version} of glTF, this program reads version {GLB_VERSION}")
        if length > len(data):
            raise self.error(f"is truncated: {len(data)} of {length} bytes are there")
        if kind != JSON_CHUNK or size > min(length - 20, JSON_MAX):
            raise self.error("its first chunk is not a JSON text that fits the file")
        found = from_json(dict[str, Any], data[20 : 20 + size], f"{self.path}: its JSON chunk")
        at = 20 + size
        if at + 8 > length:
            return found, memoryview(b"")
        size, kind = struct.unpack_from("<II", data, at)
        if kind != BINARY_CHUNK or size > length - at - 8:
            raise self.error("its binary chunk does not fit the file")
        return found, memoryview(data)[at + 8 : at + 8 + size]

    def list(self, parent: dict, key: str) -> list:
        """The list parent[key], empty if it is not there."""
        return from_plain(list[Any], parent.get(key, []), f"{self.path}: {key}")

    def item(self, kind: str, index) -> dict:
        """Entry `index` of the file's list `kind` ("nodes", "meshes" ...)."""
        items = self.json.get(kind)
        if not isinstance(items, list):  # `list` looks at all entries, which is too slow for each of many
            items = self.list(self.json, kind)
        if isinstance(index, bool) or not isinstance(index, int) or not 0 <= index < len(items):
            raise self.error(f"names one of its {kind} that is not there: {str(index)[:20]} of {len(items)}")
        if not isinstance(items[index], dict):
            raise self.error(f"entry {index} of {kind} is not an object")
        return items[index]

    def integer(self, parent: dict, key: str, largest: int, default: int | None = None) -> int:
        """The whole number parent[key], 0 to `largest`."""
        return from_plain(Annotated[int, Range(0, largest)], parent.get(key, default), f"{self.path}: {key}")

    def numbers(self, parent: dict, key: str, default: tuple) -> np.ndarray:
        """The list of finite numbers parent[key], as many as `default` has, float64."""
        kind = Annotated[np.ndarray, Shape(len(default))]
        return from_plain(kind, parent.get(key, list(default)), f"{self.path}: {key}")

    def view(self, index) -> tuple[memoryview, int]:
        """The bytes of a buffer view, and its stride, 0 if what it holds is packed."""
        view = self.item("bufferViews", index)
        buffer = self.item("buffers", view.get("buffer"))
        if view.get("buffer") != 0 or "uri" in buffer:
            raise self.error("keeps data in another file; only a self-contained .glb is read")
        have = len(self._binary)
        begin = self.integer(view, "byteOffset", have, 0)
        length = self.integer(view, "byteLength", have - begin)
        return self._binary[begin : begin + length], self.integer(view, "byteStride", 252, 0)

    def _packed(self, of: dict, kind: int, count: int, width: int) -> np.ndarray:
        """`count` rows of `width` components that begin at byteOffset of a view."""
        if kind not in COMPONENTS:
            raise self.error(f"an accessor's component type {str(kind)[:20]} is unknown")
        dtype = np.dtype(COMPONENTS[kind])
        data, stride = self.view(of.get("bufferView"))
        row = dtype.itemsize * width
        stride = stride or row
        begin = self.integer(of, "byteOffset", len(data), 0)
        if stride < row or begin + stride * (count - 1) + row > len(data):
            raise self.error(f"an accessor claims {count} elements, more than its buffer view holds")
        return np.ndarray((count, width), dtype, data, begin, (stride, dtype.itemsize)).copy()

    def accessor(self, index, *, kinds: tuple[str, ...], integer: bool = False, count: int | None = None) -> np.ndarray:
        """An accessor's elements, (count, width) float64, or int64 where `integer`; sparse ones filled in.

        kinds  what its type may be ("VEC3" ...);  count  how many elements it must have; None: any number but 0
        """
        of = self.item("accessors", index)
        kind, shape = of.get("componentType"), of.get("type")
        if shape not in kinds:
            raise self.error(f"accessor {index} is of type {str(shape)[:20]}, expected {' or '.join(kinds)}")
        width = TYPE_WIDTHS[shape]
        n = self.integer(of, "count", ITEMS_MAX)
        if n == 0 or (count is not None and n != count):
            raise self.error(f"accessor {index} has {n} elements, expected {'some' if count is None else count}")
        if not isinstance(kind, int) or (integer and kind not in INDICES):
            raise self.error(f"accessor {index} has components of the wrong type, {str(kind)[:20]}")
        sparse = of.get("sparse")
        if "bufferView" in of:
            values = self._packed(of, kind, n, width)
        elif sparse is None or kind not in COMPONENTS:
            raise self.error(f"accessor {index} has no data")
        else:
            if n * width > 4 * len(self._binary) + (1 << 20):  # zeros that no byte stands for
                raise self.error(f"accessor {index} claims {n} elements, more than this file may hold")
            values = np.zeros((n, width), COMPONENTS[kind])
        if sparse is not None:
            self._apply_sparse(sparse, kind, values)
        if integer:
            return values.astype(np.int64)
        with np.errstate(invalid="ignore"):  # a signalling NaN
            floats = values.astype(np.float64)
        if not np.isfinite(floats).all():
            raise self.error(f"accessor {index} holds a number that is not finite")
        if of.get("normalized") is not True or kind == 5126:
            return floats
        return np.maximum(floats * (1.0 / np.iinfo(values.dtype).max), -1.0)  # -128 of a byte stands for -1, too

    def _apply_sparse(self, sparse, kind: int, values: np.ndarray) -> None:
        """Overwrite the elements that a sparse accessor lists."""
        if not all(isinstance(x, dict) for x in (sparse, *(sparse.get(k) for k in ("indices", "values")))):
            raise self.error("a sparse accessor is damaged")
        n = self.integer(sparse, "count", len(values))
        index_kind = sparse["indices"].get("componentType")
        if n == 0 or index_kind not in INDICES:
            raise self.error("a sparse accessor is damaged")
        where = self._packed(sparse["indices"], index_kind, n, 1)[:, 0].astype(np.int64)
        if where.max() >= len(values):
            raise self.error("a sparse accessor names an element that is not there")
        values[where] = self._packed(sparse["values"], kind, n, values.shape[1])

    def image(self, index) -> np.ndarray:
        """Pixels of a PNG or JPEG image of the file, (H, W, 3) uint8 RGB."""
        image = self.item("images", index)
        if "bufferView" not in image:
            raise self.error("keeps a picture in another file; only a self-contained .glb is read")
        data = bytes(self.view(image["bufferView"])[0])
        header = read_image_header(data)
        if header is None or header.format == "webp" or not 0 < header.width * header.height <= PIXELS_MAX:
            raise self.error(f"image {index} is no PNG or JPEG of at most {PIXELS_MAX} pixels")
        pixels = decode_image(data)
        if pixels is None:
            raise self.error(f"image {index} is damaged")
        return pixels


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


def read_rig(path: str | Path) -> tuple[Rig, GlbFile]:
    """The first skin of a .glb and its first animation, sampled, with the open file. Raises BadInput."""
    file = GlbFile(path)
    nodes = file.list(file.json, "nodes")
    if not 0 < len(nodes) <= NODES_MAX:
        raise file.error(f"has {len(nodes)} nodes, expected 1 to {NODES_MAX}")
    if not file.list(file.json, "skins"):
        raise file.error("has no skin: a rigged mesh is needed")
    order, parents = node_order(file, len(nodes))
    place = np.empty(len(nodes), np.int64)
    place[order] = np.arange(len(nodes))
    rest = [np.stack(x) for x in zip(*(local_pose(file, file.item("nodes", int(k))) for k in order), strict=True)]
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
    frames, rate, name = _sampled(file, rest, place)
    names = [str(nodes[k].get("name", f"node {k}"))[:100] for k in order]
    rig = Rig(names, np.where(parents[order] < 0, -1, place[parents[order]]), place[joints], bind, tuple(rest), frames,
              rate, name)  # fmt: skip
    return rig, file


def node_order(file: GlbFile, count: int) -> tuple[np.ndarray, np.ndarray]:
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


def local_pose(file: GlbFile, node: dict) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Translation, rotation wxyz and scale of a node."""
    if "matrix" in node:
        m = file.numbers(node, "matrix", tuple(np.eye(4).ravel())).reshape(4, 4).T
        if np.abs(m).max() > MAGNITUDE_MAX:
            raise file.error("a node's matrix is too large")
        t, q, s, off = decompose(m[None])
        if off[0] > 1e-3:
            raise file.error("a node's matrix shears, or mirrors")
        return t[0], q[0], s[0]
    q = file.numbers(node, "rotation", (0.0, 0.0, 0.0, 1.0))[[3, 0, 1, 2]]
    if not 1e-3 < np.linalg.norm(q) < 1e3:
        raise file.error("a node's rotation is no quaternion")
    scale = file.numbers(node, "scale", (1.0, 1.0, 1.0))
    return file.numbers(node, "translation", (0.0, 0.0, 0.0)), q / np.linalg.norm(q), scale


def _sampled(file: GlbFile, rest: list[np.ndarray], place: np.ndarray):
    """The first animation, at a whole number of frames, about SAMPLE_RATE a second: (t, q, s), its rate and name."""
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
    times = {id(s): file.accessor(s.get("input"), kinds=("SCALAR",))[:, 0] for _, _, s in channels}
    if any((np.diff(t) <= 0).any() for t in times.values()):
        raise file.error("the times of an animation do not rise")
    begin, end = min(t[0] for t in times.values()), max(t[-1] for t in times.values())
    if not 0 < end - begin <= DURATION_MAX:
        raise file.error(f"its animation lasts {end - begin:.3g} s; more than 0 to {DURATION_MAX:g} s can be played")
    count = max(round((end - begin) * SAMPLE_RATE), 2)
    at = begin + (end - begin) * np.arange(count + 1) / count  # the last repeats the first, if the motion is periodic
    frames = [np.tile(x, (count + 1, 1, 1)) for x in rest]
    for node, path, sampler in channels:
        kind = ("translation", "rotation", "scale").index(path)
        frames[kind][:, node] = _channel(file, sampler, times[id(sampler)], at, kind == 1)
    return tuple(frames), count / (end - begin), str(animation.get("name", ""))[:100]


def _channel(file: GlbFile, sampler: dict, times: np.ndarray, at: np.ndarray, rotation: bool) -> np.ndarray:
    """A channel's values at the times `at`: (n, 3), or quaternions wxyz (n, 4)."""
    kind = sampler.get("interpolation", "LINEAR")
    if kind not in ("LINEAR", "STEP", "CUBICSPLINE"):
        raise file.error(f"interpolation {str(kind)[:20]!r} is unknown")
    cubic = kind == "CUBICSPLINE"
    kinds, count = ("VEC4",) if rotation else ("VEC3",), len(times) * (3 if cubic else 1)
    values = file.accessor(sampler.get("output"), kinds=kinds, count=count)
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


def read_mesh(file: GlbFile, joints: int) -> SkinnedMesh:
    """All triangles bound to the first skin, of `joints` joints, with their colours. Raises BadInput."""
    found, textures, known, faces, vertices = [], [], {}, 0, 0
    for node in file.list(file.json, "nodes"):
        if node.get("skin") != 0 or "mesh" not in node:
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
