"""The table of mouse and keys: it is consistent, controls know what it names, and docs/play.md shows it."""

from pathlib import Path

import pytest

from display import user_commands
from display.window.controls import WALK_KEYS, Controls
from display.window.key_bindings import BINDINGS, BY_CHORD, bound, chord_text, help_rows, key_name
from tests.support.fake_world import fake_scene

PLAY = Path(__file__).resolve().parents[2] / "docs" / "play.md"


def test_each_chord_does_one_thing():
    chords = [chord for binding in BINDINGS for chord in binding.keys]
    assert len(chords) == len(set(chords)) == len(BY_CHORD)
    assert set(WALK_KEYS) <= set(chords)


def test_actions_are_commands_functions_or_methods_and_switches_of_the_controls():
    controls = Controls(fake_scene())
    for binding in BINDINGS:
        action = binding.action
        if isinstance(action, str):
            named = getattr(controls, action)
            assert callable(named) or isinstance(named, bool), action
        else:
            assert action is None or isinstance(action, user_commands.Command) or callable(action)


def test_shift_matters_only_where_it_is_bound():
    assert bound("u", shift=True, bodies=True).label == bound("ctrl+y", shift=False, bodies=True).label == "redo"
    assert bound("ctrl+z", shift=True, bodies=True).label == "redo"
    assert bound("plus", shift=True, bodies=True) is bound("plus", shift=False, bodies=True)
    assert bound("r", shift=False, bodies=False) is None and bound("x", shift=False, bodies=True) is None


def test_help_leaves_out_what_has_no_use():
    alone, playing = dict(help_rows(bodies=False)), dict(help_rows(bodies=True))
    assert "R" not in alone and "Drag" in alone and "Drag" not in playing
    assert playing["Ctrl+Z, U"] == "undo" and chord_text("ctrl+shift+comma") == "Ctrl+Shift+,"


def test_the_table_of_the_documentation_is_this_one():
    played = [b for b in BINDINGS if b.bodies is not False]
    rows = [f"| {b.shown.strip()} | {b.label} |" if not b.keys else f"| `{b.shown}` | {b.label} |" for b in played]
    lines = PLAY.read_text(encoding="utf-8").splitlines()
    first = lines.index("| --- | --- |") + 1
    assert lines[first : lines.index("", first)] == rows


@pytest.mark.parametrize(
    ("place", "printed", "name"),
    [
        ("w", "w", "w"),
        ("w", "z", "w"),  # AZERTY: walking goes by the place of a key
        ("z", "w", None),
        ("z", "y", "y"),  # QWERTZ: all else by what is printed on it
        ("r", "к", "r"),  # Cyrillic: by its place
        ("m", ",", "comma"),  # AZERTY
        (None, "=", "plus"),
        ("f12", "", "f12"),
        ("1", "&", "1"),
        (None, "ö", None),
    ],
)
def test_keys_have_the_same_names_on_all_layouts(place, printed, name):
    assert key_name(place, printed) == name
