"""What a user may ask of a world between two frames, as text and back: nothing else is taken from a recording."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable

from core.errors import BadInput
from core.material import Material
from scenes.scene import Light

TEXT = 200  # characters of a name
INTERACTIONS = ("physics", "transform")


def flag(value) -> bool:
    return isinstance(value, bool)


def index(value) -> bool:
    """Of a body, or None for the one last held."""
    return value is None or (type(value) is int and 0 <= value < 1_000_000)


def number(value) -> bool:
    return type(value) in (int, float) and math.isfinite(value)


def name(value) -> bool:
    return isinstance(value, str) and len(value) <= TEXT


def vector(count: int) -> Callable:
    return lambda value: isinstance(value, tuple) and len(value) == count and all(map(number, value))


def both(*checks: Callable) -> Callable:
    return lambda v: (
        isinstance(v, tuple) and len(v) == len(checks) and all(c(x) for c, x in zip(checks, v, strict=True))
    )


def light(value) -> bool:
    good = isinstance(value, Light) and vector(3)(value.position) and vector(3)(value.target)
    return good and value.kind in ("point", "directional") and number(value.strength) and number(value.softness)


def material(value) -> bool:
    if isinstance(value, Material):
        numbers = [getattr(value, f.name) for f in dataclasses.fields(value)]
        return all(v is None or number(v) for v in numbers)
    return name(value)


COMMANDS: dict[str, Callable] = {
    "reset": flag,
    "pause": flag,
    "step": flag,
    "demo": flag,
    "interaction": lambda value: value in INTERACTIONS,
    "light": light,
    "undo": flag,
    "redo": flag,
    "select": index,
    "remove": index,
    "duplicate": index,
    "rescale": both(index, number),
    "rotate": both(index, vector(4)),
    "material": both(index, material),
}
CLASSES = {"Light": Light, "Material": Material}


def to_text(frame: int, commands: dict) -> str:
    """One line of JSON with the frame's number; data classes as {"Light": {field: value}}."""
    return json.dumps({"frame": frame, **commands}, default=_plain)


def _plain(value):
    if type(value).__name__ in CLASSES:
        return {type(value).__name__: {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}}
    return value.tolist()  # of NumPy


def from_text(text: str) -> tuple[int, dict]:
    """The frame and its commands again, checked. BadInput."""
    try:
        given = json.loads(text, object_hook=_object)
    except (ValueError, TypeError, RecursionError) as e:
        raise BadInput("a command is no JSON that makes sense") from e
    if not isinstance(given, dict) or type(given.get("frame")) is not int:
        raise BadInput("commands name no frame")
    commands = {key: _tuples(value) for key, value in given.items() if key != "frame"}
    for key, value in commands.items():
        if key not in COMMANDS:
            raise BadInput(f"the command {key[:60]!r} is not known")
        if not COMMANDS[key](value):
            raise BadInput(f"the command {key!r} cannot be {str(value)[:60]!r}")
    return given["frame"], commands


def _object(pairs: dict):
    if len(pairs) == 1:
        ((key, value),) = pairs.items()
        if key in CLASSES and isinstance(value, dict):
            return CLASSES[key](**{k: _tuples(v) for k, v in value.items()})  # TypeError for fields that it lacks
    return pairs


def _tuples(value):
    return tuple(_tuples(v) for v in value) if isinstance(value, list) else value
