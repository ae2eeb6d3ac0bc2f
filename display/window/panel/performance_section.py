"""The panel's section of performance: resolution, stages of a frame, frames, counts."""

from __future__ import annotations

from time import perf_counter

from display.protocol import WorldView
from display.timing import Timings
from display.user_commands import Command
from display.window.panel.section import Section
from display.window.panel.theme import QUIET
from display.window.panel.widgets import choice, table_row

READ_INTERVAL = 0.5  # [s] between two readings of the numbers: faster ones cannot be read
RESOLUTIONS = {"Auto": None, "Full": 1.0, "3/4": 0.75, "1/2": 0.5}  # scale of a side of the picture


class PerformanceSection(Section):
    """Timings, and the choice of the picture's resolution.

    `resolution` is the scale of a side of the picture that the user has chosen, None: what keeps the rate
    (display/adaptive_resolution.py). `fps` is the rate of the last reading.
    """

    title = "Performance"
    open = False

    def __init__(self):
        self.resolution: float | None = None
        self.fps = 0.0
        self._read = -READ_INTERVAL
        self._stages, self._stats = [], {}
        self._frame_lines: list[str] = []

    def read(self, world: WorldView) -> None:
        """Take the numbers anew if the last ones could be read."""
        now = perf_counter()
        if now - self._read >= READ_INTERVAL:
            self._read = now
            self.fps, self._stages, self._stats = world.timings.recent_fps(), world.timings.recent(), world.stats()
            self._frame_lines = frame_lines(world.timings)

    def draw(self, world: WorldView) -> list[Command]:
        """Draw the choice and the numbers; no commands."""
        from imgui_bundle import imgui

        current = next(name for name, scale in RESOLUTIONS.items() if scale == self.resolution)
        tips = dict.fromkeys(RESOLUTIONS, "Size of the drawn picture, on each side: fewer pixels are faster.")
        tips["Auto"] = "Fewer pixels while things move, if that is slow; all of them once they are still."
        self.resolution = RESOLUTIONS[choice(list(RESOLUTIONS), current, tips)]
        if imgui.begin_table("stages", 3, imgui.TableFlags_.sizing_stretch_prop):
            table_row("ms", "median", "worst", colour=QUIET)
            for name, median, worst in self._stages:
                table_row(name, f"{median:.2f}", f"{worst:.2f}")
            imgui.end_table()
        for line in self._frame_lines:
            imgui.text_colored(QUIET, line)
        counts = count_texts(self._stats)
        for first in range(0, len(counts), 2):
            imgui.text_colored(QUIET, ", ".join(counts[first : first + 2]))
        return []


def frame_lines(timings: Timings) -> list[str]:
    """Lines about the frames: the longest, missed ones, time not simulated, and from the head's motion to light."""
    lines = [f"longest frame {1e3 * timings.worst:.0f} ms, {timings.missed:,} missed"]
    if timings.to_light is not None:
        lines.append(f"from motion to light {1e3 * timings.to_light:.0f} ms")
    if timings.dropped >= 0.1:
        lines.append(f"{timings.dropped:.1f} s left out: too slow for real time")
    return lines


def count_texts(stats: dict) -> list[str]:
    """Counts of a world as they are shown: "12,345 gaussians"."""
    return [f"{stats[name]:,} {name}" for name in ("gaussians", "vertices", "tets", "substeps") if name in stats]
