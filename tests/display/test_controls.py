"""Camera, hand, mouse and keys of a display, without a window."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from core.camera import look_at, perspective
from display.protocol import Duplicate, Pause, PlayDemo, Redo, Remove, Rescale, Reset, SetInteraction, SingleStep, Undo
from display.window.controls import HELP, LARGER, WALKING, Controls
from display.window.mouse_hand import FASTEST, MouseHand
from display.window.orbit_camera import STEEPEST, OrbitCamera
from display.window.window import project
from scenes.scene import Hand, Light
from tests.support.fake_world import RADIUS, FakeWorld

WIDTH, HEIGHT = 320, 180
CAMERA = perspective(WIDTH, HEIGHT, 0.9, look_at((0, 0, 3), (0, 0, 0)))
CENTRE = (WIDTH / 2, HEIGHT / 2)


def one(hands: list) -> Hand:
    """The only hand of a frame."""
    (hand,) = hands
    assert hand.grip
    return hand


class Target:
    """A world for the controls: a ball of 0.3 m at the origin."""

    pick, bodies = FakeWorld.pick, FakeWorld.bodies
    paused, demo, interaction, light, editable = False, False, "physics", Light((0.0, 2.0, 0.0)), True

    def __init__(self):
        self.ball, self.velocity, self._held = np.zeros(3), np.zeros(3), None


@pytest.fixture
def controls() -> Controls:
    return Controls(OrbitCamera((0, 0, 3), (0, 0, 0), 0.9), MouseHand())


# camera


def test_orbit_turns_around_the_target_and_stays_upright():
    orbit = OrbitCamera((0, 0, 3), (0, 0.5, 0), 0.9)
    before = orbit.distance
    orbit.turn(np.pi / 2, 0.0)
    assert orbit.eye[0] > 2.9 and abs(orbit.eye[2]) < 1e-9  # to the right of the target
    orbit.turn(0.0, 9.0)
    assert_allclose(np.arcsin((orbit.eye[1] - 0.5) / orbit.distance), STEEPEST)
    assert_allclose(orbit.distance, before)
    right = orbit.camera(WIDTH, HEIGHT).world_to_camera[0, :3]
    assert_allclose(right[1], 0.0, atol=1e-12)  # level horizon


def test_look_keeps_the_eye_and_turns_left_for_positive_yaw():
    orbit = OrbitCamera((0, 0, 3), (0, 0, 0), 0.9)
    orbit.look(0.3, 0.1)
    assert_allclose(orbit.eye, (0, 0, 3))
    assert orbit.target[0] < -0.5 and orbit.target[1] > 0.2


def test_move_follows_the_camera_axes_and_reset_returns():
    orbit = OrbitCamera((3, 0, 0), (0, 0, 0), 0.9)  # looks along -x: right is -z
    orbit.move(1.0, 2.0, 0.5)
    assert_allclose(orbit.eye, (2.5, 2.0, -1.0), atol=1e-12)
    assert_allclose(orbit.target, (-0.5, 2.0, -1.0), atol=1e-12)
    orbit.reset()
    assert_allclose(orbit.eye, (3, 0, 0))


def test_zoom_never_reaches_the_target():
    orbit = OrbitCamera((0, 0, 3), (0, 0, 0), 0.9)
    orbit.zoom(1)
    assert_allclose(orbit.distance, 2.7)
    orbit.zoom(1000)
    assert 0.04 < orbit.distance < 0.06 and np.isfinite(orbit.eye).all()


def test_project_is_the_inverse_of_the_ray():
    origin, direction = CAMERA.ray(200.0, 50.0)
    assert_allclose(project(CAMERA, origin + 2.5 * direction), (200.0, 50.0))
    assert project(CAMERA, origin - direction) is None


# hand


def test_a_grabbed_point_stays_under_the_cursor():
    hand = MouseHand()
    hand.grab(CAMERA, *CENTRE, 2.7, 0.05)
    assert_allclose(one(hand.hands(CAMERA, 0.016)).position, (0, 0, 0.3), atol=1e-12)
    hand.drag(60.0, -20.0)
    for _ in range(60):
        state = one(hand.hands(CAMERA, 1 / 60))
    assert state.grip and state.reach == 0.05
    assert_allclose(project(CAMERA, np.array(state.position)), (CENTRE[0] + 60, CENTRE[1] - 20), atol=1e-6)
    assert_allclose(state.position[2], 0.3)  # the plane parallel to the screen


def test_push_changes_the_depth_but_not_the_place_on_the_screen():
    hand = MouseHand()
    hand.grab(CAMERA, 220.0, 60.0, 2.0, 0.05)
    hand.push(0.5)
    for _ in range(60):
        state = one(hand.hands(CAMERA, 1 / 60))
    assert_allclose(project(CAMERA, np.array(state.position)), (220.0, 60.0), atol=1e-6)
    direction = CAMERA.ray(220.0, 60.0)[1]
    assert_allclose(np.linalg.norm(state.position - CAMERA.position), 2.0 * np.exp(0.5), rtol=1e-6)
    assert direction[2] < 0


def test_the_hand_moves_at_a_limited_speed_and_without_jumps():
    hand, dt = MouseHand(), 1 / 60
    hand.grab(CAMERA, *CENTRE, 2.7, 0.05)
    hand.drag(1e4, 0.0)
    before = np.array(one(hand.hands(CAMERA, 0.0)).position)
    after = np.array(one(hand.hands(CAMERA, dt)).position)
    assert_allclose(np.linalg.norm(after - before) / dt, FASTEST)


@pytest.mark.parametrize("rest", [0, 2])
def test_an_even_drag_throws_with_the_speed_of_the_cursor(rest):
    """2 px a frame; two frames of rest before the release cost at most those two of the last five."""
    hand, dt, speed = MouseHand(), 1 / 60, 2.0 / CAMERA.fx * 2.7 * 60
    hand.grab(CAMERA, *CENTRE, 2.7, 0.05)
    for frame in range(40 + rest):
        hand.drag(2.0 if frame < 40 else 0.0, 0.0)
        before = np.array(one(hand.hands(CAMERA, dt)).position)
    hand.release()
    swing = [hand.hands(CAMERA, dt) for _ in range(4)]
    assert [len(hands) for hands in swing] == [1, 1, 0, 0]  # 30 ms
    thrown = np.linalg.norm(one(swing[1]).position - before) / (2 * dt)
    assert_allclose(thrown, speed * (1.0 if rest == 0 else 0.5), rtol=0.15 if rest else 1e-6)


def test_a_still_hand_puts_down_at_once():
    hand = MouseHand()
    hand.grab(CAMERA, *CENTRE, 2.7, 0.05)
    hand.drag(80.0, 0.0)
    for _ in range(30):
        hand.hands(CAMERA, 1 / 60)
    hand.release()
    assert hand.hands(CAMERA, 1 / 60) == []


def test_a_new_grip_at_once_after_the_last_leaves_a_frame_without_a_hand():
    """Else the solver would take it for the same grip, or for a hand that flew over."""
    hand = MouseHand()
    hand.grab(CAMERA, *CENTRE, 2.7, 0.05)
    hand.hands(CAMERA, 1 / 60)
    hand.release()
    hand.grab(CAMERA, 10.0, 10.0, 2.0, 0.05)
    assert hand.hands(CAMERA, 1 / 60) == []
    assert_allclose(one(hand.hands(CAMERA, 1 / 60)).position, CAMERA.position + 2.0 * CAMERA.ray(10.0, 10.0)[1])


# mouse and keys


def test_left_press_on_a_body_grabs_it_and_beside_it_turns(controls):
    world = Target()
    controls.press("left", *CENTRE, CAMERA, world)
    (hand,) = controls.advance(CAMERA, 0.01)
    assert controls.drag == "grab" and hand.grip
    assert_allclose(hand.position, (0, 0, RADIUS), atol=1e-9)
    assert hand.reach == 0.25 * 2 * RADIUS
    controls.release("right")  # another button changes nothing
    assert controls.drag == "grab"
    controls.release("left")
    assert controls.drag is None and controls.advance(CAMERA, 0.01) == []
    controls.press("left", 10.0, 10.0, CAMERA, world)
    assert controls.drag == "turn"
    controls.move(10.0, 0.0, CAMERA)
    assert controls.orbit.eye[0] < 0  # the scene follows the cursor to the right


@pytest.mark.parametrize("world", [None, pytest.param("paused", id="paused")])
def test_nothing_is_grabbed_before_the_world_is_there_or_while_it_is_paused(controls, world):
    if world:
        world = Target()
        world.paused = True
    controls.press("left", *CENTRE, CAMERA, world)
    assert controls.drag == "turn"


def test_wheel_and_shift_push_a_held_body_and_zoom_otherwise(controls):
    controls.wheel(1)
    assert_allclose(controls.orbit.distance, 2.7)
    controls.orbit.reset()
    controls.press("left", *CENTRE, CAMERA, Target())
    controls.wheel(2)
    controls.key("shift", True, None)
    controls.move(0.0, -18.0, CAMERA)  # a tenth of the height, upwards: away
    for _ in range(90):
        (hand,) = controls.advance(CAMERA, 1 / 60)
    assert_allclose(3.0 - hand.position[2], 2.7 * np.exp(2 * 0.06 + 0.2), rtol=1e-6)
    assert_allclose(controls.orbit.distance, 3.0)


def test_a_hand_waits_while_the_world_does_not_run(controls):
    controls.press("left", *CENTRE, CAMERA, Target())
    controls.move(50.0, 0.0, CAMERA)
    (hand,) = controls.advance(CAMERA, 0.05, running=False)
    assert_allclose(hand.position, (0, 0, RADIUS), atol=1e-9)


@pytest.mark.parametrize("button", ["right", "middle"])
def test_shift_drag_pans_so_that_the_target_plane_follows_the_cursor(controls, button):
    controls.key("shift", True, None)
    controls.press(button, *CENTRE, CAMERA, None)
    controls.move(30.0, 12.0, CAMERA)
    moved = controls.orbit.camera(WIDTH, HEIGHT)
    assert_allclose(project(moved, np.zeros(3)), (CENTRE[0] + 30, CENTRE[1] + 12))


def test_right_drag_looks_and_middle_drag_turns(controls):
    controls.press("right", *CENTRE, CAMERA, Target())
    controls.move(20.0, 0.0, CAMERA)
    assert_allclose(controls.orbit.eye, (0, 0, 3))
    assert controls.orbit.target[0] > 0
    controls.release("right")
    controls.orbit.reset()
    controls.press("middle", *CENTRE, CAMERA, Target())
    controls.move(20.0, 0.0, CAMERA)
    assert_allclose(controls.orbit.target, 0)
    assert controls.orbit.eye[0] < 0


def test_walking_goes_on_while_a_key_is_held(controls):
    controls.key("w", True, None)
    controls.advance(CAMERA, 0.5)
    assert_allclose(controls.orbit.eye, (0, 0, 3 - 0.5 * 0.8 * 3), atol=1e-12)
    controls.key("w", False, None)
    controls.advance(CAMERA, 0.5)
    assert_allclose(controls.orbit.eye[2], 1.8)
    controls.key("d", True, None)
    controls.let_go()  # the window lost the keyboard
    controls.advance(CAMERA, 0.5)
    assert_allclose(controls.orbit.eye[0], 0.0)


def test_keys_become_commands(controls):
    world = Target()
    assert controls.key("space", True, world) == [Pause(True)]
    world.paused = True
    assert controls.key("space", True, world) == [Pause(False)]
    assert controls.key("n", True, world) == [Pause(True), SingleStep()]
    assert controls.key("t", True, world) == [SetInteraction("transform")]
    world.interaction = "transform"
    assert controls.key("t", True, world) == [SetInteraction("physics")]
    assert controls.key("p", True, world) == [PlayDemo(True)]
    assert controls.key("r", True, world) == [Reset()]
    assert controls.key("r", False, world) == []
    controls.orbit.turn(1.0, 0.3)
    assert controls.key("home", True, world) == [] and np.allclose(controls.orbit.eye, (0, 0, 3))
    controls.key("f1", True, world)
    assert not controls.panel and not controls.quit
    controls.key("escape", True, world)
    assert controls.quit


def test_reset_lets_go_of_what_is_held(controls):
    controls.press("left", *CENTRE, CAMERA, Target())
    controls.key("r", True, Target())
    assert controls.drag is None and controls.advance(CAMERA, 0.01) == []


def test_the_help_names_every_walking_key():
    text = " ".join(keys for keys, _ in HELP).lower().split()
    assert set(WALKING) <= {word.strip(",") for word in text}


# editing


@pytest.mark.parametrize(
    ("key", "command"),
    [
        ("c", [Duplicate(0)]),
        ("delete", [Remove(0)]),
        ("plus", [Rescale(0, LARGER)]),
        ("minus", [Rescale(0, 1 / LARGER)]),
    ],
)
def test_editing_keys_mean_what_is_under_the_cursor_else_what_was_held_last(controls, key, command):
    world = Target()
    assert controls.key(key, True, world, (*CENTRE, CAMERA)) == command
    last = [replace(command[0], body=None)]
    assert controls.key(key, True, world, (5.0, 5.0, CAMERA)) == last  # the sky
    assert controls.key(key, True, world) == last
    assert controls.key(key, False, world, (*CENTRE, CAMERA)) == []
    assert controls.key(key, True, None, (*CENTRE, CAMERA)) == []
    controls.press("left", *CENTRE, CAMERA, world)
    assert controls.key(key, True, world, (*CENTRE, CAMERA)) == last  # the one that is held


def test_turning_keys_turn_both_ways_about_the_vertical(controls):
    one, other = (controls.key(k, True, Target())[0].rotation for k in ("comma", "period"))
    assert_allclose(np.linalg.norm(one), 1.0)
    assert_allclose(one, np.multiply(other, [1, 1, -1, 1]))
    assert one[1] == one[3] == 0.0 and 2 * np.arcsin(one[2]) == pytest.approx(np.pi / 12)
    controls.key("shift", True, Target())
    over = controls.key("comma", True, Target(), (5.0, 5.0, CAMERA))[0].rotation
    assert_allclose(over[1:], np.sin(np.pi / 24) * CAMERA.world_to_camera[0, :3])


def test_undo_and_redo_let_go_of_what_is_dragged(controls):
    world = Target()
    controls.press("left", *CENTRE, CAMERA, world)
    assert controls.drag == "grab"
    assert controls.key("ctrl+z", True, world) == [Undo()]
    assert controls.drag is None and not controls.hand.gripping
    assert controls.key("ctrl+y", True, world) == [Redo()]
    assert controls.key("u", True, world) == [Undo()]
    controls.key("shift", True, world)
    assert controls.key("u", True, world) == [Redo()]
    assert controls.key("ctrl+z", True, world) == [Redo()]


def test_the_light_follows_the_cursor_while_its_key_is_down(controls):
    world = Target()
    world.light = Light((0.5, 1.0, 1.0), target=(0.0, 0.0, 0.0), strength=0.4)
    assert controls.lighting(world, 40.0, 30.0, CAMERA) == []
    controls.key("l", True, world)
    light = controls.lighting(world, 40.0, 30.0, CAMERA)[0].light
    assert_allclose(project(CAMERA, np.array(light.position)), (40.0, 30.0))
    assert light.position[2] == pytest.approx(1.0)  # as far from the camera as it was
    assert (light.strength, light.target) == (0.4, (0.0, 0.0, 0.0))
    assert controls.lighting(world, 40.0, 30.0, CAMERA) == []  # nothing new
    assert len(controls.lighting(world, 50.0, 30.0, CAMERA)) == 1
    controls.key("l", False, world)
    assert controls.lighting(world, 60.0, 30.0, CAMERA) == []
    world.light = replace(world.light, position=(0.0, 0.0, 7.0))  # behind the camera
    controls.key("l", True, world)
    light = controls.lighting(world, 60.0, 30.0, CAMERA)[0].light
    assert_allclose(project(CAMERA, np.array(light.position)), (60.0, 30.0))
    assert light.position[2] == pytest.approx(0.0)  # in the plane of what one looks at
