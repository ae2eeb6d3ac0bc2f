"""Refinement of object borders along the colours of a picture: by GrabCut, or by the user's own network."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

MARGIN = 0.3  # object sizes around an object from which the background's colours are learned
SURE = 0.2  # a pixel is disputed if its second label is at least this probable
ROUNDS = 3  # iterations of GrabCut
PIXELS_MIN = 6  # a smaller object is not refined

# (picture (H, W, 3) uint8, likely (H, W) 0..1, sure inside (H, W) bool, sure outside (H, W) bool) -> inside (H, W) bool
Cut = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def grab_cut(picture: np.ndarray, likely: np.ndarray, inside: np.ndarray, outside: np.ndarray) -> np.ndarray:
    """The object (H, W) bool by GrabCut (Rother et al. 2004): sure pixels stay, the others go where colours suit."""
    import cv2

    mask = np.where(likely > 0.5, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    mask[inside], mask[outside] = cv2.GC_FGD, cv2.GC_BGD
    there = [(mask == a) | (mask == b) for a, b in ((cv2.GC_FGD, cv2.GC_PR_FGD), (cv2.GC_BGD, cv2.GC_PR_BGD))]
    if min(t.sum() for t in there) < PIXELS_MIN:
        return there[0]
    cv2.setRNGSeed(0)
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.grabCut(np.ascontiguousarray(picture[..., ::-1]), mask, None, *models, ROUNDS, cv2.GC_INIT_WITH_MASK)
    return (mask == cv2.GC_FGD) | (mask == cv2.GC_PR_FGD)


def border_band(labels: np.ndarray, width: int) -> np.ndarray:
    """Mask (H, W) bool of the pixels within `width` of a border between labels (H, W) uint8."""
    import cv2

    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * width + 1,) * 2)
    return cv2.dilate(labels, kernel) != cv2.erode(labels, kernel)


def cut_objects(picture: np.ndarray, likely: np.ndarray, unsure: np.ndarray, reach: int, cut: Cut) -> np.ndarray:
    """Ids (H, W) uint8 of objects in a picture.

    likely  probability (H, W, K + 1) of the background and each object
    unsure  (H, W) bool, pixels in which the colours decide
    reach   [px] around an object to which its pixels are limited, but for those in which it is disputed
    """
    import cv2

    first = likely.argmax(axis=2)
    found = np.zeros(likely.shape, np.float32)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1,) * 2)
    for k in range(1, likely.shape[2]):
        own = (first == k).astype(np.uint8)
        if own.sum() < PIXELS_MIN:
            continue
        x, y, w, h = cv2.boundingRect(own)
        pad = 2 * reach + int(MARGIN * max(w, h))
        at = np.s_[max(y - pad, 0) : y + h + pad, max(x - pad, 0) : x + w + pad]
        near = unsure[at] & ((cv2.dilate(own[at], kernel) > 0) | (likely[at][..., k] > SURE))
        own = own[at] > 0
        core = own & ~near
        if not core.any():
            core = likely[at][..., k] > 0.9 * likely[at][..., k].max()
        inside = _with_core(cut(picture[at], likely[at][..., k], core, ~own & ~near), own)
        found[at][..., k] = np.where(inside, 0.5 + likely[at][..., k], 0.0)
    return np.where(found.max(axis=2) > 0, found.argmax(axis=2), 0).astype(np.uint8)


def _with_core(inside: np.ndarray, core: np.ndarray) -> np.ndarray:
    """The parts of a mask that touch a core, with small holes filled."""
    import cv2

    count, part = cv2.connectedComponents(inside.astype(np.uint8), connectivity=8)
    size = np.bincount(part.ravel(), minlength=count)
    touched = np.bincount(part[core & inside], minlength=count)
    keep = touched > 0.3 * size
    keep[0] = False
    result = keep[part]
    count, hole, stats, _ = cv2.connectedComponentsWithStats((~result).astype(np.uint8), connectivity=4)
    small = stats[:, cv2.CC_STAT_AREA] < max(PIXELS_MIN, 0.002 * result.sum())
    small[0] = False
    return result | small[hole]
