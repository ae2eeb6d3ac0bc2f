"""The brick game: the tower stands and sleeps by itself, a plank is drawn from it, a thrown ball fells it."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from core.vocabulary import BodyState
from display.protocol import Frame
from display.user_commands import Reset
from scenes import registry
from scenes.table_brick_game import DRAW_AT, DRAW_TIME, DRAWN, TABLE_TOP, tower, tower_height
from tests.support.scripted_play import DT, blind_world, frames

BRICKS = len(tower())


@pytest.fixture(scope="module")
def world(ti_cpu):
    return blind_world(registry.load("table_brick_game"))


def test_the_tower_stands_while_a_plank_is_drawn(world):
    """Until the hand comes, 0.15 s after the start here, bricks do not move; then one alone leaves its place."""
    world.apply([Reset()])
    places = np.array([b.position for b in tower()])
    for time in frames(world, DRAW_TIME + 0.45, begin=DRAW_AT - 0.15):
        *bricks, bear, _ = world.bodies()
        if time < DRAW_AT - 0.05:
            assert_allclose([b.centroid for b in bricks], places, atol=2e-4)
            assert abs(bear.low[1] - tower_height()) < 0.007
    moved = np.linalg.norm(np.array([b.centroid for b in bricks]) - places, axis=1)
    assert np.argmax(moved) == DRAWN and moved[DRAWN] > 0.1 and np.delete(moved, DRAWN).max() < 0.02
    assert abs(bear.low[1] - tower_height()) < 0.02 and world.stats()["finite"]


@pytest.mark.long
def test_the_script_fells_the_tower(world):
    """The ball gives its momentum to bricks and bear."""
    world.apply([Reset()])
    game = world.scene.game
    ball_speed = bear_speed = brick_speed = 0.0
    for _ in frames(world, game.duration):
        *bricks, bear, ball = world.bodies()
        if not ball.held:
            ball_speed = max(ball_speed, -ball.velocity[2])
        bear_speed = max(bear_speed, np.linalg.norm(bear.velocity))
        brick_speed = max([brick_speed, *(np.linalg.norm(b.velocity) for b in bricks if not b.held)])
    game.verify(world.bodies())
    assert game.score >= game.goal and game.message.startswith("Most of the tower is down with one throw")
    assert ball_speed > 3.0 and brick_speed > 1.0 and bear_speed > 0.5  # soft moves rigid, rigid moves soft
    assert all(b.low[1] > -0.01 for b in world.bodies()) and world.stats()["finite"]


def test_the_tower_is_down_when_its_bricks_have_fallen_and_lie_still():
    """Bricks that were pushed by less than half their length, and still lie on others, do not count."""
    game = registry.load("table_brick_game").game

    def bodies(move, speed: float = 0.0) -> list[BodyState]:
        at = [p + move for p in game.places] + [np.array([0.4, TABLE_TOP, 0.14])] * 2
        ends = np.array([speed, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
        return [BodyState("brick", p, ends[0], p - 0.02, p + 0.02, ends[1], False) for p in at]

    for move, speed, score, won in (
        ((0.03, 0.0, 0.03), 0.0, 0, False),
        ((0.0, -0.1, 0.0), 1.0, BRICKS, False),
        ((0.0, -0.1, 0.0), 0.0, BRICKS, True),
    ):
        game.update(3.0, bodies(move, speed))
        assert game.score == score and game.message.startswith("Most of the tower is down") == won


@pytest.mark.long
def test_what_is_left_alone_sleeps(world):
    """No hand: the tower, the bear on it and the ball in its ring fall asleep where they are."""
    world.apply([Reset()])
    before = world.bodies()
    for k in range(round(6.0 / DT)):
        world.step(Frame(DT, (k + 1) * DT, []))
        if world.device.solver.stats["asleep"] == BRICKS + 2:
            break
    assert world.device.solver.stats["asleep"] == BRICKS + 2
    moved = [np.linalg.norm(b.centroid - a.centroid) for a, b in zip(before, world.bodies(), strict=True)]
    assert max(moved[:BRICKS]) < 2e-4 and max(moved) < 0.008  # soft ones settle under their weight
    assert world.scene.game.score == 0 and world.bodies()[-1].low[1] > TABLE_TOP - 0.005
