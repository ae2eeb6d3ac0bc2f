"""Softest modes of bodies: rigid ones included, as soft as linear finite elements."""

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from numpy.testing import assert_allclose

from bench.physics import BAR, LEFT, SURFACE, TETS, box, fem_stiffness
from core.material import Material
from sim.bodies import SoftBody
from sim.elastic.modal_correction import MODES, lattice_motions, modes_of, softest_modes
from sim.model import RestShape
from sim.time_step import lame


def weighted(U, mass):
    """Modes as columns (3 V, MODES), orthonormal if they are so in the masses."""
    return (np.sqrt(mass)[:, None, None] * U).transpose(0, 2, 1).reshape(-1, MODES)


def test_the_modes_are_the_rigid_ones_and_the_softest():
    """Orthonormal in the masses; no softer than linear FEM, and the first elastic ones at most 20% faster."""
    material = Material(1e7, 0.3, 1000.0)
    mass = SoftBody("bar", BAR, TETS, SURFACE, material).masses()
    mu, lam = lame(material)
    for movable in (np.ones(len(BAR), bool), ~np.isin(np.arange(len(BAR)), LEFT)):
        U, squares = softest_modes(lattice_motions(BAR, TETS, mass, movable), mu, lam - mu)
        assert U.shape == (len(BAR), MODES, 3) and (U[~movable] == 0).all()
        flat = weighted(U, mass)
        assert_allclose(flat.T @ flat, np.eye(MODES), atol=1e-5)
        free = np.repeat(movable, 3)
        K = fem_stiffness(BAR, TETS, material.young, material.poisson)[free][:, free]
        exact = spla.eigsh(K, 10, sp.diags(np.repeat(mass, 3)[free]), sigma=-1.0, return_eigenvectors=False)
        ratio = np.sqrt(squares[6:10] / np.sort(exact)[6:10])
        assert (ratio > 0.999).all() and (ratio < 1.2).all()
        if movable.all():
            assert np.sqrt(squares[:6]).max() < 1e-3 * np.sqrt(squares[6])


def test_modes_of_another_size_and_material_are_derived_from_those_of_the_shape():
    """The same as those of the larger, denser mesh itself, without its integrals over the tets."""
    material, factor = Material(2e6, 0.45, 930.0), 1.7
    shape = RestShape(BAR, TETS, SURFACE, None).scaled(factor)
    U, squares = modes_of(shape, (False,) * len(BAR), material)
    mass = material.density * shape.vertex_volumes
    mu, lam = lame(material)
    _, wanted = softest_modes(lattice_motions(factor * BAR, TETS, mass, np.ones(len(BAR), bool)), mu, lam - mu)
    assert_allclose(squares, wanted, rtol=1e-6, atol=1e-6 * wanted[6])
    flat = weighted(U, mass)
    assert_allclose(flat.T @ flat, np.eye(MODES), atol=1e-9)


def test_a_stiffer_and_denser_body_has_the_modes_that_are_known(monkeypatch):
    """The eigenvalue problem is that of a mesh and of Poisson's ratio: it would hold up play for each material."""
    shape, pinned = RestShape(BAR, TETS, SURFACE, None), (False,) * len(BAR)
    U, squares = modes_of(shape, pinned, Material(1e4, 0.3, 100.0))
    monkeypatch.setattr("sim.elastic.modal_correction.softest_modes", None)
    stiff, stiff_squares = modes_of(shape, pinned, Material(1e6, 0.3, 400.0))
    assert_allclose(stiff_squares, 25 * squares, rtol=1e-12)
    assert_allclose(stiff, U / 2, rtol=1e-12)


@pytest.mark.parametrize("cells", [(1, 1, 1), (2, 2, 2), (3, 1, 3), (6, 1, 1), (9, 9, 1)])
def test_a_mesh_coarser_than_its_lattice_has_all_rigid_modes(cells):
    """The lattice then moves in ways that no vertex follows; once those were all the modes of such a body."""
    x, tets, surface = box((0.08, 0.02, 0.06), cells)
    x = x - x.mean(0)
    material = Material(1e7, 0.3, 1000.0)
    mass = SoftBody("box", x, tets, surface, material).masses()
    mu, lam = lame(material)
    U, squares = softest_modes(lattice_motions(x, tets, mass, np.ones(len(x), bool)), mu, lam - mu)
    flat = weighted(U, mass)
    count = min(MODES, 3 * len(x))
    assert_allclose(flat.T @ flat, np.diag(np.arange(MODES) < count), atol=1e-9)
    for axis in np.eye(3):
        for motion in (np.tile(axis, (len(x), 1)), np.cross(axis, x)):
            wanted = (np.sqrt(mass)[:, None] * motion).ravel()
            assert_allclose(flat[:, :6] @ (flat[:, :6].T @ wanted), wanted, atol=1e-9)
    assert np.sqrt(squares[:6]).max() < 1e-3 * np.sqrt(squares[6])
