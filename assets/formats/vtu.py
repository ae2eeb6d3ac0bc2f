"""Simulated meshes for other programs: tets with fields as VTK's .vtu (ParaView, meshio), surfaces as Wavefront .obj.

Binary data stands inline: base64 of a 64-bit byte count and little-endian numbers.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from assets.file_access import atomic_write

TETRAHEDRON = 10  # VTK's number of the cell type
TYPES = {"f8": "Float64", "f4": "Float32", "i8": "Int64", "i4": "Int32", "u1": "UInt8"}


def write_vtu(
    path: str | Path,
    points: np.ndarray,
    tets: np.ndarray,
    *,
    point_fields: dict[str, np.ndarray],
    cell_fields: dict[str, np.ndarray],
) -> None:
    """Write points (V, 3), tets (T, 4) of positive volume, and named fields (V, ...) and (T, ...). Raises BadInput."""
    count = len(tets)
    cells = {
        "connectivity": np.asarray(tets, np.int64).reshape(-1),
        "offsets": 4 * np.arange(1, count + 1),
        "types": np.full(count, TETRAHEDRON, np.uint8),
    }
    parts = [
        '<?xml version="1.0"?>',
        '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64">',
        f'<UnstructuredGrid><Piece NumberOfPoints="{len(points)}" NumberOfCells="{count}">',
        "<Points>", data_array("Points", np.asarray(points, np.float64)), "</Points>",
        "<Cells>", *(data_array(name, values) for name, values in cells.items()), "</Cells>",
        "<PointData>", *(data_array(name, values) for name, values in point_fields.items()), "</PointData>",
        "<CellData>", *(data_array(name, values) for name, values in cell_fields.items()), "</CellData>",
        "</Piece></UnstructuredGrid></VTKFile>\n",
    ]  # fmt: skip
    with atomic_write(path) as beside:
        beside.write_text("\n".join(parts), encoding="ascii")


def data_array(name: str, values: np.ndarray) -> str:
    """The element of an array (N,) or (N, K)."""
    values = np.ascontiguousarray(values)
    little = values.astype(values.dtype.newbyteorder("<"))
    size = np.array([little.nbytes], "<u8").tobytes()
    text = base64.b64encode(size + little.tobytes()).decode("ascii")
    columns = "" if values.ndim == 1 else f' NumberOfComponents="{values.shape[1]}"'
    kind = TYPES[f"{values.dtype.kind}{values.dtype.itemsize}"]
    return f'<DataArray type="{kind}" Name="{name}"{columns} format="binary">{text}</DataArray>'


def write_surfaces(path: str | Path, surfaces: Sequence[tuple[str, np.ndarray, np.ndarray]]) -> None:
    """Write named surfaces: vertices (V, 3) [m], of which only used ones are kept, and outward triangles (S, 3).

    Raises BadInput.
    """
    lines, first = ["# VR-GS: metres, +y up"], 1
    for name, vertices, triangles in surfaces:
        used, corners = np.unique(triangles, return_inverse=True)
        lines.append("o " + (re.sub(r"\s+", "_", name) or "body"))
        lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in np.asarray(vertices, np.float64)[used].tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in (corners.reshape(-1, 3) + first).tolist()]
        first += len(used)
    with atomic_write(path) as beside:
        beside.write_text("\n".join(lines) + "\n", encoding="utf-8")
