"""A clip: its pictures read from a video, and where the thing is in each, from strokes in one or two of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from core.errors import BadInput
from prepare.segment.marks import ViewMarks, drawn_boxes, drawn_strokes, read_marks
from prepare.segment.mask_propagation import BAND, STROKE_WIDTH, border_band, cut_objects, grab_cut
from prepare.train.capture import Lens

LONGEST_SIDE = 640  # [px]; larger pictures are reduced: what is tracked moves by tenths of a pixel in these, too
MOST_FRAMES, FEWEST_FRAMES = 480, 12
HELD = "held"  # name of the marks around what stands still
FEWEST_PIXELS = 60  # of the thing in a picture
ALIKE = 0.6  # share of its colours that a mask must have in common with the marked one: else it is of something else
AROUND_STROKES = 1.0  # of a stroke's extent: the thing may reach as far beyond it
WARPED_BLUR = 2.0  # [px] of a mask that the flow has carried


@dataclass(frozen=True)
class Clip:
    """Pictures (F, H, W, 3) uint8 at times (F,) [s] from the first; `first`: that one's number in the file, whose
    pictures have the size `filmed`, (width, height) [px]."""

    pictures: np.ndarray
    times: np.ndarray
    first: int
    where: str
    filmed: tuple[int, int] = (0, 0)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) [px]."""
        return self.pictures.shape[2], self.pictures.shape[1]


def read_clip(path: Path, part: tuple[float, float] | None = None, fps: float | None = None) -> Clip:
    """The pictures of a video between two moments [s] of it; `fps`: how many a second were taken. Raises BadInput."""
    if not path.is_file():
        raise BadInput(f"{path}: no such file")
    video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    pictures, times, first = [], [], 0
    begin, end = part or (0.0, np.inf)
    rate = fps or video.get(cv2.CAP_PROP_FPS)
    for k in range(1 << 20):
        good, picture = video.read()
        if not good:
            break
        time = k / rate if fps else video.get(cv2.CAP_PROP_POS_MSEC) / 1e3
        if time < begin - 1e-6:
            first = k + 1
            continue
        if time > end + 1e-6:
            break
        if len(pictures) == MOST_FRAMES:
            raise BadInput(f"{path}: more than {MOST_FRAMES} pictures; --part BEGIN END takes a part of it")
        filmed = picture.shape[1::-1]
        scale = LONGEST_SIDE / max(filmed)
        if scale < 1.0:
            picture = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        pictures.append(picture[..., ::-1])
        times.append(time)
    video.release()
    if not pictures:
        raise BadInput(f"{path}: cannot be read as a video" if k == 0 else f"{path}: has no picture in --part")
    if len(pictures) < FEWEST_FRAMES:
        raise BadInput(f"{path}: {len(pictures)} pictures; at least {FEWEST_FRAMES} are needed")
    seconds = np.array(times)
    if (np.diff(seconds) <= 0).any():  # a container without times
        seconds = np.arange(len(pictures)) / rate
    return Clip(np.stack(pictures), seconds - seconds[0], first, str(path), filmed)


def straightened(clip: Clip, masks: np.ndarray, lens: Lens) -> tuple[Clip, np.ndarray]:
    """The clip and masks (F, H, W) as the lens's pinhole camera sees them. Raises BadInput where nothing is left."""
    if not lens.distorts:
        return clip, masks
    every = np.ones(masks.shape[1:], bool)
    pictures, known = zip(*(lens.undistort(p, every) for p in clip.pictures), strict=True)
    if not known[0].any():
        raise BadInput(f"{clip.where}: its lens, {lens.distortion}, distorts it so much that no pixel is left")
    cut = np.stack([lens.undistort_labels(m.astype(np.uint8)) > 0 for m in masks])
    return replace(clip, pictures=np.stack(pictures)), cut


def read_clip_marks(path: Path, clip: Clip, full: tuple[int, int]) -> tuple[dict[int, ViewMarks], np.ndarray]:
    """Marks on the thing by the picture's number in the clip, and boxes (B, 4) [px] around what is held in the first.

    full  (width, height) [px] that the marks are in. Raises BadInput.
    """
    names = {f"frame_{clip.first + k:04d}": k for k in range(len(clip.pictures))}
    marks = read_marks(path, dict.fromkeys(names, full))
    things = [name for name in marks.objects if name != HELD]
    if len(things) != 1:
        raise BadInput(f"{path}: marks {len(things)} things, not one (and perhaps {HELD!r})")
    scale = clip.size[0] / full[0]

    def scaled(m: ViewMarks) -> ViewMarks:
        return ViewMarks(*([scale * p for p in parts] for parts in (m.inside, m.outside, m.boxes)))

    held = [m for view, m in marks.objects.get(HELD, {}).items() if names[view] == 0]
    boxes = [scale * b for m in held for b in m.boxes]
    if HELD in marks.objects and not boxes:
        raise BadInput(f"{path}: {HELD!r} needs a box in frame_{clip.first:04d}, around what stands still")
    thing = {names[view]: scaled(m) for view, m in marks.objects[things[0]].items()}
    return thing, np.array(boxes).reshape(-1, 4)


def clip_masks(clip: Clip, marks: dict[int, ViewMarks], progress=lambda done: None) -> np.ndarray:
    """Masks (F, H, W) of the thing: cut in the marked pictures, carried from the nearest of them by optical flow
    and cut by its colours again. Raises BadInput where it is lost."""
    count = len(clip.pictures)
    found: dict[int, np.ndarray] = {k: marked_mask(clip.pictures[k], m) for k, m in marks.items()}
    colours = {k: colours_of(clip.pictures[k], found[k]) for k in marks}
    grey = [cv2.cvtColor(p, cv2.COLOR_RGB2GRAY) for p in clip.pictures]
    nearest = [min(marks, key=lambda m: abs(m - k)) for k in range(count)]
    for k in sorted(range(count), key=lambda k: abs(nearest[k] - k)):
        if k not in found:
            before = k - int(np.sign(k - nearest[k]))
            found[k] = carried_mask(clip.pictures[k], found[before], flow_between(grey[k], grey[before]))
        alike = cv2.compareHist(colours[nearest[k]], colours_of(clip.pictures[k], found[k]), cv2.HISTCMP_INTERSECT)
        if found[k].sum() < FEWEST_PIXELS or alike < ALIKE:
            what = "its strokes give no mask" if k in marks else "the thing leaves the picture, or its mask is lost"
            raise BadInput(f"{clip.where}: frame_{clip.first + k:04d}: {what}; mark it there, or leave it out (--part)")
        progress(len(found) / count)
    return np.stack([found[k] for k in range(count)])


def colours_of(picture: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Shares of the mask's pixels (H, W) bool in 8 x 8 x 8 boxes of colours, smoothed for the light that changes."""
    shares = cv2.calcHist([picture], [0, 1, 2], mask.astype(np.uint8), [8, 8, 8], [0, 256] * 3) / max(mask.sum(), 1)
    for axis in range(3):
        shares = 0.5 * shares + 0.25 * (np.roll(shares, 1, axis) + np.roll(shares, -1, axis))
    return shares.astype(np.float32)


def flow_between(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Optical flow of grey pictures (H, W) uint8 from `one` to `other`, (H, W, 2) [px]."""
    return cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(one, other, None)


def warped(picture: np.ndarray, flow: np.ndarray) -> np.ndarray:
    """The picture (H, W, ...) float32 as seen from where `flow` leads to it; 0 outside of it."""
    y, x = np.mgrid[: flow.shape[0], : flow.shape[1]].astype(np.float32)
    return cv2.remap(picture, x + flow[..., 0], y + flow[..., 1], cv2.INTER_LINEAR, borderValue=0)


def carried_mask(picture: np.ndarray, before: np.ndarray, flow: np.ndarray) -> np.ndarray:
    """The mask (H, W) bool in a picture (H, W, 3), of that before it, (H, W) bool, at the end of the flow."""
    likely = cv2.GaussianBlur(warped(before.astype(np.float32), flow), (0, 0), WARPED_BLUR)
    band = max(2, round(BAND * float(np.hypot(*before.shape))))
    unsure = border_band((likely > 0.5).astype(np.uint8), band)
    return whole(cut_objects(picture, np.stack([1 - likely, likely], 2), unsure, band, grab_cut) == 1, likely > 0.5)


def marked_mask(picture: np.ndarray, marks: ViewMarks) -> np.ndarray:
    """The mask (H, W) bool of a thing in a picture (H, W, 3) by its marks there: GrabCut, around its strokes."""
    shape = picture.shape[:2]
    width = max(2, round(STROKE_WIDTH * float(np.hypot(*shape))))
    inside, outside = (drawn_strokes(s, shape, width) for s in (marks.inside, marks.outside))
    points = marks.points if marks.boxes or not marks.inside else np.concatenate(marks.inside)
    low, high = points.min(0), points.max(0)
    if not marks.boxes:
        reach = AROUND_STROKES * (high - low).max() + 3 * width
        low, high = low - reach, high + reach
    near = drawn_boxes([np.r_[low, high]], shape)
    outside |= ~near
    inside &= ~outside
    likely = near.astype(float) if marks.boxes else inside.astype(float)
    if not marks.boxes:  # what lies about a stroke is of it as far as the stroke is long
        likely = np.maximum(likely, cv2.GaussianBlur(likely, (0, 0), max(width, 0.15 * (high - low).max())) > 0.03)
    found = grab_cut(picture, likely, inside, outside)
    return whole(found, inside if inside.any() else found)


def whole(mask: np.ndarray, seed: np.ndarray) -> np.ndarray:
    """The parts of a mask (H, W) bool that the seed (H, W) bool touches, the largest of them, without holes."""
    part = cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)[1]
    size = np.bincount(part[mask & seed], minlength=1)
    size[0] = 0
    if not size.any():
        return np.zeros_like(mask)
    largest = (part == size.argmax()).astype(np.uint8)
    lines, _ = cv2.findContours(largest, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return cv2.drawContours(largest, lines, -1, 1, cv2.FILLED) > 0


def backdrop_of(pictures: np.ndarray, masks: np.ndarray) -> np.ndarray:
    """The picture behind the thing, (H, W, 3) uint8: medians over time, and what it always hides filled in."""
    around = np.stack([cv2.dilate(m.astype(np.uint8), np.ones((7, 7), np.uint8)) for m in masks]) > 0
    seen = np.ma.masked_array(pictures, np.broadcast_to(around[..., None], pictures.shape))
    middle = np.ma.median(seen, axis=0).filled(0).astype(np.uint8)
    return cv2.inpaint(middle, around.all(0).astype(np.uint8), 5, cv2.INPAINT_TELEA)
