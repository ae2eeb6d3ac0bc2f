"""A body that moves by itself: rings bounce off the dancer, and hands do not carry it away."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial import ConvexHull

from assets.asset import Asset
from assets.library import animated_height, find_asset
from core.errors import BadInput
from core.tetmesh import vertex_components
from core.vocabulary import Hand
from display.protocol import Frame
from display.user_commands import Duplicate, Remove, Rescale, Reset, SetInteraction, Undo
from prepare.rig.skin_weights import least_volumes
from scenes import registry
from scenes.just_dance import THROW_PERIOD
from tests.support.scripted_play import DT, blind_world, frames


@pytest.fixture(scope="module")
def stage(ti_cpu):
    """The scene in a world that draws nothing, and the dancer's asset."""
    return blind_world(registry.load("just_dance")), Asset.load(find_asset("dancer"))


def shape(world, asset) -> np.ndarray:
    """The dancer's cage as it is now [m], (V, 3)."""
    return world.device.solver.x.to_numpy()[: len(asset.cage.vertices)].astype(np.float64)


def led_and_wanted(world, asset, body: int, time: float, move: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Driven vertices of a body as they are, and as the motion has them, moved by (4, 4) of the world."""
    a, rest = asset.animation, asset.cage.vertices.astype(np.float64)
    place = np.array(world.scene.bodies[0].position)
    led, first = a.vertices[a.driven], world.device.solver.vertex_offset[body]
    wanted = a.skinned(rest[a.vertices], a.matrices(time))[a.driven] + place
    x = world.device.solver.x.to_numpy()[first : first + len(rest)].astype(np.float64)
    return x[led], wanted @ move[:3, :3].T + move[:3, 3]


def test_no_thin_part_of_the_dancer_shortens_the_substeps_of_the_play(stage):
    """Two CPU cores play it at 20 frames/s: at most the substeps of the ball, in a frame of 1/60 s."""
    assert stage[0].stats()["substeps"] <= 64


@pytest.mark.parametrize("throws", [1, pytest.param(3, marks=pytest.mark.long)])
def test_the_scripted_player_meets_the_dancer_with_what_he_throws(throws, stage):
    """Rings and ball bounce off; the skirt swings, no leg goes through it, and the dancer stays whole."""
    world, asset = stage
    world.apply([Reset()])
    game, rest, least, swing = world.scene.game, asset.cage.vertices.astype(np.float64), 1.0, 0.0
    part = vertex_components(asset.cage.tets)
    skirt, body = np.unique(asset.cage.tets[part == 1]), np.unique(asset.cage.tets[part == 0])
    height = np.ptp(rest[:, 1])
    knees = body[(np.abs(rest[body, 1] - 0.36 * height) < 0.08 * height)]
    hem = skirt[rest[skirt, 1] < rest[skirt, 1].min() + 0.02]
    through = 0
    for k, _ in enumerate(frames(world, game.duration if throws == 3 else THROW_PERIOD)):
        if k % 12 == 0:
            x = shape(world, asset)
            least = min(least, least_volumes(asset.cage.tets, np.stack([rest, x])).min())
            round_hem = x[hem, ::2] - x[hem, ::2].mean(0)
            swing = max(swing, np.ptp(np.linalg.norm(round_hem, axis=1)))
            hull = ConvexHull(x[skirt]).equations
            through = max(through, (x[knees] @ hull[:, :3].T + hull[:, 3] > 0).any(axis=1).mean())
    assert game.score == throws
    if throws == 3:
        game.verify(world.bodies())
        assert game.message.startswith("Bravo")
    assert all(np.linalg.norm(b.centroid[::2] - world.bodies()[0].centroid[::2]) > 0.1 for b in world.bodies()[1:])
    assert least > 0.1 and world.stats()["finite"]
    assert swing > 0.06 and through < 0.05
    world.apply([Reset()])
    assert game.score == 0 and game.message.startswith("0 of 3")


def test_a_hand_does_not_stop_the_dance(stage):
    """It takes hold of a thigh and is moved away: skin gives way, the bones go on; let go, all is as it was."""
    world, asset = stage
    world.apply([Reset()])
    rest, place = asset.cage.vertices.astype(np.float64), np.array(world.scene.bodies[0].position)
    free = np.setdiff1d(np.arange(len(rest)), asset.animation.vertices[asset.animation.driven])
    grip = place + rest[free[np.argmin(np.linalg.norm(rest[free] - rest.mean(0), axis=1))]]
    for k in range(round(1.5 / DT)):
        time = (k + 1) * DT
        hand = Hand(tuple(grip + [0.0, 0.0, 0.1 * min(time / 0.4, 1.0)]), grip=0.1 < time < 0.8, reach=0.05)
        world.step(Frame(DT, time, [], [hand]))
        if k == round(0.6 / DT):
            assert world.bodies()[0].held
        assert_allclose(*led_and_wanted(world, asset, 0, time, np.eye(4)), atol=2e-5)
    assert least_volumes(asset.cage.tets, np.stack([rest, shape(world, asset)])).min() > 0.2 and world.stats()["finite"]


def test_a_dancer_that_is_put_elsewhere_dances_on_there_until_it_is_undone(stage):
    world, asset = stage
    world.apply([Reset()])
    for k in range(12):
        world.step(Frame(DT, (k + 1) * DT, []))
    grip = 0.5 * (world.bodies()[0].low + world.bodies()[0].high)
    world.apply([SetInteraction("transform")])
    half = (np.cos(0.25), 0.0, np.sin(0.25), 0.0)
    for k in range(5):
        hand = Hand(tuple(grip + [0.05 * k, 0.0, 0.02 * k]), half if k else (1.0, 0.0, 0.0, 0.0), True, 0.2)
        world.step(Frame(DT, 0.0, [], [hand]))
        assert world.bodies()[0].held
    R = np.array([[np.cos(0.5), 0.0, np.sin(0.5)], [0.0, 1.0, 0.0], [-np.sin(0.5), 0.0, np.cos(0.5)]])
    move = np.eye(4)
    move[:3, :3], move[:3, 3] = R, grip + [0.2, 0.0, 0.08] - R @ grip
    world.apply([SetInteraction("physics")])
    for k in range(6):
        world.step(Frame(DT, 0.0, []))
        assert_allclose(*led_and_wanted(world, asset, 0, (13 + k) * DT, move), atol=1e-4)
    assert world.stats()["finite"] and np.abs(world.bodies()[0].velocity).max() < 2.0  # nothing snapped
    world.apply([Undo()])
    world.step(Frame(DT, 0.0, []))
    assert_allclose(*led_and_wanted(world, asset, 0, 13 * DT, np.eye(4)), atol=1e-4)
    assert world.interaction == "physics"


@pytest.mark.long
def test_a_copy_dances_along_at_its_size_and_goes(stage):
    world, asset = stage
    world.apply([Reset()])
    for k in range(6):
        world.step(Frame(DT, (k + 1) * DT, []))
    world.apply([Duplicate(0)])
    world.apply([])  # room is made
    world.device.cast_shadow = lambda: None
    copy = len(world.bodies()) - 1
    aside = world.bodies()[copy].centroid - world.bodies()[0].centroid
    assert abs(aside[1]) < 1e-5 and np.hypot(aside[0], aside[2]) > 0.1  # beside it, on the stage
    move = np.eye(4)
    move[:3, 3] = aside
    for k in range(4):
        world.step(Frame(DT, 0.0, []))
        assert_allclose(*led_and_wanted(world, asset, copy, (7 + k) * DT, move), atol=1e-4)
    body = world.bodies()[copy]
    foot = np.array([body.centroid[0], body.low[1], body.centroid[2]])
    world.apply([Rescale(copy, 0.8)])
    assert not world.notice
    scale = np.diag([0.8, 0.8, 0.8, 1.0])
    scale[:3, 3] = 0.2 * foot
    world.apply([Remove(1)])  # a ring
    for k in range(4):
        world.step(Frame(DT, 0.0, []))
        assert_allclose(*led_and_wanted(world, asset, copy - 1, (11 + k) * DT, scale @ move), atol=1e-4)
        assert_allclose(*led_and_wanted(world, asset, 0, (11 + k) * DT, np.eye(4)), atol=1e-4)
    world.apply([Remove(0)])
    world.step(Frame(DT, 0.0, []))
    assert_allclose(*led_and_wanted(world, asset, copy - 2, 15 * DT, scale @ move), atol=1e-4)
    assert world.stats()["finite"] and len(world.registry.animations) == 1
    world.apply([Reset()])
    world.step(Frame(DT, 0.0, []))
    assert len(world.bodies()) == copy
    assert_allclose(*led_and_wanted(world, asset, 0, DT, np.eye(4)), atol=1e-4)


def test_what_stands_still_cannot_dance():
    with pytest.raises(BadInput, match="is not animated"):
        registry.load("just_dance", body="ring_red")
    assert animated_height("ring_red") is None
    assert_allclose(animated_height("dancer"), np.ptp(Asset.load(find_asset("dancer")).cage.vertices[:, 1]))
