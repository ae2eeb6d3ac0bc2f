"""Conditions of options: one that would be ignored beside the others is refused, in one line."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from core.errors import BadInput


@dataclass(frozen=True)
class Condition:
    """A condition under which options act.

    flags  of the options: "--size"
    holds  tells of a command's arguments whether they act
    words  what is said of one that does not: "belongs to --turntable"
    """

    flags: tuple[str, ...]
    holds: Callable[[argparse.Namespace], bool]
    words: str


def check_conditions(args: argparse.Namespace, given: Iterable[str], conditions: Iterable[Condition]) -> None:
    """Raise BadInput for one of the flags `given` that does not act."""
    given = tuple(given)
    for condition in conditions:
        for flag in given:
            if flag in condition.flags and not condition.holds(args):
                raise BadInput(f"{flag} {condition.words}")
