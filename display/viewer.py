"""A splat file alone: what `display/world.py` is to a scene, where nothing moves but the camera.

Also where a camera stands that shows all of it.
"""

from __future__ import annotations

import itertools
import sys
from pathlib import Path

import numpy as np

from assets.gaussians import Gaussians
from assets.splat_files import read_gaussians
from core.camera import Camera, look_at, perspective
from core.errors import BadInput
from core.morton import morton_order
from core.runtime import start_taichi
from display.headless.headless import Headless
from display.protocol import Frame, WorldView
from display.timing import Timings
from render import MOVING_SORT
from scenes.scene import Scene

FOV_Y = 0.9  # [rad]
BEHIND = 0.02  # what is fainter than this share of the most opaque counts for no size
ENOUGH = 30_000  # Gaussians to guess from which way is up
ABOVE = np.radians(15.0)  # [rad] from which a thing is looked at
ROOMY = 1.08  # times the distance at which a ball around it fills the picture
BACKDROP = (0.12, 0.13, 0.14)


def upright(path, up: str | None) -> tuple[Gaussians, str]:
    """The file's Gaussians turned so that `up` is +y, and what to say of it; None guesses, but for a prepared asset."""
    from assets.up_axis import guess_up_axis, rotation_to_up

    gaussians = read_gaussians(path)
    note = ""
    if up is None:
        some = gaussians.select(np.arange(0, len(gaussians), -(-len(gaussians) // ENOUGH)))
        up, sure = ("+y", 1.0) if str(path).lower().endswith(".h5") else guess_up_axis(some)
        note = f" (guessed, {sure:.0%} sure; --up overrides)" if sure < 1.0 else ""
    if up != "+y":
        gaussians = gaussians.transformed(rotation_to_up(up), (0.0, 0.0, 0.0), 1.0)
    return gaussians.select(morton_order(gaussians.means)), f"{up} is up{note}"


def middle_and_radius(gaussians: Gaussians) -> tuple[np.ndarray, float]:
    """Middle (3,) and radius of what is there, but for the outermost hundredth on each side."""
    seen = gaussians.opacities > BEHIND * gaussians.opacities.max(initial=0.0)
    points = gaussians.means[seen].astype(np.float64)
    low, high = np.percentile(points, [1.0, 99.0], axis=0)
    middle = 0.5 * (low + high)
    largest = float(np.exp(gaussians.log_scales[seen].astype(np.float64)).max(initial=1e-6))
    radius = float(np.percentile(np.linalg.norm(points - middle, axis=1), 98.0))
    return middle, radius if radius > 0.0 else 3.0 * largest


def eye_around(middle, radius: float, yaw: float, *, above: float = ABOVE, aspect: float = 1.0) -> np.ndarray:
    """Where an eye shows a ball of `radius` whole, `yaw` [rad] to the right of its front, `above` [rad] its equator."""
    narrow = np.arctan(np.tan(0.5 * FOV_Y) * min(aspect, 1.0))
    way = np.array([np.sin(yaw) * np.cos(above), np.sin(above), np.cos(yaw) * np.cos(above)])
    return np.asarray(middle) + ROOMY * radius / np.sin(narrow) * way


def camera_around(gaussians: Gaussians, width: int, height: int, yaw: float, *, above: float = ABOVE) -> Camera:
    """A camera that shows all Gaussians from `yaw` [rad]."""
    middle, radius = middle_and_radius(gaussians)
    eye = eye_around(middle, radius, yaw, above=above, aspect=width / height)
    return perspective(width, height, FOV_Y, look_at(eye, middle))


def scene_around(gaussians: Gaussians, aspect: float) -> Scene:
    """A scene without bodies: only where to look from."""
    middle, radius = middle_and_radius(gaussians)
    eye = eye_around(middle, radius, 0.0, aspect=aspect)
    return Scene(bodies=[], light=None, eye=tuple(eye), target=tuple(middle), fov_y=FOV_Y, background=BACKDROP)


class Viewer(WorldView):
    """What a display needs of a world. Draws only when the camera or the picture's size has changed."""

    def __init__(self, gaussians: Gaussians, scene: Scene, *, width: int, height: int, sort: str = MOVING_SORT):
        from render.renderer import Renderer
        from render.splats import Splats

        self.scene, self.timings = scene, Timings()
        self.splats = Splats(gaussians)
        self.renderer = Renderer(self.splats, width, height, background=scene.background, sort=sort)
        self.picture_size = (width, height)
        self._shown: tuple | None = None

    def resize(self, width: int, height: int) -> None:
        """Draw pictures of another size from now on."""
        self.renderer.resize(width, height)
        self.picture_size, self._shown = (width, height), None

    def step(self, frame: Frame) -> None:
        """Draw what the frame's camera sees."""
        camera = frame.cameras[0]
        now = (camera.width, camera.height, camera.fx, camera.world_to_camera.tobytes())
        if now != self._shown:
            with self.timings.stage("render"):
                self.renderer.render([camera])
            self._shown = now

    @property
    def picture(self):
        """As `World.picture`."""
        return self.renderer.picture

    def stats(self) -> dict:
        """Counts for the panel."""
        return {"gaussians": self.splats.count}


def run(args) -> None:
    """Show `args.file` in a window, or headless: write `args.snapshot`. Raises BadInput."""
    from display.window.gl_window import has_display

    if args.snapshot is None and not has_display():
        raise BadInput("no display to open a window on: --snapshot OUT.png writes a picture, `vrgs.py render` a film")
    gaussians, up = upright(args.file, args.up)
    width, height = args.size
    scene = scene_around(gaussians, width / height)
    print(f"{args.file}: {len(gaussians)} Gaussians, SH degree {gaussians.sh_degree}, {up}", file=sys.stderr)
    if args.snapshot is not None:
        display = Headless(scene, width=width, height=height, frames=1, snapshot=args.snapshot)
    else:
        from display.window.window import Window

        display = Window(scene, title=Path(args.file).name, width=width, height=height)
    with display:
        start_taichi(args.arch)
        world = Viewer(gaussians, scene, width=display.size[0], height=display.size[1], sort=args.sort)
        for frame in itertools.islice(display.frames(world), args.frames):
            world.step(frame)
            display.present(world)
