"""Options that several commands share, and the types of options: each takes a text and raises ArgumentTypeError."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable
from pathlib import Path

from assets.file_access import PICTURES
from render import SORTS
from scenes.registry import SceneOption

SPLATS = ".ply, .splat, .ksplat, .spz, .sog, meta.json, a mesh (.obj, .glb, .stl, .ply with faces)"
BACKGROUND_NAMES = {"grey": (0.12, 0.13, 0.14), "black": (0.0, 0.0, 0.0), "white": (1.0, 1.0, 1.0)}
AXES = ("+x", "-x", "+y", "-y", "+z", "-z")


def size(text: str) -> tuple[int, int]:
    """WIDTHxHEIGHT [px]."""
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal() and 16 <= int(width) <= 16384 and 16 <= int(height) <= 16384):
        raise argparse.ArgumentTypeError(f"{text!r} is not WIDTHxHEIGHT, each 16 to 16384")
    return int(width), int(height)


def port(text: str) -> int:
    """Number of a TCP port; 0: any that suits."""
    if not (text.isdecimal() and int(text) <= 65535):
        raise argparse.ArgumentTypeError(f"{text!r} is not a port, 0 to 65535")
    return int(text)


def positive(kind: type) -> Callable[[str], float]:
    """The type of numbers of a kind, int or float, above zero."""

    def parse(text: str):
        try:
            value = kind(text)
        except ValueError:
            value = 0
        if not 0 < value < 1e9:
            raise argparse.ArgumentTypeError(f"{text!r} is not a positive number")
        return value

    return parse


def render_scale(text: str) -> float:
    """A factor of a picture's width and height."""
    value = positive(float)(text)
    if not 0.1 <= value <= 2.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not between 0.1 and 2")
    return value


def colour(text: str) -> tuple[float, float, float]:
    """A colour by name, or as #rrggbb; each channel 0..1."""
    if text in BACKGROUND_NAMES:
        return BACKGROUND_NAMES[text]
    if re.fullmatch(r"#[0-9a-fA-F]{6}", text) is None:
        raise argparse.ArgumentTypeError(f"{text!r} is none of {', '.join(BACKGROUND_NAMES)}, nor like #8090a0")
    return tuple(int(text[k : k + 2], 16) / 255 for k in (1, 3, 5))


def elevation(text: str) -> float:
    """An angle above the horizon [degrees]."""
    try:
        value = float(text)
    except ValueError:
        value = 90.0
    if not -89.0 <= value <= 89.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not an angle between -89 and 89 degrees")
    return value


def degrees(text: str) -> float:
    """An angle of at most one turn [degrees]."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not -360.0 <= value <= 360.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not an angle between -360 and 360 degrees")
    return value


def picture_name(text: str) -> Path:
    """The name of a picture's file."""
    if Path(text).suffix.lower() not in PICTURES:
        raise argparse.ArgumentTypeError(f"{text!r} does not end in {', '.join(PICTURES[:-1])} or {PICTURES[-1]}")
    return Path(text)


def add_arch(parser: argparse.ArgumentParser) -> None:
    """Add --arch."""
    text = "where kernels run; unset: CUDA if there is one, else the CPU"
    parser.add_argument("--arch", choices=("cuda", "cpu"), help=text)


def add_sort(parser: argparse.ArgumentParser, mode: str) -> None:
    """Add --sort; `mode`: the default for splats that do not know theirs."""
    text = "order of Gaussians: by depth, by distance, or by distance along each pixel's ray (default: what they were"
    parser.add_argument("--sort", choices=SORTS, help=f"{text} trained for, z for files from elsewhere; else {mode})")


def add_preparation(parser: argparse.ArgumentParser, prefix: str = "") -> None:
    """Add the options of making a body of a splat; `prefix` opens their help where they belong to another option."""
    parser.add_argument("--up", choices=AXES, help=f"{prefix}the file's up axis (default: guessed)")
    text = f"{prefix}largest extent in metres (default: guessed)"
    parser.add_argument("--scale", type=positive(float), metavar="M", help=text)
    text = f"{prefix}turn about the vertical that brings the front to the player (default: guessed; 0: as in the file)"
    parser.add_argument("--front", type=degrees, metavar="DEG", help=text)
    text = f"{prefix}cage vertices (default: as suits the device, 500 on a CPU, 2000 on a GPU)"
    parser.add_argument("--vertices", type=positive(int), metavar="N", help=text)
    text = f"{prefix}cells of the cage: smaller where the body is thin or curved, or all alike (default adaptive)"
    parser.add_argument("--cells", choices=("adaptive", "uniform"), help=text, default="adaptive")
    text = f"{prefix}separate pieces each get a cage and become bodies of their own (default: the largest alone)"
    parser.add_argument("--pieces", action="store_true", help=text)


def add_scene_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of all scenes, each once; their values become `options`, a dict by the parameter's name."""
    from scenes import registry

    parser.set_defaults(options=None)
    takers: dict[str, list[tuple[str, SceneOption]]] = {}
    for demo in registry.demos():
        for option in demo.options:
            takers.setdefault(option.name, []).append((demo.name, option))
    group = parser.add_argument_group("options of scenes")
    for name, uses in takers.items():
        says = "; ".join(f"{scene}: {option.choice_text}" for scene, option in uses)
        try:
            group.add_argument(uses[0][1].flag, dest=name, action=SetSceneOption, metavar="X", help=says)
        except argparse.ArgumentError:
            scenes = ", ".join(scene for scene, _ in uses)
            print(f"vrgs: {scenes}: {uses[0][1].flag} means something else already: rename it", file=sys.stderr)


def add_scene_file_options(parser: argparse.ArgumentParser, scene_file: str) -> None:
    """Add the options of a scene file, which is run; one that other scenes have as well is there already."""
    from scenes import registry

    found = registry.demo(scene_file)
    for option in () if found is None else found.options:
        if option.flag not in parser._option_string_actions:
            kept = {"dest": option.name, "action": SetSceneOption, "metavar": "X", "help": option.choice_text}
            parser.add_argument(option.flag, **kept)


class SetSceneOption(argparse.Action):
    """Keep the text of a scene's option in the dict `options`."""

    def __call__(self, parser, namespace, values, option_string=None):
        namespace.options = {**(namespace.options or {}), self.dest: values}
