"""Splats as INRIA .ply: one vertex a Gaussian (3D Gaussian Splatting, Kerbl et al. 2023).

`x y z [nx ny nz] f_dc_0..2 [f_rest_0..] opacity scale_0..2 rot_0..3`, in any order; `f_rest` is
channel-major, `opacity` a logit, `scale` a natural log, `rot` wxyz and not normalised.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np

from assets.border import Report, reading, replacing, usable_gaussians
from assets.errors import BadInput
from assets.gaussians import Gaussians

TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
}
FORMATS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
LINE_MAX = 4096  # [bytes] of a header line
LINES_MAX = 4096  # of a header; splats have about 70
MEANS, DC = ["x", "y", "z"], ["f_dc_0", "f_dc_1", "f_dc_2"]
SCALES, ROTATION = ["scale_0", "scale_1", "scale_2"], ["rot_0", "rot_1", "rot_2", "rot_3"]
REQUIRED = [*MEANS, *DC, "opacity", *SCALES, *ROTATION]
REST_COUNTS = (0, 9, 24, 45)  # f_rest properties of SH degree 0, 1, 2, 3


@dataclass
class Element:
    """One `element` of the header; `types` of its properties are NumPy's, "list" for lists."""

    name: str
    count: int
    names: list[str] = field(default_factory=list)
    types: list[str] = field(default_factory=list)

    def row(self, order: str) -> np.dtype:
        """The binary layout of one row."""
        return np.dtype({"names": self.names, "formats": [order + t for t in self.types]})


def read_ply(path: str | Path, report: Report = print) -> Gaussians:
    """Gaussians of a .ply, SH degree 0 to 3; those that are not finite are dropped and reported. Raises BadInput."""
    path = Path(path)
    with reading(path) as file:
        order, elements = _header(path, file)
        vertex = _vertex(path, elements)
        rest = _rest_count(path, vertex)
        before = elements[: elements.index(vertex)]
        if order == "":
            rows = _text_rows(path, file, vertex, before)
        else:
            rows = _binary_rows(path, file, vertex, before, order)

    def columns(names: list[str]) -> np.ndarray:
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows is dropped below
            return np.stack([rows[name].astype(np.float32) for name in names], axis=1)

    n = len(rows)
    sh = columns(DC)[:, None, :]
    if rest:
        channels = columns([f"f_rest_{i}" for i in range(rest)]).reshape(n, 3, rest // 3)
        sh = np.concatenate([sh, channels.transpose(0, 2, 1)], axis=1)
    opacity = columns(["opacity"])[:, 0]
    return usable_gaussians(path, columns(MEANS), columns(ROTATION), columns(SCALES), opacity, sh, report)


def _header(path: Path, file) -> tuple[str, list[Element]]:
    """Byte order ("" for text) and elements; leaves the file at the first byte after the header."""
    if file.readline(LINE_MAX).rstrip() != b"ply":
        raise BadInput(f"{path}: not a .ply file")
    order, elements = None, []
    for raw in islice(iter(lambda: file.readline(LINE_MAX), b""), LINES_MAX):
        words = raw.decode("latin-1").split()
        match words:
            case ["end_header"]:
                if order is None:
                    raise BadInput(f"{path}: the header names no format")
                return order, elements
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", name, "1.0"] if name in FORMATS:
                order = FORMATS[name]
            case ["element", name, count] if count.isdecimal() and len(count) < 16:
                elements.append(Element(name, int(count)))
            case ["property", "list", _, _, name] if elements:
                elements[-1].names.append(name)
                elements[-1].types.append("list")
            case ["property", kind, name] if elements and kind in TYPES:
                elements[-1].names.append(name)
                elements[-1].types.append(TYPES[kind])
            case _:
                line = raw[:60].decode("ascii", "replace").strip()
                raise BadInput(f"{path}: cannot understand the header line {line!r}")
    raise BadInput(f"{path}: the header does not end")


def _vertex(path: Path, elements: list[Element]) -> Element:
    """The element that holds the Gaussians, with all that is required of it."""
    vertex = next((e for e in elements if e.name == "vertex"), None)
    if vertex is None:
        raise BadInput(f"{path}: has no vertex element")
    if "packed_position" in vertex.names:
        raise BadInput(f"{path}: is a PlayCanvas compressed .ply, which is not read; export it uncompressed")
    for element in elements:
        if len(set(element.names)) < len(element.names):
            raise BadInput(f"{path}: a property of {element.name} appears twice")
    missing = [name for name in REQUIRED if name not in vertex.names]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise BadInput(f"{path}: missing property {missing[0]!r}{more} of a Gaussian splat")
    if "list" in vertex.types:
        raise BadInput(f"{path}: list property {vertex.names[vertex.types.index('list')]!r} in vertex")
    if vertex.count == 0:
        raise BadInput(f"{path}: holds no Gaussians")
    return vertex


def _rest_count(path: Path, vertex: Element) -> int:
    names = {name for name in vertex.names if re.fullmatch(r"f_rest_\d+", name)}
    if len(names) not in REST_COUNTS:
        raise BadInput(f"{path}: {len(names)} f_rest properties, expected 0, 9, 24 or 45 (SH degree 0 to 3)")
    missing = [f"f_rest_{i}" for i in range(len(names)) if f"f_rest_{i}" not in names]
    if missing:
        raise BadInput(f"{path}: missing property {missing[0]!r}")
    return len(names)


def _binary_rows(path: Path, file, vertex: Element, before: list[Element], order: str) -> np.ndarray:
    start = file.tell()
    size = file.seek(0, 2)
    for element in before:
        if "list" in element.types:
            raise BadInput(f"{path}: list properties in {element.name} before vertex are not read")
        start += element.count * element.row(order).itemsize
    row = vertex.row(order)
    if start + vertex.count * row.itemsize > size:
        have = max(0, size - start) // row.itemsize
        raise BadInput(f"{path}: truncated; the header claims {vertex.count} Gaussians, the file holds {have}")
    file.seek(start)
    return np.fromfile(file, row, vertex.count)


def _text_rows(path: Path, file, vertex: Element, before: list[Element]) -> np.ndarray:
    start = file.tell()
    room = file.seek(0, 2) - start
    file.seek(start)
    skipped = sum(element.count for element in before)
    if skipped + 2 * vertex.count * len(vertex.names) > room + 1:  # a number is a digit and a blank at least
        raise BadInput(f"{path}: truncated; the header claims {vertex.count} Gaussians, too many for the file's size")
    lines = islice(file, skipped, skipped + vertex.count)
    try:
        table = np.loadtxt(lines, np.float64, comments=None, ndmin=2, encoding="latin-1")
    except ValueError as e:
        raise BadInput(f"{path}: a line of the vertex element is not {len(vertex.names)} numbers") from e
    if table.shape != (vertex.count, len(vertex.names)):
        raise BadInput(f"{path}: expected {vertex.count} lines of {len(vertex.names)} numbers, found {table.shape}")
    return table.view(np.dtype([(name, "f8") for name in vertex.names]))[:, 0]


def write_ply(path: str | Path, g: Gaussians) -> None:
    """Write Gaussians in INRIA's layout and order, normals 0. `object_id` is not stored. Raises BadInput."""
    n, rest = len(g), 3 * (g.sh.shape[1] - 1)
    names = [*MEANS, "nx", "ny", "nz", *DC, *(f"f_rest_{i}" for i in range(rest)), "opacity", *SCALES, *ROTATION]
    channels = g.sh[:, 1:].transpose(0, 2, 1).reshape(n, rest)
    normals = np.zeros((n, 3), np.float32)
    columns = [g.means, normals, g.sh[:, 0], channels, g.logit_opacities[:, None], g.log_scales, g.quats]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {n}"]
    header += [f"property float {name}" for name in names] + ["end_header\n"]
    with replacing(path) as beside, open(beside, "wb") as file:
        file.write("\n".join(header).encode("ascii"))
        file.write(np.concatenate(columns, axis=1).astype("<f4").tobytes())
