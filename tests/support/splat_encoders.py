"""Encoders of splat files, one Gaussian after the other, written from the descriptions of the formats."""

import gzip
import io
import json
import struct
import zipfile

import cv2
import numpy as np
import zstandard

from assets.gaussians import SH_COUNTS, Gaussians
from core.spherical_harmonics import C0


def properties(g: Gaussians) -> dict[str, np.ndarray]:
    """Columns by property name, written down from the format, not through the code under test."""
    columns = {axis: g.means[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"f_dc_{c}": g.sh[:, 0, c] for c in range(3)}
    k = g.sh.shape[1] - 1
    columns |= {f"f_rest_{c * k + i}": g.sh[:, 1 + i, c] for c in range(3) for i in range(k)}
    columns |= {"opacity": g.logit_opacities}
    columns |= {f"scale_{i}": g.log_scales[:, i] for i in range(3)}
    return columns | {f"rot_{i}": g.quats[:, i] for i in range(4)}


def ply_bytes(columns, types=None, form="binary_little_endian", before="", prefix=b"", after=b"", end="\n") -> bytes:
    """A .ply whose vertex element has these columns in this order."""
    types = types or {}
    n = len(next(iter(columns.values())))
    order = ">" if "big" in form else "<"
    kinds = {"float": "f4", "double": "f8", "uchar": "u1", "short": "i2"}
    lines = ["ply", f"format {form} 1.0", "comment made by a test", *before.split("\n")[:-1], f"element vertex {n}"]
    lines += [f"property {types.get(name, 'float')} {name}" for name in columns]
    header = end.join([*lines, "end_header"]) + end
    rows = np.zeros(n, [(name, order + kinds[types.get(name, "float")]) for name in columns])
    for name, values in columns.items():
        rows[name] = values
    body = rows.tobytes() if form != "ascii" else "".join(" ".join(map(repr, r.tolist())) + "\n" for r in rows).encode()
    return header.encode() + prefix + body + after


RANGE_NAMES = [f"{end}_{prefix}{axis}" for prefix in ("", "scale_") for end in ("min", "max") for axis in "xyz"]
COLOR_NAMES = [f"{end}_{channel}" for end in ("min", "max") for channel in "rgb"]


def packed_quat(wxyz) -> int:
    """A word from a quaternion, spelled out."""
    largest = int(np.argmax(np.abs(wxyz)))
    word = largest
    for k, value in enumerate(wxyz * np.sign(wxyz[largest])):
        if k != largest:
            word = word << 10 | round((value / 2**0.5 + 0.5) * 1023)
    return word


def fraction(value, low, high, bits) -> int:
    return 0 if high <= low else round(float((value - low) / (high - low)) * (2**bits - 1))


def compressed_bytes(g: Gaussians, *, colored=True, order="<") -> bytes:
    """A compressed .ply, one Gaussian after the other, written from the description of the format."""
    ranges, words = [], []
    for first in range(0, len(g), 256):
        part = slice(first, first + 256)
        color = g.sh[part, 0].astype(np.float64) * C0 + 0.5
        p, s = g.means[part], g.log_scales[part]
        box = (color.min(0), color.max(0)) if colored else (np.zeros(3), np.ones(3))
        ranges.append([*p.min(0), *p.max(0), *s.min(0), *s.max(0), *(np.concatenate(box) if colored else [])])
        for i in range(len(p)):
            position = [fraction(p[i, k], p[:, k].min(), p[:, k].max(), (11, 10, 11)[k]) for k in range(3)]
            scale = [fraction(s[i, k], s[:, k].min(), s[:, k].max(), (11, 10, 11)[k]) for k in range(3)]
            rgb = [min(max(fraction(color[i, k], box[0][k], box[1][k], 8), 0), 255) for k in range(3)]
            alpha = round(float(g.opacities[first + i]) * 255)
            words.append([position[0] << 21 | position[1] << 11 | position[2], packed_quat(g.quats[first + i])])
            words[-1] += [scale[0] << 21 | scale[1] << 11 | scale[2], rgb[0] << 24 | rgb[1] << 16 | rgb[2] << 8 | alpha]
    rest = g.sh[:, 1:].transpose(0, 2, 1).reshape(len(g), -1)
    form = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    lines = ["ply", f"format {form} 1.0", "comment made by a test", f"element chunk {len(ranges)}"]
    lines += [f"property float {name}" for name in [*RANGE_NAMES, *(COLOR_NAMES if colored else [])]]
    lines += [f"element vertex {len(g)}"]
    lines += [f"property uint packed_{name}" for name in ("position", "rotation", "scale", "color")]
    if rest.shape[1]:
        lines += [f"element sh {len(g)}", *(f"property uchar f_rest_{i}" for i in range(rest.shape[1]))]
    body = np.array(ranges, order + "f4").tobytes() + np.array(words, order + "u4").tobytes()
    sh = np.clip(np.floor((rest.astype(np.float64) / 8 + 0.5) * 256), 0, 255).astype(np.uint8)
    return ("\n".join([*lines, "end_header"]) + "\n").encode() + body + sh.tobytes()


def splat_bytes(g) -> bytes:
    """Rows of a .splat written from its description."""
    rows = b""
    for i in range(len(g)):
        rgb = np.clip(np.round((0.5 + C0 * g.sh[i, 0]) * 255), 0, 255)
        quat = np.clip(np.round(g.quats[i] * 128 + 128), 0, 255)
        rows += struct.pack("<6f", *g.means[i], *np.exp(g.log_scales[i]))
        rows += bytes(int(v) for v in [*rgb, round(float(g.opacities[i]) * 255), *quat])
    return rows


BLOCK, BUCKET, OFFSET_RANGE = 2.0, 8, 32767  # .ksplat: few Gaussians a bucket, so that some are full


def section_bytes(g: Gaussians, level: int, sh_range=(-1.5, 1.5), capacity=0, bucket_bytes=12) -> tuple[bytes, bytes]:
    """Header and content of one section, Gaussian by Gaussian; it stores them bucket by bucket (see `stored`)."""
    full, partial = buckets(g)
    sizes = [len(members) for _, members in partial]
    content = b""
    if level:
        content += struct.pack(f"<{len(sizes)}I", *sizes)
        content += b"".join(struct.pack("<3f", *c) + bytes(bucket_bytes - 12) for c, _ in full + partial)
    for center, members in full + partial:
        for i in members:
            rgb = np.clip(np.round((0.5 + C0 * g.sh[i, 0]) * 255), 0, 255)
            color = bytes(int(v) for v in [*rgb, round(float(g.opacities[i]) * 255)])
            numbers = [*np.exp(g.log_scales[i]), *g.quats[i]]
            if level == 0:
                content += struct.pack("<10f", *g.means[i], *numbers) + color
            else:
                offset = np.round((g.means[i] - center) * (OFFSET_RANGE / (BLOCK / 2))) + OFFSET_RANGE
                content += struct.pack("<3H7e", *(int(v) for v in offset), *numbers) + color
            for first, last in ((1, 4), (4, 9))[: g.sh_degree]:
                values = g.sh[i, first:last].T.ravel()  # red, green, blue
                low, high = sh_range
                as_bytes = np.clip(np.round((values - low) / (high - low) * 255), 0, 255).astype(np.uint8).tobytes()
                as_numbers = [struct.pack(f"<{len(values)}{kind}", *values) for kind in "fe"]
                content += [*as_numbers, as_bytes][level]
    content += bytes(capacity * row_size(level, g.sh_degree))
    about = (BUCKET, len(full + partial), BLOCK, bucket_bytes, OFFSET_RANGE) if level else (0, 0, 0.0, 0, 0)
    counts = (len(full), len(partial)) if level else (0, 0)
    fields = (len(g), len(g) + capacity, *about, len(content), *counts, g.sh_degree)
    return struct.pack("<IIIIfHxxIIIIH", *fields).ljust(1024, b"\0"), content


def row_size(level: int, degree: int) -> int:
    return (44, 24, 24)[level] + 3 * (SH_COUNTS[degree] - 1) * (4, 2, 1)[level]


def buckets(g: Gaussians) -> tuple[list, list]:
    """(centre, members) of the cubes of side BLOCK that hold BUCKET Gaussians, and of those that hold fewer."""
    full, open_ones = [], {}
    for i, cell in enumerate(map(tuple, np.floor(g.means / BLOCK).astype(int))):
        members = open_ones.setdefault(cell, [])
        members.append(i)
        if len(members) == BUCKET:
            full.append(((np.array(cell) + 0.5) * BLOCK, open_ones.pop(cell)))
    return full, [((np.array(cell) + 0.5) * BLOCK, members) for cell, members in open_ones.items()]


def stored(g: Gaussians) -> Gaussians:
    """In the order of the file."""
    full, partial = buckets(g)
    return g.select(np.concatenate([members for _, members in full + partial]))


def ksplat_bytes(parts: list[Gaussians], level: int, sh_range=(-1.5, 1.5), spare=0, **options) -> bytes:
    """A whole file of one section a part, and `spare` empty section headers."""
    sections = [section_bytes(g, level, sh_range, **options) for g in parts]
    n = sum(map(len, parts))
    places = len(parts) + spare
    fields = (0, 1, places, len(parts), n, n, level, 0.0, 0.0, 0.0, *sh_range)
    head = struct.pack("<BBxxIIIIHxxfffff", *fields).ljust(4096, b"\0")
    return head + b"".join(h for h, _ in sections) + bytes(1024 * spare) + b"".join(c for _, c in sections)


def spz_bytes(version, positions, degree=0, bits=12, flags=0, count=1, rotation=b"", sh=b"", tail=b"") -> bytes:
    """One Gaussian in a gzip .spz: alpha 128, colours 128, scales 96."""
    head = struct.pack("<IIIBBBB", 0x5053474E, version, count, degree, bits, flags, 0)
    return gzip.compress(head + positions + b"\x80" + b"\x80" * 3 + b"\x60" * 3 + rotation + sh + tail)


def spz_4_bytes(version_3: bytes, *, extension=b"") -> bytes:
    """A .spz of version 4 made from one of version 3: the same streams, each through zstd."""
    raw = gzip.decompress(version_3)
    n, at, streams = int.from_bytes(raw[8:12], "little"), 16, []
    for width in (9, 1, 3, 3, 4, 3 * (SH_COUNTS[raw[12]] - 1)):
        streams += [raw[at : at + n * width]] if width else []
        at += n * width
    packed = [zstandard.compress(s) for s in streams]
    flags = 2 if extension else 0
    head = struct.pack("<IIIBBBBI12x", 0x5053474E, 4, n, raw[12], raw[13], flags, len(packed), 32 + len(extension))
    table = b"".join(struct.pack("<QQ", len(p), len(s)) for p, s in zip(packed, streams, strict=True))
    return head + extension + table + b"".join(packed)


BOOK = np.sinh(np.linspace(-3, 3, 256)) / 5  # .sog: codebooks are uneven: finer near 0


def webp(rows: np.ndarray, width: int) -> bytes:
    """Lossless WebP of RGB(A) rows (N, C), padded to whole lines of `width`."""
    height = -(-len(rows) // width)
    pixels = np.zeros((height * width, rows.shape[1]), np.uint8)
    pixels[: len(rows)] = rows
    pixels = pixels.reshape(height, width, -1)
    bgr = pixels[..., [2, 1, 0, 3][: pixels.shape[2]]]
    ok, data = cv2.imencode(".webp", np.ascontiguousarray(bgr), [cv2.IMWRITE_WEBP_QUALITY, 101])
    assert ok
    return data.tobytes()


def nearest(values, book) -> np.ndarray:
    return np.abs(np.asarray(values)[..., None] - book).argmin(-1).astype(np.uint8)


def sog_files(g: Gaussians, version: int = 2, width: int = 12, palette: int | None = None) -> dict[str, bytes]:
    """meta.json and images. The palette holds the SH of the first `palette` Gaussians (all, if None)."""
    n = len(g)
    logs = np.sign(g.means) * np.log1p(np.abs(g.means.astype(np.float64)))
    low, high = logs.min(0), logs.max(0)
    codes = np.round((logs - low) / (high - low) * 65535).astype(int)
    quats = np.zeros((n, 4), np.uint8)
    for i, q in enumerate(g.quats.astype(np.float64)):
        k = int(np.argmax(np.abs(q)))
        rest = [c * np.sign(q[k]) for j, c in enumerate(q) if j != k]
        quats[i] = [*(round((c * 2**0.5 / 2 + 0.5) * 255) for c in rest), 252 + k]
    meta: dict = {"means": {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]}}
    meta["quats"] = {"files": ["quats.webp"]}
    files = {"means_l.webp": webp(codes % 256, width), "means_u.webp": webp(codes // 256, width)}
    files["quats.webp"] = webp(quats, width)
    if version == 2:
        scales, dc = nearest(g.log_scales, BOOK - 3), nearest(g.sh[:, 0], BOOK)
        alpha = np.maximum(np.round(g.opacities * 255), 1)  # 0 would lose its colour in the test's encoder
        meta |= {"version": 2, "count": n, "scales": {"codebook": list(BOOK - 3)}, "sh0": {"codebook": list(BOOK)}}
    else:
        ranges = {}
        for name, values in (("scales", g.log_scales), ("sh0", np.c_[g.sh[:, 0], g.logit_opacities])):
            ranges[name] = {"mins": values.min(0).tolist(), "maxs": values.max(0).tolist()}
        meta |= ranges
        meta["means"]["shape"], meta["quats"]["encoding"] = [n, 3], "quaternion_packed"
        span = np.ptp(g.log_scales, axis=0)
        scales = np.round((g.log_scales - g.log_scales.min(0)) / span * 255)
        values = np.c_[g.sh[:, 0], g.logit_opacities]
        dc = np.round((values - values.min(0)) / np.ptp(values, axis=0) * 255)
        dc, alpha = dc[:, :3], np.maximum(dc[:, 3], 1)
    files["scales.webp"], files["sh0.webp"] = webp(scales, width), webp(np.c_[dc, alpha], width)
    if g.sh_degree:
        entries = palette or n
        labels = np.arange(n) % entries
        meta["shN"], book = {"files": ["shN_centroids.webp", "shN_labels.webp"]}, BOOK
        if version == 2:
            meta["shN"] |= {"count": entries, "bands": g.sh_degree, "codebook": list(BOOK)}
        else:
            meta["shN"] |= {"mins": -1.5, "maxs": 1.5}
            book = np.linspace(-1.5, 1.5, 256)
        lines = -(-entries // 64) * 64
        table = np.zeros((lines, g.sh.shape[1] - 1, 3), np.uint8)
        table[:entries] = nearest(g.sh[:entries, 1:], book)
        files["shN_centroids.webp"] = webp(table.reshape(-1, 3), 64 * table.shape[1])
        files["shN_labels.webp"] = webp(np.c_[labels % 256, labels // 256, 0 * labels], width)
    for name in ("scales", "sh0"):
        meta[name]["files"] = [f"{name}.webp"]
    return {"meta.json": json.dumps(meta).encode(), **files}


def zipped(files: dict[str, bytes], method=zipfile.ZIP_STORED, folder="") -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name, data in files.items():
            archive.writestr(folder + name, data)
    return buffer.getvalue()
