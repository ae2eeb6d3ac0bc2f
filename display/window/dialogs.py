"""Dialogs over the picture: files to open, the length between two points, which way is up, the menu of scenes."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from imgui_bundle import imgui
from imgui_bundle import portable_file_dialogs as system_dialogs

from assets.splat_files import MESHES, SPLATS, kind_of
from core.errors import BadInput
from core.measured_length import length_of
from display.panel import chosen_by_list, demos, line_of, picture_file, spoken
from display.preferences import PathText, Preferences
from display.protocol import WorldView
from display.user_commands import AddBody, Command, LoadState, Measure, OpenScene, SwapRoom, TurnUp
from display.window.widgets import ACCENT, FIXED, MARGIN, QUIET, button_grid, heading, paragraph, pixels, place_window
from scenes.registry import Demo

FILE_WIDTH, LENGTH_WIDTH = 460.0, 300.0  # [px] of the dialogs for files, for a length
SCENE_WIDTH, SCENE_PICTURE = 350.0, (128.0, 72.0)  # [px] of a scene in the menu, of its picture
TITLE = "Open a file"
FILTERS = ["Bodies, rooms and states", " ".join(f"*{suffix}" for suffix in (*SPLATS, *MESHES, ".h5")), "All files", "*"]
LINUX_DIALOGS = ("zenity", "kdialog", "qarma", "matedialog")  # programs that portable_file_dialogs starts


def begin_dialog(name: str, width: float, *, foot: bool = False) -> None:
    """Begin an ImGui window without a title, `width` [px] wide, in the middle or (`foot`) at the lower edge."""
    place_window(foot=foot)
    imgui.set_next_window_size((min(pixels(width), imgui.get_io().display_size.x), 0))
    imgui.begin(name, None, FIXED)


def text_field(name: str, typed: str, *, focus: bool, enter: str) -> tuple[str, bool, bool]:
    """Draw a field with the buttons `enter` and Cancel under it; its text, whether it was entered or given up."""
    if focus:
        imgui.set_keyboard_focus_here()
    imgui.set_next_item_width(-1)
    entered, typed = imgui.input_text(f"##{name}", typed, imgui.InputTextFlags_.enter_returns_true)
    pressed = button_grid({enter: "(Enter)", "Cancel": "(Esc)"}, 2)
    cancelled = pressed == "Cancel" or imgui.is_key_pressed(imgui.Key.escape)
    return typed, not cancelled and (entered or pressed == enter), cancelled


def texture_of(gl, picture: np.ndarray):
    """A texture with a picture (H, W, 3) uint8 RGB."""
    return gl.texture(picture.shape[1::-1], 3, picture.tobytes(), alignment=1)


class OpenDialog:
    """The files that the user wants to open. `shown` while it asks something; `draw` gives the commands.

    A body joins the play, a room replaces the scene's, a state is loaded; of a splat the user is asked what it is.
    """

    def __init__(self, preferences: Preferences):
        self._preferences, self.shown = preferences, False
        self._typed, self._problem, self._focus = "", "", True
        self._asked: list[Path] = []  # files that may be either
        self._commands: list[Command] = []
        self._system = None  # the system's dialog while it is open

    def ask(self) -> None:
        """Let the user choose a file."""
        folder = self._preferences.get("folder", PathText, "") or os.getcwd()
        if not sys.platform.startswith("linux") or any(map(shutil.which, LINUX_DIALOGS)):
            self._system = system_dialogs.open_file(TITLE, folder, FILTERS)
        else:
            self.shown, self._problem = True, ""
            self._typed = self._typed or os.path.join(folder, "")

    def offer(self, paths: Iterable[str]) -> None:
        """Open these files, or ask what they are to be."""
        for path in map(Path, paths):
            try:
                kind = kind_of(path)
            except BadInput as e:
                self.shown, self._problem, self._focus = True, str(e), True
                continue
            self._preferences.set("folder", str(path.absolute().parent))
            if kind == "either":
                self._asked.append(path)
                self.shown = True
            else:
                self._open(path, kind)

    def close(self) -> None:
        """Close the dialog and forget what was asked."""
        self.shown, self._problem, self._asked = False, "", []

    def draw(self) -> list[Command]:
        """Draw the dialog; the commands of what was chosen."""
        if self._system is not None and self._system.ready(0):
            chosen, self._system = self._system.result(), None
            self.offer(chosen)
        if self.shown:
            self._draw()
        commands, self._commands = self._commands, []
        return commands

    def _open(self, path: Path, kind: str) -> None:
        absolute = str(path.absolute())
        self._commands.append({"body": AddBody, "room": SwapRoom, "state": LoadState}[kind](absolute))

    def _draw(self) -> None:
        begin_dialog("open", FILE_WIDTH)
        heading(TITLE)
        if self._problem:
            paragraph(self._problem, ACCENT)
        if self._asked:
            self._draw_question(self._asked[0])
        else:
            self._draw_field()
        imgui.end()

    def _draw_question(self, path: Path) -> None:
        imgui.text_colored(QUIET, f"{path.name} is a splat. What is it here?")
        tips = {"A body": "It falls onto the play.", "The room": "The scene begins anew in it.", "Cancel": "(Esc)"}
        pressed = button_grid(tips, 3)
        if pressed == "Cancel":
            self.close()
        elif pressed is not None:
            self._open(self._asked.pop(0), "body" if pressed == "A body" else "room")
            self.shown = bool(self._asked)

    def _draw_field(self) -> None:
        imgui.text_colored(QUIET, "Drop a splat, a mesh or an asset here, or type its path.")
        # A field of another name begins anew: with its text selected, which the next letters replace.
        focus, self._focus = self._focus or imgui.is_window_appearing(), False
        self._typed, entered, cancelled = text_field(f"path{self._problem}", self._typed, focus=focus, enter="Open")
        if cancelled:
            self.close()
        elif entered:
            self.shown, self._problem = False, ""
            self.offer([os.path.expanduser(self._typed.strip())])


class LengthDialog:
    """Asks for a length once there are two points; `draw` gives the command, and whether it is over."""

    def __init__(self):
        self._typed, self._problem, self._shown = "", "", False

    def draw(self, points: Sequence[np.ndarray] | None) -> tuple[list[Command], bool]:
        """Draw the dialog for the points (3,) [m], if there are two of them."""
        if points is None or len(points) < 2:
            self._typed, self._problem, self._shown = "", "", False
            return [], False
        begin_dialog("length", LENGTH_WIDTH, foot=True)
        imgui.text("How long is it really?")
        now = float(np.linalg.norm(np.subtract(points[1], points[0])))
        imgui.text_colored(QUIET, f"{now:.3g} m now; type 1.2 or 35 cm")
        if self._problem:
            paragraph(self._problem, ACCENT)
        focus, self._shown = not self._shown, True
        self._typed, entered, cancelled = text_field("length", self._typed, focus=focus, enter="Set")
        imgui.end()
        if not entered:
            return [], cancelled
        try:
            start, end = (tuple(np.asarray(p).tolist()) for p in points)
            return [Measure(start, end, length_of(self._typed))], True
        except BadInput as e:
            self._problem, self._shown = str(e), False
            return [], False


class UpChoice:
    """A strip of pictures in which the user chooses which way is up, while the world offers several.

    gl  the context (moderngl) of its pictures
    """

    def __init__(self, gl):
        self._gl = gl
        self._pictures: object = None  # of which the textures are
        self._textures: list = []

    def draw(self, world: WorldView) -> list[Command]:
        """Draw the strip; the command of the picture that was pressed."""
        choices = world.up_choices
        if not choices:
            return []
        if choices is not self._pictures:
            for texture in self._textures:
                texture.release()
            self._pictures = choices
            self._textures = [texture_of(self._gl, picture) for _, _, picture in choices]
        area, flags = imgui.get_io().display_size, imgui.WindowFlags_
        place_window(foot=True)
        imgui.set_next_window_size_constraints((0, 0), (area.x - 2 * pixels(MARGIN), area.y))
        imgui.begin("up", None, FIXED | flags.always_auto_resize | flags.horizontal_scrollbar)
        imgui.text("Which way is up? Press the picture that stands upright (Y tries the next).")
        pressed = []
        for k, ((up, chance, picture), texture) in enumerate(zip(choices, self._textures, strict=True)):
            if k:
                imgui.same_line()
            imgui.begin_group()
            size = tuple(map(pixels, picture.shape[1::-1]))
            if imgui.image_button(up, imgui.ImTextureRef(texture.glo), size):
                pressed = [TurnUp(up)]
            imgui.text_colored(QUIET, f"{up}   {chance:.0%}")
            imgui.end_group()
        imgui.end()
        return pressed


class SceneMenu:
    """The scenes, each with a picture, a line and its options; `draw` gives the command of the one that was chosen.

    gl  the context (moderngl) of its pictures
    """

    def __init__(self, gl):
        self._gl = gl
        self._options: dict[str, dict] = {}  # of each scene, as chosen here
        self._textures: dict[Path, object] = {}

    def draw(self) -> list[Command]:
        """Draw the menu; the command to open a scene."""
        area, edge = imgui.get_io().display_size, pixels(MARGIN)
        place_window()
        columns = 2 if area.x >= pixels(2 * SCENE_WIDTH) + 2 * edge else 1
        width = min(columns * pixels(SCENE_WIDTH) + 2 * imgui.get_style().window_padding.x, area.x - 2 * edge)
        imgui.set_next_window_size_constraints((width, 0), (width, area.y - 2 * edge))
        imgui.set_next_window_bg_alpha(0.97)
        imgui.begin("scenes", None, FIXED | imgui.WindowFlags_.always_auto_resize)
        heading("Scenes")
        commands: list[Command] = []
        if imgui.begin_table("scenes", columns, imgui.TableFlags_.sizing_stretch_same):
            for demo in demos():
                imgui.table_next_column()
                commands += self._cell(demo)
            imgui.end_table()
        imgui.end()
        return commands

    def _cell(self, demo: Demo) -> list[Command]:
        request = OpenScene(demo.name, dict(self._options.get(demo.name, {})))
        size, begin = tuple(map(pixels, SCENE_PICTURE)), imgui.get_cursor_pos()
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
        paragraph(line_of(demo))
        imgui.end_group()
        imgui.pop_id()
        return [request] if pressed else []

    def _texture(self, request: OpenScene):
        """The picture as a texture; None if there is none, or none that can be read: a captured room may hold any."""
        path = picture_file(request)
        if path is not None and path not in self._textures:
            import cv2

            picture = cv2.imread(str(path))
            self._textures[path] = None if picture is None else texture_of(self._gl, picture[..., ::-1])
        return self._textures.get(path)
