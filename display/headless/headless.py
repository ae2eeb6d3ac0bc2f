"""The display without a screen: a fixed number of frames, written as a video and a picture; progress on stderr."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from time import perf_counter

from assets.file_access import check_writable
from core.camera import Camera, look_at, perspective
from core.errors import BadInput
from display.picture import check_picture_name, pixels_of, save_picture, side_by_side
from display.protocol import Frame, WorldView
from scenes.scene import Scene

FRAME_DT = 1 / 60  # [s]
EYE_DISTANCE = 0.063  # [m] between the two eyes of a stereo pair, the adult mean
PROGRESS_FRAMES = 120  # shorter runs show no progress


class Headless:
    """A display: `for frame in headless.frames(world): world.step(frame); headless.present(world)`.

    Yields `frames` frames of 1/60 s from the scene's camera, in which the world's scripted hand plays if `scripted`.
    `record` is an MP4 with every `every`-th frame, in real time; `snapshot` a picture of frame `snapshot_frame`,
    counted from 0 (default: the last). With `views=2` the pictures are stereo pairs, written side by side. Raises
    BadInput before the first frame if a file cannot be written.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        width: int,
        height: int,
        frames: int,
        record: str | Path | None = None,
        snapshot: str | Path | None = None,
        snapshot_frame: int | None = None,
        views: int = 1,
        every: int = 1,
        scripted: bool = True,
    ):
        if frames < 1:
            raise BadInput(f"cannot run {frames} frames: at least one is needed")
        self.size, self.views, self.count, self._scripted = (width, height), views, frames, scripted
        self.show_scene(scene, "", "")
        self.snapshot = Path(snapshot) if snapshot else None
        self.snapshot_frame = frames - 1 if snapshot_frame is None else snapshot_frame
        if not 0 <= self.snapshot_frame < frames:
            raise BadInput(f"no frame {self.snapshot_frame} to take a picture of: there are {frames}")
        if self.snapshot:
            check_picture_name(self.snapshot)
            check_writable(self.snapshot)
        self._every, self._video, self._index = every, None, 0
        if record:
            from display.headless.video import Video

            planned = -(-frames // every)
            self._video = Video(record, views * width, height, fps=1 / FRAME_DT / every, frames=planned)

    def __enter__(self) -> Headless:
        return self

    def __exit__(self, *error) -> None:
        self.close()

    def close(self) -> None:
        """Drop an unfinished video. Further calls do nothing."""
        if self._video is not None:
            self._video.discard()

    def loading(self, text: str, picture=None) -> None:
        """Do nothing: the terminal shows the progress."""

    def show_scene(self, scene: Scene, title: str, name: str) -> None:
        """Film another scene with its own camera."""
        self._fov_y = scene.fov_y
        self._look(scene.eye, scene.target)

    def _look(self, eye, target) -> None:
        camera = perspective(*self.size, self._fov_y, look_at(eye, target))
        self.cameras = [camera] if self.views == 1 else stereo_pair(camera)

    def frames(self, world: WorldView) -> Iterator[Frame]:
        """The frames, then finish the video. A loop that breaks off leaves none."""
        progress, first = Progress(self.count), round(world.time / FRAME_DT)  # of a state, in which time has passed
        if world.wanted_view is not None:
            self._look(*world.wanted_view)
        try:
            for index in range(self.count):
                self._index, time = index, (first + index + 1) * FRAME_DT
                hands = world.scripted_hands(time) if self._scripted else []
                yield Frame(FRAME_DT, time, self.cameras, hands)
                progress.show(index + 1)
            if self._video is not None:
                self._video.close()
        finally:
            progress.end()
            self.close()

    def present(self, world: WorldView) -> None:
        """Write the world's picture to the video and the snapshot."""
        filmed = self._video is not None and self._index % self._every == 0
        kept = self.snapshot is not None and self._index == self.snapshot_frame
        if filmed or kept:
            with world.timings.stage("write"):
                pixels = side_by_side(pixels_of(world.picture), self.views)
                if filmed:
                    self._video.write(pixels)
                if kept:
                    save_picture(self.snapshot, pixels)
        world.timings.exact = True  # from the second frame on; the first compiles
        world.timings.frame()


def stereo_pair(camera: Camera) -> list[Camera]:
    """Left and right eye, parallel, around a camera."""
    eyes = []
    for side in (-1, 1):
        matrix = camera.world_to_camera.copy()
        matrix[0, 3] -= side * EYE_DISTANCE / 2
        eyes.append(replace(camera, world_to_camera=matrix))
    return eyes


class Progress:
    """Progress of a long run on stderr: a line that renews itself on a terminal, else one per tenth."""

    def __init__(self, total: int, stream=None):
        self.total, self._out = total, stream or sys.stderr
        self._tty, self._begin, self._last, self._shown = self._out.isatty(), perf_counter(), 0.0, False

    def show(self, done: int) -> None:
        """`done` frames are finished."""
        if self.total < PROGRESS_FRAMES:
            return
        now = perf_counter()
        rate = done / (now - self._begin)
        text = f"frame {done} of {self.total}, {rate:.1f} a second"
        if self._tty and (now - self._last >= 1 or done == self.total):
            print(f"\r{text}\033[K", end="", file=self._out, flush=True)
            self._last, self._shown = now, True
        elif not self._tty and done * 10 // self.total > (done - 1) * 10 // self.total:
            print(text, file=self._out, flush=True)

    def end(self) -> None:
        """End the line."""
        if self._shown:
            print(file=self._out)
