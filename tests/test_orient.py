"""The convex hull by hand against SciPy's."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from assets.orient import hull


@pytest.mark.parametrize("seed", range(4))
def test_corners_are_those_of_scipy_and_run_counterclockwise(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(500, 2)) * (1.0, 0.01)
    if seed % 2:  # many on the same lines, many twice
        points = np.round(points * (3, 300)) / 8
    corners = hull(points)
    reference = points[ConvexHull(points).vertices]
    assert {tuple(p) for p in corners} == {tuple(p) for p in reference} and len(corners) == len(reference)
    ahead, back = np.roll(corners, -1, axis=0) - corners, corners - np.roll(corners, 1, axis=0)
    assert (back[:, 0] * ahead[:, 1] > back[:, 1] * ahead[:, 0]).all()


@pytest.mark.parametrize("count", [0, 1, 2, 9])
def test_a_line_or_less_has_fewer_than_three_corners(count):
    assert len(hull(np.arange(count)[:, None] * np.array([[1.0, 2.0]]))) < 3
    assert len(hull(np.ones((count, 2)))) < 3
