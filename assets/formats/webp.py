"""WebP images as arrays of bytes, exactly as they are stored."""

from __future__ import annotations

import struct

import numpy as np

from core.errors import BadInput

HEADER_SIZE = 32  # [bytes] that tell the size of any kind of WebP image; the least that is decoded


def webp_size(data: bytes) -> tuple[int, int] | None:
    """Width and height [px] from the header of a WebP image (RFC 9649), None if it is none."""
    if len(data) < HEADER_SIZE or data[:4] != b"RIFF" or data[8:12] != b"WEBP":
        return None
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


def read_webp(data: bytes, where: str, *, most: int) -> np.ndarray:
    """Pixels (H, W, 4) uint8, red, green, blue, alpha; alpha is 255 if the image has none.

    most  bytes that the pixels may take; asked before anything is decoded
    Raises BadInput, naming `where`.
    """
    size = webp_size(data)
    if size is None:
        raise BadInput(f"{where}: not a WebP image")
    width, height = size
    if width == 0 or height == 0 or 4 * width * height > most:
        raise BadInput(f"{where}: claims {width} x {height} pixels, more than a file of this size may hold")
    import cv2

    quiet, before = cv2.utils.logging, cv2.utils.logging.getLogLevel()
    quiet.setLogLevel(quiet.LOG_LEVEL_SILENT)  # OpenCV would print what the error below says
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as e:
        raise BadInput(f"{where}: the WebP image is damaged") from e
    finally:
        quiet.setLogLevel(before)
    if pixels is None or pixels.dtype != np.uint8 or pixels.ndim != 3 or pixels.shape[:2] != (height, width):
        raise BadInput(f"{where}: the WebP image is damaged")
    if pixels.shape[2] == 3:
        pixels = np.dstack([pixels, np.full((height, width), 255, np.uint8)])
    return pixels[..., [2, 1, 0, 3]]
