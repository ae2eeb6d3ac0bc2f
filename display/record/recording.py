"""Recording of the user's input, frame by frame, in a file that replays exactly (display/record/replay.py)."""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from assets.file_access import check_writable, reason_of
from core.camera import Camera
from core.errors import BadInput
from core.runtime import running_arch
from core.vocabulary import Hand
from display.protocol import Frame
from display.record.recording_file import DATASETS, OPTIONS, Journal, is_locked, write_recording
from display.user_commands import Command, commands_from_text, commands_to_text

WRITE_PERIOD = 1.0  # [s] between two states, and between two blocks of the journal


class Recording:
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
            why = "is being written by another session" if is_locked(self.part) else why
            raise BadInput(f"{self.part} {why}") from e
        except OSError as e:
            raise BadInput(f"{self.path}: cannot be written ({reason_of(e)})") from e

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *error) -> None:
        self.close()

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
        return dataclasses.replace(frame, cameras=lambda: self._record_cameras(frame.cameras()))

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
                write_recording(self.path, self.part)
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
