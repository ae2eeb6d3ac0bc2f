"""The file in which a user names where a person's joints are, and what is held."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from assets.file_access import open_input
from core.errors import BadInput
from prepare.rig.landmarks import NAMES, Held

FILE_MAX = 1 << 20  # [bytes] of a landmarks file


def read_landmarks(path: str | Path) -> dict:
    """The JSON object of a landmarks file, checked: {NAME: [x, y, z], ..., "held": [...], "joints": {...}}.

    Coordinates are metres in the prepared asset's frame. Raises BadInput.
    """
    path = Path(path)
    with open_input(path) as file:
        data = file.read(FILE_MAX + 1)
    if len(data) > FILE_MAX:
        raise BadInput(f"{path}: is larger than {FILE_MAX} bytes")
    try:
        found = json.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as e:
        raise BadInput(f"{path}: is not JSON") from e
    if not isinstance(found, dict):
        raise BadInput(f"{path}: is not a JSON object of landmarks")
    result: dict = {"joints": {}}
    for name, value in found.items():
        if name in NAMES:
            result[name] = vector(value, f"{path}: {name}")
        elif name == "held" and isinstance(value, list):
            result["held"] = [held(v, str(path)) for v in value]
        elif name == "joints" and isinstance(value, dict) and all(isinstance(v, str) for v in value.values()):
            result["joints"] = value
        else:
            raise BadInput(f"{path}: {name[:40]!r} is no landmark; there are {', '.join(NAMES)}, held and joints")
    return result


def vector(value, what: str) -> np.ndarray:
    """Three finite numbers, or BadInput."""
    good = isinstance(value, list) and len(value) == 3
    good = good and all(isinstance(v, (int, float)) and not isinstance(v, bool) and abs(v) < 1e6 for v in value)
    if not good:
        raise BadInput(f"{what} is not three coordinates in metres")
    return np.array(value, np.float64)


def held(value, where: str) -> Held:
    """One entry of `held`: {"by": NAME, "center": [x, y, z], "radius": r}."""
    by = value.get("by") if isinstance(value, dict) else None
    radius = value.get("radius") if isinstance(value, dict) else None
    if by not in NAMES or isinstance(radius, bool) or not isinstance(radius, (int, float)) or not 0 < radius < 1e6:
        raise BadInput(f'{where}: what is held is {{"by": LANDMARK, "center": [x, y, z], "radius": r}}')
    return Held(by, vector(value.get("center"), f"{where}: the center of what is held"), float(radius))
