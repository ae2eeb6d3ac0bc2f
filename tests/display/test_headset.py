"""The headset's arithmetic and its player, without a runtime; tests/display/test_headset_play.py plays in a real one."""

import dataclasses
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace as N

import numpy as np
import pytest
from numpy.testing import assert_allclose

from display.protocol import Redo, SetInteraction, Undo
from display.xr.actions import ANALOG, KINDS, POSES, PROFILES, Controller
from display.xr.player import GRAB_REACH, PINCH_REACH, TURN, Player
from display.xr.poses import ARM, STEP, Standpoint, eye_camera, matrix_of, position_rotation
from display.xr.teleport import FARTHEST, on_the_floor
from scenes import registry, ring_toss

PROGRAM = Path(__file__).resolve().parents[2] / "vrgs.py"


def pose(rotation=(0.0, 0.0, 0.0, 1.0), position=(0.0, 0.0, 0.0)):
    return N(
        orientation=N(**dict(zip("xyzw", rotation, strict=True))), position=N(**dict(zip("xyz", position, strict=True)))
    )


def about_y(angle, position=(0.0, 0.0, 0.0)):
    return matrix_of(pose((0.0, np.sin(angle / 2), 0.0, np.cos(angle / 2)), position))


def test_an_eye_that_looks_ahead_sees_what_is_left_on_the_left_and_what_is_up_above():
    fov = N(angle_left=-0.8, angle_right=0.6, angle_up=0.7, angle_down=-0.9)
    camera = eye_camera(1000, 800, fov, about_y(0.0, (0.1, 1.6, 0.0)))
    for point, at in (((0.1 + np.tan(-0.8), 1.6, -1.0), (0.0, None)), ((0.1 + np.tan(0.6), 1.6, -1.0), (1000.0, None))):
        p = camera.world_to_camera @ [*point, 1.0]
        assert_allclose(camera.cx + camera.fx * p[0] / p[2], at[0], atol=1e-9)
    for y, row in ((1.6 + np.tan(0.7), 0.0), (1.6 - np.tan(0.9), 800.0)):
        p = camera.world_to_camera @ [0.1, y, -1.0, 1.0]
        assert_allclose(camera.cy + camera.fy * p[1] / p[2], row, atol=1e-9)
    assert_allclose(camera.position, [0.1, 1.6, 0.0], atol=1e-12)
    assert np.linalg.det(camera.world_to_camera[:3, :3]) == pytest.approx(1.0)


def test_turning_the_head_turns_the_camera():
    fov = N(angle_left=-0.7, angle_right=0.7, angle_up=0.7, angle_down=-0.7)
    camera = eye_camera(100, 100, fov, about_y(np.pi / 2))  # to the left
    p = camera.world_to_camera @ [-2.0, 0.0, 0.0, 1.0]
    assert_allclose(p[:3], [0.0, 0.0, 2.0], atol=1e-12)


def test_poses_come_back_as_positions_and_quaternions():
    q = np.array([0.1, -0.5, 0.3, 0.8])
    q /= np.linalg.norm(q)
    position, rotation = position_rotation(matrix_of(pose(q, (1.0, 2.0, 3.0))))
    assert position == (1.0, 2.0, 3.0)
    assert_allclose(np.array(rotation) * np.sign(rotation[0]), [q[3], *q[:3]], atol=1e-12)


@pytest.mark.parametrize("name", registry.names())
def test_the_player_begins_facing_the_scene(name):
    scene = registry.load(name)
    stage = Standpoint.before(scene.eye, scene.target).matrix
    assert_allclose(stage[:3, 3], [scene.eye[0], 0.0, scene.eye[2]])
    ahead, way = -stage[:3, 2], np.subtract(scene.target, scene.eye)
    assert_allclose(ahead, np.array([way[0], 0.0, way[2]]) / np.hypot(way[0], way[2]), atol=1e-12)


def test_a_turn_leaves_the_head_where_it_is():
    stand, head = Standpoint(1.0, 0.0, -2.0, 0.3), about_y(0.4, (0.3, 1.6, 0.2))
    before = stand.matrix @ head
    stand.turn(0.5, before[:3, 3])
    after = stand.matrix @ head
    assert_allclose(after[:3, 3], before[:3, 3], atol=1e-12)
    ahead = [-m[:3, 2] for m in (before, after)]
    assert_allclose(np.cross(*ahead)[1], np.sin(0.5), atol=1e-12)  # to the left


@pytest.fixture
def player():
    return Player(registry.load("ring_toss"))


WORLD = N(interaction="physics", demo=False, paused=False)


def both(left=None, right=None):
    return [left or Controller(), right or Controller()]


def test_a_fist_takes_more_than_two_fingers(player):
    here = about_y(0.0, (0.1, 1.0, -0.4))
    hands, _ = player.advance(both(Controller(grip=here, grab=1.0), Controller(grip=here, pinch=1.0)), np.eye(4), WORLD)
    assert [h.grip for h in hands] == [True, True]
    assert [h.reach for h in hands] == [GRAB_REACH, PINCH_REACH]
    assert_allclose(hands[0].position, (player.standpoint.matrix @ here)[:3, 3])


def test_a_trembling_finger_does_not_let_go(player):
    here = about_y(0.0)
    grips = []
    for level in (0.5, 0.65, 0.5, 0.55, 0.45, 0.3, 0.5):
        hands, _ = player.advance(both(Controller(grip=here, grab=level)), np.eye(4), WORLD)
        grips.append(hands[0].grip)
    assert grips == [False, True, True, True, True, False, False]


def test_a_lost_controller_stays_and_holds_on(player):
    here = about_y(0.0, (0.0, 1.0, -0.3))
    first, _ = player.advance(both(Controller(grip=here, grab=1.0)), np.eye(4), WORLD)
    lost, _ = player.advance(both(Controller(grip=None, grab=0.0)), np.eye(4), WORLD)
    assert lost[0] == first[0] and lost[0].grip


def test_the_stick_turns_one_step_at_a_time(player):
    yaw = player.standpoint.yaw
    for x in (0.9, 0.8, 0.5, 0.0, 0.9, 0.0, -0.9, 0.0):
        player.advance(both(Controller(stick=(x, 0.1))), np.eye(4), WORLD)
    assert player.standpoint.yaw == pytest.approx(yaw - TURN)  # twice right, once left


def test_the_stick_goes_where_the_hand_points(player):
    down = np.eye(4)
    down[:3, :3] = [[1, 0, 0], [0, np.cos(-0.5), -np.sin(-0.5)], [0, np.sin(-0.5), np.cos(-0.5)]]
    down[:3, 3] = 0.2, 1.2, -0.1
    head = about_y(0.0, (0.3, 1.6, 0.2))
    wanted, start = on_the_floor(player.standpoint.matrix @ down), player.standpoint.matrix
    for _ in range(3):
        player.advance(both(right=Controller(aim=down, stick=(0.0, 1.0))), head, WORLD)
        assert_allclose(player.pointing[1], wanted)  # it is shown, and nobody moves yet
        assert_allclose(player.standpoint.matrix, start)
    player.advance(both(right=Controller(aim=down)), head, WORLD)
    assert player.pointing is None
    after = (player.standpoint.matrix @ head)[:3, 3]
    assert_allclose(after[[0, 2]], wanted[[0, 2]], atol=1e-12)
    assert wanted[1] == pytest.approx(0.0)


def test_a_stick_that_is_drawn_back_goes_nowhere(player):
    down = about_y(0.0, (0.0, 1.0, 0.0)) @ matrix_of(pose((np.sin(-0.25), 0.0, 0.0, np.cos(-0.25))))
    start = player.standpoint.matrix
    for y in (1.0, -0.8, 0.9, 0.0):  # to and fro without rest
        player.advance(both(right=Controller(aim=down, stick=(0.0, y))), np.eye(4), WORLD)
    assert_allclose(player.standpoint.matrix, start)


def test_pointing_at_the_horizon_does_not_go_far():
    flat = np.eye(4)
    flat[:3, :3] = [[1, 0, 0], [0, np.cos(-0.01), -np.sin(-0.01)], [0, np.sin(-0.01), np.cos(-0.01)]]
    flat[1, 3] = 1.5
    assert np.linalg.norm(on_the_floor(flat)[[0, 2]]) == pytest.approx(FARTHEST)
    up = flat.copy()
    up[:3, :3] = flat[:3, :3].T
    assert on_the_floor(up) is None


def test_buttons_are_commands(player):
    _, commands = player.advance(both(Controller(pressed={"upper"}), Controller(pressed={"lower"})), np.eye(4), WORLD)
    assert commands == [SetInteraction("transform"), Redo()]
    _, commands = player.advance(both(Controller(pressed={"lower"}), Controller(pressed={"upper"})), np.eye(4), WORLD)
    assert commands == [Undo()]  # the left one shows the panel: display/xr/wrist_panel.py
    _, commands = player.advance(both(Controller(pressed={"upper"})), np.eye(4), None)
    assert commands == []


def test_hands_feel_taking_hold_and_what_pulls(player):
    felt = []
    actions = N(pulse=lambda h, strength, seconds: felt.append((h, round(strength, 3))))
    here = about_y(0.0)
    player.advance(both(right=Controller(grip=here, grab=1.0)), np.eye(4), WORLD)
    for force in (0.0, 5.0, 40.0, 0.01):
        pull = [np.zeros(3), np.array([0.0, force, 0.0])]
        player.feel(N(hand_forces=lambda p=pull: p, touch_forces=list), actions)
    assert [h for h, _ in felt] == [1, 1]
    assert 0 < felt[1][1] <= 1.0
    player.feel(N(hand_forces=list, touch_forces=list), actions)


def test_every_profile_names_known_actions_for_both_hands():
    for inputs in PROFILES.values():
        assert "grab" in inputs and set(inputs) <= set(KINDS)
        assert all(isinstance(at, str) or len(at) == 2 for at in inputs.values())
    assert set(POSES) | set(ANALOG) | {"upper", "lower", "point"} == set(KINDS)


def test_without_a_runtime_one_line_says_so(tmp_path):
    environment = {
        **os.environ,
        "XR_RUNTIME_JSON": str(tmp_path / "none.json"),
    }
    words = [sys.executable, PROGRAM, "--xr", "--arch", "cpu"]
    done = subprocess.run([str(w) for w in words], env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2
    assert done.stderr.startswith("vrgs: --xr: no OpenXR runtime") and done.stderr.count("\n") == 1
    assert done.stdout == ""


def test_the_player_begins_within_reach_of_what_can_be_held():
    scene = ring_toss.build()
    before, place = Standpoint.before(scene.eye, scene.target), Standpoint.of(scene)
    assert (place.yaw, place.y) == (before.yaw, before.y)
    ahead = -before.matrix[:3, 2]
    step = np.array([place.x - before.x, place.y - before.y, place.z - before.z])
    assert 0.1 < step @ ahead <= STEP + 1e-9
    assert_allclose(step, (step @ ahead) * ahead, atol=1e-9)
    near = min(np.hypot(b.position[0] - place.x, b.position[2] - place.z) for b in scene.bodies if b.material)
    assert near == pytest.approx(ARM, abs=0.05)
    empty = dataclasses.replace(scene, bodies=[])
    assert Standpoint.of(empty) == before
