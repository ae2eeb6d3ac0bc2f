"""What mouse and keys do to camera, hand and world. Knows no window system: events come by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from core.camera import Camera
from display.protocol import (
    Command,
    Duplicate,
    Pause,
    PlayDemo,
    Redo,
    Remove,
    Rescale,
    Reset,
    Rotate,
    SetInteraction,
    SetLight,
    SingleStep,
    Undo,
)
from display.window.mouse_hand import NEAREST, MouseHand
from display.window.orbit_camera import OrbitCamera
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
    ("Ctrl+Z  /  Ctrl+Y", "undo  /  redo"),
    ("C  /  Del", "copy  /  remove a body"),
    ("+  -  ,  .", "larger, smaller, turn it"),
    ("L", "light to the cursor"),
    ("F1  /  Esc", "hide this  /  quit"),
]
CAMERA_HELP = [("Drag", "turn around it"), *HELP[3:8], HELP[-1]]  # where there is nothing but to look
LARGER = 1.25  # times, of a key or a button
TURNED = np.pi / 12  # [rad] about the vertical axis


class Controls:
    """One drag at a time, keys held, and commands for the world. Positions in picture pixels."""

    def __init__(self, orbit: OrbitCamera, hand: MouseHand):
        self.orbit, self.hand = orbit, hand
        self.drag: str | None = None  # "grab", "turn", "look" or "pan"
        self.panel = True
        self.quit = False
        self._button: str | None = None
        self._walking: set[str] = set()
        self._shift = False
        self._lit: tuple | None = None  # where the light was put last, while its key is down

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

    def key(self, name: str, down: bool, world, at: tuple[float, float, Camera] | None = None) -> list[Command]:
        """A key goes down or up, with the cursor over (u, v) [px] of a camera's picture. Returns commands for the
        world."""
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
            return [Reset()]
        elif down and name == "n":
            return [Pause(True), SingleStep()]
        elif down and name == "space" and world is not None:
            return [Pause(not world.paused)]
        elif down and name == "p" and world is not None:
            self.let_go()
            return [PlayDemo(not world.demo)]
        elif down and name == "t" and world is not None:
            return [SetInteraction("transform" if world.interaction == "physics" else "physics")]
        elif name == "l":
            self._lit = () if down else None
        elif down and world is not None and world.editable:
            return self._edit(name, world, at)
        return []

    def _edit(self, name: str, world, at) -> list[Command]:
        """Commands that change bodies: what is held, else what is under the cursor, else what was held last."""
        if name in ("ctrl+z", "ctrl+y", "u"):
            self._drop()
            return [Redo() if name == "ctrl+y" or self._shift else Undo()]
        hit = world.pick(*at[2].ray(*at[:2])) if at is not None and self.drag != "grab" else None
        body = None if hit is None else hit[1]
        if name == "delete":
            self._drop()
        if name in ("comma", "period") and self._shift and at is not None:
            return editing(name, body, at[2].world_to_camera[0, :3])
        return editing(name, body)

    def lighting(self, world, u: float, v: float, camera: Camera) -> list[Command]:
        """While its key is down, the light follows the cursor, as far from the camera's plane as it is."""
        if self._lit is None or self._lit == (u, v) or world is None or world.light is None:
            return []
        self._lit = (u, v)
        origin, direction = camera.ray(u, v)
        forward = camera.world_to_camera[2, :3]
        depth = float(forward @ (np.array(world.light.position) - origin))
        if depth < NEAREST:  # it is behind the camera: then it is put where one looks to
            depth = self.orbit.distance
        place = origin + direction * depth / float(direction @ forward)
        return [SetLight(replace(world.light, position=tuple(map(float, place))))]

    def let_go(self) -> None:
        """End drags and held keys, as when the window loses the focus: their releases never come."""
        self._drop()
        self._walking.clear()
        self._shift, self._lit = False, None

    def _drop(self) -> None:
        self.hand.drop()
        self.drag = self._button = None

    def advance(self, camera: Camera, dt: float, *, running: bool = True) -> list[Hand]:
        """Walk for `dt` [s] and return the mouse's hand, if it grips. It waits while the world does not run."""
        if self._walking:
            right, up, forward = np.sum([WALKING[name] for name in self._walking], axis=0)
            speed = max(WALK_LEAST, WALK * self.orbit.distance) * (HURRY if self._shift else 1.0)
            self.orbit.move(right * speed * dt, up * speed * dt, forward * speed * dt)
        return self.hand.hands(camera, dt if running else 0.0)


def editing(name: str, body: int | None, axis=(0.0, 1.0, 0.0)) -> list[Command]:
    """The command of a key or button for a body; None: for the one held last. `axis` (3,): it is turned about."""
    half = TURNED / 2
    turn = (float(np.cos(half)), *(np.sin(half) * np.asarray(axis)).tolist())
    return {
        "c": [Duplicate(body)],
        "delete": [Remove(body)],
        "plus": [Rescale(body, LARGER)],
        "minus": [Rescale(body, 1 / LARGER)],
        "comma": [Rotate(body, turn)],
        "period": [Rotate(body, (turn[0], *(-t for t in turn[1:])))],
    }.get(name, [])
