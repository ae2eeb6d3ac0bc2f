"""What moves by itself among other things: rings bounce off the dancer, and hands do not carry it off."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assets.asset import Asset
from assets.errors import BadInput
from assets.library import find_asset, moves_by_itself
from assets.materials import STATURE, material_named, moving_named
from prepare.rig_weights import least_volumes
from scenes import registry
from scenes.scene import Hand

DT = 1 / 60  # [s]


@pytest.fixture(scope="module")
def stage(ti_cpu):
    """The scene in a world that draws nothing, and the dancer's asset."""
    from display.world import World

    world = World(registry.load("just_dance"), width=32, height=32)
    world.renderer.render = lambda cameras: None
    world.shadow.cast = lambda: None
    return world, Asset.load(find_asset("dancer"))


def shape(world, asset) -> np.ndarray:
    """The dancer's cage as it is now [m], (V, 3)."""
    return world.solver.x.to_numpy()[: len(asset.cage.vertices)].astype(np.float64)


def test_a_ring_bounces_off_the_dancer(stage):
    """It flies at the dancer from the front, comes back towards where it came from, and leaves the dancer whole."""
    from display.frame import Frame

    world, asset = stage
    world.apply({"reset": True})
    game, speeds, least = world.scene.game, [], 1.0
    for k in range(round(3.2 / DT)):
        world.step(Frame(DT, (k + 1) * DT, [], world.scripted_hands((k + 1) * DT)))
        dancer, ring = world.bodies()
        if game.throw is not None and not ring.held and k * DT > game.begun + game.throw.released_at:
            speeds.append(ring.velocity[2])
        if k % 6 == 0:
            rest = asset.cage.vertices.astype(np.float64)
            least = min(least, least_volumes(asset.cage.tets, np.stack([rest, shape(world, asset)])).min())
    game.verify(world.bodies())
    assert min(speeds) < -0.8 and speeds[-1] > -0.2  # towards the dancer; stopped
    assert ring.centroid[2] > 0.5 * (dancer.low + dancer.high)[2]
    assert least > 0.1 and world.stats()["finite"]


def test_a_hand_does_not_stop_the_dance(stage):
    """It takes hold of a thigh and is moved away: skin gives way, the bones go on; let go, all is as it was."""
    from display.frame import Frame

    world, asset = stage
    world.apply({"reset": True})
    a, rest = asset.animation, asset.cage.vertices.astype(np.float64)
    place = np.array(world.scene.bodies[2].position)
    led = a.vertices[a.driven]
    free = np.setdiff1d(np.arange(len(rest)), led)
    grip = place + rest[free[np.argmin(np.linalg.norm(rest[free] - rest.mean(0), axis=1))]]
    for k in range(round(2.4 / DT)):
        time = (k + 1) * DT
        hand = Hand(tuple(grip + [0.0, 0.0, 0.1 * min(time / 0.4, 1.0)]), grip=0.1 < time < 0.8, reach=0.05)
        world.step(Frame(DT, time, [], [hand]))
        x = shape(world, asset)
        if k == round(0.6 / DT):
            assert world.bodies()[0].held
        wanted = a.skinned(rest[a.vertices], a.matrices(time))[a.driven] + place
        assert_allclose(x[led], wanted, atol=2e-5)
    assert least_volumes(asset.cage.tets, np.stack([rest, x])).min() > 0.2 and world.stats()["finite"]


def test_what_stands_still_cannot_dance():
    with pytest.raises(BadInput, match="does not move by itself"):
        registry.load("just_dance", body="ring_red")
    assert moves_by_itself("ring_red") is None
    assert_allclose(moves_by_itself("dancer"), np.ptp(Asset.load(find_asset("dancer")).cage.vertices[:, 1]))


def test_a_small_dancer_is_softer_and_a_giant_is_not_harder():
    flesh = material_named("flesh")
    assert moving_named("flesh", STATURE) == moving_named("flesh", 3.0) == flesh
    half = moving_named("flesh", STATURE / 2)
    assert_allclose(half["young"], flesh["young"] / 4)
    assert {k: v for k, v in half.items() if k != "young"} == {k: v for k, v in flesh.items() if k != "young"}
    assert moving_named("flesh", 0.01)["young"] == 1e3
