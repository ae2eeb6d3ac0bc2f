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
CORNER = 0.001  # of the clearest corner's strength: one clear thing is not enough
WINDOW = (21, 21)  # [px] of Lucas and Kanade; corners keep half of it from the mask
OFF = 0.7  # [px] from where a homography leads: such a corner is of something that moves
FEWEST = 24  # corners that agree on a homography
SHARE = 0.25  # of the corners, found again in the second picture: of noise a tenth is, by chance
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

    None where too little of that is found again in the second picture, as of a plain wall, whose corners are noise.
    Raises BadInput where the camera moves too far, or what is behind is lost later.
    """
    grey = [cv2.cvtColor(p, cv2.COLOR_RGB2GRAY) for p in clip.pictures]
    behind = [cv2.erode((~m).astype(np.uint8), np.ones(WINDOW, np.uint8)) for m in masks]
    corners = cv2.goodFeaturesToTrack(grey[0], CORNERS, CORNER, APART, mask=behind[0], blockSize=7)
    first, moves = np.zeros((0, 2), np.float32) if corners is None else corners[:, 0], [np.eye(3)]
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 1e-3)
    how = {"winSize": WINDOW, "maxLevel": 2, "criteria": stop, "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}
    for k in range(1, len(grey)):
        move, agree = None, np.zeros(len(first), bool)
        if len(first) >= FEWEST:
            likely = moved(first, moves[-1]).astype(np.float32)
            there, found, _ = cv2.calcOpticalFlowPyrLK(grey[0], grey[k], first, likely, **how)
            column, row = np.clip(there.round().astype(int), 0, np.array(clip.size) - 1).T
            good = behind[k][row, column] * found[:, 0] > 0
            if good.sum() >= FEWEST:
                move, agree[good] = homography(first[good], there[good])
        if k == 1 and agree.sum() < max(FEWEST, SHARE * len(first)):
            return None
        if agree.sum() < FEWEST:
            said = "what is behind the thing is not found again"
        elif (shift := shift_of(move, clip.size)) > FARTHEST * max(clip.size):
            said = f"the camera has turned by {shift:.0f} px"
        else:
            first = first[agree] if k == 1 else first
            moves.append(move)
            progress((k + 1) / len(grey))
            continue
        raise BadInput(f"{clip.where}: frame_{clip.first + k:04d}: {said}; hold it still, or leave it out (--part)")
    return np.stack(moves)


def homography(one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray | None, np.ndarray]:
    """The homography (3, 3) by which most places (N, 2) lead to others, and a mask (N,) of these: none, unless half."""
    move, agree = cv2.findHomography(one, other, cv2.RANSAC, OFF)
    agree = np.zeros(len(one), bool) if move is None else agree[:, 0] > 0
    return move, agree & (agree.mean() > 0.5)
