"""The panel's section of the world as a whole: gravity and slow motion."""

from __future__ import annotations

import numpy as np

from display import user_commands
from display.protocol import WorldView
from display.user_commands import MIN_TIME_SCALE, Command
from display.window.panel.section import Section
from display.window.panel.slider import Slider
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
        return self._sliders.draw(sliders(world))


def sliders(world: WorldView) -> list[Slider]:
    """Those of gravity and of the pace of time."""
    usual = np.array(world.scene.gravity)
    direction = usual / np.linalg.norm(usual) if usual.any() else np.array([0.0, -1.0, 0.0])
    strength, pace = float(np.linalg.norm(world.gravity)), world.time_scale
    return [
        Slider(
            "gravity",
            strength,
            0.0,
            GRAVITY_MAX,
            f"{strength:.2f} m/s\u00b2",
            lambda x, continued: user_commands.SetGravity(tuple((x * direction).tolist()), continued=continued),
            usual=float(np.linalg.norm(usual)),
            tip=f"{TIPS['gravity']} {RESET_TIP}",
        ),
        Slider(
            "time",
            pace,
            MIN_TIME_SCALE,
            1.0,
            "as it is" if pace == 1.0 else f"{pace:.2g} x",
            lambda x, continued: user_commands.SetTimeScale(x, continued=continued),
            usual=1.0,
            log=True,
            tip=f"{TIPS['time']} {RESET_TIP}",
        ),
    ]
