"""Table of the mouse and keys of the window: what controls obey, the panel lists, and docs/play.md shows.

A chord is the name of a key after its modifiers, "ctrl+shift+z". Keys have the name that is printed on them, but
WASD and QE the place that they have on a QWERTY keyboard.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from display import user_commands
from display.protocol import WorldView
from display.user_commands import EDITS, Command

NAMES = {"plus": "+", "minus": "-", "comma": ",", "period": ".", "delete": "Del", "escape": "Esc"}  # else capitalised
DIGITS = tuple("123456789")
WALKING = "wasdqe"  # keys by their place on a QWERTY keyboard; all other letters by what is printed on them
NAMED = ["home", "escape", "enter", "space", "tab", "delete", *(f"f{k}" for k in range(1, 13))]
PLACES = frozenset([*NAMED, *"abcdefghijklmnopqrstuvwxyz123456789"])
SYMBOLS = {"+": "plus", "=": "plus", "-": "minus", ",": "comma", ".": "period"}


@dataclass(frozen=True)
class KeyBinding:
    """A line of the table.

    keys    chords that all do the same; none of a gesture of the mouse
    label   what they do, for the user
    action  a command, whose body, if it has one, is that under the cursor; a function of the world that gives commands;
            or the name of a method of Controls, or of a switch there. None: the keys act as long as they are held, and
            Controls knows them
    text    how the user reads the keys; "": made from `keys`
    bodies  True: only where there are bodies, False: only where there are none
    """

    keys: tuple[str, ...]
    label: str
    action: Command | Callable[[WorldView], Sequence[Command]] | str | None = None
    text: str = ""
    bodies: bool | None = None

    @property
    def shown(self) -> str:
        """The keys as the user reads them."""
        return self.text or ", ".join(map(chord_text, self.keys))


def chord_text(chord: str) -> str:
    """A chord as it is written for the user: "Ctrl+Z"."""
    return "+".join(NAMES.get(part, part.capitalize()) for part in chord.split("+"))


BINDINGS = (
    KeyBinding((), "grab it, release to throw", text="Drag a body", bodies=True),
    KeyBinding((), "move it nearer or farther", text="  + wheel, or Shift", bodies=True),
    KeyBinding((), "turn around the scene", text="Drag elsewhere", bodies=True),
    KeyBinding((), "turn around it", text="Drag", bodies=False),
    KeyBinding((), "look around", text="Right drag"),
    KeyBinding((), "shift the view", text="Shift + right drag"),
    KeyBinding((), "nearer and farther", text="Wheel"),
    KeyBinding(("w", "a", "s", "d", "q", "e"), "walk; down and up", text="W A S D, Q E"),
    KeyBinding(("home",), "first view again", "reset_view"),
    KeyBinding(("space",), "pause", lambda world: [user_commands.Pause(not world.paused)], bodies=True),
    KeyBinding(
        ("n",), "a single step", lambda world: [user_commands.Pause(True), user_commands.SingleStep()], bodies=True
    ),
    KeyBinding(("r",), "reset the scene", user_commands.Reset(), bodies=True),
    KeyBinding(
        ("t",),
        "physics or transform",
        lambda world: [user_commands.SetInteraction("transform" if world.interaction == "physics" else "physics")],
        bodies=True,
    ),
    KeyBinding(("p",), "watch a demonstration", lambda world: [user_commands.PlayDemo(not world.demo)], bodies=True),
    KeyBinding(("ctrl+z", "u"), "undo", user_commands.Undo(), bodies=True),
    KeyBinding(("ctrl+y", "ctrl+shift+z", "shift+u"), "redo", user_commands.Redo(), text="Ctrl+Y", bodies=True),
    KeyBinding(("c", "ctrl+d"), "copy the body under the cursor", EDITS["copy"], bodies=True),
    KeyBinding(("delete",), "remove it", EDITS["remove"], bodies=True),
    KeyBinding(("plus",), "make it larger", EDITS["larger"]),
    KeyBinding(("minus",), "make it smaller", EDITS["smaller"]),
    KeyBinding(("comma",), "turn it to the left", EDITS["turn back"]),
    KeyBinding(("period",), "turn it to the right", EDITS["turn"]),
    KeyBinding(("shift+comma",), "tilt it away", "tilt"),
    KeyBinding(("shift+period",), "tilt it towards you", "tilt"),
    KeyBinding(("g",), "gizmo: move, turn, scale, off", "next_gizmo", bodies=True),
    KeyBinding(("ctrl+g",), "rings that turn your room, off", "toggle_room_gizmo", bodies=True),
    KeyBinding(("ctrl+comma",), "turn your room to the left", EDITS["turn room back"], bodies=True),
    KeyBinding(("ctrl+period",), "turn your room to the right", EDITS["turn room"], bodies=True),
    KeyBinding(("ctrl+shift+comma",), "tilt your room away", "tilt", bodies=True),
    KeyBinding(("ctrl+shift+period",), "tilt your room towards you", "tilt", bodies=True),
    KeyBinding(("k",), "set the size: two points and a length", "measure"),
    KeyBinding(("ctrl+k",), "keep its up, front and size in its file", user_commands.KeepFrame()),
    KeyBinding(("l",), "the light follows the cursor", text="L (hold)", bodies=True),
    KeyBinding(DIGITS, "go to a view that was kept", "go_to_bookmark", text="1 ... 9"),
    KeyBinding(tuple(f"ctrl+{digit}" for digit in DIGITS), "keep this view", "keep_bookmark", text="Ctrl+1 ... 9"),
    KeyBinding(("f12",), "write the picture", user_commands.TakePicture()),
    KeyBinding(("shift+f12",), "write the camera, for vrgs.py render", user_commands.WriteCamera()),
    KeyBinding(("ctrl+s",), "save the state of the scene", user_commands.SaveState(), bodies=True),
    KeyBinding(("ctrl+l",), "go on from the state that was saved last", user_commands.LoadState(), bodies=True),
    KeyBinding(("ctrl+e",), "export the scene as a splat file", user_commands.Export(), bodies=True),
    KeyBinding(("f9",), "film: begin, finish", lambda world: [user_commands.Film(world.film_seconds is None)]),
    KeyBinding(("f2",), "choose another scene", "menu", bodies=True),
    KeyBinding(("ctrl+o",), "open a file as a body or a room", "asks_file", bodies=True),
    KeyBinding(
        ("m",),
        "sound on or off",
        lambda world: [] if world.sound is None else [user_commands.SetSound(not world.sound)],
        bodies=True,
    ),
    KeyBinding(("tab",), "next file", user_commands.NextFile(), bodies=False),
    KeyBinding(("y",), "next axis of the file up", user_commands.TurnUp(), bodies=False),
    KeyBinding(("x",), "axes", lambda world: [user_commands.ShowAxes(not world.axes)], bodies=False),
    KeyBinding(("b",), "next background", user_commands.NextBackground(), bodies=False),
    KeyBinding(("o",), "write what the crop leaves", user_commands.WriteSplats(), bodies=False),
    KeyBinding(("f1",), "show or hide the panel", "panel"),
    KeyBinding(("h",), "list of mouse and keys", "help"),
    KeyBinding(("escape",), "end drag or demonstration; quit", "escape"),
)
BY_CHORD = {chord: binding for binding in BINDINGS for chord in binding.keys}


def bound(name: str, *, shift: bool, bodies: bool) -> KeyBinding | None:
    """The binding of a key that goes down, where there are bodies or not; Shift matters only if it is bound so."""
    ctrl, key = name.rpartition("+")[::2]
    shifted = "+".join(part for part in (ctrl, "shift", key) if part)
    binding = (BY_CHORD.get(shifted) if shift else None) or BY_CHORD.get(name)
    return binding if binding is not None and binding.bodies in (None, bodies) else None


def help_rows(bodies: bool, without: Sequence[str] = ()) -> list[tuple[str, str]]:
    """(keys, meaning) for the user, in a world with bodies or without; some actions may be left out."""
    return [(b.shown, b.label) for b in BINDINGS if b.bodies in (None, bodies) and b.action not in without]


def key_name(place: str | None, printed: str) -> str | None:
    """Name of a key by its place on a QWERTY keyboard (or None) and what is printed on it; None: no key of ours."""
    if place is not None and (len(place) > 1 or place in WALKING or place.isdigit()):
        return place
    if printed in SYMBOLS:
        return SYMBOLS[printed]
    if printed.isascii() and printed.isalpha():
        return None if printed in WALKING else printed
    return place  # other alphabets


def chord_name(place: str | None, printed: str, *, down: bool, ctrl: bool) -> str | None:
    """As `key_name`, after "ctrl+" where a key goes down with that; then letters are as printed."""
    name = printed if ctrl and printed.isascii() and printed.isalpha() else key_name(place, printed)
    return f"ctrl+{name}" if name is not None and ctrl and down and name != "shift" else name
