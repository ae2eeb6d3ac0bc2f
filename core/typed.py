"""The codec for typed data that crosses a border: plain data (JSON) into dataclasses by their annotations, and back.

    @dataclass(frozen=True)
    class Lamp:
        name: Annotated[str, Size(40, least=1)]
        position: tuple[float, float, float]
        strength: Annotated[float, Range(0, 1)] = 0.5
        turn: Annotated[np.ndarray, Shape(3, 3)] | None = None

    lamp = from_json(Lamp, text, "lamp.json")  # BadInput: lamp.json: strength is 3, not a number from 0 to 1
    text = to_json(lamp)

Plain data is untrusted. A type is a dataclass (an object with its fields; those with a default may be missing, others
than its fields may not be there), `tuple[A, B]` or `tuple[A, ...]`, `list[A]`, `dict[str, A]`, `Literal`, a union,
`np.ndarray` with a Shape, `bool`, `int` (1.0 is one, too), `float`, `str`, `None`, or `Any`. Numbers must be finite;
texts and lists without a Size have at most TEXT_MAX characters and ITEMS_MAX items. What no annotation can say, a
dataclass checks in `__post_init__`, by raising ValueError. Where JSON has a list of the values of a message instead of
an object, its type is a tuple: `from_plain(tuple[Fraction, Fraction], values, "move")`.
"""

from __future__ import annotations

import dataclasses
import json
import math
import re
import sys
from contextlib import suppress
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from core.errors import BadInput

TEXT_MAX = 200  # [characters]
ITEMS_MAX = 100_000
SHOWN_MAX = 60  # [characters] of a wrong value in an error
T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class Range:
    """Bounds of a number, or of all numbers of an array; both are allowed."""

    low: float
    high: float

    def __str__(self) -> str:
        return "" if self is FINITE else f" from {self.low:g} to {self.high:g}"


FINITE = Range(-sys.float_info.max, sys.float_info.max)


@dataclasses.dataclass(frozen=True)
class Size:
    """Bounds of the number of characters or items."""

    most: int
    least: int = 0


@dataclasses.dataclass(frozen=True)
class Form:
    """Regular expression that a whole text matches, and what such a text is called."""

    pattern: str
    name: str


class Shape:
    """Shape of an array of numbers, float64; None stands for any length."""

    def __init__(self, *sides: int | None):
        self.sides = sides


def from_json(kind: type[T], text: str | bytes, where: str) -> T:
    """The value of this type that a JSON text holds. Raises BadInput that names `where`, the key and the defect."""
    try:
        plain = json.loads(text)
    except (ValueError, RecursionError) as e:
        raise BadInput(f"{where}: not JSON ({' '.join(str(e).split())[:SHOWN_MAX]})") from e
    return from_plain(kind, plain, where)


def from_plain(kind: type[T], plain: Any, where: str) -> T:
    """The value of this type that plain data holds. Raises BadInput that names `where`, the key and the defect."""
    try:
        return _read(kind, plain, "")
    except ValueError as e:
        raise BadInput(f"{where}: {e}") from e


def to_json(value: Any, *, indent: int | None = None) -> str:
    """A value as JSON text."""
    return json.dumps(to_plain(value), indent=indent, ensure_ascii=False)


def to_plain(value: Any) -> Any:
    """A value as plain data: a dataclass as an object of its fields, without those that are None by default.

    NumPy scalars and arrays become numbers and lists, NaN and infinity null.
    """
    if dataclasses.is_dataclass(value):
        fields = [(f, getattr(value, f.name)) for f in dataclasses.fields(value)]
        return {f.name: to_plain(v) for f, v in fields if not (v is None and f.default is None)}
    if isinstance(value, dict):
        return {key: to_plain(v) for key, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [to_plain(v) for v in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return to_plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value


@cache
def field_types(kind: type) -> dict[str, Any]:
    """Types of a dataclass's fields, with their bounds."""
    hints = get_type_hints(kind, include_extras=True)
    return {f.name: hints[f.name] for f in dataclasses.fields(kind)}


def _read(kind: Any, value: Any, path: str) -> Any:
    """The value of this type. Raises ValueError that names the key at `path`."""
    bounds = ()
    if get_origin(kind) is Annotated:
        kind, *bounds = get_args(kind)
    origin = get_origin(kind)
    if kind is Any:
        return value
    if origin in (Union, UnionType):
        return _one_of(get_args(kind), value, path)
    if origin is Literal:
        if any(value is choice or (isinstance(value, str) and value == choice) for choice in get_args(kind)):
            return value
        raise _wrong(path, value, f"one of {', '.join(map(str, get_args(kind)))}")
    if dataclasses.is_dataclass(kind):
        return _object(kind, value, path)
    if kind is np.ndarray:
        return _array(bounds, value, path)
    if kind in (int, float):
        return _number(kind, bounds, value, path)
    if kind is str:
        return _text(bounds, value, path)
    if origin in (tuple, list, dict):
        return _items(origin, get_args(kind), bounds, value, path)
    if kind in (bool, None, NoneType):
        if isinstance(value, NoneType if kind is None else kind):
            return value
        raise _wrong(path, value, "true or false" if kind is bool else "null")
    raise TypeError(f"typed data cannot be {kind}")


def _one_of(kinds: tuple, value: Any, path: str) -> Any:
    """The value of the first of these types that it fits."""
    if value is None and NoneType in kinds:
        return None
    *others, last = (kind for kind in kinds if kind is not NoneType)
    for kind in others:
        with suppress(ValueError):
            return _read(kind, value, path)
    return _read(last, value, path)


def _object(kind: type, value: Any, path: str) -> Any:
    types = field_types(kind)
    if not isinstance(value, dict):
        raise _wrong(path, value, f"an object with {', '.join(types)}")
    for key in value:
        if key not in types:
            raise ValueError(f"{_below(path, str(key)[:SHOWN_MAX])} is unknown")
    for f in dataclasses.fields(kind):
        if f.name not in value and f.default is f.default_factory is dataclasses.MISSING:
            raise ValueError(f"{_below(path, f.name)} is missing")
    made = {key: _read(types[key], v, _below(path, key)) for key, v in value.items()}
    try:
        return kind(**made)
    except ValueError as e:
        raise ValueError(f"{path}: {e}" if path else str(e)) from e


def _items(origin: type, kinds: tuple, bounds: tuple, value: Any, path: str) -> Any:
    size = _bound(Size, bounds) or Size(ITEMS_MAX)
    if not isinstance(value, dict if origin is dict else list):
        raise _wrong(path, value, "an object" if origin is dict else "a list")
    if origin is dict:
        items = {_read(kinds[0], key, path): _read(kinds[1], v, _below(path, str(key))) for key, v in value.items()}
    elif origin is list or kinds[1:] == (Ellipsis,):
        items = origin(_read(kinds[0], v, f"{path}[{k}]") for k, v in enumerate(value[: size.most + 1]))
    else:
        size = Size(len(kinds), least=len(kinds))
        items = tuple(_read(k, v, f"{path}[{i}]") for i, (k, v) in enumerate(zip(kinds, value, strict=False)))
    if not size.least <= len(value) <= size.most:
        span = f"{size.least}" if size.least == size.most else f"{size.least} to {size.most}"
        raise _wrong(path, value, f"a list of {span}")
    return items


def _number(kind: type, bounds: tuple, value: Any, path: str) -> int | float:
    span = _bound(Range, bounds) or FINITE
    fits = type(value) is int or (type(value) is float and (kind is float or value.is_integer()))
    if not fits or not span.low <= value <= span.high:  # NaN compares false
        raise _wrong(path, value, f"a {'whole ' if kind is int else ''}number{span}")
    return kind(value)


def _text(bounds: tuple, value: Any, path: str) -> str:
    size, form = _bound(Size, bounds) or Size(TEXT_MAX), _bound(Form, bounds)
    if not isinstance(value, str) or not size.least <= len(value) <= size.most:
        raise _wrong(path, value, f"a text of {size.least} to {size.most} characters")
    if form and not re.fullmatch(form.pattern, value):
        raise _wrong(path, value, form.name)
    return value


def _array(bounds: tuple, value: Any, path: str) -> np.ndarray:
    sides, span = _bound(Shape, bounds).sides, _bound(Range, bounds) or FINITE
    expected = f"{'x'.join('N' if side is None else str(side) for side in sides)} finite numbers{span}"
    try:
        items = np.array(value, object)
    except ValueError as e:
        raise _wrong(path, value, expected) from e
    fits = len(items.shape) == len(sides) and all(s in (None, n) for s, n in zip(sides, items.shape, strict=True))
    if not fits or not all(type(x) in (int, float) and span.low <= x <= span.high for x in items.flat):
        raise _wrong(path, value, expected)
    return items.astype(np.float64)


def _bound(kind: type, bounds: tuple) -> Any:
    return next((b for b in bounds if isinstance(b, kind)), None)


def _below(path: str, key: str) -> str:
    return f"{path}.{key}" if path else key


def _wrong(path: str, value: Any, expected: str) -> ValueError:
    shown = repr(value)
    shown = shown if len(shown) <= SHOWN_MAX else f"{shown[:SHOWN_MAX]}…"
    return ValueError(f"{path or 'it'} is {shown}, not {expected}")
