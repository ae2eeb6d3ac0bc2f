"""Splats as INRIA .ply: one vertex a Gaussian (3D Gaussian Splatting, Kerbl et al. 2023).

`x y z [nx ny nz] f_dc_0..2 [f_rest_0..] opacity scale_0..2 rot_0..3`, in any order; `f_rest` is
channel-major, `opacity` a logit, `scale` a natural log, `rot` wxyz and not normalised. Of a splat with
objects there is an integer property `object_id` too, and a line `comment object 1 bear` for each name; a line
`comment sort radial` says which order of blending they were trained for. A
.ply whose vertices are packed goes to `assets/formats/compressed_ply.py`.
"""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.lib.recfunctions import structured_to_unstructured

from assets.file_access import atomic_write, open_input
from assets.formats.compressed_ply import read_compressed
from assets.formats.ply_header import REST_COUNTS, Element, binary_rows, read_header
from assets.formats.quantization import ALPHA_EPSILON
from assets.gaussians import OBJECTS_MAX, SORTS, Gaussians, Report, drawable_gaussians, is_object_name
from core.errors import BadInput

MEANS, DC = ["x", "y", "z"], ["f_dc_0", "f_dc_1", "f_dc_2"]
SCALES, ROTATION = ["scale_0", "scale_1", "scale_2"], ["rot_0", "rot_1", "rot_2", "rot_3"]
REQUIRED = [*MEANS, *DC, "opacity", *SCALES, *ROTATION]
LOGIT_MAX = np.float32(np.log(1 / ALPHA_EPSILON - 1))  # for infinities, which tools write for opacities 1 and 0


def read_ply(path: str | Path, report: Report = print) -> Gaussians:
    """Gaussians of a .ply, SH degree 0 to 3; those that are not finite are dropped and reported. Raises BadInput."""
    path = Path(path)
    comments: list[str] = []
    with open_input(path) as file:
        order, elements = read_header(path, file, comments)
        vertex = next((e for e in elements if e.name == "vertex"), None)
        if vertex is None:
            raise BadInput(f"{path}: has no vertex element")
        if "packed_position" in vertex.names:
            return replace(read_compressed(path, file, order, elements, report), sort=_order(comments))
        _check_vertex(path, vertex)
        rest = _rest_count(path, vertex)
        if order == "":
            rows = _text_rows(path, file, vertex, elements[: elements.index(vertex)])
        else:
            rows = binary_rows(path, file, file.tell(), elements, vertex, order)

    floats = [name for name in vertex.names if name != "object_id"]
    matrix = None
    if all(rows.dtype[name] == np.float32 for name in floats):  # as in most files
        matrix = structured_to_unstructured(rows[floats])

    def columns(names: list[str]) -> np.ndarray:
        if matrix is not None:
            return matrix[:, [floats.index(name) for name in names]]
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows is dropped below
            return np.stack([rows[name].astype(np.float32) for name in names], axis=1)

    n = len(rows)
    sh = columns(DC)[:, None, :]
    if rest:
        channels = columns([f"f_rest_{i}" for i in range(rest)]).reshape(n, 3, rest // 3)
        sh = np.concatenate([sh, channels.transpose(0, 2, 1)], axis=1)
    opacity = columns(["opacity"])[:, 0]
    opacity = np.where(np.isinf(opacity), np.copysign(LOGIT_MAX, opacity), opacity)
    shape = columns(MEANS), columns(ROTATION), columns(SCALES), opacity, sh
    ids, objects = None, ()
    if "object_id" in vertex.names:
        ids, objects = _object_ids(path, rows["object_id"], report), _object_names(comments)
    sort = _order(comments)
    return drawable_gaussians(path, *shape, report, object_id=ids, objects=objects, sort=sort)


def _order(comments: list[str]) -> str:
    """The order of blending that a header's comments name, or ""."""
    return next((sort for sort in SORTS if f"sort {sort}" in comments), "")


def _object_ids(path: Path, values: np.ndarray, report: Report) -> np.ndarray:
    """Ids of any type of number as uint16; those that are none become background, and are reported."""
    with np.errstate(invalid="ignore"):
        values = values.astype(np.float64)
        sound = (values >= 0) & (values <= np.iinfo(np.uint16).max) & (values == np.rint(values))
    if not sound.all():
        report(
            f"{path}: {int((~sound).sum())} of {len(values)} object ids are no whole numbers of 0 to 65535; taken as 0"
        )
    return np.where(sound, values, 0.0).astype(np.uint16)


def _object_names(comments: list[str]) -> tuple[str, ...]:
    """Names of the objects 1, 2, ... in the comments of a header; one that is missing is called by its number."""
    names = {}
    for comment in comments:
        match = re.fullmatch(r"object (\d{1,5}) (.+)", comment)
        if match and 0 < int(match[1]) <= OBJECTS_MAX and is_object_name(match[2]):
            names[int(match[1])] = match[2]
    return tuple(names.get(k, f"object_{k}") for k in range(1, max(names, default=0) + 1))


def _check_vertex(path: Path, vertex: Element) -> None:
    """Raise BadInput unless the vertex element has all properties of a Gaussian."""
    missing = [name for name in REQUIRED if name not in vertex.names]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise BadInput(f"{path}: missing property {missing[0]!r}{more} of a Gaussian splat")
    if "list" in vertex.types:
        raise BadInput(f"{path}: list property {vertex.names[vertex.types.index('list')]!r} in vertex")
    if vertex.count == 0:
        raise BadInput(f"{path}: holds no Gaussians")


def _rest_count(path: Path, vertex: Element) -> int:
    """Number of f_rest properties. Raises BadInput unless they belong to an SH degree."""
    names = {name for name in vertex.names if re.fullmatch(r"f_rest_\d+", name)}
    if len(names) not in REST_COUNTS:
        raise BadInput(f"{path}: {len(names)} f_rest properties, expected 0, 9, 24 or 45 (SH degree 0 to 3)")
    missing = [f"f_rest_{i}" for i in range(len(names)) if f"f_rest_{i}" not in names]
    if missing:
        raise BadInput(f"{path}: missing property {missing[0]!r}")
    return len(names)


def _text_rows(path: Path, file, vertex: Element, before: list[Element]) -> np.ndarray:
    """Rows of the vertex element of a text file, (count,) float64 fields."""
    start = file.tell()
    size = file.seek(0, 2) - start
    file.seek(start)
    skipped = sum(element.count for element in before)
    if skipped + 2 * vertex.count * len(vertex.names) > size + 1:  # a number is a digit and a blank at least
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
    """Write Gaussians in INRIA's layout and order, normals 0, and `object_id` last if there are objects.

    Raises BadInput.
    """
    n, rest = len(g), 3 * (g.sh.shape[1] - 1)
    names = [*MEANS, "nx", "ny", "nz", *DC, *(f"f_rest_{i}" for i in range(rest)), "opacity", *SCALES, *ROTATION]
    channels = g.sh[:, 1:].transpose(0, 2, 1).reshape(n, rest)
    normals = np.zeros((n, 3), np.float32)
    columns = [g.means, normals, g.sh[:, 0], channels, g.logit_opacities[:, None], g.log_scales, g.quats]
    rows = np.concatenate(columns, axis=1).astype("<f4")
    header = ["ply", "format binary_little_endian 1.0"]
    header += [f"comment object {k} {name}" for k, name in enumerate(g.objects, 1)]
    header += [f"comment sort {g.sort}"] if g.sort else []
    header += [f"element vertex {n}", *(f"property float {name}" for name in names)]
    if g.object_id.any() or g.objects:
        header.append("property ushort object_id")
        whole = np.empty(n, np.dtype([("floats", "<f4", rows.shape[1:]), ("object_id", "<u2")]))
        whole["floats"], whole["object_id"] = rows, g.object_id
        rows = whole
    with atomic_write(path) as beside, open(beside, "wb") as file:
        file.write("\n".join([*header, "end_header\n"]).encode())
        file.write(rows.tobytes())
