"""What options of the command line may be: each takes a text, and raises ArgumentTypeError with a clear line."""

from __future__ import annotations

import argparse


def size(text: str) -> tuple[int, int]:
    """WIDTHxHEIGHT [px]."""
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal() and 16 <= int(width) <= 16384 and 16 <= int(height) <= 16384):
        raise argparse.ArgumentTypeError(f"{text!r} is not WIDTHxHEIGHT, each 16 to 16384")
    return int(width), int(height)


def positive(kind):
    """A number above zero."""

    def parse(text: str):
        try:
            value = kind(text)
        except ValueError:
            value = 0
        if not 0 < value < 1e9:
            raise argparse.ArgumentTypeError(f"{text!r} is not a positive number")
        return value

    return parse


def share(text: str) -> float:
    """A factor of a picture's side."""
    value = positive(float)(text)
    if not 0.1 <= value <= 2.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not between 0.1 and 2")
    return value


def elevation(text: str) -> float:
    """Degrees above the horizon."""
    try:
        value = float(text)
    except ValueError:
        value = 90.0
    if not -89.0 <= value <= 89.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not an angle between -89 and 89 degrees")
    return value
