"""Marching cubes of a level set, and distances between points and surfaces."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from core.camera import look_at, perspective
from core.errors import BadInput
from prepare.cage.isosurface import (
    areas,
    distance_to_surface,
    distance_to_triangles,
    marching_cubes,
    sampled,
    volume_within,
)
from prepare.cage.mesh_quality import euler_characteristic, non_manifold_vertices
from prepare.mesh_drawing import Canvas, cubes

N, R = 28, 9.0


def sphere(centre=(13.3, 13.9, 14.2)) -> np.ndarray:
    """Signed distance [cells] of a ball of R cells."""
    nodes = np.stack(np.meshgrid(*[np.arange(N)] * 3, indexing="ij"), -1)
    return (np.linalg.norm(nodes - np.asarray(centre), axis=-1) - R).astype(np.float32)


def test_the_surface_of_a_ball():
    """Closed, outward, of the ball's area and volume, placed by origin and spacing; a level further out is larger."""
    origin, spacing = np.array([1.0, -2.0, 0.5]), 0.01
    v, f = marching_cubes(sphere(), origin, spacing)
    assert len(non_manifold_vertices(f)) == 0
    assert euler_characteristic(f) == 2
    assert_allclose(volume_within(v, f), 4 / 3 * np.pi * (R * spacing) ** 3, rtol=0.01)
    assert_allclose(areas(v, f).sum(), 4 * np.pi * (R * spacing) ** 2, rtol=0.01)
    centre = origin + spacing * np.array([13.3, 13.9, 14.2])
    assert_allclose(np.linalg.norm(v - centre, axis=1), R * spacing, atol=0.02 * spacing)
    v, f = marching_cubes(sphere(), origin, spacing, level=2.0)
    assert_allclose(np.linalg.norm(v - centre, axis=1), (R + 2) * spacing, atol=0.02 * spacing)


def test_a_shape_at_the_grids_end_is_closed():
    _, f = marching_cubes(sphere((3, 14, 14)), np.zeros(3), 1.0)
    assert len(non_manifold_vertices(f)) == 0
    with pytest.raises(BadInput, match="no surface"):
        marching_cubes(np.ones((5, 5, 5)), np.zeros(3), 1.0)


def test_distance_to_a_triangle_is_the_smallest_over_its_points():
    """Against the minimum over a fine lattice of the triangle's points."""
    rng = np.random.default_rng(0)
    p, corners = rng.normal(size=(200, 3)), rng.normal(size=(200, 3, 3))
    i, j = np.meshgrid(np.arange(121), np.arange(121), indexing="ij")
    w = np.stack([i, j, 120 - i - j], -1)[i + j <= 120] / 120
    points = np.einsum("wk,nki->nwi", w, corners)
    brute = np.linalg.norm(points - p[:, None], axis=-1).min(1)
    found = distance_to_triangles(p, corners)
    assert (found <= brute + 1e-12).all()
    assert_allclose(found, brute, atol=0.04)  # the lattice's step is up to 1/120 of an edge of about four
    assert np.median(brute - found) < 1e-3


def test_distance_to_a_ball_is_that_to_its_radius():
    v, f = marching_cubes(sphere(), np.zeros(3), 1.0)
    rng = np.random.default_rng(1)
    p = np.array([13.3, 13.9, 14.2]) + rng.normal(size=(500, 3)) * 6
    assert_allclose(distance_to_surface(p, v, f), np.abs(np.linalg.norm(p - [13.3, 13.9, 14.2], axis=1) - R), atol=0.05)


def test_samples_are_spread_by_area():
    v, f = marching_cubes(sphere(), np.zeros(3), 1.0)
    p, triangle = sampled(v, f, 4000)
    assert distance_to_triangles(p, v[f[triangle]]).max() < 1e-9
    above = (p[:, 1] > 13.9 + R / 2).mean()  # a cap of half the radius has a quarter of a sphere's area
    assert_allclose(above, 0.25, atol=0.01)


def test_cells_have_the_faces_of_their_shape():
    cells = np.zeros((4, 4, 4), bool)
    cells[1:3, 1:3, 1] = True
    x, f, owner = cubes(cells)
    assert len(f) == 4 + 4 + 8
    assert cells[tuple(owner.T)].all()
    triangles = np.concatenate([f[:, :3], f[:, [0, 2, 3]]])
    assert_allclose(volume_within(x, triangles), 4)


def test_the_nearer_face_hides_the_farther():
    camera = perspective(40, 40, 0.8, look_at((0, 0, 3.0), (0, 0, 0)))
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    x = np.concatenate([corners, corners + [0, 0, -1]])
    for faces in ([[0, 1, 2, 3], [4, 5, 6, 7]], [[4, 5, 6, 7], [0, 1, 2, 3]]):
        faces = np.array(faces)
        canvas = Canvas(camera)
        canvas.polygons(x, faces, np.where(faces[:, :1] == 0, [255, 0, 0], [0, 0, 255]))
        red, _, blue = canvas.picture()[20, 20]
        assert red > 100 and blue == 0
    canvas = Canvas(camera)
    canvas.polygons(x, np.array([[3, 2, 1, 0]]), np.array([[255, 0, 0]]))  # seen from behind
    assert (canvas.picture() == canvas.page[0, 0]).all()
