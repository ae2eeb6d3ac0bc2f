"""The group `animation` of an asset file.

| dataset | shape, type | |
| inverse_bind | (J, 4, 4) float64 | from the asset's frame to each joint's at rest |
| parents | (J,) int32 | each before its children, itself for none |
| rest_translations, rest_rotations, rest_scales | (J, 3), (J, 4), (J, 3) float32 | local; metres, wxyz |
| translations, rotations, scales | (F, J, 3), (F, J, 4), (F, J, 3) float32 | of each frame |
| vertices, joints, weights, driven | (S,), (S, 4) int32, (S, 4) float32, (S,) uint8 | the cage's surface |
| attributes `fps` [1/s], `names` | | of the joints, a JSON list |
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import TYPE_CHECKING

import h5py
import numpy as np

from assets.animation import JOINTS_MAX, JOINTS_PER_VERTEX, Animation

if TYPE_CHECKING:
    from assets.hdf5 import Hdf5Reader

KINDS = (("translations", 3), ("rotations", 4), ("scales", 3))


def write_animation(a: Animation, file: h5py.File, write: Callable) -> None:
    """Write the group; `write(file, name, values, dtype)` writes a dataset."""
    write(file, "animation/inverse_bind", a.inverse_bind, np.float64)
    root = np.arange(len(a.parents))  # its own parent: indices in files are not negative
    write(file, "animation/parents", np.where(a.parents < 0, root, a.parents), np.int32)
    for k, (kind, _) in enumerate(KINDS):
        write(file, f"animation/rest_{kind}", a.rest[k], np.float32)
        write(file, f"animation/{kind}", a.frames[k], np.float32)
    for name, dtype in (("vertices", np.int32), ("joints", np.int32), ("weights", np.float32), ("driven", np.uint8)):
        write(file, f"animation/{name}", getattr(a, name), dtype)
    file["animation"].attrs["fps"] = float(a.fps)
    file["animation"].attrs["names"] = json.dumps(a.names)


def read_animation(file: Hdf5Reader) -> Animation:
    """The group as it is stored; `check_animation` holds it against the cage. Raises BadInput."""

    def indices(name: str, shape: tuple) -> np.ndarray:
        values = file.array(f"animation/{name}", "iu", shape)
        if values.size and (values.min() < 0 or values.max() > np.iinfo(np.int32).max):
            raise file.bad(f"animation/{name} holds an index out of range")
        return values.astype(np.int32)

    def floats(name: str, shape: tuple) -> np.ndarray:
        with np.errstate(invalid="ignore"):  # a signalling NaN; the check refuses it
            return file.array(f"animation/{name}", "f", shape).astype(np.float64)

    try:
        names = json.loads(file.text("animation", "names"))
    except (ValueError, RecursionError) as e:
        raise file.bad("the joints' names are not JSON") from e
    if not isinstance(names, list) or len(names) > JOINTS_MAX or not all(isinstance(n, str) for n in names):
        raise file.bad(f"the joints' names are not a list of at most {JOINTS_MAX} texts")
    J = len(names)
    rest = tuple(floats(f"rest_{kind}", (J, width)) for kind, width in KINDS)
    moving = floats("translations", (None, J, 3))
    frames = (moving, *(floats(kind, (len(moving), J, width)) for kind, width in KINDS[1:]))
    parents = indices("parents", (J,))
    vertices = indices("vertices", (None,))
    S = len(vertices)
    return Animation(
        names,
        np.where(parents == np.arange(J), -1, parents).astype(np.int32),
        floats("inverse_bind", (J, 4, 4)),
        tuple(unit(x) if k == 1 else x for k, x in enumerate(rest)),
        tuple(unit(x) if k == 1 else x for k, x in enumerate(frames)),
        file.number("animation", "fps"),
        vertices,
        indices("joints", (S, JOINTS_PER_VERTEX)),
        floats("weights", (S, JOINTS_PER_VERTEX)).astype(np.float32),
        indices("driven", (S,)) != 0,
    )


def unit(q: np.ndarray) -> np.ndarray:
    """Quaternions (..., 4) that float32 has rounded, of length 1 again; others stay, and are refused."""
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(np.abs(norm - 1) < 1e-5, q / np.where(norm > 0, norm, 1.0), q)
