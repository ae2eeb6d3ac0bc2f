"""Faces, volumes and components of tetrahedral meshes."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.physics import box
from core.tetmesh import (
    INDEX_BITS,
    boundary_surface,
    enclosed_volume,
    face_components,
    shared_face_pairs,
    tet_faces,
    tet_volumes,
    vertex_components,
    vertex_set_keys,
)


def test_a_box_has_its_volume_surface_and_inner_faces():
    x, tets, surface = box((1.0, 2.0, 3.0), (2, 3, 4))
    assert_allclose(tet_volumes(x, tets), np.linalg.det(x[tets[:, 1:]] - x[tets[:, :1]]) / 6)
    assert_allclose(tet_volumes(x, tets).sum(), 6.0)
    assert_allclose(enclosed_volume(x + 100.0, boundary_surface(tets)), 6.0)
    assert len(surface) == 2 * 2 * (2 * 3 + 3 * 4 + 4 * 2)
    faces, pairs = tet_faces(tets), shared_face_pairs(tets)
    assert_array_equal(np.sort(faces[pairs[:, 0]]), np.sort(faces[pairs[:, 1]]))
    assert 2 * len(pairs) + len(surface) == 4 * len(tets) and (np.diff(pairs[:, 0]) > 0).all()


@pytest.mark.parametrize("width", [2, 3])
@pytest.mark.parametrize("largest", [9, 1 << INDEX_BITS])  # beyond this the keys do not fit one number
def test_keys_are_equal_for_the_same_vertices_alone(width, largest):
    rng = np.random.default_rng(0)
    rows = rng.integers(0, 9, (300, width)) * (largest // 9)
    rows[0, 0] = largest
    _, expected = np.unique(np.sort(rows), axis=0, return_inverse=True)
    _, found = np.unique(vertex_set_keys(rows), return_inverse=True)
    assert len(np.unique(np.stack([expected.ravel(), found], 1), axis=0)) == expected.max() + 1 == found.max() + 1


@pytest.mark.parametrize("seed", range(3))
def test_components_of_chains_of_tets(seed):
    """Chains whose tets share faces, then two of them joined at a vertex alone."""
    rng = np.random.default_rng(seed)
    lengths = rng.integers(1, 60, 7)
    starts = np.cumsum(lengths + 3) - lengths - 3
    chain = np.repeat(np.arange(7), lengths)
    tets = np.concatenate([s + np.arange(n)[:, None] + np.arange(4) for s, n in zip(starts, lengths, strict=True)])
    shuffled = rng.permutation(len(tets))
    tets, chain = rng.permutation(tets.max() + 1)[tets[shuffled]], chain[shuffled]
    for found in (face_components(tets), vertex_components(tets)):
        assert len(np.unique(np.stack([found, chain], 1), axis=0)) == 7
        assert (np.diff(np.bincount(found)) <= 0).all()  # the largest first
    a, b = tets[chain == 0][0, 0], tets[chain == 1][0, 0]
    joined = np.where(tets == a, b, tets)
    assert face_components(joined).max() == 6 and vertex_components(joined).max() == 5
