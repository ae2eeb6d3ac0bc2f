"""Values of a game as JSON and back: numbers, texts, lists, tuples, sets, dictionaries, arrays, and dataclasses.

A list is itself; all else that JSON lacks is {"kind": [...]}. Of a file, which is untrusted, nothing but such values is
made: a dataclass is one that the game's own module knows, and has the fields that it names.
"""

from __future__ import annotations

import dataclasses
import math
import sys

import numpy as np

from core.errors import BadInput

DEPTH_MAX = 20  # of values in values
ARRAY_MAX = 1 << 20  # numbers of an array


def encoded(value, depth: int = 0):
    """A value as JSON. Raises BadInput for one of another type."""
    if depth > DEPTH_MAX:
        raise BadInput("values lie too deep in one another")
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else {"float": str(value)}
    if isinstance(value, list):
        return [encoded(v, depth + 1) for v in value]
    if isinstance(value, np.generic):
        return encoded(value.item(), depth)
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        kind = {"f": "floats", "b": "bools"}.get(value.dtype.kind, "integers")
        return {kind: [list(value.shape), [encoded(v, depth + 1) for v in value.ravel().tolist()]]}
    if isinstance(value, (tuple, set, frozenset)):
        values = sorted(value, key=repr) if isinstance(value, (set, frozenset)) else value
        return {type(value).__name__: [encoded(v, depth + 1) for v in values]}
    if isinstance(value, dict):
        return {"dict": [[encoded(k, depth + 1), encoded(v, depth + 1)] for k, v in value.items()]}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        own = {f.name: encoded(getattr(value, f.name), depth + 1) for f in dataclasses.fields(value)}
        return {"object": [type(value).__name__, own]}
    raise BadInput(f"a value of type {type(value).__name__} cannot be kept in a file")


def decoded(value, classes: dict[str, type], depth: int = 0):
    """The value of JSON; `classes` are the dataclasses that it may name. Raises BadInput."""
    if depth > DEPTH_MAX:
        raise BadInput("values lie too deep in one another")
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, list):
        return [decoded(v, classes, depth + 1) for v in value]
    try:
        ((kind, content),) = value.items()
        match kind:
            case "float":
                return float({"nan": "nan", "inf": "inf", "-inf": "-inf"}[content])
            case "floats" | "integers" | "bools":
                return array(kind, *content)
            case "tuple" | "set" | "frozenset":
                make = {"tuple": tuple, "set": set, "frozenset": frozenset}[kind]
                return make(decoded(v, classes, depth + 1) for v in list(content))
            case "dict":
                return {decoded(k, classes, depth + 1): decoded(v, classes, depth + 1) for k, v in list(content)}
            case "object":
                name, own = content
                made = {f: decoded(v, classes, depth + 1) for f, v in own.items()}
                if made.keys() != {f.name for f in dataclasses.fields(classes[name])}:
                    raise ValueError
                return restored(classes[name], made)
    except (AttributeError, LookupError, TypeError, ValueError, OverflowError) as e:
        raise BadInput(f"{str(value)[:60]!r} is no value") from e
    raise BadInput(f"{str(value)[:60]!r} is no value")


def array(kind: str, shape, values) -> np.ndarray:
    """An array of numbers of JSON. Raises ValueError or the like."""
    sides = [int(side) for side in shape]
    if len(values) > ARRAY_MAX or math.prod(sides) != len(values) or min(sides, default=0) < 0:
        raise ValueError
    numbers = [decoded(v, {}) for v in values]
    if not all(isinstance(n, (bool, int, float)) for n in numbers):
        raise ValueError
    return np.array(numbers, {"floats": np.float64, "integers": np.int64, "bools": bool}[kind]).reshape(sides)


def restored(kind: type, values: dict):
    """A dataclass's object with these fields, whatever its constructor would make of them."""
    made = object.__new__(kind)
    for name, value in values.items():
        object.__setattr__(made, name, value)
    return made


def game_state(game) -> dict:
    """The name and the state of a game, as JSON. Raises BadInput that names what cannot be kept."""
    state = {}
    for name, value in vars(game).items():
        try:
            state[name] = encoded(value)
        except BadInput as e:
            raise BadInput(f"the game's {name!r}: {e}") from e
    return {"name": type(game).__name__, "state": state}


def game_values(game, given: dict) -> dict:
    """The attributes of a game of this kind, of JSON. Raises BadInput."""
    state = given["state"]
    if given["name"] != type(game).__name__ or not isinstance(state, dict) or state.keys() != vars(game).keys():
        raise BadInput("its game is another one")
    known = vars(sys.modules[type(game).__module__])
    classes = {name: kind for name, kind in known.items() if isinstance(kind, type) and dataclasses.is_dataclass(kind)}
    return {name: decoded(value, classes) for name, value in state.items()}
