"""A room of the user's that is turned in play: splats, collider, light and bodies go with it, and its file keeps it."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assets.asset import Asset
from assets.file_access import locked_folder
from assets.library import SHIPPED_FOLDER
from assets.room_folder import RoomManifest, RoomObject, read_room, write_room
from core.camera import look_at, perspective
from core.errors import BadInput
from core.rotation import matrices_from_quaternions
from core.vocabulary import Body, Light
from display.edit.editor import own_room
from display.keep.keeper import Keeper
from display.keep.kept_frame import frame_writer, write_room_turned
from display.keep.scene_state import put_state, state_of
from display.protocol import Frame
from display.user_commands import KeepFrame, Pause, Reset, TurnRoom, Undo
from scenes.dining_table import RING_MATERIAL as RUBBER
from scenes.scene import Scene
from tests.support.leaning_room import leaning_room

SIZE = (96, 64)
LEAN = (float(np.cos(0.1)), float(np.sin(0.1)), 0.0, 0.0)  # 11 degrees about x
BACK = (LEAN[0], -LEAN[1], 0.0, 0.0)
TURN = matrices_from_quaternions(np.array(BACK))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A captured room whose frame leans, with a brick on its floor."""
    path = tmp_path_factory.mktemp("room")
    (path / "objects").mkdir()
    leaning_room(matrices_from_quaternions(np.array(LEAN))).save(path / "room.h5")
    (path / "objects" / "brick.h5").write_bytes((SHIPPED_FOLDER / "brick_red.h5").read_bytes())
    at = TURN.T @ [-0.6, 0.0, 0.5]
    brick = RoomObject("brick", "objects/brick.h5", tuple(at), LEAN)
    camera = perspective(*SIZE, 0.9, look_at((0.0, 1.5, 2.0), (0.0, 0.0, 0.0)))
    write_room(path, RoomManifest("room.h5", (brick,), (0.0, 1.5, 2.0), (0.0, 0.0, 0.0), 0.9, -0.5, 0.1, np.diag([0.1, 0.1, 0.1, 1.0]), (camera,)))  # fmt: skip  # noqa: E501
    return path


@pytest.fixture(scope="module")
def world(folder, ti_cpu):
    from display.world import World

    brick = Body(str(folder / "objects/brick.h5"), RUBBER, tuple(TURN.T @ [-0.6, 0.0, 0.5]), LEAN)
    scene = Scene([Body(str(folder / "room.h5")), brick], Light((0.3, 2.0, 0.3)), (0, 1.5, 2), (0, 0, 0))
    return World(scene, width=SIZE[0], height=SIZE[1])


def step(world, *commands):
    camera = perspective(*SIZE, 0.9, look_at((0, 1.5, 2), (0, 0, 0)))
    frame = Frame(1 / 60, 0.0, [camera], [], list(commands))
    with Keeper("room") as keeper:
        world.step(frame)
        keeper.after(frame, world)


def state(world) -> list[np.ndarray]:
    """Means and first covariances of the room, vertices, light."""
    splats = world.device.splats
    count = world.device.still
    light = np.array([world.light.position, world.light.target])
    x = world.device.solver.snapshot()["x"].copy()
    return [splats.mean.to_numpy()[:count], splats.cov.to_numpy()[:count], x, light, world.picture.to_numpy()]


def test_all_that_is_in_the_room_turns_with_it_and_back(world):
    step(world, Pause(True))
    before = state(world)
    step(world, TurnRoom(BACK))
    after = state(world)
    for k in (0, 2, 3):
        assert_allclose(after[k], before[k] @ TURN.T, atol=2e-5)
    full = lambda c: c[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)  # noqa: E731
    assert_allclose(full(after[1]), TURN @ full(before[1]) @ TURN.T, atol=1e-6)
    assert (after[4] != before[4]).any()
    assert world.ground((0.8, 0.4, -0.8)) == pytest.approx(0.0, abs=0.05)  # the floor is level now
    step(world, Undo())
    for now, then in zip(state(world), before, strict=True):
        assert_allclose(now, then, atol=2e-6)


def test_the_collider_turns_with_it(world, monkeypatch):
    """On the floor that is level now the brick lies still; time runs."""
    step(world, Pause(True), TurnRoom(BACK))
    step(world, Pause(False))
    monkeypatch.setattr(world.device, "render", lambda cameras: None)
    monkeypatch.setattr(world.device, "cast_shadow", lambda: None)
    for _ in range(15):
        step(world)
    assert world.bodies()[0].low[1] == pytest.approx(0.0, abs=0.01)
    step(world, Reset())
    assert world.bodies()[0].low[1] == pytest.approx(0.0, abs=0.01)  # its start is a place in the room


def test_a_state_has_the_turn(world):
    saved = state_of(world, {"scene": "room"})
    step(world, Undo())
    world.room.place(np.eye(4))
    put_state(world, saved, "here")
    assert_allclose(world.room.pose[:3, :3], TURN, atol=1e-9)


def test_the_file_keeps_it_and_objects_and_cameras_go_along(world, folder):
    """Two keeps of one turn are one turn; a state that was saved now would be of another file."""
    old = read_room(folder)
    step(world, Pause(True), KeepFrame())
    room, asset = read_room(folder), Asset.load(folder / "room.h5")
    assert asset.environment.planes[1][0] == "table" and not world.room.turned
    assert_allclose(room.objects[0].position[1], 0.0, atol=0.02)
    assert abs(np.array(room.objects[0].rotation) @ [1, 0, 0, 0]) == pytest.approx(1.0, abs=1e-6)
    seen = [r.cameras[0].world_to_camera @ [*r.objects[0].position, 1.0] for r in (room, old)]
    assert_allclose(*seen, atol=1e-6)
    assert_allclose(room.room_from_capture[:3, :3], TURN @ old.room_from_capture[:3, :3], atol=1e-9)
    with pytest.raises(BadInput, match="Take hold of something"):
        frame_writer(world, None)
    with pytest.raises(BadInput, match="has been turned since"):
        state_of(world, {"scene": "room"})


def test_a_room_that_is_being_captured_anew_is_not_turned(folder):
    """Before its manifest is back it is no room, and only half of it would be turned."""
    before = (folder / "room.h5").read_bytes()
    with locked_folder(folder), pytest.raises(BadInput, match="is being written by another run"):
        write_room_turned(folder / "room.h5", TURN)
    assert (folder / "room.h5").read_bytes() == before


def test_only_a_room_of_the_users_turns(folder):
    own = Body(str(folder / "room.h5"))
    light = Light((0.0, 2.0, 0.0))
    assert own_room(Scene([own], light, (0, 1, 1), (0, 0, 0))) is own
    assert own_room(Scene([Body("study")], light, (0, 1, 1), (0, 0, 0))) is None
    assert own_room(Scene([own, Body("bottle")], light, (0, 1, 1), (0, 0, 0))) is own
    assert own_room(Scene([Body("study"), own], light, (0, 1, 1), (0, 0, 0))) is None
