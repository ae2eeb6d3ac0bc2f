"""Threads for work on large arrays, during which NumPy and SciPy let other threads run."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Item, Result = TypeVar("Item"), TypeVar("Result")


def in_threads(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """The function of each item, in the items' order, as many at a time as there are processor cores."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(function, items))


def batches(count: int, size: int) -> list[slice]:
    """Slices of `size` that cover `count` items; the last may be shorter. None for none."""
    return [slice(i, min(i + size, count)) for i in range(0, count, size)]
