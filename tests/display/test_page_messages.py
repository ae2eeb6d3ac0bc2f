"""Messages of a page are untrusted: what is not as it must be is refused, all of it."""

import json
from types import SimpleNamespace as N

import numpy as np
import pytest

from core.camera import look_at, perspective, project
from core.errors import BadInput
from display import user_commands
from display.panel import Panel, commands_of
from display.web.browser import Browser, pressed_key
from display.web.page_messages import overlay, read_message, world_state
from tests.support.fake_world import BallWorld, fake_scene


@pytest.mark.parametrize(
    ("message", "values"),
    [
        (["move", 0.5, -0.25, 12.5], ("move", 0.5, -0.25, 12.5)),
        (["button", "left", True, 0, 1, 3], ("button", "left", True, 0.0, 1.0, 3.0)),
        (["shown", 7, None], ("shown", 7.0, None)),
        (["blur"], ("blur",)),
        (["panel", "Play", "Pause", True, False], ("panel", "Play", "Pause", True, False)),
        (["panel", "Body", "density", 20, True], ("panel", "Body", "density", 20.0, True)),
        (["open", "manipulation", {"animal": "fox"}], ("open", "manipulation", {"animal": "fox"})),
    ],
)
def test_messages_are_read(message, values):
    assert read_message(json.dumps(message)) == values


@pytest.mark.parametrize(
    "message",
    [
        *("", "{}", "[]", "[1]", '["unknown"]', '[["move"], 1, 2, 3]', "[" * 2000, b'["blur"]'),
        *(f'["move", {values}]' for values in ("1, 2", "1, 2, 3, 4", "1, NaN, 3", "1e9, 0, 3", "true, 0, 3")),
        *(f'["button", {values}, 0, 0, 1]' for values in ('"fourth", true', '"left", 1')),
        *(f'["size", {width}, 100]' for width in ("0", "1e9")),
        '["key", "' + 50 * "x" + '", "a", true, false, 1]',
        *(f'["panel", "Body", "stiffness", {value}]' for value in ("1e99, true", "null, true", "{}, true", "1")),
        '["open", "manipulation", {"animal": 3}]',
        '["open", "manipulation", {' + ", ".join(f'"{k}": "a"' for k in range(11)) + "}]",
    ],
)
def test_malformed_messages_are_refused(message):
    with pytest.raises(BadInput):
        read_message(message)


def test_rows_of_the_panel_take_what_they_show_and_nothing_else():
    world, panel = BallWorld(fake_scene()), Panel()
    world.selected = 0

    def sent(section, name, value, continued=False):
        return list(commands_of(panel.sections(world), section, name, value, continued))

    assert sent("Play", "Pause", True) == [user_commands.Pause(True)]
    assert sent("Play", "interaction", "Transform") == [user_commands.SetInteraction("transform")]
    assert sent("Body", "material", "jelly") == [user_commands.SetMaterial(0, "jelly")]
    (moved,) = sent("Body", "stiffness", 1e12, True)
    assert moved.material.young == 1e8 and moved.continued, "within the slider's ends"
    assert sent("Performance", "resolution", "1/2") == [] and panel.scale == 0.5
    assert sent("Keep", "export", "export .obj") == sent("Keep", "selected body only", True) == []
    assert sent("Keep", "Export", True) == [user_commands.Export("obj", 0)]
    for section, name, value in (
        ("Play", "Pause", False),
        ("Play", "Format", True),
        ("Files", "Pause", True),
        ("Body", "material", "/etc/passwd"),
        ("Body", "material", 3.0),
        ("Body", "stiffness", "soft"),
        ("Performance", "resolution", 0.5),
        ("Keep", "with shadows", 1.0),
    ):
        assert sent(section, name, value) == []
    assert panel.scale == 0.5


def test_a_page_is_told_all_sections_as_plain_data():
    world = BallWorld(fake_scene())
    world.selected = 0
    state = json.loads(json.dumps(world_state(world, Panel()), allow_nan=False))
    assert state["sections"] == ["Play", "Body", "World", "Light", "Keep", "Performance"]
    assert state["section Body"]["label"] == "ball" and not state["section Body"]["folded"]
    kinds = {row["kind"] for title in state["sections"] for row in state[f"section {title}"]["rows"]}
    assert kinds == {"ButtonGrid", "Choice", "Slider", "Toggle", "Table"}


def test_strokes_lie_where_the_camera_sees_things_in_fractions_of_a_picture_that_is_not_square():
    camera = perspective(400, 100, 0.9, look_at((0.2, 0.7, 1.0), (0.0, 0.1, 0.0)))
    world = BallWorld(fake_scene())
    for at in np.random.default_rng(0).uniform(-0.2, 0.2, (9, 3)):
        (u, v) = overlay(world, camera, at, None, near=False)[0]
        x, y = project(camera, at)
        assert (u, v) == pytest.approx((x / 400, y / 100), abs=1e-4)
    assert overlay(world, camera, np.array(camera.position + [0.0, 0.0, 1.0]), None, near=False) == []  # behind it
    under = world.bodies()[0]
    for u0, v0, u1, v1, opacity in overlay(world, camera, None, under, near=False):
        assert 0 < opacity <= 1
        for u, v in ((u0, v0), (u1, v1)):  # the ray through it meets the body's box, a little widened
            origin, way = camera.ray(400 * u, 100 * v)
            near = origin + way * ((under.centroid - origin) @ way)
            assert np.linalg.norm(near - under.centroid) < np.linalg.norm(under.high - under.low)


@pytest.mark.parametrize(
    ("code", "key", "down", "ctrl", "name"),
    [
        ("KeyW", "z", True, False, "w"),
        ("KeyY", "z", True, True, "ctrl+z"),
        ("KeyZ", "z", False, True, "z"),
        ("ShiftRight", "Shift", True, False, "shift"),
        ("NumpadAdd", "+", True, False, "plus"),
        ("Digit3", "3", True, True, "ctrl+3"),
        ("Space", " ", True, False, "space"),
        ("Backspace", "Backspace", True, False, None),
    ],
)
def test_keys_have_the_names_that_they_have_in_the_window(code, key, down, ctrl, name):
    assert pressed_key(code, key, down=down, ctrl=ctrl) == name


@pytest.mark.parametrize("page", [(640, 360), (1920, 1080), (5120, 1440), (900, 4000), (16384, 9216)])
@pytest.mark.parametrize("largest", [None, (800, 800)])
def test_a_picture_has_the_shape_of_its_page_and_no_more_pixels_than_are_sent(page, largest):
    """As many as fit: 1920 x 1080, and no side larger than was asked for."""
    width, height = Browser._full.fget(N(_server=N(player=N(size=page)), _largest=largest))
    most = 1920 * 1080 if largest is None else 800 * 800
    assert width * height <= most and width / height == pytest.approx(page[0] / page[1], rel=0.01)
    fits = min(1.0, (1920 * 1080 / (page[0] * page[1])) ** 0.5, *(np.divide(largest or page, page)))
    assert (width, height) == pytest.approx(np.multiply(fits, page), abs=1.5)
