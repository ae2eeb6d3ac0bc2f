"""Depenetration: bodies that are pushed into something, or start there, come out slowly; none is thrown."""

import numpy as np
import pytest

from bench.sample_meshes import box
from core.material import Material
from scenes.scene import Box, Hand
from sim.contact.response import MAX_RECOVERY_SPEED
from sim.contact.signed_distance import rest_grid
from sim.contact.static_shapes import StaticGrid
from sim.soft_body import SoftBody
from sim.solver import Solver

DT, SIDE, APART = 1 / 60, 0.08, 2.0
RUBBER = Material(young=5e4, poisson=0.4, density=1100.0, damping=4.0)
HALF = np.array([0.3, 0.2, 0.3])


@pytest.fixture(scope="module")
def cubes(ti_cpu):
    """A cube on a box, one on a distance grid of a box (tops at y = 0), and two with nothing under them."""
    x, tets, surface = box((SIDE,) * 3, (2, 2, 2))
    bodies = [
        SoftBody(f"cube{k}", x - SIDE / 2, tets, surface, RUBBER, position=(APART * k, SIDE / 2 + 1e-3, 0))
        for k in range(4)
    ]
    solid = box(2 * HALF, (2, 2, 2))
    grid = rest_grid(solid[0] - HALF, *solid[1:], nodes=40)
    shapes = [Box((0, -HALF[1], 0), tuple(HALF)), StaticGrid(grid, position=(APART, -HALF[1], 0))]
    return Solver(bodies, shapes, hands=2)


def fastest(solver) -> float:
    return float(np.linalg.norm(solver.v.to_numpy()[: solver.vertex_offset[-1]], axis=1).max())


def test_what_hands_push_into_a_wall_comes_out_slowly(cubes):
    """Hands go 0.3 m deep into box and grid, with the 80 N that they have, and let go."""
    cubes.reset()
    cubes.gravity = (0.0, -9.81, 0.0)
    for k in range(40):
        y = SIDE / 2 - 0.3 * min(k / 20, 1)
        cubes.step(DT, [Hand((APART * b, y, 0), grip=k > 0, reach=0.1) for b in range(2)])
    speeds, heights = [], []
    for _ in range(60):
        cubes.step(DT, [])
        speeds.append(np.linalg.norm(cubes.v.to_numpy()[: cubes.vertex_offset[2]], axis=1).max())
        heights.append([b.centroid[1] for b in cubes.bodies()[:2]])
    assert max(speeds) < 2 * MAX_RECOVERY_SPEED, max(speeds)
    assert np.max(heights) < SIDE / 2 + 0.06
    assert min(b.low[1] for b in cubes.bodies()[:2]) > -1e-3


def test_what_starts_inside_comes_out_slowly(cubes):
    """3 cm deep in box and grid, and two cubes 4 cm in one another, without gravity."""
    x = np.asarray(cubes.body_models[0].body.vertices)
    place = [(0, SIDE / 2 - 0.03, 0), (APART, SIDE / 2 - 0.03, 0), (4 * APART, 0, 0), (4 * APART, 0.04, 0.005)]
    cubes.gravity = (0.0, 0.0, 0.0)
    start = np.concatenate([x + np.array(p) for p in place])
    cubes.restore({"x": start, "v": np.zeros_like(start)})
    top = 0.0
    for _ in range(60):
        cubes.step(DT, [])
        top = max(top, fastest(cubes))
    assert top < 3 * MAX_RECOVERY_SPEED, top
    states = cubes.bodies()
    assert min(s.low[1] for s in states[:2]) > -1e-3
    lower, upper = states[2:]
    assert upper.low[1] > lower.high[1] - 2e-3
    assert max(np.linalg.norm(s.velocity) for s in states) < 1.5 * MAX_RECOVERY_SPEED  # they spring back, too
