"""Demos that are saved in the middle and go on in another program, exactly."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from display.keep.scene_state import state_of
from display.keep.state_file import read_state, write_state
from display.protocol import Frame
from display.user_commands import SaveState
from scenes import registry

ROOT = Path(__file__).resolve().parents[2]
DT = 1 / 60
SECOND_HALF = 20  # frames
FIRST_HALVES = {  # frames after which a hand holds something, or a body dances, or bricks are falling
    "ring_toss": 70,
    "table_brick_game": 100,
    "just_dance": 90,
    "animal_crossing": 40,
}


@pytest.mark.long
@pytest.mark.parametrize("name", FIRST_HALVES)
def test_a_demo_goes_on_in_another_program_bit_for_bit(ti_cpu, tmp_path, name):
    from display.world import World

    world, first = World(registry.load(name), width=32, height=18), FIRST_HALVES[name]
    for k in range(1, first + SECOND_HALF + 1):
        commands = [SaveState()] if k == first else []
        world.step(Frame(DT, k * DT, [], world.scripted_hands(k * DT), commands))
        if k == first:
            write_state(tmp_path / "state.h5", state_of(world, {"scene": name}))
    words = ["--headless", "--state", "state.h5", "--frames", str(SECOND_HALF), "--save-state", "end.h5"]
    command = [sys.executable, str(ROOT / "vrgs.py"), *words, "--arch", "cpu", "--size", "32x18"]
    subprocess.run(command, cwd=tmp_path, check=True)
    expected, there = state_of(world, {"scene": name}), read_state(tmp_path / "end.h5")
    np.testing.assert_array_equal(there.motion, expected.motion)
    assert [b.asleep for b in there.bodies] == [b.asleep for b in expected.bodies]
    assert there.settings.time == expected.settings.time and there.settings.game == expected.settings.game
