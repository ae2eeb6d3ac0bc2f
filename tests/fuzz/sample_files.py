"""Small files that hold all that an asset, a recording or a state may hold."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from assets.animation import Animation
from assets.asset import Asset
from assets.environment import Environment
from core.distance_grid import DistanceGrid
from core.material import Material
from core.vocabulary import Hand, Light
from display.keep.scene_state import game_state
from display.keep.state_file import SavedAnimation, SavedBody, SceneState, Settings
from display.record.recording import Recording
from display.user_commands import Duplicate, Pause, Rescale, Rotate, SetInteraction, SetLight, SetMaterial, Undo
from sim.hands.grasp import Grasp, GraspState
from tests.assets.test_fitted_clip import filmed
from tests.assets.test_quantisation import embedded
from tests.display.test_recording import Ball, some_frames
from tests.support.samples import some_gaussians


def sphere_grid(nodes: int, spacing: float) -> DistanceGrid:
    axis = spacing * (np.arange(nodes) - nodes / 2)
    distance = np.linalg.norm(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1), axis=-1) - axis[-1] / 2
    return DistanceGrid(distance.astype(np.float16), np.full(3, axis[0]), spacing)


def moving_body() -> Asset:
    """A bar with a cage, an embedding, a grid, a material, a clip and a motion of two joints."""
    asset = filmed(embedded(n=60, exact=4))
    surface = np.unique(asset.cage.surface).astype(np.int32)
    count, frames = len(surface), 5
    angle = np.linspace(0, 1, frames)
    turns = np.stack([np.cos(angle), 0 * angle, 0 * angle, np.sin(angle)], 1)
    rest = (np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1)), np.ones((2, 3)))
    motion = (np.zeros((frames, 2, 3)), np.tile(turns[:, None], (1, 2, 1)), np.ones((frames, 2, 3)))
    joints = np.tile(np.array([0, 1, 0, 0], np.int32), (count, 1))
    weights = np.tile(np.array([0.75, 0.25, 0, 0], np.float32), (count, 1))
    names, parents, driven = ["lower", "upper"], np.array([-1, 0], np.int32), np.arange(count) % 2 == 0
    bind = np.tile(np.eye(4), (2, 1, 1))
    animation = Animation(names, parents, bind, rest, motion, 30.0, surface, joints, weights, driven)
    return replace(
        asset,
        sdf=sphere_grid(7, 0.1),
        material=Material(5e4, 0.4, 1100.0, damping=1.0, kinetic_friction=0.25),
        animation=animation,
        provenance={"source": "test.ply", "options": {"vertices": 500}, "steps": [1, 2]},
    )


def some_stage() -> Asset:
    planes = (("floor", 0.0, -1.0, -1.0, 1.0, 1.0), ("table", 0.7, -0.5, -0.5, 0.5, 0.5))
    environment = Environment(0.0, (0.0, 0.7, 0.0), (0.0, 1.6, 1.0), 0.3, planes, (sphere_grid(5, 0.05),))
    return Asset(some_gaussians(40, 1), sdf=sphere_grid(9, 0.1), environment=environment)


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
