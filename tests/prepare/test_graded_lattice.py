"""A lattice of cells of several sizes: conforming, well shaped, as fine as asked; and what is stuffed from it."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

from core.errors import BadInput
from core.tetmesh import TET_FACES, boundary_surface, tet_volumes
from prepare.cage.graded_lattice import graded_lattice, refined
from prepare.cage.mesh_quality import dihedral_angles, non_manifold_vertices
from prepare.cage.stuffing import stuff_lattice
from tests.prepare.test_stuffing import bumpy, sampled, sphere


def upright(at, tets):
    flipped = tet_volumes(at, tets) < 0
    return np.where(flipped[:, None], tets[:, [0, 1, 3, 2]], tets)


@pytest.mark.parametrize("seed", range(4))
def test_cells_of_all_sizes_fit_together(seed):
    """Each face belongs to two tets but at the border of the box, and no tet is worse than half a cube's."""
    rng = np.random.default_rng(seed)
    shape = (32, 24, 16)
    want = np.where(rng.uniform(size=shape) < 0.004, rng.integers(1, 4, shape), 0)
    lattice = graded_lattice(want, 3)
    tets = upright(lattice.at, lattice.tets)
    angles = dihedral_angles(lattice.at, tets)
    assert angles.min() > 44.99 and angles.max() < 120.01
    _, times = np.unique(np.sort(tets[:, TET_FACES].reshape(-1, 3), axis=1), axis=0, return_counts=True)
    assert times.max() == 2
    surface = boundary_surface(tets)
    assert len(non_manifold_vertices(surface)) == 0
    middle = lattice.at[surface].mean(1)
    widest = 16  # of a cell
    assert ((middle < widest / 2) | (middle > 2 * np.array(shape) - widest / 2)).any(1).all()


def test_cells_are_as_fine_as_asked_and_neighbours_alike():
    want = np.zeros((32, 32, 32), np.int8)
    want[5, 6, 7], want[20, 20, 20] = 3, 2
    divided = refined(want, 3)
    assert divided[0][0, 0, 0] and divided[1][1, 1, 1] and divided[2][2, 3, 3]
    assert divided[1][5, 5, 5] and not divided[2][10, 10, 10]
    assert not divided[0][3, 0, 0]
    for coarse, fine in pairwise(divided):
        for cell in np.argwhere(fine):  # all 26 neighbours exist
            for step in np.ndindex(3, 3, 3):
                beside = np.clip(cell + step - np.ones(3, int), 0, np.array(fine.shape) - 1)
                assert coarse[tuple(beside // 2)]


def test_equal_cells_are_the_usual_lattice():
    """Two vertices a cell, 12 tets, each a twelfth of it."""
    lattice = graded_lattice(np.zeros((6, 6, 6), np.int8), 0)
    assert_allclose(np.abs(tet_volumes(lattice.at, lattice.tets)), 8 / 12)
    assert len(lattice.tets) == 3 * 4 * 5 * 6 * 6
    assert (lattice.size == 2).all()


@pytest.mark.parametrize("seed", range(3))
def test_what_is_stuffed_from_changing_cells_is_sound(seed):
    """Cells of three sizes at random places of a rough surface: positive tets, a closed manifold."""
    values, origin, spacing = sampled(lambda p: bumpy(p, seed))
    rng = np.random.default_rng(seed)
    want = np.kron(rng.integers(0, 3, (6, 6, 6)), np.ones((8, 8, 8), int))
    lattice = graded_lattice(want, 2)
    cage = stuff_lattice(lattice, np.full(3, -2.3), 4.6 / 96, values, origin, spacing)
    cage.check("graded")
    assert len(non_manifold_vertices(cage.surface)) == 0
    assert dihedral_angles(cage.vertices, cage.tets).min() > 2  # before it is relaxed


def test_a_lattice_of_many_vertices_is_sound():
    """More than 46,341: numbers of edges, products of two vertices, pass the end of 32 bits."""
    values, origin, spacing = sampled(sphere)
    lattice = graded_lattice(np.zeros((30, 30, 30), np.int8), 0)
    assert len(lattice.at) > 46_341
    cage = stuff_lattice(lattice, np.full(3, -1.2), 2.4 / 60, values, origin, spacing)
    cage.check("many")


def test_too_fine_a_lattice_is_refused():
    with pytest.raises(BadInput, match="too fine"):
        graded_lattice(np.broadcast_to(np.int8(0), (400, 400, 400)), 2)
