"""Replay of a recording (display/record/recording.py), with the deviation from the recorded state."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from assets.library import animated_height
from core.camera import Camera, fitted
from core.material import ANIMATED_MATERIAL
from core.typed import field_types
from display.protocol import Frame
from display.record.recording_file import (
    FORMAT,
    VERSION,
    WorldOptions,
    checked_about,
    open_recording,
    read_frames,
    read_states,
)
from display.user_commands import Pause, last_of


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
        with open_recording(path) as file:
            version = file.check_format(FORMAT, "a recording", VERSION)
            about = checked_about(file.text("", "about"), str(path))
            frames = read_frames(file)
            return cls(path, version, about, frames, read_states(file, len(frames)))

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
