"""The headset's arithmetic and its player, without a runtime; test_headset_play.py plays in a real one."""

import dataclasses
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace as N

import numpy as np
import pytest
from numpy.testing import assert_allclose

from core.rotation import pose_matrix
from display.user_commands import Redo, SetInteraction, Undo
from display.xr.actions import ACTIONS, EVERY_PROFILE, PROFILES, Controller
from display.xr.hand_joints import rotation_about
from display.xr.player import GRAB_RADIUS, MAX_TELEPORT, PINCH_RADIUS, SNAP_TURN, Player, floor_hit
from display.xr.poses import ARM_LENGTH, MAX_STEP_AHEAD, PlaySpace, eye_camera, matrix_of, position_rotation
from scenes import registry, ring_toss
from tests.support.fake_view import FakeView

PROGRAM = Path(__file__).resolve().parents[2] / "vrgs.py"
WORLD = FakeView()


def turned(angle, position=(0.0, 0.0, 0.0), axis=(0, 1, 0)):
    return pose_matrix(position, rotation_about(axis, angle))


def pitched(angle, position=(0.0, 0.0, 0.0)):
    return turned(angle, position, (1, 0, 0))


def test_an_eye_that_looks_ahead_sees_what_is_left_on_the_left_and_what_is_up_above():
    fov = N(angle_left=-0.8, angle_right=0.6, angle_up=0.7, angle_down=-0.9)
    camera = eye_camera(1000, 800, fov, turned(0.0, (0.1, 1.6, 0.0)))
    for x, y, u, v in ((np.tan(-0.8), np.tan(0.7), 0.0, 0.0), (np.tan(0.6), -np.tan(0.9), 1000.0, 800.0)):
        p = camera.world_to_camera @ [0.1 + x, 1.6 + y, -1.0, 1.0]
        found = camera.cx + camera.fx * p[0] / p[2], camera.cy + camera.fy * p[1] / p[2]
        assert_allclose(found, (u, v), atol=1e-9)
    assert_allclose(camera.position, [0.1, 1.6, 0.0], atol=1e-12)
    assert np.linalg.det(camera.world_to_camera[:3, :3]) == pytest.approx(1.0)
    left = eye_camera(1000, 800, fov, turned(np.pi / 2))
    assert_allclose((left.world_to_camera @ [-2.0, 0.0, 0.0, 1.0])[:3], [0.0, 0.0, 2.0], atol=1e-12)


def test_openxrs_poses_become_positions_and_quaternions():
    q = np.array([0.1, -0.5, 0.3, 0.8])
    q /= np.linalg.norm(q)
    pose = N(orientation=N(**dict(zip("xyzw", q, strict=True))), position=N(x=1.0, y=2.0, z=3.0))
    position, rotation = position_rotation(matrix_of(pose))
    assert position == (1.0, 2.0, 3.0)
    assert_allclose(np.array(rotation) * np.sign(rotation[0]), [q[3], *q[:3]], atol=1e-12)


@pytest.mark.parametrize("name", registry.names())
def test_the_player_begins_facing_the_scene(name):
    scene = registry.load(name)
    start = PlaySpace.facing(scene.eye, scene.target).world_from_play
    assert_allclose(start[:3, 3], [scene.eye[0], 0.0, scene.eye[2]])
    direction = np.subtract(scene.target, scene.eye) * [1, 0, 1]
    assert_allclose(-start[:3, 2], direction / np.linalg.norm(direction), atol=1e-12)


def test_the_player_begins_within_reach_of_what_can_be_held():
    scene = ring_toss.build()
    before, start = PlaySpace.facing(scene.eye, scene.target), PlaySpace.of(scene)
    assert (start.yaw, start.y) == (before.yaw, before.y)
    ahead = -before.world_from_play[:3, 2]
    step = np.array([start.x - before.x, start.y - before.y, start.z - before.z])
    assert 0.1 < step @ ahead <= MAX_STEP_AHEAD + 1e-9
    assert_allclose(step, (step @ ahead) * ahead, atol=1e-9)
    nearest = min(np.hypot(b.position[0] - start.x, b.position[2] - start.z) for b in scene.bodies if b.material)
    assert nearest == pytest.approx(ARM_LENGTH, abs=0.05)
    assert PlaySpace.of(dataclasses.replace(scene, bodies=[])) == before


def test_a_turn_leaves_the_head_where_it_is():
    space, head = PlaySpace(1.0, 0.0, -2.0, 0.3), turned(0.4, (0.3, 1.6, 0.2))
    before = space.world_from_play @ head
    space.turn(0.5, before[:3, 3])
    after = space.world_from_play @ head
    assert_allclose(after, pose_matrix(before[:3, 3], rotation_about((0, 1, 0), 0.5) @ before[:3, :3]), atol=1e-12)


@pytest.fixture
def player():
    return Player(registry.load("ring_toss"))


def advance(player, left=None, right=None, head=None):
    return player.advance([left or Controller(), right or Controller()], np.eye(4) if head is None else head, WORLD)


def test_a_fist_takes_more_than_two_fingers(player):
    here = turned(0.0, (0.1, 1.0, -0.4))
    hands, _ = advance(player, Controller(grip=here, grab=1.0), Controller(grip=here, pinch=1.0))
    assert [h.grip for h in hands] == [True, True]
    assert [h.reach for h in hands] == [GRAB_RADIUS, PINCH_RADIUS]
    assert_allclose(hands[0].position, (player.play_space.world_from_play @ here)[:3, 3])


def test_a_trembling_finger_does_not_let_go(player):
    levels = (0.5, 0.65, 0.5, 0.55, 0.45, 0.3, 0.5)
    grips = [advance(player, Controller(grip=np.eye(4), grab=level))[0][0].grip for level in levels]
    assert grips == [False, True, True, True, True, False, False]


def test_a_lost_controller_stays_and_holds_on(player):
    first, _ = advance(player, Controller(grip=turned(0.0, (0.0, 1.0, -0.3)), grab=1.0))
    lost, _ = advance(player)
    assert lost[0] == first[0] and lost[0].grip


def test_the_stick_turns_one_step_at_a_time(player):
    yaw = player.play_space.yaw
    for x in (0.9, 0.8, 0.5, 0.0, 0.9, 0.0, -0.9, 0.0):
        advance(player, Controller(stick=(x, 0.1)))
    assert player.play_space.yaw == pytest.approx(yaw - SNAP_TURN)  # twice right, once left


def test_the_stick_goes_where_the_hand_points(player):
    down, head = pitched(-0.5, (0.2, 1.2, -0.1)), turned(0.0, (0.3, 1.6, 0.2))
    start = player.play_space.world_from_play
    wanted = floor_hit(start @ down)
    for _ in range(3):
        advance(player, right=Controller(aim=down, stick=(0.0, 1.0)), head=head)
        assert_allclose(player.pointing[1], wanted)  # it is shown, and nobody moves yet
        assert_allclose(player.play_space.world_from_play, start)
    advance(player, right=Controller(aim=down), head=head)
    assert player.pointing is None
    after = (player.play_space.world_from_play @ head)[:3, 3]
    assert_allclose(after[[0, 2]], wanted[[0, 2]], atol=1e-12)
    assert wanted[1] == pytest.approx(0.0)


def test_a_stick_that_is_drawn_back_goes_nowhere(player):
    start = player.play_space.world_from_play
    for y in (1.0, -0.8, 0.9, 0.0):  # to and fro without rest
        advance(player, right=Controller(aim=pitched(-0.5, (0.0, 1.0, 0.0)), stick=(0.0, y)))
    assert_allclose(player.play_space.world_from_play, start)


def test_pointing_at_the_horizon_does_not_go_far():
    assert np.linalg.norm(floor_hit(pitched(-0.01, (0, 1.5, 0)))[[0, 2]]) == pytest.approx(MAX_TELEPORT)
    assert floor_hit(pitched(0.01, (0, 1.5, 0))) is None


def test_buttons_are_commands(player):
    _, commands = advance(player, Controller(pressed={"upper"}), Controller(pressed={"lower"}))
    assert commands == [SetInteraction("transform"), Redo()]
    _, commands = advance(player, Controller(pressed={"lower"}), Controller(pressed={"upper"}))
    assert commands == [Undo()]  # the left one shows the panel: display/xr/wrist_panel.py


def test_hands_feel_taking_hold_and_what_pulls(player):
    felt = []
    actions = N(pulse=lambda h, strength, seconds: felt.append((h, round(strength, 3))))
    advance(player, right=Controller(grip=np.eye(4), grab=1.0))
    for force in (0.0, 5.0, 40.0, 0.01):
        pull = [np.zeros(3), np.array([0.0, force, 0.0])]
        player.feel(FakeView(hand_forces=lambda p=pull: p), actions)
    assert [h for h, _ in felt] == [1, 1]
    assert 0 < felt[1][1] <= 1.0
    player.feel(WORLD, actions)


def test_every_profile_binds_known_actions_of_both_hands():
    for inputs in PROFILES.values():
        assert "grab" in inputs and set(inputs) <= set(ACTIONS)
        assert all(isinstance(at, str) or len(at) == 2 for at in inputs.values())
    assert set(EVERY_PROFILE).union(*PROFILES.values()) == set(ACTIONS)


def test_without_a_runtime_one_line_says_so(tmp_path):
    environment = {**os.environ, "XR_RUNTIME_JSON": str(tmp_path / "none.json")}
    words = [sys.executable, PROGRAM, "--xr", "--arch", "cpu"]
    done = subprocess.run([str(w) for w in words], env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2
    assert done.stderr.startswith("vrgs: --xr: no OpenXR runtime") and done.stderr.count("\n") == 1
    assert done.stdout == ""
