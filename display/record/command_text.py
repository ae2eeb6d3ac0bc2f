"""Commands as lines of JSON and back. A recording may come from anywhere: only known commands with valid values are read."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from types import UnionType
from typing import Literal, Union, get_args, get_origin, get_type_hints

from core.errors import BadInput
from core.material import Material
from display import protocol
from display.protocol import Command
from scenes.scene import Light

TEXT = 200  # characters of a name
MAX_INDEX = 1_000_000  # of a body
KEYS = {
    "demo": protocol.PlayDemo,
    "reset": protocol.Reset,
    "light": protocol.SetLight,
    "interaction": protocol.SetInteraction,
    "select": protocol.Select,
    "remove": protocol.Remove,
    "duplicate": protocol.Duplicate,
    "rescale": protocol.Rescale,
    "rotate": protocol.Rotate,
    "material": protocol.SetMaterial,
    "undo": protocol.Undo,
    "redo": protocol.Redo,
    "pause": protocol.Pause,
    "step": protocol.SingleStep,
}
NAMES = {kind: key for key, kind in KEYS.items()}


def to_text(frame: int, commands: Sequence[Command]) -> str:
    """One line of JSON: {"frame": 12, "pause": true, "rescale": [3, 1.25]}.

    A command without fields is true, one with one field is its value, one with more a list; Light and Material are
    {"Light": {field: value}}.
    """
    values = {}
    for command in commands:
        fields = [getattr(command, f.name) for f in dataclasses.fields(command)]
        values[NAMES[type(command)]] = True if not fields else fields[0] if len(fields) == 1 else fields
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
        return [kind()] if _checked(value, bool) else []
    values = [value] if len(types) == 1 else value
    return [kind(*(_checked(v, t) for v, t in zip(values, types.values(), strict=True)))]


def _types(kind: type) -> dict[str, type]:
    hints = get_type_hints(kind)
    return {f.name: hints[f.name] for f in dataclasses.fields(kind)}


def _checked(value, kind):
    """The value of JSON as this type. Raises LookupError, TypeError or ValueError if it is not one."""
    origin = get_origin(kind)
    if origin in (Union, UnionType):
        for one in get_args(kind):
            try:
                return _checked(value, one)
            except (LookupError, TypeError, ValueError):
                pass
    elif origin is Literal:
        if value in get_args(kind):
            return value
    elif origin is tuple:
        return tuple(_checked(v, t) for v, t in zip(value, get_args(kind), strict=True))
    elif dataclasses.is_dataclass(kind):
        types = _types(kind)
        return kind(**{name: _checked(v, types[name]) for name, v in dict(value[kind.__name__]).items()})
    elif kind is float and type(value) in (int, float) and math.isfinite(value):
        return value
    elif kind is int and type(value) is int and 0 <= value < MAX_INDEX:
        return value
    elif kind is str and isinstance(value, str) and len(value) <= TEXT:
        return value
    elif kind in (bool, type(None)) and isinstance(value, kind):
        return value
    raise ValueError
