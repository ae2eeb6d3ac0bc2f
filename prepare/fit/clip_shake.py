"""Shake of a camera in a hand, taken out of a clip: each picture as it would be seen from where the first was taken.

A camera that turns, and hardly leaves its place, sees a homography of what it saw before. It is found by corners behind
the thing, which are tracked from the first picture to each, so that no error grows over time.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from core.errors import BadInput
from prepare.fit.clip_masks import Clip

CORNERS, APART = 500, 8.0  # behind the thing, and the least distance [px] of two of them
CORNER = 0.01  # of the clearest corner's strength
WINDOW = (21, 21)  # [px] of Lucas and Kanade; corners keep half of it from the mask
BACK_AND_FORTH = 0.5  # [px] by which a corner, tracked to another picture and back, may be off
OFF = 1.0  # [px] from where a homography leads: such a corner is of something that moves
FEWEST = 24  # corners that agree on a homography, which are half of those tracked or more
STILL = 0.15  # [px]; several times the error of a homography
FARTHEST = 0.1  # of the longest side: a place that is left so far does not stay the same one


def steadied(clip: Clip, masks: np.ndarray, progress=lambda done: None) -> tuple[Clip, np.ndarray, str]:
    """The clip and the masks (F, H, W) of the thing without shake, and a line that says what was done.

    Both are returned as they are where the camera stands still, or where nothing behind the thing shows whether it
    does. Raises BadInput where the camera moves too far.
    """
    moves = camera_moves(clip, masks, progress)
    if moves is None:
        return clip, masks, "shake: not measured, what is behind the thing is too plain"
    most = max(shift_of(move, clip.size) for move in moves)
    if most < STILL:
        return clip, masks, f"shake: none (less than {STILL} px)"
    flags, edge = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP, cv2.BORDER_REPLICATE
    pictures, cut = clip.pictures.copy(), masks.copy()
    for k in range(1, len(moves)):
        pictures[k] = cv2.warpPerspective(pictures[k], moves[k], clip.size, flags=flags, borderMode=edge)
        soft = cv2.warpPerspective(masks[k].astype(np.float32), moves[k], clip.size, flags=cv2.WARP_INVERSE_MAP)
        cut[k] = soft > 0.5
    return replace(clip, pictures=pictures), cut, f"shake: up to {most:.1f} px, taken out"


def shift_of(move: np.ndarray, size: tuple[int, int]) -> float:
    """Root mean square way [px] that a homography (3, 3) moves the middle half of a picture of a size."""
    places = np.array([[x, y] for x in (0.25, 0.5, 0.75) for y in (0.25, 0.5, 0.75)]) * size
    return float(np.sqrt(((moved(places, move) - places) ** 2).sum(1).mean()))


def moved(places: np.ndarray, move: np.ndarray) -> np.ndarray:
    """Places (N, 2) after a homography (3, 3)."""
    return cv2.perspectiveTransform(places[:, None].astype(np.float64), move)[:, 0]


def camera_moves(clip: Clip, masks: np.ndarray, progress=lambda done: None) -> np.ndarray | None:
    """Homographies (F, 3, 3) of pixels from the first picture to each, by what is outside of the masks (F, H, W).

    None where the first picture has too few corners there. Raises BadInput where the camera moves too far.
    """
    grey = [cv2.cvtColor(p, cv2.COLOR_RGB2GRAY) for p in clip.pictures]
    behind = [cv2.erode((~m).astype(np.uint8), np.ones(WINDOW, np.uint8)) for m in masks]
    corners = cv2.goodFeaturesToTrack(grey[0], CORNERS, CORNER, APART, mask=behind[0], blockSize=7)
    if corners is None or len(corners) < FEWEST:
        return None
    first, moves = corners[:, 0], [np.eye(3)]
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 1e-3)
    how = {"winSize": WINDOW, "maxLevel": 2, "criteria": stop, "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}
    for k in range(1, len(grey)):
        likely = moved(first, moves[-1]).astype(np.float32)
        there, good, _ = cv2.calcOpticalFlowPyrLK(grey[0], grey[k], first, likely, **how)
        back = cv2.calcOpticalFlowPyrLK(grey[k], grey[0], there, first + there - likely, **how)[0]
        good = (good[:, 0] > 0) & (np.linalg.norm(back - first, axis=1) < BACK_AND_FORTH)
        there_row, there_column = np.clip(there[:, ::-1].round().astype(int), 0, np.array(grey[0].shape) - 1).T
        good &= behind[k][there_row, there_column] > 0
        move, agree = None, np.zeros(0)
        if good.sum() >= FEWEST:
            move, agree = cv2.findHomography(first[good], there[good], cv2.RANSAC, OFF)
        if move is None or agree.sum() < max(FEWEST, good.sum() / 2):
            said = "what is behind the thing is not found again"
        elif shift_of(move, clip.size) > FARTHEST * max(clip.size):
            said = f"the camera has moved by {shift_of(move, clip.size):.0f} px"
        else:
            moves.append(move)
            progress((k + 1) / len(grey))
            continue
        raise BadInput(f"{clip.where}: frame_{clip.first + k:04d}: {said}; hold it still, or leave it out (--part)")
    return np.stack(moves)
