"""Reading of binary glTF 2.0 (.glb) from untrusted sources: container, accessors and images.

Khronos, glTF 2.0 Specification: 4.4 the binary container, 3.6.2 accessors. One self-contained file: no other file
is opened, and each size is checked against the bytes that are there before memory of that size is allocated.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np

from assets.file_access import open_input
from assets.images import decode_image, read_image_header
from core.errors import BadInput

GLB_MAGIC, GLB_VERSION = b"glTF", 2
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
FILE_MAX = 1 << 30  # [bytes] that are taken into memory
JSON_MAX = 64 << 20  # [bytes]
ITEMS_MAX = 20_000_000  # elements of an accessor
PIXELS_MAX = 8192 * 8192  # of a texture
COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
INDICES = (5121, 5123, 5125)
TYPE_WIDTHS = {
    "SCALAR": 1,
    "VEC2": 2,
    "VEC3": 3,
    "VEC4": 4,
    "MAT4": 16,
}  # MAT2 and MAT3 are padded
HARMLESS_EXTENSIONS = (
    "KHR_materials_",
    "KHR_lights_",
    "KHR_texture_transform",
    "KHR_mesh_quantization",
)  # may be required


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
            if not (isinstance(name, str) and name.startswith(HARMLESS_EXTENSIONS)):
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
        try:
            found = json.loads(data[20 : 20 + size].decode("utf-8"))
        except (ValueError, RecursionError) as e:
            raise self.error("its JSON chunk is damaged") from e
        if not isinstance(found, dict):
            raise self.error("its JSON chunk is not an object")
        at = 20 + size
        if at + 8 > length:
            return found, memoryview(b"")
        size, kind = struct.unpack_from("<II", data, at)
        if kind != BINARY_CHUNK or size > length - at - 8:
            raise self.error("its binary chunk does not fit the file")
        return found, memoryview(data)[at + 8 : at + 8 + size]

    def list(self, parent: dict, key: str) -> list:
        """The list parent[key], empty if it is not there."""
        found = parent.get(key, [])
        if not isinstance(found, list):
            raise self.error(f"{key} is not a list")
        return found

    def item(self, kind: str, index) -> dict:
        """Entry `index` of the file's list `kind` ("nodes", "meshes" ...)."""
        items = self.list(self.json, kind)
        if isinstance(index, bool) or not isinstance(index, int) or not 0 <= index < len(items):
            raise self.error(f"names one of its {kind} that is not there: {str(index)[:20]} of {len(items)}")
        if not isinstance(items[index], dict):
            raise self.error(f"entry {index} of {kind} is not an object")
        return items[index]

    def integer(self, parent: dict, key: str, largest: int, default: int | None = None) -> int:
        """The whole number parent[key], 0 to `largest`."""
        value = parent.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= largest:
            raise self.error(f"{key} is {str(value)[:20]}, not a whole number of 0 to {largest}")
        return value

    def numbers(self, parent: dict, key: str, default: tuple) -> np.ndarray:
        """The list of finite numbers parent[key], as many as `default` has, float64."""
        value = parent.get(key, default)
        try:
            found = np.asarray(value, np.float64)
        except (TypeError, ValueError, OverflowError) as e:
            raise self.error(f"{key} is not a list of numbers") from e
        if found.shape != (len(default),) or not np.isfinite(found).all():
            raise self.error(f"{key} is not a list of {len(default)} finite numbers")
        return found

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
        kind, width = (
            of.get("componentType"),
            TYPE_WIDTHS.get(of.get("type")) if isinstance(of.get("type"), str) else None,
        )
        if of.get("type") not in kinds or width is None:
            raise self.error(f"accessor {index} is of type {str(of.get('type'))[:20]}, expected {' or '.join(kinds)}")
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
        scale = 1.0
        if of.get("normalized") is True and kind != 5126:
            scale = 1.0 / np.iinfo(values.dtype).max
        with np.errstate(invalid="ignore"):  # a signalling NaN
            values = values.astype(np.float64)
        if not np.isfinite(values).all():
            raise self.error(f"accessor {index} holds a number that is not finite")
        return np.maximum(values * scale, -1.0) if scale != 1.0 else values  # -128 of a byte stands for -1 too

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
