"""Rooms and gardens become environments: the floor, the tables, the sign of the distance, and a dropped ball."""

import json
from dataclasses import replace
from functools import cache

import h5py
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.ndimage import map_coordinates

from assets.asset import Asset
from assets.environment import Environment
from assets.gaussians import normals_and_areas
from assets.orientation import find_gravity, guess_up_axis
from assets.splat_files import read_gaussians, write_gaussians
from core.camera import directions_around
from core.errors import BadInput
from prepare.environment.environment_pipeline import EnvironmentOptions, prepare_environment
from prepare.environment.surfels import Surfels, surfels
from prepare.environment.winding_number import blended_planes, signed_distance, winding_number
from prepare.prepared_files import prepare_environment_file
from scenes import registry
from tests.fuzz.sample_files import some_stage
from tests.support.sample_scenes import (
    GARDEN_TABLE,
    LEANING,
    ROOM,
    SHELF,
    TABLE,
    garden,
    garden_distance,
    room,
    room_distance,
    table_and_jug,
)
from tests.support.shells import ball

RIGHT = 0.99  # of all places must have the right sign
SHELL = 4  # voxels under the surface beyond which a grid says nothing (sim/contact/static_shapes.py)


room, garden = cache(room), cache(garden)  # many tests look at the same ones


@pytest.fixture(scope="module")
def scenes(ti_cpu):
    """For each name the splat in the code's frame, the environment made of it, and world-from-code, (4, 3).

    Captures lean, have y down and lie anywhere.
    """
    found = {}
    for name, made, size in (("room", room(), 5.01), ("garden", garden(), 7.6)):
        capture = made.transformed(LEANING, (3.0, -1.0, 2.0), 0.5)
        asset, _ = prepare_environment(capture, EnvironmentOptions(scale=size, cell=0.075))
        # the rotation, scale and shift that carried the code's frame to the asset's: least squares over all centres
        a = np.c_[made.means.astype(float), np.ones(len(made))]
        found[name] = made, asset, np.linalg.lstsq(a, asset.gaussians.means.astype(float), rcond=None)[0]
    return found


@pytest.fixture(params=["room", "garden"])
def scene(request, scenes):
    return request.param, *scenes[request.param]


def to_code(points, matrix):
    """Points of the asset (N, 3) in the frame that the scene was made in."""
    return (points - matrix[3]) @ np.linalg.inv(matrix[:3])


def distance(asset: Asset, points: np.ndarray) -> np.ndarray:
    """Signed distance of the colliders at points (N, 3) [m]: the least of all grids that have one."""
    found = np.full(len(points), 1e3)
    for grid in asset.grids:
        q = (points - grid.origin) / grid.spacing
        inside = ((q >= 0) & (q <= np.array(grid.values.shape) - 1)).all(1)
        phi = map_coordinates(grid.values.astype(np.float32), q[inside].T, order=1)
        found[inside] = np.minimum(found[inside], np.where(phi > -SHELL * grid.spacing, phi, 1e3))
    return found


def test_the_scene_stands_upright(scene):
    """Level to a tenth of a degree, the floor at y = 0 to a centimetre everywhere, in metres to a percent."""
    name, _, asset, matrix = scene
    assert asset.provenance["up"] == "-y"
    up = matrix[1] / np.linalg.norm(matrix[1])
    assert up[1] > np.cos(np.radians(0.1))
    assert_allclose(np.linalg.norm(matrix[:3], axis=1), 1, atol=0.01)
    r = 2.4 if name == "room" else 3.0
    floor = np.array([[x, 0, z, 1] for x in (-r, r) for z in (-1.9, 1.9)]) @ matrix
    assert np.abs(floor[:, 1]).max() < 0.01


def test_a_garden_whose_cameras_are_known_has_their_scale_and_is_seen_from_them(ti_cpu, tmp_path):
    """A trainer's cameras.json over point_cloud/iteration_N/, in a frame three times too large and upside down."""
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    eyes = np.stack([2.2 * np.sin(angle), np.full(12, 1.5), 2.2 * np.cos(angle)], 1)
    spin, shift, units = LEANING, np.array([3.0, -1.0, 2.0]), 3.0
    ahead = np.array([0.0, 0.7, 0.0]) - eyes
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    right = np.cross(ahead, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    axes = np.stack([right, np.cross(ahead, right), ahead], 2)  # camera to world, +y down
    folder = tmp_path / "point_cloud" / "iteration_7000"
    folder.mkdir(parents=True)
    write_gaussians(folder / "point_cloud.ply", garden().transformed(spin, shift, units))
    entries = [
        {"id": k, "position": (units * spin @ x + shift).tolist(), "rotation": (spin @ a).tolist()}
        for k, (x, a) in enumerate(zip(eyes, axes, strict=True))
    ]
    (tmp_path / "cameras.json").write_text(json.dumps(entries))
    splats, said = folder / "point_cloud.ply", []
    prepare_environment_file(splats, tmp_path / "garden.h5", EnvironmentOptions(cell=0.1), report=said.append)
    assert any("as its cameras stand" in line for line in said) and not any("guessed" in line for line in said)
    asset = Asset.load(tmp_path / "garden.h5")
    assert_allclose(asset.provenance["metres_per_unit"], 1 / units, rtol=0.03)
    eye, drop = (np.array(p) for p in (asset.environment.eye_position, asset.environment.drop_point))
    assert abs(eye[1] - 1.5) < 0.05 and 1.4 < np.hypot(*(eye - drop)[[0, 2]]) < 3.0


def test_tables_and_shelves_are_found(scene):
    """Each within a centimetre of its height and of its rim's place within 6 cm; and nothing else but a chest."""
    name, _, asset, matrix = scene
    known = {"table": TABLE, "shelf": SHELF} if name == "room" else {"table": GARDEN_TABLE}
    planes = asset.environment.planes
    assert planes[0][0] == "floor" and abs(planes[0][1]) < 0.01
    for kind, (low, high) in known.items():
        top = np.array([[low[0], high[1], low[2], 1], [*high, 1]]) @ matrix
        (found,) = [p for p in planes if p[0] == kind and abs(p[1] - top[0, 1]) < 0.01]
        corners = np.sort(top[:, [0, 2]], axis=0).ravel()
        assert_allclose(found[2:], corners, atol=0.06)
    assert len(planes) == 1 + len(known) + (name == "room")


def test_the_sign_is_right(scene):
    """Over and under floor, table and shelf, and in all of the air."""
    name, _, asset, matrix = scene
    rng = np.random.default_rng(1)
    truth, tops = (room_distance, (TABLE, SHELF)) if name == "room" else (garden_distance, (GARDEN_TABLE,))
    low, high = ((-2.4, 0.0, -1.2), (1.4, 2.5, 1.9)) if name == "room" else ((-2.7, 0.0, -2.7), (1.5, 2.5, 1.5))
    air = rng.uniform(low, high, (50_000, 3))
    air = air[truth(air) > 0.03]
    assert (distance(asset, np.c_[air, np.ones(len(air))] @ matrix) > 0).mean() >= RIGHT
    for a, b in (*tops, ((-2.0, -1.0, -1.0), (1.4, 0.0, 1.6))):
        x, z = rng.uniform(np.array(a)[[0, 2]] + 0.03, np.array(b)[[0, 2]] - 0.03, (4000, 2)).T
        off = rng.uniform(0.004, 0.015, 4000)
        for side in (1, -1):
            points = np.stack([x, b[1] + side * off, z, np.ones(4000)], 1) @ matrix
            if name == "room":  # the jug stands there
                points = points[~((np.abs(x - 0.35) < 0.09) & (np.abs(z - 0.15) < 0.09))]
            assert (side * distance(asset, points) > 0).mean() >= RIGHT, (b, side)


def test_the_surface_is_where_it_should_be(scene):
    """On the table, half a millimetre in the median and 3 mm almost everywhere: its own noise is 2 to 4 mm."""
    name, _, asset, matrix = scene
    low, high = TABLE if name == "room" else GARDEN_TABLE
    rng = np.random.default_rng(2)
    x, z = rng.uniform(np.array(low)[[0, 2]] + 0.05, np.array(high)[[0, 2]] - 0.05, (3000, 2)).T
    keep = (np.abs(x - 0.35) > 0.1) | (np.abs(z - 0.15) > 0.1)
    off = np.abs(
        distance(asset, np.stack([x, np.full(3000, high[1] + 0.005), z, np.ones(3000)], 1)[keep] @ matrix) - 0.005
    )
    assert np.median(off) < 0.002 and np.percentile(off, 95) < 0.004


def test_the_drop_is_free_and_the_user_sees_it(scene):
    name, _, asset, matrix = scene
    stage = asset.environment
    assert stage.drop_point[0] == stage.drop_point[2] == 0.0 and stage.clear_radius > 0.25
    assert abs(stage.drop_point[1] - (0.74 if name == "room" else 0.72)) < 0.012
    eye, drop = np.array(stage.eye_position), np.array(stage.drop_point)
    assert 0.5 < np.linalg.norm((eye - drop)[[0, 2]]) < 1.6 and 1.2 < eye[1] < 1.8
    way = drop + np.linspace(0.1, 1, 60)[:, None] * (eye - drop)
    assert (distance(asset, way) > 0.02).all()
    if name == "room":
        inside = to_code(eye[None], matrix)[0]
        assert (inside > np.array(ROOM[0])).all() and (inside < np.array(ROOM[1])).all()


def test_a_ball_dropped_there_lies_on_the_table(scenes, tmp_path):
    """The sandbox's own bodies and colliders; a soft ball from 8 cm bounces and stays. One scene lies 50 m away."""
    from bench.physics import box
    from core.material import Material
    from display.scene_bodies import place_static
    from sim.bodies import SoftBody
    from sim.solver import Solver

    x, tets, surface = box((0.1, 0.1, 0.1), (4, 4, 4))
    x = x - 0.05
    x = x * (np.abs(x).max(1) / np.maximum(np.linalg.norm(x, axis=1), 1e-9))[:, None]  # a ball
    material = Material(1e4, 0.4, 300.0, friction=0.6)
    balls, grids, drops = [], [], []
    for k, (name, (_, asset, _)) in enumerate(scenes.items()):
        asset.save(tmp_path / f"{name}.h5")
        played, offset = registry.load("sandbox", stage=str(tmp_path / f"{name}.h5")), np.array([50.0 * k, 0, 0])
        room, ring = played.bodies[0], played.bodies[-1]
        grids += place_static(asset, replace(room, position=tuple(room.position + offset)))[1]
        drop = np.array(ring.position) + offset
        balls.append(SoftBody(name, x, tets, surface, material, position=tuple(drop + [0, 0.05, 0])))
        drops.append([*drop[[0, 2]], played.room.spot[1]])
    solver = Solver(balls, [*played.colliders, *grids])
    drops, lowest = np.array(drops), []
    for _ in range(120):
        solver.step(1 / 60)
        lowest.append([b.low[1] for b in solver.bodies()] - drops[:, 2])
    assert np.min(lowest) > -0.008 and np.max(lowest[-30:]) < 0.008
    away = np.array([b.centroid[[0, 2]] for b in solver.bodies()]) - drops[:, :2]
    assert np.linalg.norm(away, axis=1).max() < 0.01


def test_what_is_cut_out_leaves_a_closed_table(ti_cpu, tmp_path):
    """By the command: the jug goes to a file of its own, and the table has no hole where it stood."""
    made = table_and_jug()
    Asset(made).save(tmp_path / "in.h5")
    options = EnvironmentOptions(up="+y", cell=0.03, cut=(7,))
    out, jug = prepare_environment_file(tmp_path / "in.h5", tmp_path / "out.h5", options)
    piece = read_gaussians(jug)
    assert len(piece) == (made.object_id == 7).sum() > 500
    asset = Asset.load(out)
    assert not (asset.gaussians.object_id == 7).any()
    spot = np.median(piece.means, axis=0)
    assert_allclose(np.ptp(piece.means[:, [0, 2]], axis=0), 0.1, atol=0.02)
    x, z = np.meshgrid(np.linspace(-0.06, 0.06, 13), np.linspace(-0.06, 0.06, 13))
    at = np.stack([spot[0] + x.ravel(), np.full(x.size, asset.environment.drop_point[1]), spot[2] + z.ravel()], 1)
    assert (distance(asset, at + [0, 0.01, 0]) > 0).all() and (distance(asset, at - [0, 0.01, 0]) < 0).all()
    with pytest.raises(BadInput, match="object id 9; there are: 0, 7"):
        prepare_environment_file(tmp_path / "in.h5", tmp_path / "no.h5", replace(options, cut=(9,)))
    assert not (tmp_path / "no.h5").exists()


@pytest.mark.parametrize(
    "up, turn", [("+y", np.eye(3)), ("-y", LEANING), ("+z", np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]))]
)
def test_up_is_found_and_refined(up, turn):
    g = room().transformed(turn)
    assert guess_up_axis(g)[0] == up
    g = g.opaque()
    floor, rotation = find_gravity(g.means.astype(float), *normals_and_areas(g), up)
    assert (rotation @ turn)[1, 1] > np.cos(np.radians(0.1))
    assert abs(floor) < 0.005


def test_the_winding_number_by_ffts_is_the_sum():
    """Against the sum over all dipoles, in float64; in a ball it is 1, outside 0, on it the mean."""
    n = directions_around(3000)
    s = Surfels(0.5 * n + 0.02, n, np.full(3000, np.pi / 3000), np.zeros((3000, 3), int))
    shape, spacing, origin = (34, 33, 32), 0.05, np.array([-0.8, -0.8, -0.8])
    w = winding_number(s, origin, spacing, shape).values
    q = origin + spacing * np.indices(shape).reshape(3, -1).T
    r = s.points[None] - q[::37, None]
    length = np.linalg.norm(r, axis=2)
    want = (s.areas * (r * s.normals).sum(2) / (4 * np.pi * length**3)).sum(1)
    away = np.abs(np.linalg.norm(q[::37] - 0.02, axis=1) - 0.5) > 3 * spacing
    assert_allclose(w.ravel()[::37][away], want[away], atol=0.02)
    assert_allclose(want[np.linalg.norm(q[::37] - 0.02, axis=1) < 0.3], 1, atol=1e-3)
    at = map_coordinates(w, ((s.points - origin) / spacing).T, order=1)
    assert_allclose(at.mean(), 0.5, atol=0.05)


def test_the_planes_nearby_are_summed_as_in_float64(ti_cpu):
    """The kernel against a loop over all nodes."""
    rng = np.random.default_rng(3)
    p, n = rng.uniform(-0.5, 7.5, (40, 3)), directions_around(40)
    s = Surfels(p, n, np.ones(40), np.zeros((40, 3), int))
    value = rng.normal(size=40)
    phi, mean, weight = blended_planes(s, value, np.zeros(3), 1.0, (7, 6, 8))
    for node in np.ndindex(7, 6, 8):
        r = node - p
        near = ((np.floor(p) - node <= 1) & (node - np.floor(p) <= 2)).all(1)  # two nodes on each side
        w = np.exp(-0.5 * (r * r).sum(1) / 0.8**2) * near
        assert_allclose(weight[node], w.sum(), atol=1e-5)
        if w.sum() > 0.045:
            assert_allclose(phi[node], (w * (r * n).sum(1)).sum() / w.sum(), atol=1e-4)
            assert_allclose(mean[node], (w * value).sum() / w.sum(), atol=1e-4)


def test_a_ball_gets_its_distance(ti_cpu):
    """Gaussians on a sphere of 0.5 m: within a tenth of a voxel on both sides of it, and the right sign everywhere."""
    g = ball(4000, radius=0.5, open_below=-2.0)
    low, h, shape = np.array([-1.0, -1.0, -1.0]), 0.05, (41, 41, 41)
    centre = g.means.astype(float).mean(0)
    s = surfels(g, low + centre, h, shape)
    s = replace(s, normals=s.normals * np.sign((s.normals * (s.points - centre)).sum(1))[:, None])
    w = winding_number(s, low + centre, 2 * h, (22, 22, 22))
    phi = signed_distance(s, w, low + centre, h, shape).values
    radius = np.median(np.linalg.norm(s.points - centre, axis=1))
    true = np.linalg.norm(low[:, None, None, None] + h * np.indices(shape), axis=0) - radius
    wrong = (np.sign(phi) != np.sign(true)) & (np.abs(true) > 0.3 * h)
    assert not wrong.any()
    near = np.abs(true) < 1.2 * h
    assert np.percentile(np.abs(phi - true)[near], 95) < 0.25 * h
    assert np.percentile(np.abs(phi - true), 99) < 1.0 * h


BAD = {
    "too many cells": (room, {"cell": 0.005}, r"cells, the limit is 16,000,000: ask for --cell 0\.0\d+"),
    "too large": (room, {"scale": 1e4}, "out of range"),
    "no axis": (room, {"up": "y"}, "up axis"),
    "nothing opaque": (lambda: replace(room(), logit_opacities=np.full(len(room()), -6, np.float32)), {}, "opaque"),
    "a point": (lambda: replace(room(), means=np.zeros((len(room()), 3), np.float32)), {}, "extent"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_an_environment_is_told_in_one_line(ti_cpu, name):
    made, options, message = BAD[name]
    with pytest.raises(BadInput, match=message) as caught:
        prepare_environment(made(), EnvironmentOptions(**options))
    assert "\n" not in str(caught.value)


def test_objects_cut_out_are_not_left_behind_without_their_scene(tmp_path, monkeypatch):
    """The scene's own file is the last to be written, and all of them appear at once."""

    def prepared(*_, **__):
        stage = some_stage()
        return replace(stage, provenance={"up_probabilities": {"+y": 1.0}}), {7: stage.gaussians}

    def refuse(*_, **__):
        raise BadInput("out.h5: cannot be written (No space left on device)")

    write_gaussians(tmp_path / "in.ply", table_and_jug())
    monkeypatch.setattr("prepare.prepared_files.prepare_environment", prepared)
    monkeypatch.setattr("assets.asset.Asset.save", refuse)
    with pytest.raises(BadInput, match="No space left"):
        prepare_environment_file(tmp_path / "in.ply", tmp_path / "out.h5")
    assert [p.name for p in tmp_path.iterdir()] == ["in.ply"]


def test_a_stage_is_written_and_read_again(tmp_path):
    asset = some_stage()
    asset.save(tmp_path / "s.h5")
    for read in (Asset.load(tmp_path / "s.h5").environment, Environment.load(tmp_path / "s.h5")):
        assert replace(read, fine_grids=()) == replace(asset.environment, fine_grids=())
        (grid,), (written,) = read.fine_grids, asset.environment.fine_grids
        assert (grid.values == written.values).all() and grid.spacing == written.spacing


def test_a_damaged_stage_is_refused(tmp_path):
    path = tmp_path / "s.h5"
    Asset(some_stage().gaussians).save(path)
    with pytest.raises(BadInput, match="is no stage"):
        registry.load("sandbox", stage=str(path))
    for damage, message in (
        (lambda file: file["stage"].attrs.update(floor=np.nan), "finite"),
        (lambda file: file["stage"].attrs.update(clear=-1.0), "radius"),
        (lambda file: file["stage"].attrs.update(eye=[0, 0, np.inf]), "finite"),
        # a level that nothing shows, as older versions made of a splat without a floor
        (lambda file: file["stage/planes"].__setitem__((0, 0), 3.0), "no floor to play on"),
        (lambda file: file["stage/fine0"].__setitem__((0, 0, 0), np.inf), "finite"),
    ):
        some_stage().save(path)
        with h5py.File(path, "r+") as file:
            damage(file)
        with pytest.raises(BadInput, match=message):
            Asset.load(path)
