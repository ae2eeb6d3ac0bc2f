"""Bodies and rooms of the user's in the roles of scenes."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assets.asset import Asset
from assets.environment import Environment
from assets.gaussians import Gaussians
from assets.library import find_asset
from assets.room_folder import RoomManifest, write_room
from core.camera import look_at, perspective
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.material import Material
from core.rotation import matrices_from_quaternions
from core.vocabulary import Body, Plane
from scenes import registry
from scenes.roles import CELL, bounds, clear_of_room, in_room, photographs_of, places, spot_in
from scenes.scene import Role, Room, Scene
from vrgs import main

JELLY = Material.named("jelly")
DEMOS = registry.names()


def ring(tmp_path, name: str = "mine", material=JELLY, scale: float = 3.0) -> str:
    """A file with a ring of another size, that stands on its rim and off its origin."""
    asset = Asset.load(find_asset("ring_red"))
    x = asset.cage.vertices[:, [1, 0, 2]] * np.float32([-scale, scale, scale]) + np.float32([0.2, 1.0, 0.0])
    g = asset.gaussians
    means = g.means[:, [1, 0, 2]] * np.float32([-scale, scale, scale]) + np.float32([0.2, 1.0, 0.0])
    made = replace(asset, gaussians=replace(g, means=means), cage=replace(asset.cage, vertices=x), sdf=None)
    replace(made, material=material).save(tmp_path / f"{name}.h5")
    return str(tmp_path / f"{name}.h5")


def room(tmp_path, *, table: bool, scale: float = 1.0) -> str:
    """A room from x = -2 to 2 and z = -3 to 3 [m] with a table of 0.9 m at x = -1; its user looks along +x."""
    spacing = 0.05
    at = np.stack(
        np.meshgrid(*(np.arange(a, b, spacing) for a, b in ((-2.2, 2.2), (-0.3, 2.6), (-3.2, 3.2))), indexing="ij"), -1
    )
    air = np.minimum.reduce([2.0 - np.abs(at[..., 0]), at[..., 1], 3.0 - np.abs(at[..., 2])])
    block = np.max(np.abs(at - [-1.0, 0.45, 0.0]) - [0.4, 0.45, 0.6], axis=-1)
    values = np.minimum(air, block).astype(np.float16)
    g = Gaussians.of(np.zeros((1, 3)), [[1, 0, 0, 0]], [[0, 0, 0]], [0], np.zeros((1, 1, 3)))
    drop = (-1.0, 0.9, 0.0) if table else (1.0, 0.0, 1.0)
    planes = (("floor", 0.0, -2.0, -3.0, 2.0, 3.0), ("table", 0.9, -1.4, -0.6, -0.6, 0.6))
    stage = Environment(0.0, drop, (drop[0] - 0.5, 1.5, drop[2]), 0.35, planes)
    path = tmp_path / "room.h5"
    Asset(g, sdf=DistanceGrid(values, np.array([-2.2, -0.3, -3.2]), spacing), environment=stage).save(path)
    return str(path)


def replaceable(name: str) -> tuple[list[str], Role, str, int]:
    """The first role of a demo that a still body may play: the bodies before it, the role, its name and its body."""
    scene = registry.load(name)
    all_places = places(scene)
    first = next(k for k, (role, _, _) in enumerate(all_places) if not role.animated)
    return [scene.bodies[i].asset for _, _, i in all_places[:first]], *all_places[first]


@pytest.mark.parametrize("name", [n for n in DEMOS if n not in ("fitted_toy", "sandbox")])  # which place bodies
def test_a_body_takes_the_place_the_size_and_the_material_of_what_it_replaces(name, tmp_path):
    """Upright on the same spot."""
    scene, mine = registry.load(name), ring(tmp_path)
    before, role, title, i = replaceable(name)
    own = scene.bodies[i]
    cast = registry.load(name, body=[*before, mine])
    body = cast.bodies[i]
    assert cast.cast[-1] == (mine, title) and body.material == JELLY and body.kind == own.kind
    (low, high), (its_low, its_high) = bounds(own.asset, own), bounds(mine, body)
    assert_allclose(0.5 * (low + high)[[0, 2]], 0.5 * (its_low + its_high)[[0, 2]], atol=1e-6)
    assert_allclose(low[1], its_low[1], atol=1e-6)
    if role.resize:
        assert_allclose(np.linalg.norm(high - low), np.linalg.norm(its_high - its_low), rtol=1e-6)
    assert registry.load(name, body=[*before, mine], resize=False).bodies[i].scale == 1.0
    assert registry.load(name, body=[*before, ring(tmp_path, "plain", None)]).bodies[i].material == own.material
    assert registry.load(name, body=[*before, mine], material="wood").bodies[i].material == Material.named("wood")
    with pytest.raises(BadInput, match="too many for this scene; roles"):
        registry.load(name, body=[*before, *[mine] * (len(places(scene)) + 1)])


def test_a_small_animal_dances_as_large_as_the_dancer(tmp_path):
    """It is no speck on the stage; --scale keeps its size."""
    mine, dancer = str(tmp_path / "animal.h5"), registry.load("just_dance").bodies[1]
    asset = Asset.load(find_asset("dancer"))
    replace(asset, cage=replace(asset.cage, vertices=np.float32(0.3) * asset.cage.vertices)).save(mine)
    body = registry.load("just_dance", body=mine).bodies[1]
    assert_allclose(bounds(mine, body), bounds("dancer", dancer), atol=1e-5)
    assert body.material.young == pytest.approx(dancer.material.young, rel=1e-5)
    assert registry.load("just_dance", body=mine, resize=False).bodies[1].scale == 1.0


@pytest.mark.parametrize("name", DEMOS)
def test_every_demo_moves_into_a_room_of_the_users(name, tmp_path):
    """Its own room goes, the other one stands around the play; all that is played with stays as it is, but awake."""
    stage = room(tmp_path, table=True)
    own, scene = registry.load(name), registry.load(name, stage=stage)
    around, *rest = scene.bodies
    assert around.asset == stage and scene.cast[-1][0] == stage and scene.cast[-1][1].startswith("the room")
    played = [replace(b, asleep=False) for b in own.bodies if b.asset not in own.room.assets]
    rest = rest[: len(rest) - len(own.room.marks)]  # which mark places in another room only
    assert [replace(b, position=o.position) for b, o in zip(rest, played, strict=True)] == played
    assert len(rest) < len(own.bodies)
    assert any(c in own.room.colliders for c in own.colliders)
    assert not any(c in own.room.colliders for c in scene.colliders[1:])
    turn = matrices_from_quaternions(np.array(around.rotation))
    spot = turn.T @ (np.array(own.room.spot) - around.position)
    assert spot[1] == pytest.approx(0.0 if own.room.on_floor else 0.9, abs=1e-6)
    assert scene.floor == pytest.approx(own.room.spot[1] - spot[1])
    eye = turn.T @ (np.array(scene.eye) - around.position)
    assert (np.abs(eye[[0, 2]]) < [2.0, 3.0]).all() and eye[1] > spot[1]


def test_each_body_is_told_its_role(tmp_path):
    a, b = ring(tmp_path, "a"), ring(tmp_path, "b")
    assert registry.load("ring_toss", body=[a, b]).cast == ((a, "ring 1"), (b, "ring 2"))
    assert registry.load("sandbox", body=[a]).cast == ((a, "the toy"),)
    assert registry.load("just_dance", body=["dancer", a]).cast == (("dancer", "the dancer"), (a, "prop 1"))
    with pytest.raises(BadInput, match=r"^dancer: moves by itself, so that it cannot be ring 1$"):
        registry.load("ring_toss", body="dancer")


def test_bodies_in_the_sandbox_lie_side_by_side(tmp_path):
    names = [ring(tmp_path), "ring_blue", "dancer"]
    scene = registry.load("sandbox", body=names)
    boxes = [bounds(b.asset, b) for b in scene.bodies if b.asset in names]
    assert all(b[0][0] - a[1][0] == pytest.approx(0.04, abs=1e-5) for a, b in pairwise(boxes))
    assert_allclose([low[1] for low, _ in boxes], [0.78, 0.78, 0.75], atol=1e-5)  # a dancer is not dropped
    assert_allclose(boxes[0][0][0] + boxes[-1][1][0], 0.0, atol=1e-5)


@pytest.mark.parametrize("table", [True, False])
def test_a_room_of_the_users_is_put_around_the_play(table, tmp_path):
    """Its drop point lies under the play's middle, its user stands at the scene's eye; the play stays as it is."""
    stage = room(tmp_path, table=table)
    scene, own = registry.load("ring_toss", stage=stage), registry.load("ring_toss")
    drop, user = ((-1.0, 0.9, 0.0), (-1.5, 1.5, 0.0)) if table else ((1.0, 0.0, 1.0), (0.5, 1.5, 1.0))
    around, *rest = scene.bodies
    assert around.asset == stage and rest == own.bodies[1:]
    turn = matrices_from_quaternions(np.array(around.rotation))
    assert_allclose(turn @ drop + around.position, own.room.spot, atol=1e-6)
    assert_allclose((turn @ (np.array(user) - drop))[0], 0.0, atol=1e-6)  # to the eye, along +z
    assert (turn @ (np.array(user) - drop))[2] > 0.4
    assert scene.floor == pytest.approx(0.75 - drop[1])
    assert scene.colliders[0] == Plane((0.0, scene.floor, 0.0), (0.0, 1.0, 0.0))
    assert scene.colliders[1:] == own.colliders[len(own.room.colliders) :]
    assert scene.cast == ((stage, "the room"),)


def test_the_eye_stays_in_the_room(tmp_path):
    """The table is 0.6 m from a wall, towards which the scene's eye would be 1.15 m away."""
    stage = room(tmp_path, table=True)
    scene = registry.load("ring_toss", stage=stage)
    turn = matrices_from_quaternions(np.array(scene.bodies[0].rotation))
    eye = turn.T @ (np.array(scene.eye) - scene.bodies[0].position)
    assert -1.9 < eye[0] < -1.4 and eye[1] > 1.1
    assert scene.target == registry.load("ring_toss").target


def test_what_would_be_in_a_wall_or_in_furniture_is_put_beside_it(tmp_path):
    """A ring in the wall comes out of it, one in the table as well, though not into a third; others stay."""
    grid = Asset.load(room(tmp_path, table=True)).sdf
    places = [(1.98, 0.2, 0.0), (-1.0, 0.3, 0.0), (-0.45, 0.3, 0.0), (0.5, 0.2, 1.0)]
    rings = [Body("ring_red", JELLY, position=at) for at in places]
    wall, table, beside, free = clear_of_room([*rings], grid, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.5, 0.0, 0.0))
    assert (beside, free) == tuple(rings[2:])
    assert 1.6 < wall.position[0] < 1.92 and wall.position[1:] == (0.2, 0.0)
    boxes = [bounds(b.asset, b) for b in (table, beside)]
    assert boxes[0][0][0] > -0.62 and boxes[0][0][0] > boxes[1][1][0]


def test_a_play_on_the_floor_finds_free_floor(tmp_path):
    stage = room(tmp_path, table=True)
    asset = Asset.load(stage)

    def placed(radius):
        play = Scene([], None, (0, 1, 1), (0, 0, 0), room=Room((), (), (0.0, 0.0, 0.0), radius, on_floor=True))
        return spot_in(play, asset.environment, asset.sdf)

    spot, free = placed(1.0)
    to_table = np.linalg.norm(np.maximum(np.abs(spot[[0, 2]] - [-1.0, 0.0]) - [0.4, 0.6], 0.0))
    assert spot[1] == 0.0 and free > 1.0
    assert free == pytest.approx(min(2.0 - abs(spot[0]), 3.0 - abs(spot[2]), to_table), abs=2 * CELL)
    spot, free = placed(0.5)
    assert free > 0.45 and abs(spot[2]) < 0.3  # enough, and near the room's middle


def test_a_play_in_a_captured_room_is_where_its_photographs_look(tmp_path):
    """Cameras in one corner of a room, all turned to a place on its floor."""
    stage = room(tmp_path, table=True)
    looked_at = np.array([1.0, 0.0, 1.2])
    eyes = [(x, 1.4, 2.6) for x in (0.4, 1.0, 1.6)]
    cameras = tuple(perspective(64, 48, 0.9, look_at(eye, looked_at)) for eye in eyes)
    write_room(tmp_path, RoomManifest("room.h5", (), eyes[1], tuple(looked_at), 0.9, 0.0, 1.0, np.eye(4), cameras))
    assert len(photographs_of(stage)) == 3
    placed = in_room(registry.load("box_moving"), stage)
    turn = matrices_from_quaternions(np.array(placed.bodies[0].rotation))
    eye, target = ((np.array(p) - placed.bodies[0].position) @ turn for p in (placed.eye, placed.target))
    assert np.linalg.norm(eye - np.array(eyes), axis=1).min() < 0.5 and (target - eye)[2] < -0.5, (
        "where they stood, where they looked"
    )
    (tmp_path / "room.json").unlink()
    assert photographs_of(stage) == ()


def test_a_room_that_is_too_small_is_told(tmp_path):
    stage = room(tmp_path, table=True)
    asset = Asset.load(stage)
    replace(asset, environment=replace(asset.environment, clear_radius=0.12)).save(stage)
    assert registry.load("ring_toss", stage=stage).cast == (
        (stage, "the room (12 cm are free around the play, which takes 30 cm)"),
    )


@pytest.mark.parametrize(("name", "takes"), [("box_moving", "2.0 m"), ("animal_crossing", "2.4 m")])
def test_a_play_that_must_fit_is_refused_by_a_cluttered_room(name, takes, tmp_path):
    """Columns stand on its floor in rows, 1 m apart."""
    stage = room(tmp_path, table=False)
    asset = Asset.load(stage)
    count = asset.sdf.values.shape
    x, z = np.arange(count[0])[:, None, None] * 0.05 - 2.2, np.arange(count[2]) * 0.05 - 3.2
    columns = np.hypot(x % 1.0 - 0.5, z % 1.0 - 0.5) - 0.1
    grid = replace(asset.sdf, values=np.minimum(asset.sdf.values, columns.astype(np.float16)))
    replace(asset, sdf=grid).save(stage)
    with pytest.raises(BadInput, match=f"there is no room for this play: it takes {takes} of level, free floor") as e:
        registry.load(name, stage=stage)
    assert "\n" not in str(e.value)


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        (["--scene", "ring_toss", "--body", "none.h5"], "none.h5: no such asset"),
        (["--scene", "ring_toss", "--body", "none.ply"], "none.ply: no such file"),
        (["--scene", "ring_toss", "--body", "README.md"], "README.md"),
        (["--scene", "ring_toss", "--body", "bottle"], "bottle: has no cage to simulate"),
        (["--scene", "sandbox", "--body", "ring_red", "--body", "bottle"], "bottle: has no cage to simulate"),
        (["--scene", "ring_toss", *["--body", "ring_red"] * 4], "4 bodies are too many"),
        (["--scene", "ring_toss", "--stage", "none.h5"], "none.h5: no such asset"),
        (["--scene", "ring_toss", "--stage", "ring_red"], "is no stage"),
        (["--scene", "ring_toss", "--material", "wood"], "takes no --material without --body"),
        (["--scene", "just_dance", "--body", "ring_red"], "ring_red: is not animated"),
    ],
)
def test_what_cannot_play_a_role_is_told_in_one_line(argv, says, capsys):
    assert main([*argv, "--headless"]) == 2
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1


def test_the_command_line_says_who_plays_what(tmp_path, capsys, unwarmed):
    """In a line at the start, and in the statistics; two bodies of the user's are thrown in a room of the user's."""
    mine, stage = ring(tmp_path), room(tmp_path, table=True)
    argv = ["--scene", "ring_toss", "--body", mine, "--body", "ring_blue", "--stage", stage]
    argv += ["--headless", "--arch", "cpu", "--size", "32x24", "--frames", "4", "--stats", str(tmp_path / "s.json")]
    assert main(argv) == 0
    assert capsys.readouterr().out == "mine.h5 is ring 1; ring_blue is ring 2; room.h5 is the room\n"
    stats = json.loads((tmp_path / "s.json").read_text())
    assert stats["roles"] == {"ring 1": "mine.h5", "ring 2": "ring_blue", "the room": "room.h5"} and stats["finite"]


def test_more_bodies_than_a_row_of_the_sandbox_holds_are_above_it():
    names = ["ring_red", "ring_blue"] * 12
    boxes = [bounds(b.asset, b) for b in registry.load("sandbox", body=names).bodies if b.asset in names]
    assert len(boxes) == len(names)
    for k, (low, high) in enumerate(boxes):
        assert np.abs([low[0], high[0]]).max() < 0.8  # on the table
        assert not any(((low < b[1]) & (b[0] < high)).all() for b in boxes[:k])
