"""Splats as SOG (PlayCanvas): a meta.json and WebP images, zipped as .sog or side by side in a folder.

Pixel i of each image, row by row, belongs to Gaussian i. Positions are 16 bits, high and low bytes in
two images, between least and greatest values of sign(x) ln(1 + |x|). A quaternion is its three lesser
components; alpha - 252 says which of w, x, y, z is left out. Log-scales, colours and SH are bytes: in
version 2 indices into a codebook, in version 1 (no `version`) fractions of a range. SH beyond degree 0 is
a palette, 64 entries a row, and 16 bits a Gaussian that choose one. Opacity is a byte, in version 1 of
the logit's range. Source: the SOG specification at developer.playcanvas.com; for version 1
playcanvas/splat-transform, read-sog-v1.ts. Axes and units are those of the .ply. Written is version 2.
"""

from __future__ import annotations

import json
import math
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

import numpy as np

from assets.file_access import atomic_write, file_size, open_input, unpack_bound
from assets.formats.packing import bytes_from_logits, join_largest, logits_from_bytes, split_largest, to_bytes
from assets.formats.ply import chunk_order
from assets.gaussians import SH_COUNTS, SORTS, Gaussians, Report, drawable_gaussians, usable_view
from assets.images import decode_image, read_image_header
from core.errors import BadInput
from core.typed import Range, Shape, from_json, from_plain

META_MAX = 1 << 20  # [bytes] of a meta.json; codebooks of 256 numbers take some kilobytes
COUNT_MAX = 1 << 28  # 16,384 x 16,384, the largest WebP image
NUMBER_MAX = 1e30  # of the numbers in a meta.json
NAME_MAX = 255  # [characters] of a file's name, on most file systems
LARGEST_MIN = 252  # alpha of a quaternion whose w is left out
PALETTE_WIDTH = 64  # palette entries in a row
PALETTE_MAX = 1 << 16
CODES = 256  # of a codebook
ROUNDS = 10  # of k-means; more gain little
SAMPLE = 1 << 16  # harmonics that the first level of the palette is made from
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
    about = meta.get("asset") if isinstance(meta.get("asset"), dict) else {}
    sort = about["sort"] if about.get("sort") in SORTS else ""
    antialias = meta.get("model") == "antialiased" or meta.get("antialias") is True
    told = {"sort": sort, "antialias": antialias, "view": usable_view(about.get("view"))}
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
    return drawable_gaussians(path, means, quats, log_scales.astype(np.float32), logits, sh, report, **told)


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


def write_sog(path: str | Path, g: Gaussians) -> None:
    """Write a zipped SOG of version 2, in `chunk_order`, as images of neighbours are small. `object_id` is not stored.

    Positions are rounded to 1/65535 of their range of logarithms, all else to 8 bits; harmonics beyond degree 0 are one
    of at most 65,536.
    """
    g = g.select(chunk_order(g.means))
    n = len(g)
    width = 4 * math.ceil(math.sqrt(n) / 4)
    logs = np.sign(g.means) * np.log1p(np.abs(g.means.astype(np.float64)))
    low, high = logs.min(0), logs.max(0)
    codes = np.round((logs - low) / np.where(high > low, high - low, 1) * 65535).astype(np.uint16)
    largest, others = split_largest(g.quats.astype(np.float64))
    quats = np.c_[to_bytes((others * math.sqrt(0.5) + 0.5) * 255), (LARGEST_MIN + largest).astype(np.uint8)]
    (scales, scale_book), (dc, dc_book) = _coded(g.log_scales), _coded(g.sh[:, 0])
    alpha = np.maximum(bytes_from_logits(g.logit_opacities), 1)  # WebP does not keep the colour of what is invisible
    about = {"sort": g.sort} if g.sort else {}
    about |= {"view": g.view} if g.view else {}
    meta = {"version": 2, "asset": {"generator": "VR-GS", **about}, "count": n}
    meta |= {"model": "antialiased"} if g.antialias else {}
    meta["means"] = {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]}
    meta["scales"] = {"codebook": scale_book, "files": ["scales.webp"]}
    meta |= {"quats": {"files": ["quats.webp"]}, "sh0": {"codebook": dc_book, "files": ["sh0.webp"]}}
    images = {"means_l": codes & 255, "means_u": codes >> 8, "quats": quats, "scales": scales, "sh0": np.c_[dc, alpha]}
    files = {f"{name}.webp": _webp(rows, width) for name, rows in images.items()}
    if g.sh_degree:
        palette, labels = _palette_of(g.sh[:, 1:].reshape(n, -1))
        entries, book = _coded(palette)
        files["shN_centroids.webp"] = _webp(entries.reshape(-1, 3), PALETTE_WIDTH * (g.sh.shape[1] - 1))
        files["shN_labels.webp"] = _webp(np.c_[labels & 255, labels >> 8, 0 * labels], width)
        about = {"count": len(palette), "bands": g.sh_degree, "codebook": book}
        meta["shN"] = {**about, "files": ["shN_centroids.webp", "shN_labels.webp"]}
    with atomic_write(path) as beside, zipfile.ZipFile(beside, "w") as archive:
        for name, data in {"meta.json": json.dumps(meta).encode(), **files}.items():
            archive.writestr(zipfile.ZipInfo(name), data)  # without the time: a file depends on its splats only


def _webp(rows: np.ndarray, width: int) -> bytes:
    """A lossless image of RGB or RGBA pixels (N, 3 or 4), the last line filled up."""
    import cv2

    filled = np.full((-(-len(rows) // width) * width, rows.shape[1]), 255, np.uint8)
    filled[: len(rows)] = rows
    pixels = filled.reshape(-1, width, rows.shape[1])[..., [2, 1, 0, 3][: rows.shape[1]]]
    return cv2.imencode(".webp", np.ascontiguousarray(pixels), [cv2.IMWRITE_WEBP_QUALITY, 101])[1].tobytes()


def _coded(values: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """Values as bytes, and the codebook: k-means in one dimension, from quantiles and even steps between the ends."""
    flat = np.sort(values, axis=None).astype(np.float64)
    book = (np.quantile(flat, np.linspace(0, 1, CODES)) + np.linspace(flat[0], flat[-1], CODES)) / 2
    sums = np.concatenate([[0.0], np.cumsum(flat)])
    for _ in range(ROUNDS):
        ends = np.concatenate([[0], np.searchsorted(flat, (book[1:] + book[:-1]) / 2), [len(flat)]])
        count = np.diff(ends)
        book = np.where(count > 0, np.diff(sums[ends]) / np.maximum(count, 1), book)
    return np.searchsorted((book[1:] + book[:-1]) / 2, values).astype(np.uint8), book.tolist()


def _palette_of(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """At most 65,536 rows (K, D) that stand for all rows (N, D), and which one does, (N,) int64.

    k-means in two levels, each of which compares with some hundred rows only. Equal rows, as those of Gaussians of
    degree 0 beside others, count as one: a cluster of 160,000 would be compared with 60,000.
    """
    from scipy.cluster.vq import kmeans2, vq

    def k_means(rows: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        with warnings.catch_warnings(action="ignore"):  # of an entry that no row is nearest to, or of equal rows
            return kmeans2(rows, count, ROUNDS, minit="points", rng=0)

    wanted = min(PALETTE_MAX, 1 << (len(rows).bit_length() - 1))
    texts = np.ascontiguousarray(rows).view(f"V{rows.itemsize * rows.shape[1]}").ravel()
    _, where, entry = np.unique(texts, return_index=True, return_inverse=True)
    rows, n = rows[where], len(where)
    if n <= wanted:
        return rows, entry
    coarse = k_means(rows[:: max(1, n // SAMPLE)], math.isqrt(wanted))[0]
    first = vq(rows, coarse)[0]
    palette, labels, used = [], np.empty(n, np.int64), 0
    for k in np.unique(first).tolist():
        mine = np.flatnonzero(first == k)
        share = max(1, len(mine) * (wanted - len(coarse)) // n)
        fine, of_fine = k_means(rows[mine], share)
        labels[mine] = used + of_fine
        palette.append(fine)
        used += share
    return np.concatenate(palette), labels[entry]
