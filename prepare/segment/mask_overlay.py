"""Contact sheets of photographs with their masks drawn over them, for visual inspection."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from prepare.segment.mask_files import Masks
from prepare.train.capture import View
from prepare.train.photographs import read_image

TILE = 320  # [px] width of a photograph on the sheet
COLUMNS = 5
TINT = 0.45  # opacity of a mask's colour over the photograph


def overlay(pixels: np.ndarray, ids: np.ndarray | None, colors: np.ndarray) -> np.ndarray:
    """A photograph (H, W, 3) uint8 with its objects tinted and outlined in their colours (K, 3), the rest darker."""
    if ids is None or not ids.any():
        return pixels
    import cv2

    paint = np.concatenate([np.zeros((1, 3), np.uint8), colors])
    out = np.where((ids > 0)[..., None], (1 - TINT) * pixels + TINT * paint[ids], 0.75 * pixels).astype(np.uint8)
    width = max(1, round(max(ids.shape) / 400))
    for k in range(1, len(paint)):
        own = (ids == k).astype(np.uint8)
        lines, _ = cv2.findContours(own, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(out, lines, -1, tuple(map(int, paint[k])), width)
    return out


def overlays(views: Sequence[View], masks: Masks) -> dict[str, np.ndarray]:
    """The overlay of each view, TILE pixels wide, by the photograph's name. Raises BadInput."""
    import cv2

    tiles = {}
    for view, ids in zip(views, masks.ids, strict=True):
        picture = overlay(read_image(view.image)[0], ids, masks.colors)
        size = (TILE, max(1, round(TILE * picture.shape[0] / picture.shape[1])))
        tiles[view.name] = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return tiles


def contact_sheet(tiles: Sequence[np.ndarray]) -> np.ndarray:
    """Pictures (h, TILE, 3) side by side in rows of COLUMNS, (H, W, 3) uint8."""
    height = max(t.shape[0] for t in tiles)
    tiles = [np.pad(t, ((0, height - t.shape[0]), (0, 0), (0, 0))) for t in tiles]
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % COLUMNS)
    return np.vstack([np.hstack(tiles[k : k + COLUMNS]) for k in range(0, len(tiles), COLUMNS)])
