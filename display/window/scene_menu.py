"""The menu of scenes over the picture (F2): a picture and a line for each, and its options."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from assets.room_folder import PICTURE as ROOM_PICTURE
from display.protocol import WorldView
from display.user_commands import Command, OpenScene
from display.window.panel.theme import ACCENT, MARGIN, QUIET, TITLE_SIZE
from display.window.panel.widgets import pixels
from scenes import registry
from scenes.registry import Demo, SceneOption

PICTURES = Path(registry.__file__).parent / "pictures"
CELL, PICTURE = 350.0, (128.0, 72.0)  # [px] of the width of a scene, of its picture


@cache
def demos() -> tuple[Demo, ...]:
    """The scenes that can be played; files that are added while the program runs are not among them."""
    return tuple(demo for demo in registry.demos() if demo.build is not None)


def chosen_by_list(demo: Demo) -> list[SceneOption]:
    """The options of a scene that are one of several texts."""
    return [option for option in demo.options if option.choices]


def variants(demo: Demo) -> list[OpenScene]:
    """A scene with each choice of its first option that has some; or the scene alone."""
    options = chosen_by_list(demo)[:1]
    return [OpenScene(demo.name, {o.name: c}) for o in options for c in o.choices] or [OpenScene(demo.name)]


def spoken(name: str) -> str:
    """A scene's name as it is read: "Ring toss"."""
    return name.replace("_", " ").capitalize()


def line_of(demo: Demo) -> str:
    """The summary of a scene, without its name and what belongs to the command line."""
    return re.split(r"; | \(|, here or ", demo.summary.partition(": ")[2] or demo.summary)[0].rstrip(".")


def picture_file(request: OpenScene) -> Path | None:
    """The picture of a scene with these options, or that of the scene or captured room; None if there is none."""
    if registry.is_room(request.name):
        path = Path(request.name) / ROOM_PICTURE
        return path if path.is_file() else None
    names = ("_".join((request.name, *map(str, request.options.values()))), request.name)
    return next((path for path in (PICTURES / f"{name}.jpg" for name in names) if path.is_file()), None)


class SceneMenu:
    """`shown` while it is open; `draw` gives the command of the scene that was chosen.

    gl  the context (moderngl) of its pictures
    """

    def __init__(self, gl):
        self._gl = gl
        self.shown = False
        self._options: dict[str, dict] = {}  # of each scene, as chosen here
        self._textures: dict[Path, object] = {}

    def draw(self, world: WorldView) -> list[Command]:
        """Draw the menu; the command to open a scene."""
        if not self.shown:
            return []
        from imgui_bundle import imgui

        area, edge = imgui.get_io().display_size, pixels(MARGIN)
        imgui.set_next_window_pos((0.5 * area.x, 0.5 * area.y), 0, (0.5, 0.5))
        columns = 2 if area.x >= pixels(2 * CELL) + 2 * edge else 1
        width = min(columns * pixels(CELL) + 2 * imgui.get_style().window_padding.x, area.x - 2 * edge)
        imgui.set_next_window_size_constraints((width, 0), (width, area.y - 2 * edge))
        flags = imgui.WindowFlags_
        fixed = flags.no_title_bar | flags.no_resize | flags.no_move | flags.no_saved_settings
        imgui.set_next_window_bg_alpha(0.97)
        imgui.begin("scenes", None, fixed | flags.always_auto_resize)
        imgui.push_font(None, TITLE_SIZE)
        imgui.text("Scenes")
        imgui.pop_font()
        commands: list[Command] = []
        if imgui.begin_table("scenes", columns, imgui.TableFlags_.sizing_stretch_same):
            for demo in demos():
                imgui.table_next_column()
                commands += self._cell(demo)
            imgui.end_table()
        imgui.end()
        if commands:
            self.shown = False
        return commands

    def _cell(self, demo: Demo) -> list[Command]:
        """Draw a scene: its picture, which is a button, name, summary and options."""
        from imgui_bundle import imgui

        request = OpenScene(demo.name, dict(self._options.get(demo.name, {})))
        size, begin = tuple(map(pixels, PICTURE)), imgui.get_cursor_pos()
        imgui.push_id(demo.name)
        pressed = imgui.selectable("##row", False, imgui.SelectableFlags_.allow_overlap, (0, size[1]))[0]
        imgui.set_cursor_pos(begin)
        texture = self._texture(request)
        if texture is None:
            imgui.dummy(size)
        else:
            imgui.image(imgui.ImTextureRef(texture.glo), size)
        imgui.same_line()
        imgui.begin_group()
        imgui.text_colored(ACCENT, spoken(demo.name))
        for option in chosen_by_list(demo):
            imgui.same_line()
            current = str(request.options.get(option.name, option.default))
            imgui.set_next_item_width(pixels(90))
            if imgui.begin_combo(f"##{option.name}", current):
                for text in option.choices:
                    if imgui.selectable(text, text == current)[0]:
                        self._options.setdefault(demo.name, {})[option.name] = text
                imgui.end_combo()
        imgui.push_text_wrap_pos(0.0)
        imgui.text_colored(QUIET, line_of(demo))
        imgui.pop_text_wrap_pos()
        imgui.end_group()
        imgui.pop_id()
        return [request] if pressed else []

    def _texture(self, request: OpenScene):
        """The picture as a texture; None if there is none."""
        path = picture_file(request)
        if path is not None and path not in self._textures:
            import cv2
            import numpy as np

            pixels_ = cv2.imread(str(path))
            if pixels_ is None:  # of a captured room, which may hold anything
                return None
            pixels_ = np.ascontiguousarray(pixels_[..., ::-1])
            texture = self._gl.texture(pixels_.shape[1::-1], 3, pixels_.tobytes(), alignment=1)
            self._textures[path] = texture
        return self._textures.get(path)
