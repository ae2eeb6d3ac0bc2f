"""What mouse and keys do to camera, hand and world. Knows no window system: events come by name."""

from __future__ import annotations

import numpy as np

from assets.camera import Camera
from display.mouse_hand import MouseHand
from display.orbit import Orbit
from scenes.scene import Hand

TURN = np.pi  # [rad] of turning for a drag over the picture's height
LOOK = 1.5  # head turn against the angle that the cursor passes over
PUSH_NOTCH = 0.06  # share of the hand's depth for one notch of the wheel
WALK = 0.8  # [1/s] walking speed in distances to the target
WALK_LEAST = 0.5  # [m/s], so that nobody is stuck in front of a near target
HURRY = 3.0  # walking speed with Shift
WALKING = {"d": (1, 0, 0), "a": (-1, 0, 0), "e": (0, 1, 0), "q": (0, -1, 0), "w": (0, 0, 1), "s": (0, 0, -1)}
REACH_SHARE = 0.25  # of the body's largest extent: finger and thumb, not the whole body
REACH = (0.02, 0.15)  # [m] least and most

HELP = [
    ("Drag a body", "grab it, let go to throw"),
    ("  + wheel, or Shift", "nearer and farther"),
    ("Drag elsewhere", "turn around the scene"),
    ("Right drag", "look about"),
    ("Shift + right drag", "shift the view"),
    ("Wheel", "nearer and farther"),
    ("W A S D, Q E", "walk, down and up"),
    ("Home", "first view again"),
    ("Space  /  N", "pause  /  one step"),
    ("R", "reset the scene"),
    ("T", "physics or transform"),
    ("P", "watch a demonstration"),
    ("F1  /  Esc", "hide this  /  quit"),
]
CAMERA_HELP = [("Drag", "turn around it"), *HELP[3:8], HELP[12]]  # where there is nothing but to look


class Controls:
    """One drag at a time, keys held, and commands for the world. Positions in picture pixels."""

    def __init__(self, orbit: Orbit, hand: MouseHand):
        self.orbit, self.hand = orbit, hand
        self.drag: str | None = None  # "grab", "turn", "look" or "pan"
        self.panel = True
        self.quit = False
        self._button: str | None = None
        self._walking: set[str] = set()
        self._shift = False

    def press(self, button: str, u: float, v: float, camera: Camera, world) -> None:
        """A mouse button goes down over the picture. `world` may be None: nothing to grab yet."""
        if self.drag is not None:
            return
        self._button = button
        if button == "left" and world is not None and not world.paused and self._grab(u, v, camera, world):
            self.drag = "grab"
        elif self._shift and button in ("right", "middle"):
            self.drag = "pan"
        else:
            self.drag = "look" if button == "right" else "turn"

    def _grab(self, u: float, v: float, camera: Camera, world) -> bool:
        hit = world.pick(*camera.ray(u, v))
        if hit is None:
            return False
        distance, index = hit
        body = world.bodies()[index]
        extent = float(np.max(np.asarray(body.high) - np.asarray(body.low)))
        self.hand.grab(camera, u, v, distance, float(np.clip(REACH_SHARE * extent, *REACH)))
        return True

    def release(self, button: str) -> None:
        """A mouse button goes up: the drag that it began ends."""
        if button != self._button:
            return
        if self.drag == "grab":
            self.hand.release()
        self.drag = self._button = None

    def move(self, du: float, dv: float, camera: Camera) -> None:
        """The cursor moves [px]."""
        angle = TURN / camera.height
        if self.drag == "grab" and self._shift:
            self.hand.push(-2.0 * dv / camera.height)
        elif self.drag == "grab":
            self.hand.drag(du, dv)
        elif self.drag == "turn":
            self.orbit.turn(-du * angle, dv * angle)
        elif self.drag == "look":  # as in games: the view goes with the mouse; "turn" and "pan" drag the scene
            self.orbit.look(-LOOK * du / camera.fx, -LOOK * dv / camera.fy)
        elif self.drag == "pan":
            metres = self.orbit.distance / camera.fy  # per pixel, at the target
            self.orbit.move(-du * metres, dv * metres, 0.0)

    def wheel(self, notches: float) -> None:
        """The wheel turns; positive is away from the user."""
        if self.drag == "grab":
            self.hand.push(PUSH_NOTCH * notches)
        else:
            self.orbit.zoom(notches)

    def key(self, name: str, down: bool, world) -> dict:
        """A key goes down or up. Returns commands for the world."""
        if name == "shift":
            self._shift = down
        elif name in WALKING:
            (self._walking.add if down else self._walking.discard)(name)
        elif down and name == "escape":
            self.quit = True
        elif down and name == "f1":
            self.panel = not self.panel
        elif down and name == "home":
            self.orbit.reset()
        elif down and name == "r":
            self.let_go()
            return {"reset": True}
        elif down and name == "n":
            return {"pause": True, "step": True}
        elif down and name == "space" and world is not None:
            return {"pause": not world.paused}
        elif down and name == "p" and world is not None:
            self.let_go()
            return {"demo": not world.demo}
        elif down and name == "t" and world is not None:
            return {"interaction": "transform" if world.interaction == "physics" else "physics"}
        return {}

    def let_go(self) -> None:
        """End drags and held keys, as when the window loses the focus: their releases never come."""
        self.hand.drop()
        self.drag = self._button = None
        self._walking.clear()
        self._shift = False

    def advance(self, camera: Camera, dt: float, *, running: bool = True) -> list[Hand]:
        """Walk for `dt` [s] and return the mouse's hand, if it grips. It waits while the world does not run."""
        if self._walking:
            right, up, forward = np.sum([WALKING[name] for name in self._walking], axis=0)
            speed = max(WALK_LEAST, WALK * self.orbit.distance) * (HURRY if self._shift else 1.0)
            self.orbit.move(right * speed * dt, up * speed * dt, forward * speed * dt)
        return self.hand.hands(camera, dt if running else 0.0)
