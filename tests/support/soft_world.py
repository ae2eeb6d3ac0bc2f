"""Static shapes and capacity that tests of soft bodies share, so that they share compiled kernels."""

import numpy as np

from bench.physics import box
from core.vocabulary import Box, Capsule, Plane
from sim.contact.static_shapes import StaticGrid, rest_grid
from sim.model import Capacity
from sim.solver import Solver

CAPACITY = Capacity(vertices=1200, tets=2900, triangles=2400, samples=6000, nodes=800_000, bodies=16)
HALF = np.array([0.3, 0.2, 0.3])  # [m] of box and grids
TOP = 1.0  # [m] of box, grids and thick capsule; the floor is at 0
BOX, GRID, TURNED_GRID, CAPSULE, PEG = 10.0, 12.0, 14.0, 16.0, 18.0  # [m] where they stand along x
CAPSULE_RADIUS = 0.5
FLOOR = Plane((0, 0, 0), (0, 1, 0))


def shapes() -> list:
    """Floor, box, two distance grids of the same box, a thick capsule, and a peg on the floor."""
    x, tets, surface = box(2 * HALF, (2, 2, 2))
    grid = rest_grid(x - HALF, tets, surface, nodes=40)
    y = TOP - HALF[1]
    return [
        FLOOR,
        Box((BOX, y, 0), tuple(HALF)),
        StaticGrid(grid, position=(GRID, y, 0)),
        StaticGrid(grid, (np.cos(0.4), 0, np.sin(0.4), 0), (TURNED_GRID, TOP - 1.3 * HALF[1], 0), 1.3),
        Capsule((CAPSULE, TOP - CAPSULE_RADIUS, -1), (CAPSULE, TOP - CAPSULE_RADIUS, 1), CAPSULE_RADIUS, friction=1.0),
        Capsule((PEG, 0, 0), (PEG, 0.3, 0), 0.04),
    ]


def vertices_of(solver: Solver) -> list[np.ndarray]:
    """Positions of each body's vertices [m], (V, 3) float64."""
    return np.split(solver.snapshot()["x"].astype(np.float64), solver.vertex_offset[1:-1])


def soft_solver(bodies, *, floor: bool = True, more_shapes=(), **options) -> Solver:
    """A solver of these soft bodies in the shared world, with or without its floor, and 8 hands; none sleeps."""
    options = {"sleep": False, **options}
    return Solver(bodies, [*shapes()[0 if floor else 1 :], *more_shapes], hands=8, capacity=CAPACITY, **options)
