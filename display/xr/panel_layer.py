"""The wrist panel's picture, painted when what it shows changes, and the quad layer that shows it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, lru_cache
from time import monotonic

import cv2
import numpy as np

from display.protocol import WorldView
from display.window.panel.theme import ACCENT, QUIET, font_file
from display.xr.swapchains import QuadLayer
from display.xr.wrist_panel import PANEL_WIDTH, PIXELS, Button, WristPanel, pages

RATE_INTERVAL = 0.5  # [s] between two readings of the frame rate
PANEL_BACKGROUND, BUTTON, HOVERED = (18, 20, 26), (46, 49, 57), (84, 88, 98)  # sRGB
ACCENT_HOVERED = (252, 194, 116)
LIGHT_TEXT, DARK_TEXT = (237, 240, 245), (20, 20, 20)
ACCENT_8BIT, QUIET_8BIT = (tuple(round(255 * c) for c in colour[:3]) for colour in (ACCENT, QUIET))
CORNER_RADIUS = 18  # [px]
MESSAGE_SIZE, LABEL_SIZE, SMALL_SIZE, TINY_SIZE = 34, 34, 28, 24  # [px] of letters


@dataclass(frozen=True)
class PanelContent:
    """Content of the panel; equal contents look the same."""

    message: str = ""
    note: str = ""
    warns: bool = False
    rate: str = ""
    lit: frozenset = frozenset()  # names of the buttons that are on
    hovered: str | None = None
    page: str = ""

    @classmethod
    def of(cls, world: WorldView, panel: WristPanel) -> PanelContent:
        """The content for a world as it is."""
        bodies, k = world.bodies(), world.selected
        lit = {
            "pause": world.paused,
            "watch": world.demo,
            "film": world.film_seconds is not None,
            "light": panel.placing,
            world.interaction: True,
        }
        note = bodies[k].name if k is not None and k < len(bodies) else "Hold a body or point at it to select it."
        if panel.placing:
            note = "The light follows your hand until you release the trigger."
        seconds = world.film_seconds
        film = "" if seconds is None else f"film {int(seconds) // 60}:{int(seconds) % 60:02d}   "
        says_score = not world.score or str(world.score) in world.message.split()
        return cls(
            message=f"{world.score}   {world.message}" if world.message and not says_score else world.message,
            note=note if panel.placing else world.opening or world.notice or note,
            warns=bool(world.opening or world.notice or panel.placing),
            rate=f"{film}{world.timings.recent_fps():.0f} fps",
            lit=frozenset(name for name, on in lit.items() if on),
            hovered=panel.hovered.name if panel.hovered else None,
            page=panel.page,
        )


class PanelLayer:
    """Quad layer of the panel; painted when its content has changed."""

    def __init__(self, runtime, session, gl):
        self._quad = QuadLayer(runtime, session, gl, PIXELS, PANEL_WIDTH)
        self._shown: PanelContent | None = None
        self._rate_read = 0.0  # [s] of monotonic()
        warm_up()

    def show(self, content: PanelContent) -> None:
        """Let the panel look like this; its frame rate is updated less often than it changes."""
        now = monotonic()
        if self._shown is not None and now - self._rate_read < RATE_INTERVAL:
            content = replace(content, rate=self._shown.rate)
        else:
            self._rate_read = now
        if content != self._shown:
            self._quad.draw(paint(content))
            self._shown = content

    def layer(self, space, pose: np.ndarray):
        """The composition layer, at `pose` (4, 4) in `space`."""
        return self._quad.layer(space, pose)

    def close(self) -> None:
        """Give the textures back."""
        self._quad.close()


@cache
def font():
    """Roboto, which comes with ImGui."""
    return cv2.FontFace(str(font_file()))


@lru_cache(maxsize=256)
def text_width(text: str, size: int) -> int:
    """Width of a line of text [px]."""
    return cv2.getTextSize((PIXELS[0], PIXELS[1]), text, (0, 0), font(), size)[2]


@lru_cache(maxsize=64)
def shortened(text: str, size: int, max_width: int) -> str:
    """As much of a text as fits into `max_width` [px], with dots where it was cut."""
    if text_width(text, size) <= max_width:
        return text
    while text and text_width(text + "...", size) > max_width:
        text = text[:-1]
    return text.rstrip() + "..."


@lru_cache(maxsize=64)  # rates and scores come and go
def text_mask(text: str, size: int) -> np.ndarray:
    """Coverage of a line of text, (H, W) float32 in 0..1; its base line is at 3/4 of H."""
    image = np.zeros((2 * size, text_width(text, size) + 8, 3), np.uint8)
    cv2.putText(image, text, (4, 3 * size // 2), (255, 255, 255), font(), size)
    return image[..., 0].astype(np.float32) / 255.0


def write(picture: np.ndarray, text: str, left: int, middle: int, size: int, colour) -> None:
    """Write a line of text on a picture (H, W, 3 or more) uint8, its small letters around the height `middle` [px]."""
    mask = text_mask(text, size)
    top = middle - 3 * size // 2 + round(0.36 * size)
    h, w = mask.shape
    area = picture[top : top + h, left : left + w, :3]
    cover = mask[: area.shape[0], : area.shape[1], None]
    area[:] = (area + cover * (np.float32(colour) - area) + 0.5).astype(np.uint8)


@cache
def rounded_rectangle(width: int, height: int) -> np.ndarray:
    """Coverage of a rectangle with round corners, (H, W, 1) float32."""
    big = np.zeros((4 * height, 4 * width), np.uint8)
    r = 4 * CORNER_RADIUS
    cv2.rectangle(big, (r, 0), (4 * width - r - 1, 4 * height - 1), 255, -1)
    cv2.rectangle(big, (0, r), (4 * width - 1, 4 * height - r - 1), 255, -1)
    for x in (r, 4 * width - r - 1):
        for y in (r, 4 * height - r - 1):
            cv2.circle(big, (x, y), r, 255, -1)
    return cv2.resize(big, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32)[..., None] / 255.0


@cache
def button_picture(button: Button, lit: bool, hovered: bool) -> np.ndarray:
    """A button on the panel, (H, W, 3) uint8."""
    _, _, w, h = button.box
    colour = np.float32((ACCENT_8BIT, ACCENT_HOVERED)[hovered] if lit else (BUTTON, HOVERED)[hovered])
    background = np.float32(PANEL_BACKGROUND)
    picture = (background + rounded_rectangle(w, h) * (colour - background) + 0.5).astype(np.uint8)
    text = button.name[:1].upper() + button.name[1:]
    size = next((s for s in (LABEL_SIZE, SMALL_SIZE) if text_width(text, s) < w - 16), TINY_SIZE)
    text = shortened(text, size, w - 16)
    left = (w - text_width(text, size)) // 2 - 4
    write(picture, text, left, h // 2, size, DARK_TEXT if lit else LIGHT_TEXT)
    return picture


@cache
def empty_panel() -> np.ndarray:
    """The panel without anything on it, (H, W, 4) uint8."""
    alpha = rounded_rectangle(*PIXELS)
    return (np.concatenate([alpha * np.float32(PANEL_BACKGROUND), 255.0 * alpha], axis=2) + 0.5).astype(np.uint8)


def warm_up() -> None:
    """Paint everything once that is kept: the font, the buttons."""
    for button in (b for buttons in pages().values() for b in buttons):
        for lit in (False, True):
            for hovered in (False, True):
                button_picture(button, lit, hovered)
    paint(PanelContent())


def paint(content: PanelContent) -> np.ndarray:
    """The panel, (H, W, 4) uint8 RGBA, colours times alpha, row 0 on top."""
    picture, width = empty_panel().copy(), PIXELS[0]
    rate = text_width(content.rate, SMALL_SIZE)
    write(picture, shortened(content.message, MESSAGE_SIZE, width - rate - 80), 24, 44, MESSAGE_SIZE, LIGHT_TEXT)
    write(picture, content.rate, width - rate - 28, 44, SMALL_SIZE, ACCENT_8BIT)
    colour = ACCENT_8BIT if content.warns else QUIET_8BIT
    write(picture, shortened(content.note, SMALL_SIZE, width - 60), 24, 86, SMALL_SIZE, colour)
    for button in pages()[content.page]:
        x, y, w, h = button.box
        lit, hovered = button.name in content.lit, button.name == content.hovered
        picture[y : y + h, x : x + w, :3] = button_picture(button, lit, hovered)
    return picture
