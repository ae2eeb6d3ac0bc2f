"""Letters as pictures, for what is printed, painted or stencilled on models."""

from __future__ import annotations

from functools import cache

import numpy as np

PIXELS = 128  # of a glyph's picture
MARGIN = 8  # pixels left free around a letter


@cache
def glyph(letter: str) -> np.ndarray:
    """Picture (H, W) of a capital letter, 1 where there is ink, as large as the picture."""
    import cv2

    font, weight = cv2.FONT_HERSHEY_DUPLEX, PIXELS // 9
    scale = (PIXELS - 2 * MARGIN - weight) / cv2.getTextSize("H", font, 1.0, 1)[0][1]
    (w, h), _ = cv2.getTextSize(letter, font, scale, weight)
    picture = np.zeros((PIXELS, PIXELS), np.uint8)
    cv2.putText(picture, letter, ((PIXELS - w) // 2, (PIXELS + h) // 2), font, scale, 255, weight, cv2.LINE_AA)
    return picture / 255.0


def sampled(picture: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Values (N,) of a picture at u to the right and v up, both -1..1; 0 outside."""
    h, w = picture.shape
    column, row = np.round((u + 1) / 2 * (w - 1)).astype(int), np.round((1 - v) / 2 * (h - 1)).astype(int)
    inside = (column >= 0) & (column < w) & (row >= 0) & (row < h)
    return np.where(inside, picture[row.clip(0, h - 1), column.clip(0, w - 1)], 0.0)
