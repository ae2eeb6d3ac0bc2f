"""Level sets: distances to masks, marching cubes, distances between points and surfaces; and how meshes are drawn."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial import cKDTree

from core.camera import look_at, perspective
from core.distance_grid import DistanceGrid, marching_cubes
from core.errors import BadInput
from core.tetmesh import enclosed_volume, triangle_areas
from prepare.cage.level_set import (
    contact_grid,
    distance_to,
    distance_to_surface,
)
from prepare.cage.mesh_quality import euler_characteristic, non_manifold_vertices
from prepare.report_pictures import Canvas, cubes
from tests.support.distance_shapes import sampled, sphere

CENTRE = np.array([-0.07, -0.01, 0.02])
R = 0.9
BALL = sampled(lambda p: sphere(p, CENTRE, R), 1.35, 0.1)


def test_the_distance_to_a_mask_is_that_to_its_nearest_cell():
    mask = np.random.default_rng(0).uniform(size=(9, 7, 8)) < 0.05
    true = cKDTree(np.argwhere(mask)).query(np.argwhere(np.ones(mask.shape)))[0].reshape(mask.shape)
    assert_allclose(distance_to(mask), true, rtol=1e-6)
    assert_allclose(distance_to(mask, 3.0), np.where(true > 3.0, np.inf, true), rtol=1e-6)
    assert np.isinf(distance_to(np.zeros((4, 5, 6), bool))).all()


def test_the_surface_of_a_ball():
    """Closed, outward, of the ball's area and volume; a level further out is larger."""
    v, f = marching_cubes(BALL)
    assert len(non_manifold_vertices(f)) == 0
    assert euler_characteristic(f) == 2
    assert_allclose(enclosed_volume(v, f), 4 / 3 * np.pi * R**3, rtol=0.01)
    assert_allclose(triangle_areas(v, f).sum(), 4 * np.pi * R**2, rtol=0.01)
    assert_allclose(np.linalg.norm(v - CENTRE, axis=1), R, atol=0.002)
    v, f = marching_cubes(BALL, level=0.2)
    assert_allclose(np.linalg.norm(v - CENTRE, axis=1), R + 0.2, atol=0.002)


def test_a_shape_at_the_grids_border_is_closed():
    _, f = marching_cubes(sampled(lambda p: sphere(p, (-1.0, 0, 0), R), 1.35, 0.1))
    assert len(non_manifold_vertices(f)) == 0
    with pytest.raises(BadInput, match="no surface"):
        marching_cubes(DistanceGrid(np.ones((5, 5, 5)), np.zeros(3), 1.0))


def test_distances_to_a_surface_are_those_to_the_ball():
    v, f = marching_cubes(BALL)
    p = CENTRE + np.random.default_rng(1).normal(size=(500, 3)) * 0.6
    assert_allclose(distance_to_surface(p, v, f), np.abs(np.linalg.norm(p - CENTRE, axis=1) - R), atol=0.005)


def test_the_contact_grid_of_far_components_stays_small():
    far = DistanceGrid(BALL.values, BALL.origin + [60.0, 0, 0], BALL.spacing)
    near, both = contact_grid([BALL]), contact_grid([BALL, far])
    assert max(near.shape) <= 58 and max(both.shape) <= 162
    assert_allclose(near.sample(CENTRE[None]), -R, atol=0.1)  # the tip of a cone between nodes


def test_cells_have_the_faces_of_their_shape():
    cells = np.zeros((4, 4, 4), bool)
    cells[1:3, 1:3, 1] = True
    x, f, owner = cubes(cells)
    assert len(f) == 4 + 4 + 8
    assert cells[tuple(owner.T)].all()
    triangles = np.concatenate([f[:, :3], f[:, [0, 2, 3]]])
    assert_allclose(enclosed_volume(x, triangles), 4)


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
