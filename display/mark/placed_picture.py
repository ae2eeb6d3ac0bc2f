"""A picture in a part of a window: nearer or as a whole, and positions from one to the other."""

from __future__ import annotations

from display.picture import fit

ZOOM_STEP, ZOOM_MAX = 1.25, 16.0  # of a notch of the wheel; of the whole picture's size


class PlacedPicture:
    """A picture of `size` (width, height) in an `area` (left, top, width, height) of a window.

    Pixels of the picture and positions in the window count to the right and down.
    """

    def __init__(self) -> None:
        self.size, self.area, self._zoom = (1, 1), (0, 0, 1, 1), 1.0
        self._middle = (0.5, 0.5)  # the part of the picture at the middle of the area

    @property
    def place(self) -> tuple[float, float, float, float]:
        """Left, top, width and height of the whole picture in the window; larger than the area when zoomed."""
        left, top, width, height = self.area
        x, y, w, h = fit(self.size, (max(width, 1), max(height, 1)))
        if self._zoom == 1.0:
            return left + x, top + y, w, h
        w, h = w * self._zoom, h * self._zoom
        return left + 0.5 * width - self._middle[0] * w, top + 0.5 * height - self._middle[1] * h, w, h

    def to_window(self, point) -> tuple[float, float]:
        """Position in the window of a pixel's."""
        left, top, width, height = self.place
        return left + point[0] / self.size[0] * width, top + point[1] / self.size[1] * height

    def to_picture(self, x: float, y: float) -> tuple[float, float]:
        """Position in the picture, the nearest within it."""
        left, top, width, height = self.place
        u, v = (x - left) / width * self.size[0], (y - top) / height * self.size[1]
        return min(max(u, 0.0), float(self.size[0])), min(max(v, 0.0), float(self.size[1]))

    def zoom(self, notches: float, x: float, y: float) -> None:
        """Enlarge the picture; what is at a position in the window stays there."""
        u, v = (p / n for p, n in zip(self.to_picture(x, y), self.size, strict=True))
        self._zoom = min(max(self._zoom * ZOOM_STEP**notches, 1.0), ZOOM_MAX)
        left, top, width, height = self.area
        _, _, w, h = fit(self.size, (max(width, 1), max(height, 1)))
        w, h = w * self._zoom, h * self._zoom
        self._look_at(u - (x - left - 0.5 * width) / w, v - (y - top - 0.5 * height) / h)

    def move(self, dx: float, dy: float) -> None:
        """Move an enlarged picture with the hand that drags it."""
        _, _, width, height = self.place
        self._look_at(self._middle[0] - dx / width, self._middle[1] - dy / height)

    def whole(self) -> None:
        """Show the whole picture."""
        self._zoom, self._middle = 1.0, (0.5, 0.5)

    def _look_at(self, u: float, v: float) -> None:
        self._middle = (min(max(u, 0.0), 1.0), min(max(v, 0.0), 1.0)) if self._zoom > 1.0 else (0.5, 0.5)
