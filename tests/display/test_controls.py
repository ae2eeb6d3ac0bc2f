"""Camera, hand, mouse and keys of the window's display, without a window."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from core.camera import look_at, perspective, project
from core.vocabulary import Hand, Light
from display import user_commands
from display.user_commands import SCALE_STEP, TURN_STEP
from display.window.controls import Controls
from display.window.mouse import MAX_PITCH, MAX_SPEED, MouseHand, OrbitCamera
from tests.support.fake_world import RADIUS, BallWorld, fake_scene

WIDTH, HEIGHT = 320, 180
CAMERA = perspective(WIDTH, HEIGHT, 0.9, look_at((0, 0, 3), (0, 0, 0)))
CENTRE = (WIDTH / 2, HEIGHT / 2)
SKY = (5.0, 5.0)


def one(hands: list) -> Hand:
    """The only hand of a frame."""
    (hand,) = hands
    assert hand.grip
    return hand


@pytest.fixture
def world() -> BallWorld:
    """A ball of 0.3 m at the origin."""
    return BallWorld(fake_scene())


@pytest.fixture
def controls() -> Controls:
    controls = Controls(fake_scene())
    controls.update_camera((WIDTH, HEIGHT))
    return controls


def press(controls, button, world, at=CENTRE):
    controls.cursor = at
    controls.press(button, world)


def move(controls, du, dv):
    controls.move(controls.cursor[0] + du, controls.cursor[1] + dv)


# camera


def test_orbit_turns_around_the_target_and_stays_upright():
    orbit = OrbitCamera((0, 0, 3), (0, 0.5, 0), 0.9)
    before = orbit.distance
    orbit.turn(np.pi / 2, 0.0)
    assert orbit.eye[0] > 2.9 and abs(orbit.eye[2]) < 1e-9  # to the right of the target
    orbit.turn(0.0, 9.0)
    assert_allclose(np.arcsin((orbit.eye[1] - 0.5) / orbit.distance), MAX_PITCH)
    assert_allclose(orbit.distance, before)
    right = orbit.camera(WIDTH, HEIGHT).world_to_camera[0, :3]
    assert_allclose(right[1], 0.0, atol=1e-12)  # level horizon


def test_an_orbit_stops_at_the_ground_unless_the_eye_is_below_it_already():
    orbit = OrbitCamera((0, 1, 3), (0, 0.5, 0), 0.9)
    before = orbit.distance
    orbit.turn(0.3, -2.0, lowest=0.2)
    assert_allclose([orbit.eye[1], orbit.distance], [0.2, before])
    orbit.turn(0.3, 0.1, lowest=0.2)
    assert orbit.eye[1] > 0.3  # up again at once
    orbit.eye = np.array([0.0, -1.0, 2.0])
    orbit.turn(0.3, -0.2, lowest=0.2)
    assert_allclose(orbit.eye[1], -1.0)
    orbit.turn(0.0, 0.2, lowest=0.2)
    assert orbit.eye[1] > -0.9


def test_a_drag_goes_no_lower_than_the_table(controls, world):
    world.ground = lambda point: -0.4
    press(controls, "left", world, SKY)
    move(controls, 0.0, -170.0)
    assert controls.orbit.eye[1] == pytest.approx(-0.35)


def test_move_follows_the_camera_axes_and_reset_returns():
    orbit = OrbitCamera((3, 0, 0), (0, 0, 0), 0.9)  # looks along -x: right is -z
    orbit.move(1.0, 2.0, 0.5)
    assert_allclose(orbit.eye, (2.5, 2.0, -1.0), atol=1e-12)
    assert_allclose(orbit.target, (-0.5, 2.0, -1.0), atol=1e-12)
    orbit.reset()
    assert_allclose(orbit.eye, (3, 0, 0))


def test_zoom_never_reaches_the_target():
    orbit = OrbitCamera((0, 0, 3), (0, 0, 0), 0.9)
    orbit.zoom(1000)
    assert 0.04 < orbit.distance < 0.06 and np.isfinite(orbit.eye).all()


@pytest.mark.parametrize("pace", [1.0, 0.1])
def test_a_throw_in_slow_motion_is_as_fast_as_the_cursor(pace):
    hand, dt = MouseHand(), 1 / 60
    hand.grab(CAMERA, *CENTRE, 3.0, 0.05)
    for _ in range(30):
        hand.drag(2.0, 0.0)
        hand.hands(CAMERA, dt, pace)
    hand.release()
    (a,), (b,) = (hand.hands(CAMERA, dt, pace) for _ in range(2))
    speed = 2.0 / CAMERA.fx * 3.0 / dt
    assert_allclose((np.array(b.position) - a.position) / (dt * pace), (speed, 0.0, 0.0), rtol=1e-6)


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
    assert_allclose(np.linalg.norm(after - before) / dt, MAX_SPEED)


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


def key(controls, name, world, at=SKY, down=True):
    controls.cursor = at
    return controls.key(name, down, world)


def test_left_press_on_a_body_grabs_it_and_beside_it_turns(controls, world):
    press(controls, "left", world)
    (hand,) = controls.hands(0.01, [], world)
    assert controls.drag == "grab" and hand.grip
    assert_allclose(hand.position, (0, 0, RADIUS), atol=1e-9)
    assert hand.reach == 0.25 * 2 * RADIUS
    controls.release("right")  # another button changes nothing
    assert controls.drag == "grab"
    controls.release("left")
    assert controls.drag is None and controls.hands(0.01, [], world) == []
    press(controls, "left", world, SKY)
    assert controls.drag == "turn"
    move(controls, 10.0, 0.0)
    assert controls.orbit.eye[0] < 0  # the scene follows the cursor to the right


def test_a_press_beside_a_body_takes_what_the_cursor_shows(controls, world):
    """The ball's edge is 18.7 px from its centre; 14 of 540 px are 4.7 of 180."""
    for beside, taken in ((3.0, True), (8.0, False)):
        press(controls, "left", world, (CENTRE[0] + 18.7 + beside, CENTRE[1]))
        assert controls.drag == ("grab" if taken else "turn")
        if taken:
            assert abs(np.linalg.norm(controls.hand.position) - RADIUS) < 1e-6  # on the ball
        controls.release("left")
        controls._hovered = (None, None, 0.0)
        assert (controls.hovered(world, over=True, moving=True) is not None) == taken


def test_wheel_and_shift_push_a_held_body_and_zoom_otherwise(controls, world):
    controls.wheel(1)
    assert_allclose(controls.orbit.distance, 2.7)
    controls.orbit.reset()
    press(controls, "left", world)
    controls.wheel(2)
    key(controls, "shift", world)
    move(controls, 0.0, -18.0)  # a tenth of the height, upwards: away
    for _ in range(90):
        (hand,) = controls.hands(1 / 60, [], world)
    assert_allclose(3.0 - hand.position[2], 2.7 * np.exp(2 * 0.06 + 0.2), rtol=1e-6)
    assert_allclose(controls.orbit.distance, 3.0)


def test_while_the_world_is_paused_a_hand_waits_and_grabs_nothing(controls, world):
    press(controls, "left", world)
    move(controls, 50.0, 0.0)
    world.paused = True
    (hand,) = controls.hands(0.05, [], world)
    assert_allclose(hand.position, (0, 0, RADIUS), atol=1e-9)
    controls.release("left")
    press(controls, "left", world)
    assert controls.drag == "turn"


@pytest.mark.parametrize("button", ["right", "middle"])
def test_shift_drag_pans_so_that_the_target_plane_follows_the_cursor(controls, world, button):
    key(controls, "shift", world)
    press(controls, button, world)
    move(controls, 30.0, 12.0)
    moved = controls.orbit.camera(WIDTH, HEIGHT)
    assert_allclose(project(moved, np.zeros(3)), (CENTRE[0] + 30, CENTRE[1] + 12))


def test_right_drag_looks_and_middle_drag_turns(controls, world):
    press(controls, "right", world)
    move(controls, 20.0, 0.0)
    assert_allclose(controls.orbit.eye, (0, 0, 3))
    assert controls.orbit.target[0] > 0
    controls.release("right")
    controls.orbit.reset()
    press(controls, "middle", world)
    move(controls, 20.0, 0.0)
    assert_allclose(controls.orbit.target, 0)
    assert controls.orbit.eye[0] < 0


def test_walking_goes_on_while_a_key_is_held(controls, world):
    key(controls, "w", world)
    controls.hands(0.5, [], world)
    assert_allclose(controls.orbit.eye, (0, 0, 3 - 0.5 * 0.8 * 3), atol=1e-12)
    key(controls, "w", world, down=False)
    controls.hands(0.5, [], world)
    assert_allclose(controls.orbit.eye[2], 1.8)
    key(controls, "d", world)
    controls.let_go()  # the window lost the keyboard
    controls.hands(0.5, [], world)
    assert_allclose(controls.orbit.eye[0], 0.0)


def test_keys_become_commands(controls, world):
    for name, commands in {
        "space": [user_commands.Pause(True)],
        "n": [user_commands.Pause(True), user_commands.SingleStep()],
        "t": [user_commands.SetInteraction("transform")],
        "p": [user_commands.PlayDemo(True)],
        "u": [user_commands.Undo()],
        "home": [],
        "f1": [],
    }.items():
        assert key(controls, name, world) == commands
        assert key(controls, name, world, down=False) == []
    assert not controls.panel and not controls.quit
    world.paused, world.interaction = True, "transform"
    assert key(controls, "space", world) == [user_commands.Pause(False)]
    assert key(controls, "t", world) == [user_commands.SetInteraction("physics")]
    controls.orbit.turn(1.0, 0.3)
    key(controls, "home", world)
    assert np.allclose(controls.orbit.eye, (0, 0, 3))
    key(controls, "escape", world)
    assert controls.quit


def test_escape_ends_what_has_begun_and_quits_only_if_nothing_has(controls, world):
    world.demo, controls.help, controls.gizmo = True, True, "turn"
    press(controls, "left", world)
    assert key(controls, "escape", world) == [] and controls.drag is None and not controls.hand.gripping
    assert controls.help
    assert key(controls, "escape", world) == [] and not controls.help and controls.gizmo
    assert key(controls, "escape", world) == [] and controls.gizmo is None
    assert key(controls, "escape", world) == [user_commands.PlayDemo(False)] and not controls.quit
    world.demo = False
    assert key(controls, "escape", world) == [] and controls.quit


def test_the_gizmo_is_that_of_the_body_under_the_cursor_else_of_the_selected_one(controls, world):
    told = []
    world.tell = told.append
    assert key(controls, "g", world) == [] and controls.gizmo is None and told  # the sky, and nothing selected
    assert key(controls, "g", world, CENTRE) == [user_commands.Select(0)] and controls.gizmo == "move"
    kinds = []
    for _ in range(3):
        assert key(controls, "g", world, CENTRE) == []
        kinds.append(controls.gizmo)
    assert kinds == ["turn", "scale", None]
    world.selected = 0
    assert key(controls, "g", world) == [user_commands.Select(0)]


@pytest.mark.parametrize(
    ("name", "command"), [("r", user_commands.Reset), ("ctrl+z", user_commands.Undo), ("ctrl+y", user_commands.Redo)]
)
def test_what_may_take_the_body_away_lets_go_of_it(controls, world, name, command):
    press(controls, "left", world)
    assert key(controls, name, world) == [command()]
    assert controls.drag is None and controls.hands(0.01, [], world) == []


# editing


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("c", user_commands.Duplicate),
        ("delete", user_commands.Remove),
        ("plus", lambda body: user_commands.Rescale(body, SCALE_STEP)),
        ("minus", lambda body: user_commands.Rescale(body, 1 / SCALE_STEP)),
    ],
)
def test_editing_keys_mean_what_is_under_the_cursor_else_what_was_held_last(controls, world, name, command):
    assert key(controls, name, world, CENTRE) == [command(0)]
    assert key(controls, name, world) == [command(None)]  # the sky
    assert key(controls, name, world, CENTRE, down=False) == []
    press(controls, "left", world)
    assert key(controls, name, world, CENTRE) == [command(None)]  # the one that is held
    world.editable = False  # a viewed file: it is turned and scaled as a whole
    assert len(key(controls, name, world, CENTRE)) == (name in ("plus", "minus"))


def test_turning_keys_turn_both_ways_about_the_vertical(controls, world):
    one, other = (key(controls, k, world)[0].rotation for k in ("comma", "period"))
    assert_allclose(np.linalg.norm(one), 1.0)
    assert_allclose(one, np.multiply(other, [1, 1, -1, 1]))
    assert one[1] == one[3] == 0.0 and 2 * np.arcsin(one[2]) == pytest.approx(TURN_STEP)
    key(controls, "shift", world)
    over = key(controls, "comma", world)[0].rotation
    assert_allclose(over[1:], np.sin(TURN_STEP / 2) * CAMERA.world_to_camera[0, :3])
    assert_allclose(key(controls, "period", world)[0].rotation, np.multiply(over, [1, -1, -1, -1]))


def test_the_light_follows_the_cursor_while_its_key_is_down(controls, world):
    def place(u, v):
        controls.cursor = (u, v)
        return [command.light for command in controls.place_light(world)]

    world.light = Light((0.5, 1.0, 1.0), target=(0.0, 0.0, 0.0), strength=0.4)
    assert place(40.0, 30.0) == []
    key(controls, "l", world)
    (light,) = place(40.0, 30.0)
    assert_allclose(project(CAMERA, np.array(light.position)), (40.0, 30.0))
    assert light.position[2] == pytest.approx(1.0)  # as far from the camera as it was
    assert (light.strength, light.target) == (0.4, (0.0, 0.0, 0.0))
    assert place(40.0, 30.0) == []  # nothing new
    assert len(place(50.0, 30.0)) == 1
    key(controls, "l", world, down=False)
    assert place(60.0, 30.0) == []
    world.light = replace(world.light, position=(0.0, 0.0, 7.0))  # behind the camera
    key(controls, "l", world)
    (light,) = place(60.0, 30.0)
    assert_allclose(project(CAMERA, np.array(light.position)), (60.0, 30.0))
    assert light.position[2] == pytest.approx(0.0)  # in the plane of what one looks at
    world.light = None
    assert place(70.0, 30.0) == []


def test_a_picture_higher_than_wide_shows_as_much_from_side_to_side_as_a_square_one():
    orbit = OrbitCamera((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), 0.9)
    square, upright, wide = orbit.camera(400, 400), orbit.camera(400, 800), orbit.camera(800, 400)
    assert_allclose([upright.fx, wide.fy], [square.fx, square.fy])
