"""Capacity of the device's fields, and flat arrays of what all bodies have (NumPy only)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from core.errors import BadInput

MAX_BODIES = 64  # per-body fields are tiny; one size for all scenes keeps compiled kernels in the cache


@dataclass(frozen=True)
class Sizes:
    """Numbers of elements (the fields' capacities are larger)."""

    vertices: int
    tets: int
    triangles: int
    bodies: int


@dataclass(frozen=True)
class Capacity:
    """Capacity of the solver's fields, which cannot grow: the first bodies `factor` times, and at least these totals.

    samples: points of contact; nodes: of the bodies' distance grids, each different one counted once. Kernels are
    compiled once, for what fits: contact among bodies, if more than one does; rigid bodies, if `rigid` or if there is
    one at first.
    """

    vertices: int = 0
    tets: int = 0
    triangles: int = 0
    samples: int = 0
    nodes: int = 0
    bodies: int = 0
    factor: float = 1.0
    rigid: bool = False

    @classmethod
    def of(cls, capacity: Capacity | float | None) -> Capacity:
        """Take a factor as a capacity for MAX_BODIES bodies, None as no more than the first bodies need."""
        if isinstance(capacity, Capacity):
            return capacity
        return cls() if capacity is None else cls(bodies=MAX_BODIES, factor=float(capacity))

    def sized(self, what: str, need: int) -> int:
        """Capacity for `what`, of which `need` are there at first."""
        return max(1, int(np.ceil(need * self.factor)), getattr(self, what))

    @property
    def grows(self) -> bool:
        """True if more may come than is there at first."""
        return self != Capacity()


class CapacityError(BadInput):
    """Raised where the fields are too small for what they should hold."""


def fit(what: str, need: int, capacity: int) -> None:
    """Raise CapacityError if `need` elements do not fit."""
    if need > capacity:
        raise CapacityError(f"no room for {need} {what}: the capacity is {capacity}")


def offsets(counts: list[int]) -> np.ndarray:
    """Begin of each run of `counts` elements, and the end of the last, (n+1,)."""
    return np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]).astype(np.int64)


def stacked(arrays: list[np.ndarray], width: int | None = None) -> np.ndarray:
    """Concatenate arrays (n, width) or (n,), also none."""
    return np.concatenate([np.zeros(0 if width is None else (0, width), int), *arrays])
