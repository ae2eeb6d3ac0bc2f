"""The camera of a clip, found by photographs of the same place."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from assets.room_folder import RoomManifest, RoomObject, write_room
from core.camera import look_at, perspective
from core.errors import BadInput
from core.rotation import quaternions_from_matrices
from prepare.fit.clip_masks import Clip
from prepare.fit.register import CapturedPlace, camera_by, matched
from tests.support import patterned_room as made

NO_ROOM = made.Path("bear.h5")
MIDDLE, TOWARDS = np.array([-0.5, 0.6, -1.2]), np.array([0.4, 0.25, 0.88])


def true_camera(fov=41.0):
    """A camera with a field of view [degrees], as far away as it shows the same."""
    away = 0.5 / np.tan(0.5 * np.radians(fov))
    return perspective(480, 360, np.radians(fov), look_at(MIDDLE + 2.2 * away * TOWARDS, MIDDLE))


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


@pytest.mark.parametrize(("fov", "given"), [(20.0, None), (41.0, None), (85.0, None), (85.0, 85.0)])
def test_pose_and_focal_length_are_found(place, fov, given):
    """The thing is in front and hides a part; there is noise."""
    true = true_camera(fov)
    shown = made.photographed([*made.corner_of_a_room(1), *thing(MIDDLE + 0.5 * TOWARDS - [0, 0.3, 0])], true)
    noise = 2 * np.random.default_rng(0).normal(size=shown.shape)
    found = place.found_camera((shown + noise).clip(0, 255).astype(np.uint8), "clip", given)
    camera, (first, there) = found.camera, (made.cameras()[0], place.capture.cameras()[0])
    between = camera.world_to_camera @ np.linalg.inv(there.world_to_camera)
    off = between @ np.linalg.inv(true.world_to_camera @ np.linalg.inv(first.world_to_camera))
    assert np.degrees(Rotation.from_matrix(off[:3, :3]).magnitude()) < 0.5
    assert np.linalg.norm(off[:3, 3]) < 0.01 * np.linalg.norm(true.position - MIDDLE)
    assert_allclose([camera.fx, camera.fy], true.fx, rtol=0.02)
    assert abs(found.fov - fov) < 4 * found.error + 1e-9 and (found.error > 0) == (given is None)
    assert found.agree > 60 and found.residual < 1.5 and found.k1 == 0 and f"{found.agree} of" in found.described()
    assert camera.world_to_camera[1, 1] < -0.8  # upright


def test_a_lens_that_bends_is_found(place):
    found = place.found_camera(made.photographed(made.corner_of_a_room(1), true_camera(60.0), (-0.15,)), "clip")
    assert abs(found.k1 + 0.15) < 0.003 and abs(found.fov - 60) < 0.2 and f"k1 {found.k1:.3f}" in found.described()


def test_a_bend_that_few_points_do_not_show_is_not_taken():
    """Sixteen points in the middle of the picture, 0.5 px off: by least squares k1 is -1, and not sure."""
    rng, true = np.random.default_rng(0), true_camera()
    points = MIDDLE + 0.25 * rng.uniform(-1, 1, (16, 3))
    places = np.stack(true.projected(points)[:2], 1) + 0.5 * rng.normal(size=(16, 2))
    assert camera_by(points, places, (480, 360), 41.0).k1 == 0


SPOTS = np.array(
    [[x, y, z] for x in (-0.6, 0.5) for y in (0, 0.7) for z in (-1.2, -0.6)] + [[0.3, 1.3, -2], [-2, 1, -1]]
)


def clicks(camera, rng, some=slice(None)):
    """Places at which a user clicks SPOTS, about a pixel off; None for what is outside of the picture."""
    x, y, _ = camera.projected(SPOTS[some])
    places = np.stack([x, y], 1) + rng.normal(size=(len(x), 2))
    return [(u, v) if 0 < u < camera.width and 0 < v < camera.height else None for u, v in places.tolist()]


@pytest.mark.parametrize(("given", "some"), [(None, slice(None)), (60.0, slice(3, 10))])
def test_a_few_marked_points_give_the_camera(place, given, some):
    """Pictures of the clip are twice as large as they are read; a photograph without the last points has fewer."""
    rng, true = np.random.default_rng(0), true_camera(60.0)
    points = {"frame_0007": clicks(true.resized(960, 720), rng, some)}
    points |= {f"{k:02}.png": clicks(made.cameras()[k], rng, some) for k in (1, 4, 7)} | {"03.png": [None]}
    clip = Clip(np.zeros((1, 360, 480, 3), np.uint8), np.zeros(1), 7, "clip", (960, 720))
    found = place.clicked_camera(points, clip, clip.filmed, given)
    between = found.camera.world_to_camera @ np.linalg.inv(place.capture.cameras()[0].world_to_camera)
    off = between @ np.linalg.inv(true.world_to_camera @ np.linalg.inv(made.cameras()[0].world_to_camera))
    assert np.degrees(Rotation.from_matrix(off[:3, :3]).magnitude()) < 1.5 and np.linalg.norm(off[:3, 3]) < 0.08
    assert abs(found.fov - 60) < 3 * found.error + 1e-9 and found.agree >= (6 if given is None else 4)
    few = {view: row[:3] for view, row in points.items()}
    with pytest.raises(BadInput, match=r"clip: [0-3] points are marked in frame_0007 and .* fewer than [46] agree"):
        place.clicked_camera(few, clip, clip.filmed, given)
    with pytest.raises(BadInput, match=r"clip: points in frame_0009: they belong in frame_0007 and in photographs"):
        place.clicked_camera(points | {"frame_0009": [(1.0, 2.0)]}, clip, clip.filmed, given)
    with pytest.raises(BadInput, match="clip: 0 points are marked"):
        place.clicked_camera({"04.png": points["04.png"]}, clip, clip.filmed, given)


@pytest.mark.parametrize("shown", [made.corner_of_a_room(2), []], ids=["another room", "nothing"])
def test_another_place_is_refused_in_one_line(place, shown):
    with pytest.raises(BadInput, match=r"clip: the clip shows too little of what .* \d+ of \d+ features") as e:
        place.found_camera(made.photographed(shown, true_camera()), "clip")
    assert "\n" not in str(e.value)


def test_a_wall_seen_from_the_front_does_not_show_how_far_away_it_is(place):
    front = perspective(480, 360, np.radians(30), look_at((-0.2, 1.5, 1.5), (-0.2, 1.5, -2)))
    picture = made.photographed(made.corner_of_a_room(1)[:1], front)
    with pytest.raises(BadInput, match=r"clip: its field of view is not sure .* give --fov"):
        place.found_camera(picture, "clip")
    assert place.found_camera(picture, "clip", 30.0).agree > 60


def test_a_feature_that_is_as_like_to_another_is_not_matched():
    """Descriptors at angles [rad] from its own, to two sides."""
    for one, other, row in ((0.3, 0.5, 0), (0.45, 0.5, -1)):
        two = np.array([[np.cos(one), np.sin(one), 0.0], [np.cos(other), 0.0, np.sin(other)]])
        assert matched(np.eye(1, 3), two).tolist() == [row]


def write_poses(model):
    """The poses as `capture` keeps those that it has found."""
    model.mkdir(parents=True)
    c, rows = made.cameras()[0], []
    (model / "cameras.txt").write_text(f"1 PINHOLE {c.width} {c.height} {c.fx} {c.fy} {c.cx} {c.cy}\n")
    for k, camera in enumerate(made.cameras()):
        pose = [*quaternions_from_matrices(camera.world_to_camera[:3, :3]), *camera.world_to_camera[:3, 3]]
        rows.append(f"{k} {' '.join(map(str, pose))} 1 {k:02}.png\n\n")
    (model / "images.txt").write_text("".join(rows))


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
    u, v, depth = found.placed(true_camera()).projected(x @ matrix[:3, :3].T + matrix[:3, 3])
    assert_allclose([u, v, depth / 0.4], true_camera().projected(x))
    write_poses(tmp_path / "work/poses/sparse")
    kept = CapturedPlace.of(folder / "images", tmp_path / "objects/bear.h5")  # which has no poses of its own
    assert_allclose(kept.capture.views[3].world_to_camera, place.capture.views[3].world_to_camera, atol=1e-9)
    write_room(tmp_path, replace(room, cameras=room.cameras[::-1]))
    with pytest.raises(BadInput, match=r"is not the capture that .* was made of"):
        CapturedPlace.of(folder, tmp_path / "objects/bear.h5")
