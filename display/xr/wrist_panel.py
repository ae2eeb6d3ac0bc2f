"""The panel over the left hand: where it is, what is on it, what the right hand does with it. Pure, but for `world`.

It shows itself when the left palm turns to the face, or is kept there by a button. The right hand points at it and
pulls the trigger, or pushes a finger through it; then it takes hold of nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from display.protocol import Command, Pause, PlayDemo, Redo, Reset, Select, SetInteraction, SetLight, Undo
from display.window.controls import editing
from display.xr.actions import LET_GO, PRESS, Controller

PIXELS = (800, 512)
WIDTH = 0.28  # [m]
ABOVE = 0.14  # [m] of its middle over the hand
SHOWN, HIDDEN = 0.85, 0.6  # cosine of the angle between the palm and the way to the eyes
FARTHEST = 3.0  # [m] to point at it
FINGER = 0.09  # [m] that a controller's finger is longer than its grip: display/xr/finger_poke.py
DEEP, CLEAR = 0.06, 0.015  # [m] behind which a finger has passed by, before which it must come back to push again
INDEX_TIP, PALM = 10, 0  # joints of a tracked hand


@dataclass(frozen=True)
class Button:
    """A place to press: left, top, width and height [px]."""

    name: str
    text: str
    box: tuple[int, int, int, int]

    def holds(self, u: float, v: float) -> bool:
        x, y, w, h = self.box
        return x <= u < x + w and y <= v < y + h


def row(top: int, *names: tuple[str, str]) -> list[Button]:
    """Buttons side by side."""
    left, gap, height = 20, 12, 84
    width = (PIXELS[0] - 2 * left - gap * (len(names) - 1)) // len(names)
    return [Button(n, text, (left + k * (width + gap), top, width, height)) for k, (n, text) in enumerate(names)]


BUTTONS = [
    *row(116, ("physics", "Physics"), ("transform", "Transform")),
    *row(212, ("undo", "Undo"), ("redo", "Redo"), ("c", "Copy"), ("delete", "Remove")),
    *row(308, ("minus", "Smaller"), ("plus", "Larger"), ("period", "Turn"), ("light", "Light")),
    *row(404, ("pause", "Pause"), ("reset", "Reset"), ("demo", "Watch")),
]


def button_at(u: float, v: float) -> Button | None:
    """What is at a point of the panel [px]."""
    return next((b for b in BUTTONS if b.holds(u, v)), None)


def pose_of(hand: np.ndarray, head: np.ndarray) -> np.ndarray:
    """(4, 4) of the panel, x to its right, y up, z to the eyes, over a hand (4, 4); all in the play space."""
    m = np.eye(4)
    m[:3, 3] = hand[:3, 3] + [0.0, ABOVE, 0.0]
    z = head[:3, 3] - m[:3, 3]
    z = z / max(np.linalg.norm(z), 1e-6)
    x = np.cross([0.0, 1.0, 0.0], z)
    x = x / np.linalg.norm(x) if np.linalg.norm(x) > 1e-3 else head[:3, 0]
    m[:3, 0], m[:3, 1], m[:3, 2] = x, np.cross(z, x), z
    return m


def on_panel(panel: np.ndarray, point: np.ndarray) -> tuple[float, float, float]:
    """Pixel (u, v) of the panel before which a point is, and how far before it [m]; negative behind."""
    p = panel[:3, :3].T @ (point - panel[:3, 3])
    scale = PIXELS[0] / WIDTH
    return 0.5 * PIXELS[0] + scale * p[0], 0.5 * PIXELS[1] - scale * p[1], float(p[2])


def inside(u: float, v: float) -> bool:
    return 0 <= u < PIXELS[0] and 0 <= v < PIXELS[1]


def ray_hit(panel: np.ndarray, aim: np.ndarray) -> tuple[float, float] | None:
    """Pixel at which a hand (4, 4) points along -z, from before the panel and no farther than FARTHEST; or None."""
    start, way = aim[:3, 3], -aim[:3, 2]
    *_, before = on_panel(panel, start)
    approach = -float(way @ panel[:3, 2])
    if before <= 0.0 or approach < 1e-3 or before / approach > FARTHEST:
        return None
    u, v, _ = on_panel(panel, start + way * (before / approach))
    return (u, v) if inside(u, v) else None


def palm_to_face(c: Controller, head: np.ndarray) -> float:
    """Cosine of the angle between where the left palm looks and the way to the eyes."""
    joints = getattr(c, "joints", None)
    palm = c.grip[:3, 0] if joints is None else -joints.rotation[PALM][:, 1]
    way = head[:3, 3] - c.grip[:3, 3]
    return float(palm @ way / max(np.linalg.norm(way), 1e-6))


def fingertip(c: Controller) -> np.ndarray | None:
    """Of the right hand, (3,) in the play space."""
    joints = getattr(c, "joints", None)
    if joints is not None:
        return joints.position[INDEX_TIP]
    return None if c.grip is None else c.grip[:3, 3] - FINGER * (c.grip if c.aim is None else c.aim)[:3, 2]


class WristPanel:
    """What the panel is doing. `pose` is None while it is hidden; `over` is the button that is pointed at, `clicked`
    whether one was pressed in this frame."""

    def __init__(self):
        self.pinned = self.clicked = False
        self.pose: np.ndarray | None = None
        self.over: Button | None = None
        self.placing: str | None = None  # the light follows the hand: until it lets go, or has pinched and lets go
        self._facing = self._down = self._taken = False
        self._before: float | None = None  # [m] of the fingertip before the panel; None until it is clear of it

    def advance(self, controllers: list[Controller], head: np.ndarray, stage: np.ndarray, world) -> list[Command]:
        """Commands for the world, which may be None yet. Poses are in the play space, which stands in the world by
        `stage`; `head` (4, 4). While the right hand is at the panel, its controller is changed to one that holds
        nothing."""
        self.clicked = False
        if world is None:
            return []
        left, right = controllers
        if "lower" in left.pressed:
            self.pinned = not (self.pinned or self.pose is not None)
            self._facing = False
        self._show(left, head)
        level = max(right.grab, right.pinch)
        pulls = level > (LET_GO if self._down else PRESS)
        began, self._down = pulls and not self._down, pulls
        button = self._pressed(right, began)
        commands = [] if button is None else self._command(button, world, by_ray=began)
        if began and not self._taken and right.aim is not None and world.editable:
            aim = stage @ right.aim
            hit = world.pick(aim[:3, 3], -aim[:3, 2])
            if hit is not None:
                commands.append(Select(hit[1]))
        commands += self._place_light(right, stage, world)
        if self._taken or self.placing:
            controllers[1] = replace(right, grab=0.0, pinch=0.0)
        self._taken = self._taken and pulls
        return commands

    def _show(self, left: Controller, head: np.ndarray) -> None:
        if left.grip is None:  # it stays where it is
            self.pose = self.pose if self.pinned else None
            return
        busy = max(left.grab, left.pinch) > LET_GO
        self._facing = not busy and palm_to_face(left, head) > (HIDDEN if self._facing else SHOWN)
        self.pose = pose_of(left.grip, head) if self.pinned or self._facing else None

    def _pressed(self, right: Controller, began: bool) -> Button | None:
        """The button that the right hand has just pressed, by its ray or by its finger."""
        self.over = None
        if self.pose is None:
            self._before = None
            return None
        hit = ray_hit(self.pose, right.aim) if right.aim is not None else None
        if hit is not None and (self._taken or began or not self._down):
            self.over = button_at(*hit)
            if began:
                self._taken = True
                return self.over
        return self._poked(fingertip(right))

    def _poked(self, tip: np.ndarray | None) -> Button | None:
        if tip is None:
            return None
        u, v, depth = on_panel(self.pose, tip)
        if depth > CLEAR:
            self._before = depth
            return None
        if not inside(u, v) or depth < -DEEP:
            self._before = None
            return None
        self.over = button_at(u, v)
        through, self._before = self._before is not None and depth <= 0.0, self._before if depth > 0.0 else None
        return self.over if through else None

    def _command(self, button: Button, world, *, by_ray: bool) -> list[Command]:
        self.clicked = True
        name = button.name
        if name in ("physics", "transform"):
            return [SetInteraction(name)]
        if name in ("undo", "redo", "reset"):
            return [{"undo": Undo, "redo": Redo, "reset": Reset}[name]()]
        if name == "pause":
            return [Pause(not world.paused)]
        if name == "demo":
            return [PlayDemo(not world.demo)]
        if name == "light":
            self.placing = "pulled" if by_ray else "free"
            return []
        return editing(name, None)

    def _place_light(self, right: Controller, stage: np.ndarray, world) -> list[Command]:
        """The light is where the hand is, until the trigger is let go."""
        if self.placing is None or world.light is None:
            self.placing = None
            return []
        if self.placing == "free" and self._down:
            self.placing = "pulled"
        elif self.placing == "pulled" and not self._down:
            self.placing = None
            return []
        if right.grip is None:
            return []
        place = (stage @ right.grip)[:3, 3]
        return [SetLight(replace(world.light, position=tuple(place.tolist())))]
