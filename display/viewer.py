"""Splat files as a world in which nothing moves but the camera, and cameras that show all of one."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from assets.gaussians import Gaussians
from assets.splat_files import read_gaussians
from assets.up_axis import alternatives, rotation_to_up
from core.camera import Camera, look_at, perspective
from core.errors import BadInput
from core.measured_length import scale_between
from core.morton import morton_order
from display.edit.editor import rotation_matrix
from display.edit.notice import Notice
from display.keep.output_place import output_path
from display.picture import pixels_of
from display.protocol import Frame, Line, WorldView
from display.surface_point import surface_point
from display.timing import Timings
from display.user_commands import (
    Command,
    Crop,
    Measure,
    NextBackground,
    NextFile,
    Rescale,
    Rotate,
    ShowAxes,
    TurnUp,
    ViewFiles,
    WriteSplats,
    in_order,
)
from display.viewed_file import ViewedFile
from render import MOVING_SORT
from scenes.scene import Scene

FOV_Y = 0.9  # [rad]
FAINT_OPACITY = 0.02  # of the most opaque Gaussian; fainter ones do not count for the size
CHOICE_SIZE = (168, 140)  # [px] of the pictures in which the user sees what else may be up
ELEVATION = np.radians(15.0)  # [rad] of the first view
DISTANCE_MARGIN = 1.08  # of the distance at which a ball around the splats fills the picture
BACKGROUND = (0.12, 0.13, 0.14)
BACKGROUNDS = (BACKGROUND, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (0.45, 0.62, 0.8))
AXES = {"x": (0.95, 0.35, 0.3), "y": (0.45, 0.85, 0.35), "z": (0.4, 0.6, 1.0)}  # colours
SCALE_RANGE = (1e-3, 1e3)  # of a file, in multiples of its first size
CROP_COLOUR = (1.0, 0.78, 0.25)


def upright(path, up: str | None) -> tuple[Gaussians, str]:
    """The file's Gaussians turned so that `up` is +y, and a note on that; None: guessed, but for a prepared asset."""
    gaussians, chances = turned_up(path, up)
    return gaussians, up_note(chances)


def turned_up(path, up: str | None) -> tuple[Gaussians, dict[str, float]]:
    """The file's Gaussians turned so that `up` is +y; None: the most probable axis, but for a prepared asset.

    Out.  the probabilities of the axes that may point up, the one that was taken first
    """
    from assets.up_axis import up_probabilities

    gaussians = read_gaussians(path)
    if up is None and not str(path).lower().endswith(".h5"):
        chances = up_probabilities(gaussians)
    else:
        chances = {up or "+y": 1.0}
    chances = dict(sorted(chances.items(), key=lambda item: -item[1]))
    up = next(iter(chances))
    if up != "+y":
        gaussians = gaussians.transformed(rotation_to_up(up), (0.0, 0.0, 0.0), 1.0)
    return gaussians.select(morton_order(gaussians.means)), chances


def up_note(chances: dict[str, float]) -> str:
    """A note on which axis is up, the first, and what else may be."""
    up, sure = next(iter(chances.items()))
    if len(chances) == 1:
        return f"{up} is up"
    others = ", ".join(f"{other} {chances[other]:.0%}" for other in alternatives(chances)[1:])
    return f"{up} is up (guessed, {sure:.0%} sure{f'; else {others}' if others else ''}; --up overrides)"


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
    """A world of splat files, one of which is shown. Draws only when something has changed.

    files  at least one;   out  what `WriteSplats` writes; None: a new name each time
    """

    def __init__(
        self,
        files: Sequence[ViewedFile],
        scene: Scene,
        *,
        width: int,
        height: int,
        sort: str | None = None,
        background: tuple[float, float, float] = BACKGROUND,
        out: Path | None = None,
    ):
        self.scene, self.timings, self.picture_size = scene, Timings(), (width, height)
        self.axes, self._files, self._index, self._out = False, list(files), 0, out
        self._sort, self._background = sort, background
        self.cameras: list[Camera] = []  # of the last picture
        self._shown: tuple | None = None
        self._notice = Notice()
        self._prepare(max(len(f.gaussians) for f in files), max(f.gaussians.sh.shape[1] for f in files))
        self.up_choices = self._choices()

    def _prepare(self, capacity: int, coefficients: int) -> None:
        """Make room on the device for so many Gaussians with so many coefficients, and show the file."""
        from render.splats import Splats

        self._coefficients = coefficients
        self.splats = Splats(self._padded(self.file.gaussians), capacity=capacity)
        self.splats.sh_range = (0, self.splats.capacity)  # of any file
        self._draw_in_order()
        self._show_crop()

    def _draw_in_order(self) -> None:
        """Make the renderer for the order of blending of the file that is shown."""
        from render.renderer import Renderer

        self._drawn_order = self._order()
        options = {"background": self._background, "sort": self._drawn_order}
        self.renderer = Renderer(self.splats, *self.picture_size, **options)

    def _order(self) -> str:
        """Order of blending of the file that is shown, unless the user chose one."""
        return self._sort or self.file.gaussians.sort or MOVING_SORT

    def _padded(self, gaussians: Gaussians) -> Gaussians:
        """The Gaussians with as many coefficients as there is room for."""
        missing = self._coefficients - gaussians.sh.shape[1]
        return replace(gaussians, sh=np.pad(gaussians.sh, ((0, 0), (0, missing), (0, 0)))) if missing else gaussians

    @property
    def file(self) -> ViewedFile:
        """The file that is shown."""
        return self._files[self._index]

    @property
    def file_number(self) -> tuple[int, int]:
        """Number of the file that is shown, from 1, and how many there are."""
        return self._index + 1, len(self._files)

    @property
    def facts(self) -> list[tuple[str, str]]:
        """Statistics of the file that is shown."""
        return self._facts

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
        """Carry out the frame's commands, and draw the view of its camera."""
        for command in in_order(frame.commands):
            try:
                self._carry_out(command)
            except BadInput as e:
                self.tell(" ".join(str(e).split()))
        self.draw(frame.cameras)

    def _carry_out(self, command: Command) -> None:
        match command:
            case ViewFiles(paths):
                first = len(self._files)
                self._files += [ViewedFile.read(Path(path), None) for path in paths]
                self._show(first)
            case NextFile(step):
                self._show((self._index + step) % len(self._files))
            case TurnUp(up):
                self._change(self.file.turned(up))
                self.up_choices = []  # the user has seen them, and chosen
                self.tell(self.file.note)
            case Rotate(_, rotation):
                self._change(self.file.changed(rotation_matrix(rotation)))
            case Rescale(_, factor):
                self._rescale(factor)
            case Measure(start, end, length):
                self._measure(np.array(start), np.array(end), length)
            case ShowAxes(on):
                self.axes = on
            case NextBackground():
                known = [*BACKGROUNDS, *([] if self._background in BACKGROUNDS else [self._background])]
                self._background = known[(known.index(self._background) + 1) % len(known)]
                self.renderer.set_background(self._background)
                self._shown = None
            case Crop(low, high):
                self._files[self._index] = self.file.cropped(np.array(low), np.array(high))
                self._show_crop()
            case WriteSplats():
                self._write()

    def _measure(self, start: np.ndarray, end: np.ndarray, length: float) -> None:
        """Scale the file by the length between two points, and the view with it. Raises BadInput."""
        factor, middle = scale_between(start, end, length), 0.5 * (self.file.bounds.low + self.file.bounds.high)
        eye, target = self.cameras[0].position, 0.5 * (start + end)
        self._rescale(factor)
        self.wanted_view = tuple(tuple((middle + factor * (p - middle)).tolist()) for p in (eye, target))

    def _rescale(self, factor: float) -> None:
        """Show the file `factor` times as large. Raises BadInput."""
        if not SCALE_RANGE[0] <= factor * self.file.factor <= SCALE_RANGE[1]:
            raise BadInput("It cannot be made larger or smaller than that.")
        self._change(self.file.changed(np.eye(3), factor))
        self.tell(f"{self.file.size:.3g} m: its largest extent, {self.file.factor:.3g} times that of the file")

    def _change(self, file: ViewedFile) -> None:
        """Show the file that is shown as it is now."""
        shown, self._files[self._index] = self.up_choices, file
        self._show(self._index)
        self.up_choices = shown

    def frame_kept(self, path: Path, turn: np.ndarray, factor: float) -> None:
        """Note that a file has been turned and scaled by that much (display/keep/kept_frame.py)."""
        self._files = [f.kept(turn, factor) if f.path == path else f for f in self._files]

    def _show(self, index: int) -> None:
        """Show another file, or the one that has changed."""
        self._index = index
        gaussians = self.file.gaussians
        if len(gaussians) > self.splats.capacity or gaussians.sh.shape[1] > self._coefficients:
            self.renderer.destroy()
            self.splats.destroy()
            self._prepare(len(gaussians), max(self._coefficients, gaussians.sh.shape[1]))
        else:
            self.splats.replace(self._padded(gaussians))
            if self._order() != self._drawn_order:
                self.renderer.destroy()
                self._draw_in_order()
            self._show_crop()
        self.up_choices = self._choices()
        self.tell(f"{self.file.path.name}: {len(gaussians):,} Gaussians")

    def _choices(self) -> list[tuple[str, float, np.ndarray]]:
        """The axes that may well point up, with their probabilities and what the file looks like with each."""
        chances = self.file.chances
        ups = alternatives(chances) if chances else []
        if len(ups) < 2:
            return []
        gaussians, size, found = self.file.gaussians, self.picture_size, []
        middle, radius = middle_and_radius(gaussians)
        self.renderer.resize(*CHOICE_SIZE)
        for up in ups:
            turn = np.eye(4)  # of the world, which is easier than to turn the Gaussians
            turn[:3, :3] = rotation_to_up(up) @ rotation_to_up(self.file.up).T
            turn[:3, 3] = middle - turn[:3, :3] @ middle
            aspect = CHOICE_SIZE[0] / CHOICE_SIZE[1]
            pose = look_at(eye_around(middle, radius, 0.5, aspect=aspect), middle) @ turn
            self.renderer.render([perspective(*CHOICE_SIZE, FOV_Y, pose)])
            found.append((up, chances[up], pixels_of(self.renderer.picture)[: CHOICE_SIZE[1], :, :3].copy()))
        self.renderer.resize(*size)
        self._shown = None
        return found

    def _show_crop(self) -> None:
        """Hide what lies outside the crop."""
        self._facts = self.file.facts()
        shown = self.file.shown
        self.splats.opacity.from_numpy(self.splats.padded(np.where(shown, self.file.gaussians.opacities, 0.0)))
        self.resize(*self.picture_size)

    def _write(self) -> None:
        """Write what is shown of the file."""
        out = self._out or output_path(f"{self.file.path.stem}_cropped", ".ply")
        same = out.exists() and self.file.path.exists() and out.samefile(self.file.path)
        if same:
            raise BadInput(f"{out}: is the file itself; choose another name")
        self.tell(f"Written: {out}, {self.file.write(out):,} Gaussians")
        print(self._notice.shown, file=sys.stderr, flush=True)

    def surface(self, camera: Camera, u: float, v: float) -> np.ndarray | None:
        """Point (3,) [m] of what a camera sees at a pixel; None: nothing opaque."""
        return surface_point(self.splats, camera, u, v)

    def lines(self) -> list[Line]:
        """The axes, as long as the file is large, and the box of the crop."""
        lines = []
        if self.axes:
            length = 10.0 ** np.round(np.log10(max(float(np.max(self.file.bounds.high - self.file.bounds.low)), 1e-3)))
            for axis, (name, colour) in enumerate(AXES.items()):
                text = f"{name} {length:g} m"
                lines.append(Line(np.zeros(3), length * np.eye(3)[axis], colour, text))
        if self.file.crop is not None:
            lines += [Line(start, end, CROP_COLOUR) for start, end in self.file.crop.edges()]
        return lines

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
