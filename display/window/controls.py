"""Mouse and keys for camera, hand and world, independent of the window system: events come by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from core.camera import Camera
from display import protocol
from display.protocol import Command, WorldView
from display.window.mouse_hand import MIN_DEPTH, MouseHand
from display.window.orbit_camera import OrbitCamera
from scenes.scene import Hand

ORBIT_PER_HEIGHT = np.pi  # [rad] of turning for a drag over the picture's height
LOOK_GAIN = 1.5  # head turn against the angle that the cursor passes over
PUSH_PER_NOTCH = 0.06  # of the hand's depth, for one notch of the wheel
WALK_RATE = 0.8  # [1/s] walking speed in distances to the target
MIN_WALK_SPEED = 0.5  # [m/s], so that a near target does not stop the walk
RUN_FACTOR = 3.0  # walking speed with Shift
WALK_KEYS = {"d": (1, 0, 0), "a": (-1, 0, 0), "e": (0, 1, 0), "q": (0, -1, 0), "w": (0, 0, 1), "s": (0, 0, -1)}
RELATIVE_GRAB_RADIUS = 0.25  # of the body's largest extent: finger and thumb, not the whole body
MIN_GRAB_RADIUS, MAX_GRAB_RADIUS = 0.02, 0.15  # [m]
SCALE_STEP = 1.25  # of a key or a button
TURN_STEP = np.pi / 12  # [rad]

HELP = [
    ("Drag a body", "grab it, release to throw"),
    ("  + wheel, or Shift", "nearer and farther"),
    ("Drag elsewhere", "turn around the scene"),
    ("Right drag", "look around"),
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
CAMERA_HELP = [("Drag", "turn around it"), *HELP[3:8], HELP[-1]]  # where there is nothing to edit


def rotation_step(axis=(0.0, 1.0, 0.0), sign: float = 1.0) -> tuple[float, ...]:
    """Quaternion wxyz of a step about a unit axis (3,), the vertical one unless told otherwise."""
    half = sign * TURN_STEP / 2
    return (float(np.cos(half)), *(np.sin(half) * np.asarray(axis)).tolist())


EDITS: dict[str, Command] = {  # by the names of the panels' buttons, of the selected body
    "undo": protocol.Undo(),
    "redo": protocol.Redo(),
    "copy": protocol.Duplicate(),
    "remove": protocol.Remove(),
    "smaller": protocol.Rescale(None, 1 / SCALE_STEP),
    "larger": protocol.Rescale(None, SCALE_STEP),
    "turn": protocol.Rotate(None, rotation_step(sign=-1.0)),
}
EDIT_KEYS = {"c": "copy", "delete": "remove", "minus": "smaller", "plus": "larger"}


class Controls:
    """State of mouse and keys: one drag at a time, keys held. Positions in picture pixels.

    `drag` is "grab", "turn", "look", "pan" or None, `panel` whether the panel is on view, `quit` whether to end.
    """

    def __init__(self, orbit: OrbitCamera, hand: MouseHand):
        self.orbit, self.hand = orbit, hand
        self.drag: str | None = None
        self.panel = True
        self.quit = False
        self._button: str | None = None
        self._walking: set[str] = set()
        self._shift = False
        self._light_cursor: tuple | None = None  # where the light was put last, while its key is down

    def press(self, button: str, u: float, v: float, camera: Camera, world: WorldView) -> None:
        """Take a mouse button that goes down over the picture."""
        if self.drag is not None:
            return
        self._button = button
        if button == "left" and not world.paused and self._grab(u, v, camera, world):
            self.drag = "grab"
        elif self._shift and button in ("right", "middle"):
            self.drag = "pan"
        else:
            self.drag = "look" if button == "right" else "turn"

    def _grab(self, u: float, v: float, camera: Camera, world: WorldView) -> bool:
        hit = world.pick(*camera.ray(u, v))
        if hit is None:
            return False
        distance, index = hit
        body = world.bodies()[index]
        radius = RELATIVE_GRAB_RADIUS * float(np.max(body.high - body.low))
        self.hand.grab(camera, u, v, distance, float(np.clip(radius, MIN_GRAB_RADIUS, MAX_GRAB_RADIUS)))
        return True

    def release(self, button: str) -> None:
        """Take a mouse button that goes up: the drag that it began ends."""
        if button != self._button:
            return
        if self.drag == "grab":
            self.hand.release()
        self.drag = self._button = None

    def move(self, du: float, dv: float, camera: Camera) -> None:
        """Take a motion of the cursor [px]."""
        angle = ORBIT_PER_HEIGHT / camera.height
        if self.drag == "grab" and self._shift:
            self.hand.push(-2.0 * dv / camera.height)
        elif self.drag == "grab":
            self.hand.drag(du, dv)
        elif self.drag == "turn":
            self.orbit.turn(-du * angle, dv * angle)
        elif self.drag == "look":  # as in games: the view goes with the mouse; "turn" and "pan" drag the scene
            self.orbit.look(-LOOK_GAIN * du / camera.fx, -LOOK_GAIN * dv / camera.fy)
        elif self.drag == "pan":
            self.pan(du, dv, camera)

    def pan(self, du: float, dv: float, camera: Camera) -> None:
        """Shift the view with the cursor [px]."""
        metres_per_pixel = self.orbit.distance / camera.fy  # at the target
        self.orbit.move(-du * metres_per_pixel, dv * metres_per_pixel, 0.0)

    def wheel(self, notches: float) -> None:
        """Take a turn of the wheel; positive is away from the user."""
        if self.drag == "grab":
            self.hand.push(PUSH_PER_NOTCH * notches)
        else:
            self.orbit.zoom(notches)

    def key(self, name: str, down: bool, world: WorldView, u: float, v: float, camera: Camera) -> list[Command]:
        """Take a key that goes down or up, with the cursor at (u, v) of a camera's picture; its commands."""
        if name == "shift":
            self._shift = down
        elif name in WALK_KEYS:
            (self._walking.add if down else self._walking.discard)(name)
        elif name == "l":
            self._light_cursor = () if down else None
        elif not down:
            return []
        elif name == "escape":
            self.quit = True
        elif name == "f1":
            self.panel = not self.panel
        elif name == "home":
            self.orbit.reset()
        elif name == "r":
            self.let_go()
            return [protocol.Reset()]
        elif name == "n":
            return [protocol.Pause(True), protocol.SingleStep()]
        elif name == "space":
            return [protocol.Pause(not world.paused)]
        elif name == "p":
            self.let_go()
            return [protocol.PlayDemo(not world.demo)]
        elif name == "t":
            return [protocol.SetInteraction("transform" if world.interaction == "physics" else "physics")]
        elif world.editable:
            return self._edit(name, world, u, v, camera)
        return []

    def _edit(self, name: str, world: WorldView, u: float, v: float, camera: Camera) -> list[Command]:
        """Edit of the body that is held, else of the one under the cursor, else of the one selected last."""
        if name in ("ctrl+z", "ctrl+y", "u"):
            self._drop()
            return [protocol.Redo() if name == "ctrl+y" or self._shift else protocol.Undo()]
        hit = world.pick(*camera.ray(u, v)) if self.drag != "grab" else None
        body = None if hit is None else hit[1]
        if name == "delete":
            self._drop()
        if name in ("comma", "period"):
            axis = camera.world_to_camera[0, :3] if self._shift else (0.0, 1.0, 0.0)
            return [protocol.Rotate(body, rotation_step(axis, 1.0 if name == "comma" else -1.0))]
        return [replace(EDITS[EDIT_KEYS[name]], body=body)] if name in EDIT_KEYS else []

    def place_light(self, world: WorldView, u: float, v: float, camera: Camera) -> list[Command]:
        """While its key is down, the light follows the cursor at the depth that it has."""
        if self._light_cursor is None or self._light_cursor == (u, v) or world.light is None:
            return []
        self._light_cursor = (u, v)
        origin, direction = camera.ray(u, v)
        forward = camera.world_to_camera[2, :3]
        depth = float(forward @ (np.array(world.light.position) - origin))
        if depth < MIN_DEPTH:  # it is behind the camera: then it comes to the target's depth
            depth = self.orbit.distance
        position = origin + direction * depth / float(direction @ forward)
        return [protocol.SetLight(replace(world.light, position=tuple(map(float, position))))]

    def let_go(self) -> None:
        """End drags and held keys, as when the window loses the focus: their releases never come."""
        self._drop()
        self._walking.clear()
        self._shift, self._light_cursor = False, None

    def _drop(self) -> None:
        self.hand.drop()
        self.drag = self._button = None

    def advance(self, camera: Camera, dt: float, *, running: bool = True) -> list[Hand]:
        """Walk for `dt` [s] and return the mouse's hand, if it grips. It waits while the world does not run."""
        if self._walking:
            right, up, forward = np.sum([WALK_KEYS[name] for name in self._walking], axis=0)
            speed = max(MIN_WALK_SPEED, WALK_RATE * self.orbit.distance) * (RUN_FACTOR if self._shift else 1.0)
            self.orbit.move(right * speed * dt, up * speed * dt, forward * speed * dt)
        return self.hand.hands(camera, dt if running else 0.0)
