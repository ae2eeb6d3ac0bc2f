"""The Z-order curve."""

import numpy as np

from core.morton import morton_order


def test_a_grid_is_walked_octant_by_octant():
    i, j, k = np.meshgrid(*[np.arange(4)] * 3, indexing="ij")
    points = np.stack([i, j, k], -1).reshape(-1, 3).astype(np.float32)
    points = points[np.random.default_rng(0).permutation(64)]
    walked = points[morton_order(points)].astype(int)
    assert (walked[:8] // 2 == 0).all() and (walked[-8:] // 2 == 1).all()
    assert [tuple(p) for p in walked[:3]] == [(0, 0, 0), (1, 0, 0), (0, 1, 0)]


def test_every_point_is_there_once_and_ties_keep_their_order():
    rng = np.random.default_rng(1)
    assert sorted(morton_order(rng.normal(size=(1000, 3)))) == list(range(1000))
    assert list(morton_order(np.ones((5, 3)))) == list(range(5))
    assert len(morton_order(np.zeros((0, 3)))) == 0
