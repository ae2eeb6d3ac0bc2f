"""State of a world as a page shows it, in types of JSON."""

from __future__ import annotations

from base64 import b64encode

import numpy as np

from core.camera import Camera, project
from core.material import MATERIALS
from core.vocabulary import BodyState
from display.edit.selection_marker import marked, marker_lines
from display.protocol import WorldView
from display.run_stats import plain
from display.user_commands import Export, OpenScene
from display.window import hover, scene_menu
from display.window.key_bindings import BY_CHORD, help_rows
from display.window.panel import (
    body_section,
    keep_section,
    light_section,
    performance_section,
    play_section,
    score_line,
    world_section,
)
from display.window.panel.slider import Slider
from scenes.registry import Demo
from scenes.scene import Scene

# Actions of keys that a page has in its own way, or not at all.
WINDOW_ONLY = ("toggle_panel", "toggle_menu", "toggle_help", "ask_file", "next_gizmo", "toggle_room_gizmo", "escape")
PAGE_KEYS = [
    ("F1", "show or hide the panel"),
    ("F2", "choose another scene"),
    ("H", "list of mouse and keys"),
    ("Esc", "end drag or demonstration"),
]
SECTIONS = {"body": body_section.sliders, "world": world_section.sliders, "light": light_section.sliders}


def first_words(title: str, name: str, scene: Scene) -> dict:
    """First message to a page: what does not change while the scene of that `name` is played."""
    editable = scene.light is not None or bool(scene.bodies)
    return {
        "title": title,
        "playing": name,
        "scenes": [described_scene(demo) for demo in scene_menu.demos()] if editable else [],
        "cast": [f"{file} is {role}" for file, role in scene.cast],
        "interactions": play_section.INTERACTIONS,
        "edits": {name: tip for name, (_, tip) in body_section.BUTTONS.items()},
        "materials": list(MATERIALS),
        "kinds": keep_section.KINDS,
        "kind_tip": keep_section.KIND_TIP,
        "resolutions": list(performance_section.RESOLUTIONS),
        "keys": [*help_rows(editable, WINDOW_ONLY), *PAGE_KEYS],
        "ctrl_keys": [chord.rpartition("+")[2] for chord in BY_CHORD if chord.startswith("ctrl+")],
    }


def described_scene(demo: Demo) -> dict:
    """A scene for the menu, with its picture as a data URL, or None."""
    options = {option.name: [str(option.default), *option.choices] for option in scene_menu.chosen_by_list(demo)}
    picture = scene_menu.picture_file(OpenScene(demo.name))
    data = None if picture is None else "data:image/jpeg;base64," + b64encode(picture.read_bytes()).decode()
    spoken, line = scene_menu.spoken(demo.name), scene_menu.line_of(demo)
    return {"name": demo.name, "spoken": spoken, "line": line, "options": options, "picture": data}


def scene_request(name: str, options: dict) -> OpenScene | None:
    """The command that opens a scene of the menu with options that it has; None if there is none such."""
    for demo in scene_menu.demos():
        known = {option.name: option.choices for option in scene_menu.chosen_by_list(demo)}
        if demo.name == name and all(value in known.get(key, ()) for key, value in options.items()):
            return OpenScene(name, options)
    return None


def world_state(world: WorldView) -> dict:
    """Content of the panel; cheap enough for every frame."""
    bodies, selected = world.bodies(), world.selected
    known = selected is not None and selected < len(bodies)
    score, message = score_line.score_and_message(world)
    return {
        "loading": "",
        "editable": world.editable,
        "paused": world.paused,
        "demo": world.demo,
        "interaction": world.interaction.capitalize(),
        "score": score,
        "message": message,
        "notice": world.notice,
        "opening": world.opening,
        "film": None if world.film_seconds is None else int(world.film_seconds),
        "selected": body_section.called(bodies[selected].name) if known else None,
        "material": world.material(selected)[1] if known else None,
        "light": None if world.light is None else world.light.kind.capitalize(),
        "keep": {name: tip for name, (_, tip) in keep_section.buttons(world, Export()).items()},
        "sliders": {section: [described(one) for one in sliders_of(world, section)] for section in SECTIONS},
    }


def sliders_of(world: WorldView, section: str) -> list[Slider]:
    """The sliders of a section of the panel; none where it has nothing to show."""
    selected = world.selected
    shown = {
        "body": world.editable and selected is not None and selected < len(world.bodies()),
        "world": world.editable,
        "light": world.light is not None,
    }
    return SECTIONS[section](world) if shown[section] else []


def described(slider: Slider) -> dict:
    """A slider without its command."""
    fields = ("name", "value", "low", "high", "shown", "usual", "log")
    tip = slider.tip.replace(world_section.RESET_TIP, "A right click brings the usual value back.")
    return {field: plain(getattr(slider, field)) for field in fields} | {"tip": tip}


def overlay(world: WorldView, camera: Camera, hand: np.ndarray | None, under: BodyState | None, *, near: bool) -> list:
    """Strokes over the picture: [u, v] of the hand, and [u, v, u, v, opacity] of the corners of the marked body.

    u and v are fractions of the camera's picture.

    under  the body under the cursor
    near   the cursor is among the edits
    """

    def place(at: tuple[float, float]) -> list[float]:
        return [round(float(at[0]) / camera.width, 4), round(float(at[1]) / camera.height, 4)]

    if hand is not None:
        at = project(camera, hand)
        return [] if at is None else [place(at)]
    body = marked(world, near=near)
    shown = [(body, 1.0)] if body is not None else []
    shown += [(under, hover.OPACITY)] if under is not None and under is not body else []
    return [[*place(a), *place(b), s * opacity] for one, s in shown for a, b, opacity in marker_lines(one, camera)]
