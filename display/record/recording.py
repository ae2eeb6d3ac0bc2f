"""Recording of the user's input, frame by frame, as an HDF5 file that replays exactly (display/record/replay.py).

Root attributes: `format` "vrgs-recording", `version`, `about` (JSON: the scene, the options, where kernels ran), and
`layouts` (JSON: a list of the layouts of hands, see display/record/codec.py).

| dataset | shape, type | |
| --- | --- | --- |
| frames/dt, time, step | (F,) float64 | seconds; step 0: the whole dt at once |
| frames/hands, frames/cameras | (F,) int32 | number of each in a frame |
| hands/layout | (H,) int32 | of the hands of all frames, concatenated |
| hands/numbers | (N,) float64 | their values |
| cameras/values | (C, 22) float64 | width, height, fx, fy, cx, cy, world_to_camera row by row |
| commands/text | (B,) uint8 | JSON lines, each with its frame: {"frame": 12, "pause": true} |
| states/frame, states/count | (S,) int64, int32 | frame and number of bodies of each state, about every second |
| states/centroids | (M, 3) float64 | [m] |

It is written to FILE.part, appended once a second, and renamed at the end. The part of a session that ended abnormally
is a complete recording up to there: `--replay FILE.h5.part` plays it. A full disk ends it, and it gets its name.
"""

from __future__ import annotations

import dataclasses
import json
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import h5py
import numpy as np

from assets.file_access import check_writable, reason_of
from assets.growing_file import GrowingFile
from core.camera import Camera
from core.errors import BadInput
from display.protocol import Frame
from display.record.codec import from_text, pack_hand, to_text
from display.user_commands import Command

FORMAT, VERSION = "vrgs-recording", 3  # 1: bodies were not of their own material; 2: there was one body at most
OPTIONS = ("scene", "body", "stage", "material", "interaction", "embedding", "sort", "seed", "up", "scale", "vertices")
OPTIONS += ("cells", "pieces", "options", "detail", "state")  # of the command: they make the world what it is
WRITE_PERIOD = 1.0  # [s] between two states, and between two writings
CAMERA_SIZE = 22  # numbers of a camera
CHUNK = {"frames": 1024, "hands/layout": 2048, "hands/numbers": 32768, "cameras": 256, "commands": 4096, "states": 256}
DATASETS = {
    "frames/dt": ((), np.float64),
    "frames/time": ((), np.float64),
    "frames/step": ((), np.float64),
    "frames/hands": ((), np.int32),
    "frames/cameras": ((), np.int32),
    "hands/layout": ((), np.int32),
    "hands/numbers": ((), np.float64),
    "cameras/values": ((CAMERA_SIZE,), np.float64),
    "commands/text": ((), np.uint8),
    "states/frame": ((), np.int64),
    "states/count": ((), np.int32),
    "states/centroids": ((3,), np.float64),
}


class Recording:
    """`note` each frame before the world's step, `after` it; complete after `close`. Raises BadInput at once if the
    file cannot be written; if that happens later, a line says so, what was recorded is kept, and the play goes on."""

    def __init__(self, path: str | Path):
        self.path = Path(path)
        self.part = self.path.with_name(f"{self.path.name}.part")
        if self.part.exists():
            raise BadInput(f"{self.part} {why_it_is_there(self.part)}")
        check_writable(self.path)
        self.about: dict = {}
        self.frames = 0
        self._world, self._dt = None, 0.0  # of the last frame
        self._layouts: dict[str, int] = {}
        self._new: dict[str, list] = {name: [] for name in DATASETS}
        self._since = self._written = 0.0  # [s] of recorded time
        self._writer, self._closed = ThreadPoolExecutor(1), False
        self._kept = False  # whether a frame is in the file
        try:
            self._growing = GrowingFile(self.part)  # not if it is there: another session may begin at this moment
        except FileExistsError as e:
            raise BadInput(f"{self.part} {why_it_is_there(self.part)}") from e
        except OSError as e:
            raise BadInput(f"{self.path}: cannot be written ({reason_of(e)})") from e
        self._file = h5py.File(self._growing, "w")
        self._file.attrs["format"], self._file.attrs["version"] = FORMAT, VERSION
        for name, (shape, kind) in DATASETS.items():
            rows = next(n for prefix, n in CHUNK.items() if name.startswith(prefix))
            how = {"maxshape": (None, *shape), "chunks": (rows, *shape)}
            self._file.create_dataset(name, (0, *shape), kind, **how)
        try:
            self._commit()
        except OSError as e:
            self._end()
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
            layout, numbers = pack_hand(hand)
            text = json.dumps(layout)
            new["hands/layout"].append(self._layouts.setdefault(text, len(self._layouts)))
            new["hands/numbers"].extend(numbers)
        if frame.commands:
            self._record_commands(frame.commands)
        new["frames/cameras"].append(0)
        if not callable(frame.cameras):
            self._record_cameras(frame.cameras)
            return frame
        return dataclasses.replace(frame, cameras=lambda: self._record_cameras(frame.cameras()))

    def _record_commands(self, commands: Sequence[Command]) -> None:
        line = to_text(self.frames, commands)
        try:
            from_text(line)
        except BadInput as e:  # it would make the whole file invalid
            print(f"{self.path}: not recorded: {e}", file=sys.stderr)
            return
        self._new["commands/text"].extend(f"{line}\n".encode())

    def _record_cameras(self, cameras: list[Camera]) -> list[Camera]:
        self._new["frames/cameras"][-1] = len(cameras)
        self._new["cameras/values"].extend(numbers_of(c) for c in cameras)
        return cameras

    def after(self, world) -> None:
        """Record the state after the world's step of the frame noted last."""
        self.frames += 1
        self._world = world
        self._since += self._dt
        self._written += self._dt
        if self._since >= WRITE_PERIOD - 1e-6 or self.frames == 1:
            self._state(world)
        if self._written >= WRITE_PERIOD - 1e-6 or self.frames == 1:
            self._write()

    def _state(self, world) -> None:
        self._since = 0.0
        bodies = world.bodies()
        self._new["states/frame"].append(self.frames - 1)
        self._new["states/count"].append(len(bodies))
        self._new["states/centroids"].extend(np.asarray(b.centroid, np.float64) for b in bodies)

    def _write(self) -> None:
        """Pass new data to the writer thread: writing takes 10 ms, which would miss a frame."""
        self._written = 0.0
        texts = {"about": json.dumps(self.about), "layouts": f"[{', '.join(self._layouts)}]"}
        new, self._new = self._new, {name: [] for name in DATASETS}
        self._writer.submit(self._append, texts, new)

    def _append(self, texts: dict[str, str], new: dict[str, list]) -> None:
        """Append rows; the file is valid before and after."""
        if self._file is None:
            return
        for key, text in texts.items():
            self._file.attrs[key] = text
        for name, rows in new.items():
            if rows:
                data = self._file[name]
                data.resize(len(data) + len(rows), axis=0)
                data[-len(rows) :] = np.array(rows, DATASETS[name][1])
        try:
            self._commit()
            self._kept = self.frames > 0
        except OSError as e:
            what = "the recording ends here" if self._kept else "nothing is recorded"
            print(f"{self.path}: {what} ({reason_of(e)})", file=sys.stderr)
            self._end()

    def _commit(self) -> None:
        """Write all that was appended to the disk, or nothing. Raises OSError."""
        self._file.flush()
        self._growing.commit()

    def _end(self) -> None:
        """Close the file, and give it its name, or remove it if it holds no frame."""
        self._file.close()
        self._growing.close()
        self._file = None
        if self._kept:
            os.replace(self.part, self.path)
        else:
            self.part.unlink()

    def flush(self) -> None:
        """Wait until all data is written."""
        self._writer.submit(lambda: None).result()

    def close(self) -> None:
        """Write the rest, with the final state, and give the file its name. Further calls do nothing."""
        if self._closed:
            return
        self._closed = True
        self._finish()
        self._write()
        self._writer.shutdown()  # waits
        if self._file is not None:
            self._end()

    def _finish(self) -> None:
        """Record the last state; an incomplete frame is left out."""
        new = self._new
        if self._world is None:
            return
        if self._since > 0.0 or new["states/frame"][-1:] != [self.frames - 1]:
            self._state(self._world)


def why_it_is_there(part: Path) -> str:
    """The reason why there is a part already: the system locks a file that HDF5 writes."""
    try:
        h5py.File(part, "r", locking=True).close()
    except BlockingIOError:
        return "is being written by another session"
    except OSError:
        pass  # damaged: to be looked at by the user
    return "was left by an interrupted session: play it with --replay, or remove it"


def about_play(args, world_options: dict) -> dict:
    """The options of the command and of the world, and where kernels run, as JSON."""
    import taichi as ti

    given = {key: getattr(args, key, None) for key in OPTIONS}
    about = {key: value if value is None else plain(value) for key, value in given.items()}
    about["arch"] = "cuda" if ti.cfg.arch == ti.cuda else "cpu"
    about["world"] = {key: value for key, value in world_options.items() if isinstance(value, (bool, str))}
    return about


def plain(value):
    """An option as a JSON value."""
    if isinstance(value, dict):
        return {key: plain(v) for key, v in value.items()}
    if isinstance(value, list):
        return [plain(v) for v in value]
    return value if isinstance(value, (bool, int, float)) else str(value)


def numbers_of(camera: Camera) -> list[float]:
    """A camera as CAMERA_SIZE numbers."""
    c = camera
    return [c.width, c.height, c.fx, c.fy, c.cx, c.cy, *np.asarray(c.world_to_camera, np.float64).ravel().tolist()]
