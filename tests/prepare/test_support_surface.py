"""Support surfaces from points around a ball of radius 1 at the origin: planes that carry it."""

from types import SimpleNamespace

import numpy as np
import pytest

from prepare.inpaint.hole_views import Surroundings
from prepare.inpaint.object_shadow import half_sphere
from prepare.inpaint.support_surface import PARALLEL, SupportSurface, normals_of, support_surfaces

ABOVE = 3.0 * half_sphere(9)[:, [0, 2, 1]]
IN_CORNER = np.array([[x, y, 3.0] for x in (1.0, 3.0) for y in (1.0, 2.0)])


def ball() -> np.ndarray:
    directions = half_sphere(250)
    return np.concatenate([directions, -directions])


def level(count: int, height: float) -> np.ndarray:
    """Noisy points (count, 3) of the plane y = height around the ball, not inside it."""
    rng = np.random.default_rng(count)
    points = np.stack([*rng.uniform(-1.7, 1.7, (2, 9 * count)), height + 0.01 * rng.normal(size=9 * count)], axis=1)
    away = np.linalg.norm(points, axis=1)
    return points[(away < 1.7) & (away > 1.0)][:count, [0, 2, 1]]


def ring(count: int, inner: float, outer: float, height: float) -> np.ndarray:
    """Noisy points (count, 3) of a level ring around the ball's axis."""
    rng = np.random.default_rng(count)
    radius, turn = np.sqrt(rng.uniform(inner**2, outer**2, count)), rng.uniform(0.0, 2.0 * np.pi, count)
    return np.stack([radius * np.cos(turn), height + 0.01 * rng.normal(size=count), radius * np.sin(turn)], axis=1)


def clutter() -> np.ndarray:
    """Points everywhere around the ball but under it."""
    rng = np.random.default_rng(3)
    points = rng.normal(size=(4000, 3))
    points *= (rng.uniform(1.0, 1.7, 4000) / np.linalg.norm(points, axis=1))[:, None]
    return points[points[:, 1] > -0.9]


@pytest.fixture
def planes(monkeypatch):
    """Support surfaces of the ball among points, for each of some seeds."""

    def of(*points, eyes=ABOVE, seeds=(0,)) -> list[list[SupportSurface]]:
        seen = np.concatenate(points)
        normals = normals_of(seen)
        monkeypatch.setattr("prepare.inpaint.support_surface.rim_points", lambda *_: (seen, normals))
        views, around = (
            [SimpleNamespace(camera=SimpleNamespace(position=e)) for e in eyes],
            Surroundings(np.zeros(3), 1),
        )
        return [support_surfaces(views, ball(), around, np.random.default_rng(seed)) for seed in seeds]

    return of


def height(surface: SupportSurface) -> float:
    """Height of a level surface."""
    assert surface.axes[2][1] > 0.99
    return surface.origin[1]


def test_an_object_sinks_into_a_carpet(planes):
    ((carpet,),) = planes(level(2000, -0.86))
    assert height(carpet) == pytest.approx(-0.86, abs=0.02)


def test_what_cuts_through_an_object_does_not_carry_it(planes):
    ((floor,),) = planes(level(3000, -1.0), level(4000, -0.6))
    assert height(floor) == pytest.approx(-1.0, abs=0.02)


def test_an_object_in_a_corner_has_three_supports(planes):
    floor = level(1500, -1.0)
    floor = floor[(floor[:, 0] > -1.0) & (floor[:, 2] > -1.0)]
    (found,) = planes(floor, floor[:, [1, 0, 2]], floor[:, [0, 2, 1]], eyes=IN_CORNER)
    np.testing.assert_allclose(np.sum([s.axes[2] for s in found], axis=0), 1.0, atol=0.05)
    assert len(found) == 3


def test_a_floor_that_was_not_seen_close_to_an_object_carries_it_beside_a_wall_that_was(planes):
    floor, wall = level(3000, -1.0), level(1500, -1.0)[:, [1, 0, 2]]
    floor = floor[(floor[:, 0] > -1.0) & (np.linalg.norm(floor, axis=1) > 1.12)]
    (found,) = planes(floor, wall[wall[:, 1] > -1.0], eyes=IN_CORNER)
    assert len(found) == 2 and height(found[1]) == pytest.approx(-1.0, abs=0.02)


def test_the_ground_below_does_not_tilt_the_top_of_a_plinth(planes):
    ((top,),) = planes(ring(300, 0.5, 0.8, -1.0), ring(5000, 0.85, 1.2, -1.18))
    assert height(top) == pytest.approx(-1.0, abs=0.02) and top.axes[2][1] > 0.998


def test_clutter_is_no_support(planes):
    assert planes(clutter()) == [[]]


def test_a_floor_is_found_among_clutter(planes):
    """Three points of it are seldom drawn, but each of its points beside the ball tells the plane."""
    for found in planes(clutter(), level(500, -1.0), seeds=range(1, 9)):
        assert height(found[0]) == pytest.approx(-1.0, abs=0.02)


def test_normals_are_of_the_surface_and_not_of_its_noise():
    """Of two walls 2 m long that meet, with 450 points/m^2 each to 3 cm; all but at their edge."""
    rng = np.random.default_rng(0)
    wall = np.stack([rng.uniform(0, 1, 800), 0.03 * rng.normal(size=800), rng.uniform(-1, 1, 800)], axis=1)
    normals = np.abs(normals_of(np.concatenate([wall, wall[:, [1, 0, 2]]])))
    assert (np.concatenate([normals[:800, 1], normals[800:, 0]]) > PARALLEL).mean() > 0.955
