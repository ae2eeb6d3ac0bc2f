"""Mouse and keys for camera, hand and world, independent of the window system: events come by name."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from time import perf_counter

import numpy as np

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
# Offsets of the rays of a press, in heights of the picture: at the cursor, then 7 and 14 px of 540 around it.
AROUND = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
PICK_OFFSETS = ((0.0, 0.0), *((r * np.cos(a), r * np.sin(a)) for r in (0.013, 0.026) for a in AROUND))
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


class Controls:
    """State of mouse and keys: one drag at a time, keys held.

    camera    of the picture in the size in which it is shown, by `update_camera`
    cursor    (u, v) [px] of that picture
    drag      "grab", "turn", "look", "pan" or None
    gizmo     "move", "turn", "scale", ROOM_GIZMO or None
    measured  points (3,) [m] whose distance sets the size; None: none are asked
    orbit     the camera of the scene, of which the preferences keep bookmarks under its `name`

    `panel`, `help` (the list of keys) and `menu` (of scenes) are on view, `asks_file`: the user wants to choose a file,
    `quit`: to end. Esc closes the `dialog` (an OpenDialog) while it is shown.
    """

    def __init__(self, scene: Scene, preferences: Preferences | None = None, name: str = "", dialog=None):
        self._preferences, self._dialog, self.hand = preferences or Preferences(), dialog, MouseHand()
        self.panel, self.help, self.menu, self.asks_file, self.quit = True, False, False, False, False
        self.gizmo: str | None = None
        self.cursor = (0.0, 0.0)
        self._followed: tuple | None = None  # the last view that the world wanted
        self._lowest: float | None = None  # [m] to which a drag takes the eye down
        self._walking: set[str] = set()
        self._hovered: tuple[int | None, tuple | None, float] = (None, None, 0.0)  # body, cursor and time of a query
        self.show_scene(scene, name)
        self.camera = self.orbit.camera(1, 1)

    def show_scene(self, scene: Scene, name: str) -> None:
        """Show this scene from its first view, with nothing held."""
        self.let_go()
        self.orbit = OrbitCamera(scene.eye, scene.target, scene.fov_y)
        self.measured: list[np.ndarray] | None = None
        self._bookmarks_key = f"bookmarks.{name}"
        self._bookmarks = self._preferences.get(self._bookmarks_key, Bookmarks, {})

    def update_camera(self, size: tuple[int, int]) -> bool:
        """Take the camera anew, for a picture that is shown in this size [px]; True if it has moved."""
        before, self.camera = self.camera, self.orbit.camera(*(max(1, side) for side in size))
        return before.world_to_camera.tobytes() != self.camera.world_to_camera.tobytes()

    def press(self, button: str, world: WorldView) -> None:
        """Handle a mouse button that goes down over the picture, at the cursor."""
        if self.drag is not None:
            return
        if self.measured is not None and button == "left":
            self._measure_at(world.surface(self.camera, *self.cursor), world)
            return
        self._button = button
        if button == "left" and not world.paused and self._grab(world):
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

    def _grab(self, world: WorldView) -> bool:
        hit = self._pick(world)
        if hit is None:
            return False
        distance, index, at = hit
        body = world.bodies()[index]
        radius = RELATIVE_GRAB_RADIUS * float(np.max(body.high - body.low))
        radius = float(np.clip(radius, MIN_GRAB_RADIUS, MAX_GRAB_RADIUS))
        self.hand.grab(self.camera, *at, distance, radius)
        return True

    def _pick(self, world: WorldView) -> tuple[float, int, tuple[float, float]] | None:
        """`world.pick` at the cursor, else as near beside it as there is a body, and the pixel (u, v) where it is."""
        for du, dv in PICK_OFFSETS:
            at = self.cursor[0] + du * self.camera.height, self.cursor[1] + dv * self.camera.height
            hit = world.pick(*self.camera.ray(*at))
            if hit is not None:
                return *hit, at
        return None

    def release(self, button: str) -> None:
        """Handle a mouse button that goes up: ends the drag that it began."""
        if button != self._button:
            return
        if self.drag == "grab":
            self.hand.release()
        self.drag = self._button = None

    def move(self, u: float, v: float) -> None:
        """Handle a motion of the cursor, to (u, v)."""
        du, dv, self.cursor = u - self.cursor[0], v - self.cursor[1], (u, v)
        camera, angle = self.camera, ORBIT_PER_HEIGHT / self.camera.height
        if self.drag == "grab" and self._shift:
            self.hand.push(-2.0 * dv / camera.height)
        elif self.drag == "grab":
            self.hand.drag(du, dv)
        elif self.drag == "turn":
            self.orbit.turn(-du * angle, dv * angle, self._lowest)
        elif self.drag == "look":  # as in games: the view goes with the mouse; "turn" and "pan" drag the scene
            self.orbit.look(-LOOK_GAIN * du / camera.fx, -LOOK_GAIN * dv / camera.fy)
        elif self.drag == "pan":
            self.pan(du, dv)

    def pan(self, du: float, dv: float) -> None:
        """Shift the view with the cursor [px]."""
        metres_per_pixel = self.orbit.distance / self.camera.fy  # at the target
        self.orbit.move(-du * metres_per_pixel, dv * metres_per_pixel, 0.0)

    def wheel(self, notches: float) -> None:
        """Handle a turn of the wheel; positive is away from the user."""
        if self.drag == "grab":
            self.hand.push(PUSH_PER_NOTCH * notches)
        else:
            self.orbit.zoom(notches)

    def key(self, name: str, down: bool, world: WorldView) -> list[Command]:
        """Handle a key that goes down, its name after "ctrl+" if that is held, or up; returns its commands."""
        if name == "shift":
            self._shift = down
        elif name in WALK_KEYS:
            (self._walking.add if down else self._walking.discard)(name)
        elif name == "l":
            self._light_cursor = () if down else None
        elif down and (binding := bound(name, shift=self._shift, bodies=world.editable)) is not None:
            return self._act(binding.action, name, world)
        return []

    def _act(self, action, name: str, world: WorldView) -> list[Command]:
        if isinstance(action, str):
            named = getattr(self, action)
            if isinstance(named, bool):
                setattr(self, action, not named)
                return []
            return named(name, world) or []
        commands = [self._aimed(action, world)] if isinstance(action, Command) else list(action(world))
        self.note(commands)
        return commands

    def _aimed(self, command: Command, world: WorldView) -> Command:
        """A command aimed at the body under the cursor; else at the one that is held or was selected last."""
        if not hasattr(command, "body") or self.drag == "grab":
            return command
        hit = self._pick(world)
        return command if hit is None else replace(command, body=hit[1])

    def note(self, commands: Iterable[Command]) -> None:
        """End the drag if one of these commands takes away what is held."""
        if any(isinstance(command, ENDING_DRAGS) for command in commands):
            self._drop()

    def completed(self, commands: Iterable[Command], size: tuple[int, int], world: WorldView) -> list[Command]:
        """The commands of a frame: with that of the light which follows the cursor, and with the size [px] of the whole
        picture and the view where they ask for these. Goes to the view of a state that was loaded."""
        if world.wanted_view is not self._followed:
            self._followed = world.wanted_view
            if self._followed is not None:
                self.orbit.look_from(*self._followed)
        sized = [replace(c, size=size) if isinstance(c, PictureCommand) else c for c in commands]
        sized = [replace(c, view=self.orbit.view) if isinstance(c, SaveState) else c for c in sized]
        return sized + self.place_light(world)

    # the actions of key_bindings.py that concern the window alone, or the camera: of the key's name and the world

    def escape(self, name: str, world: WorldView) -> list[Command]:
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
        elif world.opening:
            return [user_commands.CancelOpening()]
        elif self.gizmo is not None:
            self.gizmo = None
        elif world.demo:
            return [user_commands.PlayDemo(False)]
        else:
            self.quit = True
        return []

    def show_next_gizmo(self) -> None:
        """Show the next kind of gizmo, or none after the last."""
        self.gizmo = {None: "move", ROOM_GIZMO: "move", "move": "turn", "turn": "scale", "scale": None}[self.gizmo]

    def next_gizmo(self, name: str, world: WorldView) -> list[Command]:
        """Show the gizmo of the body under the cursor, or of the selected one: move, turn, scale, none."""
        self.show_next_gizmo()
        if self.gizmo != "move":
            return []
        select = self._aimed(user_commands.Select(world.selected), world)
        if select.body is None:
            self.gizmo = None
            world.tell("Point at a body, or hold one, to move it.")
            return []
        return [select]

    def toggle_room_gizmo(self, name: str, world: WorldView) -> None:
        """Show rings that turn the whole room, or hide them."""
        if self.gizmo != ROOM_GIZMO and world.room_middle is None:
            world.tell("Only a room of your own can be turned: vrgs.py capture, or --stage ROOM.")
        self.gizmo = None if self.gizmo == ROOM_GIZMO or world.room_middle is None else ROOM_GIZMO

    def measure(self, name: str, world: WorldView) -> None:
        """Begin to measure between two points, or stop that."""
        self.measured = [] if self.measured is None else None
        if self.measured is not None:
            world.tell("Click two points whose distance you know (Esc: none).")

    def reset_view(self, name: str, world: WorldView) -> None:
        """Show the scene from where it begins."""
        self.orbit.reset()

    def go_to_bookmark(self, name: str, world: WorldView) -> None:
        """Show the view that is kept under a digit."""
        eye, target = self._bookmarks.get(name, ((), ()))
        if eye != target:
            self.orbit.look_from(eye, target)
        else:
            world.tell(f"No view is kept under {name}: Ctrl+{name} keeps this one.")

    def keep_bookmark(self, name: str, world: WorldView) -> None:
        """Keep the view under a digit."""
        self._bookmarks = self._bookmarks | {name[-1]: self.orbit.view}
        self._preferences.set(self._bookmarks_key, self._bookmarks)
        world.tell(f"This view is kept under {name[-1]}.")

    def tilt(self, name: str, world: WorldView) -> list[Command]:
        """Tilt a body, or with Ctrl the room, about the camera's horizontal axis: away by a comma, else towards it."""
        axis, sign = self.camera.world_to_camera[0, :3], 1.0 if name.endswith("comma") else -1.0
        if name.startswith("ctrl+"):
            return [user_commands.TurnRoom(rotation_step(axis, sign, step=ROOM_STEP))]
        return [self._aimed(user_commands.Rotate(None, rotation_step(axis, sign)), world)]

    # what goes on while a key or button is down

    def place_light(self, world: WorldView) -> list[Command]:
        """While its key is down, the light follows the cursor at the depth that it has."""
        if self._light_cursor is None or self._light_cursor == self.cursor or world.light is None:
            return []
        self._light_cursor = self.cursor
        origin, direction = self.camera.ray(*self.cursor)
        forward = self.camera.world_to_camera[2, :3]
        depth = float(forward @ (np.array(world.light.position) - origin))
        if depth < MIN_DEPTH:  # it is behind the camera: then it comes to the target's depth
            depth = self.orbit.distance
        position = origin + direction * depth / float(direction @ forward)
        return [user_commands.SetLight(replace(world.light, position=tuple(map(float, position))))]

    def let_go(self) -> None:
        """End drags and held keys, as when the window loses the focus: their releases never come."""
        self._drop()
        self._walking.clear()
        self._shift = False
        self._light_cursor: tuple | None = None  # where the light was put last, while its key is down

    def _drop(self) -> None:
        self.hand.drop()
        self.drag: str | None = None
        self._button: str | None = None

    def hands(self, dt: float, commands: Iterable[Command], world: WorldView) -> list[Hand]:
        """Walk for `dt` [s]; the mouse's hand then, if it grips. It moves at the world's pace, and waits while the
        world is paused, as it may be by these commands."""
        if self._walking:
            right, up, forward = np.sum([WALK_KEYS[name] for name in self._walking], axis=0)
            speed = max(MIN_WALK_SPEED, WALK_RATE * self.orbit.distance) * (RUN_FACTOR if self._shift else 1.0)
            self.orbit.move(right * speed * dt, up * speed * dt, forward * speed * dt)
        pause = last_of(Pause, commands)
        waits = (world.paused if pause is None else pause.on) and last_of(SingleStep, commands) is None
        return self.hand.hands(self.camera, 0.0 if waits else dt, world.time_scale)

    def hovered(self, world: WorldView, *, over: bool, moving: bool) -> BodyState | None:
        """The body under the cursor, which a press would take; none if the cursor is not `over` the picture.

        The world is only queried when something moves, and not in each frame: a query casts a ray.
        """
        if not over or self.drag is not None or not world.editable or world.demo:
            self._hovered = (None, None, 0.0)
            return None
        k, cursor, when = self._hovered
        now = perf_counter()
        if now - when > HOVER_PERIOD and (moving or cursor != self.cursor):
            hit = self._pick(world)
            k = None if hit is None else hit[1]
            self._hovered = (k, self.cursor, now)
        bodies = world.bodies()
        return bodies[k] if k is not None and k < len(bodies) and not bodies[k].held else None
