"""Trilinear interpolation of a distance grid."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from core.distance_grid import DistanceGrid

NORMAL = np.array([0.6, 0.0, 0.8])


def plane_grid(dtype=np.float64) -> DistanceGrid:
    """Distance to a plane through the origin, which trilinear interpolation reproduces exactly."""
    grid = DistanceGrid(np.zeros((5, 6, 7), dtype), np.array([-0.5, -0.2, -0.7]), 0.25)
    return DistanceGrid((grid.nodes() @ NORMAL).astype(dtype), grid.origin, grid.spacing)


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-14), (np.float16, 1e-3)])
def test_a_linear_distance_is_reproduced(dtype, tolerance):
    grid = plane_grid(dtype)
    points = np.random.default_rng(0).uniform(grid.origin, grid.upper, (10, 20, 3))
    assert_allclose(grid.sample(points), points @ NORMAL, atol=tolerance)
    assert_allclose(grid.scaled(3.0).sample(3.0 * points), 3.0 * (points @ NORMAL), atol=3 * tolerance + 1e-6)


def test_beyond_the_grid_the_border_counts():
    grid = plane_grid()
    out = np.array([[grid.upper[0] + 0.3, 0.1, grid.upper[2] + 0.4], [grid.origin[0] - 0.3, 0.1, -0.1]])
    border = out.clip(grid.origin, grid.upper)
    assert_allclose(grid.sample(out), border @ NORMAL, atol=1e-14)
