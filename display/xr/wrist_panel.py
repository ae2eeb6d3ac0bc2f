"""The panel over the left hand: its pose, its buttons, and the right hand's interaction with it.

It appears when the left palm turns to the face, or is pinned there by a button. The right hand points at it and pulls
the trigger, or pushes a finger through it; then it grips nothing. Positions on the panel are in pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from display import user_commands
from display.edit.edit_steps import EDITS
from display.protocol import WorldView
from display.user_commands import Command
from display.window.scene_menu import demos, spoken, variants
from display.xr.actions import PRESS_ABOVE, RELEASE_BELOW, Controller
from display.xr.hand_joints import INDEX_TIP, PALM
from display.xr.poses import pose_matrix

PIXELS = (800, 512)  # (width, height)
PANEL_WIDTH = 0.28  # [m]
HEIGHT_OVER_HAND = 0.14  # [m] of its middle
SHOW_ABOVE, HIDE_BELOW = 0.85, 0.6  # cosine of the angle between the palm and the direction to the eyes
MAX_RAY = 3.0  # [m] to point at it
MAX_PUSH_DEPTH = 0.06  # [m] behind the panel beyond which a finger has passed by
SCENE_COLUMNS, SCENES_A_PAGE = 3, 10  # of four rows, in which "more" and "back" have their places
CLEARANCE = 0.015  # [m] before the panel to which a finger must come back to push again


@dataclass(frozen=True)
class Button:
    """A button: `box` is left, top, width and height [px]."""

    name: str
    box: tuple[int, int, int, int]

    def contains(self, u: float, v: float) -> bool:
        """True if a point [px] is on it."""
        x, y, w, h = self.box
        return x <= u < x + w and y <= v < y + h

    def command(self, world: WorldView) -> Command | None:
        """The command that it gives; None of the light's, which is to be placed."""
        match self.name:
            case "physics" | "transform":
                return user_commands.SetInteraction(self.name)
            case "pause":
                return user_commands.Pause(not world.paused)
            case "reset":
                return user_commands.Reset()
            case "watch":
                return user_commands.PlayDemo(not world.demo)
            case "picture":
                return user_commands.TakePicture()
            case "film":
                return user_commands.Film(world.film_seconds is None)
        return EDITS.get(self.name) or scene_requests().get(self.name)


def button_row(top: int, *names: str, columns: int = 0) -> list[Button]:
    """Buttons side by side, as wide as if there were `columns` of them."""
    left, gap, height, columns = 20, 12, 84, columns or len(names)
    width = (PIXELS[0] - 2 * left - gap * (columns - 1)) // columns
    return [Button(name, (left + k * (width + gap), top, width, height)) for k, name in enumerate(names)]


BUTTONS = [
    *button_row(116, "physics", "transform", "scenes"),
    *button_row(212, "undo", "redo", "copy", "remove"),
    *button_row(308, "smaller", "larger", "turn", "light"),
    *button_row(404, "pause", "reset", "watch", "picture", "film"),
]


@cache
def scene_requests() -> dict[str, user_commands.OpenScene]:
    """The scenes that can be opened, with each choice of their options, by the texts of their buttons."""
    requests = (request for demo in demos() for request in variants(demo))
    return {" ".join((spoken(r.name), *map(str, r.options.values()))): r for r in requests}


@cache
def pages() -> dict[str, list[Button]]:
    """Buttons by page: "" is the first, "scenes", "scenes 2" and so on list the scenes."""
    found, names, k = {"": BUTTONS}, list(scene_requests()), 1
    while names:
        rest = names[SCENES_A_PAGE:]
        shown = [*names[:SCENES_A_PAGE], *(["more"] if rest else []), "back"]
        rows = [shown[i : i + SCENE_COLUMNS] for i in range(0, len(shown), SCENE_COLUMNS)]
        buttons = [b for k, row in enumerate(rows) for b in button_row(116 + 96 * k, *row, columns=SCENE_COLUMNS)]
        found["scenes" if k == 1 else f"scenes {k}"] = buttons
        names, k = rest, k + 1
    return found


def page_after(page: str, button: str) -> str:
    """The page to show once a button of a page was pressed."""
    if button == "scenes" and "scenes" in pages():
        return "scenes"
    if button == "more":
        order = list(pages())
        return order[order.index(page) + 1]
    return ""


def button_at(u: float, v: float, page: str = "") -> Button | None:
    """The button at a point of the panel [px]."""
    return next((b for b in pages()[page] if b.contains(u, v)), None)


def panel_pose(hand: np.ndarray, head: np.ndarray) -> np.ndarray:
    """(4, 4) of the panel, x to its right, y up, z to the eyes, over a hand (4, 4); all in the play space."""
    centre = hand[:3, 3] + [0.0, HEIGHT_OVER_HAND, 0.0]
    z = head[:3, 3] - centre
    z = z / max(np.linalg.norm(z), 1e-6)
    x = np.cross([0.0, 1.0, 0.0], z)
    x = x / np.linalg.norm(x) if np.linalg.norm(x) > 1e-3 else head[:3, 0]
    return pose_matrix(centre, np.column_stack([x, np.cross(z, x), z]))


def project_to_panel(panel: np.ndarray, point: np.ndarray) -> tuple[float, float, float]:
    """Pixel (u, v) of the panel (4, 4) nearest to a point (3,), and its distance before it [m], negative behind."""
    p = panel[:3, :3].T @ (point - panel[:3, 3])
    scale = PIXELS[0] / PANEL_WIDTH
    return 0.5 * PIXELS[0] + scale * p[0], 0.5 * PIXELS[1] - scale * p[1], float(p[2])


def point_on_panel(panel: np.ndarray, u: float, v: float, distance: float = 0.0) -> np.ndarray:
    """Point (3,) at a distance [m] before a pixel of the panel (4, 4): the inverse of `project_to_panel`."""
    scale = PANEL_WIDTH / PIXELS[0]
    return panel[:3, 3] + panel[:3, :3] @ [(u - 0.5 * PIXELS[0]) * scale, (0.5 * PIXELS[1] - v) * scale, distance]


def is_inside(u: float, v: float) -> bool:
    """True if a pixel is on the panel."""
    return 0 <= u < PIXELS[0] and 0 <= v < PIXELS[1]


def ray_hit(panel: np.ndarray, aim: np.ndarray) -> tuple[float, float] | None:
    """Pixel at which a hand (4, 4) points along -z, from before the panel and within MAX_RAY; or None."""
    start, direction = aim[:3, 3], -aim[:3, 2]
    *_, distance = project_to_panel(panel, start)
    approach = -float(direction @ panel[:3, 2])
    if distance <= 0.0 or approach < 1e-3 or distance / approach > MAX_RAY:
        return None
    u, v, _ = project_to_panel(panel, start + direction * (distance / approach))
    return (u, v) if is_inside(u, v) else None


def palm_to_face(c: Controller, head: np.ndarray) -> float:
    """Cosine of the angle between the left palm's normal and the direction to the eyes."""
    palm = c.grip[:3, 0] if c.joints is None else -c.joints.rotation[PALM][:, 1]
    to_eyes = head[:3, 3] - c.grip[:3, 3]
    return float(palm @ to_eyes / max(np.linalg.norm(to_eyes), 1e-6))


def fingertip(c: Controller) -> np.ndarray | None:
    """Tip of the right index finger, or of the finger that a controller stretches out, (3,) in the play space."""
    if c.joints is not None:
        return c.joints.position[INDEX_TIP]
    return None if c.grip is None else c.finger()


class WristPanel:
    """State of the panel. `pose` (4, 4) is None while it is hidden; `hovered` is the button that is pointed at,
    `clicked` whether one was pressed in this frame, `placing` whether the light follows the right hand, `page` which
    buttons it has."""

    def __init__(self):
        self.pinned = self.clicked = self.placing = False
        self.pose: np.ndarray | None = None
        self.hovered: Button | None = None
        self.page = ""
        self._facing = self._trigger = self._captured = False
        self._trigger_places = False  # the light stays where it is when the trigger is released
        self._finger_before: float | None = None  # [m] of the fingertip; None until it is clear of the panel

    def advance(
        self, controllers: list[Controller], head: np.ndarray, world_from_play: np.ndarray, world: WorldView
    ) -> tuple[Controller, list[Command]]:
        """The right hand's controller for everything else, and commands. Poses are in the play space.

        While the right hand is at the panel, or places the light, it grips nothing else.
        """
        self.clicked = False
        left, right = controllers
        if "lower" in left.pressed:
            self.pinned = not (self.pinned or self.pose is not None)
            self._facing = False
        self._update_pose(left, head)
        pulls = max(right.grab, right.pinch) > (RELEASE_BELOW if self._trigger else PRESS_ABOVE)
        began, self._trigger = pulls and not self._trigger, pulls
        button, commands = self._pressed(right, began), []
        if button is not None:
            self.clicked, command = True, button.command(world)
            self.page = page_after(self.page, button.name)
            if command is not None:
                commands.append(command)
            elif button.name == "light" and world.light is not None:
                self.placing, self._trigger_places = True, began
        if began and not self._captured and right.aim is not None and world.editable:
            aim = world_from_play @ right.aim
            hit = world.pick(aim[:3, 3], -aim[:3, 2])
            if hit is not None:
                commands.append(user_commands.Select(hit[1]))
        commands += self._place_light(right, world_from_play, world)
        if self._captured or self.placing:
            right = replace(right, grab=0.0, pinch=0.0)
        self._captured = self._captured and pulls
        return right, commands

    def _update_pose(self, left: Controller, head: np.ndarray) -> None:
        if left.grip is None:  # it stays where it is
            self.pose = self.pose if self.pinned else None
            return
        busy = max(left.grab, left.pinch) > RELEASE_BELOW
        self._facing = not busy and palm_to_face(left, head) > (HIDE_BELOW if self._facing else SHOW_ABOVE)
        self.pose = panel_pose(left.grip, head) if self.pinned or self._facing else None

    def _pressed(self, right: Controller, began: bool) -> Button | None:
        """The button that the right hand has just pressed, by its ray or by its finger."""
        self.hovered = None
        if self.pose is None:
            self._finger_before = None
            return None
        hit = ray_hit(self.pose, right.aim) if right.aim is not None else None
        if hit is not None and (self._captured or began or not self._trigger):
            self.hovered = button_at(*hit, self.page)
            if began:
                self._captured = True
                return self.hovered
        return self._poked(fingertip(right))

    def _poked(self, tip: np.ndarray | None) -> Button | None:
        if tip is None:
            return None
        u, v, distance = project_to_panel(self.pose, tip)
        if distance > CLEARANCE:
            self._finger_before = distance
            return None
        if not is_inside(u, v) or distance < -MAX_PUSH_DEPTH:
            self._finger_before = None
            return None
        self.hovered = button_at(u, v, self.page)
        if distance > 0.0 or self._finger_before is None:
            return None
        self._finger_before = None
        return self.hovered

    def _place_light(self, right: Controller, world_from_play: np.ndarray, world: WorldView) -> list[Command]:
        """The light is where the hand is, until the trigger is released; taken with a finger, until it was pulled and
        released."""
        if not self.placing:
            return []
        if self._trigger:
            self._trigger_places = True
        elif self._trigger_places:
            self.placing = False
            return []
        if right.grip is None:
            return []
        position = (world_from_play @ right.grip)[:3, 3]
        return [user_commands.SetLight(replace(world.light, position=tuple(position.tolist())))]
