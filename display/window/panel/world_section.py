"""The panel's section of the world as a whole: gravity and slow motion."""

from __future__ import annotations

import numpy as np

from display import protocol
from display.protocol import MIN_TIME_SCALE, Command, WorldView
from display.window.panel.section import Section
from display.window.panel.widgets import Sliders

GRAVITY_MAX = 20.0  # [m/s^2] of the slider: twice the earth's
TIPS = {
    "gravity": "Moon 1.6, Mars 3.7, Earth 9.81, Jupiter 25.",
    "time": "Slow motion: how fast the world's time passes.",
}
RESET_TIP = "Ctrl+click types a value, a right click brings the usual one back."


class WorldSection(Section):
    """Gravity and the pace of time."""

    title = "World"
    open = False

    def __init__(self):
        self._sliders = Sliders()

    def shown(self, world: WorldView) -> bool:
        """True of worlds that are simulated."""
        return world.editable

    def draw(self, world: WorldView) -> list[Command]:
        """Draw both sliders; the commands of the one that is moved."""
        commands: list[Command] = []
        usual = np.array(world.scene.gravity)
        strength = float(np.linalg.norm(world.gravity))
        tip = f"{TIPS['gravity']} {RESET_TIP}"
        options = {"usual": float(np.linalg.norm(usual)), "tip": tip}
        moved = self._sliders.draw("gravity", strength, 0.0, GRAVITY_MAX, f"{strength:.2f} m/s\u00b2", **options)
        if moved is not None:
            direction = usual / np.linalg.norm(usual) if usual.any() else np.array([0.0, -1.0, 0.0])
            commands.append(protocol.SetGravity(tuple((moved[0] * direction).tolist()), continued=moved[1]))
        pace, tip = world.time_scale, f"{TIPS['time']} {RESET_TIP}"
        shown = "as it is" if pace == 1.0 else f"{pace:.2g} x"
        moved = self._sliders.draw("time", pace, MIN_TIME_SCALE, 1.0, shown, usual=1.0, log=True, tip=tip)
        return commands + ([] if moved is None else [protocol.SetTimeScale(moved[0], continued=moved[1])])
