"""Writes an MP4, picture by picture."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np

from core.errors import BadInput

CODECS = ("avc1", "mp4v")  # H.264 where OpenCV was built with an encoder for it, else MPEG-4 part 2
BYTES_PER_PIXEL = 0.05  # of a busy picture; measured 0.02 on noise and waves that move


class Video:
    """An MP4 that appears under its name only when complete and readable: `write` pictures, then `close`.

    `frames` is the number that is planned. Raises BadInput at once if the place cannot be written or
    lacks the room for them.
    """

    def __init__(self, path: str | Path, width: int, height: int, *, fps: float = 60.0, frames: int = 0):
        self.path, self.fps, self.count = Path(path), fps, 0
        if self.path.suffix.lower() != ".mp4":
            raise BadInput(f"{self.path}: a video's name must end in .mp4")
        self.size = (width + width % 2, height + height % 2)  # codecs halve the colours' resolution
        self._part = self.path.with_name(f".{self.path.stem}.part.mp4")
        claim(self.path, self._part, bytes_needed=BYTES_PER_PIXEL * width * height * frames)
        self._codec, self._writer = self._first_codec(), None

    def _open(self, codec: str):
        import cv2

        return cv2.VideoWriter(str(self._part), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*codec), self.fps, self.size)

    def _first_codec(self) -> str:
        """The first codec that OpenCV can write here. It tries, as OpenCV keeps no list; leaves no file."""
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # silent: FFmpeg logs each encoder that is not there
        import cv2

        level = cv2.utils.logging.getLogLevel()
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # it reports each codec that it lacks
        try:
            for codec in CODECS:
                writer = self._open(codec)
                works = writer.isOpened()
                writer.release()
                self._part.unlink(missing_ok=True)
                if works:
                    return codec
        finally:
            cv2.utils.logging.setLogLevel(level)
        raise BadInput(f"{self.path}: OpenCV can write no MP4 of {self.size[0]}x{self.size[1]} pixels here")

    def write(self, pixels: np.ndarray) -> None:
        """Append RGBA or RGB pixels (H, W, 3|4) uint8; an odd row or column is repeated to make it even."""
        import cv2

        if self._writer is None:
            self._writer = self._open(self._codec)
        height, width, channels = pixels.shape
        bgr = cv2.cvtColor(pixels, cv2.COLOR_RGBA2BGR if channels == 4 else cv2.COLOR_RGB2BGR)
        if (width, height) != self.size:
            bgr = np.pad(bgr, ((0, self.size[1] - height), (0, self.size[0] - width), (0, 0)), mode="edge")
        self._writer.write(bgr)
        self.count += 1

    def close(self) -> None:
        """Finish the file, check that it reads back, and give it its name. Raises BadInput if it does not."""
        if self._writer is None:
            return
        self._writer.release()
        self._writer = None
        readable = frame_count(self._part)
        if readable != self.count:
            self._part.unlink(missing_ok=True)
            raise BadInput(f"{self.path}: only {readable} of {self.count} pictures could be written (disk full?)")
        os.replace(self._part, self.path)

    def discard(self) -> None:
        """Give up: leaves no file behind."""
        if self._writer is not None:
            self._writer.release()
            self._writer = None
            self._part.unlink(missing_ok=True)


def claim(path: Path, part: Path, *, bytes_needed: float = 0.0) -> None:
    """Check that a file can be written at `path`, by way of `part` beside it. Raises BadInput."""
    if path.is_dir():
        raise BadInput(f"{path}: is a folder")
    try:
        with open(part, "wb"):
            pass
        free = shutil.disk_usage(path.parent).free
    except OSError as e:
        raise BadInput(f"{path}: cannot write here ({e.strerror})") from e
    part.unlink()
    if free < bytes_needed:
        raise BadInput(f"{path}: the disk has {free / 1e6:.0f} MB left, about {bytes_needed / 1e6:.0f} MB are needed")


def frame_count(path: Path) -> int:
    """Number of pictures that a video file says it holds, if its first one can be read; else 0."""
    import cv2

    video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    try:
        readable, _ = video.read()
        return round(video.get(cv2.CAP_PROP_FRAME_COUNT)) if readable else 0
    finally:
        video.release()
