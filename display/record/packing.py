"""Values of a frame as a layout and numbers: hands, with whatever fields they have, fit into flat arrays.

A layout is JSON. "f", "i", "b": a float, an integer, a truth value (a number each); "n": None (no number);
["t", n, L] and ["t", L, L, ...]: a tuple of n values of layout L, or of several; ["a", type, shape]: an array;
["s", text]; {"c": name, "f": {field: L}}: an instance of a data class of scenes/scene.py.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from core.errors import BadInput
from scenes import scene

CLASSES = {c.__name__: c for c in vars(scene).values() if dataclasses.is_dataclass(c)}
TYPES = ("float64", "float32", "int64", "int32", "uint8", "bool")
DEEPEST, MOST = 8, 100_000  # levels of a layout, numbers of a value
TEXT = 200  # characters


def pack(value) -> tuple[object, list[float]]:
    """The layout of a value, and its numbers. TypeError for what has none."""
    if value is None:
        return "n", []
    if isinstance(value, (bool, np.bool_)):
        return "b", [float(value)]
    if isinstance(value, (int, np.integer)):
        return "i", [float(value)]
    if isinstance(value, (float, np.floating)):
        return "f", [float(value)]
    if isinstance(value, str):
        return ["s", value[:TEXT]], []
    if isinstance(value, np.ndarray) and value.dtype.name in TYPES:
        return ["a", value.dtype.name, list(value.shape)], value.astype(np.float64).ravel().tolist()
    if isinstance(value, (tuple, list)):
        packed = [pack(v) for v in value]
        layouts, numbers = [p[0] for p in packed], [x for p in packed for x in p[1]]
        same = bool(layouts) and all(layout == layouts[0] for layout in layouts)
        return ["t", len(layouts), layouts[0]] if same else ["t", *layouts], numbers
    if type(value).__name__ in CLASSES:
        fields = {f.name: pack(getattr(value, f.name)) for f in dataclasses.fields(value)}
        layout = {"c": type(value).__name__, "f": {name: p[0] for name, p in fields.items()}}
        return layout, [x for p in fields.values() for x in p[1]]
    raise TypeError(f"a {type(value).__name__} cannot be recorded")


def size_of(layout, depth: int = 0) -> int:
    """How many numbers a layout needs. BadInput for one that is none."""
    if depth > DEEPEST:
        raise BadInput("a layout is too deep")
    if layout in ("f", "i", "b"):
        return 1
    size = 0
    if isinstance(layout, list) and layout[:1] == ["t"]:
        many = len(layout) == 3 and type(layout[1]) is int
        if many and not 0 <= layout[1] <= MOST:
            raise BadInput("a layout is too long")
        size = layout[1] * size_of(layout[2], depth + 1) if many else sum(size_of(x, depth + 1) for x in layout[1:])
    elif isinstance(layout, list) and layout[:1] == ["a"] and len(layout) == 3 and _is_shape(layout[2]):
        size = math.prod(layout[2])
    elif isinstance(layout, dict) and isinstance(layout.get("f"), dict):
        size = sum(size_of(x, depth + 1) for x in layout["f"].values())
    if size > MOST:
        raise BadInput("a layout is too long")
    return size


def unpack(layout, numbers: np.ndarray):
    """The value again. BadInput for a layout that is none, or that does not fit the numbers."""
    value, used = _unpack(layout, np.asarray(numbers, np.float64), 0, 0)
    if used != len(numbers):
        raise BadInput(f"{len(numbers) - used} numbers too many")
    return value


def _unpack(layout, numbers: np.ndarray, at: int, depth: int):
    """(value, where the next one begins)."""
    if depth > DEEPEST:
        raise BadInput("a layout is too deep")
    if layout == "n":
        return None, at
    if layout in ("f", "i", "b"):
        if at >= len(numbers):
            raise BadInput("numbers are missing")
        x = float(numbers[at])
        return (x if layout == "f" else bool(x) if layout == "b" else int(x)), at + 1
    if isinstance(layout, list) and layout:
        kind, *rest = layout
        if kind == "s" and len(rest) == 1 and isinstance(rest[0], str):
            return rest[0], at
        if kind == "a" and len(rest) == 2 and rest[0] in TYPES and _is_shape(rest[1]):
            n = math.prod(rest[1])
            if at + n > len(numbers):
                raise BadInput("numbers are missing")
            return numbers[at : at + n].astype(rest[0]).reshape(rest[1]), at + n
        if kind == "t":
            if len(rest) == 2 and isinstance(rest[0], int) and not isinstance(rest[0], bool):
                if not 0 <= rest[0] <= MOST:
                    raise BadInput("a layout is too long")
                rest = [rest[1]] * rest[0]
            values = []
            for inner in rest:
                value, at = _unpack(inner, numbers, at, depth + 1)
                values.append(value)
            return tuple(values), at
    if isinstance(layout, dict) and set(layout) == {"c", "f"} and isinstance(layout["f"], dict):
        return _instance(layout, numbers, at, depth)
    raise BadInput(f"{str(layout)[:60]!r} is no layout")


def _is_shape(shape) -> bool:
    good = isinstance(shape, list) and len(shape) <= 4
    return good and all(type(n) is int and 0 <= n <= MOST for n in shape) and math.prod(shape) <= MOST


def _instance(layout: dict, numbers: np.ndarray, at: int, depth: int):
    kind = CLASSES.get(layout["c"]) if isinstance(layout["c"], str) else None
    if kind is None:
        raise BadInput(f"{str(layout['c'])[:60]!r} is nothing that a hand has")
    known, values = {f.name for f in dataclasses.fields(kind)}, {}
    for name, inner in layout["f"].items():
        if name not in known:
            raise BadInput(f"a {layout['c']} has no {name[:60]!r} in this version")
        values[name], at = _unpack(inner, numbers, at, depth + 1)
    try:
        return kind(**values), at
    except TypeError as e:
        raise BadInput(f"a {layout['c']} is incomplete") from e
