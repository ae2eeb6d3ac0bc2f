"""Mouse and keys for camera, hand and world, independent of the window system: events come by name."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from core.camera import Camera
from core.vocabulary import BodyState, Hand
from display import user_commands
from display.preferences import Bookmarks, Preferences
from display.protocol import WorldView
from display.user_commands import (
    ROOM_STEP,
    Command,
    Pause,
    PictureCommand,
    SaveState,
    SingleStep,
    last_of,
    rotation_step,
)
from display.window.key_bindings import bound
from display.window.mouse import MIN_DEPTH, MouseHand, OrbitCamera
from scenes.scene import Scene

ORBIT_PER_HEIGHT = np.pi  # [rad] of turning for a drag over the picture's height
LOOK_GAIN = 1.5  # head turn against the angle that the cursor passes over
PUSH_PER_NOTCH = 0.06  # of the hand's depth, for one notch of the wheel
EYE_CLEARANCE = 0.05  # [m] over table or floor, below which a drag does not take the eye; walking does
WALK_RATE = 0.8  # [1/s] walking speed in distances to the target
MIN_WALK_SPEED = 0.5  # [m/s], so that a near target does not stop the walk
RUN_FACTOR = 3.0  # walking speed with Shift
WALK_KEYS = {"d": (1, 0, 0), "a": (-1, 0, 0), "e": (0, 1, 0), "q": (0, -1, 0), "w": (0, 0, 1), "s": (0, 0, -1)}
RELATIVE_GRAB_RADIUS = 0.25  # of the body's largest extent: finger and thumb, not the whole body
MIN_GRAB_RADIUS, MAX_GRAB_RADIUS = 0.02, 0.15  # [m]
ROOM_GIZMO = "room"  # rings that turn the whole room
HOVER_PERIOD = 0.05  # [s] between two queries for the body under the cursor
HOVER_OPACITY = 0.5  # of the corners around it
ENDING_DRAGS = (
    user_commands.Reset,
    user_commands.LoadState,
    user_commands.PlayDemo,
    user_commands.Undo,
    user_commands.Redo,
    user_commands.Remove,
)


@dataclass(frozen=True)
class Press:
    """A key that goes down: its name with "ctrl+" if that is held, and the cursor at (u, v) of a camera's picture."""

    name: str
    world: WorldView
    u: float
    v: float
    camera: Camera


class Controls:
    """State of mouse and keys: one drag at a time, keys held. Positions in picture pixels.

    `drag` is "grab", "turn", "look", "pan" or None. `panel`, `help` (the list of keys) and `menu` (of scenes) are on
    view; `asks_file`: the user wants to choose a file; `gizmo`: which one is on view, `quit` whether to end.
    `orbit` is the camera of the scene, of which the preferences keep bookmarks under its `name`. Esc closes the
    `dialog` (an OpenDialog) while it is shown.
    """

    def __init__(self, scene: Scene, preferences: Preferences | None = None, name: str = "", dialog=None):
        self._preferences, self._dialog, self.hand = preferences or Preferences(), dialog, MouseHand()
        self.drag: str | None = None
        self.panel = True
        self.help = False
        self.gizmo: str | None = None
        self.menu = self.asks_file = False
        self.measured: list[np.ndarray] | None = None  # points (3,) whose distance sets the size; None: none are asked
        self.quit = False
        self._followed: tuple | None = None  # the last view that the world wanted
        self._view: tuple | None = None  # of the last frame
        self._button: str | None = None
        self._lowest: float | None = None  # [m] to which a drag takes the eye down
        self._walking: set[str] = set()
        self._shift = False
        self._light_cursor: tuple | None = None  # where the light was put last, while its key is down
        self._hovered: tuple[int | None, tuple | None, float] = (None, None, 0.0)  # body, cursor and time of a query
        self.show_scene(scene, name)

    def show_scene(self, scene: Scene, name: str) -> None:
        """Show this scene from its first view, with nothing held."""
        self.let_go()
        self.orbit, self.measured = OrbitCamera(scene.eye, scene.target, scene.fov_y), None
        self._bookmarks_key = f"bookmarks.{name}"
        self._bookmarks = self._preferences.get(self._bookmarks_key, Bookmarks, {})

    def press(self, button: str, u: float, v: float, camera: Camera, world: WorldView) -> None:
        """Handle a mouse button that goes down over the picture."""
        if self.drag is not None:
            return
        if self.measured is not None and button == "left":
            self._measure_at(world.surface(camera, u, v), world)
            return
        self._button = button
        if button == "left" and not world.paused and self._grab(u, v, camera, world):
            self.drag = "grab"
        elif self._shift and button in ("right", "middle"):
            self.drag = "pan"
        else:
            self.drag = "look" if button == "right" else "turn"
            ground = world.ground(self.orbit.target)
            self._lowest = None if ground is None else ground + EYE_CLEARANCE

    def _measure_at(self, point: np.ndarray | None, world: WorldView) -> None:
        if point is None:
            world.tell("Nothing is there: click on something that is seen.")
        elif len(self.measured) < 2:
            self.measured.append(point)
            world.tell("Now the other point." if len(self.measured) == 1 else "")

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
        """Handle a mouse button that goes up: ends the drag that it began."""
        if button != self._button:
            return
        if self.drag == "grab":
            self.hand.release()
        self.drag = self._button = None

    def move(self, du: float, dv: float, camera: Camera) -> None:
        """Handle a motion of the cursor [px]."""
        angle = ORBIT_PER_HEIGHT / camera.height
        if self.drag == "grab" and self._shift:
            self.hand.push(-2.0 * dv / camera.height)
        elif self.drag == "grab":
            self.hand.drag(du, dv)
        elif self.drag == "turn":
            self.orbit.turn(-du * angle, dv * angle, self._lowest)
        elif self.drag == "look":  # as in games: the view goes with the mouse; "turn" and "pan" drag the scene
            self.orbit.look(-LOOK_GAIN * du / camera.fx, -LOOK_GAIN * dv / camera.fy)
        elif self.drag == "pan":
            self.pan(du, dv, camera)

    def pan(self, du: float, dv: float, camera: Camera) -> None:
        """Shift the view with the cursor [px]."""
        metres_per_pixel = self.orbit.distance / camera.fy  # at the target
        self.orbit.move(-du * metres_per_pixel, dv * metres_per_pixel, 0.0)

    def wheel(self, notches: float) -> None:
        """Handle a turn of the wheel; positive is away from the user."""
        if self.drag == "grab":
            self.hand.push(PUSH_PER_NOTCH * notches)
        else:
            self.orbit.zoom(notches)

    def key(self, name: str, down: bool, world: WorldView, u: float, v: float, camera: Camera) -> list[Command]:
        """Handle a key that goes down or up, with the cursor at (u, v) of a camera's picture; returns its commands."""
        if name == "shift":
            self._shift = down
        elif name in WALK_KEYS:
            (self._walking.add if down else self._walking.discard)(name)
        elif name == "l":
            self._light_cursor = () if down else None
        elif down and (binding := bound(name, shift=self._shift, bodies=world.editable)) is not None:
            return self._act(binding.action, Press(name, world, u, v, camera))
        return []

    def _act(self, action, press: Press) -> list[Command]:
        if isinstance(action, str):
            named = getattr(self, action)
            if isinstance(named, bool):
                setattr(self, action, not named)
                return []
            return named(press) or []
        commands = [self._aimed(action, press)] if isinstance(action, Command) else list(action(press.world))
        self.note(commands)
        return commands

    def _aimed(self, command: Command, press: Press) -> Command:
        """A command aimed at the body under the cursor; else at the one that is held or was selected last."""
        if not hasattr(command, "body") or self.drag == "grab":
            return command
        hit = press.world.pick(*press.camera.ray(press.u, press.v))
        return command if hit is None else replace(command, body=hit[1])

    def note(self, commands: Iterable[Command]) -> None:
        """End the drag if one of these commands takes away what is held."""
        if any(isinstance(command, ENDING_DRAGS) for command in commands):
            self._drop()

    def completed(self, commands: Iterable[Command], size: tuple[int, int]) -> list[Command]:
        """The commands, with the size [px] of the whole picture and the view where they ask for these."""
        view = (tuple(self.orbit.eye.tolist()), tuple(self.orbit.target.tolist()))
        sized = [replace(c, size=size) if isinstance(c, PictureCommand) else c for c in commands]
        return [replace(c, view=view) if isinstance(c, SaveState) else c for c in sized]

    def follow(self, world: WorldView) -> None:
        """Go to the view of a state that was loaded."""
        if world.wanted_view is not self._followed:
            self._followed = world.wanted_view
            if self._followed is not None:
                self.orbit.eye, self.orbit.target = (np.array(point, np.float64) for point in self._followed)

    # the actions of key_bindings.py that concern the window alone, or the camera

    def escape(self, press: Press) -> list[Command]:
        """End the first of these that is active: the drag, the list of keys, a measurement, a menu or dialog, what is
        being opened, the gizmo, the demonstration; else quit."""
        if self.drag is not None:
            self._drop()
        elif self.help:
            self.help = False
        elif self.measured is not None:
            self.measured = None
        elif self.menu:
            self.menu = False
        elif self._dialog is not None and self._dialog.shown:
            self._dialog.close()
        elif press.world.opening:
            return [user_commands.CancelOpening()]
        elif self.gizmo is not None:
            self.gizmo = None
        elif press.world.demo:
            return [user_commands.PlayDemo(False)]
        else:
            self.quit = True
        return []

    def show_next_gizmo(self) -> None:
        """Show the next kind of gizmo, or none after the last."""
        self.gizmo = {None: "move", ROOM_GIZMO: "move", "move": "turn", "turn": "scale", "scale": None}[self.gizmo]

    def next_gizmo(self, press: Press) -> list[Command]:
        """Show the gizmo of the body under the cursor, or of the selected one: move, turn, scale, none."""
        self.show_next_gizmo()
        if self.gizmo != "move":
            return []
        select = self._aimed(user_commands.Select(press.world.selected), press)
        if select.body is None:
            self.gizmo = None
            press.world.tell("Point at a body, or hold one, to move it.")
            return []
        return [select]

    def toggle_room_gizmo(self, press: Press) -> None:
        """Show rings that turn the whole room, or hide them."""
        self.gizmo = None if self.gizmo == ROOM_GIZMO else ROOM_GIZMO
        if self.gizmo is not None and press.world.room_middle is None:
            self.gizmo = None
            press.world.tell("Only a room of your own can be turned: vrgs.py capture, or --stage ROOM.")

    def measure(self, press: Press) -> None:
        """Begin to measure between two points, or stop that."""
        self.measured = [] if self.measured is None else None
        if self.measured is not None:
            press.world.tell("Click two points whose distance you know (Esc: none).")

    def reset_view(self, press: Press) -> None:
        """Show the scene from where it begins."""
        self.orbit.reset()

    def go_to_bookmark(self, press: Press) -> None:
        """Show the view that is kept under a digit."""
        digit = press.name[-1]
        eye, target = self._bookmarks.get(digit, ((), ()))
        if eye != target:
            self.orbit.eye, self.orbit.target = np.array(eye), np.array(target)
        else:
            press.world.tell(f"No view is kept under {digit}: Ctrl+{digit} keeps this one.")

    def keep_bookmark(self, press: Press) -> None:
        """Keep the view under a digit."""
        digit = press.name[-1]
        self._bookmarks = self._bookmarks | {digit: (tuple(self.orbit.eye.tolist()), tuple(self.orbit.target.tolist()))}
        self._preferences.set(self._bookmarks_key, self._bookmarks)
        press.world.tell(f"This view is kept under {digit}.")

    def tilt(self, press: Press) -> list[Command]:
        """Tilt a body, or with Ctrl the room, about the camera's horizontal axis: away by a comma, else towards it."""
        axis, sign = press.camera.world_to_camera[0, :3], 1.0 if press.name.endswith("comma") else -1.0
        if press.name.startswith("ctrl+"):
            return [user_commands.TurnRoom(rotation_step(axis, sign, step=ROOM_STEP))]
        return [self._aimed(user_commands.Rotate(None, rotation_step(axis, sign)), press)]

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
        return [user_commands.SetLight(replace(world.light, position=tuple(map(float, position))))]

    def camera_moved(self, camera: Camera) -> bool:
        """True if the camera, for the full picture, differs from that of the last call."""
        before, self._view = self._view, (camera.width, camera.world_to_camera.tobytes())
        return before != self._view

    def let_go(self) -> None:
        """End drags and held keys, as when the window loses the focus: their releases never come."""
        self._drop()
        self._walking.clear()
        self._shift, self._light_cursor = False, None

    def _drop(self) -> None:
        self.hand.drop()
        self.drag = self._button = None

    def hands(self, camera: Camera, dt: float, commands: Iterable[Command], world: WorldView) -> list[Hand]:
        """Walk for `dt` [s]; the mouse's hand then, if it grips. It moves at the world's pace, and waits while the
        world is paused, as it may be by these commands."""
        if self._walking:
            right, up, forward = np.sum([WALK_KEYS[name] for name in self._walking], axis=0)
            speed = max(MIN_WALK_SPEED, WALK_RATE * self.orbit.distance) * (RUN_FACTOR if self._shift else 1.0)
            self.orbit.move(right * speed * dt, up * speed * dt, forward * speed * dt)
        pause = last_of(Pause, commands)
        waits = (world.paused if pause is None else pause.on) and last_of(SingleStep, commands) is None
        return self.hand.hands(camera, 0.0 if waits else dt, world.time_scale)

    def hovered(
        self, world: WorldView, camera: Camera, cursor: tuple[float, float] | None, *, moving: bool
    ) -> BodyState | None:
        """The body under the cursor (u, v) [px of the camera], which a press would take; a cursor of None takes none.

        The world is only queried when something moves, and not in each frame: a query casts a ray.
        """
        if cursor is None or self.drag is not None or not world.editable or world.demo:
            self._hovered = (None, None, 0.0)
            return None
        k, before, when = self._hovered
        now = perf_counter()
        if now - when > HOVER_PERIOD and (moving or cursor != before):
            hit = world.pick(*camera.ray(*cursor))
            k = None if hit is None else hit[1]
            self._hovered = (k, cursor, now)
        bodies = world.bodies()
        return bodies[k] if k is not None and k < len(bodies) and not bodies[k].held else None
