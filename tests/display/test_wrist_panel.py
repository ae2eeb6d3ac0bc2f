"""The panel over the left hand: its pose, what is pressed by ray and by finger, its picture; without a runtime."""

from dataclasses import replace
from types import SimpleNamespace as N

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from core.vocabulary import Light
from display import user_commands
from display.xr import wrist_panel
from display.xr.actions import FINGER_LENGTH, Controller
from display.xr.hand_joints import HandJoints
from display.xr.poses import pose_matrix
from tests.support.fake_view import FakeView
from tests.support.fake_world import fake_scene
from tests.support.worn import point_on_panel


def at(x, y, z) -> np.ndarray:
    return pose_matrix((x, y, z), np.eye(3))


HEAD = at(0.0, 1.6, 0.0)
WORLD_FROM_PLAY = pose_matrix((5.0, 0.0, 2.0), [[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
LEFT = Controller(grip=at(-0.2, 1.1, -0.35), aim=at(-0.2, 1.1, -0.35))
AWAY = at(0.4, 1.3, -0.5)
LIGHT = Light((0.0, 2.0, 0.0))


@pytest.fixture
def world():
    bodies = [N(name="ring_red"), N(name="ring_blue")]
    return FakeView(
        scene=fake_scene(),
        score=2,
        message="Score: see there.",
        light=LIGHT,
        editable=True,
        timings=N(recent_fps=lambda: 71.6),
        bodies=lambda: bodies,
    )


@pytest.fixture
def panel(world):
    """Pinned by its button."""
    panel = wrist_panel.WristPanel()
    advance(panel, world, Controller(), replace(LEFT, pressed={"lower"}))
    assert panel.pose is not None
    return panel


def pointing(panel, name: str, distance: float = 0.3, **inputs) -> Controller:
    """The right hand, which points at a button's middle from before the panel."""
    x, y, w, h = wrist_panel.BUTTONS[name]
    pose = pose_matrix(point_on_panel(panel.pose, x + w / 2, y + h / 2, distance), panel.pose[:3, :3])
    return Controller(grip=pose, aim=pose, **inputs)


def away(pinch: float) -> Controller:
    return Controller(grip=AWAY, aim=AWAY, pinch=pinch)


def advance(panel, world, right: Controller, left: Controller = LEFT):
    """Commands, and how far the right hand pinches for everything else."""
    right, commands = panel.advance([left, right], HEAD, WORLD_FROM_PLAY, world)
    return commands, right.pinch


def test_it_is_over_the_hand_and_looks_to_the_eyes():
    pose = wrist_panel.panel_pose(LEFT.grip, HEAD)
    assert_allclose(pose[:3, 3], LEFT.grip[:3, 3] + [0, wrist_panel.HEIGHT_OVER_HAND, 0])
    assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
    to_eyes = HEAD[:3, 3] - pose[:3, 3]
    assert_allclose(pose[:3, 2], to_eyes / np.linalg.norm(to_eyes))
    assert pose[1, 0] == pytest.approx(0.0) and pose[1, 1] > 0.5  # level, and not upside down
    below = wrist_panel.panel_pose(at(0.0, 1.0, 0.0), HEAD)
    assert np.isfinite(below).all() and np.linalg.det(below[:3, :3]) == pytest.approx(1.0)


def test_a_ray_meets_the_pixel_that_it_points_at_from_before_the_panel_and_not_from_afar():
    pose = wrist_panel.panel_pose(LEFT.grip, HEAD)
    rng = np.random.default_rng(0)
    for _ in range(50):
        u, v = rng.uniform(0, wrist_panel.PIXELS[0] - 1), rng.uniform(0, wrist_panel.PIXELS[1] - 1)
        target = point_on_panel(pose, u, v)
        assert_allclose(wrist_panel.project_to_panel(pose, target), (u, v, 0.0), atol=1e-9)
        start = target + pose[:3, :3] @ [*rng.uniform(-0.3, 0.3, 2), rng.uniform(0.1, 0.8)]
        z = (start - target) / np.linalg.norm(start - target)
        x = np.cross([0.3, 1.0, 0.2], z)
        x /= np.linalg.norm(x)
        aim = pose_matrix(start, np.column_stack([x, np.cross(z, x), z]))
        assert_allclose(wrist_panel.ray_hit(pose, aim), (u, v), atol=1e-6)
        aim[:3, [0, 2]] *= -1
        assert wrist_panel.ray_hit(pose, aim) is None  # it points away
    for offset in ([0, 0, -0.3], [0.5, 0, 0.3], [0, 0, 4.3]):  # behind, beside, far
        assert wrist_panel.ray_hit(pose, pose_matrix(pose[:3, 3] + pose[:3, :3] @ offset, pose[:3, :3])) is None
    assert wrist_panel.ray_hit(pose, pose_matrix(pose[:3, 3] + 0.3 * pose[:3, 2], pose[:3, :3])) is not None


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("Undo", user_commands.Undo()),
        ("Redo", user_commands.Redo()),
        ("Copy", user_commands.Duplicate()),
        ("Remove", user_commands.Remove()),
        ("Larger", user_commands.Rescale(None, 1.25)),
        ("Smaller", user_commands.Rescale(None, 0.8)),
        ("Physics", user_commands.SetInteraction("physics")),
        ("Transform", user_commands.SetInteraction("transform")),
        ("Pause", user_commands.Pause(True)),
        ("Reset", user_commands.Reset()),
        ("Watch", user_commands.PlayDemo(True)),
        ("Picture", user_commands.TakePicture()),
        ("Film", user_commands.Film(True)),
    ],
)
def test_the_trigger_presses_what_the_ray_is_on_once_and_grips_nothing(panel, world, name, command):
    assert advance(panel, world, pointing(panel, name)) == ([], 0.0)
    assert panel.hovered == name and not panel.clicked
    for pinch, wanted in ((0.9, [command]), (0.9, []), (0.5, []), (0.0, []), (0.9, [command])):
        assert advance(panel, world, pointing(panel, name, pinch=pinch)) == (wanted, 0.0)
        assert panel.clicked == bool(wanted)


def test_turning_is_about_the_vertical(panel, world):
    ((command,), _) = advance(panel, world, pointing(panel, "Turn", pinch=0.9))
    assert isinstance(command, user_commands.Rotate) and command.rotation[1] == command.rotation[3] == 0.0


def test_a_trigger_pulled_elsewhere_presses_nothing_here_and_holds_on(panel, world):
    assert advance(panel, world, away(1.0)) == ([], 1.0)
    assert advance(panel, world, pointing(panel, "Reset", pinch=1.0)) == ([], 1.0)
    assert panel.hovered is None


def test_a_finger_presses_by_going_through_from_the_front(panel, world):
    def pressed(*distances):
        """True if the finger of a controller, which points with the hand, presses at these distances."""
        fingers = [pointing(panel, "Copy", d + FINGER_LENGTH) for d in distances]
        return [advance(panel, world, finger)[0] == [user_commands.Duplicate()] for finger in fingers]

    assert pressed(0.1, 0.02, 0.005, -0.002, -0.02, 0.005, -0.01) == [False] * 3 + [True] + [False] * 3
    assert pressed(0.02, -0.002) == [False, True]  # again, from clear of the panel
    assert not any(pressed(-0.1, -0.03, -0.005, 0.005, 0.03))  # from behind
    assert pressed(0.2, -0.04) == [False, True]  # fast


def test_a_tracked_finger_presses(panel, world):
    def hand(distance):
        c = pointing(panel, "Redo", distance)
        joints = HandJoints(np.tile(c.grip[:3, 3], (26, 1)), np.tile(np.eye(3), (26, 1, 1)), np.zeros(26))
        return replace(c, aim=None, joints=joints)

    assert [advance(panel, world, hand(d))[0] for d in (0.03, -0.001)] == [[], [user_commands.Redo()]]


def test_the_light_follows_the_hand_until_the_trigger_is_released(panel, world):
    assert advance(panel, world, pointing(panel, "Light", pinch=1.0))[1] == 0.0 and panel.placing
    (command,), pinch = advance(panel, world, away(1.0))
    assert command == user_commands.SetLight(replace(LIGHT, position=command.light.position)) and pinch == 0.0
    assert_allclose(command.light.position, (WORLD_FROM_PLAY @ AWAY)[:3, 3])
    assert advance(panel, world, away(0.0))[0] == [] and not panel.placing


def test_a_light_taken_with_a_finger_waits_for_the_trigger(panel, world):
    for distance in (0.03, -0.001):
        advance(panel, world, pointing(panel, "Light", distance + FINGER_LENGTH))
    assert panel.placing
    for pinch, follows in ((0.0, True), (0.0, True), (1.0, True), (1.0, True), (0.0, False), (0.0, False)):
        assert bool(advance(panel, world, away(pinch))[0]) == follows


def test_without_a_light_there_is_none_to_place(panel, world):
    dark = FakeView(scene=fake_scene(), editable=True)
    assert advance(panel, dark, pointing(panel, "Light", pinch=1.0)) == ([], 0.0) and not panel.placing
    assert advance(panel, dark, away(1.0))[0] == []


def test_pointing_at_a_body_selects_it(panel, world):
    asked = []
    world.pick = lambda origin, direction: asked.append((origin, direction)) or (0.8, 1)
    assert advance(panel, world, away(1.0)) == ([user_commands.Select(1)], 1.0)
    assert_allclose(asked[0][0], (WORLD_FROM_PLAY @ AWAY)[:3, 3])
    assert_allclose(asked[0][1], WORLD_FROM_PLAY[:3, :3] @ [0, 0, -1])
    assert advance(panel, world, away(1.0))[0] == []


def test_it_comes_when_the_palm_turns_to_the_face_and_goes(world):
    panel = wrist_panel.WristPanel()

    def seen(degrees, **inputs):
        """True if the panel is shown once the left palm, +x of its grip, is that far from the direction to the eyes."""
        x = HEAD[:3, 3] - LEFT.grip[:3, 3]
        x /= np.linalg.norm(x)
        y = np.cross([0.0, 0.0, 1.0], x)
        y /= np.linalg.norm(y)
        z = np.cross(x, y)
        palm = np.cos(np.radians(degrees)) * x + np.sin(np.radians(degrees)) * y
        grip = pose_matrix(LEFT.grip[:3, 3], np.column_stack([palm, np.cross(z, palm), z]))
        advance(panel, world, Controller(), Controller(grip=grip, aim=grip, **inputs))
        return panel.pose is not None

    angles = (90, 60, 40, 20, 40, 50, 60, 20)
    assert [seen(a) for a in angles] == [False, False, False, True, True, True, False, True]
    assert not seen(0, grab=1.0)  # a hand that holds something turns as it must


def test_the_button_keeps_it_and_takes_it_away(panel, world):
    for left, there in ((LEFT, True), (Controller(), True), (replace(LEFT, pressed={"lower"}), False)):
        advance(panel, world, Controller(), left)  # while the hand is not tracked it stays
        assert (panel.pose is not None) == there


def test_what_it_shows(panel, world):
    content = wrist_panel.PanelContent.of(world, panel)
    assert content.message == "2   Score: see there." and content.rate == "72 fps" and content.lit == {"Physics"}
    assert "Hold" in content.note and not content.warns
    world.selected, world.paused, world.interaction = 1, True, "transform"
    content = wrist_panel.PanelContent.of(world, panel)
    assert content.note == "ring blue" and content.lit == {"Transform", "Pause"}
    world.notice = "There is no room."
    content = wrist_panel.PanelContent.of(world, panel)
    assert content.note == "There is no room." and content.warns


def test_its_picture_is_readable_and_says_what_is_on():
    content = wrist_panel.PanelContent("0 of 3 rings.", "ring_red", False, "90 fps", frozenset({"Physics"}), None)
    plain = wrist_panel.paint(content)
    assert plain.shape == (*wrist_panel.PIXELS[::-1], 4) and plain.dtype == np.uint8
    assert (plain[..., :3] <= plain[..., 3:]).all()  # colours times alpha
    for name, (x, y, w, h) in wrist_panel.BUTTONS.items():
        inside = plain[y : y + h, x : x + w, :3].astype(int)
        assert np.ptp(inside[h // 4 : -h // 4].mean(2)) > 100, f"{name} has no letters"
        assert (inside[8, w // 2] > [200, 120, 0]).all() == (name == "Physics")
    x, y, w, h = wrist_panel.BUTTONS["Undo"]
    changed = (plain != wrist_panel.paint(replace(content, hovered="Undo"))).any(2)
    assert changed[y : y + h, x : x + w].mean() > 0.9 and not changed[:y].any()


def test_scenes_are_listed_on_pages_of_their_own():
    """Each is a button that opens it; "Back" leads to the first page."""
    page, seen = wrist_panel.page_after(0, "Scenes"), []
    while page:
        names = list(wrist_panel.pages()[page])
        assert names[-1] == "Back" and wrist_panel.page_after(page, "Back") == 0
        for x, y, w, h in wrist_panel.pages()[page].values():
            assert x + w <= wrist_panel.PIXELS[0] and y + h <= wrist_panel.PIXELS[1]
        requests = [wrist_panel.scene_requests()[name] for name in names if name not in ("More", "Back")]
        seen += [(r.name, *r.options.values()) for r in requests]
        page = wrist_panel.page_after(page, "More") if "More" in names else 0
    assert {("ring_toss",), ("manipulation", "bear"), ("manipulation", "fox")} <= set(seen)
    assert (
        wrist_panel.paint(wrist_panel.PanelContent(page=1)).shape == wrist_panel.paint(wrist_panel.PanelContent()).shape
    )


def test_a_ray_reaches_as_far_as_it_is_long_from_before_the_panel_at_any_slant():
    rng = np.random.default_rng(0)
    panel = pose_matrix(rng.normal(size=3), Rotation.random(rng=rng).as_matrix())
    for slant in np.radians([0, 40, 80]):
        for length, hits in ((0.95 * wrist_panel.MAX_RAY, True), (1.05 * wrist_panel.MAX_RAY, False), (-0.1, False)):
            turn = panel[:3, :3] @ Rotation.from_rotvec([0.3 * slant, slant, 0.0]).as_matrix()
            u, v = rng.uniform(0.2, 0.8, 2) * wrist_panel.PIXELS
            start = point_on_panel(panel, u, v, 0.0) + length * turn[:, 2]
            found = wrist_panel.ray_hit(panel, pose_matrix(start, turn))
            assert found == (pytest.approx((u, v), abs=0.01) if hits else None)
