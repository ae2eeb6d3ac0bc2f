"""Shake of a camera in a hand is taken out of a clip; one that stands still is left alone, one that goes is refused."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.errors import BadInput
from prepare.fit.clip_masks import Clip, clip_masks
from prepare.fit.clip_shake import FEWEST, camera_moves, moved, steadied
from prepare.fit.clip_tracks import tracked
from tests.support.filmed_block import FPS, FRAMES, PIXELS, TRUE, camera_of, filmed, let_go, marks_of, speckled_block

TIMES = np.arange(FRAMES) / FPS
GRID = np.stack(np.meshgrid(np.linspace(0, PIXELS[0], 5), np.linspace(0, PIXELS[1], 5)), -1).reshape(-1, 2)


def turns_of(pixels: float) -> np.ndarray:
    """Turns (F, 3, 3) of a hand that sways, by as many pixels to each side and by a third of that angle about the axis."""
    t = TIMES[:, None]
    angles = np.sin(2 * np.pi * t * [3.1, 2.3, 1.7] + [0, 1, 2]) * pixels / camera_of().fx * [1, 1, 1.0]
    return Rotation.from_rotvec(angles - angles[0]).as_matrix()


def maps_of(turns: np.ndarray) -> np.ndarray:
    """The homographies (F, 3, 3) of these turns, of pixels from the middle of the first."""
    c = camera_of()
    lens = np.array([[c.fx, 0, c.cx - 0.5], [0, c.fy, c.cy - 0.5], [0, 0, 1]])
    return lens @ turns @ np.linalg.inv(lens)


@pytest.fixture(scope="module")
def take(ti_cpu):
    """Makes the clip by a shake [px] and a seed of the noise, and its masks."""
    block = speckled_block(TRUE)
    moving = let_go(block, TIMES)

    def made(pixels: float, seed: int = 0) -> tuple[Clip, np.ndarray]:
        clip = Clip(filmed(block, moving, camera_of(), seed, turns_of(pixels)), TIMES, 0, "clip")
        return clip, clip_masks(clip, {0: marks_of(camera_of(), moving).objects["block"]["frame_0000"]})

    return made


def test_probe(take):
    still, masks = take(0.0)
    m = camera_moves(still, masks)
    if m is not None:
        off = [np.linalg.norm(moved(GRID, k) - GRID, axis=1).max() for k in m]
        print("still", max(off), np.sqrt(np.mean(np.square(off))))
    a = tracked(still, masks)
    b0 = None
    for px in (0.5, 2, 4.0):
        clip, cm = take(px)
        true = maps_of(turns_of(px))
        m = camera_moves(clip, cm)
        size = max(np.linalg.norm(moved(GRID, t) - GRID, axis=1).max() for t in true)
        off = [np.linalg.norm(moved(GRID, k) - moved(GRID, t), axis=1).max() for k, t in zip(m, true)]
        c, w, line = steadied(clip, cm)
        b = tracked(c, w)
        n = min(a.shape[1], b.shape[1])
        d = (a[:, :n] - b[:, :n]) if np.allclose(a[0, :n], b[0, :n]) else None
        print(px, size, max(off), line, d is not None and np.sqrt(np.nanmean(d**2)), (w & masks).sum() / (w | masks).sum(),
              np.isfinite(a).mean(), np.isfinite(b).mean())
