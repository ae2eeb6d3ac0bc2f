"""The scene in docs/writing_a_scene.md: found by its name, and its scripted hand does what it promises."""

import re
from dataclasses import replace
from pathlib import Path

import scenes
from display.protocol import Frame
from scenes import registry

GUIDE = Path(__file__).resolve().parents[2] / "docs" / "writing_a_scene.md"
DT = 1 / 30  # [s]


def test_the_scene_of_the_guide_plays(tmp_path, monkeypatch, ti_cpu):
    source = re.search(r"```python\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL).group(1)
    (tmp_path / "stack.py").write_text(source, encoding="utf-8")
    monkeypatch.setattr(scenes, "__path__", [*scenes.__path__, str(tmp_path)])
    assert "stack" in registry.names() and registry.demo("stack").summary.startswith("Stack:")
    scene = registry.load("stack")

    from display.world import World

    bare = replace(scene, bodies=scene.bodies[1:])  # without the room, for speed
    world = World(bare, width=32, height=32)
    world.device.render, world.device.cast_shadow = lambda cameras: None, lambda: None  # nothing is looked at
    for i in range(round(scene.game.duration / DT)):
        time = (i + 1) * DT
        world.step(Frame(dt=DT, time=time, cameras=[], hands=world.scripted_hands(time)))
    scene.game.verify(world.bodies())
    assert scene.game.message == "Stacked!"
