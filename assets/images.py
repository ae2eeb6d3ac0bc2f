"""A small picture of an asset within its file: a PNG, whose structure is checked before anyone decodes it."""

from __future__ import annotations

import struct
import zlib

import numpy as np

from core.errors import BadInput

THUMBNAIL_SIDE = 192  # [px] of those that are made
SIDE_MAX = 1024  # [px] of those that are taken
BYTES_MAX = 1 << 20
SIGNATURE = b"\x89PNG\r\n\x1a\n"
CHANNELS = {0: 1, 2: 3, 4: 2, 6: 4}  # of grey, RGB and these with alpha; palettes are not taken


def check_thumbnail(png: np.ndarray, where: str) -> None:
    """Raise BadInput, naming `where`, unless the bytes (K,) uint8 are a whole small PNG that unpacks to its size.

    Chunks are length, name, data, CRC (PNG specification, Sec. 5.3); a PNG of 8 bits a channel without interlacing
    unpacks to height (1 + width channels) bytes (Sec. 7.2).
    """
    if png.dtype != np.uint8 or png.ndim != 1 or len(png) > BYTES_MAX:
        raise BadInput(f"{where}: the thumbnail is not a row of at most {BYTES_MAX} bytes")
    data = png.tobytes()
    chunks = list(_chunks(data, where))
    names = [name for name, _ in chunks]
    if names[:1] != [b"IHDR"] or names[-1:] != [b"IEND"] or b"IDAT" not in names or len(chunks[0][1]) != 13:
        raise BadInput(f"{where}: the thumbnail is no whole PNG")
    width, height, depth, colour, *_, interlaced = struct.unpack(">IIBBBBB", chunks[0][1])
    if not (0 < width <= SIDE_MAX and 0 < height <= SIDE_MAX):
        raise BadInput(f"{where}: the thumbnail is {width}x{height}; at most {SIDE_MAX} a side are taken")
    if depth != 8 or colour not in CHANNELS or interlaced:
        raise BadInput(f"{where}: the thumbnail is no plain PNG of 8 bits a channel")
    size = height * (1 + width * CHANNELS[colour])
    packed = b"".join(body for name, body in chunks if name == b"IDAT")
    try:
        unpacked = zlib.decompressobj().decompress(packed, size + 1)
    except zlib.error as e:
        raise BadInput(f"{where}: the thumbnail's pixels are damaged") from e
    if len(unpacked) != size:
        raise BadInput(f"{where}: the thumbnail's pixels are not {size} bytes")


def _chunks(data: bytes, where: str):
    """Name and data of each chunk."""
    if not data.startswith(SIGNATURE):
        raise BadInput(f"{where}: the thumbnail is no PNG")
    at = len(SIGNATURE)
    while at < len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        end = at + 12 + length
        if end > len(data) or zlib.crc32(data[at + 4 : end - 4]) != int.from_bytes(data[end - 4 : end], "big"):
            raise BadInput(f"{where}: the thumbnail is damaged")
        yield data[at + 4 : at + 8], data[at + 8 : end - 4]
        at = end


def thumbnail_of(picture: np.ndarray) -> np.ndarray:
    """PNG bytes (K,) uint8 of the middle square of a picture (H, W, 3) uint8 RGB, SIDE pixels wide."""
    import cv2

    height, width = picture.shape[:2]
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    square = cv2.resize(picture[top : top + side, left : left + side], (THUMBNAIL_SIDE, THUMBNAIL_SIDE), interpolation=cv2.INTER_AREA)
    return cv2.imencode(".png", square[..., ::-1].copy(), [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].reshape(-1)
