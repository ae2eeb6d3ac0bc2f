"""`vrgs.py bench`: the smallest run of each measurement."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assets.asset import Asset, Cage
from bench import bar_figures, render_speed
from core.tetmesh import boundary_surface
from tests.support.samples import random_gaussians, tet_bar


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("turn", [1.3, None])
def test_the_gradients_of_the_ablation_are_those_of_its_motion(turn, axis):
    """Central differences, the ends of the body held in place."""
    rng, deformed = np.random.default_rng(0), bar_figures.deformed
    x = np.concatenate([[[-1.0, -2.0, -3.0], [2.0, 1.0, 3.0]], rng.uniform(-0.9, 0.9, (50, 3))])
    _, F = deformed(x, turn, axis)
    for c in range(3):
        step = np.zeros_like(x)
        step[2:, c] = 1e-5
        slope = (deformed(x + step, turn, axis)[0] - deformed(x - step, turn, axis)[0])[2:] / 2e-5
        assert_allclose(F[2:, :, c], slope, atol=1e-8)


def test_two_levels_are_smoother_than_one_and_the_page_shows_them(ti_cpu):
    """A bar of a few tets twisted by 180 degrees: neighbours differ at most half as much as with one level."""
    from prepare.cage.embedding_hosts import embed

    x, tets = tet_bar((4, 16, 4), (0.1, 0.4, 0.1))
    x = (x - [0.05, 0.0, 0.05]).astype(np.float32)
    low, high = (-0.05, 0, -0.05), (0.05, 0.4, 0.05)
    g = random_gaussians(np.random.default_rng(0), 2000, low=low, high=high, sigma=0.002)
    embedded = embed(g.means, g.quats, np.exp(g.log_scales), x, tets)
    bar = Asset(g, Cage(x, tets, boundary_surface(tets)), embedded)
    (one, _, redder), (two, picture, errors) = bar_figures.measure_ablation(bar, ["180 degrees"])
    assert (picture != errors).any() and redder.mean() < errors.mean() - 0.1
    assert two["jump"] < 0.5 * one["jump"]
    assert 0.05 < two["error"] < 1.2 * one["error"] < 0.6
    assert picture.shape[0] == bar_figures.PANEL and (picture < 200).mean() > 0.02


def test_the_time_of_a_picture_is_measured(ti_cpu):
    row = render_speed.measure(500, 64, 48, rounds=2)
    assert row["pairs"] > 100 and 0 < row["median_ms"] <= row["worst_ms"] and row["views"] == 2
