"""The panel over the left hand: where it is, what is pressed by ray and by finger, how it looks; without a runtime."""

from dataclasses import replace
from types import SimpleNamespace as N

import numpy as np
import pytest
from numpy.testing import assert_allclose

from display.protocol import (
    Duplicate,
    Pause,
    PlayDemo,
    Redo,
    Remove,
    Rescale,
    Reset,
    Select,
    SetInteraction,
    SetLight,
    Undo,
    last_of,
)
from display.xr.actions import Controller
from display.xr.panel_paint import BACK, Content, content_of, paint
from display.xr.wrist_panel import (
    ABOVE,
    BUTTONS,
    FINGER,
    PIXELS,
    WIDTH,
    WristPanel,
    button_at,
    on_panel,
    pose_of,
    ray_hit,
)
from scenes.scene import Light

HEAD = np.eye(4)
HEAD[:3, 3] = 0.0, 1.6, 0.0
STAGE = np.array([[0.0, 0.0, 1.0, 5.0], [0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 2.0], [0.0, 0.0, 0.0, 1.0]])
BY_NAME = {b.name: b for b in BUTTONS}


def at(x, y, z) -> np.ndarray:
    m = np.eye(4)
    m[:3, 3] = x, y, z
    return m


LEFT = Controller(grip=at(-0.2, 1.1, -0.35), aim=at(-0.2, 1.1, -0.35))


class World:
    """What the panel asks of a world."""

    interaction, paused, demo, selected, notice = "physics", False, False, None, ""
    score, message, light, editable = 2, "Score: see there.", Light((0.0, 2.0, 0.0)), True
    timings = N(recent_fps=lambda: 71.6)
    hit = None

    def bodies(self):
        return [N(name="ring_red"), N(name="ring_blue")]

    def pick(self, origin, direction):
        self.asked = (origin, direction)
        return self.hit


@pytest.fixture
def world():
    return World()


@pytest.fixture
def panel(world):
    """Pinned by its button."""
    panel = WristPanel()
    panel.advance([replace(LEFT, pressed={"lower"}), Controller()], HEAD, STAGE, world)
    assert panel.pose is not None
    return panel


def pointing(panel, name: str, distance: float = 0.3, **inputs) -> Controller:
    """The right hand, which points at a button's middle from before the panel."""
    x, y, w, h = BY_NAME[name].box
    scale = WIDTH / PIXELS[0]
    pose = panel.pose.copy()
    pose[:3, 3] += pose[:3, :3] @ [
        (x + w / 2 - PIXELS[0] / 2) * scale, (PIXELS[1] / 2 - y - h / 2) * scale, distance,
    ]  # fmt: skip
    return Controller(grip=pose.copy(), aim=pose, **inputs)


def advance(panel, world, right: Controller, left: Controller = LEFT):
    controllers = [left, right]
    return panel.advance(controllers, HEAD, STAGE, world), controllers[1]


def test_buttons_lie_apart_on_the_panel():
    cover = np.zeros(PIXELS[::-1], int)
    for b in BUTTONS:
        x, y, w, h = b.box
        assert x >= 0 and y >= 0 and x + w <= PIXELS[0] and y + h <= PIXELS[1] and min(w, h) >= 80
        cover[y : y + h, x : x + w] += 1
        assert button_at(x, y) is b and button_at(x + w - 1, y + h - 1) is b and button_at(x + w / 2, y + h / 2) is b
    assert cover.max() == 1
    assert button_at(1, 1) is None and button_at(-5, 200) is None
    assert len(BY_NAME) == len(BUTTONS)


def test_it_is_over_the_hand_and_looks_to_the_eyes():
    pose = pose_of(LEFT.grip, HEAD)
    assert_allclose(pose[:3, 3], LEFT.grip[:3, 3] + [0, ABOVE, 0])
    assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
    way = HEAD[:3, 3] - pose[:3, 3]
    assert_allclose(pose[:3, 2], way / np.linalg.norm(way))
    assert pose[1, 0] == pytest.approx(0.0) and pose[1, 1] > 0.5  # level, and not upside down
    over = pose_of(at(0.0, 1.0, 0.0), HEAD)  # straight below
    assert np.isfinite(over).all() and np.linalg.det(over[:3, :3]) == pytest.approx(1.0)


def test_a_ray_meets_the_pixel_that_it_points_at():
    pose = pose_of(LEFT.grip, HEAD)
    rng = np.random.default_rng(0)
    for _ in range(50):
        u, v = rng.uniform(0, PIXELS[0] - 1), rng.uniform(0, PIXELS[1] - 1)
        scale = WIDTH / PIXELS[0]
        target = pose[:3, 3] + pose[:3, :3] @ [(u - PIXELS[0] / 2) * scale, (PIXELS[1] / 2 - v) * scale, 0.0]
        start = target + pose[:3, :3] @ [*rng.uniform(-0.3, 0.3, 2), rng.uniform(0.1, 0.8)]
        z = (start - target) / np.linalg.norm(start - target)
        x = np.cross([0.3, 1.0, 0.2], z)
        x /= np.linalg.norm(x)
        aim = np.eye(4)
        aim[:3, :3], aim[:3, 3] = np.column_stack([x, np.cross(z, x), z]), start
        assert_allclose(ray_hit(pose, aim), (u, v), atol=1e-6)
        aim[:3, 0], aim[:3, 2] = -aim[:3, 0], -aim[:3, 2]
        assert ray_hit(pose, aim) is None  # it points away
    assert on_panel(pose, pose[:3, 3])[:2] == (PIXELS[0] / 2, PIXELS[1] / 2)


def test_a_ray_from_behind_beside_or_afar_misses(panel):
    right = pointing(panel, "undo").aim
    behind = right.copy()
    behind[:3, 3] -= 0.6 * panel.pose[:3, 2]
    beside = right.copy()
    beside[:3, 3] += 0.5 * panel.pose[:3, 0]
    far = right.copy()
    far[:3, 3] += 4.0 * panel.pose[:3, 2]
    for aim in (behind, beside, far):
        assert ray_hit(panel.pose, aim) is None


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("undo", [Undo()]),
        ("redo", [Redo()]),
        ("c", [Duplicate(None)]),
        ("delete", [Remove(None)]),
        ("plus", [Rescale(None, 1.25)]),
        ("minus", [Rescale(None, 0.8)]),
        ("physics", [SetInteraction("physics")]),
        ("transform", [SetInteraction("transform")]),
        ("pause", [Pause(True)]),
        ("reset", [Reset()]),
        ("demo", [PlayDemo(True)]),
    ],
)
def test_the_trigger_presses_what_the_ray_is_on_once_and_grips_nothing(panel, world, name, command):
    commands, right = advance(panel, world, pointing(panel, name))
    assert commands == [] and panel.over.name == name and not panel.clicked
    commands, right = advance(panel, world, pointing(panel, name, pinch=0.9))
    assert commands == command and right.pinch == 0.0 and panel.clicked
    for level in (0.9, 0.5):
        commands, right = advance(panel, world, pointing(panel, name, pinch=level))
        assert commands == [] and right.pinch == 0.0 and not panel.clicked
    commands, right = advance(panel, world, pointing(panel, name))
    assert commands == []
    commands, _ = advance(panel, world, pointing(panel, name, pinch=0.9))
    assert commands == command


def test_a_trigger_pulled_elsewhere_presses_nothing_here_and_holds_on(panel, world):
    elsewhere = Controller(grip=at(0.3, 1.0, -0.3), aim=at(0.3, 1.0, -0.3), pinch=1.0)
    _, right = advance(panel, world, elsewhere)
    assert right.pinch == 1.0
    commands, right = advance(panel, world, pointing(panel, "reset", pinch=1.0))
    assert commands == [] and right.pinch == 1.0 and panel.over is None


def test_a_finger_presses_by_going_through_from_the_front(panel, world):
    def finger(depth):
        return pointing(panel, "c", depth + FINGER)  # it points with the hand

    pressed = [advance(panel, world, finger(d))[0] for d in (0.1, 0.02, 0.005, -0.002, -0.02, 0.005, -0.01)]
    assert pressed == [[], [], [], [Duplicate(None)], [], [], []]
    again = [advance(panel, world, finger(d))[0] for d in (0.02, -0.002)]
    assert again == [[], [Duplicate(None)]]
    from_behind = [advance(panel, world, finger(d))[0] for d in (-0.1, -0.03, -0.005, 0.005, 0.03)]
    assert from_behind == [[]] * 5
    fast = [advance(panel, world, finger(d))[0] for d in (0.2, -0.04)]
    assert fast == [[], [Duplicate(None)]]


def test_a_tracked_finger_presses(panel, world):
    def hand(depth):
        c = pointing(panel, "redo", depth)
        joints = N(position=np.tile(c.grip[:3, 3], (26, 1)), rotation=np.tile(np.eye(3), (26, 1, 1)))
        c.joints, c.aim = joints, None
        return c

    assert [advance(panel, world, hand(d))[0] for d in (0.03, -0.001)] == [[], [Redo()]]


def test_the_light_follows_the_hand_until_the_trigger_is_let_go(panel, world):
    commands, right = advance(panel, world, pointing(panel, "light", pinch=1.0))
    assert right.pinch == 0.0 and panel.placing
    away = at(0.4, 1.3, -0.5)
    commands, right = advance(panel, world, Controller(grip=away, aim=away, pinch=1.0))
    assert_allclose(last_of(SetLight, commands).light.position, (STAGE @ away)[:3, 3])
    assert right.pinch == 0.0
    commands, _ = advance(panel, world, Controller(grip=away, aim=away))
    assert last_of(SetLight, commands) is None and panel.placing is None


def test_a_light_taken_with_a_finger_waits_for_the_trigger(panel, world):
    for depth in (0.03, -0.001):
        advance(panel, world, pointing(panel, "light", depth + FINGER))
    assert panel.placing
    away = at(0.4, 1.3, -0.5)
    for pinch, follows in ((0.0, True), (0.0, True), (1.0, True), (1.0, True), (0.0, False), (0.0, False)):
        commands, _ = advance(panel, world, Controller(grip=away, aim=away, pinch=pinch))
        assert (last_of(SetLight, commands) is not None) == follows


def test_pointing_at_a_body_chooses_it(panel, world):
    world.hit = (0.8, 1)
    away = at(0.4, 1.3, -0.5)
    commands, right = advance(panel, world, Controller(grip=away, aim=away, pinch=1.0))
    assert commands == [Select(1)] and right.pinch == 1.0
    assert_allclose(world.asked[0], (STAGE @ away)[:3, 3])
    assert_allclose(world.asked[1], STAGE[:3, :3] @ [0, 0, -1])
    commands, _ = advance(panel, world, Controller(grip=away, aim=away, pinch=1.0))
    assert commands == []


def test_it_comes_when_the_palm_turns_to_the_face_and_goes(world):
    panel = WristPanel()

    def turned(angle, **inputs):
        """The left hand's palm, +x of its grip, `angle` away from the way to the eyes."""
        way = HEAD[:3, 3] - LEFT.grip[:3, 3]
        x = way / np.linalg.norm(way)
        y = np.cross([0.0, 0.0, 1.0], x)
        y /= np.linalg.norm(y)
        grip = LEFT.grip.copy()
        side = np.cos(angle) * x + np.sin(angle) * y
        grip[:3, :3] = np.column_stack([side, np.cross(np.cross(x, y), side), np.cross(x, y)])
        return Controller(grip=grip, aim=grip, **inputs)

    seen = []
    for degrees in (90, 60, 40, 20, 40, 50, 60, 20):
        advance(panel, world, Controller(), turned(np.radians(degrees)))
        seen.append(panel.pose is not None)
    assert seen == [False, False, False, True, True, True, False, True]
    advance(panel, world, Controller(), turned(0.0, grab=1.0))
    assert panel.pose is None  # a hand that holds something turns as it must


def test_the_button_keeps_it_and_takes_it_away(panel, world):
    advance(panel, world, Controller())
    assert panel.pose is not None
    advance(panel, world, Controller(), Controller())  # the hand is lost: it stays
    assert panel.pose is not None
    advance(panel, world, Controller(), replace(LEFT, pressed={"lower"}))
    assert panel.pose is None
    assert advance(panel, None, Controller(pinch=1.0))[0] == []


def test_what_it_shows(panel, world):
    content = content_of(world, panel)
    assert content.message == "2   Score: see there." and content.rate == "72 fps" and content.on == {"physics"}
    assert "Hold" in content.note and not content.warns
    world.selected, world.paused, world.interaction = 1, True, "transform"
    content = content_of(world, panel)
    assert content.note == "ring_blue" and content.on == {"transform", "pause"}
    world.notice = "There is no room."
    assert content_of(world, panel).note == "There is no room." and content_of(world, panel).warns


def test_its_picture_is_readable_and_says_what_is_on():
    content = Content("0 of 3 rings.", "ring_red", False, "90 fps", frozenset({"physics"}), None)
    plain = paint(content)
    assert plain.shape == (*PIXELS[::-1], 4) and plain.dtype == np.uint8
    assert plain[0, 0, 3] == 0 and plain[250, 400, 3] == 255
    assert (plain[..., :3] <= plain[..., 3:]).all()  # colours times alpha
    for b in BUTTONS:
        x, y, w, h = b.box
        inside = plain[y : y + h, x : x + w, :3].astype(int)
        middle = inside[h // 4 : -h // 4].mean(2)
        assert np.ptp(middle) > 100, f"{b.name} has no letters"
        lit = (inside[8, w // 2] > [200, 120, 0]).all()
        assert lit == (b.name == "physics")
        outside = inside[:, [2, w - 3]].mean(2)
        assert abs(outside[h // 2].mean() - inside[8, w // 2].mean()) < 3, f"{b.name}'s letters reach its edge"
    assert (plain[6, 300, :3] == BACK).all()
    other = paint(replace(content, over="undo"))
    x, y, w, h = BY_NAME["undo"].box
    changed = (plain != other).any(2)
    assert changed[y : y + h, x : x + w].mean() > 0.9 and not changed[:y].any()
    assert (paint(replace(content, message="x" * 300)) != plain).any()  # it is cut, and fits
    assert (paint(content) == plain).all()
