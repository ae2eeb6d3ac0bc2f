"""The shadow of a removed object: its light from what the surface shows, and what it leaves to points."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from prepare.inpaint.object_shadow import DARKEST, ObjectShadow, fit_light, half_sphere
from prepare.inpaint.surface_texture import goes_on

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


def test_directions_are_spread_over_the_half_sphere():
    directions = half_sphere(64)
    assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    assert (directions[:, 2] > 0).all()
    assert_allclose(directions.mean(axis=0), [0.0, 0.0, 0.5], atol=0.02)  # of the even half sphere


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
