"""Dialogs over the picture: files to open, the length between two points, which way is up, the menu of scenes."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from assets.splat_files import MESHES, SPLATS, kind_of
from core.errors import BadInput
from core.measured_length import length_of
from display.panel import chosen_by_list, demos, line_of, picture_file, spoken
from display.preferences import PathText, Preferences
from display.protocol import WorldView
from display.user_commands import AddBody, Command, LoadState, Measure, OpenScene, SwapRoom, TurnUp
from display.window.widgets import ACCENT, MARGIN, QUIET, TITLE_SIZE, button_grid, pixels
from scenes.registry import Demo

FILE_WIDTH, LENGTH_WIDTH = 460.0, 300.0  # [px] of the dialogs for files, for a length
FOOT = 60.0  # [px] under a dialog at the lower edge, where hints stand
SCENE_WIDTH, SCENE_PICTURE = 350.0, (128.0, 72.0)  # [px] of a scene in the menu, of its picture
TITLE = "Open a file"
FILTERS = ["Bodies, rooms and states", " ".join(f"*{suffix}" for suffix in (*SPLATS, *MESHES, ".h5")), "All files", "*"]
LINUX_DIALOGS = ("zenity", "kdialog", "qarma", "matedialog")  # programs that portable_file_dialogs starts


def begin_dialog(name: str, width: float, *, foot: bool = False) -> None:
    """Begin an ImGui window without a title, `width` [px] wide, in the middle or (`foot`) at the lower edge."""
    from imgui_bundle import imgui

    area, flags = imgui.get_io().display_size, imgui.WindowFlags_
    at, pivot = (
        ((0.5 * area.x, area.y - pixels(FOOT)), (0.5, 1.0)) if foot else ((0.5 * area.x, 0.5 * area.y), (0.5, 0.5))
    )
    imgui.set_next_window_pos(at, 0, pivot)
    imgui.set_next_window_size((min(pixels(width), area.x), 0))
    imgui.begin(name, None, flags.no_title_bar | flags.no_resize | flags.no_move | flags.no_saved_settings)


def write_problem(problem: str) -> None:
    """Write what is wrong with the input, if anything is."""
    from imgui_bundle import imgui

    if problem:
        imgui.push_text_wrap_pos(0.0)
        imgui.text_colored(ACCENT, problem)
        imgui.pop_text_wrap_pos()


class OpenDialog:
    """The files that the user wants to open. `shown` while it asks something; `draw` gives the commands.

    A body joins the play, a room replaces the scene's, a state is loaded; of a splat the user is asked what it is.
    """

    def __init__(self, preferences: Preferences):
        self._preferences = preferences
        self.shown = self._focus = False
        self._typed, self._problem = "", ""
        self._asked: list[Path] = []  # files that may be either
        self._commands: list[Command] = []
        self._system = None  # the system's dialog while it is open

    def ask(self) -> None:
        """Let the user choose a file."""
        folder = self._preferences.get("folder", PathText, "") or os.getcwd()
        if not sys.platform.startswith("linux") or any(map(shutil.which, LINUX_DIALOGS)):
            from imgui_bundle import portable_file_dialogs as dialogs

            self._system = dialogs.open_file(TITLE, folder, FILTERS)
        else:
            self.shown, self._focus, self._problem = True, True, ""
            self._typed = self._typed or os.path.join(folder, "")

    def offer(self, paths: Iterable[str]) -> None:
        """Open these files, or ask what they are to be."""
        for path in map(Path, paths):
            try:
                kind = kind_of(path)
            except BadInput as e:
                self.shown, self._problem = True, str(e)
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
        from imgui_bundle import imgui

        begin_dialog("open", FILE_WIDTH)
        imgui.push_font(None, TITLE_SIZE)
        imgui.text(TITLE)
        imgui.pop_font()
        write_problem(self._problem)
        if self._asked:
            self._draw_question(self._asked[0])
        else:
            self._draw_field()
        imgui.end()

    def _draw_question(self, path: Path) -> None:
        from imgui_bundle import imgui

        imgui.text_colored(QUIET, f"{path.name} is a splat. What is it here?")
        tips = {"A body": "It falls onto the play.", "The room": "The scene begins anew in it.", "Cancel": "(Esc)"}
        pressed = button_grid(tips, 3)
        if pressed is None:
            return
        if pressed == "Cancel":
            self.close()
            return
        self._open(self._asked.pop(0), "body" if pressed == "A body" else "room")
        self.shown = bool(self._asked)

    def _draw_field(self) -> None:
        from imgui_bundle import imgui

        imgui.text_colored(QUIET, "Drop a splat, a mesh or an asset here, or type its path.")
        if imgui.is_window_appearing() or self._focus:
            imgui.set_keyboard_focus_here()
        self._focus = False
        imgui.set_next_item_width(-1)
        entered, self._typed = imgui.input_text("##path", self._typed, imgui.InputTextFlags_.enter_returns_true)
        pressed = button_grid({"Open": "(Enter)", "Cancel": "(Esc)"}, 2)
        if pressed == "Cancel" or imgui.is_key_pressed(imgui.Key.escape):
            self.close()
        elif pressed == "Open" or entered:
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
        from imgui_bundle import imgui

        begin_dialog("length", LENGTH_WIDTH, foot=True)
        imgui.text("How long is it really?")
        now = float(np.linalg.norm(np.subtract(points[1], points[0])))
        imgui.text_colored(QUIET, f"{now:.3g} m now; type 1.2 or 35 cm")
        write_problem(self._problem)
        if not self._shown:
            imgui.set_keyboard_focus_here()
        self._shown = True
        imgui.set_next_item_width(-1)
        entered, self._typed = imgui.input_text("##length", self._typed, imgui.InputTextFlags_.enter_returns_true)
        pressed = button_grid({"Set": "(Enter)", "Cancel": "(Esc)"}, 2)
        imgui.end()
        if pressed == "Cancel" or imgui.is_key_pressed(imgui.Key.escape):
            return [], True
        if not (entered or pressed == "Set"):
            return [], False
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
        from imgui_bundle import imgui

        if choices is not self._pictures:
            for texture in self._textures:
                texture.release()
            self._pictures = choices
            self._textures = [self._gl.texture(p.shape[1::-1], 3, p.tobytes(), alignment=1) for _, _, p in choices]
        area, flags = imgui.get_io().display_size, imgui.WindowFlags_
        imgui.set_next_window_pos((0.5 * area.x, area.y - pixels(FOOT)), 0, (0.5, 1.0))
        imgui.set_next_window_size_constraints((0, 0), (area.x - 2 * pixels(MARGIN), area.y))
        fixed = flags.no_title_bar | flags.no_resize | flags.no_move | flags.no_saved_settings
        imgui.begin("up", None, fixed | flags.always_auto_resize | flags.horizontal_scrollbar)
        imgui.text("Which way is up? Press the picture that stands upright (Y tries the next).")
        pressed = []
        for k, ((up, chance, picture), texture) in enumerate(zip(choices, self._textures, strict=True)):
            if k:
                imgui.same_line()
            imgui.begin_group()
            height, width = picture.shape[:2]
            size = (pixels(width), pixels(height))
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
        from imgui_bundle import imgui

        area, edge = imgui.get_io().display_size, pixels(MARGIN)
        imgui.set_next_window_pos((0.5 * area.x, 0.5 * area.y), 0, (0.5, 0.5))
        columns = 2 if area.x >= pixels(2 * SCENE_WIDTH) + 2 * edge else 1
        width = min(columns * pixels(SCENE_WIDTH) + 2 * imgui.get_style().window_padding.x, area.x - 2 * edge)
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
        return commands

    def _cell(self, demo: Demo) -> list[Command]:
        """Draw a scene: its picture, which is a button, name, summary and options."""
        from imgui_bundle import imgui

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

            pixels_ = cv2.imread(str(path))
            if pixels_ is None:  # of a captured room, which may hold anything
                return None
            pixels_ = np.ascontiguousarray(pixels_[..., ::-1])
            texture = self._gl.texture(pixels_.shape[1::-1], 3, pixels_.tobytes(), alignment=1)
            self._textures[path] = texture
        return self._textures.get(path)
