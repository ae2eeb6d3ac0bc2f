"""A persistent kernel against the plain loops: two blocks on a floor, one on the other, sliding."""

from collections.abc import Callable

import numpy as np
from numpy.testing import assert_allclose

from bench.sample_meshes import box
from core.material import Material
from core.vocabulary import Plane
from sim.model import BodyModel, Model, SoftBody
from sim.rigid.rigid_body import RigidBody
from sim.solver import Solver


def assert_blocks_slide_alike(
    forms: list[Callable[[Solver], object]],
    young: float,
    cells: tuple[int, int, int],
    tolerances,
    rigid: bool = False,
    **options,
) -> None:
    """Compare two integrators, made by `forms` for a solver with these options, on blocks of so many cells.

    rigid: the lower block does not deform.
    tolerances [m]: after a 180th of a second, and at the end. At last the upper block sleeps, and stays to the bit.
    """
    moved = []
    x, tets, surface = box((0.2, 0.1, 0.1), cells)
    material, n = Material(young, 0.3, 1000.0, friction=0.3), len(x)
    lower = SoftBody("lower", x, tets, surface, material, velocity=(0.5, 0.0, 0.0))
    if rigid:
        at = {"position": x.mean(0), "velocity": lower.velocity}
        lower = RigidBody.box("lower", np.ptp(x, axis=0), density=1000.0, friction=0.3, **at)
        n = len(lower.vertices)
    upper = SoftBody("upper", x, tets, surface, material, position=(0.045, 0.1, 0.01))
    solver = Solver([lower, upper], [Plane((0, 0, 0), (0, 1, 0))], **options)
    for make in forms:
        solver.integrator = make(solver)
        solver.integrator.max_substeps = 16  # damping acts between launches
        solver.integrator.load(Model([BodyModel.of(b, []) for b in (lower, upper)]))
        solver.reset()
        for _ in range(3):
            solver.step(1 / 180)
            moved.append(solver.snapshot()["x"])
        solver.state.asleep[1] = 1
        solver.integrator.run(4)
        moved.append(solver.snapshot()["x"])
        assert (moved[-1][n:] == moved[-2][n:]).all() and (moved[-1][:n] != moved[-2][:n]).any()
    assert np.abs(moved[2] - np.concatenate([lower.start(), upper.start()])).max() > 0.005
    assert_allclose(moved[0], moved[4], rtol=0, atol=tolerances[0])
    assert_allclose(moved[3], moved[7], rtol=0, atol=tolerances[1])
