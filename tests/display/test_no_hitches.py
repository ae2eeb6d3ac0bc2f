"""Nothing is compiled in the midst of play: not by the first grip, throw, touch, look, change or size of picture."""

from dataclasses import replace
from io import StringIO

import numpy as np
import pytest

from core.camera import look_at, perspective
from core.vocabulary import Hand, Touch
from display import user_commands as cmd
from display.protocol import Frame
from display.timing import FIRST_START, start_progress
from scenes import ring_toss
from tests.support.compiling import compiled

YELLOW = 1
TURN = (0.99, 0.0, 0.14, 0.0)


class Play:
    """The ring toss in small pictures, for a headset or in a window."""

    def __init__(self, *, headset: bool):
        from display.world import World
        from display.xr import avatar

        self.frames, self.size, self.views = 0, (96, 64), 1 + headset
        scene = ring_toss.build()
        self.scene = replace(scene, bodies=scene.bodies[1:])  # without the room, for speed
        how = {"fingers": True, "props": avatar.skins()} if headset else {}
        self.world = World(self.scene, width=self.size[0], height=self.size[1], views=self.views, **how)
        self.parts = avatar.hidden() if headset else None

    def frame(self, *given):
        hands, commands = ([g for g in given if isinstance(g, Hand) == k] for k in (True, False))
        self.frames += 1
        view = look_at(np.add(self.scene.eye, [0.001 * self.frames, 0, 0]), self.scene.target)
        cameras = [perspective(*self.size, 0.9, view)] * self.views
        if self.parts is not None:
            self.parts[:] = np.nan
            self.parts[52] = np.column_stack([np.eye(3), hands[0].position if hands else np.zeros(3)])
        self.world.step(Frame(1 / 60, self.frames / 60, cameras, hands, commands, prop_poses=self.parts))
        self.world.hand_forces(), self.world.touch_forces(), self.world.stats()

    def rim(self):
        """A place on the yellow ring, (3,) [m]."""
        return self.world.bodies()[YELLOW].centroid + [0.0, 0.0, ring_toss.RING_RADIUS]

    def throw(self):
        at = self.rim()
        self.frame(Hand(tuple(at)), Hand())
        for k in range(4):
            self.frame(Hand(tuple(at + [0, 0.03 * k, -0.02 * k]), grip=True, reach=0.05), Hand())
            assert self.world.bodies()[YELLOW].held
        self.frame(Hand(tuple(at + [0, 0.12, -0.08])), Hand())
        assert not self.world.bodies()[YELLOW].held

    def touch(self):
        at = self.rim()
        for k in range(3):
            tip = at + [0.0, 0.06 - 0.02 * k, 0.0]
            self.frame(Hand(tuple(tip), touch=(Touch(tuple(tip), tuple(tip + [0, 0.05, 0]), 0.009),)))

    def stretch(self):
        """Two hands draw it out in transform mode, and let go."""
        self.frame(cmd.SetInteraction("transform"))
        at = self.rim()
        for k in range(4):
            other = at + [0.03 * k, 0.0, -2 * ring_toss.RING_RADIUS - 0.02 * k]
            self.frame(*(Hand(tuple(p), grip=k > 0, reach=0.05) for p in (at, other)))
        self.frame(Hand(tuple(at)), Hand())
        self.frame(cmd.SetInteraction("physics"))

    def resize(self, width: int, height: int):
        self.size = width, height
        self.world.resize(width, height)
        self.frame()


@pytest.fixture(scope="module", params=[pytest.param(False, marks=pytest.mark.long), True])
def play(request, ti_cpu) -> Play:
    """In a window, and in a headset; warmed up."""
    play = Play(headset=request.param)
    play.world.warm_up()
    return play


def test_nothing_is_compiled_in_the_midst_of_play(play):
    with compiled() as names:
        play.frame()
        play.throw()
        play.touch()
        for commands in ([cmd.Undo()], [cmd.Redo()], [cmd.Select(YELLOW)], [cmd.Rotate(None, TURN)]):
            play.frame(*commands)
        play.frame(cmd.Duplicate(None))
        assert len(play.world.bodies()) == 4
        for commands in ([cmd.Rescale(None, 0.8)], [cmd.SetMaterial(0, "plush")], [cmd.Undo()], [cmd.Remove(0)]):
            play.frame(*commands)
        for commands in ([cmd.SetMaterial(0, "clay")], [cmd.Duplicate(None)], [cmd.Undo()]):
            play.frame(*commands)
        play.frame(cmd.SetMaterial(0, "wood"))
        assert play.world.stats()["integrator"] == "vbd"
        play.frame(cmd.SetLight(play.scene.light), cmd.SetGravity((0.0, -1.6, 0.0)), cmd.SetTimeScale(0.5))
        play.frame(cmd.Place(0, (0.0, 0.1, 0.0)), cmd.SetGravity(play.scene.gravity), cmd.SetTimeScale(1.0))
        play.frame(cmd.Pause(True))
        play.frame(cmd.Pause(False), cmd.Reset())
        assert play.world.stats()["integrator"] == "xpbd"
        play.stretch()
        play.world.pick(play.scene.eye, np.subtract(play.scene.target, play.scene.eye))
        play.resize(48, 32)
        play.resize(96, 64)
        play.frame(cmd.PlayDemo(True))
        play.frame()
    assert names == []


def test_a_warm_up_leaves_the_scene_at_its_start(play):
    """Recordings do not say whether kernels were warm: bodies, picture, and the frames that follow are the same."""
    world, seen = play.world, []
    for start in (world.reset, world.warm_up):
        start()
        assert world.time == 0.0 and world.score == 0
        first, means = world.device.solver.snapshot(), world.device.splats.mean.to_numpy()
        for _ in range(4):
            play.frame()
        last = world.device.solver.snapshot()
        seen.append([means, *(s[name] for s in (first, last) for name in ("x", "x_lo", "v", "v_lo", "untangling"))])
    for a, b in zip(*seen, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_start_says_how_long_it_prepares(ti_cpu, monkeypatch):
    """On the display, and in a log a line now and then; after the start kernels are nobody's concern."""
    ti, clock, log, shown = ti_cpu, iter(np.arange(100.0)), StringIO(), []
    monkeypatch.setattr("display.timing.perf_counter", lambda: next(clock))

    def compile_some(count: int):
        for k in range(count):
            field = ti.field(ti.f32, 3)
            field.fill(float(k))

    with start_progress(shown.append, log):
        compile_some(7)
    compile_some(1)
    assert shown == [f"Preparing, {k} s ({FIRST_START})" for k in range(1, 8)]
    assert log.getvalue() == shown[4] + "\n"
