"""Shapes of an animated body's cage while the solver plays its motion."""

from collections.abc import Iterator

import numpy as np

from assets.animation import START_RAMP
from assets.asset import Asset
from core.material import ANIMATED_MATERIAL, Material
from core.vocabulary import Body
from display.scene_bodies import AnimationTargets
from sim.bodies import SoftBody
from sim.solver import Solver


def animated_shapes(asset: Asset, *, seconds: float | None = None, **placed) -> Iterator[np.ndarray]:
    """Cage vertices [m] (V, 3) after each frame of 1/60 s: through the whole motion, or the first seconds of it.

    placed  position and scale of the body
    """
    cage, motion, material = asset.cage, asset.animation, Material.named(ANIMATED_MATERIAL)
    body = Body("animated", material, **placed)
    vertices = cage.vertices * np.float32(body.scale)
    led = motion.vertices[motion.driven]
    soft = SoftBody("animated", vertices, cage.tets, cage.surface, material, pinned=led, self_contact=False,
                    position=body.position)  # fmt: skip
    solver = Solver([soft], contacts=False)
    targets = AnimationTargets(0, body, motion, vertices)
    for _ in range(round(60 * (seconds or START_RAMP + motion.duration))):
        targets.drive(solver, 1 / 60)
        solver.step(1 / 60)
        yield solver.x.to_numpy()[: len(vertices)].astype(np.float64)
