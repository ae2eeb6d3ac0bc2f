"""What the embedding's benchmark rests on: the formulas' gradients, and its smallest run."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assets.asset import Asset, Cage
from bench.sample_meshes import random_gaussians, tet_bar
from core.tetmesh import boundary_surface


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("turn", [1.3, None])
def test_the_gradients_are_those_of_the_motion(turn, axis):
    """Central differences, the ends of the body held in place."""
    from bench.ablation import moved

    rng = np.random.default_rng(0)
    x = np.concatenate([[[-1.0, -2.0, -3.0], [2.0, 1.0, 3.0]], rng.uniform(-0.9, 0.9, (50, 3))])
    _, F = moved(x, turn, axis)
    for c in range(3):
        step = np.zeros_like(x)
        step[2:, c] = 1e-5
        slope = (moved(x + step, turn, axis)[0] - moved(x - step, turn, axis)[0])[2:] / 2e-5
        assert_allclose(F[2:, :, c], slope, atol=1e-8)


def test_two_levels_are_smoother_and_the_page_is_drawn(ti_cpu):
    """A bar of a few tets twisted by 180 degrees: neighbours differ at most half as much as with one level."""
    from bench.ablation import DEFORMATIONS, SCHEMES, ablation, page
    from display.headless.picture_strip import PANEL
    from prepare.cage.embedding_hosts import embed

    x, tets = tet_bar((4, 16, 4), (0.1, 0.4, 0.1))
    x = (x - [0.05, 0.0, 0.05]).astype(np.float32)
    low, high = (-0.05, 0, -0.05), (0.05, 0.4, 0.05)
    g = random_gaussians(np.random.default_rng(0), 4000, low=low, high=high, sigma=0.002)
    embedded = embed(g.means, g.quats, np.exp(g.log_scales), x, tets)
    bar, rows, pictures = Asset(g, Cage(x, tets, boundary_surface(tets)), embedded), {}, {}
    for scheme in SCHEMES:
        title = "180 degrees"
        rows[scheme], pictures[title, scheme] = ablation("bar", bar, title, DEFORMATIONS[title], scheme, draw=True)
    one, two = (rows[s] for s in SCHEMES)
    assert two["jump"] < 0.5 * one["jump"] and two["spikes"] <= one["spikes"] < 0.01
    assert 0.05 < two["error"] < 1.2 * one["error"] < 0.6
    paper = page([("bar", pictures)])
    assert paper.shape[0] > 2 * PANEL and (pictures["180 degrees", "two-level"] < 200).mean() > 0.02


def test_the_speed_is_measured(ti_cpu):
    from bench.embedding_ablation import deform

    row = deform(3000, 2)
    assert 150 < row["bytes_no_rotation"] < row["bytes"] - 15.9 < 400
    assert abs(row["gb_per_s"] * row["median_ms"] * 1e6 - row["bytes"] * 3000) < 1
