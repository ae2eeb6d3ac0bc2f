"""The scene in docs/writing_a_scene.md: found by its name, and its scripted hand does what it promises."""

import re
from pathlib import Path

import scenes
from scenes import registry
from tests.support.scripted_play import play

GUIDE = Path(__file__).resolve().parents[2] / "docs" / "writing_a_scene.md"


def test_the_scene_of_the_guide_plays(tmp_path, monkeypatch, ti_cpu):
    source = re.search(r"```python\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL).group(1)
    (tmp_path / "stack.py").write_text(source, encoding="utf-8")
    monkeypatch.setattr(scenes, "__path__", [*scenes.__path__, str(tmp_path)])
    assert "stack" in registry.names() and registry.demo("stack").summary.startswith("Stack:")
    scene = registry.load("stack")
    world = play(scene, dt=1 / 30)
    scene.game.verify(world.bodies())
    assert scene.game.message == "Stacked!"
