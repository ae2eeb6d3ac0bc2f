"""State of a world as a page shows it, in types of JSON."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from core.camera import Camera, project
from core.material import MATERIALS
from display.edit.selection_marker import marked, marker_lines
from display.protocol import WorldView
from display.run_stats import plain
from display.window.key_bindings import BY_CHORD, help_rows
from display.window.panel import body_section, light_section, performance_section, play_section, score_line
from scenes.scene import Scene


def first_words(title: str, scene: Scene) -> dict:
    """What a page is told first: what does not change."""
    return {
        "title": title,
        "cast": [f"{file} is {role}" for file, role in scene.cast],
        "interactions": play_section.INTERACTIONS,
        "edits": {name: tip for name, (_, tip) in body_section.BUTTONS.items()},
        "materials": list(MATERIALS),
        "resolutions": list(performance_section.RESOLUTIONS),
        "light_centre": list(map(float, scene.target)),
        "light_range": light_section.RANGE,
        "keys": help_rows(scene.light is not None),
        "ctrl_keys": [chord.rpartition("+")[2] for chord in BY_CHORD if chord.startswith("ctrl+")],
    }


def world_state(world: WorldView) -> dict:
    """What the panel shows; cheap enough for every frame."""
    bodies, selected = world.bodies(), world.selected
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
        "selected": bodies[selected].name if selected is not None and selected < len(bodies) else None,
        "light": plain(asdict(world.light)) if world.light is not None else None,
    }


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
