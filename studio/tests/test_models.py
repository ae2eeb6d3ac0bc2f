"""The shipped assets, and the sampling of models with Gaussians."""

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assets.asset import Asset
from core.material import Material
from core.rotation import matrices_from_quaternions
from display.xr.avatar import MODELS as MODELS_OF_AVATAR
from prepare.cage.mesh_quality import dihedral_angles
from studio import solids
from studio.__main__ import main
from studio.avatar_model import avatar_models
from studio.catalogue import MODELS
from studio.detail import Detail
from studio.dining_room.bottle import BOTTLE_AT, BOTTLE_HEIGHT
from studio.dining_room.furniture import TABLE_SIZE, TABLE_TOP
from studio.dining_room.room_model import GRID_HIGH, GRID_LOW, VIEWER
from studio.dining_room.shell import ROOM_HIGH, ROOM_LOW
from studio.finish import fit_view_dependence, flat_sh, sharpened, smoothed, to_gaussians, view_directions
from studio.ring import RING_MAJOR, RING_TUBE, torus_cage, torus_surfaces
from studio.shapes import Surface, beveled_box, box, lathe, leaf_mesh, quad, rotation_about, superellipsoid, tube
from studio.surface_sampling import sample_surface, sample_surfaces
from studio.textures import fbm, plain

SHIPPED = Path(__file__).resolve().parents[2] / "assets" / "data"
RINGS = ("ring_red", "ring_blue", "ring_yellow")
NAMES = ("dining_room", "bottle", *RINGS)


@pytest.fixture(scope="module")
def shipped() -> dict[str, Asset]:
    return {name: Asset.load(SHIPPED / f"{name}.h5") for name in NAMES}


def at(asset: Asset, points) -> np.ndarray:
    """Signed distance of an asset at points, from the nearest grid node."""
    index = np.round((np.asarray(points) - asset.sdf.origin) / asset.sdf.spacing).astype(int)
    return asset.sdf.values[tuple(index.T)].astype(float)


def test_an_unknown_name_is_refused(tmp_path, capsys):
    assert main(["teapot", "--out", str(tmp_path)]) == 2
    assert "teapot: no such model" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_all_files_together_stay_small():
    assert sum(path.stat().st_size for path in SHIPPED.glob("*.h5")) < 25e6
    room = SHIPPED / "dining_room.h5"
    assert room.stat().st_size < 12.5 * len(Asset.load(room).gaussians)


def test_the_room_has_the_measures_of_its_model(shipped):
    g = shipped["dining_room"].gaussians
    assert 110_000 <= len(g) <= 160_000 and g.sh_degree == 0
    inside = (g.means > np.array(ROOM_LOW) - 0.01).all(1) & (g.means < np.array(ROOM_HIGH) + 0.01).all(1)
    assert inside.mean() > 0.9  # the rest is the garden
    top = g.means[(g.object_id == 1) & (np.abs(g.means[:, 1] - TABLE_TOP) < 1e-3)]
    assert len(top) > 10_000
    assert_allclose(top.max(0)[[0, 2]], np.array(TABLE_SIZE) / 2, atol=0.01)
    assert (g.opacities > 0.9).all()


def test_the_lane_round_the_bottle_is_free(shipped):
    room = shipped["dining_room"]
    things = room.gaussians.select(room.gaussians.object_id >= 10)
    assert np.linalg.norm((things.means - np.array(BOTTLE_AT))[:, [0, 2]], axis=1).min() > 0.18


def test_things_on_the_table_are_solid_and_the_air_is_not(shipped):
    """The grid's sign agrees with the Gaussians: objects' centres inside, free air outside."""
    room = shipped["dining_room"]
    assert_allclose(room.sdf.origin, GRID_LOW, atol=1e-6)
    assert (
        room.sdf.origin + room.sdf.spacing * (np.array(room.sdf.values.shape) - 1) >= np.array(GRID_HIGH) - 1e-6
    ).all()
    things = [room.gaussians.means[room.gaussians.object_id == k].mean(0) for k in (10, 11, 13)]  # bowl, mug, books
    assert (at(room, things) < 0).all()
    assert (at(room, [(0.0, 0.9, -0.15), (0.0, 0.76, 0.2), (0.0, 1.1, 0.0)]) > 0.05).all()


@pytest.mark.parametrize("height", [0.02, 0.10, 0.20, 0.28])
def test_the_bottle_is_solid(shipped, height):
    bottle = shipped["bottle"]
    radius = 0.0368 if height < 0.18 else (0.029 if height < 0.21 else 0.0138)
    d = at(bottle, [(0.0, height, 0.0), (0.053, height, 0.0)])
    assert_allclose(d[0], -min(radius, height, BOTTLE_HEIGHT - height), atol=0.006)  # half a cell's diagonal
    assert d[1] > 0
    g = bottle.gaussians
    assert g.means[:, 1].min() > -0.002 and abs(g.means[:, 1].max() - BOTTLE_HEIGHT) < 0.003
    assert np.hypot(g.means[:, 0], g.means[:, 2]).max() < 0.039


@pytest.mark.parametrize("name", RINGS)
def test_rings_are_ready_to_be_simulated(shipped, name):
    asset = shipped[name]
    assert 150 <= len(asset.cage.vertices) <= 300
    assert asset.material == Material(young=3e4, poisson=0.4, density=1100.0, friction=0.6)
    d = solids.torus(RING_MAJOR, RING_TUBE)(asset.gaussians.means)
    assert np.abs(d).max() < 0.002  # the surface lies where the torus is
    assert at(asset, [(RING_MAJOR, 0.0, 0.0)])[0] < -0.012 and at(asset, [(0.0, 0.0, 0.0)])[0] > 0.06
    x = asset.cage.vertices[asset.cage.tets[asset.embedding.host]]  # (N, 4, 4, 3)
    corners = np.einsum("nkj,nkjc->nkc", asset.embedding.weights, x)
    assert_allclose(corners.mean(1), asset.gaussians.means, atol=5e-4)


@pytest.mark.parametrize("wanted", [270, 1000, 3000])
def test_the_ring_cage_is_well_shaped(wanted):
    cage = torus_cage(wanted)
    cage.check("cage")
    assert abs(len(cage.vertices) / wanted - 1) < 0.02
    angles = np.degrees(dihedral_angles(cage.vertices.astype(float), cage.tets))
    angles = angles if angles.max() < 181 else np.radians(angles)
    assert angles.min() >= 12  # as prepare's cages
    tube_volume = 2 * np.pi**2 * RING_MAJOR * RING_TUBE**2
    assert (cage.volumes() > 0).all()
    assert tube_volume < cage.volumes().sum() < 1.25 * tube_volume  # drawn round the tube, not far from it


def test_sampling_is_reproducible():
    surface = torus_surfaces("ring_red")[1]
    one, two = (sample_surface(surface, 0, np.random.default_rng(5)) for _ in range(2))
    assert all(np.array_equal(getattr(one, f), getattr(two, f)) for f in ("points", "normals", "tangents", "sigma"))


SHAPES = {
    "box": box((0, 0, 0), (1, 2, 3)),
    "block": beveled_box((1, 1, 1), 0.05),
    "lathe": lathe([(0, 0), (1, 0), (1, 1), (0, 1)]),
    "tube": tube([(0, 0, 0), (0.1, 0, 1), (0, 0, 2)], 0.3),
    "pillow": superellipsoid((1, 1, 1), 0.5),
}


@pytest.mark.parametrize("mesh", SHAPES.values(), ids=SHAPES)
def test_shapes_are_closed_and_face_outwards(mesh):
    import trimesh

    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert solid.is_watertight and solid.volume > 0


def sampled(mesh, **options):
    surface = Surface("test", mesh, plain("808080"), 0.02, uniform=True, **options)
    c = sample_surface(surface, 0, np.random.default_rng(0))
    return c, to_gaussians(c, flat_sh(np.full((len(c), 3), 0.5)), np.zeros(len(c)))


def seen_alpha(g, points) -> np.ndarray:
    """Opacity of all Gaussians together at surface points, as a ray along the thin direction meets them."""
    r = matrices_from_quaternions(g.quats)
    local = np.einsum("nij,pni->pnj", r, points[:, None] - g.means[None])[..., :2] / np.exp(g.log_scales[:, :2])
    alpha = g.opacities * np.exp(-0.5 * (local**2).sum(2))
    near = np.abs(np.einsum("nij,pni->pnj", r, points[:, None] - g.means[None])[..., 2]) < 0.01
    return 1 - np.prod(1 - alpha * near, axis=1)


@pytest.mark.parametrize("stretch", [1.0, 3.0])
def test_gaussians_lie_in_the_surface_without_holes(stretch):
    """A plate: thin axes along the normal, everything covered, nothing beyond the border."""
    r = rotation_about("x", 30) @ rotation_about("y", 20)
    mesh = quad((-0.2, 0, 0.2), (0.4, 0, 0), (0, 0, -0.4)).moved(r)
    _, g = sampled(mesh, grain=tuple(r[:, 0]), stretch=stretch)
    normal = r[:, 1]
    thin = matrices_from_quaternions(g.quats)[:, :, 2]
    assert_allclose(np.abs(thin @ normal), 1, atol=1e-5)
    assert (np.exp(g.log_scales[:, 2]) < 0.5 * np.exp(g.log_scales[:, :2]).min(1)).all()
    u = np.random.default_rng(1).uniform(-0.19, 0.19, (1500, 2))
    alpha = seen_alpha(g, (u[:, :1] * r[:, 0] + u[:, 1:] * r[:, 2]).astype(np.float32))
    assert alpha.min() > 0.6 and np.quantile(alpha, 0.02) > 0.85
    past = np.linspace(-0.2, 0.2, 400)[:, None] * r[:, 2] + (0.2 + 0.015 * stretch) * r[:, 0]
    assert seen_alpha(g, past).max() < 0.1


def test_neighbours_keep_their_distance():
    """Blue noise: no two points inside a face are nearer than the spacing, and few are much farther."""
    from scipy.spatial import cKDTree

    c, _ = sampled(quad((0, 0, 0), (1, 0, 0), (0, 0, -1)))
    inner = c.points[((c.points[:, [0, 2]] > (0.1, -0.9)) & (c.points[:, [0, 2]] < (0.9, -0.1))).all(1)]
    nearest = cKDTree(c.points).query(inner, k=2)[0][:, 1]
    assert nearest.min() >= 0.02 - 1e-6 and np.quantile(nearest, 0.99) < 0.03


def test_sharpening_undoes_the_blur_of_overlap():
    c, _ = sampled(quad((0, 0, 0), (1, 0, 0), (0, 0, -1)))
    wish = 0.5 + 0.2 * np.tanh(np.sin(c.points[:, :1] * 60)) * np.ones(3)
    blurred, corrected = smoothed(c, wish), smoothed(c, sharpened(c, wish))
    assert np.abs(corrected - wish).mean() < 0.5 * np.abs(blurred - wish).mean()


def test_smoothing_in_rounds_changes_the_chosen_values_alone():
    c, _ = sampled(quad((0, 0, 0), (1, 0, 0), (0, 0, -1)))
    values = np.random.default_rng(4).random((len(c), 3))
    assert_allclose(smoothed(c, values, 1.3, 16, rounds=2), smoothed(c, smoothed(c, values, 1.3, 16), 1.3, 16))
    chosen = c.points[:, 0] > 0.5
    some = smoothed(c, values, 1.3, 16, which=chosen)
    assert np.array_equal(some[~chosen], values[~chosen])
    assert_allclose(some[chosen], smoothed(c, values, 1.3, 16)[chosen])
    assert_allclose(smoothed(c, np.full((len(c), 3), 0.7)), 0.7)


def test_solids_measure_distances():
    p = np.random.default_rng(2).uniform(-1, 1, (500, 3))
    assert_allclose(solids.sphere((0, 0.5, 0), 0.3)(p), np.linalg.norm(p - (0, 0.5, 0), axis=1) - 0.3)
    can = solids.revolved([(0.0, -0.4), (0.3, -0.4), (0.3, 0.4), (0.0, 0.4)])(p)
    q = np.stack([np.hypot(p[:, 0], p[:, 2]) - 0.3, np.abs(p[:, 1]) - 0.4], 1)
    assert_allclose(can, np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(1), 0), atol=1e-12)
    grid = solids.sample_distance_grid([solids.sphere((0, 0, 0), 0.1)], (-0.2, -0.2, -0.2), (0.2, 0.2, 0.2), 0.05)
    assert grid.values.dtype == np.float16 and grid.values.shape == (9, 9, 9)
    assert_allclose(grid.values[4, 4, 4], -0.1, atol=1e-3)


def test_view_dependent_colour_is_reproduced_where_it_is_seen():
    """A colour that is linear in the direction lies in the span of the basis and must come out."""
    from core.spherical_harmonics import sh_basis

    normals = np.array([[0.0, 1.0, 0.0], [0.6, 0.0, 0.8]])
    views = view_directions((0.0, 0.8, 0.0), VIEWER)
    look = 0.5 + 0.3 * views[0][None, :, :] * np.ones((2, 1, 1))
    sh = fit_view_dependence(normals, lambda cosine: look, 2, views)
    seen = 0.5 + np.einsum("mk,nkc->nmc", sh_basis(views[0], 9), sh)
    front = (-(normals @ views[0].T) > 0.3) & (views[1] == 1)  # the player's views, which count most
    assert front.sum() > 60
    assert np.abs(seen - look)[front].max() < 0.03  # the ridge takes a little


def test_noise_is_smooth_and_the_same_each_time():
    p = np.random.default_rng(3).uniform(-5, 5, (4000, 3))
    a, b = fbm(p, 4, 7), fbm(p + 1e-5, 4, 7)
    assert np.array_equal(a, fbm(p, 4, 7)) and np.abs(a - b).max() < 1e-3
    assert abs(a.mean()) < 0.05 and 0.1 < a.std() < 0.6


@pytest.mark.parametrize("factor", [1.5, 4.0])
def test_detail_multiplies_the_number_of_surfels(factor):
    surfaces = [
        Surface("plate", quad((0, 0, 0), (0.5, 0, 0), (0, 0, -0.5)), plain("808080"), 0.02, uniform=True),
        Surface("block", box((0, 0, 0), (0.2, 0.5, 0.2)), plain("808080"), 0.02, uniform=True),
        Surface("leaves", leaf_mesh(np.zeros((9000, 3)), (0.1, 0, 0), (0, 0.04, 0)), plain("808080"), 9.0, leaves=True),
    ]
    counts = [len(sample_surfaces(surfaces, np.random.default_rng(1), Detail(f))) for f in (1.0, factor)]
    assert abs(counts[1] / counts[0] / factor - 1) < 0.05


def test_detail_multiplies_surfels_that_are_nearly_all_on_edges():
    bar = [Surface("bar", box((0, 0, 0), (0.3, 0.04, 0.04)), plain("808080"), 0.03, uniform=True)]
    counts = [len(sample_surfaces(bar, np.random.default_rng(1), Detail(f))) for f in (1.0, 12.0)]
    assert abs(counts[1] / counts[0] / 12.0 - 1) < 0.05


def test_every_model_of_the_catalogue_is_there():
    for where, *_ in MODELS.values():
        module, function = where.split(":")
        assert callable(getattr(import_module(module), function))


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("--force", "--force belongs to --detail paper"),
        ("--views 9", "--views belongs to --capture"),
        ("--up +z", "--up belongs to --capture"),
        ("--capture c teapot", "teapot: --capture builds no assets"),
        ("--capture c --views 1", "a capture has at least"),
    ],
)
def test_an_option_that_would_be_ignored_is_refused(words, why, capsys):
    assert main(words.split()) == 2
    assert why in capsys.readouterr().err


def test_the_shipped_avatar_is_what_its_model_gives():
    """Up to the last bits of another machine's exp and log, by which a point may be chosen or not."""
    with np.load(MODELS_OF_AVATAR) as shipped:
        made = avatar_models()
        assert set(shipped.files) == set(made)
        for name, array in made.items():
            assert array.dtype == shipped[name].dtype
            assert len(array) == pytest.approx(len(shipped[name]), rel=0.02)
            assert_allclose(array.mean(0), shipped[name].mean(0), atol=0.02)
