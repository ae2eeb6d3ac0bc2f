"""Strip of pictures of a splat with each plausible axis up, for the user to choose from."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from assets.asset import Asset
from assets.gaussians import Gaussians
from assets.up_axis import alternatives, robust_bounds, rotation_to_up
from prepare.report_pictures import PAPER, camera_for, splat_picture

WIDTH, HEIGHT, FOOT = 240, 220, 34  # [px] of a picture, and of the line under it
INK = (40, 38, 36)
OPAQUE = 0.3  # fainter Gaussians are not framed


def strip_name(out: Path) -> Path:
    """Path of the strip of the asset `out`: ASSET.up.png."""
    return out.with_suffix(".up.png")


def question(probabilities: dict[str, float], pictures: Path | None = None) -> str:
    """The line that shows the alternatives to the user, as options of the command line; "" if the guess is sure."""
    ups = alternatives(probabilities)
    if len(ups) < 2:
        return ""
    listed = ", ".join(f"--up {up} {probabilities[up]:.0%}" for up in ups)
    return f"which way is up is not sure: {listed}" + (f"; pictures: {pictures}" if pictures is not None else "")


def orientation_strip(gaussians: Gaussians, up: str, probabilities: dict[str, float]) -> np.ndarray:
    """Pictures (H, W, 3) uint8 of each alternative with its option, most probable first. Taichi must be running.

    up  the axis of the file that points to +y in `gaussians`
    """
    pictures = [_panel(gaussians, up, to, probabilities[to]) for to in alternatives(probabilities)]
    return np.concatenate(pictures, axis=1)


def _panel(gaussians: Gaussians, now: str, up: str, probability: float) -> np.ndarray:
    turn = rotation_to_up(up) @ rotation_to_up(now).T
    turned = gaussians.transformed(turn)
    seen = turned.means[turned.opacities > OPAQUE] if (turned.opacities > OPAQUE).any() else turned.means
    low, high = robust_bounds(seen.astype(np.float64))
    camera = camera_for(seen.clip(low, high).astype(np.float64), WIDTH, HEIGHT)
    picture = splat_picture(Asset(turned), camera)
    page = np.full((HEIGHT + FOOT, WIDTH, 3), PAPER, np.uint8)
    page[:HEIGHT] = picture
    cv2.putText(page, f"--up {up}   {probability:.0%}", (12, HEIGHT + 22), INK, cv2.FontFace("sans"), 17, 500)
    return page
