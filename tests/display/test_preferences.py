"""The user's preferences: kept over starts, shared by several programs, and never in the way."""

import json
import sys
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from core.vocabulary import Light
from display.keep.keeper import Remembered
from display.preferences import PathText, Preferences, config_folder
from display.protocol import Frame
from display.user_commands import LoadState, SetLight, Undo
from display.window.gl_window import covers
from tests.support.fake_view import FakeView
from tests.support.fake_world import fake_scene


@pytest.fixture
def path(tmp_path):
    return tmp_path / "config" / "preferences.json"


def test_what_is_set_is_there_at_the_next_start(path):
    first = Preferences(path)
    first.set("window.size", [800, 600])
    first.set("panel.open", False)
    first.set("light.sandbox", {"strength": 0.5})
    first.set("light.sandbox", None)
    again = Preferences(path)
    assert again.get("window.size", tuple[float, float]) == (800, 600) and again.get("panel.open", bool, True) is False
    assert again.get("light.sandbox", Light) is None and "light.sandbox" not in json.loads(path.read_text())


@pytest.mark.parametrize("value", ["x", [1], [1, True], [1, None], [1, float("nan")], [1, 10**400], {"0": 1}, 3, None])
def test_values_of_another_type_count_as_absent(path, value):
    path.parent.mkdir()
    path.write_text(json.dumps({"window.size": value, "sound": value}))
    preferences = Preferences(path)
    assert preferences.get("window.size", tuple[float, float]) is None and preferences.get("sound", bool, True) is True


def test_two_programs_keep_each_others_values(path):
    one, two = Preferences(path), Preferences(path)
    one.set("sound", False)
    two.set("folder", "/films")
    one.set("panel.open", False)
    again = Preferences(path)
    assert again.get("folder", PathText) == "/films"
    assert not again.get("sound", bool, True) and not again.get("panel.open", bool, True)
    assert [p.name for p in path.parent.iterdir()] == [path.name]  # neither locks nor parts are left


@pytest.mark.parametrize("text", ["", "{", "[1]", "\xff", "[" * 100_000, "{}" + " " * (1 << 20)])
def test_a_damaged_file_is_set_aside_and_told_once(path, text, capsys):
    path.parent.mkdir()
    path.write_text(text, encoding="latin-1")
    preferences = Preferences(path)
    preferences.set("sound", False)
    aside = path.with_name("preferences.broken.json")
    told = capsys.readouterr().err
    assert told.count("\n") == 1 and aside.name in told
    assert aside.read_text(encoding="latin-1") == text and Preferences(path).get("sound", bool, True) is False
    path.write_text("no")
    Preferences(path)
    assert aside.read_text(encoding="latin-1") == text and path.with_name("preferences.broken_2.json").exists()


@pytest.mark.parametrize("obstacle", ["a file for a folder", "a folder for a file"])
def test_a_place_that_cannot_be_used_is_told_once_and_the_play_goes_on(path, obstacle, capsys):
    if obstacle == "a file for a folder":
        path.parent.write_text("in the way")
    else:
        path.mkdir(parents=True)
    preferences = Preferences(path)
    preferences.set("sound", False)
    preferences.set("panel.open", False)
    assert preferences.get("sound", bool, True) is False and not path.is_file()
    assert capsys.readouterr().err.count("\n") == 1


def test_the_lock_of_a_killed_program_does_not_hold_up_the_play(path, monkeypatch):
    monkeypatch.setattr("display.preferences.LOCK_PATIENCE", 0.05)
    path.parent.mkdir()
    path.with_name(f".{path.name}.lock").touch()
    Preferences(path).set("sound", False)
    assert Preferences(path).get("sound", bool, True) is False


def test_the_folder_follows_the_platform(monkeypatch, tmp_path):
    monkeypatch.setenv("VRGS_CONFIG", str(tmp_path))
    assert config_folder() == tmp_path
    monkeypatch.delenv("VRGS_CONFIG")
    monkeypatch.setenv("XDG_CONFIG_HOME", "/x")
    monkeypatch.setenv("APPDATA", "/roaming")
    assert config_folder() == (Path("/roaming/vrgs") if sys.platform == "win32" else Path("/x/vrgs"))


LIGHT = Light((1.0, 2.0, 0.0))


def remembered(preferences, **options) -> Remembered:
    return Remembered(preferences, "sandbox", **({"light": True} | options))


def play(memory, *commands, light=LIGHT) -> list:
    """The commands of the first frame."""
    world = FakeView(light=light, scene=replace(fake_scene(), light=LIGHT))
    return memory.given(Frame(0.1, 0.1, [], [], list(commands)), world).commands


def test_the_light_of_a_scene_is_as_it_was_left():
    preferences, other = Preferences(), Light((0.0, 3.0, 0.5), kind="directional", strength=0.3)
    first = remembered(preferences)
    assert play(first) == []
    first.keep(FakeView(light=other, scene=replace(fake_scene(), light=LIGHT)))
    second = remembered(preferences)
    assert play(second, Undo()) == [SetLight(other), Undo()] and play(second) == []
    assert play(remembered(preferences, light=False)) == [] and play(remembered(preferences), light=None) == []
    remembered(preferences).keep(FakeView(light=LIGHT, scene=replace(fake_scene(), light=LIGHT)))
    assert play(remembered(preferences)) == [], "the scene's own light is not remembered"


@pytest.mark.parametrize("stored", [3, {}, {"position": [0, 1]}, asdict(replace(LIGHT, strength=7.0)), {"kind": "x"}])
def test_a_light_that_makes_no_sense_is_left_out(stored):
    preferences = Preferences()
    preferences.set("light.sandbox", stored)
    assert play(remembered(preferences)) == []


def test_the_last_state_of_the_scene_is_loaded_unless_another_is_named():
    preferences = Preferences()
    assert play(remembered(preferences), LoadState()) == [LoadState("")]
    preferences.set("state.sandbox", "/films/a.h5")
    assert play(remembered(preferences), LoadState()) == [LoadState("/films/a.h5")]
    assert play(remembered(preferences), LoadState("b.h5")) == [LoadState("b.h5")]


def test_a_place_on_no_screen_is_not_returned_to():
    assert covers((0, 0, 1920, 1080), 5, 1079) and not covers((0, 0, 1920, 1080), -1, 5)
