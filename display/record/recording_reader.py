"""Reader of recordings (display/record/recording.py), which are untrusted: everything is checked before it is used."""

from __future__ import annotations

import json

import numpy as np

from assets.hdf5 import Hdf5Reader
from core.camera import Camera
from core.errors import BadInput
from display.protocol import Frame
from display.record.codec import from_text, hand_size, touch_count, unpack_hand
from display.record.recording import CAMERA_SIZE, OPTIONS
from display.user_commands import Command
from render import SORTS

MAX_FRAME_DT = 10.0  # [s]
HANDS_MAX, CAMERAS_MAX, SIDE_MAX = 16, 2, 16384  # of a frame; [px]
CHOICES = {
    "arch": ("cpu", "cuda"),
    "interaction": ("physics", "transform"),
    "embedding": ("two-level", "one-level"),
    "sort": SORTS,
    "cells": ("adaptive", "uniform"),
    "detail": ("shipped", "paper"),
    "up": ("+x", "-x", "+y", "-y", "+z", "-z"),
}
KINDS = {"seed": (int,), "vertices": (int, list), "scale": (int, float), "pieces": (bool,)}  # the others are texts
KINDS |= {"body": (str, list), "options": (dict,)}
BODIES_MAX = 64


def checked_about(text: str) -> dict:
    """Attribute `about` of the recording: only known entries, of the right type."""
    try:
        about = json.loads(text)
    except (ValueError, RecursionError) as e:
        raise BadInput("what it says of itself is no JSON") from e
    if not isinstance(about, dict) or not isinstance(about.get("scene"), str):
        raise BadInput("it does not say which scene was played")
    for key in OPTIONS:
        value, kinds = about.get(key), KINDS.get(key, (str,))
        if value is not None and (type(value) not in kinds or len(str(value)) > 4096):
            raise BadInput(f"its {key} cannot be {str(value)[:60]!r}")
    world = about.get("world", {})
    if not isinstance(world, dict) or not all(isinstance(v, (bool, str)) for v in world.values()):
        raise BadInput("the options of its world make no sense")
    for key, choices in CHOICES.items():
        if any(value not in (None, *choices) for value in (about.get(key), world.get(key))):
            raise BadInput(f"its {key} is none that there is")
    vertices, bodies, own = about.get("vertices"), about.get("body"), about.get("options") or {}
    if isinstance(bodies, list) and not (len(bodies) <= BODIES_MAX and all(type(b) is str for b in bodies)):
        raise BadInput(f"its body cannot be {str(bodies)[:60]!r}")
    each = vertices if isinstance(vertices, list) else []
    if not all(type(v) is int for v in each):
        raise BadInput(f"its vertices cannot be {str(vertices)[:60]!r}")
    if not all(isinstance(key, str) and isinstance(value, (bool, int, float, str)) for key, value in own.items()):
        raise BadInput("the options of its scene make no sense")
    numbers = [v for v in (*(each or [vertices]), about.get("scale")) if v is not None]
    if not all(0 < value < 1e9 for value in numbers):
        raise BadInput("its vertices or its scale cannot be")
    return about


def finite(
    file: Hdf5Reader, name: str, shape: tuple = (None,), *, low: float = -np.inf, high: float = np.inf
) -> np.ndarray:
    """A dataset of floats within bounds."""
    values = file.array(name, "f", shape).astype(np.float64)
    with np.errstate(invalid="ignore"):
        if not (np.isfinite(values) & (values >= low) & (values <= high)).all():
            raise file.error(f"{name} holds values that cannot be")
    return values


def counts(file: Hdf5Reader, name: str, most: int, length: int | None = None) -> np.ndarray:
    """A dataset of counts, 0 to `most`."""
    values = file.array(name, "iu", (length,)).astype(np.int64)
    if len(values) and (values.min() < 0 or values.max() > most):
        raise file.error(f"{name} holds values that cannot be")
    return values


def read_frames(file: Hdf5Reader) -> list[Frame]:
    """All frames, checked."""
    dt = finite(file, "frames/dt", low=0.0, high=MAX_FRAME_DT)
    count = len(dt)
    time = finite(file, "frames/time", (count,), low=0.0)
    step = finite(file, "frames/step", (count,), low=0.0, high=MAX_FRAME_DT)
    hands = read_hands(file, counts(file, "frames/hands", HANDS_MAX, count))
    cameras = read_cameras(file, counts(file, "frames/cameras", CAMERAS_MAX, count))
    commands = read_commands(file, count)
    return [
        Frame(float(dt[k]), float(time[k]), cameras[k], hands[k], commands.get(k, []), max_step=float(step[k]) or None)
        for k in range(count)
    ]


def read_hands(file: Hdf5Reader, per_frame: np.ndarray) -> list[list]:
    """The hands of each frame."""
    try:
        layouts = json.loads(file.text("", "layouts"))
    except (ValueError, RecursionError) as e:
        raise file.error("its layouts are no JSON") from e
    if not isinstance(layouts, list):
        raise file.error("its layouts are no list")
    which = counts(file, "hands/layout", max(len(layouts) - 1, 0), int(per_frame.sum()))
    if len(which) and not layouts:
        raise file.error("its layouts are missing")
    numbers = finite(file, "hands/numbers")
    touches = [touch_count(layout) for layout in layouts]
    sizes = [hand_size(n) for n in touches]
    if sum(sizes[k] for k in which) != len(numbers):
        raise file.error("hands/numbers is not as long as the hands need")
    all_hands, first = [], 0
    for k in which:
        all_hands.append(unpack_hand(touches[k], numbers[first : first + sizes[k]]))
        first += sizes[k]
    ends = np.cumsum(per_frame)
    return [all_hands[end - n : end] for end, n in zip(ends, per_frame, strict=True)]


def read_cameras(file: Hdf5Reader, per_frame: np.ndarray) -> list[list[Camera]]:
    """The cameras of each frame."""
    values = finite(file, "cameras/values", (int(per_frame.sum()), CAMERA_SIZE), low=-1e9, high=1e9)
    sides, focal = values[:, :2], values[:, 2:4]
    if len(values) and not (sides.min() >= 1 and sides.max() <= SIDE_MAX and focal.min() > 0):
        raise file.error("cameras/values holds a camera that cannot be")
    cameras = [Camera(int(v[0]), int(v[1]), *v[2:6].tolist(), v[6:].reshape(4, 4)) for v in values]
    ends = np.cumsum(per_frame)
    return [cameras[end - n : end] for end, n in zip(ends, per_frame, strict=True)]


def read_commands(file: Hdf5Reader, count: int) -> dict[int, list[Command]]:
    """The commands of the frames that have some."""
    commands = {}
    text = file.array("commands/text", "iu", (None,)).astype(np.uint8).tobytes()
    try:
        lines = text.decode().splitlines()
    except UnicodeDecodeError as e:
        raise file.error("commands/text is no text") from e
    for line in lines:
        frame, given = from_text(line)
        if not 0 <= frame < count:
            raise file.error("commands/text names a frame that there is not")
        commands[frame] = given
    return commands


def read_states(file: Hdf5Reader, frames: int) -> dict[int, np.ndarray]:
    """Centroids (B, 3) of the bodies, by the frame after which they were recorded."""
    where = counts(file, "states/frame", max(frames - 1, 0))
    per_state = counts(file, "states/count", 1_000_000, len(where))
    centroids = file.array("states/centroids", "f", (int(per_state.sum()), 3)).astype(np.float64)
    ends = np.cumsum(per_state)
    return {int(k): centroids[end - n : end] for k, end, n in zip(where, ends, per_state, strict=True)}
