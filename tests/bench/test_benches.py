"""`vrgs.py bench`: the smallest run of each measurement."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from assets.asset import Asset, Cage
from assets.gaussians import Gaussians
from bench import bar_figures, render_speed
from bench import render_speed as rooms
from bench.physics import random_gaussians, tet_bar
from core.tetmesh import boundary_surface


def test_a_room_is_the_same_whether_its_harmonics_are_made_in_chunks_or_at_once(monkeypatch):
    whole = rooms.room(3000)
    monkeypatch.setattr(rooms, "SH_CHUNK", 700)
    chunks = rooms.room(3000)
    for name in Gaussians.__dataclass_fields__:
        assert_array_equal(getattr(chunks, name), getattr(whole, name))


def test_a_slow_device_draws_three_pictures_and_no_more():
    drawn = []
    assert len(render_speed.times(drawn.append, lambda: None, 32, 32, 50, warm=2, most=0.0)) == 3 and len(drawn) == 5
    assert len(render_speed.times(drawn.append, lambda: None, 32, 32, 4)) == 4


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
    measured = bar_figures.measure_ablations("bar", bar, ["180 degrees"], draw=True)
    (one, (_, redder)), (two, (picture, errors)) = measured
    assert (picture != errors).any() and redder.mean() < errors.mean() - 0.1
    assert two["jump"] < 0.5 * one["jump"] and two["spikes"] <= one["spikes"] < 0.01
    assert 0.05 < two["error"] < 1.2 * one["error"] < 0.6
    assert picture.shape[0] == bar_figures.PANEL and (picture < 200).mean() > 0.02


def test_the_time_of_a_picture_is_measured(ti_cpu):
    row = render_speed.measure(500, 64, 48, rounds=2)
    assert row["pairs"] > 100 and 0 < row["median_ms"] <= row["worst_ms"] and row["views"] == 2
