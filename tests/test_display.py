"""Camera, mouse, keys, timings and files of a display, without a window."""

import io
import json
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from fake_world import RADIUS, FakeWorld, fake_scene
from numpy.testing import assert_allclose

from assets.camera import look_at, perspective
from assets.errors import BadInput
from display.controls import HELP, WALKING, Controls
from display.frame import Frame
from display.headless import Progress
from display.mouse_hand import FASTEST, MouseHand
from display.orbit import STEEPEST, Orbit
from display.picture import fit, pixels_of, save_png, side_by_side
from display.stats import peak_memory_mb, run_stats, write_stats
from display.timing import Timings
from display.window import project
from scenes.scene import Hand

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
    paused, interaction = False, "physics"

    def __init__(self):
        self.ball, self.velocity, self._held = np.zeros(3), np.zeros(3), None


@pytest.fixture
def controls() -> Controls:
    return Controls(Orbit((0, 0, 3), (0, 0, 0), 0.9), MouseHand())


# camera


def test_orbit_turns_around_the_target_and_stays_upright():
    orbit = Orbit((0, 0, 3), (0, 0.5, 0), 0.9)
    before = orbit.distance
    orbit.turn(np.pi / 2, 0.0)
    assert orbit.eye[0] > 2.9 and abs(orbit.eye[2]) < 1e-9  # to the right of the target
    orbit.turn(0.0, 9.0)
    assert_allclose(np.arcsin((orbit.eye[1] - 0.5) / orbit.distance), STEEPEST)
    assert_allclose(orbit.distance, before)
    right = orbit.camera(WIDTH, HEIGHT).world_to_camera[0, :3]
    assert_allclose(right[1], 0.0, atol=1e-12)  # level horizon


def test_look_keeps_the_eye_and_turns_left_for_positive_yaw():
    orbit = Orbit((0, 0, 3), (0, 0, 0), 0.9)
    orbit.look(0.3, 0.1)
    assert_allclose(orbit.eye, (0, 0, 3))
    assert orbit.target[0] < -0.5 and orbit.target[1] > 0.2


def test_move_follows_the_camera_axes_and_reset_returns():
    orbit = Orbit((3, 0, 0), (0, 0, 0), 0.9)  # looks along -x: right is -z
    orbit.move(1.0, 2.0, 0.5)
    assert_allclose(orbit.eye, (2.5, 2.0, -1.0), atol=1e-12)
    assert_allclose(orbit.target, (-0.5, 2.0, -1.0), atol=1e-12)
    orbit.reset()
    assert_allclose(orbit.eye, (3, 0, 0))


def test_zoom_never_reaches_the_target():
    orbit = Orbit((0, 0, 3), (0, 0, 0), 0.9)
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
    assert controls.key("space", True, world) == {"pause": True}
    world.paused = True
    assert controls.key("space", True, world) == {"pause": False}
    assert controls.key("n", True, world) == {"pause": True, "step": True}
    assert controls.key("t", True, world) == {"interaction": "transform"}
    world.interaction = "transform"
    assert controls.key("t", True, world) == {"interaction": "physics"}
    assert controls.key("r", True, world) == {"reset": True}
    assert controls.key("r", False, world) == {}
    controls.orbit.turn(1.0, 0.3)
    assert controls.key("home", True, world) == {} and np.allclose(controls.orbit.eye, (0, 0, 3))
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


# pictures


@pytest.mark.parametrize(
    "picture, frame, expected",
    [
        ((960, 540), (960, 540), (0, 0, 960, 540)),
        ((960, 540), (1920, 1080), (0, 0, 1920, 1080)),
        ((100, 100), (300, 200), (50, 0, 200, 200)),
        ((960, 540), (960, 800), (0, 130, 960, 540)),
    ],
)
def test_fit_keeps_the_aspect_and_centres(picture, frame, expected):
    assert fit(picture, frame) == expected


def test_pixels_are_rgba_with_the_top_row_first(ti_cpu):
    picture = ti_cpu.ndarray(ti_cpu.u32, (2, 3))
    values = np.arange(6, dtype=np.uint32).reshape(2, 3) + np.uint32(0x40302010)
    picture.from_numpy(values)
    pixels = pixels_of(picture)
    assert pixels.shape == (2, 3, 4)
    assert pixels[0, 0].tolist() == [0x10, 0x20, 0x30, 0x40]
    assert pixels[1, 2].tolist() == [0x15, 0x20, 0x30, 0x40]


def test_png_holds_the_same_colours_and_no_transparency(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 255, (7, 5, 4), np.uint8)
    save_png(tmp_path / "p.png", pixels)
    read = cv2.imread(str(tmp_path / "p.png"), cv2.IMREAD_UNCHANGED)
    assert (read == pixels[..., 2::-1]).all() and read.shape[2] == 3
    assert [path.name for path in tmp_path.iterdir()] == ["p.png"]
    with pytest.raises(BadInput, match=r"nowhere.p\.png: cannot write the picture"):
        save_png(tmp_path / "nowhere" / "p.png", pixels)


def test_two_views_lie_side_by_side():
    pixels = np.arange(4 * 3 * 4, dtype=np.uint8).reshape(4, 3, 4)
    both = side_by_side(pixels, 2)
    assert both.shape == (2, 6, 4)
    assert (both[:, :3] == pixels[:2]).all() and (both[:, 3:] == pixels[2:]).all()


def test_the_ball_is_drawn_where_the_ray_finds_it(ti_cpu):
    """The fake world itself: its picture and its `pick` agree, so tests with it mean something."""
    world = FakeWorld(fake_scene(), width=WIDTH, height=HEIGHT)
    world.step(Frame(0.016, 0.016, [CAMERA]))
    pixels = pixels_of(world.picture).astype(int)
    red = pixels[..., 0] > 2 * pixels[..., 1]
    for v, u in [(90, 160), (90, 165 + 30), (20, 20), (90, 10), (120, 150)]:
        assert red[v, u] == (world.pick(*CAMERA.ray(u + 0.5, v + 0.5)) is not None), (u, v)


# numbers


def test_timings_tell_the_first_run_apart():
    timings = Timings()
    for seconds in (5.0, 0.002, 0.001, 0.003):
        timings.add("render", seconds)
    timings.add("once", 0.5)
    assert timings.as_dict()["render"] == pytest.approx({"median_ms": 2.0, "worst_ms": 3.0, "first_ms": 5000.0})
    assert timings.as_dict()["once"] == pytest.approx({"median_ms": 500.0, "worst_ms": 500.0, "first_ms": 500.0})
    assert [row[0] for row in timings.recent()] == ["render", "once"]


def test_recent_timings_forget_what_is_long_ago():
    timings = Timings()
    for seconds in [0.1] * 50 + [0.001] * 200:
        timings.add("render", seconds)
    assert timings.recent()[0][2] == pytest.approx(1.0)
    assert timings.as_dict()["render"]["worst_ms"] == pytest.approx(100.0)


def test_the_recent_frame_rate_is_that_of_the_last_second():
    timings = Timings()
    assert timings.recent_fps() == 0
    timings._frames.extend([0.5] * 20 + [0.01] * 100)
    assert timings.recent_fps() == pytest.approx(100)
    timings._frames.append(2.0)
    assert timings.recent_fps() == pytest.approx(0.5)


def test_a_stage_is_timed_and_frames_are_counted():
    timings = Timings(budget=0.01)
    for pause in (0.0, 0.02, 0.02):
        with timings.stage("nap"):
            time.sleep(pause)
        timings.frame()
    assert timings.as_dict()["nap"]["median_ms"] >= 20
    assert 5 < timings.fps < 50 and timings.missed == 2
    timings.rest()
    time.sleep(0.05)
    timings.frame()
    assert timings.missed == 2  # the pause is not a missed frame


def test_exact_timings_wait_for_the_device(ti_cpu, monkeypatch):
    calls = []
    monkeypatch.setattr(ti_cpu, "sync", lambda: calls.append(1))
    timings = Timings()
    with timings.stage("a"):
        pass
    timings.exact = True
    with timings.stage("a"):
        pass
    assert len(calls) == 1


def test_stats_are_written_whole_and_as_strict_json(tmp_path, ti_cpu):
    world = FakeWorld(fake_scene(), width=32, height=16)
    camera = perspective(32, 16, 0.9, look_at((0, 0, 3), (0, 0, 0)))
    for index in range(3):
        world.step(Frame(1 / 60, index / 60, [camera]))
        world.timings.frame()
    path = tmp_path / "stats.json"
    write_stats(path, run_stats(world, 3) | {"odd": np.float32("nan"), "many": np.arange(2), "flag": np.bool_(True)})
    stats = json.loads(path.read_text())
    promised = "frames fps stages gaussians vertices tets substeps dt score finite missed_frames peak_memory_mb"
    assert set(promised.split()) <= set(stats)
    assert stats["frames"] == 3 and stats["finite"] is True and stats["fps"] > 0
    assert {"median_ms", "worst_ms"} <= set(stats["stages"]["render"])
    assert stats["odd"] is None and stats["many"] == [0, 1] and stats["flag"] is True
    assert [p.name for p in tmp_path.iterdir()] == ["stats.json"]


def test_stats_that_cannot_be_written_are_bad_input(tmp_path):
    with pytest.raises(BadInput, match="cannot write the statistics"):
        write_stats(tmp_path / "nowhere" / "stats.json", {})


def test_peak_memory_grows_with_what_is_held():
    before = peak_memory_mb()
    assert 20 < before < 100_000
    block = np.ones(int(1.2 * before * 1e6 / 8))  # alone more than all before
    assert peak_memory_mb() > before and block[-1] == 1


@pytest.mark.parametrize("tty", [True, False])
def test_progress_is_shown_on_long_runs_only(tty):
    for total, expected in ((1000, 10), (20, 0)):
        out = io.StringIO()
        out.isatty = lambda: tty
        progress = Progress(total, out)
        progress._begin -= 1.0  # as if a second had passed
        for k in range(total):
            progress.show(k + 1)
        progress.end()
        text = out.getvalue()
        assert ("1000 of 1000" in text) == (total == 1000)
        if tty:
            assert text.count("\r") >= bool(expected) and (not text or text.endswith("\n"))
        else:
            assert len(text.splitlines()) == expected


def test_displays_import_nothing_heavy_until_they_open():
    """`python vrgs.py --headless` must run where there is no OpenGL."""
    heavy = ["glfw", "moderngl", "imgui_bundle", "cv2", "taichi"]
    code = f"import sys, display.window, display.headless; print([m for m in {heavy} if m in sys.modules])"
    root = Path(__file__).resolve().parents[1]
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root)
    assert out.stdout.strip() == "[]"
