"""A section of the panel: a title under which it folds, and what it draws."""

from __future__ import annotations

from display.protocol import WorldView
from display.user_commands import Command


class Section:
    """A part of the panel. Widgets of a subclass are as wide as the space that is left (widgets.py).

    `title` stands on the header; `open` is whether its content is on view, at first and then as the user leaves it;
    `hovered` whether the cursor was over its content in the last frame.
    """

    title: str
    open = True
    hovered = False

    def shown(self, world: WorldView) -> bool:
        """True if this world has a use for the section."""
        return True

    def label(self, world: WorldView) -> str:
        """Text of the header: the title unless it says more."""
        return self.title

    def draw(self, world: WorldView) -> list[Command]:
        """Draw the content; the commands that the user gives."""
        raise NotImplementedError
