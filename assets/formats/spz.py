"""Splats as .spz (Niantic): all attributes quantised, one after the other, compressed.

Versions 1-3 are one gzip stream: a 16-byte header, then positions, alphas, colours, scales,
rotations, SH. Version 4 is a 32-byte header, a table and one zstd stream an attribute. The axes are
right-up-back, half a turn about x away from those of the .ply (right-down-front); reading and
writing turn them; an extension of Adobe may name others. The order of blending that the splats were trained
for, if it is not z, is a line in the comment of the gzip stream (RFC 1952), `sort radial`, in version 4 an extension;
so is the view of a photographer, `view 0 1 2 0 0 0 3.14`.
An extension is its type, the length of its content, and that; they lie behind the header, in versions 1-3 at the end.
"""

from __future__ import annotations

import gzip
import struct
import zlib
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from assets.file_access import atomic_write, open_input, unpack_bound
from assets.formats.packing import bytes_from_logits, join_largest, logits_from_bytes, split_largest, to_bytes
from assets.gaussians import SH_COUNTS, SORTS, Gaussians, Report, drawable_gaussians, usable_view
from core.errors import BadInput
from core.spherical_harmonics import sh_basis

SPZ_MAGIC = 0x5053474E  # "NGSP"
GZIP = b"\x1f\x8b"
GZIP_COMMENT = 16  # flag of a gzip stream
SPZ_HEADER = struct.Struct("<IIIBBBB")  # magic, version, count, SH degree, fractional bits, flags, reserved or streams
STREAM_ENTRY = struct.Struct("<QQ")  # stored and unpacked size of a version-4 stream [bytes]
HEADER_4_SIZE = 32
TABLE_OFFSET = 16  # of the field in the version-4 header that says where its table starts
ANTIALIASED, EXTENSIONS = 1, 2  # flags
SH_DEGREE_MAX = 4  # the format has one degree more than 3D Gaussian Splatting
FRACTION_BITS_MAX = 23  # of a 24-bit coordinate
FRACTION_BITS_WRITTEN = 16  # 15 micrometres, below the smallest Gaussians; fewer if the extent requires it
COLOR_SCALE = 0.15  # SH degree 0 is stored as 0.15 c + 0.5, which leaves a margin around the range of colours
ZSTD_LEVEL = 12  # of 22: 1.5 % less than 3; 19, 7 % less, takes 40 s for a million Gaussians
ZSTD_WINDOW_MAX = 1 << 27  # [bytes] of memory that a zstd frame may ask for; its own default limit
EXTENSIONS_MAX = 1 << 16  # [bytes] of all extensions of version 1 to 3
EXTENSION = struct.Struct("<II")  # type, length of the content [bytes]
COORDINATE_SYSTEM, SORT, VIEW = 0xADBE0003, 0x56520001, 0x56520002  # types of extensions: Adobe's, and ours
SYSTEMS = [
    f"{x}{y}{z}" for y, z in ("DB", "UB", "DF", "UF", "FD", "FU", "BD", "BU") for x in "LR"
]  # of x, y, z; from 1
AXES = dict(R=(1, 0, 0), L=(-1, 0, 0), D=(0, 1, 0), U=(0, -1, 0), F=(0, 0, 1), B=(0, 0, -1))  # in those of the .ply
AXIS_FLIP = np.array([1.0, -1.0, -1.0])  # right-up-back <-> right-down-front
AXIS_FLIP_QUAT = np.array([1.0, 1.0, -1.0, -1.0])  # of a quaternion wxyz


def _flip_sh(sh: np.ndarray) -> np.ndarray:
    """Coefficients in the other axes: each basis function is even or odd under the half turn."""
    generic = np.array([[0.36, 0.48, 0.8]])
    signs = np.sign(sh_basis(generic, sh.shape[1]) * sh_basis(generic * AXIS_FLIP, sh.shape[1]))
    return sh * signs[0, :, None]


@dataclass(frozen=True)
class Header:
    """The fields that both kinds of header have."""

    version: int
    count: int
    sh_degree: int
    bits: int  # fractional bits of a coordinate
    flags: int

    def widths(self) -> list[int]:
        """Bytes a Gaussian of positions, alphas, colours, scales, rotations, SH."""
        sh = 3 * ((self.sh_degree + 1) ** 2 - 1)
        return [6 if self.version == 1 else 9, 1, 3, 3, 4 if self.version >= 3 else 3, sh]


def read_spz(path: str | Path, report: Report = print) -> Gaussians:
    """Gaussians of a .spz, turned to the axes of a .ply. Raises BadInput.

    `report` takes a line for what was dropped or ignored.
    """
    path = Path(path)
    with open_input(path) as file:
        data = file.read()
    unzipped = data[:4] == SPZ_MAGIC.to_bytes(4, "little")
    if not unzipped and data[:2] != GZIP:
        raise BadInput(f"{path}: not a .spz file")
    if unzipped and int.from_bytes(data[4:8], "little") == 4:
        header, streams, more = _read_zstd(path, data)
    else:
        header, streams, more = _read_gzip(path, data, unzipped)
    extensions = _extensions(more) if header.flags & EXTENSIONS else {}
    system = int.from_bytes(extensions.pop(COORDINATE_SYSTEM, b""), "little")
    lines = [b"sort " + extensions.pop(SORT, b""), b"view " + extensions.pop(VIEW, b"")]
    ignored = ["SH degree 4"] if header.sh_degree > 3 else []
    ignored += [f"its extension {kind:#x}" for kind in extensions]
    ignored += [f"its coordinate system {system}"] if system > len(SYSTEMS) else []
    if ignored:
        report(f"{path}: ignored {', '.join(ignored)}")
    if not unzipped and data[3] == GZIP_COMMENT:
        lines = data[10:].split(b"\0", 1)[0].split(b"\n")
    sort = next((sort for sort in SORTS if f"sort {sort}".encode() in lines), "")
    view = usable_view(next((line.split()[1:] for line in lines if line.startswith(b"view ")), []))
    g = _decode(path, header, streams, report)
    if 0 < system <= len(SYSTEMS):
        g = _turned(g, SYSTEMS[system - 1])
    return replace(g, sort=sort, antialias=bool(header.flags & ANTIALIASED), view=view)


def _header(path: Path, data: bytes, stored: int) -> Header:
    """The header, whose count a file of `stored` bytes can hold: that is checked before anything is unpacked."""
    if len(data) < SPZ_HEADER.size:
        raise BadInput(f"{path}: truncated, or not a .spz file")
    magic, version, count, sh_degree, bits, flags, _ = SPZ_HEADER.unpack_from(data)
    if magic != SPZ_MAGIC:
        raise BadInput(f"{path}: not a .spz file")
    if not 1 <= version <= 4:
        raise BadInput(f"{path}: version {version} of .spz, read are 1 to 4")
    if sh_degree > SH_DEGREE_MAX or bits > FRACTION_BITS_MAX:
        raise BadInput(f"{path}: SH degree {sh_degree} with {bits} fractional bits does not exist in .spz")
    if count == 0:
        raise BadInput(f"{path}: holds no Gaussians")
    header = Header(version, count, sh_degree, bits, flags)
    if count * sum(header.widths()) > unpack_bound(stored):
        raise BadInput(f"{path}: claims {count} Gaussians, more than a file of {stored} bytes may hold")
    return header


def _extensions(data: bytes) -> dict[int, bytes]:
    """Content of the extensions by their type."""
    found, at = {}, 0
    while at + EXTENSION.size <= len(data):
        kind, size = EXTENSION.unpack_from(data, at)
        at += EXTENSION.size + size
        found[kind] = data[at - size : at]
    return found


def _turned(g: Gaussians, system: str) -> Gaussians:
    """The Gaussians that were read as RUB but are of another system, which may be mirrored."""
    turn = np.array([AXES[letter] for letter in system]).T @ np.diag(AXIS_FLIP)
    side = round(np.linalg.det(turn))
    g = g.transformed(side * turn) if (turn != side * np.eye(3)).any() else g
    if side < 0:  # a rotation, and all axes reversed: of the harmonics, those of odd degree change their sign
        signs = np.repeat([1, -1, 1, -1], [1, 3, 5, 7])[: g.sh.shape[1]]
        g = replace(g, means=-g.means, sh=(g.sh * signs[:, None]).astype(np.float32))
    return g


def _read_gzip(path: Path, data: bytes, unzipped: bool) -> tuple[Header, list[bytes], bytes]:
    """Versions 1 to 3, and what follows; `unzipped` if the gzip layer was removed."""
    unpack = zlib.decompressobj(16 + zlib.MAX_WBITS)
    try:
        head = data[: SPZ_HEADER.size] if unzipped else unpack.decompress(data, SPZ_HEADER.size)
        header = _header(path, head, len(data))
        if header.version == 4:
            raise BadInput(f"{path}: version 4 of .spz inside gzip")
        size = header.count * sum(header.widths())
        body = data[SPZ_HEADER.size :] if unzipped else unpack.decompress(unpack.unconsumed_tail, size)
        tail = data[SPZ_HEADER.size + size :] if unzipped else unpack.decompress(unpack.unconsumed_tail, EXTENSIONS_MAX)
    except zlib.error as e:
        raise BadInput(f"{path}: the gzip stream is damaged ({e})") from e
    if len(body) < size or not (unzipped or tail or unpack.eof):
        raise BadInput(f"{path}: truncated; {header.count} Gaussians take {size} bytes, found {len(body)}")
    ends = np.cumsum([0, *header.widths()]) * header.count
    return header, [body[a:b] for a, b in pairwise(ends)], tail[:EXTENSIONS_MAX]


def _read_zstd(path: Path, data: bytes) -> tuple[Header, list[bytes], bytes]:
    """Version 4, and its extensions."""
    import zstandard

    if len(data) < HEADER_4_SIZE:
        raise BadInput(f"{path}: truncated")
    header = _header(path, data, len(data))
    sizes = [header.count * width for width in header.widths()]
    used = [size for size in sizes if size]  # empty streams are left out
    table = int.from_bytes(data[TABLE_OFFSET : TABLE_OFFSET + 4], "little")
    start = table + STREAM_ENTRY.size * len(used)
    if data[SPZ_HEADER.size - 1] != len(used) or table < HEADER_4_SIZE or start > len(data):
        raise BadInput(f"{path}: the table of streams is damaged")
    unpack = zstandard.ZstdDecompressor(max_window_size=ZSTD_WINDOW_MAX)
    streams = []
    for i, size in enumerate(used):
        stored, claimed = STREAM_ENTRY.unpack_from(data, table + STREAM_ENTRY.size * i)
        if claimed != size or start + stored > len(data):
            raise BadInput(f"{path}: truncated, or stream {i} is not of {header.count} Gaussians")
        try:
            with unpack.stream_reader(data[start : start + stored]) as reader:
                streams.append(reader.read(size))
        except zstandard.ZstdError as e:
            raise BadInput(f"{path}: stream {i} is damaged ({e})") from e
        if len(streams[-1]) != size:
            raise BadInput(f"{path}: stream {i} ends early")
        start += stored
    return header, [streams.pop(0) if size else b"" for size in sizes], data[HEADER_4_SIZE:table]


def _decode(path: Path, header: Header, streams: list[bytes], report: Report) -> Gaussians:
    n = header.count
    positions, alphas, colors, scales, rotations, sh = (np.frombuffer(s, np.uint8) for s in streams)
    if header.version == 1:
        means = positions.view("<f2").astype(np.float32).reshape(n, 3)
    else:
        b = positions.reshape(-1, 3).astype(np.int32)
        fixed = (b[:, 0] | b[:, 1] << 8 | b[:, 2] << 16) << 8 >> 8  # 24 bits; the shifts carry the sign
        means = fixed.reshape(n, 3) / np.float32(1 << header.bits)
    quats = _smallest_three(rotations) if header.version >= 3 else _first_three(rotations)
    dc = (colors.reshape(n, 1, 3) / np.float32(255) - 0.5) / COLOR_SCALE
    rest = (sh.reshape(n, -1, 3)[:, : SH_COUNTS[-1] - 1].astype(np.float32) - 128) / 128
    with np.errstate(invalid="ignore"):  # a signalling NaN of version 1: its Gaussian is dropped
        means = means * AXIS_FLIP
    return drawable_gaussians(
        path,
        means,
        quats * AXIS_FLIP_QUAT,
        scales.reshape(n, 3) / np.float32(16) - 10,
        logits_from_bytes(alphas),
        _flip_sh(np.concatenate([dc, rest], axis=1)),
        report,
    )


def _first_three(packed: np.ndarray) -> np.ndarray:
    """Quaternions wxyz from bytes of x, y, z; w completes them to length 1 and is not negative."""
    xyz = packed.reshape(-1, 3) / 127.5 - 1.0
    w = np.sqrt(np.maximum(0.0, 1.0 - (xyz**2).sum(axis=1, keepdims=True)))
    return np.concatenate([w, xyz], axis=1)


def _smallest_three(packed: np.ndarray) -> np.ndarray:
    """Quaternions wxyz of 32-bit words: the index of the largest of x, y, z, w, then sign and 9 bits of each other."""
    code = packed.view("<u4")
    fields = code[:, None] >> np.array([20, 10, 0], np.uint32)
    magnitude = (fields & 511) / 511 * np.sqrt(0.5)
    return np.roll(join_largest(code >> 30, np.where(fields & 512, -magnitude, magnitude)), 1, axis=1)


def write_spz(path: str | Path, g: Gaussians, version: int = 3) -> None:
    """Write `spz_bytes`. Raises BadInput."""
    data = spz_bytes(path, g, version)
    with atomic_write(path) as beside:
        beside.write_bytes(data)


def spz_bytes(path: str | Path, g: Gaussians, version: int = 3) -> bytes:
    """A file of version 3, which all programs read, or 4. Raises BadInput, naming `path`.

    Positions are rounded to 2^-16 m (more beyond 128 m), all else to 8 to 10 bits.
    Log-scales outside -10..5.94 and SH coefficients outside -1..0.99 are clamped; `object_id` is not stored.
    """
    means, n = g.means.astype(np.float64) * AXIS_FLIP, len(g)
    extent = float(np.abs(means).max(initial=1e-9))
    bits = min(FRACTION_BITS_WRITTEN, int(np.floor(np.log2((2**23 - 1) / extent))))
    if bits < 0:
        raise BadInput(f"{path}: positions up to {extent:.3g} m do not fit a .spz")
    fixed = np.round(means * (1 << bits)).astype("<i4").reshape(-1, 1).view(np.uint8)[:, :3]
    sh = _flip_sh(g.sh)
    largest, others = split_largest(np.roll(g.quats.astype(np.float64) * AXIS_FLIP_QUAT, -1, axis=1))
    magnitude = np.minimum(np.round(511 * np.abs(others) / np.sqrt(0.5)), 511).astype(np.uint32)
    fields = magnitude | np.where(others < 0, 512, 0).astype(np.uint32)
    rotations = largest.astype(np.uint32) << 30 | fields[:, 0] << 20 | fields[:, 1] << 10 | fields[:, 2]
    streams = [
        fixed,
        bytes_from_logits(g.logit_opacities),
        to_bytes((sh[:, 0] * COLOR_SCALE + 0.5) * 255),
        to_bytes((g.log_scales.astype(np.float64) + 10) * 16),
        rotations.astype("<u4"),
        to_bytes(sh[:, 1:] * 128.0 + 128),
    ]
    streams = [np.ascontiguousarray(s).tobytes() for s in streams]
    about = SPZ_MAGIC, version, n, g.sh_degree, bits
    said = {SORT: g.sort} if g.sort not in ("", "z") else {}
    said |= {VIEW: " ".join(f"{v:.7g}" for v in g.view)} if g.view else {}
    said = {kind: text.encode() for kind, text in said.items()}
    if version == 4:
        import zstandard

        sizes = [len(s) for s in streams if s]
        packed = [zstandard.compress(s, ZSTD_LEVEL) for s in streams if s]
        more = b"".join(EXTENSION.pack(kind, len(text)) + text for kind, text in said.items())
        flags = ANTIALIASED * g.antialias | EXTENSIONS * bool(said)
        head = SPZ_HEADER.pack(*about, flags, len(packed))
        head += (HEADER_4_SIZE + len(more)).to_bytes(HEADER_4_SIZE - TABLE_OFFSET, "little") + more
        table = [STREAM_ENTRY.pack(len(p), size) for p, size in zip(packed, sizes, strict=True)]
        return b"".join([head, *table, *packed])
    packed = gzip.compress(SPZ_HEADER.pack(*about, ANTIALIASED * g.antialias, 0) + b"".join(streams), 6, mtime=0)
    if said:
        lines = b"\n".join({SORT: b"sort ", VIEW: b"view "}[kind] + text for kind, text in said.items())
        packed = packed[:3] + bytes([GZIP_COMMENT]) + packed[4:10] + lines + b"\0" + packed[10:]
    return packed
