"""Nothing is compiled in the midst of play: not by the first grip, throw, touch, look, change or size of picture."""

from dataclasses import replace
from types import SimpleNamespace as N

import numpy as np
import pytest

from core.camera import look_at, perspective
from core.material import Material
from display.edit.editor import COMPILING_NOTICE, Editor
from display.protocol import (
    Duplicate,
    Frame,
    Pause,
    PlayDemo,
    Redo,
    Remove,
    Rescale,
    Reset,
    Rotate,
    Select,
    SetInteraction,
    SetLight,
    SetMaterial,
    Undo,
)
from scenes import ring_toss
from scenes.scene import Hand, Touch
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
        how = {"fingers": True, "grown": True, "props": avatar.skins()} if headset else {}
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
        self.frame(SetInteraction("transform"))
        at = self.rim()
        for k in range(4):
            other = at + [0.03 * k, 0.0, -2 * ring_toss.RING_RADIUS - 0.02 * k]
            self.frame(*(Hand(tuple(p), grip=k > 0, reach=0.05) for p in (at, other)))
        self.frame(Hand(tuple(at)), Hand())
        self.frame(SetInteraction("physics"))

    def resize(self, width: int, height: int):
        self.size = width, height
        self.world.resize(width, height)
        self.frame()


def unchanged(world, before: dict, means: np.ndarray) -> None:
    """Bodies and what is seen of them are as they were."""
    after = world.device.solver.snapshot()
    for name in ("x", "x_lo", "v", "v_lo", "untangling"):
        np.testing.assert_array_equal(before[name], after[name])
    world.refresh()
    np.testing.assert_array_equal(world.device.splats.mean.to_numpy(), means)


@pytest.mark.parametrize("headset", [pytest.param(False, marks=pytest.mark.long), True])
def test_nothing_is_compiled_in_the_midst_of_play(ti_cpu, headset):
    play = Play(headset=headset)
    before, means = play.world.device.solver.snapshot(), play.world.device.splats.mean.to_numpy()
    play.world.warm_up()
    unchanged(play.world, before, means)
    play.frame()
    with compiled() as names:
        play.throw()
        play.touch()
        for commands in ([Undo()], [Redo()], [Select(YELLOW)], [Rotate(None, TURN)]):
            play.frame(*commands)
        if headset:  # in a window the first copy, or a body of another size, makes room, which is said
            play.frame(Duplicate(None))
            assert len(play.world.bodies()) == 4
            play.frame(Rescale(None, 0.8))
        for commands in ([SetMaterial(0, "plush")], [Undo()], [Remove(0)]):
            play.frame(*commands)
        play.frame(SetLight(play.scene.light))
        play.frame(Pause(True))
        play.frame(Pause(False), Reset())
        if headset:
            play.stretch()
        play.world.pick(play.scene.eye, np.subtract(play.scene.target, play.scene.eye))
        play.resize(48, 32)
        play.resize(96, 64)
        play.frame(PlayDemo(True))
        play.frame()
    assert names == []


def test_a_stiffer_solver_is_announced_in_a_picture_before_it_is_made():
    """One frame stands still, with a notice, after the edit that needs other kernels."""
    solver = N(needs_compilation=False)
    registry = N(device=N(solver=solver), members=(None,))
    registry.set_material = lambda k, material: setattr(solver, "needs_compilation", material == Material.named("wood"))
    world = N(refresh=lambda: None, restore=lambda snapshot: None, light=None)
    world.snapshot = lambda: N(bodies=N(solver={"bodies": ()}))
    editor = Editor(world, registry)

    def frame(*commands):
        editor.begin_frame()
        editor.apply(commands)
        return editor.holding, editor.notice == COMPILING_NOTICE

    assert frame() == (False, False)
    assert frame(SetMaterial(0, "plush")) == (False, False)
    assert frame(SetMaterial(0, "wood")) == (True, True)
    assert frame() == (False, True)
    solver.needs_compilation = False
    assert frame(Undo()) == (False, False)
