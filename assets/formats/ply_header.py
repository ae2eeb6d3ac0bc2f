"""The header of .ply files, and elements with binary rows."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np

from core.errors import BadInput

TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
}
FORMATS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
LINE_MAX = 4096  # [bytes] of a header line
LINES_MAX = 4096  # of a header; splats have about 70
REST_COUNTS = (0, 9, 24, 45)  # f_rest properties of SH degree 0, 1, 2, 3


@dataclass
class Element:
    """An element of the header, with names and NumPy types ("list" for lists) of its properties."""

    name: str
    count: int
    names: list[str] = field(default_factory=list)
    types: list[str] = field(default_factory=list)

    def row(self, order: str) -> np.dtype:
        """The binary layout of one row."""
        return np.dtype({"names": self.names, "formats": [order + t for t in self.types]})


def read_header(path: Path, file, comments: list[str] | None = None) -> tuple[str, list[Element]]:
    """Byte order ("" for text) and elements; leaves the file at the first byte after the header.

    Out: `comments` gets the text of each comment.
    """
    if file.readline(LINE_MAX).rstrip() != b"ply":
        raise BadInput(f"{path}: not a .ply file")
    order, elements = None, []
    for raw in islice(iter(lambda: file.readline(LINE_MAX), b""), LINES_MAX):
        words = raw.decode("latin-1").split()
        match words:
            case ["end_header"]:
                if order is None:
                    raise BadInput(f"{path}: the header names no format")
                for element in elements:
                    if len(set(element.names)) < len(element.names):
                        raise BadInput(f"{path}: a property of {element.name} appears twice")
                return order, elements
            case ["comment", *_] if comments is not None:
                comments.append(raw.decode("utf-8", "replace").strip().removeprefix("comment").strip())
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


def binary_rows(path: Path, file, start: int, elements: list[Element], wanted: Element, order: str) -> np.ndarray:
    """Rows of one element, with named fields, (count,). `start`: where the header ends [bytes]. Raises BadInput."""
    size = file.seek(0, 2)
    for element in elements[: elements.index(wanted)]:
        if "list" in element.types:
            raise BadInput(f"{path}: list properties in {element.name} before {wanted.name} are not read")
        start += element.count * element.row(order).itemsize
    row = wanted.row(order)
    if start + wanted.count * row.itemsize > size:
        have = max(0, size - start) // row.itemsize
        what = "Gaussians" if wanted.name == "vertex" else f"rows of {wanted.name}"
        raise BadInput(f"{path}: truncated; the header claims {wanted.count} {what}, the file holds {have}")
    file.seek(start)
    return np.fromfile(file, row, wanted.count)
