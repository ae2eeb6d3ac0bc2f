"""Splitting of an asset into its connected components."""

import numpy as np
from numpy.testing import assert_allclose

from assets.asset import Asset, Cage, CageEmbedding, split_components
from core.tetmesh import boundary_surface
from tests.support.samples import some_gaussians

TET = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def test_a_corner_in_another_component_comes_home():
    """Two tets far apart; a Gaussian with one corner in the other one keeps its shape."""
    tets = np.arange(8, dtype=np.int32).reshape(2, 4)
    cage = Cage(np.concatenate([TET, TET + [5, 0, 0]]).astype(np.float32), tets, boundary_surface(tets))
    corners = np.array([[0.1, 0.1, 0.1], [0.4, 0.1, 0.1], [0.1, 0.4, 0.1], [0.1, 0.1, 0.4]])
    host = np.array([[0, 0, 1, 0]], np.int32)
    last = corners - 5.0 * host.T * [1, 0, 0]
    weights = np.concatenate([1 - last.sum(1, keepdims=True), last], 1)[None].astype(np.float32)
    first, second = split_components(Asset(some_gaussians(1), cage, CageEmbedding(host, weights)))
    assert len(first.gaussians) == 1 and len(second.gaussians) == 0
    first.check("first")
    again = np.einsum("kj,kjc->kc", first.embedding.weights[0], first.cage.vertices[first.cage.tets[[0] * 4]])
    assert_allclose(again, corners, atol=1e-5)
    assert split_components(first)[0] is first
