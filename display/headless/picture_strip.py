"""The picture strip of `vrgs.py tune`: a column for each stiffness, the greatest compression above the end."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from core.camera import Camera

if TYPE_CHECKING:
    from display.headless.stiffness_sweep import Drop

PANEL = 300  # [px]
GAP, MARGIN, HEAD, FOOT = 6, 18, 104, 30  # [px]
PAPER, INK, FAINT, ACCENT = (250, 249, 247), (40, 38, 36), (120, 116, 112), (200, 70, 40)


def strip(name: str, drops: list[Drop], height: float) -> np.ndarray:
    """Picture (H, W, 3) uint8 of all drops of a body from `height` [m]."""
    width = 2 * MARGIN + len(drops) * PANEL + (len(drops) - 1) * GAP
    page = np.full((HEAD + 2 * (PANEL + FOOT) + MARGIN, max(width, 2 * PANEL), 3), PAPER, np.uint8)
    write(page, f"{name}, dropped from {height:.2f} m", (MARGIN, 34), 22, weight=600)
    write(page, "dashed: the undeformed height", (MARGIN, 54), 15, ACCENT)
    rows = ("greatest compression", "at rest")
    for column, d in enumerate(drops):
        left = MARGIN + column * (PANEL + GAP)
        write(page, f"E = {pascal(d.young)}", (left, HEAD - 12), 20, weight=600)
        numbers = (f"{d.compression:.0%}", f"{d.settled:.0%} of its height")
        for k, (picture, row, number) in enumerate(zip(d.pictures, rows, numbers, strict=True)):
            top = HEAD + k * (PANEL + FOOT)
            page[top : top + PANEL, left : left + PANEL] = picture
            row = row if k == 0 or d.at_rest else "still moving"
            write(page, f"{row}: {number}", (left, top + PANEL + 20), 15, FAINT)
    return page


def mark_height(picture: np.ndarray, camera: Camera, x: np.ndarray, height: float) -> None:
    """Draw a dashed line behind which the body would reach, were it undeformed: `height` [m] over its lowest point."""
    w, reach = camera.world_to_camera, 2.0 * np.ptp(x, axis=0).max()
    middle = np.array([x[:, 0].mean(), x[:, 1].min() + height, x[:, 2].mean()])
    p = (middle + np.linspace(-reach, reach, 82)[:, None] * w[0, :3]) @ w[:3, :3].T + w[:3, 3]
    pixels = p[:, :2] / p[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    for a, b in pixels.reshape(-1, 2, 2):
        cv2.line(picture, *(tuple(np.round(16 * q).astype(int).tolist()) for q in (a, b)), ACCENT, 1, cv2.LINE_AA, 4)


def pascal(value: float) -> str:
    """A stiffness in the unit that suits it: 3e4 is "30 kPa"."""
    for unit, name in ((1e6, "MPa"), (1e3, "kPa")):
        if value >= unit:
            return f"{value / unit:.3g} {name}"
    return f"{value:.3g} Pa"


def write(page: np.ndarray, text: str, place: tuple[int, int], size: int, colour=INK, weight: int = 400) -> None:
    cv2.putText(page, text, place, colour, cv2.FontFace("sans"), size, weight)
