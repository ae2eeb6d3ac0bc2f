"""The panel's first section: pause, step, reset, undo, the demonstration, and what a grip does."""

from __future__ import annotations

from display import user_commands
from display.protocol import WorldView
from display.user_commands import Command
from display.window.panel.section import Section
from display.window.panel.widgets import button_grid, choice

INTERACTIONS = {
    "Physics": "Bodies deform, collide and fall.",
    "Transform": "A body that you hold moves rigidly; nothing deforms.",
}


class PlaySection(Section):
    """Buttons of the play as a whole; always on view, so without a header."""

    title = ""

    def shown(self, world: WorldView) -> bool:
        """True of worlds that can be played with."""
        return world.editable

    def draw(self, world: WorldView) -> list[Command]:
        """Draw the buttons; their commands."""
        pause, watch = "Resume" if world.paused else "Pause", "Stop" if world.demo else "Watch"
        tips = {pause: "(Space)", "Step": "A single frame (N).", "Reset": "The scene anew (R)."}
        tips |= {"Undo": "Take the last change back (Ctrl+Z).", "Redo": "(Ctrl+Y)"}
        tips |= {watch: "A demonstration (P)."} if world.scene.game is not None else {}
        commands: list[Command] = {
            pause: [user_commands.Pause(not world.paused)],
            "Step": [user_commands.Pause(True), user_commands.SingleStep()],
            "Reset": [user_commands.Reset()],
            "Undo": [user_commands.Undo()],
            "Redo": [user_commands.Redo()],
            watch: [user_commands.PlayDemo(not world.demo)],
        }.get(button_grid(tips, 3), [])
        chosen = choice(list(INTERACTIONS), world.interaction.capitalize(), INTERACTIONS).lower()
        return commands + ([user_commands.SetInteraction(chosen)] if chosen != world.interaction else [])
