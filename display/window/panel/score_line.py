"""The line at the top of the picture: the game's score and message, and notices."""

from __future__ import annotations

from display.protocol import WorldView
from display.window.panel.theme import ACCENT, MARGIN
from display.window.panel.widgets import pixels


def draw_score(world: WorldView, left: float) -> None:
    """Draw score, message, notice, and the progress of what is being opened, at the top: in the middle, or right of
    `left` [px] in a small window."""
    from imgui_bundle import imgui

    game = world.scene.game if world.editable else None
    if game is None and not (world.notice or world.opening):
        return
    score, message = score_and_message(world)
    half = 0.5 * imgui.calc_text_size(f"{score}   {message}".strip()).x
    middle = max(0.5 * imgui.get_io().display_size.x, left + pixels(3 * MARGIN) + half)
    imgui.set_next_window_pos((middle, pixels(MARGIN)), 0, (0.5, 0.0))
    flags = imgui.WindowFlags_
    still = flags.no_decoration | flags.always_auto_resize | flags.no_inputs | flags.no_saved_settings
    imgui.begin("score", None, still | flags.no_nav | flags.no_focus_on_appearing)
    if score:
        imgui.text_colored(ACCENT, score)
        imgui.same_line(0, pixels(12))
    if message:
        imgui.text(message)
    if world.notice:
        imgui.text_colored(ACCENT, world.notice)
    if world.opening:
        imgui.text_colored(ACCENT, world.opening)
    imgui.end()


def score_and_message(world: WorldView) -> tuple[str, str]:
    """Score and message of the game as they are shown; "" for a score that the message says."""
    if world.scene.game is None:
        return "", ""
    score, message = str(world.score or ""), world.message
    return "" if score in message.split() else score, message
