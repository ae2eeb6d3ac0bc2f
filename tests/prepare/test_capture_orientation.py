"""Up, size and front of captures whose frame, floor and size are known."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assets.gaussians import concatenate
from assets.orientation import support_plane, up_of_cameras
from core.camera import look_at
from core.rotation import matrices_from_quaternions
from prepare.room_capture.capture_orientation import capture_orientation
from prepare.train.capture import Capture, View
from tests.support.sample_scenes import TABLE, brick, legs, sheet
from tests.support.samples import discs

LENS = None  # no pixel is looked at
TURN = matrices_from_quaternions(np.array([0.4, -0.7, 0.2, 0.5]))  # of the world into the capture's frame


def rolled(pose: np.ndarray, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    by = np.eye(4)
    by[:2, :2] = [[c, -s], [s, c]]
    return by @ pose


def orbit(rng, count: int, arc: float, height: float, roll: float = np.radians(3.0), radius: float = 2.0):
    """Hand-held cameras (count, 4, 4) on an arc [rad] about the front, +z, `height` over what they look at."""
    turns = arc * (np.linspace(-0.5, 0.5, count) + rng.normal(0, 0.02, count))
    poses = []
    for turn in turns:
        eye = radius * np.array([np.sin(turn), 0.0, np.cos(turn)]) + [0, height + rng.normal(0, 0.1), 0]
        poses.append(rolled(look_at(eye, rng.normal(0, 0.1, 3)), rng.normal(0, roll)))
    return np.array(poses)


def in_frame(poses: np.ndarray, scale: float = 1.0, shift=(0.0, 0.0, 0.0)) -> np.ndarray:
    """The poses where the world is turned by TURN, scaled and displaced."""
    moved = poses.copy()
    moved[:, :3, :3] = poses[:, :3, :3] @ TURN.T
    moved[:, :3, 3] = scale * poses[:, :3, 3] - np.einsum("nij,j->ni", moved[:, :3, :3], np.asarray(shift, float))
    return moved


def capture_of(poses: np.ndarray) -> Capture:
    return Capture(Path(), [View(Path(f"{k:03}.jpg"), LENS, pose) for k, pose in enumerate(poses)])


def degrees_apart(a, b) -> float:
    return float(np.degrees(np.arccos(np.clip(np.dot(a, b), -1, 1))))


@pytest.mark.parametrize(("arc", "height"), [(2 * np.pi, 1.0), (np.pi, 1.2), (np.radians(50), 1.5)])
def test_cameras_that_look_down_from_one_side_do_not_lean_the_world(arc, height):
    """The mean of the pictures' own up leans towards the cameras by their tilt; their horizontal axes do not."""
    poses = in_frame(orbit(np.random.default_rng(0), 60, arc, height))
    up, error = up_of_cameras(poses)
    mean = -poses[:, 1, :3].sum(0)
    apart = degrees_apart(up, TURN[:, 1])
    assert apart < max(1.5, 3 * np.degrees(error)) and apart < 4.0
    assert arc == 2 * np.pi or degrees_apart(mean / np.linalg.norm(mean), TURN[:, 1]) > 15.0


def test_pictures_held_on_their_side_and_upside_down_are_told_apart():
    rng = np.random.default_rng(1)
    quarters = np.repeat([0, 1, 3, 2], [30, 15, 10, 3])
    poses = orbit(rng, len(quarters), 5.0, 0.7)
    turned = np.array([rolled(pose, q * np.pi / 2) for pose, q in zip(poses, quarters, strict=True)])
    assert degrees_apart(up_of_cameras(in_frame(turned))[0], TURN[:, 1]) < 1.5


def test_some_pictures_held_askew_do_no_harm():
    """A third, all turned the same way and taken from one side: least squares without limits are off by 90 degrees."""
    rng = np.random.default_rng(2)
    poses = orbit(rng, 60, 2.0, 0.7)
    poses[::3] = [rolled(pose, rng.uniform(0.4, 1.1)) for pose in poses[::3]]
    assert degrees_apart(up_of_cameras(poses)[0], (0, 1, 0)) < 1.5


def test_the_error_that_is_said_is_the_error_that_is_made():
    """Of 200 series of every kind two thirds lie within the error, and 19 of 20 within twice that."""
    rng, ratios = np.random.default_rng(3), []
    for _ in range(200):
        poses = orbit(rng, int(rng.integers(8, 40)), rng.uniform(0.1, 6.0), 2.0 * np.tan(rng.normal(0, 0.44)), 0.07)
        up, error = up_of_cameras(poses)
        ratios.append(np.radians(degrees_apart(up, (0, 1, 0))) / error)
    assert 0.55 < np.mean(np.array(ratios) < 1.0) < 0.9 and np.mean(np.array(ratios) < 2.0) > 0.9


@pytest.fixture(scope="module")
def table():
    """A table on a floor, in a frame that is turned, 0.4 units a metre and displaced, and its cameras."""
    rng = np.random.default_rng(4)
    world = concatenate([
        sheet(rng, (-3, 0, 3), (6, 0, 0), (0, 0, -6), 0.05, 0.004),
        brick(rng, *TABLE, 0.02, 0.004),
        legs(rng, TABLE, 0.02, 0.004),
    ])  # fmt: skip
    shift, poses = np.array([1.0, -2.0, 0.5]), orbit(rng, 40, np.pi, 0.8)
    poses[:, :3, 3] -= poses[:, :3, :3] @ [0.0, 0.7, 0.0]  # around the table's top
    return world.transformed(TURN, shift, 0.4), capture_of(in_frame(poses, 0.4, shift)), poses


def test_a_floor_that_agrees_with_the_cameras_makes_up_exact_and_gives_the_size(table):
    """The floor is the plane under the table, whose top is nearer and dense; eyes were 1.5 m over it."""
    gaussians, capture, _ = table
    found = capture_orientation(capture, gaussians)
    assert found.floor_seen and not found.measured
    assert degrees_apart(found.up, TURN[:, 1]) < 0.3
    assert found.scale * 0.4 == pytest.approx(1.0, rel=0.1)
    world = found.gaussians(gaussians)
    assert abs(np.median(world.means[:14_000, 1])) < 0.01
    assert any("may be" in line for line in found.described())


@pytest.mark.parametrize(("side", "height"), [(1.2, 0.0), (0.6, 0.7)])
def test_a_plane_under_the_largest_is_the_floor_if_it_is_not_much_smaller(side, height):
    """Of a table of 1.6 m square, 0.7 m high: what is seen of the floor has 56% of its area, a shelf 14%."""
    rng = np.random.default_rng(1)
    planes = [
        sheet(rng, (-0.5 * s, y, 0.5 * s), (s, 0, 0), (0, 0, -s), 0.03, 0.003) for s, y in ((1.6, 0.7), (side, 0.0))
    ]
    places = np.array([-p[:3, :3].T @ p[:3, 3] for p in orbit(rng, 20, 2 * np.pi, 0.8)]) + [0, 0.7, 0]
    up = np.array([0.0, 1.0, 0.0])
    found = support_plane(concatenate(planes), places, up, 0.02)
    assert found[1] == pytest.approx(height, abs=0.02)


@pytest.mark.parametrize("rough", [0.003, 0.02])
def test_a_bare_floor_is_a_plane(rough):
    """Its range of heights is its roughness [m], of which no thin layer has much."""
    rng = np.random.default_rng(1)
    places = np.array([-p[:3, :3].T @ p[:3, 3] for p in orbit(rng, 20, 2 * np.pi, 1.5)])
    floor = sheet(rng, (-2, 0, 2), (4, 0, 0), (0, 0, -4), 0.06, rough)
    normal, height = support_plane(floor, places, np.array([0.0, 1.0, 0.0]), 0.02)
    assert degrees_apart(normal, (0.0, 1.0, 0.0)) < 0.3 and abs(height) < 0.1 * rough + 1e-3


def test_cameras_move_with_what_they_show(table):
    """A point has the same pixel before and after; the front is where the photographs were taken from."""
    gaussians, capture, _ = table
    found = capture_orientation(capture, gaussians)
    x = gaussians.means[::500].astype(float)
    for view in capture.views[::10]:
        before = x @ view.world_to_camera[:3, :3].T + view.world_to_camera[:3, 3]
        pose = found.pose(view.world_to_camera)
        after = (found.scale * (x @ found.rotation.T) + found.shift) @ pose[:3, :3].T + pose[:3, 3]
        assert_allclose(after, found.scale * before, atol=1e-9)
    places = np.array([-p[:3, :3].T @ p[:3, 3] for p in (found.pose(v.world_to_camera) for v in capture.views)])
    assert places[:, 1].min() > 0.5 and abs(places[:, 0].mean()) < 0.3 and places[:, 2].mean() > 1.0
    assert found.front_from == "most photographs"


def test_a_plane_that_leans_against_the_cameras_is_not_taken(table):
    """A slope of 30 degrees under cameras that agree on the vertical within one."""
    _, capture, _ = table
    rng = np.random.default_rng(5)
    slope = sheet(rng, (-3, -1.7, 3), (6, 3.4, 0), (0, 0, -6), 0.05, 0.004)
    found = capture_orientation(capture, slope.transformed(TURN, (1.0, -2.0, 0.5), 0.4))
    assert not found.floor_seen and "no floor was seen" in found.described()[1]
    assert degrees_apart(found.up, TURN[:, 1]) < 2.0


def test_a_measured_scale_is_taken(table):
    gaussians, capture, _ = table
    found = capture_orientation(capture, gaussians, 2.5)
    assert found.scale == 2.5 and found.measured and found.described()[1].endswith("measured")


def test_cameras_alone_give_up_and_front():
    poses = orbit(np.random.default_rng(6), 30, 2 * np.pi, 0.5)
    found = capture_orientation(capture_of(in_frame(poses)), discs(np.zeros((0, 3))))
    assert found.front_from == "first photograph" and not found.floor_seen
    assert degrees_apart(found.up, TURN[:, 1]) < 3 * np.degrees(found.error)
    first = found.pose(in_frame(poses)[0])
    assert (-first[:3, :3].T @ first[:3, 3])[2] > 1.0
