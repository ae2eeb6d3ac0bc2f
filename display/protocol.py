"""What a display asks of the world for one frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from core.camera import Camera
from scenes.scene import Hand


@dataclass
class Frame:
    """Advance the world by `dt` [s] with these `hands`, then draw it for `cameras` (one an eye).

    `cameras` may be what gives them: it is called once the world has moved, and gives none where nothing is drawn.
    `time` [s] is the sum of all dt so far. `step` [s] is the longest that the world may go at once; without it dt is
    one step. `commands` are the user's wishes between two frames, see `World.apply`: {"reset": True}, {"light": Light},
    {"interaction": "physics"|"transform"}, {"pause": bool}, {"step": True}, {"demo": bool}; and of bodies, by index, or
    None for the one last held (display/edit/editor.py): {"undo": True}, {"redo": True}, {"select": index},
    {"duplicate": index}, {"remove": index}, {"rescale": (index, factor)}, {"rotate": (index, wxyz)},
    {"material": (index, name or Material)}. `parts` (P, 3, 4) are where the world's props are, see render/skinned_props.py;
    None: where they were.
    """

    dt: float
    time: float
    cameras: list[Camera] | Callable[[], list[Camera]]
    hands: list[Hand] = field(default_factory=list)
    commands: dict = field(default_factory=dict)
    step: float | None = None
    parts: np.ndarray | None = None
