"""Typed options of the commands: one dataclass for each, from which its parser, its help and its checks follow.

    @dataclass(kw_only=True)
    class FilmOptions(Options):
        splats: Path = argument("SPLATS", "file to draw")
        out: Path = option("OUT.mp4", "film to write", REQUIRED)
        frames: Count | None = option("N", "number of pictures (default 180)")
        antialias: bool = switch("anti-aliased rendering")

A field's name is its flag, its annotation the type: `Literal` gives choices, `list[...]` takes several values, and
`Annotated[..., function]` names the function that turns a text into the value. Fields with a plain default are set by
the program alone.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from dataclasses import MISSING, Field, dataclass, field, fields
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Literal, Union, get_args, get_origin, get_type_hints

from assets.file_access import PICTURES
from core.errors import BadInput

REQUIRED = MISSING  # default of an option that must be given
SPLATS = ".ply, .splat, .ksplat, .spz, .sog, meta.json, .glb, a mesh (.obj, .glb, .stl, .ply with faces)"
CAPTURES = "folder with transforms.json, transforms_train.json, a COLMAP model, or of Polycam or Record3D"
GREY = (0.12, 0.13, 0.14)
BACKGROUND_NAMES = {"grey": GREY, "black": (0.0, 0.0, 0.0), "white": (1.0, 1.0, 1.0)}


@dataclass(frozen=True)
class Condition:
    """A condition under which options act; one that would be ignored beside the others is refused.

    flags  of the options: "--size"
    holds  whether they act, by the command's options
    words  what is said of one that does not: "belongs to --turntable"
    """

    flags: tuple[str, ...]
    holds: Callable[[Any], object]
    words: str


@dataclass(kw_only=True)
class Options:
    """Options of a command. `given`: the flags that the command line names, in full."""

    EXAMPLES: ClassVar[tuple[str, ...]] = ()
    CONDITIONS: ClassVar[tuple[Condition, ...]] = ()

    given: tuple[str, ...] = ()

    def values_of(self, kind: type[Options]) -> dict[str, Any]:
        """Values of the fields of a base class."""
        return {f.name: getattr(self, f.name) for f in fields(kind)}

    def check(self) -> None:
        """Raise BadInput for a given option that does not act."""
        for condition in self.CONDITIONS:
            for flag in self.given:
                if flag in condition.flags and not condition.holds(self):
                    raise BadInput(f"{flag} {condition.words}")


@dataclass(frozen=True, eq=False)
class OneOf:
    """Options of which one at most is given, or exactly one where it is `required`."""

    required: bool = False


def argument(metavar: str | None, help: str, default: Any = REQUIRED) -> Any:
    """A value that is written without a flag."""
    return option(metavar, help, default, positional=True)


def option(
    metavar: str | tuple[str, ...] | None,
    help: str,
    default: Any = None,
    *,
    positional: bool = False,
    flag: str | None = None,
    one_of: OneOf | None = None,
    bare: int | str | None = None,
    repeat: bool = False,
) -> Any:
    """An option with a value, as a field of a command's dataclass; without a metavar its help names the choices.

    flag    where it is not the field's name
    bare    value of the option without a value, where it may have none
    repeat  it may be given several times, each with a value of a list
    """
    form = {"metavar": metavar, "help": help, "positional": positional, "flag": flag, "one_of": one_of}
    form |= {"bare": bare, "repeat": repeat}
    if isinstance(default, list):
        return field(default_factory=default.copy, metadata=form)
    return field(default=default, metadata=form)


def switch(help: str, *, one_of: OneOf | None = None) -> Any:
    """An option without a value: False unless it is given."""
    return option(None, help, False, one_of=one_of)


def add_options(parser: argparse.ArgumentParser, kind: type[Options]) -> None:
    """Add the options of a dataclass to a parser; those that are not given keep the dataclass's defaults."""
    hints, groups = get_type_hints(kind, include_extras=True), {}
    order = [name for part in kind.__mro__ for name in vars(part).get("__annotations__", ())]
    for f in sorted(fields(kind), key=lambda f: order.index(f.name)):  # a command's own before those that it shares
        if not f.metadata:
            continue
        form = {"help": f.metadata["help"], "default": argparse.SUPPRESS, **value_form(hints[f.name], f)}
        if f.metadata["positional"]:
            parser.add_argument(f.name, **form)
            continue
        one_of: OneOf | None = f.metadata["one_of"]
        if one_of is not None and one_of not in groups:
            groups[one_of] = parser.add_mutually_exclusive_group(required=one_of.required)
        needed = f.default is MISSING and f.default_factory is MISSING
        flag = f.metadata["flag"] or f"--{f.name.replace('_', '-')}"
        groups.get(one_of, parser).add_argument(flag, dest=f.name, required=needed, **form)


def value_form(hint: Any, f: Field) -> dict[str, Any]:
    """Arguments of `add_argument` that say which values a field of a type takes."""
    if hint is bool:
        return {"action": "store_true"}
    form: dict[str, Any] = {"metavar": f.metadata["metavar"]}
    if get_origin(hint) in (Union, UnionType):
        (hint,) = (part for part in get_args(hint) if part is not NoneType)
    if get_origin(hint) is list:
        (hint,) = get_args(hint)
        if f.metadata["repeat"]:
            form["action"] = "append"
            if get_origin(hint) is list:  # each of several values, as many as it names
                form["nargs"], (hint,) = len(f.metadata["metavar"]), get_args(hint)
        else:
            form["nargs"] = "*" if f.metadata["positional"] and f.default_factory is not MISSING else "+"
    elif get_origin(hint) is tuple:
        form["nargs"], hint = len(get_args(hint)), get_args(hint)[0]
    elif f.metadata["positional"] and f.default is None:
        form |= {"nargs": "?", "default": None}  # argparse would take the word SUPPRESS for a value
    if f.metadata["bare"] is not None:
        form |= {"nargs": "?", "const": f.metadata["bare"]}
    if get_origin(hint) is Annotated:
        form["type"] = get_args(hint)[1]
    elif get_origin(hint) is Literal:
        form["choices"], form["type"] = get_args(hint), type(get_args(hint)[0])
    else:
        form["type"] = hint
    return form


# types: each function turns a text into a value, or raises ArgumentTypeError


def size(text: str) -> tuple[int, int]:
    """WIDTHxHEIGHT [px]."""
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal() and 16 <= int(width) <= 16384 and 16 <= int(height) <= 16384):
        raise argparse.ArgumentTypeError(f"{text!r} is not WIDTHxHEIGHT, each 16 to 16384")
    return int(width), int(height)


def port(text: str) -> int:
    """Number of a TCP port; 0: any that is free."""
    if not (text.isdecimal() and int(text) <= 65535):
        raise argparse.ArgumentTypeError(f"{text!r} is not a port, 0 to 65535")
    return int(text)


def positive(kind: type) -> Callable[[str], float]:
    """The function for numbers of a kind, int or float, above zero."""

    def parse(text: str):
        try:
            value = kind(text)
        except ValueError:
            value = 0
        if value >= 1e9:
            raise argparse.ArgumentTypeError(f"{text!r} is too large: below 1e9")
        if not value > 0:
            what = "whole number" if kind is int else "number"
            raise argparse.ArgumentTypeError(f"{text!r} is not a positive {what}")
        return value

    return parse


def within(low: float, high: float, what: str) -> Callable[[str], float]:
    """The function for numbers from `low` to `high`; `what` says this in a message."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text!r} is not {what}")
        return value

    return parse


def share(text: str) -> float:
    """A whole number from 1 on, or a percentage below 100 as a share below 1."""
    number = text.removesuffix("%")
    try:
        value = float(number) / 100 if number != text else float(int(text))
    except ValueError:
        value = 0.0
    if not (0 < value < 1 if number != text else 1 <= value < 1e9):
        raise argparse.ArgumentTypeError(f"{text!r} is neither a positive whole number nor a percentage below 100%")
    return value


def colour(text: str) -> tuple[float, float, float]:
    """A colour by name, or as #rrggbb; each channel 0..1."""
    if text in BACKGROUND_NAMES:
        return BACKGROUND_NAMES[text]
    if re.fullmatch(r"#[0-9a-fA-F]{6}", text) is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a colour: {', '.join(BACKGROUND_NAMES)}, or as #8090a0")
    return tuple(int(text[k : k + 2], 16) / 255 for k in (1, 3, 5))


def picture_name(text: str) -> Path:
    """The name of a picture's file."""
    if Path(text).suffix.lower() not in PICTURES:
        raise argparse.ArgumentTypeError(f"{text!r} does not end in {', '.join(PICTURES[:-1])} or {PICTURES[-1]}")
    return Path(text)


Detail = Literal["shipped", "paper"]
Setting = Literal["physics", "transform"]
Arch = Literal["cuda", "cpu"]
Axis = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
Sort = Literal["z", "radial", "pixel"]  # render.SORTS; a test compares them
Count = Annotated[int, positive(int)]
Amount = Annotated[float, positive(float)]
Size = Annotated[tuple[int, int], size]
Port = Annotated[int, port]
Share = Annotated[float, share]
Colour = Annotated[tuple[float, float, float], colour]
PictureName = Annotated[Path, picture_name]
Elevation = Annotated[float, within(-89.0, 89.0, "an angle between -89 and 89 degrees")]
Turn = Annotated[float, within(-360.0, 360.0, "an angle between -360 and 360 degrees")]
RenderScale = Annotated[float, within(0.1, 2.0, "between 0.1 and 2")]

# fields that several commands share


def arch_option() -> Any:
    """--arch."""
    return option(None, "where kernels run (default: CUDA if there is a GPU, else the CPU)")


def seed_option() -> Any:
    """--seed."""
    return option("S", "seed of all random numbers (default 0)", 0)


def sort_option(mode: str) -> Any:
    """--sort; `mode`: the default for splats that do not know theirs."""
    text = "blending order: by depth, by distance, or by distance along each pixel's ray (default: as trained"
    return option(None, f"{text}, z for files from elsewhere; else {mode})")


def by_device(numbers: dict[str, int]) -> str:
    """A default that depends on the device, in words."""
    return f"{numbers['cuda']:,} on a GPU, {numbers['cpu']:,} on a CPU"


def reduce_option(what: str) -> Any:
    """--reduce."""
    return option("N", f"divide the width and height of {what} by N", 1)


@dataclass(kw_only=True)
class Preparation(Options):
    """Options of making a body of a splat file."""

    up: Axis | None = option(None, "up axis of the splat file (default: guessed)")
    scale: Amount | None = option("M", "largest extent of the splat in metres (default: guessed)")
    front: Turn | None = option("DEG", "turn about the vertical that brings its front to the player (default: guessed)")
    vertices: Annotated[int | list[int] | None, positive(int)] = option(
        "N", "vertices of a splat's cage (default: as suits the device, 500 on a CPU, 2000 on a GPU)"
    )
    cells: Literal["adaptive", "uniform"] = option(
        None, "cells of the cage: smaller where it is thin or curved, or all alike (default adaptive)", "adaptive"
    )
    pieces: bool = switch("make each separate piece a body with its own cage (default: only the largest)")
