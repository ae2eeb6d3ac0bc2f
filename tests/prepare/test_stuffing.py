"""Isosurface stuffing: angles, volumes and topology of cages of known shapes."""

import time

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.ndimage import gaussian_filter

from core.errors import BadInput
from core.tetmesh import boundary_surface, face_components, tet_volumes
from prepare.cage.mesh_quality import dihedral_angles, euler_characteristic, non_manifold_vertices
from prepare.cage.stuffing import stuff

SPACING = 0.05


def sampled(distance, half_size=2.3):
    """Values, origin and spacing of a distance function on a cube."""
    axis = np.arange(-half_size, half_size + SPACING / 2, SPACING)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)
    return distance(points), np.full(3, -half_size), SPACING


def sphere(p, centre=(0, 0, 0), radius=1.0):
    return np.linalg.norm(p - np.asarray(centre), axis=-1) - radius


def torus(p, major=1.0, minor=0.25):
    return np.hypot(np.hypot(p[..., 0], p[..., 2]) - major, p[..., 1]) - minor


def box(p, half_size):
    q = np.abs(p) - half_size
    return np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(-1), 0)


def two_blobs(p):
    return np.minimum(sphere(p, (1.2, 0, 0)), sphere(p, (-1.2, 0, 0), 0.7))


def kissing(p):
    return np.minimum(sphere(p, (1.0, 0.03, 0.02), 1.001), sphere(p, (-1.0, 0, 0), 1.0))


def bumpy(p, seed):
    rng = np.random.default_rng(seed)
    waves = sum(np.sin(p @ rng.normal(size=3) * 2.5 + rng.uniform(0, 6)) for _ in range(6))
    return np.maximum(0.2 * waves, sphere(p, radius=1.6))


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
    """Positive volumes, good angles, a closed manifold of the right genus, one piece, the right volume."""
    distance, cell, volume, tolerance, euler = SHAPES[name]
    cage = stuff(*sampled(distance), cell=cell)
    cage.check(name)
    assert dihedral_angles(cage.vertices, cage.tets).min() >= 10
    assert len(non_manifold_vertices(cage.surface)) == 0
    assert euler_characteristic(cage.surface) == euler
    assert face_components(cage.tets).max() == 0
    assert_allclose(tet_volumes(cage.vertices, cage.tets).sum(), volume, rtol=tolerance)


def test_a_ring_of_few_vertices_stays_a_ring():
    cage = stuff(*sampled(torus), cell=0.25 / 0.8)
    assert 150 <= len(cage.vertices) <= 300
    assert euler_characteristic(cage.surface) == 0


@pytest.mark.parametrize("seed", range(4))
def test_any_shape_stays_sound(seed):
    """Rough shapes with handles and pinches: the bounds hold for them, too."""
    cage = stuff(*sampled(lambda p: bumpy(p, seed)), cell=0.25)
    cage.check("bumpy")
    assert dihedral_angles(cage.vertices, cage.tets).min() >= 10
    assert len(non_manifold_vertices(cage.surface)) == 0


@pytest.mark.parametrize("seed", range(6))
def test_noise_gives_positive_tets_and_a_manifold(seed):
    """Nothing about the field may be assumed: white noise has every sign pattern there is."""
    rng = np.random.default_rng(seed)
    noise = gaussian_filter(rng.normal(size=(14, 14, 14)), rng.uniform(0, 1.5))
    cage = stuff(noise, np.zeros(3), 1.0, cell=rng.uniform(0.8, 2.5), whole=False)
    assert (tet_volumes(cage.vertices, cage.tets) > 0).all()
    assert dihedral_angles(cage.vertices, cage.tets).min() >= 9  # measured: 9.6 over 40 seeds
    assert len(non_manifold_vertices(cage.surface)) == 0


def test_bodies_that_touch_in_a_point_do_not_pinch():
    cage = stuff(*sampled(kissing), cell=0.2)
    assert len(non_manifold_vertices(cage.surface)) == 0


def test_all_pieces_are_kept_if_asked():
    cage = stuff(*sampled(two_blobs), cell=0.2, whole=False)
    assert face_components(cage.tets).max() == 1
    assert_allclose(tet_volumes(cage.vertices, cage.tets).sum(), 4 / 3 * np.pi * (1 + 0.7**3), rtol=0.03)


def test_a_shape_cut_by_the_grid_is_closed_there():
    values, origin, spacing = sampled(sphere)
    cage = stuff(values[: len(values) // 2], origin, spacing, cell=0.2)
    cage.check("half a sphere")
    assert euler_characteristic(cage.surface) == 2


def test_the_cage_follows_the_grid():
    """Scaling and moving the grid scales and moves the cage and changes nothing else."""
    values, origin, spacing = sampled(torus)
    here = stuff(values, origin, spacing, cell=0.2)
    there = stuff(values * 0.01, origin * 0.01 + [3, -2, 1], spacing * 0.01, cell=0.002)
    assert_allclose(there.vertices, here.vertices * 0.01 + [3, -2, 1], atol=1e-6)
    assert (there.tets == here.tets).all()


def test_ten_thousand_vertices_take_about_a_second():
    grid = sampled(sphere)
    begin = time.process_time()
    cage = stuff(*grid, cell=0.1)
    assert len(cage.vertices) > 10_000
    assert time.process_time() - begin < 5  # 0.3 s on a quiet core


@pytest.mark.parametrize(
    "values, message",
    [(np.ones((5, 5, 5)), "empty"), (np.full((5, 5, 5), np.nan), "not finite")],
)
def test_what_has_no_inside_is_refused(values, message):
    with pytest.raises(BadInput, match=message):
        stuff(values, np.zeros(3), 1.0, cell=1.0)


def test_a_lattice_beyond_memory_is_refused():
    with pytest.raises(BadInput, match="too fine"):
        stuff(*sampled(sphere), cell=1e-3)


def test_the_quality_measures_see_defects():
    """One regular tet: angles of 70.5 degrees; two tets sharing an edge or a vertex only are no manifold."""
    x = np.array([[0, 0, 0], [1, 1, 0], [0, 1, 1], [1, 0, 1], [-1, -1, 0], [-1, 0, -1], [0, -1, -1]], float)
    tet = np.array([[0, 1, 2, 3]])
    assert_allclose(dihedral_angles(x, tet), np.degrees(np.arccos(1 / 3)))
    assert_allclose(tet_volumes(x, tet), [1 / 3])
    assert len(boundary_surface(tet)) == 4 and len(non_manifold_vertices(boundary_surface(tet))) == 0
    assert (non_manifold_vertices(boundary_surface(np.array([[0, 1, 2, 3], [0, 4, 5, 6]]))) == [0]).all()
    assert (non_manifold_vertices(boundary_surface(np.array([[0, 1, 2, 3], [0, 1, 5, 6]]))) == [0, 1]).all()
    assert (face_components(np.array([[0, 1, 2, 3], [0, 4, 5, 6], [1, 2, 3, 4]])) == [0, 1, 0]).all()
