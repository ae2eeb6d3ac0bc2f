"""`vrgs.py bench hitches`: the worst frame of each thing that one does in play, in every scene, and what took its time.

Frames of 1/90 s as a headset's (`StereoPlay`), warmed up as before play, but without OpenGL. Each act is done by hands
and commands; the first frames of the play, at rest, are an act of their own. With cold caches the numbers are those of
a fresh machine: set TI_OFFLINE_CACHE_FILE_PATH to an empty folder.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np
import taichi as ti

from bench.frame_time import StereoPlay
from core.runtime import watch_compilation
from core.vocabulary import Hand, Touch
from display import user_commands as cmd
from display.keep.scene_state import state_of
from display.keep.state_file import write_state
from display.world import World
from display.xr import wrist_panel as wrist
from scenes import registry

REST = 20  # frames before the first act, and after each: what it set going goes on
MOTION = 15  # frames in which a hand moves
REACH = 0.6  # of a body's largest side, for a hand in its middle
CAPSULE = 0.009  # [m] radius of a finger
ADDED = "toy_duck"  # the body that is added, before a copy takes its place
GOAL = 50.0  # [ms] of no frame on a GPU

Act = tuple  # a frame: its hands, then commands, or functions that are called before it and may return commands
PANEL = ("Transform", "Physics", "Pause", "Pause", "Turn", "Watch", "Watch")  # buttons of the panel, pressed in turn
MENU = (wrist.SCENES, wrist.BACK)


def run(*, names: list[str], size: tuple[int, int]) -> Iterator[dict]:
    """Do everything in these scenes, or in all; prints and yields a row for each act. Raises BadInput."""
    print(f"{'scene':22} {'act':10} {'frames':>6} {'worst ms':>9}  in which")
    for name in names or [*registry.names(), *registry.rooms()]:
        play = StereoPlay(registry.load(name), size, reserve=[ADDED])
        with TemporaryDirectory() as folder:
            for act, frames in acts(play, name, Path(folder) / "hitches.state.h5"):
                row = {"bench": "hitches", "scene": name, "act": act, **measured(play, frames)}
                row["arch"] = str(ti.cfg.arch).removeprefix("Arch.")
                print(line(row), flush=True)
                yield row
        play.close()


def measured(play: StereoPlay, frames: Iterable[Act]) -> dict:
    """The worst of these frames [ms], its stages [ms], and the kernels that were compiled in all of them."""
    worst, kernels, count, timings = {"worst_ms": 0.0, "stages": {}}, [], 0, play.world.timings
    with watch_compilation(kernels.append):
        for hands, *given in frames:
            begin = perf_counter()
            timings.frame()
            commands = [g for g in given if isinstance(g, cmd.Command)]
            for change in (g for g in given if not isinstance(g, cmd.Command)):
                with timings.stage("commands"):
                    commands += change() or []
            play.frame(ti.sync, hands, commands)
            took, count = 1e3 * (perf_counter() - begin), count + 1
            if took > worst["worst_ms"]:
                worst = {"worst_ms": took, "stages": {stage: 1e3 * t for stage, t in timings.in_frame.items()}}
    return {"frames": count, **worst, "kernels": kernels}


def line(row: dict) -> str:
    """A row of the table."""
    stages = sorted(row["stages"].items(), key=lambda s: -s[1])[:2]
    cause = ", ".join(f"{stage} {ms:.1f}" for stage, ms in stages)
    compiled = f", compiled: {', '.join(row['kernels'])}" if row["kernels"] else ""
    late = "  over 50 ms" if row["worst_ms"] > GOAL else ""
    return f"{row['scene']:22} {row['act']:10} {row['frames']:6} {row['worst_ms']:9.1f}  {cause}{compiled}{late}"


def acts(play: StereoPlay, name: str, path: Path) -> Iterator[tuple[str, Iterable[Act]]]:
    """Each act's name, and its frames, in the scene of this name; `path` is where the state is saved."""
    world = play.world
    yield "rest", still(REST)
    if world.bodies():
        yield "touch", touching(play)
        yield "grasp", grasping(play)
        yield "scale", scaling(play)
        yield "resize", still(REST, cmd.Rescale(0, 0.9))
        yield "material", still(REST, cmd.SetMaterial(0, "rubber"))
        yield "add", joining(world)
        yield "copy", still(REST, cmd.Duplicate(0))
        yield "undo", still(REST, cmd.Undo())
        yield "save", still(REST, lambda: write_state(path, state_of(world, {"scene": name})))
        yield "load", still(REST, cmd.LoadState(str(path)))
    yield "panel", panelled(play, PANEL)
    yield "menu", panelled(play, MENU)
    if world.light is not None:
        x, y, z = world.light.position
        yield "light", still(REST, cmd.SetLight(replace(world.light, position=(x + 0.2, y, z))))
    yield "reset", still(REST, cmd.Reset())


def still(frames: int, *given) -> Iterable[Act]:
    """Frames with open hands, the commands in the first."""
    return [([Hand(), Hand()], *given), *[([Hand(), Hand()],)] * (frames - 1)]


def joining(world: World) -> Iterator[Act]:
    """A body is read on a thread, as a play does it, and joins; the frames wait, as a headset's do."""
    with ThreadPoolExecutor(1) as reader:
        body = reader.submit(world.editor.prepared, ADDED, ADDED)
        while wait([body], 1 / 90).not_done:
            yield ([Hand(), Hand()],)
    yield from still(REST, lambda: world.editor.add(body.result()))


def panelled(play: StereoPlay, buttons: Iterable[str]) -> Iterator[Act]:
    """The panel over the left hand, painted as a headset shows it, and the window's laid out; the right hand points at
    these buttons and presses them."""
    panel, shown, head = wrist.WristPanel(), wrist.PanelContent(), np.linalg.inv(play.eyes(0)[0].world_to_camera)
    wrist.paint(shown)  # as before play

    def look(button: str = "") -> list[cmd.Command]:
        nonlocal shown
        left, right = play.controllers(0)
        left.pressed = set() if panel.pinned else {"lower"}
        if button:
            x, y, width, height = wrist.pages()[panel.page][button]
            right.aim, right.grab = panel.pose.copy(), 1.0
            pixels = np.array([x + width / 2 - wrist.PIXELS[0] / 2, wrist.PIXELS[1] / 2 - y - height / 2])
            right.aim[:3, 3] += right.aim[:3, :3] @ [*pixels * wrist.PANEL_WIDTH / wrist.PIXELS[0], 0.1]
        commands = panel.advance([left, right], head, np.eye(4), play.world)[1]
        assert not button or panel.clicked
        content = replace(wrist.PanelContent.of(play.world, panel), rate="")
        if content != shown:
            shown = content
            wrist.paint(content)
        panel.described.read(play.world)
        panel.described.sections(play.world)
        return commands

    for button in buttons:
        yield [Hand(), Hand()], look
        yield [Hand(), Hand()], partial(look, button)
    yield from still(REST, look)


def touching(play: StereoPlay) -> Iterator[Act]:
    """A finger comes down on the first body, and goes on into it."""
    body = play.world.bodies()[0]
    top = np.array([body.centroid[0], body.high[1], body.centroid[2]])
    for k in range(MOTION):
        tip = top + [0.0, 0.05 * (1 - 1.5 * k / MOTION), 0.0]
        finger = Touch(tuple(tip), tuple(tip + [0.0, 0.05, 0.0]), CAPSULE)
        yield ([Hand(tuple(tip + [0.0, 0.1, 0.0]), touch=(finger,)), Hand()],)
    yield from still(REST)


def grasping(play: StereoPlay) -> Iterator[Act]:
    """A hand takes the first body, lifts it, and throws it."""
    body = play.world.bodies()[0]
    at, reach = body.centroid, REACH * float((body.high - body.low).max())
    yield ([Hand(tuple(at)), Hand()],)
    for k in range(2 * MOTION):
        at = at + [0.0, 0.01, 0.0] if k < MOTION else at + [0.01, 0.02, 0.0]
        yield ([Hand(tuple(at), grip=True, reach=reach), Hand()],)
    yield from still(REST)


def scaling(play: StereoPlay) -> Iterator[Act]:
    """Two hands draw the first body larger, and let go."""
    body = play.world.bodies()[0]
    apart = np.array([0.5 * (body.high - body.low)[0], 0.0, 0.0])
    yield [Hand(), Hand()], cmd.SetInteraction("transform")
    for k in range(MOTION):
        ends = (body.centroid + side * (1 + 0.02 * k) * apart for side in (-1, 1))
        yield ([Hand(tuple(p), grip=k > 0, reach=2 * float(apart[0])) for p in ends],)
    yield from still(2)
    yield from still(REST, cmd.SetInteraction("physics"))
