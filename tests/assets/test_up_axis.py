"""Up axis: scenes by their planes, a cup by its inside; and the convex hull by hand against SciPy's."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from assets.gaussians import Gaussians
from assets.level_planes import hollow_columns, normals_and_areas, plane_votes, scene_votes
from assets.up_axis import (
    AXES,
    convex_hull,
    describe_guess,
    guess_up_axis,
    most_likely,
    outermost_points,
    robust_bounds,
    rotation_to_up,
)
from prepare.cleaning import clean
from tests.support.cage_cases import case
from tests.support.sample_scenes import brick, garden, room, table_and_jug
from tests.support.shells import ball, toy

SCENES = {"room": room, "open room": lambda: room(ceiling=False), "garden": garden, "table": table_and_jug}


@pytest.fixture(scope="module")
def scenes() -> dict[str, Gaussians]:
    return {name: make() for name, make in SCENES.items()}


def every(g: Gaussians, n: int) -> Gaussians:
    return g.select(np.arange(0, len(g), n))


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_stands_on_its_floor_whatever_axis_is_up(scenes, name):
    """The largest pair of planes, or what is left of it without a ceiling; walls, shelf and chest do not mislead."""
    g = scenes[name]
    assert scene_votes(g) is not None
    for up in AXES:
        found, sure = guess_up_axis(every(g.transformed(rotation_to_up(up).T), 3))
        assert found == up and sure > 0.85, (up, found, sure)


def test_the_ceiling_decides_nothing_by_itself(scenes):
    """A closed empty box has no floor that could be told from its ceiling; the votes say so."""
    box = brick(np.random.default_rng(0), (-2, 0, -2.5), (2, 2.2, 2.5), 0.08, 0.0)
    votes = plane_votes(box.means.astype(float), *normals_and_areas(box))
    assert abs(votes["+y"] - votes["-y"]) < 0.02 and min(votes["+y"], votes["-y"]) > votes["+z"] + 0.02
    assert most_likely(votes, 0.03)[1] < 0.7
    assert scene_votes(box) is None  # nothing is in it: as much a body as a room


@pytest.mark.parametrize("up", AXES)
def test_a_mug_stands_with_its_opening_upwards(up):
    """Its underside is missing, so that the floor inside is all that is there: what misled before."""
    found, sure = guess_up_axis(clean(case("mug", 12_000))[0].transformed(rotation_to_up(up).T))
    assert found == up and sure > 0.5


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
    votes = dict.fromkeys(AXES, 0.0)
    assert most_likely(votes | {"+y": 1.0}, 0.1)[0] == "+y" and most_likely(votes | {"+y": 1.0}, 0.1)[1] > 0.99
    assert most_likely(votes | {"+y": 1.0, "-z": 1.0}, 0.1)[1] == pytest.approx(0.5, abs=0.01)
    assert describe_guess("-z", 0.514) == "-z (guessed, 51% sure; --up overrides)"
    assert (
        guess_up_axis(toy())[1] > guess_up_axis(case("capsule", 6000))[1]
    )  # a drop has an underside, a lying capsule looks like any side


@pytest.mark.parametrize("seed", range(4))
def test_corners_are_those_of_scipy_and_run_counterclockwise(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(500, 2)) * (1.0, 0.01)
    if seed % 2:  # many on the same lines, many twice
        points = np.round(points * (3, 300)) / 8
    corners = convex_hull(points)
    reference = points[ConvexHull(points).vertices]
    assert {tuple(p) for p in corners} == {tuple(p) for p in reference} and len(corners) == len(reference)
    ahead, back = np.roll(corners, -1, axis=0) - corners, corners - np.roll(corners, 1, axis=0)
    assert (back[:, 0] * ahead[:, 1] > back[:, 1] * ahead[:, 0]).all()


@pytest.mark.parametrize("count", [0, 1, 2, 9])
def test_a_line_or_less_has_fewer_than_three_corners(count):
    assert len(convex_hull(np.arange(count)[:, None] * np.array([[1.0, 2.0]]))) < 3
    assert len(convex_hull(np.ones((count, 2)))) < 3


def test_what_looks_the_same_from_all_sides_is_taken_as_most_files_are():
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
    up, sure = guess_up_axis(g)
    assert up == "-y" and sure < 0.4
