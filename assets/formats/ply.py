"""Splats as .ply, INRIA's plain one and PlayCanvas's compressed one, told apart by their content.

Plain: one vertex a Gaussian (3D Gaussian Splatting, Kerbl et al. 2023),
`x y z [nx ny nz] f_dc_0..2 [f_rest_0..] opacity scale_0..2 rot_0..3`, in any order; `f_rest` is
channel-major, `opacity` a logit, `scale` a natural log, `rot` wxyz and not normalised. Of a splat with
objects there is an integer property `object_id` too, and a line `comment object 1 bear` for each name; a line
`comment sort radial` says which order of blending they were trained for, `comment SplatRenderMode: mip` (of Brush; of
Postshot: `comment antialiased 1`) that it was for anti-aliased drawing, `comment view` where a photographer stood and
what was looked at, six numbers.

Compressed: 16 bytes a Gaussian, and ranges shared by 256 of them. The element `chunk` holds the least and greatest
position, log-scale and (since 2024) colour of 256 Gaussians; `vertex` four 32-bit words that lie between these; `sh`,
if present, a byte a coefficient. Words, from the highest bit: position and log-scale 11, 10, 11 bits of x, y, z; colour
8 bits each of red, green, blue and opacity; rotation 2 bits for which of w, x, y, z is largest and left out, then 10
for each other one. Layout and formulas: playcanvas/splat-transform, decompress-ply.ts and compressed-chunk.ts.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.lib.recfunctions import structured_to_unstructured

from assets.file_access import atomic_write, open_input
from assets.formats.packing import ALPHA_EPSILON, bytes_from_logits, join_largest, logits_from_bytes, split_largest
from assets.gaussians import OBJECTS_MAX, SORTS, Gaussians, Report, drawable_gaussians, is_object_name, usable_view
from core.errors import BadInput
from core.morton import morton_order
from core.spherical_harmonics import C0

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


def read_header(path: Path, file) -> tuple[str, list[Element], list[str]]:
    """Byte order ("" for text), elements and comments; leaves the file at the first byte after the header."""
    if file.readline(LINE_MAX).rstrip() != b"ply":
        raise BadInput(f"{path}: not a .ply file")
    order, elements, comments = None, [], []
    for raw in islice(iter(lambda: file.readline(LINE_MAX), b""), LINES_MAX):
        words = raw.decode("latin-1").split()
        match words:
            case ["end_header"]:
                if order is None:
                    raise BadInput(f"{path}: the header names no format")
                for element in elements:
                    if len(set(element.names)) < len(element.names):
                        raise BadInput(f"{path}: a property of {element.name} appears twice")
                return order, elements, comments
            case ["comment", *_]:
                comments.append(raw.decode("utf-8", "replace").strip().removeprefix("comment").strip())
            case [] | ["obj_info", *_]:
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


MEANS, DC = ["x", "y", "z"], ["f_dc_0", "f_dc_1", "f_dc_2"]
SCALES, ROTATION = ["scale_0", "scale_1", "scale_2"], ["rot_0", "rot_1", "rot_2", "rot_3"]
REQUIRED = [*MEANS, *DC, "opacity", *SCALES, *ROTATION]
LOGIT_MAX = np.float32(np.log(1 / ALPHA_EPSILON - 1))  # for infinities, which tools write for opacities 1 and 0


def read_ply(path: str | Path, report: Report = print) -> Gaussians:
    """Gaussians of a .ply, SH degree 0 to 3; those that are not finite are dropped and reported. Raises BadInput."""
    path = Path(path)
    with open_input(path) as file:
        order, elements, comments = read_header(path, file)
        about = {"sort": next((sort for sort in SORTS if f"sort {sort}" in comments), "")}
        view = usable_view(next((c.split()[1:] for c in comments if c.startswith("view ")), []))
        about |= {"antialias": _is_antialiased(comments), "view": view}
        vertex = next((e for e in elements if e.name == "vertex"), None)
        if vertex is None:
            raise BadInput(f"{path}: has no vertex element")
        if "packed_position" in vertex.names:
            return replace(read_compressed(path, file, order, elements, report), **about)
        rest = _check_vertex(path, vertex)
        rows = _vertex_rows(path, file, order, elements, vertex)

    def columns(names: list[str]) -> np.ndarray:
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows is dropped below
            return structured_to_unstructured(rows[names], np.float32)

    sh = columns(DC)[:, None, :]
    if rest:
        channels = columns([f"f_rest_{i}" for i in range(rest)]).reshape(len(rows), 3, rest // 3)
        sh = np.concatenate([sh, channels.transpose(0, 2, 1)], axis=1)
    opacity = columns(["opacity"])[:, 0]
    opacity = np.where(np.isinf(opacity), np.copysign(LOGIT_MAX, opacity), opacity)
    shape = columns(MEANS), columns(ROTATION), columns(SCALES), opacity, sh
    ids, objects = None, ()
    if "object_id" in vertex.names:
        ids, objects = _object_ids(path, rows["object_id"], report), _object_names(comments)
    return replace(drawable_gaussians(path, *shape, report, object_id=ids, objects=objects), **about)


def read_vertices(path: Path) -> np.ndarray:
    """Rows of the vertex element of any .ply, (count,) with named fields. Raises BadInput."""
    with open_input(path) as file:
        order, elements, _ = read_header(path, file)
        vertex = next((e for e in elements if e.name == "vertex"), None)
        if vertex is None or vertex.count == 0 or "list" in vertex.types:
            raise BadInput(f"{path}: holds no points")
        return _vertex_rows(path, file, order, elements, vertex)


def _vertex_rows(path: Path, file, order: str, elements: list[Element], vertex: Element) -> np.ndarray:
    """Rows of the vertex element, of a text file all float64, (count,) with named fields."""
    if order == "":
        return _text_rows(path, file, vertex, elements[: elements.index(vertex)])
    return binary_rows(path, file, file.tell(), elements, vertex, order)


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


def _is_antialiased(comments: list[str]) -> bool:
    """Trained for anti-aliased drawing, as Brush or Postshot say it; the last of the comments counts."""
    said = [c.lower().split() for c in comments]
    marks = [words[1] for words in said if len(words) == 2 and words[0] in ("splatrendermode:", "antialiased")]
    return bool(marks) and marks[-1] in ("mip", "1")


def _about(g: Gaussians) -> list[str]:
    """Lines of a header: how the Gaussians were trained, and from where they are seen."""
    view = ["comment view " + " ".join(f"{v:.7g}" for v in g.view)] if g.view else []
    return view + [f"comment sort {g.sort}"] * bool(g.sort) + ["comment SplatRenderMode: mip"] * g.antialias


def _check_vertex(path: Path, vertex: Element) -> int:
    """The number of f_rest properties. Raises BadInput unless the element has all properties of a Gaussian."""
    missing = [name for name in REQUIRED if name not in vertex.names]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise BadInput(f"{path}: missing property {missing[0]!r}{more} of a Gaussian splat")
    if "list" in vertex.types:
        raise BadInput(f"{path}: list property {vertex.names[vertex.types.index('list')]!r} in vertex")
    if vertex.count == 0:
        raise BadInput(f"{path}: holds no Gaussians")
    rest = len({name for name in vertex.names if re.fullmatch(r"f_rest_\d+", name)})
    if rest not in REST_COUNTS:
        raise BadInput(f"{path}: {rest} f_rest properties, expected 0, 9, 24 or 45 (SH degree 0 to 3)")
    for i in range(rest):
        if f"f_rest_{i}" not in vertex.names:
            raise BadInput(f"{path}: missing property 'f_rest_{i}'")
    return rest


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
    header += _about(g)
    header += [f"element vertex {n}", *(f"property float {name}" for name in names)]
    if g.object_id.any() or g.objects:
        header.append("property ushort object_id")
        whole = np.empty(n, np.dtype([("floats", "<f4", rows.shape[1:]), ("object_id", "<u2")]))
        whole["floats"], whole["object_id"] = rows, g.object_id
        rows = whole
    with atomic_write(path) as beside, open(beside, "wb") as file:
        file.write("\n".join([*header, "end_header\n"]).encode())
        file.write(rows.tobytes())


CHUNK = 256  # Gaussians that share their ranges
PACKED = ["packed_position", "packed_rotation", "packed_scale", "packed_color"]
RANGES = {
    "position": (["min_x", "min_y", "min_z"], ["max_x", "max_y", "max_z"]),
    "scale": (["min_scale_x", "min_scale_y", "min_scale_z"], ["max_scale_x", "max_scale_y", "max_scale_z"]),
    "color": (["min_r", "min_g", "min_b"], ["max_r", "max_g", "max_b"]),
}
COMPONENT_SHIFTS, COMPONENT_BITS = (21, 11, 0), (11, 10, 11)  # bits of x, y, z in a word
QUAT_SHIFTS = (20, 10, 0)  # of the three smaller components
SH_EXTENT = 8.0  # coefficients lie within -4..4


def read_compressed(path: Path, file, order: str, elements: list[Element], report: Report) -> Gaussians:
    """Gaussians of a compressed .ply whose header has just been read from `file`. Raises BadInput."""
    chunk, vertex, sh = _check_compressed(path, order, elements)
    start = file.tell()
    rows = binary_rows(path, file, start, elements, vertex, order)
    ranges = binary_rows(path, file, start, elements, chunk, order)
    n, of_vertex = len(rows), np.arange(len(rows)) // CHUNK
    words = {name: rows[name].astype(np.uint32) for name in PACKED}

    def between(name: str, fraction: np.ndarray) -> np.ndarray:
        low, high = (np.stack([ranges[c] for c in names], axis=1).astype(np.float64) for names in RANGES[name])
        return low[of_vertex] * (1 - fraction) + high[of_vertex] * fraction

    with np.errstate(over="ignore", invalid="ignore"):  # non-finite Gaussians are dropped below
        means = between("position", _fractions(words["packed_position"])).astype(np.float32)
        log_scales = between("scale", _fractions(words["packed_scale"])).astype(np.float32)
        bytes_of = words["packed_color"][:, None] >> np.array([24, 16, 8, 0], np.uint32) & 255
        color = bytes_of[:, :3] / 255.0
        if "min_r" in chunk.names:
            color = between("color", color)
        dc = ((color - 0.5) / C0).astype(np.float32)[:, None, :]
    if sh is not None:
        codes = binary_rows(path, file, start, elements, sh, order)
        codes = np.stack([codes[f"f_rest_{i}"] for i in range(len(sh.names))], axis=1).reshape(n, 3, -1)
        fraction = (np.arange(256) + 0.5) / 256  # the middle of each byte's step
        fraction[[0, -1]] = 0, 1
        of_byte = ((fraction - 0.5) * SH_EXTENT).astype(np.float32)
        dc = np.concatenate([dc, of_byte[codes].transpose(0, 2, 1)], axis=1)
    rotation = words["packed_rotation"]
    others = ((rotation[:, None] >> np.array(QUAT_SHIFTS, np.uint32) & 1023) / 1023.0 - 0.5) * np.sqrt(2)
    quats = join_largest(rotation >> 30, others)
    return drawable_gaussians(path, means, quats, log_scales, logits_from_bytes(bytes_of[:, 3]), dc, report)


def _check_compressed(path: Path, order: str, elements: list[Element]) -> tuple[Element, Element, Element | None]:
    """The elements chunk, vertex and sh (or None). Raises BadInput unless they agree."""
    what = f"{path}: a compressed .ply"
    if order == "":
        raise BadInput(f"{what} cannot be text")
    chunk, vertex, sh = (next((e for e in elements if e.name == name), None) for name in ("chunk", "vertex", "sh"))
    if chunk is None:
        raise BadInput(f"{what} needs an element chunk")
    colored = "min_r" in chunk.names
    needed = [n for name in RANGES if colored or name != "color" for names in RANGES[name] for n in names]
    for element, names, kinds in ((chunk, needed, ("f4", "f8")), (vertex, PACKED, ("u4",))):
        types = dict(zip(element.names, element.types, strict=True))
        for name in names:
            if name not in types:
                raise BadInput(f"{what} lacks the property {name!r} of {element.name}")
            if types[name] not in kinds:
                raise BadInput(f"{what} has a property {name!r} of a wrong type")
        if "list" in element.types:
            raise BadInput(f"{what} has a list property in {element.name}")
    if vertex.count == 0:
        raise BadInput(f"{path}: holds no Gaussians")
    if chunk.count != -(-vertex.count // CHUNK):
        raise BadInput(f"{what} of {vertex.count} Gaussians cannot have {chunk.count} chunks")
    if sh is not None:
        rest = [f"f_rest_{i}" for i in range(len(sh.names))]
        if len(rest) not in REST_COUNTS[1:] or set(rest) != set(sh.names) or set(sh.types) != {"u1"}:
            raise BadInput(f"{what} needs 9, 24 or 45 properties f_rest of one byte in sh")
        if sh.count != vertex.count:
            raise BadInput(f"{what} has {vertex.count} Gaussians but {sh.count} rows of sh")
    return chunk, vertex, sh


def _fractions(words: np.ndarray) -> np.ndarray:
    """Three numbers 0..1 of each word of 11, 10, 11 bits, (N, 3)."""
    limits = (1 << np.array(COMPONENT_BITS, np.uint32)) - 1
    return (words[:, None] >> np.array(COMPONENT_SHIFTS, np.uint32) & limits) / limits.astype(np.float64)


def chunk_order(means: np.ndarray) -> np.ndarray:
    """Order (N,) in which `write_compressed` stores Gaussians: neighbours share a chunk, so its range is small.

    With the most bits possible, since otherwise a few far Gaussians would put all others in one cell.
    """
    return morton_order(means.astype(np.float64), bits=21)


def write_compressed(path: str | Path, g: Gaussians) -> None:
    """Write a compressed .ply in `chunk_order`. `object_id` is not stored. Raises BadInput.

    Errors are at most half a step: of the chunk's extent / 2047 (y: 1023) in position and log-scale,
    / 255 in colour, 1/255 in opacity. SH coefficients are off by 1/64, beyond -4..4 they are clamped.
    """
    g = g.select(chunk_order(g.means))
    n, rest = len(g), 3 * (g.sh.shape[1] - 1)
    positions, position_range = _pack(g.means, COMPONENT_BITS)
    scales, scale_range = _pack(g.log_scales, COMPONENT_BITS)
    colors, color_range = _pack(g.sh[:, 0] * np.float32(C0) + np.float32(0.5), (8, 8, 8))
    opacity = bytes_from_logits(g.logit_opacities).astype(np.uint32)
    largest, others = split_largest(g.quats.astype(np.float64))
    quats = np.clip(np.round((others * np.sqrt(0.5) + 0.5) * 1023), 0, 1023).astype(np.uint32)
    words = [
        (positions << np.array(COMPONENT_SHIFTS, np.uint32)).sum(axis=1, dtype=np.uint32),
        largest.astype(np.uint32) << 30 | (quats << np.array(QUAT_SHIFTS, np.uint32)).sum(axis=1, dtype=np.uint32),
        (scales << np.array(COMPONENT_SHIFTS, np.uint32)).sum(axis=1, dtype=np.uint32),
        (colors << np.array([24, 16, 8], np.uint32)).sum(axis=1, dtype=np.uint32) | opacity,
    ]
    ranges = np.concatenate([*position_range, *scale_range, *color_range], axis=1)
    channels = g.sh[:, 1:].transpose(0, 2, 1).reshape(n, rest)
    codes = np.clip(np.floor((channels / SH_EXTENT + 0.5) * 256), 0, 255).astype(np.uint8)
    header = ["ply", "format binary_little_endian 1.0", *_about(g)]
    header += [f"element chunk {len(ranges)}"]
    header += [f"property float {name}" for both in RANGES.values() for names in both for name in names]
    header += [f"element vertex {n}", *(f"property uint {name}" for name in PACKED)]
    header += [f"element sh {n}", *(f"property uchar f_rest_{i}" for i in range(rest))] if rest else []
    with atomic_write(path) as beside, open(beside, "wb") as file:
        file.write("\n".join([*header, "end_header\n"]).encode("ascii"))
        file.write(ranges.astype("<f4").tobytes())
        file.write(np.stack(words, axis=1).astype("<u4").tobytes())
        file.write(codes.tobytes())


def _pack(values: np.ndarray, widths: tuple[int, int, int]) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Codes (N, 3) of values (N, 3) within the ranges of their chunks, and these: least and greatest (C, 3)."""
    starts = np.arange(0, len(values), CHUNK)
    low, high = (reduce.reduceat(values, starts, axis=0) for reduce in (np.minimum, np.maximum))
    of_value = np.arange(len(values)) // CHUNK
    extent = (high.astype(np.float64) - low)[of_value]
    fraction = (values - low[of_value].astype(np.float64)) / np.where(extent > 0, extent, 1)
    limits = (1 << np.array(widths)) - 1
    return np.round(fraction * limits).astype(np.uint32), (low, high)
