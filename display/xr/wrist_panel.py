"""The panel over the left hand: its pose, its buttons, the right hand's interaction with it, and its picture.

It appears when the left palm turns to the face, or is pinned there by a button. The right hand points at it and pulls
the trigger, or pushes a finger through it; then it grips nothing. Its buttons are some of those that the panel of the
window has (display/panel.py), and pages that list the scenes. Positions on the panel are in pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from time import monotonic

import cv2
import numpy as np

from display import user_commands
from display.panel import (
    ACCENT,
    EDIT_BUTTONS,
    QUIET,
    Button,
    Choice,
    Panel,
    buttons_of,
    called,
    demos,
    font_file,
    play_section,
    score_and_message,
    spoken,
    variants,
)
from display.protocol import WorldView
from display.user_commands import Command
from display.xr.actions import PRESS_ABOVE, RELEASE_BELOW, Controller
from display.xr.hand_joints import INDEX_TIP, PALM
from display.xr.poses import pose_matrix, position_rotation, rotation_facing
from display.xr.swapchains import ColourTarget, set_sub_image

Box = tuple[int, int, int, int]  # left, top, width, height [px]
PIXELS = (800, 512)  # (width, height)
PANEL_WIDTH = 0.28  # [m]
HEIGHT_OVER_HAND = 0.14  # [m] of its middle
SHOW_ABOVE, HIDE_BELOW = 0.85, 0.6  # cosine of the angle between the palm and the direction to the eyes
MAX_RAY = 3.0  # [m] to point at it
MAX_PUSH_DEPTH = 0.06  # [m] behind the panel beyond which a finger has passed by
CLEARANCE = 0.015  # [m] before the panel to which a finger must come back to push again
SCENE_COLUMNS, SCENES_A_PAGE = 3, 10  # of four rows, in which "More" and "Back" have their places
SCENES, MORE, BACK, LIGHT = "Scenes", "More", "Back", "Light"  # buttons that the window's panel does not have
ROWS = (
    ("Physics", "Transform", SCENES),
    ("Undo", "Redo", "Copy", "Remove"),
    ("Smaller", "Larger", "Turn", LIGHT),
    ("Pause", "Reset", "Watch", "Picture", "Film"),
)
RATE_INTERVAL = 0.5  # [s] between two readings of the frame rate
PANEL_BACKGROUND, BUTTON, HOVERED = (18, 20, 26), (46, 49, 57), (84, 88, 98)  # sRGB
ACCENT_HOVERED = (252, 194, 116)
LIGHT_TEXT, DARK_TEXT = (237, 240, 245), (20, 20, 20)
ACCENT_8BIT, QUIET_8BIT = (tuple(round(255 * c) for c in colour[:3]) for colour in (ACCENT, QUIET))
CORNER_RADIUS = 18  # [px]
MESSAGE_SIZE, LABEL_SIZE, SMALL_SIZE, TINY_SIZE = 34, 34, 28, 24  # [px] of letters


def button_rows(rows: Sequence[Sequence[str]], columns: int = 0) -> dict[str, Box]:
    """Places of buttons in rows from the top, in each as wide as if it had `columns` of them."""
    left, gap, height, placed = 20, 12, 84, {}
    for top, names in zip(range(116, PIXELS[1], height + gap), rows, strict=False):
        count = columns or len(names)
        width = (PIXELS[0] - 2 * left - gap * (count - 1)) // count
        placed |= {name: (left + k * (width + gap), top, width, height) for k, name in enumerate(names)}
    return placed


BUTTONS = button_rows(ROWS)


def described_buttons(world: WorldView, panel: Panel) -> dict[str, Button]:
    """Commands that the window's panel has under these names, and whether each is on."""
    play = play_section(world)
    (grip,) = (row for row in play.rows if isinstance(row, Choice))
    found = {name: Button(name, grip.choose(name), on=name == grip.current) for name in grip.options}
    return found | {b.name: b for b in EDIT_BUTTONS} | buttons_of([play, panel.keep_section(world)])


@cache
def scene_requests() -> dict[str, user_commands.OpenScene]:
    """The scenes that can be opened, with each choice of their options, by the texts of their buttons."""
    requests = (request for demo in demos() for request in variants(demo))
    return {" ".join((spoken(r.name), *map(str, r.options.values()))): r for r in requests}


@cache
def pages() -> list[dict[str, Box]]:
    """The buttons of each page: the first one, then those that list the scenes."""
    names, found = list(scene_requests()), [BUTTONS]
    for first in range(0, len(names), SCENES_A_PAGE):
        last = first + SCENES_A_PAGE >= len(names)
        shown = [*names[first : first + SCENES_A_PAGE], *([] if last else [MORE]), BACK]
        rows = [shown[i : i + SCENE_COLUMNS] for i in range(0, len(shown), SCENE_COLUMNS)]
        found.append(button_rows(rows, SCENE_COLUMNS))
    return found


def page_after(page: int, button: str) -> int:
    """The page to show once a button of a page was pressed."""
    if button == SCENES:
        return min(1, len(pages()) - 1)
    return page + 1 if button == MORE else 0


def button_at(u: float, v: float, page: int) -> str | None:
    """The button at a point of the panel [px]."""
    boxes = pages()[page].items()
    return next((name for name, (x, y, w, h) in boxes if x <= u < x + w and y <= v < y + h), None)


def panel_pose(hand: np.ndarray, head: np.ndarray) -> np.ndarray:
    """(4, 4) of the panel, x to its right, y up, z to the eyes, over a hand (4, 4); all in the play space."""
    centre = hand[:3, 3] + [0.0, HEIGHT_OVER_HAND, 0.0]
    to_eyes = head[:3, 3] - centre
    to_eyes = to_eyes / max(np.linalg.norm(to_eyes), 1e-6)
    return pose_matrix(centre, rotation_facing(to_eyes, (0.0, 1.0, 0.0), head[:3, 0]))


def project_to_panel(panel: np.ndarray, point: np.ndarray) -> tuple[float, float, float]:
    """Pixel (u, v) of the panel (4, 4) nearest to a point (3,), and its distance before it [m], negative behind."""
    p = panel[:3, :3].T @ (point - panel[:3, 3])
    scale = PIXELS[0] / PANEL_WIDTH
    return 0.5 * PIXELS[0] + scale * p[0], 0.5 * PIXELS[1] - scale * p[1], float(p[2])


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
        self.hovered: str | None = None
        self.page = 0
        self.described = Panel()
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
            self.clicked = True
            commands += self._commands(button, world)
            self.page = page_after(self.page, button)
            if button == LIGHT and world.light is not None:
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

    def _commands(self, name: str, world: WorldView) -> Sequence[Command]:
        """The commands of a button; none of the light's and of those that turn a page."""
        if name in scene_requests():
            return [scene_requests()[name]]
        button = described_buttons(world, self.described).get(name)
        return [] if button is None else button.commands

    def _update_pose(self, left: Controller, head: np.ndarray) -> None:
        if left.grip is None:  # it stays where it is
            self.pose = self.pose if self.pinned else None
            return
        busy = max(left.grab, left.pinch) > RELEASE_BELOW
        self._facing = not busy and palm_to_face(left, head) > (HIDE_BELOW if self._facing else SHOW_ABOVE)
        self.pose = panel_pose(left.grip, head) if self.pinned or self._facing else None

    def _pressed(self, right: Controller, began: bool) -> str | None:
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

    def _poked(self, tip: np.ndarray | None) -> str | None:
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
        """Move the light with the hand until the trigger is released; if a finger took it, until the trigger was
        pulled and released."""
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


@dataclass(frozen=True)
class PanelContent:
    """Content of the panel; equal contents look the same."""

    message: str = ""
    note: str = ""
    warns: bool = False
    rate: str = ""
    lit: frozenset = frozenset()  # names of the buttons that are on
    hovered: str | None = None
    page: int = 0

    @classmethod
    def of(cls, world: WorldView, panel: WristPanel) -> PanelContent:
        """The content for a world as it is."""
        bodies, k, seconds = world.bodies(), world.selected, world.film_seconds
        lit = {name for name, button in described_buttons(world, panel.described).items() if button.on}
        selected = k is not None and k < len(bodies)
        note = called(bodies[k].name) if selected else "Hold a body or point at it to select it."
        news = "The light follows your hand until you release the trigger." if panel.placing else ""
        news = news or world.opening or world.notice
        film = "" if seconds is None else f"film {int(seconds) // 60}:{int(seconds) % 60:02d}   "
        return cls(
            message="   ".join(filter(None, score_and_message(world))),
            note=news or note,
            warns=bool(news),
            rate=f"{film}{world.timings.recent_fps():.0f} fps",
            lit=frozenset(lit | {LIGHT} if panel.placing else lit),
            hovered=panel.hovered,
            page=panel.page,
        )


class PanelLayer:
    """Quad layer of the panel, which the runtime lays into the world itself, as sharp as the headset can.

    It is painted when its content has changed.
    """

    def __init__(self, runtime, session, gl):
        self.xr = runtime.xr
        self._target = ColourTarget(runtime, session, gl, PIXELS, opaque=False)
        self._texture = gl.texture(PIXELS, 4)
        self._shown: PanelContent | None = None
        self._rate_read = 0.0  # [s] of monotonic()
        paint(PanelContent())  # reads the font

    def show(self, content: PanelContent) -> None:
        """Let the panel look like this; its frame rate is updated less often than it changes."""
        now = monotonic()
        if self._shown is not None and now - self._rate_read < RATE_INTERVAL:
            content = replace(content, rate=self._shown.rate)
        else:
            self._rate_read = now
        if content != self._shown:
            self._texture.write(paint(content))
            self._target.draw(self._texture, first_row=0, size=PIXELS)
            self._shown = content

    def layer(self, space, pose: np.ndarray):
        """The composition layer, centred at `pose` (4, 4) in `space`, facing its +z."""
        xr = self.xr
        quad = xr.CompositionLayerQuad(
            layer_flags=xr.CompositionLayerFlags.BLEND_TEXTURE_SOURCE_ALPHA_BIT,
            space=space,
            eye_visibility=xr.EyeVisibility.BOTH,
        )
        set_sub_image(quad.sub_image, self._target.swapchain, PIXELS)
        position, (w, x, y, z) = position_rotation(pose)
        quad.pose.position[:] = list(position)
        quad.pose.orientation[:] = [x, y, z, w]
        quad.size.width, quad.size.height = PANEL_WIDTH, PANEL_WIDTH * PIXELS[1] / PIXELS[0]
        return quad

    def close(self) -> None:
        """Give the textures back."""
        self._texture.release()
        self._target.close()


@cache
def font():
    """Roboto, which comes with ImGui."""
    return cv2.FontFace(str(font_file()))


@lru_cache(maxsize=256)
def text_width(text: str, size: int) -> int:
    """Width of a line of text [px]."""
    return cv2.getTextSize(PIXELS, text, (0, 0), font(), size)[2]


@lru_cache(maxsize=64)
def shortened(text: str, size: int, max_width: int) -> str:
    """As much of a text as fits into `max_width` [px], with dots where it was cut."""
    if text_width(text, size) <= max_width:
        return text
    while text and text_width(text + "...", size) > max_width:
        text = text[:-1]
    return text.rstrip() + "..."


def write(picture: np.ndarray, text: str, left: int, middle: int, size: int, colour) -> None:
    """Write a line of text on a picture (H, W, 3) uint8, its small letters around the height `middle` [px]."""
    cv2.putText(picture, text, (left, middle + round(0.36 * size)), colour, font(), size)


def fill_rounded(picture: np.ndarray, box: Box, colour) -> None:
    """Fill a box of a picture with round corners."""
    x, y, w, h = box
    r = CORNER_RADIUS
    cv2.rectangle(picture, (x + r, y), (x + w - r - 1, y + h - 1), colour, -1)
    cv2.rectangle(picture, (x, y + r), (x + w - 1, y + h - r - 1), colour, -1)
    for corner in ((a, b) for a in (x + r, x + w - r - 1) for b in (y + r, y + h - r - 1)):
        cv2.circle(picture, corner, r - 1, colour, -1, cv2.LINE_AA)  # its soft edge is one pixel more


def paint_button(picture: np.ndarray, name: str, box: Box, *, lit: bool, hovered: bool) -> None:
    """Paint a button on the panel (H, W, 3) uint8."""
    x, y, w, h = box
    fill_rounded(picture, box, (ACCENT_8BIT, ACCENT_HOVERED)[hovered] if lit else (BUTTON, HOVERED)[hovered])
    size = next((s for s in (LABEL_SIZE, SMALL_SIZE) if text_width(name, s) < w - 16), TINY_SIZE)
    text = shortened(name, size, w - 16)
    write(picture, text, x + (w - text_width(text, size)) // 2, y + h // 2, size, DARK_TEXT if lit else LIGHT_TEXT)


@cache
def coverage() -> np.ndarray:
    """Alpha of the panel, (H, W) uint8."""
    alpha = np.zeros(PIXELS[::-1], np.uint8)
    fill_rounded(alpha, (0, 0, *PIXELS), 255)
    return alpha


def paint(content: PanelContent) -> np.ndarray:
    """The panel, (H, W, 4) uint8 RGBA, colours times alpha, row 0 on top."""
    picture, width = np.zeros((*PIXELS[::-1], 3), np.uint8), PIXELS[0]
    fill_rounded(picture, (0, 0, *PIXELS), PANEL_BACKGROUND)
    rate = text_width(content.rate, SMALL_SIZE)
    write(picture, shortened(content.message, MESSAGE_SIZE, width - rate - 80), 28, 44, MESSAGE_SIZE, LIGHT_TEXT)
    write(picture, content.rate, width - rate - 24, 44, SMALL_SIZE, ACCENT_8BIT)
    colour = ACCENT_8BIT if content.warns else QUIET_8BIT
    write(picture, shortened(content.note, SMALL_SIZE, width - 60), 28, 86, SMALL_SIZE, colour)
    for name, box in pages()[content.page].items():
        paint_button(picture, name, box, lit=name in content.lit, hovered=name == content.hovered)
    return np.dstack([picture, coverage()])
