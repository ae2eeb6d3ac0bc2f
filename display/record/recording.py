"""Recording of the user's input, frame by frame, and its replay, with the deviation from the recorded state."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from assets.file_access import check_writable, reason_of
from assets.library import animated_height
from core.camera import Camera, fitted
from core.errors import BadInput
from core.material import ANIMATED_MATERIAL
from core.runtime import running_arch
from core.typed import field_types
from core.vocabulary import Hand
from display.protocol import Closing, Frame
from display.record import recording_file
from display.record.recording_file import DATASETS, OPTIONS, Journal, WorldOptions
from display.user_commands import Command, Pause, commands_from_text, commands_to_text, last_of

WRITE_PERIOD = 1.0  # [s] between two states, and between two blocks of the journal


class Recording(Closing):
    """A recording in progress: `note` each frame before the world's step, `after` behind it, then `close`.

    Raises BadInput if the file cannot be written. If that happens later, a line says so, the play goes on, and what was
    recorded until then is kept.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        self.part = self.path.with_name(f"{self.path.name}.part")
        check_writable(self.path)
        self.about: dict = {}
        self.frames = 0
        self._world, self._dt = None, 0.0  # of the last frame
        self._new: dict[str, list] = {name: [] for name in DATASETS}
        self._since = 0.0  # [s] of recorded time since the last state
        self._stated = 0  # frames until then
        self._writer = ThreadPoolExecutor(1)
        self._blocks = 0  # in the journal
        try:
            self._journal: Journal | None = Journal(self.part)
        except FileExistsError as e:
            why = "was left by an interrupted session: play it with --replay, or remove it"
            why = "is being written by another session" if recording_file.is_locked(self.part) else why
            raise BadInput(f"{self.part} {why}") from e
        except OSError as e:
            raise BadInput(f"{self.path}: cannot be written ({reason_of(e)})") from e

    def begin(self, args, world_options: dict) -> None:
        """Store the options of the command and of the world."""
        self.about = about_play(args, world_options)

    def note(self, frame: Frame) -> Frame:
        """Record a frame before the world's step; returns the frame to pass to the world.

        Cameras given as a function are recorded when the world calls it.
        """
        new, self._dt = self._new, frame.dt
        new["frames/dt"].append(frame.dt)
        new["frames/time"].append(frame.time)
        new["frames/step"].append(frame.max_step or 0.0)
        new["frames/hands"].append(len(frame.hands))
        for hand in frame.hands:
            touches, numbers = packed_hand(hand)
            new["hands/touches"].append(touches)
            new["hands/numbers"].extend(numbers)
        if frame.commands:
            self._record_commands(frame.commands)
        new["frames/cameras"].append(0)
        if not callable(frame.cameras):
            self._record_cameras(frame.cameras)
            return frame
        return replace(frame, cameras=lambda: self._record_cameras(frame.cameras()))

    def _record_commands(self, commands: Sequence[Command]) -> None:
        line = commands_to_text(self.frames, commands)
        try:
            commands_from_text(line, f"{self.path}: not recorded")
        except BadInput as e:  # it would make the whole file invalid
            print(e, file=sys.stderr)
            return
        self._new["commands/text"].extend(f"{line}\n".encode())

    def _record_cameras(self, cameras: Sequence[Camera]) -> Sequence[Camera]:
        self._new["frames/cameras"][-1] = len(cameras)
        for c in cameras:
            numbers = [c.width, c.height, c.fx, c.fy, c.cx, c.cy, *c.world_to_camera.ravel().tolist()]
            self._new["cameras/values"].append(numbers)
        return cameras

    def after(self, world) -> None:
        """Record the state after the world's step of the frame noted last."""
        self.frames += 1
        self._world = world
        self._since += self._dt
        if self._since >= WRITE_PERIOD - 1e-6 or self.frames == 1:
            self._write()

    def _write(self) -> None:
        """Record the state, and pass the new rows to the writer thread, for which no frame waits."""
        self._since, self._stated, bodies = 0.0, self.frames, self._world.bodies()
        self._new["states/frame"].append(self.frames - 1)
        self._new["states/count"].append(len(bodies))
        self._new["states/centroids"].extend(np.asarray(b.centroid, np.float64) for b in bodies)
        new, self._new = self._new, {name: [] for name in DATASETS}
        self._writer.submit(self._append, new)

    def _append(self, new: dict[str, list]) -> None:
        """Append a block to the journal; where it finds no space, end the recording."""
        if self._journal is None:
            return
        columns = {name: np.array(rows, DATASETS[name][1]) for name, rows in new.items() if rows}
        if self._blocks == 0:
            columns["about"] = np.frombuffer(json.dumps(self.about).encode(), np.uint8)
        try:
            self._journal.append(columns)
            self._blocks += 1
        except OSError as e:
            what = "the recording ends here" if self._blocks else "nothing is recorded"
            print(f"{self.path}: {what} ({reason_of(e)})", file=sys.stderr)
            self._end()

    def _end(self) -> None:
        """Turn the journal into the recording; if that fails, leave it, and if it has no frame, remove it."""
        self._journal.close()
        self._journal = None
        try:
            if self._blocks:
                recording_file.write_recording(self.path, self.part)
            self.part.unlink()
        except BadInput as e:
            print(f"{e}; all that was recorded is in {self.part}, and --replay plays it", file=sys.stderr)

    def flush(self) -> None:
        """Wait until all data is written."""
        self._writer.submit(lambda: None).result()

    def close(self) -> None:
        """Write the rest, with the final state, and give the file its name. Further calls do nothing."""
        if self._stated < self.frames:
            self._write()
        self._writer.shutdown()  # waits
        if self._journal is not None:
            self._end()


def packed_hand(hand: Hand | None) -> tuple[int, list[float]]:
    """Number of finger capsules of a hand, and its numbers; -1 for one with non-finite numbers, as for none."""
    if hand is None:
        return -1, []
    numbers = [*hand.position, *hand.rotation, hand.grip, hand.reach]
    for touch in hand.touch:
        numbers += [*touch.a, *touch.b, touch.radius]
    return (len(hand.touch), numbers) if np.isfinite(numbers).all() else (-1, [])


def about_play(args, world_options: dict) -> dict:
    """The options of the command and of the world, and where kernels run, as JSON."""
    about = {key: plain(getattr(args, key, None)) for key in OPTIONS}
    about["arch"] = running_arch()
    about["world"] = {key: value for key, value in world_options.items() if isinstance(value, (bool, str))}
    return about


def plain(value):
    """An option as a JSON value; a path is a text."""
    if isinstance(value, dict):
        return {key: plain(v) for key, v in value.items()}
    if isinstance(value, list):
        return [plain(v) for v in value]
    return value if value is None or isinstance(value, (bool, int, float)) else str(value)


class Replay:
    """A recording: its attribute `about`, its frames, the states to compare with. `Replay.load` checks all."""

    def __init__(self, path: Path, version: int, about: dict, frames: list[Frame], states: dict[int, np.ndarray]):
        self.path, self.version, self.about = path, version, about
        self.recorded, self.states = frames, states
        self.done, self.largest, self.compared = 0, 0.0, 0
        self._cameras: list[Camera] = []  # of the last frame that had some

    def __len__(self) -> int:
        return len(self.recorded)

    @classmethod
    def load(cls, path: str | Path) -> Replay:
        """Read and check a recording, also an incomplete one."""
        path = Path(path)
        with recording_file.open_recording(path) as file:
            version = file.check_format(recording_file.FORMAT, "a recording", recording_file.VERSION)
            about = recording_file.checked_about(file.text("", "about"), str(path))
            frames = recording_file.read_frames(file)
            return cls(path, version, about, frames, recording_file.read_states(file, len(frames)))

    def world_options(self, options: dict) -> dict:
        """Options of a World: the recorded ones, and these for the rest; depth is for headsets."""
        recorded = self.about.get("world", {})
        return options | {key: recorded[key] for key in field_types(WorldOptions) if key in recorded}

    def implied_material(self, scene: str, body: str | None) -> str | None:
        """The material of a body for which none was asked: before version 2 that was not the asset's own."""
        if self.version > 1 or scene != "sandbox":
            return None
        return "plush" if body is None or animated_height(body) is None else ANIMATED_MATERIAL

    def frames(self, display, world, *, paced: bool) -> Iterator[Frame]:
        """Yield the recorded frames, for the caller to step and present, until they or the display end.

        They have as many of the recorded cameras as the display, for pictures of its size.

        paced  in the display's time, and stopped by its pause; otherwise one for each of the display's frames
        """
        due, held = 0.0, False
        for shown in display.frames(world):
            if self.done == len(self):
                return
            held ^= paced and last_of(Pause, shown.commands) is not None
            due += 0.0 if held else shown.dt
            now = self.recorded[self.done]
            while paced and self.done + 1 < len(self) and due >= now.dt + self.recorded[self.done + 1].dt:
                world.step(replace(now, cameras=[]))  # more steps than pictures
                due -= now.dt
                self._after(world)
                now = self.recorded[self.done]
            if paced and due < now.dt:
                display.present(world)  # nothing new
                continue
            due -= now.dt
            yield replace(now, cameras=self._seen(now.cameras, shown.cameras))
            self._after(world)

    def _seen(self, recorded: list[Camera], shown: list[Camera]) -> list[Camera]:
        self._cameras = recorded or self._cameras
        if len(self._cameras) < len(shown):
            return shown
        pairs = zip(self._cameras, shown, strict=False)
        return [fitted(c, s.width, s.height, stretch=s.fx / s.fy) for c, s in pairs]

    def _after(self, world) -> None:
        """Compare the world after its step with the recorded state."""
        expected = self.states.get(self.done)
        self.done += 1
        if expected is None:
            return
        self.compared += 1
        there = np.array([b.centroid for b in world.bodies()]).reshape(-1, 3)
        if there.shape != expected.shape:
            self.largest = float("inf")
        elif len(there):
            away = float(np.linalg.norm(there - expected, axis=1).max())
            self.largest = max(self.largest, away if np.isfinite(away) else float("inf"))

    def report(self) -> str:
        """Summary of the replay, one line."""
        of = "" if self.done == len(self) else f" of {len(self)}"
        if not self.compared:
            return f"replayed {self.done}{of} frames"
        if self.largest == float("inf"):
            return f"replayed {self.done}{of} frames, not the same bodies"
        return f"replayed {self.done}{of} frames, largest difference {self.largest:.3g} m"
