"""Images in files from untrusted sources: sizes from their headers, before memory of that size is taken; decoding."""

from __future__ import annotations

import contextlib
import os
import struct
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
WEBP_HEADER_SIZE = 32  # [bytes] that tell the size of any kind of WebP image


class ImageHeader(NamedTuple):
    """Format ("png", "jpeg" or "webp") and size [px] of an image."""

    format: str
    width: int
    height: int


def read_image_header(data: bytes) -> ImageHeader | None:
    """The header of a PNG (ISO 15948), JPEG or WebP image; None if it is none of these, or damaged."""
    if data.startswith(PNG_SIGNATURE) and len(data) >= 24:
        return ImageHeader("png", *struct.unpack_from(">II", data, 16))
    kind, size = "webp", None
    if data[:2] == b"\xff\xd8":
        kind, size = "jpeg", _jpeg_size(data)
    elif len(data) >= WEBP_HEADER_SIZE and data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        size = _webp_size(data)
    return size and ImageHeader(kind, *size)


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    """Size from the frame header of a JPEG (ITU T.81, B.2)."""
    at = 2
    while at + 9 < len(data):
        if data[at] != 0xFF:
            return None
        kind = data[at + 1]
        if kind == 0xFF or kind == 0x01 or 0xD0 <= kind <= 0xD7:  # a fill byte, or a marker without a segment
            at += 1 if kind == 0xFF else 2
        elif 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        else:
            at += 2 + struct.unpack_from(">H", data, at + 2)[0]
    return None


def _webp_size(data: bytes) -> tuple[int, int] | None:
    """Size of a WebP image (RFC 9649)."""
    kind = data[12:16]
    if kind == b"VP8L":  # 14 bits each, after a byte of signature
        bits = struct.unpack_from("<I", data, 21)[0]
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if kind == b"VP8X":  # 24 bits each
        return int.from_bytes(data[24:27], "little") + 1, int.from_bytes(data[27:30], "little") + 1
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", data, 26)
        return width & 0x3FFF, height & 0x3FFF
    return None


def decode_image(data: bytes, *, alpha: bool = False) -> np.ndarray | None:
    """Pixels (H, W, 3) uint8 RGB, or with `alpha` (H, W, 4) RGBA just as stored; None if the image is damaged.

    A JPEG's orientation tag is ignored. Check the header first: a small file may claim a huge image.
    """
    import cv2

    pixels = decoded(data, cv2.IMREAD_UNCHANGED if alpha else cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if pixels is None or pixels.dtype != np.uint8 or pixels.ndim != 3:
        return None
    if alpha and pixels.shape[2] == 3:
        pixels = np.dstack([pixels, np.full(pixels.shape[:2], 255, np.uint8)])
    return np.ascontiguousarray(pixels[..., [2, 1, 0, 3][: pixels.shape[2]]])


def decoded(data: bytes, mode: int) -> np.ndarray | None:
    """Pixels as OpenCV decodes them in this mode, without its warnings; None if the image is damaged beyond use."""
    import cv2

    if data.startswith(PNG_SIGNATURE) and not _png_lengths_fit(data):
        return None  # OpenCV allocates what a chunk claims
    log, level = cv2.utils.logging, cv2.utils.logging.getLogLevel()
    log.setLogLevel(log.LOG_LEVEL_SILENT)  # OpenCV would print what the caller reports
    try:
        with without_stderr():
            return cv2.imdecode(np.frombuffer(data, np.uint8), mode)
    except cv2.error:
        return None
    finally:
        log.setLogLevel(level)


@contextlib.contextmanager
def without_stderr() -> Iterator[None]:
    """Discard what C libraries write: libpng and libjpeg name each defect of an image."""
    with open(os.devnull, "wb") as nothing:
        kept = os.dup(2)
        os.dup2(nothing.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)


def _png_lengths_fit(data: bytes) -> bool:
    """Check that no chunk claims to be longer than the file."""
    at = len(PNG_SIGNATURE)
    while at + 12 <= len(data) and data[at + 4 : at + 8] != b"IEND":
        at += 12 + int.from_bytes(data[at : at + 4], "big")
    return at <= len(data)
