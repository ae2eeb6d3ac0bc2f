"""Bodies crushed to nearly nothing: they have only one rest shape."""

import numpy as np
import pytest

from scenes.scene import Material
from sim.body import SoftBody, rest_volumes
from sim.solver import Solver
from tests.meshes import box

POISSON = (0.0, 0.3, 0.4, 0.45)


def test_crushed_to_a_tenth_and_to_a_hundredth(ti_cpu):
    """With Psi of MATH 7 alone, F = 0 is a minimum, which draws in all that is smaller than 0.54 (nu = 0) to 0.29
    (nu = 0.3) of its size; and noise may leave kinks."""
    x, tets, surface = box((0.2, 0.1, 0.1), (4, 2, 2))
    rest, n = rest_volumes(x, tets), len(x)
    sizes = (0.5, 0.1, 0.01)
    kinds = [(nu, size) for nu in POISSON for size in sizes]
    bodies = [
        SoftBody(f"{nu}, {size}", x, tets, surface, Material(5e4, nu, 1000.0, damping=8.0), position=(0, 0, k))
        for k, (nu, size) in enumerate(kinds)
    ]
    solver = Solver(bodies, gravity=(0, 0, 0), contacts=False)
    rng = np.random.default_rng(4)
    start = [size * (x + rng.normal(0, 1e-3, x.shape)) + [0, 0, k] for k, (_, size) in enumerate(kinds)]
    solver.restore({"x": np.concatenate(start), "v": np.zeros((n * len(kinds), 3))})
    for _ in range(60):
        solver.step(1 / 20)
    q = solver.snapshot()["x"].astype(np.float64)
    for k, body in enumerate(bodies):
        volumes = rest_volumes(q[k * n : (k + 1) * n], tets)
        assert volumes.min() / rest.min() > 0.9, body.name
        assert volumes.sum() == pytest.approx(rest.sum(), rel=0.005), body.name
