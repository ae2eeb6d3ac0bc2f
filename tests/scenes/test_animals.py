"""The demos with animals: they are placed, sized and petted in one, pulled at in the other."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from core.errors import BadInput
from core.vocabulary import BodyState
from display.xr import avatar
from scenes import animal_crossing, manipulation, registry
from scenes.manipulation import PULL_TIME, REST_TIME, SETTLE_TIME
from tests.support.scripted_play import play


def test_two_hands_place_an_animal_and_draw_it_larger(ti_cpu):
    """The hands are drawn on the bear's side, and are not hidden in it."""
    scene, inside = registry.load("animal_crossing"), []

    def seen(time, world):
        if 0.3 < time < 1.2 and round(60 * time) % 10 == 0:
            poses = avatar.scripted_poses(world.scripted_hands(time), scene.eye, scene.target)
            for skin in avatar.scripted_skins():
                x = np.c_[skin.gaussians.means, np.ones(len(skin.part))][::20]
                for at in np.einsum("nk,nkij,nj->ni", skin.weight[::20], poses[skin.part[::20]], x):
                    hit = world.device.solver.pick(scene.eye, at - scene.eye)
                    inside.append(hit is not None and hit[0] < np.linalg.norm(at - scene.eye))

    world = play(scene, seconds=animal_crossing.PLACING_TIME, each=seen)
    assert len(inside) > 100 and np.mean(inside) < 0.05
    bear = list(animal_crossing.ANIMALS).index("bear")
    assert scene.game.guests[bear].placed and scene.game.score == 1
    assert_allclose(world.device.solver.body_models[bear].shape.factor, 1 / 0.62, rtol=0.02)


@pytest.mark.long
def test_animals_are_placed_sized_and_petted(ti_cpu):
    scene = registry.load("animal_crossing")
    assert len(animal_crossing.ANIMALS) == 5
    world = play(scene)
    game = scene.game
    game.verify(world.bodies())
    assert game.score == len(animal_crossing.SCRIPT) + 1 and world.interaction == "physics"
    sizes = [m.shape.factor for m in world.device.solver.body_models]
    assert_allclose(sizes[:2], [1.0, 1 / 0.62], rtol=0.02)  # the fox kept its size, the bear has grown
    assert_allclose(sizes[4], 1 / 1.45, rtol=0.02)  # the rabbit has shrunk
    assert "horse" in game.message or "bear" in game.message
    game.reset()
    assert game.score == 0


@pytest.mark.parametrize(
    ("upright", "axis", "expected"),
    [(0.0, (1, 0, 0), True), (0.0, (0, 1, 0), False), (0.9, (0.1, -0.9, 0.4), True), (0.9, (1, 0.2, 0), False)],
)
def test_an_animal_on_its_side_does_not_stand(upright, axis, expected):
    low, high = np.array([-0.1, 0.0, -0.3]), np.array([0.1, 0.5, 0.3])
    axis = np.array(axis) / np.linalg.norm(axis)
    body = BodyState("fox", np.array([0.0, 0.25, 0.0]), np.zeros(3), low, high, axis, False)
    assert animal_crossing.Guest(0.5, upright).stands(body) == expected


def test_a_part_of_an_animal_is_pulled_and_springs_back(ti_cpu):
    scene = registry.load("manipulation")
    feet = []

    def note(time, world):
        if round(time * 60) % 30 == 0:
            solver = world.device.solver
            pinned = np.asarray(solver.body_models[0].body.pinned)
            feet.append(solver.x.to_numpy()[pinned])

    world = play(scene, seconds=SETTLE_TIME + PULL_TIME + REST_TIME, each=note)
    assert scene.game.score == 1 and scene.game.goal == 3
    assert len(feet[0]) > 10 and np.ptp(feet, axis=0).max() < 1e-6  # what is fixed stays
    assert world.bodies()[0].driven and world.stats()["finite"]


@pytest.mark.long
@pytest.mark.parametrize("animal", manipulation.ANIMALS)
def test_all_parts_of_each_animal_are_pulled(animal, ti_cpu):
    scene = registry.load("manipulation", animal=animal)
    scene.game.verify(play(scene).bodies())
    assert scene.game.score == scene.game.goal == 3


def test_the_message_names_the_flowers_around_an_animal_s_place():
    zero, up = np.zeros(3), np.array([0.0, 1.0, 0.0])
    game = animal_crossing.AnimalCrossing()
    game.update(0.0, [BodyState(n, zero, zero, zero, up, up, False) for n in animal_crossing.ANIMALS])
    assert "Bring the fox to its ring of orange flowers, as large" in game.message


def test_only_animals_that_are_known():
    assert set(manipulation.ANIMALS) == {"fox", "bear", "horse"}
    with pytest.raises(BadInput, match="fox, bear or horse"):
        registry.load("manipulation", animal="dodo")
