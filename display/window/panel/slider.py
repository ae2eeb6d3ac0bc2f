"""A slider as data: what it shows and what it does, whoever draws it (widgets.py, or a page)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from display.user_commands import Command


@dataclass(frozen=True)
class Slider:
    """A slider of a `value` from `low` to `high`, which the user reads as `shown`.

    command  of a new value, and of whether it goes on with the last change: a drag is undone as one
    usual    value that the user can bring back
    log      equal ratios take equal ways
    """

    name: str
    value: float
    low: float
    high: float
    shown: str
    command: Callable[[float, bool], Command]
    usual: float | None = None
    log: bool = False
    tip: str = ""


def readable(value: float) -> float:
    """A value with as many digits as one reads."""
    return float(f"{value:.3g}")
