"""Linear elasticity of a cage: modes against a beam's formula, a cut mesh, and the shape that markers give."""

import numpy as np
import scipy.sparse as sp

from core.tetmesh import boundary_surface, enclosed_volume, tet_volumes
from prepare.fit.linear_elasticity import ElasticShape, subdivided
from prepare.fit.marker_tracks import marker_weights
from tests.support.samples import tet_bar

LENGTH, SIDE = 0.4, 0.04


def beam(cells):
    x, tets = tet_bar(cells, (LENGTH, SIDE, SIDE))
    return x.astype(np.float64), tets, np.flatnonzero(x[:, 0] < 1e-6)


def test_the_slowest_mode_comes_to_a_beams_as_the_cage_is_cut():
    """Euler and Bernoulli: w^2 = 1.875^4 E I / (rho A L^4); linear tets are too stiff, less so the finer they are."""
    exact = 1.8751**4 * SIDE**2 / 12 / LENGTH**4
    x, tets, held = beam((20, 3, 3))
    coarse = ElasticShape(x, tets, held, 0.0, 1).stiffness[0] / exact
    x2, tets2, _ = subdivided(x, tets)
    fine = ElasticShape(x2, tets2, np.flatnonzero(x2[:, 0] < 1e-6), 0.0, 1).stiffness[0] / exact
    assert 1.2 < coarse < 2.5 and 1.0 < fine < coarse
    np.testing.assert_allclose(fine + (fine - coarse) / 3, 1.0, atol=0.06)  # errors fall with the edges' square


def test_free_modes_leave_out_the_rigid_ones():
    x, tets, _ = beam((6, 2, 2))
    shape = ElasticShape(x, tets, np.zeros(0, int), 0.3, 2)
    assert shape.stiffness[0] > 1e-2 / LENGTH**2
    rigid = np.stack([*np.tile(np.eye(3)[:, None], (1, len(x), 1)), *(np.cross(axis, x) for axis in np.eye(3))])
    along = np.einsum("kvi,v,rvi->kr", shape.modes, shape.mass, rigid) / shape.mass.sum()
    np.testing.assert_allclose(along, 0, atol=1e-6)
    np.testing.assert_allclose((shape.modes**2).sum(2).mean(1), 1.0)


def test_a_cut_mesh_fills_the_same_volume_with_its_old_vertices_first():
    x, tets, _ = beam((3, 2, 1))
    rng = np.random.default_rng(0)
    x += 0.002 * rng.normal(size=x.shape)
    new, small, W = subdivided(x, tets)
    assert len(small) == 8 * len(tets) and (tet_volumes(new, small) > 0).all()
    np.testing.assert_allclose(tet_volumes(new, small).sum(), tet_volumes(x, tets).sum())
    np.testing.assert_allclose(enclosed_volume(new, boundary_surface(small)), tet_volumes(x, tets).sum())
    np.testing.assert_array_equal(new[: len(x)], x)
    np.testing.assert_allclose(W @ np.ones(len(x)), 1.0)


def test_markers_give_back_the_deformation_that_moved_them():
    x, tets, held = beam((10, 2, 2))
    shape = ElasticShape(x, tets, held, 0.3, 2)
    u = 0.01 * shape.modes[0] + 0.004 * shape.modes[1]
    rng = np.random.default_rng(0)
    W = marker_weights(x, tets, rng.uniform(0, 1, (30, 3)) * [LENGTH, SIDE, SIDE], "here")
    assert sp.issparse(W)
    found = shape.through(W, np.tile(np.eye(3), (30, 1, 1)), W @ u)
    assert np.abs(found[held]).max() == 0
    np.testing.assert_allclose(found, u, atol=0.05 * np.abs(u).max())
