"""State of a world as a page shows it, in types of JSON."""

from __future__ import annotations

import numpy as np

from core.camera import Camera, project
from core.material import MATERIALS
from display.edit.selection_marker import marked, marker_lines
from display.protocol import WorldView
from display.run_stats import plain
from display.window.key_bindings import BY_CHORD, help_rows
from display.window.panel import (
    body_section,
    light_section,
    performance_section,
    play_section,
    score_line,
    world_section,
)
from display.window.panel.slider import Slider
from scenes import registry
from scenes.scene import Scene

SECTIONS = {"body": body_section.sliders, "world": world_section.sliders, "light": light_section.sliders}


def first_words(title: str, scene: Scene) -> dict:
    """What a page is told first: what does not change."""
    return {
        "title": title,
        "scenes": {demo.name: demo.summary for demo in registry.demos() if demo.build is not None},
        "cast": [f"{file} is {role}" for file, role in scene.cast],
        "interactions": play_section.INTERACTIONS,
        "edits": {name: tip for name, (_, tip) in body_section.BUTTONS.items()},
        "materials": list(MATERIALS),
        "resolutions": list(performance_section.RESOLUTIONS),
        "keys": help_rows(scene.light is not None),
        "ctrl_keys": [chord.rpartition("+")[2] for chord in BY_CHORD if chord.startswith("ctrl+")],
    }


def world_state(world: WorldView) -> dict:
    """What the panel shows; cheap enough for every frame."""
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
        "selected": bodies[selected].name if known else None,
        "material": world.material(selected)[1] if known else None,
        "light": None if world.light is None else world.light.kind.capitalize(),
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
    fields = ("name", "value", "low", "high", "shown", "usual", "log", "tip")
    return {field: plain(getattr(slider, field)) for field in fields}


def overlay(world: WorldView, camera: Camera, hand: np.ndarray | None, *, near: bool) -> list:
    """Strokes over the picture: [u, v] of the hand, and [u, v, u, v, opacity] of the corners of the marked body.

    u and v are fractions of the camera's picture. near: the pointer is among the edits
    """

    def place(at: tuple[float, float]) -> list[float]:
        return [round(float(at[0]) / camera.width, 4), round(float(at[1]) / camera.height, 4)]

    if hand is not None:
        at = project(camera, hand)
        return [] if at is None else [place(at)]
    body = marked(world, near=near)
    lines = [] if body is None else marker_lines(body, camera)
    return [[*place(a), *place(b), opacity] for a, b, opacity in lines]
