"""Messages to a page and from it, as JSON.

A message of a page is a list of a name and its values, untrusted: all of them are checked on reading (MESSAGES). The
program tells what a page shows: `first_words` once for each scene, then changes of `world_state`.
"""

from __future__ import annotations

import json
from base64 import b64encode
from typing import Annotated, Any, Literal

import numpy as np

from core.camera import Camera, project
from core.errors import BadInput
from core.typed import Range, Size, from_plain, to_plain
from core.vocabulary import BodyState
from display.edit.selection_marker import marked, marker_lines
from display.panel import (
    ButtonGrid,
    Choice,
    Panel,
    Row,
    Section,
    Slider,
    chosen_by_list,
    demos,
    line_of,
    picture_file,
    score_and_message,
    spoken,
)
from display.protocol import WorldView
from display.user_commands import OpenScene
from display.window.controls import HOVER_OPACITY
from display.window.key_bindings import BY_CHORD, help_rows
from scenes.registry import Demo
from scenes.scene import Scene

MESSAGE_BYTES = 4096  # of one message: none of ours has more than a few hundred
Name = Annotated[str, Size(40)]  # of a key, of a scene and its options, of a section of the panel and its rows
Side = Annotated[int, Range(1, 16_384)]  # [px] of a page
Fraction = Annotated[float, Range(-4.0, 4.0)]  # of the picture: a captured pointer leaves the page, but not for long
Stamp = Annotated[float, Range(0.0, 1e15)]  # [ms] of the page's clock
Milliseconds = Annotated[float, Range(0.0, 1e9)]
Notches = Annotated[float, Range(-50.0, 50.0)]  # of a wheel at once
Count = Annotated[int, Range(0, 2**53)]
MESSAGES: dict[str, Any] = {
    "size": tuple[Side, Side],  # width and height of the page
    "move": tuple[Fraction, Fraction, Stamp],  # the pointer
    "button": tuple[Literal["left", "right", "middle"], bool, Fraction, Fraction, Stamp],  # or the only finger: left
    "wheel": tuple[Notches, Stamp],  # positive is away from the user
    "pinch": tuple[Notches, Fraction, Fraction, Stamp],  # two fingers: apart is positive; their shift
    "key": tuple[Name, Name, bool, bool, Stamp],  # KeyboardEvent's code and key, whether it is down, and Ctrl
    "blur": tuple[()],  # the page has lost the focus: releases may never come
    "shown": tuple[Count, Milliseconds | None],  # a picture is on view; since the stamp of the last input in it
    "pong": tuple[Count],  # answer to a ping
    "hidden": tuple[bool],  # nobody sees the page
    "take": tuple[()],  # this page wants to play
    "details": tuple[bool],  # the timings are on view
    "edits": tuple[bool],  # the pointer is among the edits of a body
    "panel": tuple[Name, Name, bool | Annotated[float, Range(-1e12, 1e12)] | Name, bool],  # of panel.commands_of
    "open": tuple[Name, Annotated[dict[Name, Name], Size(10)]],  # another scene, and its options
    "leave": tuple[()],  # the pointer is not over the picture
}
STAMPED = ("move", "button", "wheel", "pinch", "key")  # the last value is the stamp
# Actions of keys that a page has in its own way, or not at all.
WINDOW_ONLY = ("panel", "menu", "help", "asks_file", "next_gizmo", "toggle_room_gizmo", "measure", "escape")
PAGE_KEYS = [
    ("F1", "show or hide the panel"),
    ("F2", "choose another scene"),
    ("H", "list of mouse and keys"),
    ("Esc", "end drag or demonstration"),
]


def read_message(message: str | bytes) -> tuple:
    """Name and values of a message. Raises BadInput."""
    try:
        if not isinstance(message, str):
            raise ValueError
        name, *values = json.loads(message)
        return name, *from_plain(MESSAGES[name], values, name)
    except (ValueError, TypeError, KeyError, RecursionError, BadInput) as e:
        raise BadInput("malformed message") from e


def first_words(title: str, name: str, scene: Scene) -> dict:
    """First message to a page: what does not change while the scene of that `name` is played."""
    editable = scene.light is not None or bool(scene.bodies)
    return {
        "title": title,
        "playing": name,
        "scenes": [described_scene(demo) for demo in demos()] if editable else [],
        "cast": [f"{file} is {role}" for file, role in scene.cast],
        "keys": [*help_rows(editable, WINDOW_ONLY), *PAGE_KEYS],
        "ctrl_keys": [chord.rpartition("+")[2] for chord in BY_CHORD if chord.startswith("ctrl+")],
    }


def described_scene(demo: Demo) -> dict:
    """A scene for the menu, with its picture as a data URL, or None."""
    picture = picture_file(OpenScene(demo.name))
    return {
        "name": demo.name,
        "spoken": spoken(demo.name),
        "line": line_of(demo),
        "options": {option.name: [str(option.default), *option.choices] for option in chosen_by_list(demo)},
        "picture": picture and "data:image/jpeg;base64," + b64encode(picture.read_bytes()).decode(),
    }


def scene_request(name: str, options: dict) -> OpenScene | None:
    """The command that opens a scene of the menu; None if there is no such scene or option."""
    for demo in demos():
        known = {option.name: option.choices for option in chosen_by_list(demo)}
        if demo.name == name and all(value in known.get(key, ()) for key, value in options.items()):
            return OpenScene(name, options)
    return None


def world_state(world: WorldView, panel: Panel) -> dict:
    """State of a world that a page shows beside its picture; cheap enough for every frame.

    Each section of the panel has its own key, so that only sections that changed are sent."""
    score, message = score_and_message(world)
    sections = panel.sections(world)
    return {
        "loading": "",
        "editable": world.editable,
        "score": score,
        "message": message,
        "notice": world.notice,
        "opening": world.opening,
        "film": None if world.film_seconds is None else int(world.film_seconds),
        "sections": [section.title for section in sections],
        **{f"section {section.title}": described_section(section) for section in sections},
    }


def described_section(section: Section) -> dict:
    """A section of the panel as the page builds it."""
    rows = [described_row(row) for row in section.rows]
    return {"label": section.label or section.title, "folded": section.folded, "plain": section.plain, "rows": rows}


def described_row(row: Row) -> dict:
    """A row of the panel, with its kind in place of its commands."""
    fields = {"kind": type(row).__name__, **vars(row)}
    if isinstance(row, ButtonGrid):
        fields["buttons"] = [{"name": b.name, "label": b.text, "tip": b.tip, "on": b.on} for b in row.buttons]
    if isinstance(row, Slider) and row.usual is not None:
        fields["tip"] += " A right click brings the usual value back."
    if isinstance(row, Choice):
        fields["options"] = list(row.options.items())
    return to_plain({name: value for name, value in fields.items() if not callable(value)})


def overlay(world: WorldView, camera: Camera, hand: np.ndarray | None, under: BodyState | None, *, near: bool) -> list:
    """Strokes over the picture: [u, v] of the hand, and [u, v, u, v, opacity] of the corners of the marked body.

    u and v are fractions of the camera's picture.

    under  the body under the cursor
    near   the cursor is among the edits
    """

    def place(at: tuple[float, float]) -> list[float]:
        return [round(float(at[0]) / camera.width, 4), round(float(at[1]) / camera.height, 4)]

    if hand is not None:
        at = project(camera, hand)
        return [] if at is None else [place(at)]
    body = marked(world, near=near)
    shown = [(body, 1.0)] if body is not None else []
    shown += [(under, HOVER_OPACITY)] if under is not None and under is not body else []
    return [[*place(a), *place(b), s * opacity] for one, s in shown for a, b, opacity in marker_lines(one, camera)]
