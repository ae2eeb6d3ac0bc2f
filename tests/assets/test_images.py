"""Sizes of images from their headers, and decoding of what may be damaged."""

import struct

import cv2
import numpy as np
import pytest

from assets.images import decode_image, read_image_header
from tests.support.samples import riff

EXTENDED = bytes([0x10, 0, 0, 0]) + (10).to_bytes(3, "little") + (6).to_bytes(3, "little") + bytes(8)


def encoded(suffix: str, *options: int) -> bytes:
    """An image of 11 x 7 pixels."""
    return cv2.imencode(suffix, np.zeros((7, 11, 3), np.uint8), options)[1].tobytes()


@pytest.mark.parametrize(
    ("kind", "data"),
    [
        ("png", encoded(".png")),
        ("jpeg", encoded(".jpg")),
        ("webp", encoded(".webp", cv2.IMWRITE_WEBP_QUALITY, 101)),  # lossless
        ("webp", encoded(".webp", cv2.IMWRITE_WEBP_QUALITY, 80)),
        ("webp", riff(b"VP8X", EXTENDED)),
    ],
)
def test_a_header_tells_the_size(kind, data):
    assert read_image_header(data) == (kind, 11, 7)
    assert read_image_header(data[:12]) is None


def test_what_is_no_image_has_no_header():
    rows = [b"", b"RIFF", bytes(64), riff(b"ANIM", bytes(30)), b"\xff\xd8" + bytes(30)]
    assert [read_image_header(data) for data in rows] == [None] * len(rows)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".webp"])
def test_damaged_pixels_are_told_from_sound_ones(suffix, capfd):
    data = encoded(suffix)
    assert decode_image(data).shape == (7, 11, 3) and decode_image(data, alpha=True).shape == (7, 11, 4)
    assert decode_image(data[: len(data) // 3]) is None and decode_image(b"") is None
    assert decode_image(struct.pack("<I", 7) * 9) is None
    assert capfd.readouterr() == ("", "")


def test_a_chunk_that_claims_gigabytes_is_damage():
    """OpenCV would allocate them."""
    data = encoded(".png")
    at = data.index(b"IDAT") - 4
    assert decode_image(data[:at] + b"\xff\xff\xff\x00" + data[at + 4 :]) is None
    assert decode_image(data + bytes(7)) is not None
