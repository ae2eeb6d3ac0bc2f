"""Worlds of splats alone, in which nothing moves but the camera: of files, and of a training that goes on."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from assets.gaussians import Gaussians
from assets.orientation import alternatives, rotation_to_up
from core.camera import Camera, look_at, perspective
from core.errors import BadInput
from core.measured_length import scale_between
from display import user_commands
from display.edit.editor import rotation_matrix
from display.picture import output_path, pixels_of, surface_point
from display.protocol import Frame, Line, Notice, WorldView
from display.timing import Timings
from display.user_commands import in_order
from display.viewed_file import BACKGROUND, FOV_Y, ViewedFile, view_around
from render import MOVING_SORT
from scenes.scene import Scene

CHOICE_SIZE = (168, 140)  # [px] of the pictures in which the user sees what else may be up
BACKGROUNDS = (BACKGROUND, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (0.45, 0.62, 0.8))
AXES = {"x": (0.95, 0.35, 0.3), "y": (0.45, 0.85, 0.35), "z": (0.4, 0.6, 1.0)}  # colours
SCALE_RANGE = (1e-3, 1e3)  # of a file, in multiples of its first size
CROP_COLOUR = (1.0, 0.78, 0.25)


class SplatWorld(WorldView):
    """Splats as a world. It draws only when the camera or what it sees has changed.

    scene  says where to look from
    """

    def __init__(self, splats, scene: Scene, size: tuple[int, int], *, sort: str | None, antialias: bool = False):
        self.scene, self.timings, self.splats, self.picture_size = scene, Timings(), splats, size
        self.cameras: list[Camera] = []  # of the last picture
        self._shown: tuple | None = None  # camera of the picture; None if it is outdated
        self._background, self._notice = scene.background, Notice()
        self._draw_with(sort, antialias)

    def _draw_with(self, sort: str | None, antialias: bool) -> None:
        from render.renderer import Renderer

        self.renderer = Renderer(
            self.splats, *self.picture_size, background=self._background, sort=sort, antialias=antialias
        )

    def resize(self, width: int, height: int) -> None:
        """Draw pictures of another size [px] from now on."""
        self.renderer.resize(width, height)
        self.picture_size, self._shown = (width, height), None

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
        """The finished picture, see WorldView."""
        return self.renderer.picture

    @property
    def notice(self) -> str:
        """Message about the last command, for some seconds."""
        return self._notice.shown

    def tell(self, text: str) -> None:
        """Let `notice` be this text."""
        self._notice.tell(text)

    def surface(self, camera: Camera, u: float, v: float) -> np.ndarray | None:
        """Point (3,) [m] of what a camera sees at a pixel; None: nothing opaque."""
        return surface_point(self.splats, camera, u, v)

    def stats(self) -> dict:
        """Counts for the panel."""
        return {"gaussians": self.splats.count}


class TrainingWorld(SplatWorld):
    """Splats that are being trained: `advance` changes them in each frame, and returns a line on how far they are."""

    moving = True

    def __init__(
        self,
        splats,
        scene: Scene,
        advance: Callable[[], str],
        *,
        size: tuple[int, int],
        sort: str | None,
        antialias: bool,
    ):
        super().__init__(splats, scene, size, sort=sort, antialias=antialias)
        self._advance = advance

    def step(self, frame: Frame) -> None:
        """Let the splats change, and draw them for the frame's camera."""
        with self.timings.stage("train"):
            self.tell(self._advance())
        self._shown = None
        self.draw(frame.cameras() if callable(frame.cameras) else frame.cameras)


class Viewer(SplatWorld):
    """A world of splat files, one of which is shown.

    files  at least one;   size  (width, height) [px];   out  what `WriteSplats` writes; None: a new name each time
    """

    def __init__(
        self,
        files: Sequence[ViewedFile],
        scene: Scene,
        size: tuple[int, int],
        *,
        sort: str | None = None,
        out: Path | None = None,
    ):
        self.axes, self._files, self._index, self._out, self._sort = False, list(files), 0, out, sort
        splats = self._splats_for(max(len(f.gaussians) for f in files), max(f.gaussians.sh.shape[1] for f in files))
        self._drawn_with = self._order, self.file.gaussians.antialias
        super().__init__(splats, scene, size, sort=self._order, antialias=self.file.gaussians.antialias)
        self._show_crop()
        self.up_choices = self._choices()

    def _splats_for(self, capacity: int, coefficients: int):
        """The file that is shown on the device, with room for so many Gaussians with so many coefficients."""
        from render.splats import Splats

        self._coefficients = coefficients
        splats = Splats(self._padded(self.file.gaussians), capacity=capacity)
        splats.sh_range = (0, splats.capacity)  # of any file
        return splats

    @property
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

    def step(self, frame: Frame) -> None:
        """Carry out the frame's commands, and draw the view of its camera."""
        for command in in_order(frame.commands):
            try:
                self._carry_out(command)
            except BadInput as e:
                self.tell(" ".join(str(e).split()))
        self.draw(frame.cameras)

    def _carry_out(self, command: user_commands.Command) -> None:
        match command:
            case user_commands.ViewFiles(paths):
                first = len(self._files)
                self._files += [ViewedFile.read(path, None) for path in paths]
                self._show(first)
            case user_commands.NextFile(step):
                self._show((self._index + step) % len(self._files))
            case user_commands.TurnUp(up):
                self._change(self.file.turned(up))
                self.up_choices = []  # the user has seen them, and chosen
                self.tell(self.file.note)
            case user_commands.Rotate(_, rotation):
                self._change(self.file.changed(rotation_matrix(rotation)))
            case user_commands.Rescale(_, factor):
                self._rescale(factor)
            case user_commands.Measure(start, end, length):
                self._measure(np.array(start), np.array(end), length)
            case user_commands.ShowAxes(on):
                self.axes = on
            case user_commands.NextBackground():
                known = [*BACKGROUNDS, *([] if self._background in BACKGROUNDS else [self._background])]
                self._background = known[(known.index(self._background) + 1) % len(known)]
                self.renderer.set_background(self._background)
                self._shown = None
            case user_commands.Crop(low, high):
                self._files[self._index] = self.file.cropped(np.array(low), np.array(high))
                self._show_crop()
            case user_commands.WriteSplats():
                self._write()

    def _measure(self, start: np.ndarray, end: np.ndarray, length: float) -> None:
        """Scale the file by the length between two points, and the view with it. Raises BadInput."""
        factor, middle = scale_between(start, end, length), 0.5 * (self.file.bounds.low + self.file.bounds.high)
        eye, target = self.cameras[0].position, 0.5 * (start + end)
        self._rescale(factor)
        self.wanted_view = tuple(tuple((middle + factor * (p - middle)).tolist()) for p in (eye, target))

    def _rescale(self, factor: float) -> None:
        if not SCALE_RANGE[0] <= factor * self.file.factor <= SCALE_RANGE[1]:
            raise BadInput("It cannot be made larger or smaller than that.")
        self._change(self.file.changed(np.eye(3), factor))
        self.tell(f"{self.file.size:.3g} m: its largest extent, {self.file.factor:.3g} times that of the file")

    def _change(self, file: ViewedFile) -> None:
        """Show the file that is shown as it is now."""
        self._files[self._index] = file
        self._upload()

    def frame_kept(self, path: Path, turn: np.ndarray, factor: float) -> None:
        """Note that a file has been turned and scaled by that much (display/keep/kept_frame.py)."""
        self._files = [f.kept(turn, factor) if f.path == path else f for f in self._files]

    def _show(self, index: int) -> None:
        self._index = index
        self._upload()
        self.up_choices = self._choices()
        self.tell(f"{self.file.path.name}: {len(self.file.gaussians):,} Gaussians")

    def _upload(self) -> None:
        """Bring the file to the device: into the fields that are there, if it fits."""
        count, coefficients = len(self.file.gaussians), self.file.gaussians.sh.shape[1]
        fits = count <= self.splats.capacity and coefficients <= self._coefficients
        drawn_with = self._order, self.file.gaussians.antialias
        if not fits or drawn_with != self._drawn_with:
            self.renderer.destroy()
        if fits:
            self.splats.replace(self._padded(self.file.gaussians))
        else:
            self.splats.destroy()
            self.splats = self._splats_for(count, max(self._coefficients, coefficients))
        if not fits or drawn_with != self._drawn_with:
            self._draw_with(*drawn_with)
        self._drawn_with = drawn_with
        self._show_crop()

    def _choices(self) -> list[tuple[str, float, np.ndarray]]:
        """The axes that may well point up, with their probabilities and what the file looks like with each."""
        ups = alternatives(self.file.chances)
        if len(ups) < 2:
            return []
        size, found = self.picture_size, []
        eye, middle = view_around(self.file.gaussians, CHOICE_SIZE[0] / CHOICE_SIZE[1], 0.5)
        self.renderer.resize(*CHOICE_SIZE)
        for up in ups:
            turn = np.eye(4)  # of the world, which is easier than to turn the Gaussians
            turn[:3, :3] = rotation_to_up(up) @ rotation_to_up(self.file.up).T
            turn[:3, 3] = middle - turn[:3, :3] @ middle
            self.renderer.render([perspective(*CHOICE_SIZE, FOV_Y, look_at(eye, middle) @ turn)])
            found.append((up, self.file.chances[up], pixels_of(self.renderer.picture)[: CHOICE_SIZE[1], :, :3].copy()))
        self.renderer.resize(*size)
        self._shown = None
        return found

    def _show_crop(self) -> None:
        shown = self.file.shown
        self.splats.opacity.from_numpy(self.splats.padded(np.where(shown, self.file.gaussians.opacities, 0.0)))
        self.resize(*self.picture_size)

    def _write(self) -> None:
        out = self._out or output_path(f"{self.file.path.stem}_cropped", ".ply")
        if out.exists() and self.file.path.exists() and out.samefile(self.file.path):
            raise BadInput(f"{out}: is the file itself; choose another name")
        self.tell(f"Written: {out}, {self.file.write(out):,} Gaussians")
        print(self._notice.shown, file=sys.stderr, flush=True)

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
