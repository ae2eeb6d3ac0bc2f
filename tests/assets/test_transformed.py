"""A prepared asset in another frame is what it was, turned and scaled."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assets.asset import Asset
from assets.environment import Environment
from assets.gaussians import Gaussians, concatenate
from assets.library import SHIPPED_FOLDER
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.rotation import matrices_from_quaternions
from tests.support.leaning_room import FLAT, leaning_room
from tests.support.samples import discs, some_gaussians

TURN = matrices_from_quaternions(np.array([0.8, 0.3, -0.4, 0.3]))


@pytest.fixture(scope="module")
def toy() -> Asset:
    return Asset.load(SHIPPED_FOLDER / "toy_frog.h5")


def test_a_body_is_sound_stands_again_and_keeps_its_embedding(toy, tmp_path):
    """The corners of local tetrahedra lie where the turned ones do, as barycentric weights are affine."""
    new = toy.transformed(TURN, 1.5)
    new.save(tmp_path / "new.h5")
    new = Asset.load(tmp_path / "new.h5")
    assert new.cage.vertices[:, 1].min() == pytest.approx(0.0, abs=1e-6)
    assert_allclose(new.cage.volumes(), 1.5**3 * toy.cage.volumes(), rtol=1e-3, atol=1e-12)
    for old_centre, new_centre in zip(*(centres(a) for a in (toy, new)), strict=True):
        assert_allclose(new_centre - new.cage.vertices.mean(0), 1.5 * (old_centre - toy.cage.vertices.mean(0)) @ TURN.T, atol=2e-5)  # fmt: skip  # noqa: E501
    assert new.provenance["reoriented"][0][1] == 1.5


def centres(asset: Asset) -> tuple[np.ndarray, np.ndarray]:
    """Means of the Gaussians, as they are and as the embedding gives them."""
    corners = asset.cage.vertices[asset.cage.tets[asset.embedding.host]]  # (N, 4 corners, 4 vertices, 3)
    return asset.gaussians.means, (asset.embedding.weights[..., None] * corners).sum(2).mean(1)


def test_its_distances_are_those_of_the_turned_shape(toy):
    new = toy.transformed(TURN, 1.5)
    shift = new.cage.vertices[0] - 1.5 * TURN @ toy.cage.vertices[0]
    x = toy.cage.vertices[::5].astype(float) * 0.97
    there = new.sdf.sample(1.5 * x @ TURN.T + shift)
    assert_allclose(there, 1.5 * toy.sdf.sample(x), atol=new.sdf.spacing * 0.5)


def room() -> Asset:
    grid = DistanceGrid(
        np.random.default_rng(0).uniform(-1, 1, (8, 5, 6)).astype(np.float16), np.array([-1.0, 0, -1]), 0.4
    )
    planes = (("floor", 0.0, -1.0, -1.0, 2.0, 1.0), ("table", 0.7, 0.0, 0.0, 1.0, 0.5))
    found = Environment(0.0, (0.5, 0.7, 0.25), (0.0, 1.6, 1.0), 0.3, planes, (grid,))
    return Asset(some_gaussians(), sdf=grid, environment=found)


def test_a_room_turns_about_the_vertical_and_grows(tmp_path):
    """A quarter turn to the left takes x to -z: nodes of the grids meet nodes, and rectangles rectangles."""
    quarter = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    old, new = room(), room().transformed(quarter, 2.0)
    new.save(tmp_path / "room.h5")
    assert new.environment.planes[1] == ("table", 1.4, 0.0, -2.0, 1.0, 0.0)
    assert_allclose(new.environment.eye_position, (2.0, 3.2, 0.0), atol=1e-12)
    assert new.environment.clear_radius == 0.6
    points = old.sdf.nodes().reshape(-1, 3)
    assert_allclose(new.sdf.sample(2 * points @ quarter.T), 2 * old.sdf.values.ravel().astype(float), atol=2e-3)
    same = room().transformed(np.eye(3), 2.0)
    assert_allclose(same.sdf.values, 2 * old.sdf.values.astype(np.float32), atol=2e-3)


def upright_wall() -> Gaussians:
    """Flat Gaussians whose normals are along x."""
    points = np.random.default_rng(0).uniform(-1, 1, (500, 3)) * [0.01, 1, 1]
    return discs(points, np.exp([-6.0, -3.0, -3.0]))


def test_a_room_that_leans_is_put_level():
    """Floor, table, drop and eye are those of the level room, and the distance grid is that over its floor."""
    lean = matrices_from_quaternions(np.array([np.cos(0.1), np.sin(0.1), 0, 0]))  # 11 degrees
    new = leaning_room(lean).transformed(lean.T)
    found = new.environment
    assert found.floor_height == 0.0 and [p[0] for p in found.planes] == ["floor", "table"]
    assert_allclose(found.planes[1][1], 0.7, atol=0.02)
    assert_allclose(found.planes[1][2:], (0.0, 0.0, 1.0, 0.6), atol=0.05)
    assert_allclose(found.planes[0][2:], (-2.0, -2.0, 2.0, 2.0), atol=0.1)
    assert_allclose(found.drop_point[1], 0.0, atol=0.02)
    assert found.eye_position[1] == pytest.approx(1.6 * np.cos(0.2) - 1.2 * np.sin(0.2), abs=0.02)  # as it was, leaning
    x = np.array([[-0.5, h, 0.2] for h in (0.2, 0.6, 1.0)])
    assert_allclose(new.sdf.sample(x), [0.2, 0.6, 1.0], atol=0.03)


def test_a_room_on_its_head_gets_another_floor():
    """Turned over, its ceiling is the floor; the table hangs from above and is none."""
    over = matrices_from_quaternions(np.array([0.0, 1.0, 0.0, 0.0]))
    ceiling = np.random.default_rng(2).uniform([-2, 2.39, -2], [2, 2.41, 2], (4000, 3))
    room = leaning_room(np.eye(3))
    room = replace(room, gaussians=concatenate([room.gaussians, discs(ceiling, FLAT)]))
    found = room.transformed(over)
    low = found.gaussians.means[:, 1].min()
    assert low == pytest.approx(0.0, abs=0.05) and found.environment.planes[0][1] == 0.0
    assert found.provenance["reoriented"][0][2][1] == pytest.approx(2.4, abs=0.02)


TURN_A_LITTLE = matrices_from_quaternions(np.array([np.cos(0.05), 0, 0, np.sin(0.05)]))


@pytest.mark.parametrize(
    ("make", "turn", "factor", "says"),
    [
        (lambda: Asset.load(SHIPPED_FOLDER / "dancer.h5"), np.eye(3), 2.0, "its motion"),
        (lambda: replace(room(), gaussians=upright_wall()), TURN_A_LITTLE, 1.0, "needs a floor"),
        (lambda: Asset.load(SHIPPED_FOLDER / "brick_red.h5"), np.eye(3), 1e4, "out of range"),
        (room, np.eye(3), 0.0, "0 times"),
    ],
)
def test_what_cannot_be_is_refused(make, turn, factor, says):
    with pytest.raises(BadInput, match=says):
        make().transformed(turn, factor)
