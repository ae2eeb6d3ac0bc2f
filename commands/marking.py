"""Content of the marking window: photographs of a capture, or a splat."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

import cv2
import numpy as np

from assets.gaussians import Gaussians
from assets.orientation import guess_up_axis, rotation_to_up
from core.errors import BadInput
from display.mark.mark_edit import Mark, MarkEdit, MarkState
from display.window.mouse import OrbitCamera
from prepare.segment.marks import Marks, SplatMarks, ViewMarks, drawn_boxes, drawn_strokes
from prepare.segment.mask_files import check_name, object_colors, overlay
from prepare.segment.mask_propagation import grab_cut
from prepare.train.photographs import read_image

ORIENTATION_SAMPLE = 30_000  # Gaussians from which the up axis is guessed
PICTURE_SIZE = (960, 540)  # [px] of the pictures of a splat that are marked
STROKE_WIDTH = 0.006  # of a photograph's height
SHOWN_SIDE = 1600  # [px] longer side of a photograph in the window
CUT_SIDE = 320  # [px] of what is cut at once: a third of a second


def state_of(marks: Marks, grow: dict[str, int]) -> MarkState:
    """Marks of a file in the form of the window."""
    found = []
    for name, views in marks.objects.items():
        for view, m in views.items():
            found += [
                Mark(name, view, kind, tuple(map(tuple, s))) for kind in ("inside", "outside") for s in vars(m)[kind]
            ]
            found += [Mark(name, view, "boxes", tuple(map(tuple, b.reshape(2, 2)))) for b in m.boxes]
    points = {view: tuple(row) for view, row in marks.points.items()}
    return MarkState(tuple(marks.objects) or MarkState.objects, tuple(found), dict(grow), points)


def marks_of_state(state: MarkState) -> Marks:
    """Marks of the window in the form of a file; objects without marks are left out. Raises BadInput for a name."""
    marks = Marks()
    for mark in state.marks:
        check_name(mark.object, "the window")
        own = marks.objects.setdefault(mark.object, {}).setdefault(mark.view, ViewMarks())
        points = np.array(mark.points, np.float64)
        getattr(own, mark.kind).append(points.ravel() if mark.kind == "boxes" else points)
    order = {name: marks.objects[name] for name in state.objects if name in marks.objects}
    return Marks(order, {view: list(row) for view, row in state.points.items() if any(row)})


def edit_of(marks: Marks, grow: dict[str, int]) -> MarkEdit:
    """Editing state that starts from the marks of a file."""
    return MarkEdit(state_of(marks, grow) if marks.objects else None)


class SplatSubject:
    """A splat that is marked from a free camera; a Subject of MarkWindow. Taichi must be running."""

    size, version, numbered = PICTURE_SIZE, 0, False

    def __init__(self, gaussians: Gaussians, marks: SplatMarks):
        from display.mark.mark_window import FreeView
        from display.viewed_file import FOV_Y, view_around
        from prepare.segment.splat_segmentation import LiveSelection

        some = gaussians.select(np.arange(0, len(gaussians), -(-len(gaussians) // ORIENTATION_SAMPLE)))
        upright = np.eye(4)
        upright[:3, :3] = rotation_to_up(guess_up_axis(some)[0])
        turned = replace(some, means=(some.means @ upright[:3, :3].T).astype(np.float32))
        view = view_around(turned, PICTURE_SIZE[0] / PICTURE_SIZE[1])
        self.free = FreeView(OrbitCamera(*view, FOV_Y), PICTURE_SIZE, upright, marks.cameras)
        self._selection = LiveSelection(gaussians)

    @property
    def views(self) -> list[str]:
        """Names of the views that have been marked."""
        return list(self.free.cameras)

    def colour(self, index: int) -> tuple[float, float, float]:
        return tuple(object_colors(index + 1)[index] / 255.0)

    def picture(self) -> np.ndarray:
        return self._selection.picture(self.free.camera)

    def view_shown(self) -> str | None:
        return self.free.shown()

    def go_to(self, view: str) -> None:
        self.free.go_to(view)

    def select(self, state: MarkState) -> str:
        marks, numbers = marks_of_state(state), {name: k for k, name in enumerate(state.objects, 1)}
        counts = self._selection.select(SplatMarks(self.free.cameras, marks, state.grow), numbers)
        return ", ".join(f"{name}: {count:,}" for name, count in counts.items()) + " Gaussians" if counts else ""

    def marks(self, state: MarkState) -> SplatMarks:
        """The marks with the cameras of their views."""
        marks = marks_of_state(state)
        cameras = {name: self.free.cameras[name] for name in marks.views}
        return SplatMarks(cameras, marks, {n: r for n, r in state.grow.items() if n in marks.objects})

    def close(self) -> None:
        """Free the device memory."""
        self._selection.destroy()


class PhotographSubject:
    """Photographs that are marked; a Subject of MarkWindow. What is selected is a first idea: each photograph is cut
    by its own marks alone, at a small size. `numbered`: points of the place are marked, too."""

    free = None

    def __init__(self, views: Sequence, numbered: bool = False):
        self.numbered = numbered
        self._views = {view.name: view for view in views}
        self.views, self._state = list(self._views), MarkState()
        self._shown = self.views[0]
        self._read: tuple[str, tuple[int, int], np.ndarray] | None = None
        self._cuts: dict[tuple, Future] = {}
        self._last: dict[tuple, np.ndarray] = {}
        self._thread = ThreadPoolExecutor(1)  # else the window would not answer while it cuts

    @property
    def version(self) -> int:
        return sum(cut.done() for cut in self._cuts.values())

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) [px] of the photograph."""
        return self._photograph()[0]

    def colour(self, index: int) -> tuple[float, float, float]:
        return tuple(object_colors(index + 1)[index] / 255.0)

    def view_shown(self) -> str:
        return self._shown

    def go_to(self, view: str) -> None:
        self._shown = view

    def select(self, state: MarkState) -> str:
        marks, self._state = marks_of_state(state), state
        once = [name for name, views in marks.objects.items() if len(views) == 1]
        return f"{', '.join(once)}: mark it in one more photograph, from another side" if once else ""

    def picture(self) -> np.ndarray:
        _, pixels = self._photograph()
        ids = np.zeros(pixels.shape[:2], np.uint8)
        marks = marks_of_state(self._state).in_view(self._shown)
        for name, mark in marks.items():
            found = self._cut(name, marks) if mark.inside or mark.boxes else None
            if found is not None:
                large = cv2.resize(found.astype(np.float32), pixels.shape[1::-1], interpolation=cv2.INTER_LINEAR)
                ids[large > 0.5] = self._state.objects.index(name) + 1
        return overlay(pixels, ids, object_colors(len(self._state.objects)))

    def _photograph(self) -> tuple[tuple[int, int], np.ndarray]:
        """The shown photograph: its (width, height) [px], and its pixels, reduced if it is large."""
        if self._read is None or self._read[0] != self._shown:
            pixels = read_image(self._views[self._shown].image)[0]
            self._read = self._shown, pixels.shape[1::-1], at_most(pixels, SHOWN_SIDE)
        return self._read[1:]

    def _cut(self, name: str, marks: dict[str, ViewMarks]) -> np.ndarray | None:
        """Mask (h, w) bool of an object in the shown photograph, small; the one before, or None, until it is made."""
        relevant = tuple(m for m in self._state.marks if m.view == self._shown and m.kind != "outside")
        own = tuple(m for m in self._state.marks if (m.object, m.view) == (name, self._shown))
        key = (name, own, relevant)
        if key not in self._cuts:
            size, pixels = self._photograph()
            self._cuts[key] = self._thread.submit(first_cut, at_most(pixels, CUT_SIDE), size, name, marks)
        if self._cuts[key].done():
            self._last[self._shown, name] = self._cuts[key].result()
        return self._last.get((self._shown, name))


def first_cut(picture: np.ndarray, size: tuple[int, int], name: str, marks: dict[str, ViewMarks]) -> np.ndarray:
    """An object (h, w) bool in a small picture of a photograph of `size` [px], by all objects' marks in it: GrabCut."""
    shape, scale = picture.shape[:2], picture.shape[1] / size[0]

    def drawn(strokes: list[np.ndarray]) -> np.ndarray:
        return drawn_strokes([scale * s for s in strokes], shape, max(3, round(STROKE_WIDTH * shape[0])))

    own = marks[name]
    inside, near = drawn(own.inside), drawn_boxes([scale * b for b in own.boxes], shape)
    outside = drawn(own.outside) | drawn([s for other, m in marks.items() if other != name for s in m.inside])
    if own.boxes:
        outside |= ~near
    else:
        ys, xs = np.nonzero(inside | outside)
        near[ys.min() : ys.max() + 1, xs.min() : xs.max() + 1] = True
    inside &= ~outside
    found = grab_cut(picture, near.astype(float), inside, outside)
    if inside.any():  # what else has its colours is not of it
        part = cv2.connectedComponents(found.astype(np.uint8), connectivity=8)[1]
        found &= np.isin(part, part[inside & found])
    return found


def at_most(pixels: np.ndarray, side: int) -> np.ndarray:
    """The picture (H, W, 3) with a longer side of at most `side` [px]."""
    scale = side / max(pixels.shape[:2])
    if scale >= 1.0:
        return pixels
    return cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


def check_window() -> None:
    """Raise BadInput where no window can be opened."""
    from display.window.gl_window import has_display

    if not has_display():
        raise BadInput("no display to mark objects on: --marks MARKS.json takes marks from a file")
