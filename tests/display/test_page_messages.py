"""Messages of a page are untrusted: what is not as it must be is refused, all of it."""

import json

import pytest

from core.errors import BadInput
from display import user_commands
from display.web.browser import pressed_key
from display.web.page_messages import read_message


@pytest.mark.parametrize(
    ("message", "values"),
    [
        (["move", 0.5, -0.25, 12.5], ("move", 0.5, -0.25, 12.5)),
        (["button", "left", True, 0, 1, 3], ("button", "left", True, 0.0, 1.0, 3.0)),
        (["shown", 7, None], ("shown", 7.0, None)),
        (["blur"], ("blur",)),
        (["resolution", "1/2"], ("resolution", "1/2")),
        (["command", {"pause": True}], ("command", user_commands.Pause(True))),
        (["command", {"material": [None, "jelly"]}], ("command", user_commands.SetMaterial(None, "jelly"))),
    ],
)
def test_messages_are_read(message, values):
    assert read_message(json.dumps(message)) == values


@pytest.mark.parametrize(
    "message",
    [
        "",
        "{}",
        "[]",
        "[1]",
        '["move", 1, 2]',
        '["move", 1, 2, 3, 4]',
        '["move", 1, NaN, 3]',
        '["move", 1e9, 0, 3]',
        '["move", true, 0, 3]',
        '["button", "fourth", true, 0, 0, 1]',
        '["button", "left", 1, 0, 0, 1]',
        '["size", 0, 100]',
        '["size", 1e9, 100]',
        '["key", "' + 50 * "x" + '", "a", true, false, 1]',
        '["unknown"]',
        '[["move"], 1, 2, 3]',
        '["resolution", 0.5]',
        '["edit", "Format"]',
        '["command", {"open": "/etc/passwd"}]',
        '["command", {"pause": true, "reset": true}]',
        '["command", {"pause": false, "frame": 3}]',
        '["command", {"reset": false}]',
        '["command", {"light": {"Light": {}}}]',
        '["command", {"material": [null, {"Material": {"young": "soft"}}]}]',
        '["slide", "body", "stiffness", 1e99, true]',
        '["slide", "files", "stiffness", 1, true]',
        "[" * 2000,
        b'["blur"]',
    ],
)
def test_malformed_messages_are_refused(message):
    with pytest.raises(BadInput):
        read_message(message)


@pytest.mark.parametrize(
    ("code", "key", "down", "ctrl", "name"),
    [
        ("KeyW", "w", True, False, "w"),
        ("KeyW", "z", True, False, "w"),  # walking goes by the place of the keys
        ("KeyZ", "w", True, False, None),
        ("KeyY", "z", True, True, "ctrl+z"),  # all else by what is printed on them
        ("KeyZ", "z", False, True, "z"),
        ("ShiftRight", "Shift", True, False, "shift"),
        ("BracketRight", "+", True, False, "plus"),
        ("NumpadAdd", "+", True, False, "plus"),
        ("Digit3", "3", True, True, "ctrl+3"),
        ("Delete", "Delete", True, False, "delete"),
        ("Space", " ", True, False, "space"),
        ("Enter", "Enter", True, False, "enter"),
        ("Backspace", "Backspace", True, False, None),
    ],
)
def test_keys_have_the_names_that_they_have_in_the_window(code, key, down, ctrl, name):
    assert pressed_key(code, key, down=down, ctrl=ctrl) == name
