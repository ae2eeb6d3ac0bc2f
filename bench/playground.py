"""Rigid scenes that stand far apart in one solver, so that their kernels are compiled once."""

import numpy as np

from scenes.scene import Plane
from sim.rigid.rigid_body import RigidBody
from sim.solver import Solver

SIDE = 0.1  # [m] of the boxes
DROP = 0.5  # [m]
RESTITUTIONS = (0.0, 0.5, 0.8)
BRICK = (0.2, 0.06, 0.1)
FLOOR = Plane((0, 0, 0), (0, 1, 0), 0.6)
OCTAHEDRON = 0.07 * np.concatenate([np.eye(3), -np.eye(3)])


def cube(name: str, x: float, y: float, z: float, **options) -> RigidBody:
    """A box of SIDE with its lower face at height y."""
    options.setdefault("density", 1000.0)
    return RigidBody.box(name, (SIDE,) * 3, position=(x, y + SIDE / 2, z), **options)


def stack() -> list[RigidBody]:
    """Five boxes on one another, not quite aligned."""
    return [cube(f"stack {k}", 0.003 * (-1) ** k, SIDE * k, 0.002 * (k % 3)) for k in range(5)]


def bouncing() -> list[RigidBody]:
    """For each restitution a box, flat, and an octahedron, on its tip, DROP above the floor."""
    bodies = []
    for k, e in enumerate(RESTITUTIONS):
        bodies.append(cube(f"box {e}", 2 + k, DROP, 0, restitution=e))
        place = {"position": (2 + k, DROP + 0.07, 1), "restitution": e, "density": 1000.0}
        bodies.append(RigidBody.convex(f"octahedron {e}", OCTAHEDRON, **place))
    return bodies


def wall(courses: int = 4, length: int = 3) -> list[RigidBody]:
    """Bricks in a running bond."""
    bricks = []
    for row in range(courses):
        for k in range(length - row % 2):
            x = (k + 0.5 * (row % 2)) * (BRICK[0] + 0.002)
            y = (row + 0.5) * BRICK[1]
            bricks.append(RigidBody.box(f"brick {row} {k}", BRICK, density=1800.0, position=(x, y, 6)))
    return bricks


def heavy_on_light() -> list[RigidBody]:
    """A box a hundred times as heavy as the one that it rests on."""
    return [cube("light", 0, 0, 10), cube("heavy", 0.01, SIDE, 10, density=100_000.0)]


def sliding() -> list[RigidBody]:
    """A flat box."""
    return [RigidBody.box("slider", (0.1, 0.04, 0.1), density=1000.0, position=(0, 0.02, 18))]


def conveyor() -> list[RigidBody]:
    """A kinematic plate, and a box that lies on it."""
    plate = RigidBody.box("plate", (1.0, 0.05, 0.4), density=1000.0, position=(0, 0.5, 14), kinematic=True)
    return [plate, cube("load", 0, 0.525, 14)]


def playground() -> tuple[Solver, dict[str, slice]]:
    """The solver, and where the bodies of each scene are."""
    bodies, where = [], {}
    for scene in (stack, bouncing, wall, heavy_on_light, conveyor, sliding):
        new = scene()
        where[scene.__name__] = slice(len(bodies), len(bodies) + len(new))
        bodies += new
    return Solver(bodies, [FLOOR], hands=1), where
