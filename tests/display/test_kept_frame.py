"""Up, front and size that the user corrects in play, of a body or of a room, are in the file at the next start."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assets.asset import Asset
from assets.file_access import locked_folder
from assets.formats.ply import write_ply
from assets.library import SHIPPED_FOLDER
from assets.room_folder import RoomManifest, RoomObject, read_room, write_room
from core.camera import look_at, perspective
from core.errors import BadInput
from core.rotation import matrices_from_quaternions
from core.vocabulary import Body, Light, Plane
from display.edit.editor import own_room
from display.keep.keeper import Keeper
from display.keep.kept_frame import frame_writer, write_room_turned
from display.keep.scene_state import put_state, state_of
from display.protocol import Frame
from display.user_commands import KeepFrame, Pause, Place, Rescale, Reset, Rotate, TurnRoom, TurnUp, Undo
from display.viewed_file import ViewedFile, scene_around
from display.viewer import Viewer
from scenes.dining_table import RING_MATERIAL as RUBBER
from scenes.scene import Scene
from tests.support.leaning_room import leaning_room
from tests.support.samples import some_gaussians

SIZE = (96, 64)
HALF = (float(np.sqrt(0.5)), 0.0, float(np.sqrt(0.5)), 0.0)  # a quarter turn about the vertical
OVER = (float(np.sqrt(0.5)), float(np.sqrt(0.5)), 0.0, 0.0)  # on its back


@pytest.fixture(scope="module")
def own(tmp_path_factory, ti_cpu):
    """A world of a brick of the user's own that the scene puts down askew and larger, a shipped one, and the file."""
    from display.world import World

    path = tmp_path_factory.mktemp("own") / "brick.h5"
    path.write_bytes((SHIPPED_FOLDER / "brick_letters.h5").read_bytes())
    askew = (0.8, 0.0, 0.6, 0.0)
    bodies = [Body(str(path), RUBBER, (0.0, 0.3, 0.0), askew, scale=1.2), Body("brick_red", RUBBER, (0.3, 0.3, 0.0))]
    scene = Scene(bodies, Light((0.3, 2.0, 0.3)), (0, 0.5, 0.9), (0, 0.1, 0), [Plane((0, 0, 0), (0, 1, 0))])
    return World(scene, width=SIZE[0], height=SIZE[1]), path


def step(world, *commands):
    camera = perspective(*SIZE, 0.9, look_at(world.scene.eye, world.scene.target))
    frame = Frame(1 / 60, 0.0, [camera], [], list(commands))
    with Keeper("sandbox") as keeper:
        world.step(frame)
        keeper.after(frame, world)


def test_a_body_is_kept_as_it_stands_and_once_only(own):
    world, path = own
    before = Asset.load(path)
    step(world, Pause(True), Place(0, (0.0, 0.1, 0.0), OVER))
    step(world, Rescale(0, 1.5), KeepFrame(0))
    after = Asset.load(path)
    turn = matrices_from_quaternions(np.array([OVER, (0.8, 0.0, 0.6, 0.0)]))
    expected = 1.5 * before.cage.vertices @ (turn[1].T @ turn[0] @ turn[1]).T
    found = after.cage.vertices
    assert_allclose(found - found.mean(0), expected - expected.mean(0), atol=1e-4)
    assert found[:, 1].min() == pytest.approx(0.0, abs=1e-5)
    bytes_ = path.read_bytes()
    step(world, KeepFrame(0))
    assert "as it is here" in world.notice and path.read_bytes() == bytes_


def test_a_shipped_body_stays_as_it_is(own):
    world, _ = own
    with pytest.raises(BadInput, match="comes with the program"):
        frame_writer(world, 1)
    with pytest.raises(BadInput, match="Take hold of something"):
        world.editor.selected = None
        frame_writer(world, None)


def test_a_viewed_asset_is_turned_scaled_and_kept(ti_cpu, tmp_path):
    """The front of a room: keys turn and scale what is shown, and a key writes it; what is kept is not kept twice."""
    Asset(some_gaussians()).save(tmp_path / "room.h5")
    write_ply(tmp_path / "splat.ply", some_gaussians())
    files = [ViewedFile.read(tmp_path / "room.h5", None), ViewedFile.read(tmp_path / "splat.ply", None)]
    viewer = Viewer(files, scene_around(files[0].gaussians, 1.5), SIZE)
    before = Asset.load(tmp_path / "room.h5").gaussians.means
    step(viewer, Rotate(None, HALF), Rescale(None, 2.0))
    step(viewer, KeepFrame())
    after = Asset.load(tmp_path / "room.h5").gaussians.means
    assert_allclose(after, 2.0 * before @ matrices_from_quaternions(np.array(HALF)).T, atol=1e-4)
    step(viewer, KeepFrame())
    assert "as it is here" in viewer.notice
    viewer._carry_out(TurnUp("-z"))
    assert viewer.file.up == "-z"
    with pytest.raises(BadInput, match="O writes"):
        viewer._show(1)
        frame_writer(viewer, None)
    chances = [chance for _, chance, _ in viewer.up_choices]
    assert chances == sorted(viewer.file.chances.values(), reverse=True)[: len(chances)]
    assert len(viewer.up_choices) > 1, "a random cloud has no up"
    assert viewer.up_choices[0][2].shape == (140, 168, 3)
    assert not np.array_equal(viewer.up_choices[0][2], viewer.up_choices[1][2])
    step(viewer, TurnUp(viewer.up_choices[1][0]))
    assert len(viewer.up_choices) == 0


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
    assert world.bodies()[0].low[1] == pytest.approx(0.0, abs=0.02)  # its start is a place in the room
    for _ in range(15):
        step(world)
    assert world.bodies()[0].low[1] == pytest.approx(0.0, abs=0.01)  # out of the floor


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
