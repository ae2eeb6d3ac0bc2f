"""Images in files from untrusted sources: sizes from their headers, decoding, and the thumbnails of assets."""

from __future__ import annotations

import contextlib
import os
import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from core.errors import BadInput

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
WEBP_HEADER_SIZE = 32  # [bytes] that tell the size of any kind of WebP image
THUMBNAIL_SIDE = 192  # [px] of those that are made
THUMBNAIL_SIDE_MAX = 1024  # [px] of those that are accepted
THUMBNAIL_BYTES_MAX = 1 << 20
PNG_CHANNELS = {0: 1, 2: 3, 4: 2, 6: 4}  # grey, RGB, and these with alpha; palettes are not accepted


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
    """Pixels as OpenCV decodes them in this mode, and nothing said of damage; None if there is too much of it."""
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


def thumbnail_of(picture: np.ndarray) -> np.ndarray:
    """PNG bytes (K,) uint8 of the middle square of a picture (H, W, 3) uint8 RGB, THUMBNAIL_SIDE pixels wide."""
    import cv2

    height, width = picture.shape[:2]
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    square = picture[top : top + side, left : left + side]
    square = cv2.resize(square, (THUMBNAIL_SIDE, THUMBNAIL_SIDE), interpolation=cv2.INTER_AREA)
    return cv2.imencode(".png", square[..., ::-1].copy(), [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].reshape(-1)


def check_thumbnail(png: np.ndarray, where: str) -> None:
    """Raise BadInput, naming `where`, unless the bytes (K,) uint8 are a whole small PNG that unpacks to its size.

    Chunks are length, name, data, CRC (PNG specification, Sec. 5.3); a PNG of 8 bits a channel without interlacing
    unpacks to height (1 + width channels) bytes (Sec. 7.2).
    """
    if png.dtype != np.uint8 or png.ndim != 1 or len(png) > THUMBNAIL_BYTES_MAX:
        raise BadInput(f"{where}: the thumbnail is not a row of at most {THUMBNAIL_BYTES_MAX} bytes")
    chunks = list(_png_chunks(png.tobytes(), where))
    names = [name for name, _ in chunks]
    if names[:1] != [b"IHDR"] or names[-1:] != [b"IEND"] or b"IDAT" not in names or len(chunks[0][1]) != 13:
        raise BadInput(f"{where}: the thumbnail is no whole PNG")
    width, height, depth, color, *_, interlaced = struct.unpack(">IIBBBBB", chunks[0][1])
    if not (0 < width <= THUMBNAIL_SIDE_MAX and 0 < height <= THUMBNAIL_SIDE_MAX):
        raise BadInput(f"{where}: the thumbnail is {width}x{height}; at most {THUMBNAIL_SIDE_MAX} a side are taken")
    if depth != 8 or color not in PNG_CHANNELS or interlaced:
        raise BadInput(f"{where}: the thumbnail is no plain PNG of 8 bits a channel")
    size = height * (1 + width * PNG_CHANNELS[color])
    packed = b"".join(body for name, body in chunks if name == b"IDAT")
    try:
        unpacked = zlib.decompressobj().decompress(packed, size + 1)
    except zlib.error as e:
        raise BadInput(f"{where}: the thumbnail's pixels are damaged") from e
    if len(unpacked) != size:
        raise BadInput(f"{where}: the thumbnail's pixels are not {size} bytes")


def _png_lengths_fit(data: bytes) -> bool:
    """Check that no chunk claims to be longer than the file."""
    at = len(PNG_SIGNATURE)
    while at + 12 <= len(data) and data[at + 4 : at + 8] != b"IEND":
        at += 12 + int.from_bytes(data[at : at + 4], "big")
    return at <= len(data)


def _png_chunks(data: bytes, where: str) -> Iterator[tuple[bytes, bytes]]:
    """Name and data of each chunk."""
    if not data.startswith(PNG_SIGNATURE):
        raise BadInput(f"{where}: the thumbnail is no PNG")
    at = len(PNG_SIGNATURE)
    while at < len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        end = at + 12 + length
        if end > len(data) or zlib.crc32(data[at + 4 : end - 4]) != int.from_bytes(data[end - 4 : end], "big"):
            raise BadInput(f"{where}: the thumbnail is damaged")
        yield data[at + 4 : at + 8], data[at + 8 : end - 4]
        at = end
