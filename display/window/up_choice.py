"""Strip of pictures at the lower edge of a viewer's window in which the user chooses which way is up."""

from __future__ import annotations

from display.protocol import WorldView
from display.user_commands import Command, TurnUp
from display.window.panel.theme import QUIET
from display.window.panel.widgets import pixels

MARGIN, FOOT = 16, 60  # [px] to the sides of the window, and to its lower edge, where hints stand


class UpChoice:
    """The pictures as buttons, as long as the world has several for the user to choose from.

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
