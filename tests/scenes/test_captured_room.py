"""A captured room as a scene: read from its folder, strictly; played, reset; it names no file outside of it."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assets.asset import Asset
from assets.environment import Environment
from assets.gaussians import Gaussians
from assets.library import find_asset
from assets.room_folder import RoomManifest, RoomObject, read_room, write_room
from commands.parser import parse
from commands.play import load_scene
from commands.prepared import prepared_stage
from core.camera import look_at, perspective
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.vocabulary import BodyState, Hand, Light
from display.protocol import Frame
from display.world import World
from scenes import registry
from scenes.manipulation import pointed_parts
from scenes.roles import cast_bodies
from tests.support.scripted_play import blind_world, play

EYE, TARGET = (0.0, 1.42, 1.15), (0.0, 0.8, 0.0)
SMALL = {"width": 16, "height": 16}


@pytest.fixture
def folder(tmp_path):
    """A bare floor as if it were captured, with a ring on it and a ring of which one side is held."""
    (tmp_path / "dining" / "objects").mkdir(parents=True)
    path = tmp_path / "dining"
    heights = np.broadcast_to(np.linspace(-0.5, 2.5, 16, dtype=np.float32)[None, :, None], (31, 16, 31))
    grid = DistanceGrid(heights.copy(), np.array([-3.0, -0.5, -3.0]), 0.2)
    floor = (("floor", 0.0, -2.0, -2.0, 2.0, 2.0),)
    g = Gaussians.of(np.zeros((1, 3)), [[1, 0, 0, 0]], -3 * np.ones((1, 3)), np.zeros(1), np.zeros((1, 1, 3)))
    Asset(g, sdf=grid, environment=Environment(0.0, (0, 0, 0), EYE, 0.5, floor)).save(path / "room.h5")
    for name in ("ring_red", "ring_blue"):
        shutil.copyfile(find_asset(name), path / "objects" / f"{name}.h5")
    half = np.sqrt(0.5)
    objects = (
        RoomObject("red ring", "objects/ring_red.h5", (0.0, 0.017, 0.14), (1.0, 0.0, 0.0, 0.0)),
        RoomObject("wreath", "objects/ring_blue.h5", (0.0, 1.1, -0.2), (half, half, 0.0, 0.0), 0.0),
    )
    camera = perspective(640, 360, 0.9, look_at(EYE, TARGET))
    write_room(
        path, RoomManifest("room.h5", objects, EYE, TARGET, 0.9, 0.0, 0.5, np.diag([0.5, 0.5, 0.5, 1]), (camera,))
    )
    return path


def test_the_player_stands_where_the_photographer_stood(folder):
    scene = registry.load(str(folder))
    assert scene.eye == EYE and scene.target == TARGET and registry.label(f"{folder}/") == "dining"
    assert [b.fixed_below for b in scene.bodies[1:]] == [None, 0.0] and scene.bodies[0].material is None


def test_the_scripted_hand_takes_one_object_after_the_other(folder):
    scene = registry.load(str(folder))
    game = scene.game

    def states(time):
        held = game.hands(time, [still] * 2) and game.hands(time, [still] * 2)[0].grip
        up = np.array([0.0, 0.1, 0.0]) * bool(held)
        return [BodyState(n, up, up, up - 0.1, up + 0.1, up, bool(held)) for n in ("red", "blue")]

    zero = np.zeros(3)
    still = BodyState("ring", zero, zero, zero - 0.1, zero + 0.1, zero, False)
    with pytest.raises(AssertionError, match="red ring was not moved"):
        game.verify([still, still])
    for time in np.arange(0.0, game.duration, 0.1):
        game.update(time, states(time))
    game.verify([still, still])
    assert set(game.farthest) == {0, 1}
    game.reset()
    assert not game.starts and not game.farthest


def test_a_shadow_in_the_photographs_is_not_drawn_again(folder, ti_cpu):
    """The wreath is between the light and the red ring: as photographed, but drawn if they were modelled."""
    scene = registry.load(str(folder))
    red, wreath = (np.array(b.position) for b in scene.bodies[1:])
    light = Light(tuple(red + 10 * (wreath - red)), tuple(red), kind="directional", strength=0.6, softness=0.01)

    def visibility(world, k):
        begin, end = world.registry.gaussian_span(k)
        return world.device.splats.visibility.to_numpy()[begin:end]

    modelled = World(replace(scene, light=light, bodies=[replace(b, captured=False) for b in scene.bodies]), **SMALL)
    shadow = visibility(modelled, 0) < 1 - 0.9 * light.strength
    assert shadow.mean() > 0.2
    modelled.close()
    world = World(replace(scene, light=light), **SMALL)
    assert_allclose(np.concatenate([visibility(world, 0), visibility(world, 1)]), 1, rtol=0, atol=1e-6)
    copy = world.registry.duplicate(0, np.array([0.0, 0.04, 0.0]))
    world.refresh()
    assert_allclose(visibility(world, copy)[shadow], 1, rtol=0, atol=0.05)
    world.registry.remove(0)  # the others' Gaussians move to other indices
    world.refresh()
    assert_allclose(visibility(world, 1)[shadow], 1, rtol=0, atol=0.05)
    world.reset()
    assert_allclose(np.concatenate([visibility(world, 0), visibility(world, 1)]), 1, rtol=0, atol=1e-6)
    world.close()


def test_what_plays_the_role_of_a_captured_object_is_not_captured(folder):
    bodies = cast_bodies(registry.load(str(folder)), (), ["ball"], None).bodies
    assert [b.captured for b in bodies[1:]] == [False, True]


def test_nothing_moves_in_a_captured_room_until_it_is_touched(folder, ti_cpu):
    """A ring that stands on its edge in the air, beside a wreath, for 30 s; then a hand takes it, and it falls."""
    room, half = read_room(folder), np.sqrt(0.5)
    leaning = replace(room.objects[0], position=(0.0, 0.4, 0.14), rotation=(half, 0.0, half, 0.0))
    write_room(folder, replace(room, objects=(leaning, room.objects[1])))
    world = blind_world(registry.load(str(folder)))
    start, hand = world.device.solver.snapshot()["x"], world.bodies()[0].centroid + [0.0, 0.3, 0.0]
    for k in range(1800):
        world.step(Frame(1 / 60, k / 60, [], [Hand(tuple(hand))]))
    assert np.abs(world.device.solver.snapshot()["x"] - start).max() < 1e-3
    for k in range(60):
        near = world.bodies()[0]
        world.step(Frame(1 / 60, 30 + k / 60, [], [Hand(tuple(near.low), grip=k < 5, reach=0.1)]))
    moved = np.abs(world.device.solver.snapshot()["x"] - start).max(axis=1)
    begin = world.device.solver.vertex_offset
    assert moved[: begin[1]].min() > 0.2 and moved[begin[1] :].max() < 1e-3
    world.close()


@pytest.mark.long
def test_a_room_is_played(folder, ti_cpu):
    scene = registry.load(str(folder))
    world = play(scene)
    scene.game.verify(world.bodies())
    assert not np.allclose(world.bodies()[0].low, scene.bodies[1].position, atol=0.05)
    world.reset()
    assert world.time == 0.0 and not scene.game.farthest


def test_the_largest_captured_object_is_pulled_at_its_ends(folder):
    scene = registry.load("manipulation", capture=str(folder))
    body, game = scene.bodies[1], scene.game
    assert body.asset.endswith("ring_red.h5") and -0.01 < body.fixed_below < 0.0 and body.material.young < 3e4
    assert scene.eye == EYE and len(game.parts) == 3
    with pytest.raises(BadInput, match="no such file"):
        registry.load("manipulation", capture=str(folder.parent))


def test_pointed_ends_come_first_and_what_is_held_is_no_end():
    """A cone along +x that stands on a wide foot."""
    t, turn = np.meshgrid(np.linspace(0, 1, 12), np.linspace(0, 6.2, 16))
    cone = np.stack([1 + t, 1 + 0.3 * (1 - t) * np.cos(turn), 0.3 * (1 - t) * np.sin(turn)], -1).reshape(-1, 3)
    foot = np.stack([3 * np.cos(turn), 0 * t, 3 * np.sin(turn)], -1).reshape(-1, 3)
    free = np.arange(2 * len(cone)) < len(cone)
    parts = pointed_parts(np.concatenate([cone, foot]), free, np.array([0.0, 1.0, 0.0]))
    assert parts[0].part == "right" and "lower end" not in {p.part for p in parts}


def test_other_demos_play_in_a_captured_room(folder, capsys):
    args = parse(["--scene", "animal_crossing", "--stage", str(folder)])[1]
    assert prepared_stage(args) == str(folder / "room.h5")
    capsys.readouterr()
    scene = load_scene(parse(["--scene", "box_moving", "--stage", str(folder)])[1], None)
    assert capsys.readouterr().out.startswith(f"{folder.name} is the room")
    assert scene.bodies[0].asset == str(folder / "room.h5") and not scene.game.hole


def test_rooms_in_the_working_directory_are_in_the_menu_of_scenes(folder, monkeypatch):
    monkeypatch.chdir(folder.parent)
    assert registry.rooms() == ["dining"] and registry.demos()[-1].summary == "dining: a captured room"
    (folder.parent / "ring_toss").mkdir()
    shutil.copyfile(folder / "room.json", folder.parent / "ring_toss" / "room.json")
    assert registry.rooms() == ["dining"], "a folder hides no demo"
    with pytest.raises(BadInput, match="holds no room"):
        registry.load("..")


@pytest.mark.parametrize(
    "change, said",
    [
        (lambda d: d.update(version=2), "version 2"),
        (lambda d: d.pop("eye"), "eye is missing"),
        (lambda d: d["objects"][0].update(asset="../other.h5"), "not the name of an .h5"),
        (lambda d: d["objects"][0].update(rotation=[1, 1, 0, 0]), "no unit quaternion"),
        (lambda d: d["objects"][0].update(asset="objects/none.h5"), "objects/none.h5 is missing"),
        (lambda d: d["objects"][1].update(name="red ring"), "same name"),
        (lambda d: d.update(fov_y=0), "fov_y"),
        (lambda d: d.update(eye=d["target"]), "the eye is at its target"),
        (lambda d: d["cameras"][0].update(fx=-1), "camera 0: fx"),
        (lambda d: d["room_from_capture"][0].__setitem__(0, -0.5), "room_from_capture"),
    ],
)
def test_a_manifest_that_is_not_sound_is_refused_in_one_line(folder, change, said):
    data = json.loads((folder / "room.json").read_text())
    change(data)
    (folder / "room.json").write_text(json.dumps(data))
    with pytest.raises(BadInput, match=said) as error:
        registry.load(str(folder))
    assert "\n" not in str(error.value)


def test_a_manifest_is_read_as_it_was_written(folder):
    room = read_room(folder)
    before = (folder / "room.json").read_bytes()
    write_room(folder, room)
    assert (folder / "room.json").read_bytes() == before
