"""Small recordings, studies and states."""

from pathlib import Path

import numpy as np

from core.material import Material
from core.vocabulary import Hand, Light
from display.keep.scene_state import game_state
from display.keep.state_file import SavedAnimation, SavedBody, SceneState, Settings
from display.record.recording import Recording
from display.user_commands import Duplicate, Pause, Rescale, Rotate, SetInteraction, SetLight, SetMaterial, Undo
from sim.hands.grasp import Grasp, GraspState
from tests.display.test_recording import Ball, some_frames

COMMANDS = [Pause(False), Duplicate(0), Rescale(0, 1.25), Rotate(None, (1.0, 0.0, 0.0, 0.0)), SetMaterial(0, "rubber")]
COMMANDS += [SetInteraction("transform"), SetLight(Light((1.0, 3.0, 1.0), (0.0, 0.8, 0.0))), Undo()]


def record_some(path: Path) -> None:
    world = Ball()
    with Recording(path) as recording:
        recording.about = {"scene": "ring_toss", "seed": 3, "body": ["ball"], "options": {"animal": "fox"}}
        recording.about["world"] = {"interaction": "physics", "sort": "pixel"}
        for k, frame in enumerate(some_frames(24)):
            frame.commands = COMMANDS[k : k + 2]
            world.step(recording.note(frame))
            recording.after(world)


class SomeGame:
    """A game with values of every kind that states keep."""

    def __init__(self):
        self.score, self.best, self.message, self.done = 3, 2.5, "on", {1, 4}
        self.path, self.since = [np.arange(3.0), None], {"ring 1": (True, 0.5)}
        self.light = Light((1.0, 3.0, 1.0), (0.0, 0.8, 0.0))


def some_state() -> SceneState:
    """A state of two bodies, one of which is held, and one animated."""
    materials = (Material.named("rubber"), Material.named("plush"))
    bodies = tuple(SavedBody(k, bool(k), 1.0 + k, m, "rubber", 5, not k) for k, m in enumerate(materials))
    grasp = Grasp(0, np.array([0, 2, 3, 4]), np.zeros((4, 3)))
    hand, pose = Hand((0.1, 0.8, 0.0), grip=True), (0.1, 0.8, 0.0, 1.0, 0.0, 0.0, 0.0)
    hands = GraspState((grasp, None), (hand, None), (((0.1, pose), (0.0, pose)), ()))
    animations = (SavedAnimation(1, 2.5, np.eye(4)),)
    light = Light((1.0, 3.0, 1.0), (0.0, 0.8, 0.0))
    settings = Settings(4.0, 0.0, (0.0, -9.81, 0.0), 0.5, "physics", light, (0.0, 1.6, 1.0), (0.0, 0.8, 0.0),
                        game_state(SomeGame()))  # fmt: skip
    about = {"scene": "ring_toss", "options": {"animal": "fox"}}
    motion = np.random.default_rng(0).normal(size=(4, 10, 3)).astype(np.float32)
    return SceneState(about, (("ring_red", "00" * 32),), (("cat.h5", "cat", "11" * 32),), bodies, motion,
                      np.zeros((3, 2)), animations, hands, settings)  # fmt: skip
