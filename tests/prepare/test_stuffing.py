"""Isosurface stuffing: lattices of cells of several sizes; angles, volumes and topology of cages of known shapes."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.ndimage import gaussian_filter

from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.tetmesh import TET_FACES, boundary_surface, face_components, tet_volumes
from prepare.cage.mesh_quality import dihedral_angles, euler_characteristic, non_manifold_vertices
from prepare.cage.stuffing import divided_cells, graded_lattice, stuff
from tests.support.distance_shapes import box, bumpy, sampled, sphere, torus, uniform_lattice


def stuffed(grid: DistanceGrid, cell: float):
    return stuff(uniform_lattice(grid, cell), grid)


def two_blobs(p):
    return np.minimum(sphere(p, (1.2, 0, 0)), sphere(p, (-1.2, 0, 0), 0.7))


def kissing(p):
    return np.minimum(sphere(p, (1.0, 0.03, 0.02), 1.001), sphere(p, (-1.0, 0, 0), 1.0))


SHAPES = {  # distance, cell, exact volume, its tolerance, Euler characteristic of the surface
    "sphere": (sphere, 0.2, 4 / 3 * np.pi, 0.02, 2),
    "box": (lambda p: box(p, [1.0, 0.6, 0.4]), 0.2, 1.92, 0.02, 2),
    "thin plate": (lambda p: box(p, [1.0, 0.1, 1.0]), 0.2, 0.8, 0.05, 2),
    "torus, tube of 2 cells": (torus, 0.125, 2 * np.pi**2 * 0.25**2, 0.04, 0),
    "torus, tube of 1.2 cells": (torus, 0.25 / 1.2, 2 * np.pi**2 * 0.25**2, 0.10, 0),
    "torus, tube of 0.8 cells": (torus, 0.25 / 0.8, 2 * np.pi**2 * 0.25**2, 0.25, 0),
    "larger of two blobs": (two_blobs, 0.2, 4 / 3 * np.pi, 0.02, 2),
}


@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_gets_a_sound_cage(name):
    """Positive volumes, good angles, a closed manifold of the right genus, one component, the right volume."""
    distance, cell, volume, tolerance, euler = SHAPES[name]
    cage = stuffed(sampled(distance), cell)
    cage.check(name)
    assert dihedral_angles(cage.vertices, cage.tets).min() >= 10
    assert len(non_manifold_vertices(cage.surface)) == 0
    assert euler_characteristic(cage.surface) == euler
    assert face_components(cage.tets).max() == 0
    assert_allclose(tet_volumes(cage.vertices, cage.tets).sum(), volume, rtol=tolerance)


@pytest.mark.parametrize("distance, cell", [*((lambda p, k=k: bumpy(p, k), 0.25) for k in range(3)), (kissing, 0.2)])
def test_any_shape_stays_sound(distance, cell):
    """Rough shapes with handles and pinches, and balls that touch in a point: the bounds hold for them, too."""
    cage = stuffed(sampled(distance), cell)
    cage.check("rough")
    assert dihedral_angles(cage.vertices, cage.tets).min() >= 10
    assert len(non_manifold_vertices(cage.surface)) == 0


@pytest.mark.parametrize("seed", range(6))
def test_noise_gives_positive_tets_and_a_manifold(seed):
    """Nothing about the field may be assumed: white noise has every sign pattern there is."""
    rng = np.random.default_rng(seed)
    noise = gaussian_filter(rng.normal(size=(14, 14, 14)), rng.uniform(0, 1.5))
    cage = stuffed(DistanceGrid(noise, np.zeros(3), 1.0), rng.uniform(0.8, 2.5))
    assert (tet_volumes(cage.vertices, cage.tets) > 0).all()
    assert dihedral_angles(cage.vertices, cage.tets).min() >= 9  # measured: 9.6 over 40 seeds
    assert len(non_manifold_vertices(cage.surface)) == 0


def test_a_shape_cut_by_the_grid_is_closed_there():
    grid = sampled(sphere)
    cage = stuffed(replace(grid, values=grid.values[: len(grid.values) // 2]), 0.2)
    cage.check("half a sphere")
    assert euler_characteristic(cage.surface) == 2


def test_the_cage_follows_the_grid():
    """Scaling and moving the grid scales and moves the cage and changes nothing else."""
    grid = sampled(torus)
    here = stuffed(grid, 0.2)
    there = stuffed(DistanceGrid(grid.values * 0.01, grid.origin * 0.01 + [3, -2, 1], grid.spacing * 0.01), 0.002)
    assert_allclose(there.vertices, here.vertices * 0.01 + [3, -2, 1], atol=1e-6)
    assert (there.tets == here.tets).all()


def test_what_cannot_be_stuffed_is_refused():
    grid = sampled(sphere)
    with pytest.raises(BadInput, match="thinner than a lattice"):
        stuff(uniform_lattice(grid, 0.5), replace(grid, values=np.ones((5, 5, 5))))
    with pytest.raises(BadInput, match="not finite"):
        stuff(uniform_lattice(grid, 0.5), replace(grid, values=np.full((5, 5, 5), np.nan)))
    with pytest.raises(BadInput, match="too fine"):
        graded_lattice(np.broadcast_to(np.int8(0), (400, 400, 400)), 2)


def test_the_quality_measures_see_defects():
    """One regular tet: angles of 70.5 degrees; two tets sharing an edge or a vertex only are no manifold."""
    x = np.array([[0, 0, 0], [1, 1, 0], [0, 1, 1], [1, 0, 1]], float)
    assert_allclose(dihedral_angles(x, np.array([[0, 1, 2, 3]])), np.degrees(np.arccos(1 / 3)))
    one = [0, 1, 2, 3]
    for tets, bad in (([one], []), ([one, [0, 4, 5, 6]], [0]), ([one, [0, 1, 5, 6]], [0, 1])):
        assert non_manifold_vertices(boundary_surface(np.array(tets))).tolist() == bad


@pytest.mark.parametrize("seed", range(4))
def test_cells_of_all_sizes_fit_together(seed):
    """Each face belongs to two tets but at the border of the box, and no tet is worse than half a cube's."""
    rng = np.random.default_rng(seed)
    shape = (32, 24, 16)
    wanted = np.where(rng.uniform(size=shape) < 0.004, rng.integers(1, 4, shape), 0)
    lattice = graded_lattice(wanted, 3)
    at, tets = lattice.coordinates, lattice.tets
    tets = np.where((tet_volumes(at, tets) < 0)[:, None], tets[:, [0, 1, 3, 2]], tets)
    angles = dihedral_angles(at, tets)
    assert angles.min() > 44.99 and angles.max() < 120.01
    _, times = np.unique(np.sort(tets[:, TET_FACES].reshape(-1, 3), axis=1), axis=0, return_counts=True)
    assert times.max() == 2
    surface = boundary_surface(tets)
    assert len(non_manifold_vertices(surface)) == 0
    middle = at[surface].mean(1)
    widest = 16  # of a cell
    assert ((middle < widest / 2) | (middle > 2 * np.array(shape) - widest / 2)).any(1).all()


def test_cells_are_as_fine_as_asked_and_neighbours_alike():
    wanted = np.zeros((32, 32, 32), np.int8)
    wanted[5, 6, 7], wanted[20, 20, 20] = 3, 2
    divided = divided_cells(wanted, 3)
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
    assert_allclose(np.abs(tet_volumes(lattice.coordinates, lattice.tets)), 8 / 12)
    assert len(lattice.tets) == 3 * 4 * 5 * 6 * 6
    assert (lattice.width == 2).all()


@pytest.mark.parametrize("seed", range(2))
def test_cells_of_three_sizes_at_random_places_give_a_sound_cage(seed):
    """Of a rough surface: positive tets, a closed manifold."""
    rng = np.random.default_rng(seed)
    wanted = np.kron(rng.integers(0, 3, (6, 6, 6)), np.ones((8, 8, 8), int))
    cage = stuff(graded_lattice(wanted, 2, origin=np.full(3, -2.3), unit=4.6 / 96), sampled(lambda p: bumpy(p, seed)))
    cage.check("graded")
    assert len(non_manifold_vertices(cage.surface)) == 0
    assert dihedral_angles(cage.vertices, cage.tets).min() > 2  # before it is relaxed


def test_a_lattice_of_many_vertices_is_sound():
    """More than 46,341: numbers of edges, products of two vertices, pass the end of 32 bits."""
    lattice = graded_lattice(np.zeros((30, 30, 30), np.int8), 0, origin=np.full(3, -1.2), unit=2.4 / 60)
    assert len(lattice.coordinates) > 46_341
    stuff(lattice, sampled(sphere)).check("many")
