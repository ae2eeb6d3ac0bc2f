"""Box moving: boxes are carried to the pallet one after the other, and the mouse hole behind them becomes free."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from core.vocabulary import Box
from display.user_commands import Reset
from scenes import registry
from scenes.box_moving import FAR, HOLE, PALLET, SIZES, TURN, BoxMoving, before_hole, boxes
from tests.support.scripted_play import blind_world, frames


@pytest.fixture(scope="module")
def world(ti_cpu):
    return blind_world(registry.load("box_moving"))


def play(world, seconds: float) -> tuple[list[int], bool]:
    """Scores of all frames of the script's first seconds, and whether the hole came free as the big box moved."""
    world.apply([Reset()])
    game, scores, found = world.scene.game, [0], False
    for _ in frames(world, seconds):
        scores.append(game.score)
        big = world.bodies()[-1]
        if not found and not big.held:
            assert_allclose(big.centroid, boxes()[-1].position, atol=2e-3)
        if game.found and not found:
            found = True
            assert big.held and "mouse" in game.message
    assert np.all(np.diff(scores) >= 0)
    low = [b.low[1] - PALLET[1][1] for k, b in enumerate(world.bodies()) if k in game.placed]
    assert_allclose(low, 0.0, atol=2e-3)  # they stand on it
    assert world.stats()["finite"]
    return scores, found


def test_the_script_moves_the_first_box_and_leaves_the_others_where_they_are(world):
    scores, found = play(world, TURN)
    assert set(scores) == {0, 1} and not found
    others = [k for k in range(len(boxes())) if k not in world.scene.game.placed]
    for k in others:
        assert_allclose(world.bodies()[k].centroid, boxes()[k].position, atol=2e-3)


@pytest.mark.long
def test_the_script_moves_all_boxes_and_the_big_one_hid_the_hole(world):
    """The score grows by one box after the other."""
    scores, found = play(world, world.scene.game.duration)
    world.scene.game.verify(world.bodies())
    assert set(scores) == {0, 1, 2, 3, 4} and found
    assert not any(before_hole(b) for b in world.bodies()) and world.stats()["asleep"] >= 3


def test_the_boxes_stand_apart_before_the_hole_and_the_pallet_is_free():
    """At the start no two boxes and nothing static cut into each other, and the big one covers the whole hole."""
    sizes = [np.array(SIZES[b.asset]) for b in boxes()]
    at = [np.array(b.position) for b in boxes()]
    for i in range(len(at)):
        for j in range(i):
            assert np.max(np.abs(at[i] - at[j]) - 0.5 * (sizes[i] + sizes[j])) > -1e-6
        for c in registry.load("box_moving").colliders:
            if isinstance(c, Box):
                assert np.max(np.abs(at[i] - c.center) - 0.5 * sizes[i] - c.half_size) > 0.005
    big, size = at[-1], sizes[-1]
    assert big[0] - size[0] / 2 < HOLE[0] and big[0] + size[0] / 2 > HOLE[1] and size[1] > HOLE[2]
    assert 0.0 < big[2] - size[2] / 2 - FAR < 0.05
    assert BoxMoving().score == 0
