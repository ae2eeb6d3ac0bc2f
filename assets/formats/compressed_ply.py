"""Splats as PlayCanvas compressed .ply: 16 bytes a Gaussian, and ranges shared by 256 of them.

The element `chunk` holds the least and greatest position, log-scale and (since 2024) colour of 256
Gaussians; `vertex` four 32-bit words that lie between these; `sh`, if present, a byte a coefficient.
Words, from the highest bit: position and log-scale 11, 10, 11 bits of x, y, z; colour 8 bits each of
red, green, blue and opacity; rotation 2 bits for which of w, x, y, z is largest and left out, then 10
for each other one. Layout and formulas: playcanvas/splat-transform, decompress-ply.ts and
compressed-chunk.ts. Axes and units are those of the plain .ply.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from assets.file_access import atomic_write
from assets.formats.ply_header import REST_COUNTS, Element, binary_rows
from assets.formats.quantization import bytes_from_logits, join_largest, logits_from_bytes, split_largest
from assets.gaussians import Gaussians, Report, drawable_gaussians
from core.errors import BadInput
from core.morton import morton_order
from core.spherical_harmonics import C0

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
    chunk, vertex, sh = _check_header(path, order, elements)
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
        dc = np.concatenate([dc, _sh_of_byte()[codes].transpose(0, 2, 1)], axis=1)
    quats = _unpack_quats(words["packed_rotation"])
    return drawable_gaussians(path, means, quats, log_scales, logits_from_bytes(bytes_of[:, 3]), dc, report)


def _check_header(path: Path, order: str, elements: list[Element]) -> tuple[Element, Element, Element | None]:
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


def _sh_of_byte() -> np.ndarray:
    """SH coefficient of each byte, (256,): the middle of its step, but the ends for the first and last."""
    fraction = (np.arange(256) + 0.5) / 256
    fraction[[0, -1]] = 0, 1
    return ((fraction - 0.5) * SH_EXTENT).astype(np.float32)


def _unpack_quats(words: np.ndarray) -> np.ndarray:
    """Quaternions wxyz (N, 4); the component left out is not negative."""
    values = ((words[:, None] >> np.array(QUAT_SHIFTS, np.uint32) & 1023) / 1023.0 - 0.5) * np.sqrt(2)
    return join_largest(words >> 30, values)


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
    words = [
        (positions << np.array(COMPONENT_SHIFTS, np.uint32)).sum(axis=1, dtype=np.uint32),
        _pack_quats(g.quats.astype(np.float64)),
        (scales << np.array(COMPONENT_SHIFTS, np.uint32)).sum(axis=1, dtype=np.uint32),
        (colors << np.array([24, 16, 8], np.uint32)).sum(axis=1, dtype=np.uint32) | opacity,
    ]
    ranges = np.concatenate([*position_range, *scale_range, *color_range], axis=1)
    channels = g.sh[:, 1:].transpose(0, 2, 1).reshape(n, rest)
    codes = np.clip(np.floor((channels / SH_EXTENT + 0.5) * 256), 0, 255).astype(np.uint8)
    header = ["ply", "format binary_little_endian 1.0", *([f"comment sort {g.sort}"] if g.sort else [])]
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


def _pack_quats(wxyz: np.ndarray) -> np.ndarray:
    """Words of unit quaternions (N, 4); q and -q are the same rotation."""
    largest, others = split_largest(wxyz)
    codes = np.clip(np.round((others * np.sqrt(0.5) + 0.5) * 1023), 0, 1023).astype(np.uint32)
    return largest.astype(np.uint32) << 30 | (codes << np.array(QUAT_SHIFTS, np.uint32)).sum(axis=1, dtype=np.uint32)
