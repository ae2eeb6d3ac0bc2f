"""Growth of memory in hours of random play, measured by its rate: `python -m tests.soak.endurance --minutes 40`.

A player without a plan grabs, drags and throws bodies, copies, turns, scales and removes them, changes materials and
light, undoes and redoes, resets, pauses, starts demonstrations, and resizes the picture. Every few seconds the
process's memory is noted; once the undo stack is full, a line is fitted to it. What grows without bound has a slope;
what is filled once (kernels, undo stack, the allocator's reserves) has none, and is left out with the first third.
"""

from __future__ import annotations

import argparse
import gc
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from core.camera import look_at, perspective
from core.errors import BadInput
from core.vocabulary import Hand, Light
from display import user_commands
from display.protocol import Frame
from display.user_commands import Command

if TYPE_CHECKING:
    from display.world import World

DT = 1 / 60  # [s]
SIZES = ((96, 54), (128, 72), (160, 90), (64, 64), (54, 96))  # [px] of the picture
RESIZE_FRAMES = 240  # mean number of frames between two sizes
COMMANDS_PER_FRAME = 0.08
NOTE_SECONDS = 5.0  # between two notes
WARM_UP = 1 / 3  # of the notes: they are not fitted
BLOCKS = 8  # whose means are fitted: notes that follow one another are not independent
HOURS = 8.0  # of which the summary speaks
RISE_MAX = 100.0  # [MB] in HOURS, and beyond doubt (two standard errors), that fail the run


class RandomPlayer:
    """Hands and commands of each frame, from a seed."""

    def __init__(self, seed: int):
        self.rng = np.random.default_rng(seed)
        self._left = 0  # frames of the gesture
        self._at, self._step = np.zeros(3), np.zeros(3)

    def hands(self, world) -> list[Hand]:
        """A hand that takes a body, drags it along and lets it go in motion; then another body."""
        rng, bodies = self.rng, world.bodies()
        if self._left <= -20 and bodies:
            self._at = np.asarray(bodies[rng.integers(len(bodies))].centroid, np.float64)
            self._step = rng.normal(0, 0.01, 3) + [0, 0.004, 0]
            self._left = int(rng.integers(10, 90))
        self._left -= 1
        self._at = self._at + self._step
        if rng.random() < 0.05:
            self._step = rng.normal(0, 0.015, 3)
        return [Hand(tuple(self._at.tolist()), grip=self._left > 0, reach=0.08)]

    def commands(self, world) -> list[Command]:
        """Mostly none; else one of all that there are."""
        rng = self.rng
        if rng.random() > COMMANDS_PER_FRAME:
            return []
        if world.paused or world.demo:  # rarely for long
            ends = (user_commands.Pause(False), user_commands.SingleStep(), user_commands.PlayDemo(False))
            return [ends[rng.integers(len(ends))]]
        return [self._command(world)]

    def _command(self, world) -> Command:
        rng, count = self.rng, len(world.bodies())
        body = int(rng.integers(count)) if count else None
        turn = rng.normal(size=4)
        choices: list[tuple[float, Callable[[], Command]]] = [
            (4, lambda: user_commands.Duplicate(body)),
            (3 if count > 3 else 0.2, lambda: user_commands.Remove(body)),
            (4, lambda: user_commands.Rescale(body, float(np.exp(rng.normal(0, 0.3))))),
            (3, lambda: user_commands.Rotate(body, tuple((turn / np.linalg.norm(turn)).tolist()))),
            (4, lambda: user_commands.SetMaterial(body, str(rng.choice(["plush", "rubber", "foam", "jelly"])))),
            (5, user_commands.Undo),
            (3, user_commands.Redo),
            (1, lambda: user_commands.Select(body)),
            (1, lambda: user_commands.SetInteraction(str(rng.choice(["physics", "transform"])))),
            (1, lambda: user_commands.SetLight(self._light())),
            (1, user_commands.Reset),
            (0.5, lambda: user_commands.PlayDemo(True)),
            (0.5, lambda: user_commands.Pause(True)),
        ]
        weights = np.array([weight for weight, _ in choices])
        return choices[rng.choice(len(choices), p=weights / weights.sum())][1]()

    def _light(self) -> Light:
        x, z = self.rng.uniform(-2, 2, 2)
        return Light(position=(float(x), 3.0, float(z)), target=(0.0, 0.8, 0.0))


@dataclass
class Note:
    """Memory at a time [s] after `frames` frames: resident, held by the undo stack [MB = 1e6 bytes], Python objects."""

    seconds: float
    frames: int
    resident: float
    undo: float
    objects: int


def resident_mb() -> float:
    """Resident memory of this process [MB]; Linux only. Raises BadInput elsewhere."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6
    except OSError as e:
        raise BadInput("tests.soak.endurance reads the memory of a process from /proc, which only Linux has") from e


def play(
    make: Callable[[], World],
    player: RandomPlayer,
    seconds: float,
    note: Callable[[Note], None],
    switch: float = np.inf,
) -> int:
    """Play for some seconds of wall time; returns the number of frames. Raises BadInput if a body is not finite.

    make    makes the world
    switch  [s] after which it is made anew, as when the user opens another scene
    """
    from core.runtime import end_taichi

    world, size, frames, begin, noted, time = make(), SIZES[0], 0, perf_counter(), 0.0, 0.0
    world.resize(*size)
    due = switch
    while (now := perf_counter() - begin) < seconds:
        if now >= due:
            due, size = now + switch, SIZES[0]
            world.close()
            del world
            end_taichi()
            world = make()
        if player.rng.random() < 1 / RESIZE_FRAMES:
            size = SIZES[player.rng.integers(len(SIZES))]
            world.resize(*size)
        eye = np.asarray(world.scene.eye) + player.rng.normal(0, 0.02, 3)
        camera = perspective(*size, world.scene.fov_y, look_at(eye, world.scene.target))
        hands = world.scripted_hands(time) if world.demo else player.hands(world)
        time += DT
        world.step(Frame(DT, time, [camera], hands, player.commands(world)))
        frames += 1
        if now - noted >= NOTE_SECONDS:
            noted = now
            if not world.stats()["finite"]:
                raise BadInput(f"a body is not finite after {frames} frames")
            gc.collect()
            note(Note(now, frames, resident_mb(), world.editor.history.bytes / 1e6, len(gc.get_objects())))
    return frames


def fitted_rise(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Slope of a line through the means of BLOCKS blocks, and its standard error."""
    xs, ys = (np.array([part.mean() for part in np.array_split(v, BLOCKS)]) for v in (x, y))
    slope, offset = np.polyfit(xs, ys, 1)
    left = ys - (slope * xs + offset)
    return float(slope), float(np.sqrt((left**2).sum() / (BLOCKS - 2) / ((xs - xs.mean()) ** 2).sum()))


def summary(notes: list[Note]) -> tuple[float, float]:
    """Rate of growth [MB/h] after the warm-up and its standard error, printed too. Raises BadInput if too short."""
    kept = notes[round(WARM_UP * len(notes)) :]
    if len(kept) < 2 * BLOCKS:
        raise BadInput(f"{len(notes)} notes of memory are too few to fit a rate: play for some minutes")
    hours = np.array([n.seconds for n in kept]) / 3600
    rate, error = fitted_rise(hours, np.array([n.resident for n in kept]))
    objects, objects_error = fitted_rise(hours, np.array([float(n.objects) for n in kept]))
    print(
        f"{rate:.1f} ± {error:.1f} MB/h over {hours[-1] - hours[0]:.2f} h, "
        f"{HOURS * rate:.0f} MB in {HOURS:.0f} h; {objects:.0f} ± {objects_error:.0f} Python objects/h"
    )
    return rate, error


def main() -> int:
    """Run the command line; exit status 1 if memory grows beyond doubt by more than RISE_MAX in HOURS."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--scene", default="ring_toss", metavar="NAME")
    p.add_argument("--body", metavar="ASSET", help="for scenes that take one: ball is quick")
    p.add_argument("--switch", type=float, default=np.inf, metavar="S", help="open the scene anew every S seconds")
    p.add_argument("--minutes", type=float, default=40.0, help="of wall time (default 40)")
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--arch", choices=("cuda", "cpu"))
    args = p.parse_args()
    from core.runtime import start_taichi
    from scenes import registry

    try:
        notes, player = [], RandomPlayer(args.seed)

        def make() -> World:
            start_taichi(args.arch, args.seed)
            from display.world import World

            world = World(registry.load(args.scene, body=args.body), width=SIZES[0][0], height=SIZES[0][1])
            world.warm_up()
            return world

        def note(n: Note) -> None:
            notes.append(n)
            print(
                f"{n.seconds:7.0f} s {n.frames:8d} frames: {n.resident:8.1f} MB resident, {n.undo:6.1f} MB to undo, "
                f"{n.objects} objects",
                flush=True,
            )

        play(make, player, 60 * args.minutes, note, args.switch)
        rate, error = summary(notes)
    except BadInput as e:
        print(f"vrgs: {e}", file=sys.stderr)
        return 2
    return int(HOURS * (rate - 2 * error) > RISE_MAX)


if __name__ == "__main__":
    sys.exit(main())
