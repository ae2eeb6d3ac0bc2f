"""Messages of a page: JSON lists of a name and its values, untrusted. Everything is checked on reading.

| message | |
| --- | --- |
| ["size", width, height] | of the page, in device pixels |
| ["move", u, v, stamp] | the pointer; u and v in fractions of the picture, stamp: the page's clock [ms] |
| ["button", "left", down, u, v, stamp] | a button of the mouse, or the only finger as the left one |
| ["wheel", notches, stamp] | positive is away from the user |
| ["pinch", notches, du, dv, stamp] | two fingers: apart is positive; their shift in fractions of the picture |
| ["key", code, label, down, ctrl, stamp] | KeyboardEvent's code and key |
| ["blur"] | the page has lost the focus: releases may never come |
| ["shown", number, milliseconds] | a picture is on view; since the stamp of the last input in it, or null |
| ["pong", number] | answer to a ping |
| ["hidden", on] | nobody sees the page |
| ["take"] | this page wants to play |
| ["details", on] | the timings are on view |
| ["edits", on] | the pointer is among the edits |
| ["resolution", name] | a name of RESOLUTIONS |
| ["slide", section, name, value, continued] | a slider of the panel; whether it goes on with the last change |
| ["light", kind] | "Point" or "Directional" |
| ["keep", name, kind] | a button of the panel that writes a file; the kind of an export |
| ["edit", name] | a button of the panel's section of the body |
| ["open", name, {option: choice}] | another scene |
| ["leave"] | the pointer is not over the picture |
| ["command", {name: value}] | one of COMMANDS, as in recordings |
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable

from core.errors import BadInput
from display.record.codec import from_text
from display.user_commands import Command
from display.web.page_state import SECTIONS
from display.window.panel.body_section import BUTTONS
from display.window.panel.keep_section import KINDS
from display.window.panel.performance_section import RESOLUTIONS

MESSAGE_BYTES = 4096  # of one message: none of ours has more than a few hundred
SIDE_MAX = 16_384  # [px] of a page
FAR = 4.0  # pictures away from its corner: a captured pointer leaves the page, but not for long
NOTCHES_MAX = 50.0  # of a wheel at once
SLIDER_MAX = 1e12  # in any unit
OPTIONS_MAX = 10
TEXT_MAX = 40  # characters of the name of a key, a slider or a scene
COMMANDS = ("demo", "reset", "interaction", "material", "undo", "redo", "pause", "step")  # none names a file


def number(low: float, high: float) -> Callable:
    """A check for numbers within bounds."""

    def check(value) -> float:
        if type(value) not in (int, float) or not (math.isfinite(value) and low <= value <= high):
            raise ValueError
        return float(value)

    return check


def one_of(*values) -> Callable:
    """A check for one of these values."""

    def check(value):
        if not any(value is known or (isinstance(value, str) and value == known) for known in values):
            raise ValueError
        return value

    return check


def side(value) -> int:
    """A check for a side of a page [px]."""
    return round(number(1, SIDE_MAX)(value))


def text(value) -> str:
    """A check for a short text."""
    if not isinstance(value, str) or len(value) > TEXT_MAX:
        raise ValueError
    return value


def choices(value) -> dict[str, str]:
    """A check for options of a scene."""
    if not isinstance(value, dict) or len(value) > OPTIONS_MAX:
        raise ValueError
    return {text(key): text(choice) for key, choice in value.items()}


def optional(check: Callable) -> Callable:
    """A check that lets None pass."""
    return lambda value: None if value is None else check(value)


def command(value) -> Command:
    """A check for one command."""
    if not isinstance(value, dict) or len(value) != 1 or not set(value) <= set(COMMANDS):
        raise ValueError
    _, (found,) = from_text(json.dumps({"frame": 0, **value}))
    return found


MOUSE_BUTTON, SWITCH = one_of("left", "right", "middle"), one_of(True, False)
FRACTION, STAMP, COUNT = number(-FAR, FAR), number(0, 1e15), number(0, 2**53)
NOTCHES = number(-NOTCHES_MAX, NOTCHES_MAX)
CHECKS: dict[str, tuple[Callable, ...]] = {
    "size": (side, side),
    "move": (FRACTION, FRACTION, STAMP),
    "button": (MOUSE_BUTTON, SWITCH, FRACTION, FRACTION, STAMP),
    "wheel": (NOTCHES, STAMP),
    "pinch": (NOTCHES, FRACTION, FRACTION, STAMP),
    "key": (text, text, SWITCH, SWITCH, STAMP),
    "blur": (),
    "shown": (COUNT, optional(number(0, 1e9))),
    "pong": (COUNT,),
    "hidden": (SWITCH,),
    "take": (),
    "details": (SWITCH,),
    "edits": (SWITCH,),
    "resolution": (one_of(*RESOLUTIONS),),
    "edit": (one_of(*BUTTONS),),
    "keep": (text, one_of(*KINDS)),
    "light": (one_of("Point", "Directional"),),
    "slide": (one_of(*SECTIONS), text, number(-SLIDER_MAX, SLIDER_MAX), SWITCH),
    "open": (text, choices),
    "leave": (),
    "command": (command,),
}
STAMPED = ("move", "button", "wheel", "pinch", "key")  # the last value is the stamp


def read_message(message: str | bytes) -> tuple:
    """Name and values of a message. Raises BadInput."""
    try:
        if not isinstance(message, str):
            raise ValueError
        name, *values = json.loads(message)
        return name, *(check(value) for check, value in zip(CHECKS[name], values, strict=True))
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError, BadInput) as e:
        raise BadInput("malformed message") from e
