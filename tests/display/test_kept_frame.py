"""Up, front and size that the user corrects in play are in the file at the next start."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assets.asset import Asset
from assets.formats.ply import write_ply
from assets.library import SHIPPED_FOLDER
from core.camera import look_at, perspective
from core.errors import BadInput
from core.rotation import matrices_from_quaternions
from core.vocabulary import Body, Light, Plane
from display.keep.keeper import Keeper
from display.keep.kept_frame import frame_writer
from display.protocol import Frame
from display.user_commands import KeepFrame, Pause, Place, Rescale, Rotate, TurnUp
from display.viewed_file import ViewedFile, scene_around
from display.viewer import Viewer
from scenes.dining_table import RING_MATERIAL as RUBBER
from scenes.scene import Scene
from tests.support.samples import some_gaussians

SIZE = (96, 64)
HALF = (float(np.sqrt(0.5)), 0.0, float(np.sqrt(0.5)), 0.0)  # a quarter turn about the vertical
OVER = (float(np.sqrt(0.5)), float(np.sqrt(0.5)), 0.0, 0.0)  # on its back


@pytest.fixture(scope="module")
def own(tmp_path_factory, ti_cpu):
    """A world of a brick of the user's own that the scene puts down askew, and a shipped one; and the user's file."""
    from display.world import World

    path = tmp_path_factory.mktemp("own") / "brick.h5"
    path.write_bytes((SHIPPED_FOLDER / "brick_letters.h5").read_bytes())
    askew = (0.8, 0.0, 0.6, 0.0)
    bodies = [Body(str(path), RUBBER, (0.0, 0.3, 0.0), askew), Body("brick_red", RUBBER, (0.3, 0.3, 0.0))]
    scene = Scene(bodies, Light((0.3, 2.0, 0.3)), (0, 0.5, 0.9), (0, 0.1, 0), [Plane((0, 0, 0), (0, 1, 0))])
    return World(scene, width=SIZE[0], height=SIZE[1]), path


def step(world, *commands):
    camera = perspective(*SIZE, 0.9, look_at((0, 0.5, 0.9), (0, 0.1, 0)))
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
