"""The display without a screen: a fixed number of frames, with progress on stderr."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from time import perf_counter

from core.camera import Camera, look_at, perspective
from core.errors import BadInput
from display.protocol import Display, Frame, WorldView
from display.timing import ProgressLine
from display.user_commands import SetInteraction
from scenes.scene import Scene

FRAME_DT = 1 / 60  # [s]
EYE_DISTANCE = 0.063  # [m] between the two eyes of a stereo pair, the adult mean


class Headless(Display):
    """A display of `count` frames of 1/60 s from the scene's camera.

    views     2: pictures are stereo pairs
    scripted  whether the world's scripted hand plays
    """

    def __init__(self, scene: Scene, *, width: int, height: int, frames: int, views: int = 1, scripted: bool = True):
        if frames < 1:
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
        line, begin = None, round(world.time / FRAME_DT)
        if world.wanted_view is not None:
            self._look(*world.wanted_view)
        try:
            for index in range(1, self.count + 1):
                mode = world.interaction
                hands = world.scripted_hands((begin + index) * FRAME_DT) if self._scripted else []
                commands = [] if world.interaction == mode else [SetInteraction(world.interaction)]  # for a recording
                yield Frame(FRAME_DT, index * FRAME_DT, self.cameras, hands, commands)
                line = line or ProgressLine()  # from the second frame on: the first compiles
                rate = (index - 1) / max(perf_counter() - line.begin, 1e-3)
                line.show(f"frame {index} of {self.count}, {rate:.1f} a second")
        finally:
            if line is not None:
                line.end()

    def present(self, world: WorldView) -> None:
        """Mark the end of the frame, from the second on as the device ends it: the first compiles."""
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
