"""Marks as a user would draw them: a short stroke along the middle of an object, in two views that show it well."""

from __future__ import annotations

import cv2
import numpy as np

from prepare.segment.marks import Marks, ViewMarks
from prepare.segment.mask_files import Masks

STROKE_LENGTH = 0.6  # of what a straight line through the object's middle could have


def stroke_within(mask: np.ndarray) -> np.ndarray:
    """A straight stroke (2, 2) [px] inside of a mask (H, W) bool, through its thickest place, along its longest way."""
    distance = cv2.distanceTransform(np.pad(mask.astype(np.uint8), 1), cv2.DIST_L2, 5)[1:-1, 1:-1]
    y, x = np.unravel_index(distance.argmax(), distance.shape)
    thick, best = distance.max(), (0.0, None)
    for angle in np.linspace(0, np.pi, 16, endpoint=False):
        way = np.array([np.cos(angle), np.sin(angle)])
        ends = []
        for sign in (-1, 1):
            step = 0
            while True:
                u, v = np.round((x, y) + sign * (step + 1) * way).astype(int)
                inside = 0 <= u < mask.shape[1] and 0 <= v < mask.shape[0]
                if not inside or distance[v, u] < 0.4 * thick:
                    break
                step += 1
            ends.append(sign * STROKE_LENGTH * step * way)
        if np.linalg.norm(ends[1] - ends[0]) > best[0]:
            best = (np.linalg.norm(ends[1] - ends[0]), ends)
    ends = [np.zeros(2)] if best[1] is None else best[1]
    return np.array(ends) + (x + 0.5, y + 0.5)


def two_strokes(masks: Masks, names: list[str], apart: float = 0.35) -> Marks:
    """A stroke in each of two views, that part of the views apart, which show the object well."""
    marks = Marks()
    for k, name in enumerate(masks.names):
        area = np.array([0 if i is None else (i == k + 1).sum() for i in masks.ids], float)
        first = int(area.argmax())
        far = np.abs(np.arange(len(area)) - first) >= apart * len(area)
        second = int(np.where(far, area, -1).argmax())
        marks.objects[name] = {
            names[v]: ViewMarks([stroke_within(masks.ids[v] == k + 1)]) for v in (first, second) if area[v] > 0
        }
    return marks
