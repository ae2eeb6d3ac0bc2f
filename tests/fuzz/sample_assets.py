"""Small assets that hold all that an asset may hold."""

from dataclasses import replace

import numpy as np

from assets.animation import Animation
from assets.asset import Asset
from assets.environment import Environment
from core.distance_grid import DistanceGrid
from core.material import Material
from tests.assets.test_quantisation import embedded
from tests.support.samples import some_gaussians


def sphere_grid(nodes: int, spacing: float) -> DistanceGrid:
    axis = spacing * (np.arange(nodes) - nodes / 2)
    distance = np.linalg.norm(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1), axis=-1) - axis[-1] / 2
    return DistanceGrid(distance.astype(np.float16), np.full(3, axis[0]), spacing)


def moving_body() -> Asset:
    """A bar with a cage, an embedding, a grid, a material and a motion of two joints."""
    asset = embedded(n=60, exact=4)
    surface = np.unique(asset.cage.surface).astype(np.int32)
    count, frames = len(surface), 5
    turns = np.stack(
        [np.cos(np.linspace(0, 1, frames)), *(np.sin(np.linspace(0, 1, frames)) * k for k in (0, 0, 1))], 1
    )
    rest = (np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1)), np.ones((2, 3)))
    motion = (np.zeros((frames, 2, 3)), np.tile(turns[:, None], (1, 2, 1)), np.ones((frames, 2, 3)))
    joints = np.tile(np.array([0, 1, 0, 0], np.int32), (count, 1))
    weights = np.tile(np.array([0.75, 0.25, 0, 0], np.float32), (count, 1))
    parents, inverse_bind, driven = (
        np.array([-1, 0], np.int32),
        np.tile(np.eye(4), (2, 1, 1)),
        np.arange(count) % 2 == 0,
    )
    names = ["lower", "upper"]
    animation = Animation(names, parents, inverse_bind, rest, motion, 30.0, surface, joints, weights, driven)
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
