"""Toy collection: the scripted hands gather toys in the basket and lift it with the toys in it."""

from dataclasses import replace

import numpy as np
import pytest

from assets.library import find_asset
from core.vocabulary import BodyState
from scenes import registry, toy_collection
from tests.support.scripted_play import play


def test_each_hand_drops_a_toy_in_the_basket(ti_cpu):
    """The beginning of the play, with the toys that it takes."""
    scene = registry.load("toy_collection")
    _, basket, *toys = scene.bodies
    world = play(replace(scene, bodies=[basket, *toys[:4]]), seconds=1.5 * toy_collection.PERIOD + 0.2)
    assert {0, 1} <= scene.game.inside and "2 of 12 toys in the basket" in scene.game.message
    assert not scene.game.carried and world.stats()["finite"]


@pytest.mark.long
def test_toys_are_gathered_and_carried(ti_cpu):
    """Played with the toys that are gathered: the others lie about in any case."""
    scene = registry.load("toy_collection")
    assert len(toy_collection.TOYS) == 12 == scene.game.goal
    assert all(find_asset(name) for name in toy_collection.TOYS)
    room, basket, *toys = scene.bodies
    gathered = sum(map(len, toy_collection.TURNS))
    heights = []

    def note(time, world):
        if scene.game.carried:
            heights.append([b.centroid[1] for b in world.bodies()])

    world = play(replace(scene, bodies=[room, basket, *toys[:gathered]]), each=note)
    scene.game.verify(world.bodies())
    assert world.stats()["finite"]
    lifts = np.ptp(heights, axis=0)
    inside = [1 + k for k in scene.game.inside]
    assert lifts[0] > 0.1 and (np.abs(lifts[inside] - lifts[0]) < 0.1).all()  # the toys rise with the basket
    assert "toys in the basket" in scene.game.message
    scene.game.reset()
    assert scene.game.score == 0 and not scene.game.carried


@pytest.mark.parametrize(
    ("toy", "axis", "inside"),
    [
        ((0.1, 0.1, 0.1), (0, 1, 0), True),
        ((0.1, 0.1, 0.1), (0, -1, 0), True),  # the sign of an axis means nothing
        ((0.1, 0.5, 0.1), (0, 1, 0), False),  # far above it
        ((0.4, 0.1, 0.0), (0, 1, 0), False),  # beside it
        ((0.1, 0.1, 0.1), (1, 0, 0), False),  # it has been tipped over
    ],
)
def test_a_toy_lies_in_an_upright_basket(toy, axis, inside):
    def state(at, axis=(0.0, 1.0, 0.0)) -> BodyState:
        at = np.array(at, float)
        return BodyState("body", at, np.zeros(3), at - 0.1, at + 0.1, np.array(axis), False)

    assert toy_collection.lies_in(state((0, 0.12, 0), axis), state(toy)) == inside
