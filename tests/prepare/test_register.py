"""The camera of a clip, found by photographs of the same place."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from assets.room_folder import RoomManifest, RoomObject, write_room
from core.camera import look_at, perspective
from core.errors import BadInput
from prepare.fit.register import CapturedPlace
from tests.support import patterned_room as made

NO_ROOM = made.Path("bear.h5")
TRUE = perspective(480, 360, np.radians(41), look_at((0.5, 1.1, 1.6), (-0.5, 0.6, -1.2)))


def thing(low, size=0.35):
    """The thing that the clip is of: it stands elsewhere in the photographs."""
    return made.box(np.random.default_rng(9), low, (size, size, size))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("place")
    made.write_room(path, [*made.corner_of_a_room(1), *thing((-0.3, 0.7, -1.0))])
    return path


@pytest.fixture(scope="module")
def place(folder):
    return CapturedPlace.of(folder, NO_ROOM)


@pytest.fixture(scope="module")
def picture():
    """The clip's: the thing is in front and hides a part, and there is noise."""
    shown = made.photographed([*made.corner_of_a_room(1), *thing((0.1, 0.4, 0.3))], TRUE)
    return (shown + 2 * np.random.default_rng(0).normal(size=shown.shape)).clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize("fov", [None, 41.0])
def test_pose_and_focal_length_are_found(place, picture, fov):
    found = place.found_camera(picture, "clip", fov)
    first, camera = made.cameras()[0], found.camera
    between = camera.world_to_camera @ np.linalg.inv(place.capture.cameras()[0].world_to_camera)
    off = between @ np.linalg.inv(TRUE.world_to_camera @ np.linalg.inv(first.world_to_camera))
    assert np.degrees(Rotation.from_matrix(off[:3, :3]).magnitude()) < 0.5
    assert np.linalg.norm(off[:3, 3]) < 0.01 * 3.0  # the distance of what it looks at
    assert_allclose([camera.fx, camera.fy], TRUE.fx, rtol=0.02)
    high = 2 * np.degrees(np.arctan(0.5 * camera.height / camera.fy))
    assert abs(high - 41) < 4 * found.error + 1e-9 and found.error < (0.5 if fov is None else 1e-9)
    assert found.agree > 60 and found.residual < 1.5 and f"{found.agree} of" in found.described()
    assert camera.world_to_camera[1, 1] < -0.8  # upright


@pytest.mark.parametrize("shown", [made.corner_of_a_room(2), []], ids=["another room", "nothing"])
def test_another_place_is_refused_in_one_line(place, shown):
    with pytest.raises(BadInput, match=r"clip: the clip shows too little of what .* \d+ of \d+ features") as e:
        place.found_camera(made.photographed(shown, TRUE), "clip")
    assert "\n" not in str(e.value)


def test_a_camera_is_placed_in_the_room_of_the_asset(folder, place, tmp_path):
    """There it sees the room's points where it saw the capture's."""
    matrix = np.eye(4)
    matrix[:3, :3] = 0.4 * Rotation.from_euler("yx", [1.2, 0.05]).as_matrix()
    matrix[:3, 3] = [0.3, 0.1, -2.0]
    objects = (RoomObject("bear", "objects/bear.h5", (0, 0, 0), (1, 0, 0, 0)),)
    room = RoomManifest("room.h5", objects, (0, 1, 2), (0, 0, 0), 1.0, 0.0, 0.4, matrix, ())
    room = replace(room, cameras=tuple(CapturedPlace(place.capture, room).placed(c) for c in place.capture.cameras()))
    (tmp_path / "objects").mkdir()
    for name in ("room.h5", "objects/bear.h5"):
        (tmp_path / name).touch()
    write_room(tmp_path, room)
    found = CapturedPlace.of(folder, tmp_path / "objects/bear.h5")
    x = np.random.default_rng(0).uniform(-1, 1, (20, 3))
    u, v, depth = found.placed(TRUE).projected(x @ matrix[:3, :3].T + matrix[:3, 3])
    assert_allclose([u, v, depth / 0.4], TRUE.projected(x))
    write_room(tmp_path, replace(room, cameras=room.cameras[::-1]))
    with pytest.raises(BadInput, match=r"is not the capture that .* was made of"):
        CapturedPlace.of(folder, tmp_path / "objects/bear.h5")
