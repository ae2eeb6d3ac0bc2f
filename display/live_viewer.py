"""Gaussians that are still being made as a world: something changes them between two pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from core.camera import Camera
from display.protocol import Frame, WorldView
from display.timing import Timings
from scenes.scene import Scene


class LiveViewer(WorldView):
    """A world of splats that `advance` changes in each frame; it returns a line on how far they are.

    drawn  options of the renderer: sort, antialias
    """

    moving = True

    def __init__(self, splats, scene: Scene, advance: Callable[[], str], *, size: tuple[int, int], **drawn):
        from render.renderer import Renderer

        self.scene, self.timings, self.splats, self.picture_size = scene, Timings(), splats, size
        options = {"background": scene.background, **drawn}
        self.renderer = Renderer(splats, *size, **options)
        self.cameras: list[Camera] = []  # of the last picture
        self._advance = advance

    def resize(self, width: int, height: int) -> None:
        """Draw pictures of another size from now on."""
        self.renderer.resize(width, height)
        self.picture_size = (width, height)

    def step(self, frame: Frame) -> None:
        """Let the splats change, and draw them for the frame's camera."""
        with self.timings.stage("train"):
            self.notice = self._advance()
        self.draw(frame.cameras() if callable(frame.cameras) else frame.cameras)

    def draw(self, cameras: Sequence[Camera]) -> None:
        """Draw for this camera."""
        self.cameras = list(cameras)
        with self.timings.stage("render"):
            self.renderer.render(self.cameras[:1])
        self.pictures += 1

    @property
    def picture(self):
        """As `World.picture`."""
        return self.renderer.picture

    def stats(self) -> dict:
        """Counts for the panel."""
        return {"gaussians": self.splats.count}
