"""Scene files of the user's: played by their path, with their options; errors in one line, with the file's line."""

import re
from pathlib import Path
from types import SimpleNamespace

import pytest

import scenes
from commands.parser import parse
from commands.play import open_state
from core.errors import BadInput
from scenes import registry
from tests.support.scripted_play import play

GUIDE = Path(__file__).resolve().parents[2] / "docs" / "writing_a_scene.md"
SCENE = '''"""Balls: many."""
from neighbour import EYE
from scenes.scene import Body, Scene
from core.material import Material


def build(height: float = 0.9):
    ring = Body("ring_red", Material.named("silicone"), position=(0.0, height, 0.1))
    return Scene(bodies=[Body("dining_room"), ring], light=None, eye=EYE, target=(0.0, 0.8, 0.0))
'''


@pytest.fixture
def scene_file(tmp_path):
    (tmp_path / "neighbour.py").write_text("EYE = (0.0, 1.4, 1.1)\n", encoding="utf-8")
    path = tmp_path / "balls.py"
    path.write_text(SCENE, encoding="utf-8")
    return str(path)


def test_a_scene_file_is_played_by_its_path_with_its_own_options(scene_file):
    args = parse(["--scene", scene_file, "--height", "1.5"])[1]
    assert args.options == {"height": "1.5"}
    scene = registry.load(args.scene, **args.options)
    assert scene.bodies[1].position == (0.0, 1.5, 0.1) and scene.eye == (0.0, 1.4, 1.1)
    assert registry.label(scene_file) == "balls"


@pytest.mark.parametrize(
    "text, said",
    [
        ("x = 1\ny = (\n", r"line 2: SyntaxError: '\(' was never closed"),
        ("import os\n\nraise ValueError('no\\nway')\n", "line 3: ValueError: no way"),
        ("def build():\n    return 1 / 0\n", "line 2: ZeroDivisionError"),
        ("def build():\n    return 3\n", "build returns no Scene but int"),
        ("x = 1\n", "no function build"),
        ("build = 3\n", "no function build"),
        ("def build(size):\n    pass\n", "size of build has no default"),
        ("def build(size: list = ()):\n    pass\n", "neither a text"),
        ("from __future__ import annotations\n\ndef build(size: Nothing = 1):\n    pass\n", "Nothing"),
    ],
)
def test_an_error_in_a_scene_file_is_told_in_one_line(text, said, tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BadInput, match=f"mine.py: .*{said}") as error:
        registry.load(str(path))
    assert "\n" not in str(error.value)


GAME = """
class Game:
    score, message = 0, ""
    def reset(self): pass
    def update(self, time, bodies):
        return self.pegs

def build():
    from scenes.scene import Scene
    return Scene(bodies=[], light=None, eye=(0, 0, 1), target=(0, 0, 0), game=Game())
"""


def test_a_game_without_an_update_is_refused_before_anything_is_compiled(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(GAME.replace("def update", "def updated"), encoding="utf-8")
    with pytest.raises(BadInput, match=r"mine\.py: the game Game has no update$"):
        registry.load(str(path))


def test_an_error_in_play_is_told_with_its_line_if_it_is_the_scene_file_s(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(GAME, encoding="utf-8")
    game = registry.load(str(path)).game
    said = r"mine\.py: line 6: AttributeError: 'Game' object has no attribute 'pegs'"
    with pytest.raises(BadInput, match=said), registry.faults_told(str(path)):
        game.update(0.0, [])
    with pytest.raises(ZeroDivisionError), registry.faults_told(str(path)):
        raise ZeroDivisionError  # the program's own


def test_a_missing_scene_file_is_named():
    with pytest.raises(BadInput, match="no such file"):
        registry.load("nowhere/mine.py")


def test_the_scene_of_the_guide_plays(tmp_path, monkeypatch, ti_cpu):
    """That in docs/writing_a_scene.md: found by its name, and its scripted hand does what it promises."""
    source = re.search(r"```python\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL).group(1)
    (tmp_path / "stack.py").write_text(source, encoding="utf-8")
    monkeypatch.setattr(scenes, "__path__", [*scenes.__path__, str(tmp_path)])
    assert "stack" in registry.names() and registry.demo("stack").summary.startswith("Stack:")
    scene = registry.load("stack")
    scene.game.verify(play(scene, dt=1 / 30).bodies())
    assert scene.game.message == "Stacked!"


def test_a_saved_state_starts_no_scene_file_that_the_command_line_does_not_name(scene_file, monkeypatch):
    """Nobody's file decides what is run."""
    from display.keep import state_file

    about = {"scene": scene_file, "interaction": "physics"}
    monkeypatch.setattr(state_file, "read_state", lambda path: SimpleNamespace(about=about, assets=[]))
    with pytest.raises(BadInput, match="name that too"):
        open_state(parse(["--state", "kept.h5"])[1])
    named = parse(["--state", "kept.h5", "--scene", scene_file])[1]
    assert open_state(named).about is about and named.scene == scene_file
