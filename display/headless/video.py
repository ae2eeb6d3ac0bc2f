"""The display without a screen: a fixed number of frames; and MP4 videos, written picture by picture or as a film."""

from __future__ import annotations

import contextlib
import itertools
import math
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from assets.file_access import check_space, check_writable, part_beside, remove_stale_parts
from core.camera import Camera, look_at, perspective
from core.errors import BadInput
from display.picture import pixels_of, side_by_side
from display.protocol import Closing, Display, Frame, WorldView
from display.timing import ProgressLine
from display.user_commands import SetInteraction
from scenes.scene import Scene

FRAME_DT = 1 / 60  # [s]
EYE_DISTANCE = 0.063  # [m] between the two eyes of a stereo pair, the adult mean
# H.264, which browsers play, else MPEG-4 part 2; a quality at which no block is seen, in a fraction of a frame's time
CODECS = {"libx264": {"preset": "veryfast", "crf": "20"}, "mpeg4": {"qscale": "4"}}
FILM_FPS = 30.0  # [1/s]
TIME_SLACK = 0.01  # of a picture: rounding of a time adds none
BYTES_PER_PIXEL = 0.05  # of a busy picture; measured 0.02 on noise and waves that move
CHECK_PERIOD = 1.0  # [s] between two looks at how full the disk is: a failed write of a film is not reported
FILM_RESERVE = 32e6  # [bytes]; a film ends while its last pictures and its index can still be written
SPACE_MIN = 1e6  # [bytes] without which no codec can even begin


class Headless(Display):
    """A display of `count` frames of 1/60 s from the scene's camera; None: of any number.

    views     2: pictures are stereo pairs
    scripted  whether the world's scripted hand plays
    """

    def __init__(
        self, scene: Scene, *, width: int, height: int, frames: int | None, views: int = 1, scripted: bool = True
    ):
        if frames is not None and frames < 1:
            raise BadInput(f"cannot run {frames} frames: at least one is needed")
        self.size, self.views, self.count, self._scripted = (width, height), views, frames, scripted
        self.show_scene(scene, "", "")

    def show_scene(self, scene: Scene, title: str, name: str) -> None:
        """Look at another scene from its own camera."""
        self._fov_y = scene.fov_y
        self._look(scene.eye, scene.target)

    def _look(self, eye, target) -> None:
        camera = perspective(*self.size, self._fov_y, look_at(eye, target))
        self.cameras = [camera] if self.views == 1 else stereo_pair(camera)

    def frames(self, world: WorldView) -> Iterator[Frame]:
        """The frames. The world may have begun with a state, in which time has passed."""
        line, begin = ProgressLine(), round(world.time / FRAME_DT)
        if world.wanted_view is not None:
            self._look(*world.wanted_view)
        try:
            for index in itertools.count(1) if self.count is None else range(1, self.count + 1):
                mode = world.interaction
                hands = world.scripted_hands((begin + index) * FRAME_DT) if self._scripted else []
                commands = [] if world.interaction == mode else [SetInteraction(world.interaction)]  # for a recording
                yield Frame(FRAME_DT, index * FRAME_DT, self.cameras, hands, commands)
                if self.count:
                    line.show(f"frame {index} of {self.count}, {world.timings.fps:.1f} a second")
        finally:
            line.end()

    def present(self, world: WorldView) -> None:
        """Mark the end of the frame, as the device ends it."""
        world.timings.exact = True
        world.timings.frame()


def stereo_pair(camera: Camera) -> list[Camera]:
    """Left and right eye, parallel, around a camera."""
    eyes = []
    for side in (-1, 1):
        matrix = camera.world_to_camera.copy()
        matrix[0, 3] -= side * EYE_DISTANCE / 2
        eyes.append(replace(camera, world_to_camera=matrix))
    return eyes


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
        remove_stale_parts(self.path)
        self._part = part_beside(self.path, ".mp4")
        check_writable(self.path, self._part, bytes_needed=max(BYTES_PER_PIXEL * width * height * frames, SPACE_MIN))
        self._container = self._stream = None

    def _open(self) -> None:
        import av

        codec = next(name for name in CODECS if name in av.codec.codecs_available)
        self._container = av.open(str(self._part), "w", options={"movflags": "faststart"})
        self._stream = self._container.add_stream(codec, rate=round(self.fps), options=CODECS[codec])
        self._stream.width, self._stream.height = self.size
        self._stream.pix_fmt = "yuv420p"  # what browsers play

    def write(self, pixels: np.ndarray) -> None:
        """Append RGBA or RGB pixels (H, W, 3|4) uint8; an odd row or column is repeated to make it even."""
        import av

        if self._container is None:
            self._open()
        height, width, _ = pixels.shape
        rgb = np.pad(pixels[..., :3], ((0, self.size[1] - height), (0, self.size[0] - width), (0, 0)), mode="edge")
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(rgb), format="rgb24")
        self._encode(frame)
        self.count += 1

    def _encode(self, frame) -> None:
        """Encode a picture; None: those that the encoder still holds. Raises BadInput."""
        try:
            self._container.mux(self._stream.encode(frame))
        except OSError as e:  # PyAV's errors are the system's
            raise BadInput(f"{self.path}: cannot be written ({e.strerror})") from e

    def close(self, *, keep: bool = True) -> None:
        """Finish the file, check that it reads back, and give it its name; or leave none. Raises BadInput."""
        if self._container is None:
            return
        with contextlib.suppress(BadInput):  # what could not be written is missing below
            self._encode(None)
        with contextlib.suppress(OSError):
            self._container.close()
        self._container = None
        readable = frame_count(self._part) if keep else 0
        if keep and readable == self.count:
            os.replace(self._part, self.path)
            return
        self._part.unlink(missing_ok=True)
        if keep:
            raise BadInput(f"{self.path}: only {readable} of {self.count} pictures could be written (disk full?)")


class FilmWriter(Closing):
    """Film of a display of any frame rate and size: an MP4 at FILM_FPS, complete after `close`. Raises BadInput.

    width, height  of a view [px];   views  that stand side by side
    seconds        planned length [s]; 0: as long as the play. One that breaks off keeps what it has
    """

    def __init__(self, path: str | Path, width: int, height: int, *, views: int = 1, seconds: float = 0.0):
        self.path, self.size, self._views = Path(path), (views * width, height), views
        self.ended = ""  # the reason, if it has ended before it was closed
        self._video = Video(path, *self.size, fps=FILM_FPS, frames=math.ceil(seconds * FILM_FPS))
        self._checked = 0.0  # [s], time of the last look at the disk

    def add(self, world, time: float) -> None:
        """Bring the film up to `time` [s]: a slow frame is repeated, a fast one may be passed over.

        The film ends when the disk is nearly full, so that it can be completed; a notice and a line say so.
        """
        due = time * FILM_FPS - TIME_SLACK
        if self.ended or self._video.count >= due:
            return
        if time - self._checked >= CHECK_PERIOD:
            self._checked = time
            try:
                check_space(self.path, FILM_RESERVE)
            except BadInput as e:
                self.ended = f"The film ends here: {e}"
                print(self.ended, file=sys.stderr, flush=True)
                world.tell(self.ended)
                return
        pixels = pixels_of(world.picture)[: self._views * world.picture_size[1]]  # of a headset's eyes the left one
        pixels = side_by_side(pixels, self._views)
        if (pixels.shape[1], pixels.shape[0]) != self.size:
            import cv2

            pixels = cv2.resize(pixels, self.size, interpolation=cv2.INTER_AREA)
        while self._video.count < due:
            self._video.write(pixels)

    def close(self) -> None:
        """Finish the film."""
        self._video.close()


def frame_count(path: Path) -> int:
    """Number of pictures of a video file according to its header; 0 if the first cannot be read."""
    import cv2

    video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    try:
        readable, _ = video.read()
        return round(video.get(cv2.CAP_PROP_FRAME_COUNT)) if readable else 0
    finally:
        video.release()
