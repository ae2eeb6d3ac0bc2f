"""Bodies crushed to nearly nothing: they have only one rest shape."""

import numpy as np
import pytest

from bench.physics import box
from core.material import Material
from core.tetmesh import tet_volumes
from sim.bodies import SoftBody
from sim.solver import Solver

POISSON = (0.0, 0.3, 0.4, 0.45)


def test_crushed_to_a_tenth_and_to_a_hundredth(ti_cpu):
    """Without the last term of the energy, F = 0 is a minimum that attracts bodies smaller than 0.54 (nu = 0) to 0.29
    (nu = 0.3) of their size; and noise may leave kinks."""
    x, tets, surface = box((0.2, 0.1, 0.1), (4, 2, 2))
    rest, n = tet_volumes(x, tets), len(x)
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
        volumes = tet_volumes(q[k * n : (k + 1) * n], tets)
        assert volumes.min() / rest.min() > 0.9, body.name
        assert volumes.sum() == pytest.approx(rest.sum(), rel=0.005), body.name


@pytest.fixture(scope="module")
def tangled(ti_cpu):
    """Random starts, which leave kinks without inverted tets where nothing helps (at nu = 0.45 nearly always)."""
    x, tets, surface = box((0.2, 0.1, 0.1), (4, 2, 2))
    kinds = [(young, nu) for young in (5e3, 2e5) for nu in (0.3, 0.45) for _ in range(3)]
    bodies = [
        SoftBody(f"{nu}", x - [0.1, 0.05, 0.05], tets, surface, Material(young, nu, 1000.0, damping=8.0))
        for young, nu in kinds
    ]
    solver = Solver(bodies, gravity=(0, 0, 0), contacts=False)
    rng = np.random.default_rng(7)
    start = np.concatenate([rng.uniform(-1.0, 1.0, x.shape) * [0.1, 0.05, 0.05] for _ in kinds])
    return solver, {"x": start, "v": np.zeros_like(start)}


def test_random_starts_leave_no_kinks(tangled):
    solver, start = tangled
    solver.restore(start)
    for _ in range(2):
        for _ in range(60):
            solver.step(1 / 60)
        end = solver.snapshot()
        solver.restore({**end, "v": 0 * end["v"]})  # as a floor would: what spins is not made limp
    assert solver.stats["finite"] and not solver.untangling.active.any()
    x = np.split(solver.snapshot()["x"].astype(np.float64), solver.vertex_offset[1:-1])
    for model, at in zip(solver.body_models, x, strict=True):
        body = model.body
        volumes, rest = tet_volumes(at, body.tets), tet_volumes(body.vertices, body.tets)
        assert (volumes / rest).min() > 0.9, body.name
        assert volumes.sum() == pytest.approx(rest.sum(), rel=0.01), body.name


def test_a_snapshot_knows_what_is_mending(tangled):
    """Taken while bodies are limp, and again in another order; materials are themselves again at the end."""
    solver, start = tangled
    solver.restore(start)
    for _ in range(40):
        solver.step(1 / 60)
    assert solver.untangling.active.any()
    middle, ends = solver.snapshot(), []
    for _ in range(2):
        solver.remove(0)  # forgets nothing of the others
        solver.restore(middle)
        for _ in range(40):
            solver.step(1 / 60)
        ends.append(solver.snapshot()["x"])
        solver.reset()
        assert not solver.untangling.active.any()
    np.testing.assert_array_equal(*ends)
    mu = [m.body.material.lame_parameters[0] for m in solver.body_models]
    np.testing.assert_allclose(solver.state.mu.to_numpy()[: len(mu)], mu, rtol=1e-6)
