"""Shake of a camera in a hand is taken out of a clip; one that stands still is left alone, one that goes is refused."""

from functools import cache

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.errors import BadInput
from prepare.fit.clip_masks import Clip, clip_masks
from prepare.fit.clip_shake import camera_moves, moved, shift_of, steadied
from prepare.fit.clip_tracks import tracked
from tests.support.filmed_block import (
    PIXELS,
    TIMES,
    TRUE,
    camera_of,
    filmed,
    let_go,
    marks_of,
    pixel_map,
    speckled_block,
)

GRID = np.stack(np.meshgrid(np.linspace(0, PIXELS[0], 5), np.linspace(0, PIXELS[1], 5)), -1).reshape(-1, 2)


def turns_of(pixels: float) -> np.ndarray:
    """Turns (F, 3, 3) of a hand that sways, by as many pixels to each side, and about the axis by the same angle."""
    t = TIMES[:, None]
    angles = np.sin(2 * np.pi * t * [3.1, 2.3, 1.7] + [0, 1, 2]) * pixels / camera_of().fx
    return Rotation.from_rotvec(angles - angles[0]).as_matrix()


def steps_off(moves: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Distance (F,) [px] over the picture of homographies (F, 3, 3) from the true ones, root mean squares."""
    return np.array(
        [np.sqrt(((moved(GRID, a) - moved(GRID, b)) ** 2).mean()) for a, b in zip(moves, true, strict=True)]
    )


@pytest.fixture(scope="module")
def take(ti_cpu):
    """Makes the clip of a block by a shake [px], and its masks in the first picture's place."""
    block = speckled_block(TRUE)
    moving = let_go(block, TIMES)

    @cache
    def made(pixels: float) -> tuple[Clip, np.ndarray]:
        clip = Clip(filmed(block, moving, camera_of(), turns=turns_of(pixels)), TIMES, 0, "clip")
        return clip, clip_masks(clip, {0: marks_of(camera_of(), moving).objects["block"]["frame_0000"]})

    return made


@pytest.mark.parametrize("pixels", [0.4, 4.0])
def test_a_hand_s_shake_is_taken_out(take, pixels):
    """Points of the thing are where a camera that stands still shows them."""
    (still, where), (shaken, masks) = take(0.0), take(pixels)
    true = pixel_map(camera_of(), turns_of(pixels))
    assert 2 * pixels < max(np.linalg.norm(moved(GRID, m) - GRID, axis=1).max() for m in true)
    assert steps_off(camera_moves(shaken, masks), true).max() < 0.25
    clip, cut, line = steadied(shaken, masks)
    assert (cut & where).sum() > 0.97 * (cut | where).sum() and line.endswith("px, taken out")
    one, other, raw = (tracked(*c) for c in ((still, where), (clip, cut), (shaken, masks)))
    off, before = (np.sqrt(np.nanmean((t - one) ** 2)) for t in (other, raw))
    assert off < 0.1 and before > 3 * off
    assert np.isfinite(other).mean() > np.isfinite(one).mean() - 0.05


def test_a_clip_that_stands_still_stays_as_it_is(take):
    still, masks = take(0.0)
    assert max(shift_of(m, PIXELS) for m in camera_moves(still, masks)) > 0.01  # what the noise makes
    clip, cut, line = steadied(still, masks)
    assert clip is still and cut is masks and line.startswith("shake: none")


def wall(seed: int = 0, size=(240, 180)) -> np.ndarray:
    grey = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=size[::-1]).astype(np.float32), (0, 0), 2.0)
    return np.repeat((128 + 300 * grey).clip(0, 255).astype(np.uint8)[..., None], 3, 2)


def clip_of(pictures) -> tuple[Clip, np.ndarray]:
    pictures = np.stack(pictures)
    return Clip(pictures, TIMES[: len(pictures)], 5, "clip"), np.zeros(pictures.shape[:3], bool)


def slid(picture: np.ndarray, x: float) -> np.ndarray:
    return cv2.warpAffine(picture, np.array([[1.0, 0, x - 40], [0, 1, -30]]), PIXELS)


def test_what_passes_behind_does_not_count():
    """A third of the picture goes another way than the rest."""
    pictures = [slid(wall(), 0.7 * k) for k in range(12)]
    for k, picture in enumerate(pictures):
        picture[:, :50] = slid(wall(1), -4.0 * k)[:, :50]
    moves = camera_moves(*clip_of(pictures))
    true = np.tile(np.eye(3), (12, 1, 1))
    true[:, 0, 2] = 0.7 * np.arange(12)
    assert steps_off(moves, true).max() < 0.4


def test_a_faint_pattern_counts_beside_something_clear():
    faint = (120 + 0.07 * (wall().astype(float) - 128)).astype(np.uint8)
    faint[60:64, 60:80] = 255
    moves = camera_moves(*clip_of([slid(faint, 0.7 * k) for k in range(6)]))
    np.testing.assert_allclose(moves[:, 0, 2], 0.7 * np.arange(6), atol=0.3)


def test_a_camera_that_goes_too_far_is_refused():
    with pytest.raises(BadInput, match=r"clip: frame_0010: the camera has turned by 18 px; hold it still, or leave it"):
        steadied(*clip_of([slid(wall(), 3.5 * k) for k in range(12)]))
    with pytest.raises(BadInput, match="clip: frame_0009: what is behind the thing is not found again"):
        steadied(*clip_of([slid(wall(k >= 4), 0.0) for k in range(12)]))


@pytest.mark.parametrize(("noise", "sticker"), [(1.0, False), (1.5, False), (1.5, True)])
def test_before_a_plain_wall_nothing_is_measured(noise, sticker):
    """Its corners are noise, also beside something clear."""
    pictures = 120 + noise * np.random.default_rng(0).normal(size=(4, 360, 480, 3))
    if sticker:
        pictures[:, 5:9, 5:30] -= 100
    plain, masks = clip_of(pictures.round().astype(np.uint8))
    clip, cut, line = steadied(plain, masks)
    assert clip is plain and cut is masks and line.startswith("shake: not measured")
