"""The shadow of a removed object: its light from what the surface shows, and what it leaves to points."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from prepare.inpaint.hole_views import Surroundings
from prepare.inpaint.object_shadow import DARKEST, ObjectShadow, find_shadow, fit_light, half_sphere, without_shadow
from prepare.inpaint.support_surface import SupportSurface, SurfaceTexture, goes_on
from tests.support.samples import discs

N, J = 600, 24


class Screen:
    """Light that a thing lets pass: the same to all points."""

    def __init__(self, passing):
        self._passing = np.asarray(passing, float)

    def passing(self, points, bias):
        return np.broadcast_to(self._passing, (len(points), len(self._passing)))


@pytest.fixture
def shaded():
    """Texels under light from J directions, a third of it lost: shown (N,), hidden (N, J), places (N, 2), b (J,)."""
    rng = np.random.default_rng(0)
    across, b = rng.uniform(-0.5, 0.5, (N, 2)), np.zeros(J)
    foot = rng.uniform(-0.3, 0.3, (J, 2))  # the shadow from each direction falls elsewhere
    hidden = np.exp(-((across[:, None] - foot) ** 2).sum(axis=2) / 0.08) / J
    b[::3] = 1.5
    light = 0.6 * (1.0 + 0.3 * across[:, 0])
    return light * (1.0 - hidden @ b) * (1.0 + 0.03 * rng.normal(size=N)), hidden, across, b


def test_light_is_found_from_its_shadow(shaded):
    shown, hidden, across, b = shaded
    found = fit_light(shown, hidden, across)
    assert np.abs(hidden @ found - hidden @ b).max() < 0.05


def test_marks_on_the_surface_are_no_shadow(shaded):
    """A dark spot of a twelfth of the surface."""
    shown, hidden, across, b = shaded
    spot = (across[:, 0] + 0.3) ** 2 + (across[:, 1] - 0.3) ** 2 < 0.15**2
    found = fit_light(np.where(spot, 0.25 * shown, shown), hidden, across)
    assert np.abs(hidden @ found - hidden @ b).max() < 0.08


def test_a_surface_without_a_shadow_stays(shaded):
    """Neither noise nor light that falls off is a shadow."""
    _, hidden, across, _ = shaded
    shown = 0.5 * (1.0 + 0.4 * across[:, 1]) * (1.0 + 0.1 * np.random.default_rng(1).normal(size=N))
    assert (hidden @ fit_light(shown, hidden, across)).max() < 0.045


def test_another_material_around_the_foot_is_no_shadow(shaded):
    """Wood on a white wall, as wide as the shadow would be; and where both are, only the shadow is found."""
    shown, hidden, across, b = shaded
    near, noise = (across**2).sum(axis=1) < 0.28**2, np.exp(0.02 * np.random.default_rng(2).normal(size=N))
    assert (hidden @ fit_light(np.where(near, 0.25, 1.0) * noise, hidden, across)).max() < 0.05
    found = fit_light(np.where(near, 0.5, 1.0) * shown, hidden, across)
    assert np.abs(hidden @ found - hidden @ b).max() < 0.15


def test_what_an_object_leaves():
    """Its own part of a common shadow, only on the side that faces the light, and DARKEST at least."""
    directions = half_sphere(J)
    up, down, lost = [[0.0, 0.0, 1.0]], [[0.0, 0.0, -1.0]], np.full(J, 0.8) / directions[:, 2].sum()
    half = np.arange(J) % 2 == 0
    none, own, all_of_it = Screen(np.ones(J)), Screen(~half), Screen(np.zeros(J))

    def left(thing, others, normals, share=1.0):
        return ObjectShadow(directions, share * lost, thing, others, 0.0).left(np.zeros((1, 3)), np.array(normals))[0]

    assert left(none, None, up) == 1.0 and left(own, None, down) == 1.0
    assert left(own, None, up) == pytest.approx(0.6, abs=0.02)
    assert left(own, Screen(half), up) == pytest.approx(0.2 / 0.6, abs=0.02)  # the others have the other half
    assert left(own, own, up) == pytest.approx(1.0)  # they shade all of it anyhow
    assert left(all_of_it, None, up, share=2.0) == DARKEST


class PlateDrawing:
    """A drawing of a round plate of radius 1 around the origin, across z, whose depth is noisy."""

    def __init__(self):
        self._rng = np.random.default_rng(0)

    def replace(self, thing):
        pass

    def picture(self, camera):
        y, x = np.mgrid[: camera.height, : camera.width] + 0.5
        rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], axis=-1)
        rays = rays @ camera.world_to_camera[:3, :3]
        depth = -camera.position[2] / rays[..., 2]
        on = np.linalg.norm((camera.position + depth[..., None] * rays)[..., :2], axis=-1) < 1.0
        depth += 0.02 * self._rng.normal(size=depth.shape)
        return None, np.where(on, depth, np.inf).astype(np.float32), on.astype(np.float32)


@pytest.fixture
def plate():
    """The shadow of a plate of radius 1 that floats 1 m over a floor."""
    floor, seen = SupportSurface(np.array([0.0, 0.0, -1.0]), np.eye(3), 0.01), np.ones((40, 40), bool)
    texture = SurfaceTexture(floor, np.full(2, -1.7), 0.085, np.full((40, 40, 3), 0.5), seen, ~seen)
    turn = np.arange(100) * 0.02 * np.pi
    thing = SimpleNamespace(means=np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1))
    return find_shadow(PlateDrawing(), thing, (), texture, Surroundings(np.zeros(3), 1.0))


def test_a_noisy_surface_does_not_shade_itself_but_what_is_close_behind(plate):
    steep = plate.directions[:, 2] > 0.8
    x, y = (a.ravel() for a in np.mgrid[-0.6:0.6:12j, -0.6:0.6:12j])
    on, behind = (plate.own.passing(np.stack([x, y, 0.0 * x - h], axis=1), plate.bias)[:, steep] for h in (0.0, 0.14))
    assert on.mean() > 0.95 and behind.mean() < 0.05


def test_the_light_of_a_shadow_map_is_nearly_parallel(plate):
    toward, edge = plate.directions[0], np.cross(plate.directions[0], [1.0, 0.0, 0.0])
    inside, outside = (s * edge / np.linalg.norm(edge) - 2.0 * toward for s in (0.9, 1.35))
    assert plate.own.passing(inside[None], plate.bias)[0, 0] < 0.1
    assert plate.own.passing(outside[None], plate.bias)[0, 0] > 0.9


def test_a_shadow_is_taken_from_the_surroundings_only():
    """Four radii away the colours change; ten radii away they stay bit for bit."""
    x, y = (a.ravel() for a in np.mgrid[-12:12:49j, -12:12:49j])
    floor, directions = discs(np.stack([x, y, 0.0 * x], axis=1), 0.05), half_sphere(J)
    shadow = ObjectShadow(directions, np.full(J, 0.5) / directions[:, 2].sum(), Screen(np.zeros(J)), None, 0.0)
    view = SimpleNamespace(camera=SimpleNamespace(position=np.array([0.0, 3.0, 5.0])))
    lit, away = without_shadow(floor, shadow, Surroundings(np.zeros(3), 1.0), [view]).sh, np.hypot(x, y)
    assert (lit[away < 4.0] > 0.5).all() and not lit[away > 10.0].any()


def test_an_edge_goes_on_as_it_runs_beside_the_hole():
    """The nearest texels that were seen would leave a wedge of a table whose edge an object hides."""
    y, x = np.mgrid[:96, :96]
    table = x + 0.1 * y < 60
    unseen = (x > 25) & (x < 75) & (y > 25) & (y < 70)
    unseen |= np.abs(x + 0.1 * y - 60) < 2  # the edge itself is blurred
    found = goes_on(table & ~unseen, ~table & ~unseen)
    assert (found == table)[np.abs(x + 0.1 * y - 60) > 3].all()
    assert_array_equal(goes_on(table & ~unseen, np.zeros_like(table)), True)
    assert not goes_on(np.zeros_like(table), ~table).any()
