"""Small recordings and studies."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from display.protocol import Duplicate, Pause, Rescale, Rotate, SetInteraction, SetLight, SetMaterial, Undo
from display.record.recording import Recording
from display.study.questionnaire import QUESTIONS, Answers
from display.study.study_file import Study
from display.study.trial import Trial
from scenes.scene import Light
from tests.display.test_recording import Ball, some_frames

COMMANDS = [
    Pause(False),
    Duplicate(0),
    Rescale(0, 1.25),
    Rotate(None, (1.0, 0.0, 0.0, 0.0)),
    SetMaterial(0, "rubber"),
    SetInteraction("transform"),
    SetLight(Light((1.0, 3.0, 1.0), (0.0, 0.8, 0.0))),
    Undo(),
]


def record_some(path: Path) -> None:
    """Record a short play with commands."""
    world = Ball()
    with Recording(path) as recording:
        recording.about = {"scene": "ring_toss", "seed": 3, "body": ["ball"], "options": {"animal": "fox"}}
        recording.about["world"] = {"interaction": "physics", "sort": "pixel"}
        for k, frame in enumerate(some_frames(24)):
            frame.commands = COMMANDS[k : k + 2]
            world.step(recording.note(frame))
            recording.after(world)


def some_study() -> Study:
    """Three trials and two questionnaires."""
    trials = [
        Trial("Ida", "ring_toss", setting, "window", "2025-01-01T10:00:00", {"options": {}}, 30.0 + k, 2.0, 3.0,
              bool(k), 5, 3, 2.5, 1.5, 900, np.array([[0.0, 0.0], [4.0, k]]))
        for k, setting in enumerate(("physics", "transform", "physics"))
    ]  # fmt: skip
    answers = [
        Answers("Ida", setting, tuple(range(len(QUESTIONS))), "well", "now") for setting in ("physics", "transform")
    ]
    return Study(trials, answers)
