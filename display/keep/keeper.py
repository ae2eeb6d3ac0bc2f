"""Files that the user asks for in play: pictures, films, cameras, states, exports; what is remembered of a scene."""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from assets.camera_file import write_cameras
from core.camera import fitted
from core.errors import BadInput
from core.vocabulary import Light
from display import user_commands as cmd
from display.headless.video import FilmWriter
from display.picture import output_path, pixels_of, save_picture
from display.preferences import PathText, Preferences
from display.protocol import Closing, Frame


class Keeper(Closing):
    """Carries out the commands of a frame that write files, `after` the frame; a thread writes one after the other.

    `scene` names the files; `about()` gives the options of the scene for a state. A notice and a line on stderr tell
    what was written, or why not; the play goes on. `close` waits for what is under way.
    """

    def __init__(self, scene: str, preferences: Preferences | None = None):
        self.scene, self.about = scene, lambda: {"scene": self.scene}
        self._preferences = preferences or Preferences()
        self._film: FilmWriter | None = None
        self._film_begin = 0.0  # [s]
        self._writer, self._tasks = ThreadPoolExecutor(1), []
        self._named: set[Path] = set()

    def after(self, frame: Frame, world) -> None:
        """Carry out the frame's commands, and film the frame."""
        for command in cmd.in_order(frame.commands):
            try:
                self._carry_out(command, frame, world)
            except (BadInput, OSError) as e:
                self._tell(one_line(e), one_line(e), world)
        if self._film is not None:
            self._add_to_film(frame.time, world)
        self._report(world)

    def close(self) -> None:
        """Finish the film and all files. Further calls do nothing."""
        if self._film is not None:
            self._finish_film()
        self._writer.shutdown()
        self._report(None)

    def _carry_out(self, command, frame: Frame, world) -> None:
        match command:
            case cmd.TakePicture(size):
                path, pixels = self._new_path(".png"), full_picture(world, size)
                self._write(path, lambda: save_picture(path, pixels))
            case cmd.WriteCamera(size):
                path = self._new_path("_camera.json")
                camera = world.cameras[0]
                cameras = [camera if size is None else fitted(camera, *size)]
                self._write(path, lambda: write_cameras(path, cameras))
            case cmd.SaveState(view):
                from display.keep.scene_state import state_of
                from display.keep.state_file import write_state

                path = self._new_path(".state.h5").absolute()
                state = state_of(world, self.about(), view)
                self._write(path, lambda: write_state(path, state))
                self._preferences.set(f"state.{self.scene}", str(path))
            case cmd.Export(kind, body, shadows):
                from display.keep.scene_export import exporter

                path = self._new_path(f".{kind}")
                self._write(path, exporter(world, path, body=body, shadows=shadows))
            case cmd.KeepFrame(body):
                from display.keep.kept_frame import frame_writer

                path, write = frame_writer(world, body)
                self._write(path, write)
            case cmd.Film(on, size) if on and self._film is None:
                self._film = FilmWriter(self._new_path(".mp4"), *(size or world.picture_size))
                self._film_begin = frame.time - frame.dt
            case cmd.Film(on) if not on and self._film is not None:
                self._finish_film()
                world.film_seconds = None

    def _new_path(self, ending: str) -> Path:
        """A name that neither a file has nor one that is still to be written."""
        path = output_path(self.scene, ending, self._named)
        self._named.add(path)
        return path

    def _write(self, path: Path, write: Callable[[], None]) -> None:
        """Write a file in the thread."""
        self._tasks.append(self._writer.submit(written, path, write))

    def _add_to_film(self, time: float, world) -> None:
        """Film the frame; a film that fails ends, and keeps what it has."""
        try:
            self._film.add(world, time - self._film_begin)
            world.film_seconds = time - self._film_begin
            failed = bool(self._film.ended)
        except (BadInput, OSError) as e:
            self._tell(one_line(e), one_line(e), world)
            failed = True
        if failed:
            self._finish_film()
            world.film_seconds = None

    def _finish_film(self) -> None:
        film, self._film = self._film, None
        self._write(film.path, film.close)

    def _report(self, world) -> None:
        """Report the results of the thread."""
        while self._tasks and (self._tasks[0].done() or world is None):
            task: Future = self._tasks.pop(0)
            self._tell(*task.result(), world)

    def _tell(self, line: str, notice: str, world) -> None:
        print(line, file=sys.stderr, flush=True)
        if world is not None:
            world.tell(notice)


def written(path: Path, write: Callable[[], None]) -> tuple[str, str]:
    """Write a file; returns a line and a notice that tell where it is, or why it failed."""
    try:
        write()
    except (BadInput, OSError) as e:
        return one_line(e), one_line(e)
    return f"Written: {path}", f"Written: {path.name} in {path.parent}"


def one_line(error: Exception) -> str:
    """Text of an error, for the user."""
    return " ".join(str(error).split())


def full_picture(world, size: tuple[int, int] | None) -> np.ndarray:
    """Pixels (H, W, 4) of the first camera's last view, drawn at `size` [px]; None: as it was drawn."""
    now = world.picture_size
    if size is None or tuple(size) == tuple(now):
        return pixels_of(world.picture)[: now[1]].copy()
    cameras = world.cameras
    world.resize(*size)
    try:
        world.draw([fitted(camera, *size) for camera in cameras])
        return pixels_of(world.picture)[: size[1]].copy()
    finally:
        world.resize(*now)


class Remembered:
    """Memory of a scene from one play to the next: its light, if `light`, and its last saved state.

    `given` adds them to the commands of the frames, `keep` stores the light at the end.
    """

    def __init__(self, preferences: Preferences, scene: str, *, light: bool):
        self._preferences, self._scene, self._lit, self._fresh = preferences, scene, light, light

    def given(self, frame: Frame, world) -> Frame:
        """The frame with the remembered light, if it is the first, and with the path of the state to be loaded."""
        commands = frame.commands
        if any(isinstance(c, cmd.LoadState) and not c.path for c in commands):
            last = self._preferences.get(f"state.{self._scene}", PathText, "")
            commands = [replace(c, path=c.path or last) if isinstance(c, cmd.LoadState) else c for c in commands]
        light = self._preferences.get(f"light.{self._scene}", Light) if self._fresh else None
        self._fresh = False
        if light is not None and light.position != light.target and world.light is not None:
            commands = [cmd.SetLight(light), *commands]
        frame.commands = commands
        return frame

    def keep(self, world) -> None:
        """Store the light, if it is not the scene's own."""
        own, now = world.scene.light, world.light
        if self._lit and now is not None:
            self._preferences.set(f"light.{self._scene}", None if now == own else now)
