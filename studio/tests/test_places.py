"""The children's room, the basket and the garden as shipped, beside the colliders that the scenes give them."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial import cKDTree

from assets.asset import Asset
from core.vocabulary import Box, Capsule, Plane
from scenes import garden as garden_scene
from scenes import toy_collection
from studio import basket
from studio.childrens_room.bed_and_tent import TENT_AT
from studio.childrens_room.painted_shell import ROOM_HIGH, ROOM_LOW
from studio.garden.garden_furniture import BENCH_AT, SEAT
from studio.garden.garden_model import SUNLIGHT
from studio.garden.plants import RINGS
from studio.revolved_cage import revolved_cage
from studio.shapes import Surface, leaf_mesh
from studio.surface_sampling import sample_surface
from studio.textures import plain

SHIPPED = Path(__file__).resolve().parents[2] / "assets" / "data"


@pytest.fixture(scope="module")
def places() -> dict[str, Asset]:
    return {name: Asset.load(SHIPPED / f"{name}.h5") for name in ("childrens_room", "garden", "basket")}


def distance(asset: Asset, points) -> np.ndarray:
    """Signed distance of an asset at points, from the nearest grid node."""
    index = np.round((np.asarray(points) - asset.sdf.origin) / asset.sdf.spacing).astype(int)
    return asset.sdf.values[tuple(index.T)].astype(float)


@pytest.mark.parametrize(("name", "most"), [("childrens_room", 2.2e6), ("garden", 2.2e6), ("basket", 0.8e6)])
def test_files_stay_small_and_gaussians_are_visible(places, name, most):
    assert (SHIPPED / f"{name}.h5").stat().st_size < most
    g = places[name].gaussians
    assert (g.opacities > 0.9).all() and np.exp(g.log_scales).max() < 0.9


def test_walls_of_the_childrens_room_are_where_bodies_stop(places):
    g = places["childrens_room"].gaussians
    inside = (g.means > np.array(ROOM_LOW) - 0.01).all(1) & (g.means < np.array(ROOM_HIGH) + 0.01).all(1)
    assert 90_000 < len(g) < 130_000 and inside.mean() > 0.95  # the rest is window and trees
    planes = [c for c in toy_collection.room_colliders() if isinstance(c, Plane)]
    assert_allclose(
        sorted(float(np.dot(p.point, p.normal)) for p in planes), [-2.1, -1.9, -1.9, -1.7, 0.005], atol=1e-9
    )
    for box in (c for c in toy_collection.room_colliders() if isinstance(c, Box)):  # each is covered by what one sees
        top = np.array(box.center) + (0.0, box.half_size[1], 0.0)
        near = np.abs(g.means[:, [0, 2]] - top[[0, 2]]) < np.array(box.half_size)[[0, 2]] + 0.02
        assert np.abs(g.means[near.all(1), 1] - top[1]).min() < 0.05


def test_the_tent_is_solid_and_the_rug_is_free(places):
    room = places["childrens_room"]
    assert (distance(room, [(TENT_AT[0], 0.3, TENT_AT[1]), (1.22, 0.03, -0.05)]) < 0).all()  # tent, a block
    assert (distance(room, [(0.6, 0.2, 0.1), (0.9, 0.6, 0.2)]) > 0.05).all()


def test_the_lawn_is_covered_and_free_where_animals_go(places):
    garden = places["garden"]
    means = garden.gaussians.means
    grass = means[(means[:, 1] > -0.01) & (means[:, 1] < 0.12)]
    x, z = np.meshgrid(np.linspace(-3.4, 3.4, 40), np.linspace(-4.0, 2.8, 40))
    assert cKDTree(grass[:, [0, 2]]).query(np.stack([x.ravel(), z.ravel()], 1))[0].max() < 0.12
    for (x, z), _ in RINGS:
        body = (np.hypot(means[:, 0] - x, means[:, 2] - z) < 0.4) & (means[:, 1] > 0.15) & (means[:, 1] < 1.2)
        assert not body.any()
        assert distance(garden, [(x, 0.3, z)])[0] > 0.1
    assert distance(garden, [(BENCH_AT[0], SEAT - 0.03, BENCH_AT[1])])[0] < 0
    trunk = next(c for c in garden_scene.colliders() if isinstance(c, Capsule))
    bark = means[(np.abs(means[:, 1] - 0.6) < 0.05) & (np.hypot(means[:, 0] + 2.15, means[:, 2] + 2.35) < 0.3)]
    assert len(bark) > 10 and np.abs(np.hypot(bark[:, 0] - trunk.a[0], bark[:, 2] - trunk.a[2]) - 0.13).max() < 0.06


def test_shadows_of_the_scene_fall_as_the_baked_ones_do():
    light = garden_scene.sun()
    travel = np.subtract(light.target, light.position)
    assert_allclose(travel / np.linalg.norm(travel), SUNLIGHT / np.linalg.norm(SUNLIGHT), atol=1e-6)


def test_the_basket_is_hollow_and_holds(places):
    asset = places["basket"]
    middle = [(0.0, 0.1, 0.0), (0.15, 0.2, 0.1), (0.0, 0.28, 0.0)]
    wall = float(basket.radius_at(0.13)) - basket.WALL / 2
    assert (distance(asset, middle) > 0.05).all()
    assert (distance(asset, [(wall, 0.13, 0.0), (0.0, 0.13, -wall), (0.0, basket.FLOOR / 2, 0.0)]) < 0).all()
    assert 150 <= len(asset.cage.vertices) <= 300
    assert 0.7 < asset.cage.volumes().sum() * asset.material.density < 1.5  # [kg]
    corners = asset.cage.vertices[asset.cage.tets].mean(1)
    inner = corners[(np.hypot(corners[:, 0], corners[:, 2]) < 0.2)]
    assert inner[:, 1].max() < 2 * basket.FLOOR


def test_a_revolved_cage_fills_its_solid():
    """A cone frustum with its axis: the prisms of the polygon that circumscribes it."""
    cage = revolved_cage([(0.0, 0.0), (2.0, 0.0), (1.0, 3.0), (0.0, 3.0)], [(0, 1, 2), (0, 2, 3)], 24)
    cage.check("frustum")
    area = 24 * np.tan(np.pi / 24)  # of the polygon around the unit circle
    assert_allclose(cage.volumes().sum(), area * 3.0 * (4 + 2 + 1) / 3, rtol=1e-5)
    assert len(cage.vertices) == 2 + 2 * 24


def test_each_leaf_is_one_gaussian():
    along, across = np.array([[0.1, 0, 0], [0, 0.2, 0]]), np.array([[0, 0.04, 0], [0, 0, 0.06]])
    mesh = leaf_mesh([(0, 0, 0), (1, 2, 3)], along, across)
    c = sample_surface(Surface("leaves", mesh, plain("808080"), 9.0, leaves=True), 4, np.random.default_rng(0))
    assert_allclose(c.points, [(0, 0, 0), (1, 2, 3)], atol=1e-12)
    assert_allclose(c.tangents, [(1, 0, 0), (0, 1, 0)], atol=1e-12)
    assert_allclose(c.normals, [(0, 0, 1), (1, 0, 0)], atol=1e-12)
    assert_allclose(c.sigma, [(0.03, 0.012), (0.06, 0.018)], atol=1e-12)
    assert (c.surface == 4).all()


def test_more_gaussians_on_a_leaf_keep_its_shape():
    """The mean and the variances of a mixture of equal Gaussians: those of its members and of their centres."""
    mesh = leaf_mesh([(0.5, 0, 0)] * 400, np.tile([0.1, 0, 0], (400, 1)), np.tile([0, 0.04, 0], (400, 1)))
    surface = Surface("leaves", mesh, plain("808080"), 9.0, leaves=True)
    for per_leaf in (2.5, 20.0):
        c = sample_surface(surface, 0, np.random.default_rng(0), None, per_leaf)
        assert len(c) == pytest.approx(400 * per_leaf, rel=0.04)
        assert_allclose(c.points.mean(0), (0.5, 0, 0), atol=0.006)
        variance = c.points.var(0)[:2] + (c.sigma**2).mean(0)
        assert_allclose(np.sqrt(variance), (0.03, 0.012), rtol=0.25 if per_leaf < 3 else 0.06)
