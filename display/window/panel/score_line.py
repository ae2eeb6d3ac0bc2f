"""The lines at the top of the picture: the game's score and message, notices, what is being opened or shown."""

from __future__ import annotations

from display.protocol import WorldView
from display.window.panel.theme import ACCENT, MARGIN, TEXT
from display.window.panel.widgets import pixels

DEMONSTRATION = "A demonstration plays. P or Esc ends it, and so does a grip."
PAUSED = "Paused. Space goes on."
Line = list[tuple[str, tuple[float, ...]]]  # texts side by side, with their colours


def lines_of(world: WorldView) -> list[Line]:
    """Lines to show, from the score to notices."""
    game = world.scene.game if world.editable else None
    score, message = ("", "") if game is None else score_and_message(world)
    state = PAUSED if world.paused else DEMONSTRATION if world.demo else ""
    lines = [[(score, ACCENT), (message, TEXT)], *([(t, ACCENT)] for t in (state, world.notice, world.opening))]
    return [kept for line in lines if (kept := [(text, colour) for text, colour in line if text])]


def draw_score(world: WorldView, left: float) -> None:
    """Draw the lines at the top: in the middle, or right of `left` [px] in a small window.

    The size is computed here: a window that ImGui fits to its content is cut off in its first frame, which is the one
    that stays on the screen while something takes long.
    """
    from imgui_bundle import imgui

    lines = lines_of(world)
    if not lines:
        return
    style, area, edge, gap = imgui.get_style(), imgui.get_io().display_size, pixels(MARGIN), pixels(12)
    longest = max(area.x - left - 2 * edge - 2 * style.window_padding.x, pixels(100))
    extents = [[imgui.calc_text_size(text, False, longest) for text, _ in line] for line in lines]
    width = min(max(sum(e.x for e in line) + gap * (len(line) - 1) for line in extents), longest)
    height = sum(max(e.y for e in line) for line in extents) + style.item_spacing.y * (len(lines) - 1)
    size = (width + 2 * style.window_padding.x + 1, height + 2 * style.window_padding.y)
    middle = max(0.5 * area.x, left + edge + 0.5 * size[0])
    imgui.set_next_window_pos((middle - 0.5 * size[0], edge))
    imgui.set_next_window_size(size)
    flags = imgui.WindowFlags_
    still = flags.no_decoration | flags.no_inputs | flags.no_saved_settings
    imgui.begin("score", None, still | flags.no_nav | flags.no_focus_on_appearing)
    for line in lines:
        for k, (text, colour) in enumerate(line):
            if k:
                imgui.same_line(0, gap)
            imgui.push_text_wrap_pos(0.0)
            imgui.text_colored(colour, text)
            imgui.pop_text_wrap_pos()
    imgui.end()


def score_and_message(world: WorldView) -> tuple[str, str]:
    """Score and message of the game as they are shown; "" for a score that the message says."""
    if world.scene.game is None:
        return "", ""
    score, message = str(world.score or ""), world.message
    return "" if score in message.split() else score, message
