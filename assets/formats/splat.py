"""Splats as .splat (antimatter15) and .ksplat (GaussianSplats3D, mkkellogg), in the axes of the .ply.

A .splat is 32 bytes a Gaussian, without a header, of SH degree 0. A .ksplat has a header of 4,096 bytes, one of 1,024
for each section, then the sections, of SH degree 0 to 2. A Gaussian is its centre, standard deviations (not their
logs), quaternion wxyz, 8-bit colour and opacity, and SH: band by band, in each red, green, blue. Level 0 is float32
throughout. Levels 1 and 2 give centres as 16-bit offsets from the centre of a bucket, all else as float16; in level 2
SH coefficients are bytes between a least and a greatest one. A section's buckets come before its Gaussians: the sizes
of those that are not full, then all centres. Layout: mkkellogg/GaussianSplats3D, SplatBuffer.js.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from assets.file_access import atomic_write, open_input
from assets.formats.packing import bytes_from_logits, logits_from_bytes, to_bytes
from assets.gaussians import SH_COUNTS, Gaussians, Report, drawable_gaussians
from core.errors import BadInput
from core.spherical_harmonics import C0

ROW = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("color", "u1", 3), ("alpha", "u1"), ("quat", "u1", 4)])

SCALE_MIN = float(np.finfo(np.float32).tiny)  # [m] a smaller one could become 0, which readers drop


def read_splat(path: str | Path, report: Report = print) -> Gaussians:
    """Gaussians of a .splat; those that are not finite are dropped and reported. Raises BadInput."""
    path = Path(path)
    with open_input(path) as file:
        size = file.seek(0, 2)
        if size % ROW.itemsize:
            raise BadInput(f"{path}: truncated, or no .splat: {size} bytes are not a multiple of {ROW.itemsize}")
        file.seek(0)
        rows = np.fromfile(file, ROW)
    with np.errstate(divide="ignore", invalid="ignore"):  # a scale of 0 or less has no logarithm and is dropped
        log_scales = np.log(rows["scale"])
    quats = (rows["quat"].astype(np.float32) - 128) / 128  # wxyz
    sh = ((rows["color"] / 255.0 - 0.5) / C0).astype(np.float32)[:, None, :]
    return drawable_gaussians(path, rows["mean"], quats, log_scales, logits_from_bytes(rows["alpha"]), sh, report)


def write_splat(path: str | Path, g: Gaussians) -> None:
    """Write a .splat: positions and scales as float32, all else in 8 bits. Raises BadInput.

    SH beyond degree 0 and `object_id` are not stored, colours outside 0..1 are clamped.
    """
    rows = np.zeros(len(g), ROW)
    rows["mean"] = g.means
    rows["scale"] = np.maximum(np.exp(g.log_scales.astype(np.float64)), SCALE_MIN)
    rows["color"] = to_bytes((g.sh[:, 0].astype(np.float64) * C0 + 0.5) * 255)
    rows["alpha"] = bytes_from_logits(g.logit_opacities)
    rows["quat"] = to_bytes(g.quats.astype(np.float64) * 128 + 128)
    with atomic_write(path) as beside, open(beside, "wb") as file:
        file.write(rows.tobytes())


FILE_HEADER = struct.Struct("<BBxxI8xIH14xff")  # version, sections, Gaussians, compression level, SH range
FILE_HEADER_SIZE, SECTION_HEADER_SIZE = 4096, 1024  # [bytes]
SECTION_HEADER = struct.Struct("<IIIIfHxxI4xIIH")  # the fields of Section
DEGREE_MAX = 2
DEFAULT_SH_RANGE = (-1.5, 1.5)  # where the header gives none
DEFAULT_OFFSET_RANGE = 32767  # of a 16-bit offset, where the section gives none
HALF_MIN = 2.0**-24  # the least float16 above 0: standard deviations below it were rounded to 0
CENTER_SIZE = 12  # [bytes] of a bucket's centre


@dataclass(frozen=True)
class Section:
    """The header of a section."""

    count: int
    capacity: int  # Gaussians that fit
    bucket_size: int  # Gaussians of a full bucket
    buckets: int
    block: float  # side of the cube that a bucket covers [m]
    bucket_bytes: int
    offset_range: int  # 0: DEFAULT_OFFSET_RANGE
    full: int  # buckets that are full; they come first
    partial: int
    degree: int

    def row(self, level: int) -> np.dtype:
        """The layout of one Gaussian."""
        center, number, sh = (("<f4", "<f4", "<f4"), ("<u2", "<f2", "<f2"), ("<u2", "<f2", "u1"))[level]
        fields = [("mean", center, 3), ("scale", number, 3), ("quat", number, 4), ("color", "u1", 3), ("alpha", "u1")]
        return np.dtype(fields + [("sh", sh, (3 * (SH_COUNTS[self.degree] - 1),))])

    def bucket_storage(self) -> int:
        """Size of the bucket table before the Gaussians [bytes]."""
        return 4 * self.partial + self.bucket_bytes * self.buckets


def read_ksplat(path: str | Path, report: Report = print) -> Gaussians:
    """Gaussians of a .ksplat; those that are not finite are dropped and reported. Raises BadInput."""
    path = Path(path)
    with open_input(path) as file:
        data = file.read()
    level, sh_range, sections = _headers(path, data)
    at = FILE_HEADER_SIZE + SECTION_HEADER_SIZE * len(sections)
    degree = max(s.degree for s in sections)
    columns = []
    for i, section in enumerate(sections):
        start = at + section.bucket_storage()
        at = start + section.capacity * section.row(level).itemsize
        if at > len(data):
            raise BadInput(f"{path}: truncated; section {i} of {section.capacity} Gaussians ends beyond the file")
        if section.count:
            rows = np.frombuffer(data, section.row(level), section.count, start)
            means = rows["mean"] if level == 0 else _centers(path, section, rows["mean"], data, start)
            columns.append(_decode(rows, means, level, sh_range, degree))
    return drawable_gaussians(path, *(np.concatenate(c) for c in zip(*columns, strict=True)), report)


def _headers(path: Path, data: bytes) -> tuple[int, tuple[float, float], list[Section]]:
    """Compression level, least and greatest SH coefficient, sections."""
    if len(data) < FILE_HEADER_SIZE + SECTION_HEADER_SIZE:
        raise BadInput(f"{path}: truncated, or not a .ksplat file")
    major, minor, section_count, count, level, low, high = FILE_HEADER.unpack_from(data)
    if (major, minor) != (0, 1):
        raise BadInput(f"{path}: not a .ksplat file, or of version {major}.{minor}; read is 0.1")
    if level > 2:
        raise BadInput(f"{path}: compression level {level} of .ksplat, read are 0 to 2")
    if not 1 <= section_count <= (len(data) - FILE_HEADER_SIZE) // SECTION_HEADER_SIZE:
        raise BadInput(f"{path}: truncated; the header claims {section_count} sections")
    sections = []
    for i in range(section_count):
        section = Section(*SECTION_HEADER.unpack_from(data, FILE_HEADER_SIZE + SECTION_HEADER_SIZE * i))
        if section.degree > DEGREE_MAX:
            raise BadInput(f"{path}: section {i} has SH degree {section.degree}, a .ksplat has at most {DEGREE_MAX}")
        if section.count > section.capacity:
            raise BadInput(f"{path}: section {i} claims {section.count} Gaussians in the space of {section.capacity}")
        sections.append(section)
    total = sum(s.count for s in sections)
    if total != count:
        raise BadInput(f"{path}: claims {count} Gaussians, its sections {total}")
    if total == 0:
        raise BadInput(f"{path}: holds no Gaussians")
    return level, (low or DEFAULT_SH_RANGE[0], high or DEFAULT_SH_RANGE[1]), sections


def _centers(path: Path, s: Section, offsets: np.ndarray, data: bytes, start: int) -> np.ndarray:
    """Centres (N, 3) of a section whose Gaussians start at `start`: (offset - range) block / (2 range) + bucket."""
    begin = start - s.bucket_storage()
    sizes = np.frombuffer(data, "<u4", s.partial, begin).astype(np.int64)
    index = np.arange(s.count)
    in_full = min(s.full * s.bucket_size, s.count)
    bucket = np.empty(s.count, np.int64)
    bucket[:in_full] = index[:in_full] // max(s.bucket_size, 1)
    ends = in_full + np.cumsum(sizes)
    bucket[in_full:] = s.full + np.searchsorted(ends, index[in_full:], side="right")
    if bucket.max() >= s.buckets or s.bucket_bytes < CENTER_SIZE:
        raise BadInput(f"{path}: the buckets of a section do not hold its {s.count} Gaussians")
    table = np.frombuffer(data, np.uint8, s.bucket_bytes * s.buckets, begin + 4 * s.partial)
    centers = np.ascontiguousarray(table.reshape(s.buckets, s.bucket_bytes)[:, :CENTER_SIZE]).view("<f4")
    offset_range = s.offset_range or DEFAULT_OFFSET_RANGE
    step = s.block / 2 / offset_range
    with np.errstate(over="ignore", invalid="ignore"):  # non-finite Gaussians are dropped later
        means = (offsets.astype(np.float64) - offset_range) * step + centers[bucket]
        return means.astype(np.float32)


def _decode(rows: np.ndarray, means: np.ndarray, level: int, sh_range: tuple[float, float], degree: int) -> tuple:
    """Means, quaternions, log-scales, logits and SH of the given degree."""
    scales = rows["scale"].astype(np.float32)
    if level > 0:
        scales = np.where(scales == 0, np.float32(HALF_MIN), scales)
    with np.errstate(divide="ignore", invalid="ignore"):  # a scale of 0 or less has no logarithm and is dropped
        log_scales = np.log(scales)
    sh = np.zeros((len(rows), SH_COUNTS[degree], 3), np.float32)
    sh[:, 0] = (rows["color"] / 255.0 - 0.5) / C0
    rest = rows["sh"].astype(np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        if level == 2:
            rest = np.float32(sh_range[0]) + rest / np.float32(255) * np.float32(sh_range[1] - sh_range[0])
    held = SH_COUNTS.index(rest.shape[1] // 3 + 1)  # degree of the section
    for first, last in pairwise(SH_COUNTS[: held + 1]):
        band = rest[:, 3 * (first - 1) : 3 * (last - 1)].reshape(len(rows), 3, last - first)
        sh[:, first:last] = band.transpose(0, 2, 1)
    return means, rows["quat"].astype(np.float32), log_scales, logits_from_bytes(rows["alpha"]), sh
