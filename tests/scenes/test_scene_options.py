"""The parameters of a scene's `build` are options of the command line."""

import json

import pytest

import scenes
from commands.parser import parse
from commands.play import load_scene, take_options
from commands.play_options import PlayOptions
from core.errors import BadInput
from display.record.recording import Recording, Replay
from scenes import registry
from tests.display.test_recording import Ball, some_frames
from vrgs import main

SOURCE = '''"""Zoo: an animal."""
from typing import Annotated, Literal
from scenes.scene import Body, Scene

def build(
    animal: Literal["fox", "bear"] = "fox", how_many: int = 2, size: float = 1.0, lit: bool = True,
    name: Annotated[str | None, "what it is called"] = None,
) -> Scene:
    scene = Scene([Body("dining_room")], None, (0, 1, 1), (0, 0, 0))
    object.__setattr__(scene, "given", (animal, how_many, size, lit, name))
    return scene
'''


def test_no_module_is_a_faulty_scene():
    assert [demo.name for demo in registry.demos() if demo.fault] == []


@pytest.fixture
def zoo(tmp_path, monkeypatch):
    """A scene `zoo` with options of each kind, but `--size`, which is the picture's."""
    (tmp_path / "zoo.py").write_text(SOURCE.replace("size: float", "tall: float").replace("size,", "tall,"), "utf-8")
    monkeypatch.setattr(scenes, "__path__", [*scenes.__path__, str(tmp_path)])
    monkeypatch.delitem(__import__("sys").modules, "scenes.zoo", raising=False)


def given(*argv: str) -> tuple:
    """Arguments that `build` of the zoo gets from a command line."""
    return load_scene(parse(["--scene", "zoo", *argv])[1], None).given


def test_parameters_of_build_become_options(zoo, capsys):
    assert given() == ("fox", 2, 1.0, True, None)
    line = ("--animal", "bear", "--how-many", "3", "--tall", "0.5", "--lit", "no", "--name", "Ida")
    assert given(*line) == ("bear", 3, 0.5, False, "Ida")
    assert registry.load("zoo", how_many=4, lit=False).given == ("fox", 4, 1.0, False, None)
    assert main(["scenes"]) == 0
    said = capsys.readouterr().out
    assert "--animal: fox or bear (default fox)" in said and "--lit: yes or no (default yes)" in said
    assert "--name: what it is called" in said
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "zoo: fox or bear (default fox)" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        (["--scene", "zoo", "--animal", "bare"], "--animal of the scene zoo is fox or bear, not 'bare'"),
        (["--scene", "zoo", "--how-many", "few"], "--how-many of the scene zoo is a number, not 'few'"),
        (["--scene", "zoo", "--lit", "maybe"], "--lit of the scene zoo is yes or no"),
        (["--scene", "ring_toss", "--animal", "fox"], "the scene ring_toss takes no --animal"),
        (["--scene", "ring_toss", "--capture", "photographs"], "takes no --capture; a room to play in is its --stage"),
        (["--scene", "zoo", "--animl", "fox"], "unknown option --animl; did you mean --animal?"),
    ],
)
def test_what_an_option_cannot_be_is_told_in_one_line(zoo, capsys, argv, says):
    assert main([*argv, "--headless"]) == 2
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1


def test_an_option_named_like_one_of_the_program_is_told(tmp_path, monkeypatch, capsys):
    (tmp_path / "sized_scene.py").write_text(SOURCE, "utf-8")
    monkeypatch.setattr(scenes, "__path__", [*scenes.__path__, str(tmp_path)])
    with pytest.raises(SystemExit):
        parse(["--help"])
    assert "sized_scene: --size already has another meaning" in capsys.readouterr().err


def test_a_recording_keeps_the_options_and_all_bodies(zoo, tmp_path, ti_cpu):
    args = PlayOptions(scene="zoo", options={"animal": "bear"}, body=["a.h5", "b.h5"], vertices=[300, 400])
    world = Ball()
    with Recording(tmp_path / "play.h5") as recording:
        recording.begin(args, {})
        for frame in some_frames(3):
            world.step(recording.note(frame))
            recording.after(world)
    again = PlayOptions()
    take_options(again, Replay.load(tmp_path / "play.h5").about, tmp_path / "play.h5", "recording was made")
    assert (again.options, again.body, again.vertices) == ({"animal": "bear"}, ["a.h5", "b.h5"], [300, 400])


@pytest.mark.parametrize(
    "about", [{"body": [1]}, {"vertices": [0]}, {"vertices": ["9"]}, {"options": []}, {"options": {"a": [1]}}]
)
def test_bodies_and_options_of_a_recording_are_checked(about):
    from display.record.recording_file import checked_about

    with pytest.raises(BadInput):
        checked_about(json.dumps({"scene": "zoo", **about}), "play.h5")
