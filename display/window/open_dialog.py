"""Opening of files in the window: dropped on it, chosen in the system's dialog, or typed; then what they are to be."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterable
from pathlib import Path

from assets.file_kind import MESHES, SPLATS, kind_of
from core.errors import BadInput
from display.preferences import Preferences
from display.protocol import WorldView
from display.user_commands import AddBody, Command, LoadState, SwapRoom
from display.window.panel.theme import ACCENT, QUIET, TITLE_SIZE
from display.window.panel.widgets import button_grid, pixels

WIDTH = 460.0  # [px] of the dialog
TITLE = "Open a file"
FILTERS = ["Bodies, rooms and states", " ".join(f"*{suffix}" for suffix in (*SPLATS, *MESHES, ".h5")), "All files", "*"]
LINUX_DIALOGS = ("zenity", "kdialog", "qarma", "matedialog")  # programs that portable_file_dialogs starts


def has_system_dialog() -> bool:
    """True if the system can show a dialog to choose a file."""
    return not sys.platform.startswith("linux") or any(map(shutil.which, LINUX_DIALOGS))


class OpenDialog:
    """The files that the user wants to open. `shown` while it asks something; `draw` gives the commands.

    A body joins the play, a room replaces the scene's, from a state it goes on; of a splat the user says what it is.
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
        folder = self._preferences.get("folder", "") or os.getcwd()
        if has_system_dialog():
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
        """Open nothing more."""
        self.shown, self._problem, self._asked = False, "", []

    def draw(self, world: WorldView) -> list[Command]:
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

        area = imgui.get_io().display_size
        imgui.set_next_window_pos((0.5 * area.x, 0.5 * area.y), 0, (0.5, 0.5))
        imgui.set_next_window_size((min(pixels(WIDTH), area.x), 0))
        flags = imgui.WindowFlags_
        imgui.begin("open", None, flags.no_title_bar | flags.no_resize | flags.no_move | flags.no_saved_settings)
        imgui.push_font(None, TITLE_SIZE)
        imgui.text(TITLE)
        imgui.pop_font()
        if self._problem:
            imgui.push_text_wrap_pos(0.0)
            imgui.text_colored(ACCENT, self._problem)
            imgui.pop_text_wrap_pos()
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
