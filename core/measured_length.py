"""A scale from two points whose distance is known, and lengths as people write them."""

from __future__ import annotations

import re

import numpy as np

from core.errors import BadInput

LENGTH_RANGE = (1e-3, 1e3)  # [m] plausible measured lengths
UNITS = {"": 1.0, "m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}  # [m]


def scale_between(a, b, length: float) -> float:
    """Metres per unit of two points (3,) that are `length` [m] apart. Raises BadInput."""
    a, b = (np.asarray(p, np.float64) for p in (a, b))
    low, high = LENGTH_RANGE
    if not low <= length <= high:
        raise BadInput(f"a length of {length:g} m is out of range ({low:g} to {high:g})")
    apart = float(np.linalg.norm(b - a)) if a.shape == b.shape == (3,) else np.nan
    if not (np.isfinite(apart) and apart > 1e-9 * max(np.abs(a).max(), np.abs(b).max(), 1e-9)):
        raise BadInput("the two points of a measured length must be different, and finite")
    return length / apart


def length_of(text: str) -> float:
    """Length [m] of a text: "1.2", "1,2 m", "35 cm". Raises BadInput."""
    found = re.fullmatch(r"\s*(\d*[.,]?\d+|\d+[.,])\s*([a-z]*)\s*", text.lower())
    if found is None or found[2] not in UNITS:
        raise BadInput(f"{text.strip()!r} is not a length: type it as 1.2 or 35 cm")
    length = float(found[1].replace(",", ".")) * UNITS[found[2]]
    if not LENGTH_RANGE[0] <= length <= LENGTH_RANGE[1]:
        raise BadInput(f"a length of {length:g} m is out of range ({LENGTH_RANGE[0]:g} to {LENGTH_RANGE[1]:g})")
    return length
