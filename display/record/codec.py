"""Encoding of commands and hands in recordings, which are untrusted: everything is checked on reading.

A command is an entry of a line of JSON. A hand is a layout (JSON: its number of finger capsules) and numbers:
position, rotation, grip, reach, then a, b and radius of each capsule. The layout "n" is no hand.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from types import UnionType
from typing import Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from core.errors import BadInput
from core.material import Material
from core.vocabulary import Hand, Light, Touch
from display import user_commands
from display.user_commands import Command

TEXT_MAX = 200  # characters of a name
TOUCHES_MAX = 1000  # finger capsules of a hand
INDEX_MAX = 1_000_000  # of a body
KEYS = {  # of the commands that change the world
    "demo": user_commands.PlayDemo,
    "reset": user_commands.Reset,
    "load": user_commands.LoadState,
    "light": user_commands.SetLight,
    "interaction": user_commands.SetInteraction,
    "gravity": user_commands.SetGravity,
    "time_scale": user_commands.SetTimeScale,
    "select": user_commands.Select,
    "remove": user_commands.Remove,
    "duplicate": user_commands.Duplicate,
    "rescale": user_commands.Rescale,
    "rotate": user_commands.Rotate,
    "place": user_commands.Place,
    "turn_room": user_commands.TurnRoom,
    "material": user_commands.SetMaterial,
    "undo": user_commands.Undo,
    "redo": user_commands.Redo,
    "pause": user_commands.Pause,
    "step": user_commands.SingleStep,
    "settle": user_commands.Settle,
}
NAMES = {kind: key for key, kind in KEYS.items()}


def to_text(frame: int, commands: Sequence[Command]) -> str:
    """One line of JSON: {"frame": 12, "pause": true, "rescale": [3, 1.25]}; commands that write files are left out.

    A command without fields is true, one with one field is its value, one with more a list, without the last ones that
    have their default values; Light and Material are {"Light": {field: value}}.
    """
    values = {}
    settled = [user_commands.Settle() if isinstance(c, user_commands.SaveState) else c for c in commands]
    for command in (c for c in settled if type(c) in NAMES):
        fields = dataclasses.fields(command)
        given = [getattr(command, f.name) for f in fields]
        while len(given) > 1 and given[-1] == fields[len(given) - 1].default:
            given.pop()
        values[NAMES[type(command)]] = True if not fields else given[0] if len(fields) == 1 else given
    return json.dumps({"frame": frame, **values}, default=_plain)


def _plain(value):
    if isinstance(value, (Light, Material)):
        return {type(value).__name__: {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}}
    return value.tolist()  # of NumPy


def from_text(text: str) -> tuple[int, list[Command]]:
    """The frame's index and its commands. Raises BadInput."""
    try:
        given = json.loads(text)
    except (ValueError, RecursionError) as e:
        raise BadInput("a line of commands is not valid JSON") from e
    if not isinstance(given, dict) or type(given.get("frame")) is not int:
        raise BadInput("a line of commands names no frame")
    commands = []
    for key, value in given.items():
        if key != "frame":
            if key not in KEYS:
                raise BadInput(f"the command {key[:60]!r} is unknown")
            try:
                commands += _command(KEYS[key], value)
            except (LookupError, TypeError, ValueError) as e:
                raise BadInput(f"the command {key!r} cannot be {str(value)[:60]!r}") from e
    return given["frame"], commands


def _command(kind: type, value) -> list[Command]:
    """The command, in a list; [] if a command without fields is false."""
    types = _types(kind)
    if not types:
        return [kind()] if checked_value(value, bool) else []
    values = [value] if len(types) == 1 else value
    if not isinstance(values, list) or len(values) > len(types):
        raise ValueError
    return [kind(*(checked_value(v, t) for v, t in zip(values, types.values(), strict=False)))]  # TypeError: too few


def _types(kind: type) -> dict[str, type]:
    hints = get_type_hints(kind)
    return {f.name: hints[f.name] for f in dataclasses.fields(kind)}


def checked_value(value, kind):
    """A JSON value as this type. Raises LookupError, TypeError or ValueError if it is not one."""
    origin = get_origin(kind)
    if origin in (Union, UnionType):
        for one in get_args(kind):
            try:
                return checked_value(value, one)
            except (LookupError, TypeError, ValueError):
                pass
    elif origin is Literal:
        if value in get_args(kind):
            return value
    elif origin is tuple:
        return tuple(checked_value(v, t) for v, t in zip(value, get_args(kind), strict=True))
    elif dataclasses.is_dataclass(kind):
        types = _types(kind)
        return kind(**{name: checked_value(v, types[name]) for name, v in dict(value[kind.__name__]).items()})
    elif (
        (kind is float and type(value) in (int, float) and math.isfinite(value))
        or (kind is int and type(value) is int and 0 <= value < INDEX_MAX)
        or (kind is str and isinstance(value, str) and len(value) <= TEXT_MAX)
        or (kind in (bool, type(None)) and isinstance(value, kind))
    ):
        return value
    raise ValueError


def hand_layout(touches: int | None) -> str | dict:
    """Layout of a hand with this many finger capsules; None: of no hand."""
    if touches is None:
        return "n"
    capsule = {"c": "Touch", "f": {"a": ["t", 3, "f"], "b": ["t", 3, "f"], "radius": "f"}}
    fields = {"position": ["t", 3, "f"], "rotation": ["t", 4, "f"], "grip": "b", "reach": "f"}
    return {"c": "Hand", "f": fields | {"touch": ["t", touches, capsule] if touches else ["t"]}}


def pack_hand(hand: Hand | None) -> tuple[str | dict, list[float]]:
    """Layout and numbers of a hand. A hand with non-finite numbers counts as none, as in the world."""
    if hand is None:
        return hand_layout(None), []
    numbers = [*hand.position, *hand.rotation, hand.grip, hand.reach]
    for touch in hand.touch:
        numbers += [*touch.a, *touch.b, touch.radius]
    numbers = [float(x) for x in numbers]
    return (hand_layout(len(hand.touch)), numbers) if np.isfinite(numbers).all() else (hand_layout(None), [])


def touch_count(layout) -> int | None:
    """Number of finger capsules of a hand with this layout, None for no hand. Raises BadInput for any other layout."""
    if layout == "n":
        return None
    try:
        touch = layout["f"]["touch"]
        count = touch[1] if len(touch) > 1 else 0
    except (LookupError, TypeError) as e:
        raise BadInput("a layout is not that of a hand") from e
    if type(count) is not int or not 0 <= count <= TOUCHES_MAX or layout != hand_layout(count):
        raise BadInput("a layout is not that of a hand")
    return count


def hand_size(touches: int | None) -> int:
    """Count of numbers of a hand with this many finger capsules."""
    return 0 if touches is None else 9 + 7 * touches


def unpack_hand(touches: int | None, numbers: np.ndarray) -> Hand | None:
    """The hand of `hand_size(touches)` numbers."""
    if touches is None:
        return None
    x = numbers.tolist()
    capsules = tuple(Touch(tuple(c[:3]), tuple(c[3:6]), c[6]) for c in (x[i : i + 7] for i in range(9, len(x), 7)))
    return Hand(tuple(x[:3]), tuple(x[3:7]), bool(x[7]), x[8], capsules)
