"""Up axis: known scenes and a cup, downloaded splats, confidence against frequency; and poses of rest of a box."""

import numpy as np
import pytest

from assets.gaussians import Gaussians
from assets.level_planes import hollow_columns
from assets.splat_files import read_gaussians
from assets.up_axis import (
    AXES,
    LAPSE,
    WEIGHTS,
    alternatives,
    describe_guess,
    guess_up_axis,
    probabilities_from,
    robust_bounds,
    rotation_to_up,
    up_probabilities,
)
from assets.up_cues import DIRECTIONS, outermost_points, resting_heights
from prepare.cleaning import clean
from tests.support.cage_cases import case
from tests.support.sample_scenes import brick, garden, room, table_and_jug
from tests.support.shells import ball, toy

EVEN = dict.fromkeys(AXES, 1 / 6)
SCENES = {"room": room, "open room": lambda: room(ceiling=False), "garden": garden, "table": table_and_jug}


@pytest.fixture(scope="module")
def scenes() -> dict[str, Gaussians]:
    return {name: make() for name, make in SCENES.items()}


def every(g: Gaussians, n: int) -> Gaussians:
    return g.select(np.arange(0, len(g), n))


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_stands_on_its_floor_whatever_axis_is_up(scenes, name):
    """Walls, a shelf and a chest do not mislead."""
    g = every(scenes[name], 3)
    for up in AXES:
        p = up_probabilities(g.transformed(rotation_to_up(up).T), EVEN, "scene")
        assert max(p, key=p.get) == up and p[up] > 0.4, (up, p)


def test_an_empty_box_has_no_up():
    """A closed empty room has no floor that could be told from its ceiling."""
    box = brick(np.random.default_rng(0), (-2, 0, -2.5), (2, 2.2, 2.5), 0.08, 0.0)
    p = up_probabilities(box, EVEN)
    assert max(p.values()) < 0.7 and len(alternatives(p)) > 1


def test_what_misleads_makes_unsure():
    """A mug whose underside is missing looks as if it were open below, too: the truth is among the alternatives."""
    p = up_probabilities(clean(case("mug", 12_000))[0], EVEN)
    assert "+y" in alternatives(p) and len(alternatives(p)) > 1


@pytest.mark.parametrize("made", [ball, toy, lambda: case("capsule", 6000)])
def test_what_was_not_looked_into_is_not_hollow(made):
    """A shell without its underside is as empty from below as a cup, but its wall has one face."""
    points = made().means.astype(np.float64)
    low, high = robust_bounds(points)
    for axis in range(3):
        hits = outermost_points(points, axis, low, float((high - low).max()))
        for sign, hit in zip((-1, 1), hits, strict=True):
            assert not hollow_columns(points, points[hit], axis, sign, float((high - low).max())).any()


def test_how_sure_a_guess_is_is_said():
    assert describe_guess("-z", 0.514) == "-z (guessed, 51% sure; --up overrides)"
    p = up_probabilities(case("capsule", 6000))
    assert sum(p.values()) == pytest.approx(1.0)
    assert alternatives(p) == sorted((up for up in p if p[up] > 0.02), key=p.get, reverse=True)  # it lies on any side
    assert alternatives(dict.fromkeys(AXES, 0.02) | {"-y": 0.9}) == ["-y"]


def test_no_guess_is_surer_than_the_lapses_of_the_model_leave_it():
    """A table on its legs is beyond doubt, but the cues may mean nothing there."""
    assert max(up_probabilities(table_and_jug(), EVEN).values()) <= 1 - min(LAPSE.values()) * 5 / 6 + 1e-12


def test_what_one_model_alone_can_tell_counts_of_a_kind_that_is_not_known():
    """A missing underside tells a body's up, and nothing about a scene; the mean of 96% and 13% would be a toss-up."""
    cues = {up: dict.fromkeys(WEIGHTS["body"], 0.0) for up in AXES}
    cues["+y"]["open"] = 1.0
    body, scene, either = (probabilities_from(cues, EVEN, kind)["+y"] for kind in ("body", "scene", None))
    assert scene < 0.2 and 0.85 < either < body


def test_a_thing_rests_on_the_sides_it_can_lie_on():
    """The height of a box's centre is least where one of its sides is below, and is half the box there."""
    half = np.array([0.3, 0.1, 0.2])
    points = np.random.default_rng(0).uniform(-1, 1, (4000, 3))
    points[np.arange(4000), np.random.default_rng(1).integers(0, 3, 4000)] = np.random.default_rng(2).choice(
        [-1, 1], 4000
    )
    heights, longest = resting_heights(points * half)
    assert longest == pytest.approx(0.6, rel=0.02)
    for axis in range(3):
        for sign in (1, -1):
            near = DIRECTIONS @ (sign * np.eye(3)[axis]) > np.cos(np.radians(8.0))  # they lie about that far apart
            assert heights[near].min() == pytest.approx(half[axis], abs=0.05)
    corner = DIRECTIONS @ (np.ones(3) / np.sqrt(3)) > 0.99
    assert heights[corner].min() > 0.3  # it stands on a corner, and would fall


@pytest.mark.parametrize("name", ["toy_cat", "plush_dragon", "biker_human"])
def test_downloaded_splats_stand_on_their_feet(name, shared):
    """None of which the model was fitted to."""
    found = guess_up_axis(read_gaussians(shared / f"data/splats/{name}.ply"), "body")
    assert found[0] == {"toy_cat": "-y", "plush_dragon": "+y", "biker_human": "-y"}[name] and found[1] > 0.6


def test_what_looks_the_same_from_all_sides_is_not_sure():
    """A sphere whose points are mirrored in all planes: no cue tells its axes apart."""
    points = np.random.default_rng(0).normal(size=(40, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    turned = np.concatenate([np.roll(points, k, axis=1) for k in range(3)])
    signs = np.stack(np.meshgrid(*[(-1, 1)] * 3), -1).reshape(-1, 1, 3)
    means = (signs * turned).reshape(-1, 3)
    n = len(means)
    g = Gaussians.of(
        means, np.tile([1.0, 0, 0, 0], (n, 1)), np.full((n, 3), -4.0), np.full(n, 3.0), np.zeros((n, 1, 3))
    )
    assert guess_up_axis(g)[1] < 0.6 and len(alternatives(up_probabilities(g))) > 1
