"""Marker of the selected body: corners of light around it, in the window and in a headset.

They are shown briefly after the user has selected or changed a body, and while an edit is likely: a panel is under the
hand. Bodies in a hand are not marked. Films and headless pictures have no markers.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from core.camera import Camera, project, view_depth
from core.vocabulary import BodyState

MARKED_SECONDS = 2.5  # [s] that a body is marked after a command
CORNER_GAP = 0.008  # [m] between a body and its corners
STROKE_FRACTION, MAX_STROKE = 0.3, 0.045  # of the longest side; [m]: length of a corner's strokes
COLOUR = (1.0, 0.96, 0.86)
FAR_OPACITY = 0.35  # of strokes behind the body
SIGNS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))  # of the eight corners


def corners(body: BodyState) -> tuple[np.ndarray, float]:
    """Corners of the box around a body (8, 3) [m], in the order of SIGNS, and the length of their strokes [m]."""
    low, high = np.asarray(body.low) - CORNER_GAP, np.asarray(body.high) + CORNER_GAP
    length = min(STROKE_FRACTION * float((high - low).max()), MAX_STROKE)
    return 0.5 * (low + high) + 0.5 * SIGNS * (high - low), length


def strokes(body: BodyState) -> np.ndarray:
    """All strokes as segments (24, 2, 3) [m], none longer than half its side; three for each corner."""
    at, length = corners(body)
    sides = 0.5 * (at[-1] - at[0])
    ends = at[:, None] - SIGNS[:, :, None] * np.diag(np.minimum(length, sides))[None]
    return np.stack([np.repeat(at, 3, axis=0), ends.reshape(-1, 3)], axis=1)


def marker_lines(body: BodyState, camera: Camera) -> list[tuple[tuple[float, float], tuple[float, float], float]]:
    """Start and end [px of the picture] and opacity of the strokes before a camera; those behind are fainter."""
    thickness = abs(camera.world_to_camera[2, :3] @ np.subtract(body.high, body.low))
    middle = view_depth(camera, 0.5 * (body.low + body.high))
    lines = []
    for start, end in strokes(body):
        a, b = project(camera, start), project(camera, end)
        if a is not None and b is not None:
            lines.append((a, b, FAR_OPACITY if view_depth(camera, start) > middle + 0.1 * thickness else 1.0))
    return lines


def scaled(body: BodyState, factor: float) -> BodyState:
    """A body as large as it will be, about its centre."""
    low, high = (body.centroid + factor * (np.asarray(corner) - body.centroid) for corner in (body.low, body.high))
    return replace(body, low=low, high=high)


def marked(world, *, near: bool) -> BodyState | None:
    """The body to be marked now, or None; `near`: the user is at a panel of edits."""
    index, bodies = world.selected, world.bodies()
    if index is None or not index < len(bodies) or bodies[index].held or not (near or world.recently_selected):
        return None
    body = bodies[index]
    return body if np.isfinite([body.low, body.high]).all() else None
