"""Splats as SOG (PlayCanvas): a meta.json and WebP images, zipped as .sog or side by side in a folder.

Pixel i of each image, row by row, belongs to Gaussian i. Positions are 16 bits, high and low bytes in
two images, between least and greatest values of sign(x) ln(1 + |x|). A quaternion is its three lesser
components; alpha - 252 says which of w, x, y, z is left out. Log-scales, colours and SH are bytes: in
version 2 indices into a codebook, in version 1 (no `version`) fractions of a range. SH beyond degree 0 is
a palette, 64 entries a row, and 16 bits a Gaussian that choose one. Opacity is a byte, in version 1 of
the logit's range. Source: the SOG specification at developer.playcanvas.com; for version 1
playcanvas/splat-transform, read-sog-v1.ts. Axes and units are those of the .ply.
"""

from __future__ import annotations

import json
import math
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

import numpy as np

from assets.file_access import file_size, open_input, unpack_bound
from assets.formats.packing import join_largest, logits_from_bytes
from assets.gaussians import SH_COUNTS, Gaussians, Report, drawable_gaussians
from assets.images import decode_image, read_image_header
from core.errors import BadInput
from core.typed import Range, Shape, from_json, from_plain

META_MAX = 1 << 20  # [bytes] of a meta.json; codebooks of 256 numbers take some kilobytes
COUNT_MAX = 1 << 28  # 16,384 x 16,384, the largest WebP image
NUMBER_MAX = 1e30  # of the numbers in a meta.json
NAME_MAX = 255  # [characters] of a file's name, on most file systems
LARGEST_MIN = 252  # alpha of a quaternion whose w is left out
PALETTE_WIDTH = 64  # palette entries in a row
ZIP_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
ZIP_ENCRYPTED = 1  # flag of an entry
# Exceptions of zipfile on damaged archives; RuntimeError includes NotImplementedError.
ZIP_ERRORS = (zipfile.BadZipFile, zlib.error, struct.error, EOFError, ValueError, RuntimeError, OverflowError)


def read_entry(path: Path, archive: zipfile.ZipFile, name: str, size_max: int) -> bytes:
    """The content of an entry of a ZIP archive, of at most `size_max` bytes, checked before unpacking.

    Raises BadInput, which names `path`.
    """
    try:
        entry = archive.getinfo(name)
    except KeyError as e:
        raise BadInput(f"{path}: holds no {name[:60]!r}") from e
    if entry.compress_type not in ZIP_METHODS or entry.flag_bits & ZIP_ENCRYPTED:
        raise BadInput(f"{path}: {name[:60]!r} is encrypted or of a method of compression that is not read")
    if entry.file_size > size_max:
        raise BadInput(f"{path}: {name[:60]!r} claims {entry.file_size} bytes, more than {size_max}")
    try:
        with archive.open(entry) as content:
            data = content.read(entry.file_size)
            if len(data) < entry.file_size or content.read(1):
                raise BadInput(f"{path}: {name[:60]!r} is not of the size that the archive claims")
    except ZIP_ERRORS as e:
        raise BadInput(f"{path}: {name[:60]!r} is damaged") from e
    return data


class Images:
    """The images that a meta.json names, decoded on demand.

    load       the bytes of a file beside the meta.json
    bytes_max  that the pixels of an image may take; checked before decoding
    """

    def __init__(self, path: Path, meta: dict, load: Callable[[str], bytes], bytes_max: int) -> None:
        self.path, self.meta, self._load, self._bytes_max = path, meta, load, bytes_max

    def section(self, name: str) -> dict:
        """An object of the meta.json."""
        return from_plain(dict[str, Any], self.meta.get(name), f"{self.path}: meta.json: {name}")

    def numbers(self, name: str, key: str, count: int) -> np.ndarray:
        """Finite numbers of the meta.json, float64, as many as `count`."""
        values = self.section(name).get(key)
        return self._finite(values if isinstance(values, list) else [values], f"{key} of {name}", count)

    def _finite(self, values: list, what: str, count: int) -> np.ndarray:
        kind = Annotated[np.ndarray, Shape(count), Range(-NUMBER_MAX, NUMBER_MAX)]
        return from_plain(kind, values, f"{self.path}: meta.json: {what}")

    def codebook(self, name: str) -> np.ndarray:
        """Value of each byte, (256,); NaN beyond the end of a shorter codebook."""
        values = self.section(name).get("codebook")
        if not isinstance(values, list) or not 1 <= len(values) <= 256:
            raise BadInput(f"{self.path}: the codebook of {name} in meta.json is not 1 to 256 numbers")
        book = np.full(256, np.nan)
        lost = values[0] is None and len(values) == 256  # a fault of early writers
        known = values[1:] if lost else values
        book[lost : len(values)] = self._finite(known, f"the codebook of {name}", len(known))
        if lost:  # as the PlayCanvas engine does: one mean step below the second entry
            book[0] = book[1] + (book[1] - book[255]) / 255
        return book

    def pixels(self, name: str, index: int = 0) -> np.ndarray:
        """An image, (H, W, 4) uint8 RGBA."""
        files = self.section(name).get("files")
        if not isinstance(files, list) or len(files) <= index or not isinstance(files[index], str):
            raise BadInput(f"{self.path}: meta.json names no image {index + 1} of {name}")
        file = files[index]
        strange = set(file) & set("/\\:") or not file.isprintable() or len(file) > NAME_MAX
        if file in ("", ".", "..") or strange:
            raise BadInput(f"{self.path}: meta.json names {file[:60]!r}, which is not the name of a file beside it")
        data, where = self._load(file), f"{self.path}: {file}"
        header = read_image_header(data)
        if header is None or header.format != "webp":
            raise BadInput(f"{where}: not a WebP image")
        _, width, height = header
        if width == 0 or height == 0 or 4 * width * height > self._bytes_max:
            raise BadInput(f"{where}: claims {width} x {height} pixels, more than a file of this size may hold")
        pixels = decode_image(data, alpha=True)
        if pixels is None or pixels.shape[:2] != (height, width):
            raise BadInput(f"{where}: the WebP image is damaged")
        return pixels

    def rows(self, name: str, count: int, index: int = 0) -> np.ndarray:
        """The first `count` pixels of an image, (count, 4) uint8."""
        flat = self.pixels(name, index).reshape(-1, 4)
        if len(flat) < count:
            raise BadInput(f"{self.path}: {name} holds {len(flat)} of {count} Gaussians")
        return flat[:count]


def read_sog(path: str | Path, report: Report = print) -> Gaussians:
    """Gaussians of a .sog, or of the meta.json of a folder; non-finite ones are dropped and reported.

    Raises BadInput.
    """
    path = Path(path)
    if path.suffix.lower() == ".json":
        with open_input(path) as file:
            meta = _meta(path, file.read(META_MAX + 1))
            beside = sum(f.stat().st_size for f in path.parent.iterdir() if f.is_file())

        def load(name: str) -> bytes:
            with open_input(path.with_name(name)) as file:
                return file.read()

        return _decode(Images(path, meta, load, unpack_bound(beside)), report)
    with open_input(path) as file:
        try:
            archive = zipfile.ZipFile(file)
        except ZIP_ERRORS as e:
            raise BadInput(f"{path}: not a ZIP archive, or a truncated one") from e
        names = [n for n in archive.namelist() if PurePosixPath(n).name == "meta.json"]
        if not names:
            raise BadInput(f"{path}: holds no meta.json")
        first, bytes_max = min(names, key=len), unpack_bound(file_size(path))
        meta = _meta(path, read_entry(path, archive, first, META_MAX))
        folder = first[: -len("meta.json")]
        images = Images(path, meta, lambda name: read_entry(path, archive, folder + name, bytes_max), bytes_max)
        return _decode(images, report)


def _meta(path: Path, text: bytes) -> dict:
    if len(text) > META_MAX:
        raise BadInput(f"{path}: its meta.json is larger than {META_MAX} bytes")
    meta = from_json(dict[str, Any], text, f"{path}: its meta.json")
    if "means" not in meta:
        raise BadInput(f"{path}: its meta.json describes no splat")
    return meta


def _decode(images: Images, report: Report) -> Gaussians:
    path, meta = images.path, images.meta
    version = meta.get("version", 1)
    if version not in (1, 2):
        raise BadInput(f"{path}: version {json.dumps(version)[:20]} of SOG, read are 1 and 2")
    shape = images.section("means").get("shape")
    count = meta.get("count") if version == 2 else shape[0] if isinstance(shape, list) and shape else None
    if not isinstance(count, int) or not 0 <= count <= COUNT_MAX:
        raise BadInput(f"{path}: meta.json gives no count of Gaussians")
    if count == 0:
        raise BadInput(f"{path}: holds no Gaussians")
    antialias = meta.get("model") == "antialiased" or meta.get("antialias") is True
    low_byte, high_byte = (images.rows("means", count, index)[:, :3] for index in (0, 1))
    stored = _between(images, "means", low_byte + high_byte.astype(np.uint16) * 256, code_max=65535)
    with np.errstate(over="ignore"):  # non-finite Gaussians are dropped later
        means = (np.sign(stored) * np.expm1(np.abs(stored))).astype(np.float32)
    if images.section("quats").get("encoding", "quaternion_packed") != "quaternion_packed":
        raise BadInput(f"{path}: the encoding of its quaternions is not known")
    rgba = images.rows("quats", count)
    largest = rgba[:, 3].astype(np.int64) - LARGEST_MIN
    quats = join_largest(largest.clip(0), (rgba[:, :3] / 255.0 * 2 - 1) * math.sqrt(0.5))
    quats[largest < 0] = 0.0  # no rotation: alpha names no component
    scales, color = images.rows("scales", count), images.rows("sh0", count)
    if version == 2:
        log_scales = images.codebook("scales")[scales[:, :3]]
        dc, logits = images.codebook("sh0")[color[:, :3]], logits_from_bytes(color[:, 3])
    else:
        log_scales = _between(images, "scales", scales[:, :3])
        dc = _between(images, "sh0", color)
        dc, logits = dc[:, :3], dc[:, 3].astype(np.float32)
    sh = dc[:, None, :].astype(np.float32)
    if meta.get("shN") is not None:
        sh = np.concatenate([sh, _palette(images, count, version)], axis=1)
    return drawable_gaussians(
        path, means, quats, log_scales.astype(np.float32), logits, sh, report, antialias=antialias
    )


def _between(images: Images, name: str, codes: np.ndarray, code_max: int = 255) -> np.ndarray:
    """Codes (N, K) mapped linearly to the K ranges that the meta.json gives."""
    low, high = (images.numbers(name, key, codes.shape[1]) for key in ("mins", "maxs"))
    return low + (high - low) * (codes / float(code_max))


def _palette(images: Images, count: int, version: int) -> np.ndarray:
    """SH coefficients beyond degree 0, (N, K - 1, 3)."""
    centroids = images.pixels("shN", 0)
    entry = centroids.shape[1] // PALETTE_WIDTH  # pixels, one a coefficient
    bands = images.section("shN").get("bands") if version == 2 else None
    if entry + 1 not in SH_COUNTS[1:] or centroids.shape[1] % PALETTE_WIDTH:
        raise BadInput(f"{images.path}: its SH palette is {centroids.shape[1]} pixels wide, which fits no degree")
    if bands is not None and bands != SH_COUNTS.index(entry + 1):
        raise BadInput(
            f"{images.path}: its SH palette does not have the {json.dumps(bands)[:20]} bands that meta.json names"
        )
    palette = centroids[..., :3].reshape(-1, entry, 3)
    size = images.section("shN").get("count", len(palette)) if version == 2 else len(palette)
    labels = images.rows("shN", count, 1).astype(np.int64)
    labels = labels[:, 0] + 256 * labels[:, 1]
    if not isinstance(size, int) or size > len(palette) or labels.max() >= size:
        raise BadInput(f"{images.path}: a Gaussian names an entry beyond its SH palette")
    if version == 2:
        values = images.codebook("shN")
    else:
        low, high = (images.numbers("shN", key, 1)[0] for key in ("mins", "maxs"))
        values = low + (high - low) * np.arange(256) / 255
    return values.astype(np.float32)[palette][labels]
