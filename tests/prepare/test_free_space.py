"""Free space: around the cameras of a training, how far it reaches and that it is cleared; and around a player."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from core.camera import look_at, perspective
from prepare.environment.support_planes import ARM_LENGTH, CELL, SupportPlane, standing_eye
from prepare.train.densification import free_radii, in_free_space, near_depth
from prepare.train.trainer import Trainer, TrainOptions
from tests.support import painted_capture
from tests.support.painted_capture import SIDE

STEPS = 400  # before growth begins


def test_the_near_depth_is_that_of_what_fills_a_good_part_of_the_picture():
    depth, alpha = np.full((20, 20), 4.0), np.ones((20, 20))
    depth[0] = 0.3  # a twentieth: a thing at the border, or a floater
    assert near_depth(depth, alpha) == 4.0
    depth[:4] = 1.0  # a fifth: what was photographed, before a far background
    assert near_depth(depth, alpha) == 1.0
    alpha[:4] = 0.4
    assert near_depth(depth, alpha) == 4.0
    assert np.isnan(near_depth(depth, 0.0 * alpha))


def test_free_space_ends_far_before_what_is_seen_and_at_the_next_camera():
    places = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (5.0, 0.0, 0.0), (5.0, 3.0, 0.0)]
    cameras = [perspective(SIDE, SIDE, 0.8, look_at(at, (at[0], at[1], 1.0))) for at in places]
    radii = free_radii(cameras, np.array([2.0, 8.0, np.nan, 8.0]))
    # A thing at a third of the distance of all else may be meant; floaters reached a sixth (bench/NOTES.md).
    assert 0.4 <= radii[0] <= 0.6 and radii[1] == 1.0 and radii[2] == 0.0 and 1.6 <= radii[3] <= 2.4
    points = np.array([[0.1, 0, 0], [0, -0.35, 0], [0, 0, 0.7], [1, 0.9, 0], [1, 1.1, 0], [5, 0, 0]])
    assert_array_equal(in_free_space(points, cameras, radii), [True, True, False, True, False, False])


@pytest.fixture(scope="module")
def floaters(ti_cpu, tmp_path_factory):
    """A trainer of the painted capture, two of whose Gaussians lie beside and behind a camera; and where they lie."""
    pictures = painted_capture.photographs()
    camera = pictures[0].camera
    back = camera.position - 0.15 * camera.world_to_camera[2, :3]
    places = np.array([camera.position + (0.0, 0.2, 0.0), back])
    g = painted_capture.painted_gaussians()
    means = g.means.copy()
    means[:2] = places
    start = replace(g, means=means, log_scales=np.full_like(g.log_scales, np.log(0.05)))
    trainer = Trainer(pictures, start, 2.0, TrainOptions(steps=STEPS, cap=200, degree=0))
    return trainer, trainer.state(), places


def left_at(trainer, places: np.ndarray) -> list[bool]:
    """Mask of the places at which a Gaussian lies."""
    means = trainer.population.read()["mean"]
    return [bool((np.linalg.norm(means - at, axis=1) < 0.05).any()) for at in places]


def test_what_hangs_beside_a_camera_is_removed_and_nothing_else(floaters):
    trainer, state, places = floaters
    trainer.clear_free_space()
    after = trainer.population.read()["mean"]
    assert left_at(trainer, places) == [False, False]
    assert {tuple(m) for m in after.tolist()} == {tuple(m) for m in state["mean"][2:].tolist()}
    trainer.restore(state)
    trainer.population.frozen = 1
    trainer.clear_free_space()
    trainer.population.frozen = 0
    assert left_at(trainer, places) == [True, False]
    trainer.restore(state)


@pytest.mark.parametrize("free_space", (True, False))
def test_free_space_is_cleared_in_the_second_half_of_a_training(floaters, free_space):
    """Growth has ended then, and others still have time to take the place of what is removed."""
    trainer, state, places = floaters
    trainer.options = replace(trainer.options, free_space=free_space)
    for done, left in ((0.4, True), (0.5, not free_space), (0.9, not free_space), (1.0, True)):
        trainer.done = round(done * STEPS) - 1
        trainer.step()
        assert left_at(trainer, places) == [left, left]
        trainer.restore(state)


def test_a_player_stands_where_there_is_most_space_at_arms_length():
    """Half of the floor is strewn with posts, 0.4 m apart, between which one could just stand."""
    floor = SupportPlane("floor", 0.0, np.array([-2.0, -2.0]), np.ones((round(4 / CELL),) * 2, bool))
    table = SupportPlane("table", 0.7, np.array([-0.1, -0.1]), np.ones((4, 4), bool))
    open_air = SimpleNamespace(spacing=0.05, at=lambda points: np.zeros(len(points), bool))
    for turn in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        posts = np.stack(np.meshgrid(np.arange(-2.0, 2.0, 0.4), [1.0], np.arange(-2.0, 2.0, 0.4)), -1).reshape(-1, 3)
        posts = posts[posts[:, [0, 2]] @ turn < 0.0]
        eye = standing_eye(floor, np.array([0.0, 0.7, 0.0]), table, posts, open_air)
        assert eye[[0, 2]] @ turn > 0.2 and abs(np.hypot(eye[0], eye[2]) - ARM_LENGTH) < 0.1
        assert np.linalg.norm((posts - eye)[:, [0, 2]], axis=1).min() > 0.4
