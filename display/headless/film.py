"""Films what a window shows, in real time, whatever its frame rate and size."""

from __future__ import annotations

from pathlib import Path

from display.headless.video import Video
from display.picture import pixels_of

FPS = 30.0


class FilmWriter:
    """An MP4 of `width` x `height` [px] at 30 frames a second; complete after `close`. Raises BadInput."""

    def __init__(self, path: str | Path, width: int, height: int):
        self.size = (width, height)
        self._video = Video(path, width, height, fps=FPS)

    def add(self, world, time: float) -> None:
        """Bring the film up to `time` [s]: a slow frame is repeated, a fast one may be passed over."""
        if self._video.count >= time * FPS:
            return
        pixels = pixels_of(world.picture)[: world.picture_size[1]]  # of a headset's eyes the left one
        if (pixels.shape[1], pixels.shape[0]) != self.size:
            import cv2

            pixels = cv2.resize(pixels, self.size, interpolation=cv2.INTER_AREA)
        while self._video.count < time * FPS:
            self._video.write(pixels)

    def close(self) -> None:
        """Finish the film."""
        self._video.close()
