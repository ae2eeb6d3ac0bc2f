"""How the panel over the left hand looks: its pixels, painted when what it shows changes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

import cv2
import numpy as np

from display.window import theme
from display.xr.wrist_panel import BUTTONS, PIXELS, Button

BACK, PLATE, OVER = (18, 20, 26), (46, 49, 57), (84, 88, 98)  # sRGB
LIGHT = (252, 194, 116)  # the accent, pointed at
TEXT, DARK = (237, 240, 245), (20, 20, 20)
ACCENT, QUIET = (tuple(round(255 * c) for c in colour[:3]) for colour in (theme.ACCENT, theme.QUIET))
ROUND = 18  # [px] of a corner
TITLE, SMALL, LABEL = 34, 28, 34  # [px] of letters


@dataclass(frozen=True)
class Content:
    """What the panel shows; two that are equal look the same."""

    message: str = ""
    note: str = ""
    warns: bool = False
    rate: str = ""
    on: frozenset = frozenset()  # names of the buttons that are lit
    over: str | None = None


def content_of(world, panel) -> Content:
    """What is to be seen of a world, on a WristPanel."""
    bodies, k = world.bodies(), world.selected
    on = {world.interaction} | ({"pause"} if world.paused else set()) | ({"demo"} if world.demo else set())
    note = bodies[k].name if k is not None and k < len(bodies) else "Hold or point at a body to choose it."
    said = not world.score or str(world.score) in world.message.split()
    score = f"{world.score}   " if world.message and not said else ""
    return Content(
        message=f"{score}{world.message}",
        note="The light follows your hand: let go." if panel.placing else world.notice or note,
        warns=bool(world.notice or panel.placing),
        rate=f"{world.timings.recent_fps():.0f} fps",
        on=frozenset(on | ({"light"} if panel.placing else set())),
        over=panel.over.name if panel.over else None,
    )


@cache
def font():
    """Roboto, which comes with ImGui."""
    import imgui_bundle

    path = Path(imgui_bundle.__file__).parent / "assets" / "fonts" / "Roboto" / "Roboto-Regular.ttf"
    return cv2.FontFace(str(path))


@lru_cache(maxsize=256)
def width_of(text: str, size: int) -> int:
    """[px]"""
    return cv2.getTextSize((PIXELS[0], PIXELS[1]), text, (0, 0), font(), size)[2]


@lru_cache(maxsize=64)
def shortened(text: str, size: int, room: int) -> str:
    """As much of a text as fits, with dots where it was cut."""
    if width_of(text, size) <= room:
        return text
    while text and width_of(text + "...", size) > room:
        text = text[:-1]
    return text.rstrip() + "..."


@lru_cache(maxsize=64)  # rates and scores come and go
def letters(text: str, size: int) -> np.ndarray:
    """Coverage of a line of text, (H, W) float32 in 0..1; its base line is at 3/4 of H."""
    plate = np.zeros((2 * size, width_of(text, size) + 8, 3), np.uint8)
    cv2.putText(plate, text, (4, 3 * size // 2), (255, 255, 255), font(), size)
    return plate[..., 0].astype(np.float32) / 255.0


def write(picture: np.ndarray, text: str, left: int, middle: int, size: int, colour) -> None:
    """A line of text on a picture (H, W, 3 or more) uint8, its small letters around the height `middle` [px]."""
    mask = letters(text, size)
    top = middle - 3 * size // 2 + round(0.36 * size)
    h, w = mask.shape
    place = picture[top : top + h, left : left + w, :3]
    cover = mask[: place.shape[0], : place.shape[1], None]
    place[:] = (place + cover * (np.float32(colour) - place) + 0.5).astype(np.uint8)


@cache
def plate(width: int, height: int) -> np.ndarray:
    """Coverage of a rectangle with round corners, (H, W, 1) float32."""
    big = np.zeros((4 * height, 4 * width), np.uint8)
    r = 4 * ROUND
    cv2.rectangle(big, (r, 0), (4 * width - r - 1, 4 * height - 1), 255, -1)
    cv2.rectangle(big, (0, r), (4 * width - 1, 4 * height - r - 1), 255, -1)
    for x in (r, 4 * width - r - 1):
        for y in (r, 4 * height - r - 1):
            cv2.circle(big, (x, y), r, 255, -1)
    return cv2.resize(big, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32)[..., None] / 255.0


@cache
def face(button: Button, lit: bool, over: bool) -> np.ndarray:
    """A button on the panel, (H, W, 3) uint8."""
    _, _, w, h = button.box
    colour = np.float32((ACCENT, LIGHT)[over] if lit else (PLATE, OVER)[over])
    picture = (np.float32(BACK) + plate(w, h) * (colour - np.float32(BACK)) + 0.5).astype(np.uint8)
    left = (w - width_of(button.text, LABEL)) // 2 - 4
    write(picture, button.text, left, h // 2, LABEL, DARK if lit else TEXT)
    return picture


@cache
def empty() -> np.ndarray:
    """The panel without anything on it, (H, W, 4) uint8."""
    alpha = plate(*PIXELS)
    return (np.concatenate([alpha * np.float32(BACK), 255.0 * alpha], axis=2) + 0.5).astype(np.uint8)


def prepare() -> None:
    """Do now what takes time once: the font, the buttons."""
    for button in BUTTONS:
        for lit in (False, True):
            for over in (False, True):
                face(button, lit, over)
    paint(Content())


def paint(content: Content) -> np.ndarray:
    """The panel, (H, W, 4) uint8 RGBA, colours times alpha, row 0 on top."""
    picture, width = empty().copy(), PIXELS[0]
    rate = width_of(content.rate, SMALL)
    write(picture, shortened(content.message, TITLE, width - rate - 80), 24, 44, TITLE, TEXT)
    write(picture, content.rate, width - rate - 28, 44, SMALL, ACCENT)
    write(picture, shortened(content.note, SMALL, width - 60), 24, 86, SMALL, ACCENT if content.warns else QUIET)
    for button in BUTTONS:
        x, y, w, h = button.box
        picture[y : y + h, x : x + w, :3] = face(button, button.name in content.on, button.name == content.over)
    return picture
