"""Edits of the selected body by a key or a button: each by a fixed step."""

from __future__ import annotations

import numpy as np

from display import user_commands
from display.user_commands import Command

SCALE_STEP = 1.25
TURN_STEP = np.pi / 12  # [rad]
ROOM_STEP = np.radians(3.0)  # of a whole room: it leans a little more often than it lies on its side


def rotation_step(axis=(0.0, 1.0, 0.0), sign: float = 1.0, *, step: float = TURN_STEP) -> tuple[float, ...]:
    """Quaternion wxyz of a step about a unit axis (3,), the vertical one unless told otherwise."""
    half = sign * step / 2
    return (float(np.cos(half)), *(np.sin(half) * np.asarray(axis)).tolist())


EDITS: dict[str, Command] = {  # by the names of the panels' buttons, of the selected body
    "undo": user_commands.Undo(),
    "redo": user_commands.Redo(),
    "copy": user_commands.Duplicate(),
    "remove": user_commands.Remove(),
    "smaller": user_commands.Rescale(None, 1 / SCALE_STEP),
    "larger": user_commands.Rescale(None, SCALE_STEP),
    "turn": user_commands.Rotate(None, rotation_step(sign=-1.0)),
    "turn room": user_commands.TurnRoom(rotation_step(sign=-1.0, step=ROOM_STEP)),
    "turn room back": user_commands.TurnRoom(rotation_step(step=ROOM_STEP)),
    "turn back": user_commands.Rotate(None, rotation_step()),
}
