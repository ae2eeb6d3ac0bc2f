"""Impacts of rigid bodies that take more than a substep: through others, and into what does not give way."""

import numpy as np
import pytest

from scenes.scene import Plane
from sim.rigid.rigid_body import RigidBody
from sim.solver import Solver

SIDE = 0.1


def cube(x: float, low: float, restitution: float = 0.8, **options) -> RigidBody:
    """A cube with its lower face at this height [m]."""
    position = (x, low + SIDE / 2, 0.0)
    return RigidBody.box("cube", (SIDE,) * 3, density=1000.0, position=position, restitution=restitution, **options)


@pytest.fixture(scope="module")
def heights(ti_cpu) -> np.ndarray:
    """Heights of all cubes' centres [m] in 1.5 s, (frames, cubes)."""
    on_two = [cube(0, 0.0), cube(0, SIDE), cube(0, 0.75)]
    wedged = [cube(2, 1e-4, velocity=(0.0, -2.0, 0.0)), cube(2, SIDE + 5e-4, kinematic=True)]
    solver = Solver([*on_two, *wedged], [Plane((0, 0, 0), (0, 1, 0), 0.5)], hands=0, sleep=False)
    seen = []
    for _ in range(90):
        solver.step(1 / 60)
        seen.append([b.centroid[1] for b in solver.bodies()])
    return np.array(seen)


def test_what_falls_on_two_others_rebounds_from_the_floor_beneath_them(heights):
    """The floor's push comes through the two after some substeps: cut short after 4, it lifts the cube 10 cm less."""
    top = heights[:, 2]
    landed = round(60 * np.sqrt(2 * (0.75 - 2 * SIDE) / 9.81)) + 1
    assert top[landed] < 0.35
    assert 0.68 < top[landed:].max() < 0.8


def test_what_is_wedged_in_does_not_push_on(heights):
    """A cube that a plate leaves half a millimetre cannot rebound: after 16 substeps of trying it is 1 mm inside."""
    assert heights[:, 3].max() < SIDE / 2 + 5e-4 + 1e-4
