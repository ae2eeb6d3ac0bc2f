"""A splat file alone as a world in which nothing moves but the camera, and cameras that show all of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from assets.gaussians import Gaussians
from assets.splat_files import read_gaussians
from core.camera import Camera, look_at, perspective
from core.morton import morton_order
from display.edit.notice import Notice
from display.protocol import Frame, WorldView
from display.timing import Timings
from render import MOVING_SORT
from scenes.scene import Scene

FOV_Y = 0.9  # [rad]
FAINT_OPACITY = 0.02  # of the most opaque Gaussian; fainter ones do not count for the size
ORIENTATION_SAMPLE = 30_000  # Gaussians from which the up axis is guessed
ELEVATION = np.radians(15.0)  # [rad] of the first view
DISTANCE_MARGIN = 1.08  # of the distance at which a ball around the splats fills the picture
BACKGROUND = (0.12, 0.13, 0.14)


def upright(path, up: str | None) -> tuple[Gaussians, str]:
    """The file's Gaussians turned so that `up` is +y, and a note on that; None: guessed, but for a prepared asset."""
    from assets.up_axis import guess_up_axis, rotation_to_up

    gaussians = read_gaussians(path)
    note = ""
    if up is None:
        some = gaussians.select(np.arange(0, len(gaussians), -(-len(gaussians) // ORIENTATION_SAMPLE)))
        up, sure = ("+y", 1.0) if str(path).lower().endswith(".h5") else guess_up_axis(some)
        note = f" (guessed, {sure:.0%} sure; --up overrides)" if sure < 1.0 else ""
    if up != "+y":
        gaussians = gaussians.transformed(rotation_to_up(up), (0.0, 0.0, 0.0), 1.0)
    return gaussians.select(morton_order(gaussians.means)), f"{up} is up{note}"


def middle_and_radius(gaussians: Gaussians) -> tuple[np.ndarray, float]:
    """Middle (3,) and radius [m] of the Gaussians, without the outermost hundredth on each side."""
    seen = gaussians.opacities > FAINT_OPACITY * gaussians.opacities.max(initial=0.0)
    points = gaussians.means[seen].astype(np.float64)
    low, high = np.percentile(points, [1.0, 99.0], axis=0)
    middle = 0.5 * (low + high)
    largest = float(np.exp(gaussians.log_scales[seen].astype(np.float64)).max(initial=1e-6))
    radius = float(np.percentile(np.linalg.norm(points - middle, axis=1), 98.0))
    return middle, radius if radius > 0.0 else 3.0 * largest


def eye_around(middle, radius: float, yaw: float, *, elevation: float = ELEVATION, aspect: float = 1.0) -> np.ndarray:
    """Position of an eye that sees a whole ball of `radius` [m], `yaw` right of and `elevation` above it [rad]."""
    narrow = np.arctan(np.tan(0.5 * FOV_Y) * min(aspect, 1.0))
    direction = np.array([np.sin(yaw) * np.cos(elevation), np.sin(elevation), np.cos(yaw) * np.cos(elevation)])
    return np.asarray(middle) + DISTANCE_MARGIN * radius / np.sin(narrow) * direction


def camera_around(gaussians: Gaussians, width: int, height: int, yaw: float, *, elevation: float = ELEVATION) -> Camera:
    """A camera that shows all Gaussians from `yaw` [rad]."""
    middle, radius = middle_and_radius(gaussians)
    eye = eye_around(middle, radius, yaw, elevation=elevation, aspect=width / height)
    return perspective(width, height, FOV_Y, look_at(eye, middle))


def scene_around(gaussians: Gaussians, aspect: float) -> Scene:
    """A scene without bodies: only where to look from."""
    middle, radius = middle_and_radius(gaussians)
    eye = eye_around(middle, radius, 0.0, aspect=aspect)
    return Scene(bodies=[], light=None, eye=tuple(eye), target=tuple(middle), fov_y=FOV_Y, background=BACKGROUND)


class Viewer(WorldView):
    """A world of Gaussians alone. Draws only when the camera or the picture's size has changed."""

    def __init__(self, gaussians: Gaussians, scene: Scene, *, width: int, height: int, sort: str = MOVING_SORT):
        from render.renderer import Renderer
        from render.splats import Splats

        self.scene, self.timings = scene, Timings()
        self.splats = Splats(gaussians)
        self.renderer = Renderer(self.splats, width, height, background=scene.background, sort=sort)
        self.picture_size = (width, height)
        self._shown: tuple | None = None
        self.cameras: list[Camera] = []  # of the last picture
        self._notice = Notice()

    @property
    def notice(self) -> str:
        """Message about the last command, for some seconds."""
        return self._notice.shown

    def tell(self, text: str) -> None:
        """Let `notice` be this text."""
        self._notice.tell(text)

    def resize(self, width: int, height: int) -> None:
        """Draw pictures of another size from now on."""
        self.renderer.resize(width, height)
        self.picture_size, self._shown = (width, height), None

    def step(self, frame: Frame) -> None:
        """Draw the view of the frame's camera."""
        self.draw(frame.cameras)

    def draw(self, cameras: Sequence[Camera]) -> None:
        """Draw for this camera, unless the picture shows that already."""
        self.cameras, camera = list(cameras), cameras[0]
        now = (camera.width, camera.height, camera.fx, camera.world_to_camera.tobytes())
        if now != self._shown:
            with self.timings.stage("render"):
                self.renderer.render([camera])
            self._shown = now
            self.pictures += 1

    @property
    def picture(self):
        """As `World.picture`."""
        return self.renderer.picture

    def stats(self) -> dict:
        """Counts for the panel."""
        return {"gaussians": self.splats.count}
