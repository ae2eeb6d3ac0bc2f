"""Impact: a body that strikes a wall is stopped by it, however stiff and light it is."""

import numpy as np

from bench.sample_meshes import box
from bench.setups import strain_energy
from core.material import Material
from scenes.scene import Plane
from sim.soft_body import SoftBody
from sim.solver import Solver

DT = 1 / 60
FOAM = Material(young=2.4e7, poisson=0.478, density=18.7, friction=0.12, damping=0.0)  # descent, dt^2 kappa = 3e4
BARS, SPEED = 12, 11.0


def test_light_stiff_bodies_that_graze_a_wall_gain_no_energy(ti_cpu):
    """They strike with one vertex and slide: the push on it alone would turn them by many radians a substep."""
    x, tets, surface = box((0.08, 0.02, 0.02), (6, 1, 1))
    rng = np.random.default_rng(0)
    turns = rng.normal(size=(BARS, 4))
    bodies = [
        SoftBody("foam", x, tets, surface, FOAM, rotation=tuple(q / np.linalg.norm(q)), position=(0, 0.06, 0.3 * k))
        for k, q in enumerate(turns)
    ]
    solver = Solver(bodies, [Plane((0, 0, 0), (0, 1, 0))], gravity=(0.0, 0.0, 0.0), self_contact=False)
    assert solver.stats["integrator"] == "vbd" and solver.stats["stability"] > 30
    q = solver.snapshot()
    solver.restore({"x": q["x"], "v": np.zeros_like(q["x"]) - [SPEED, 0.8, 0.0]})
    parts, n = q["bodies"], len(x)
    begin, most = 0.5 * parts[0].mass.sum() * (SPEED**2 + 0.8**2), 0.0
    for _ in range(12):
        solver.step(DT)
        q = solver.snapshot()
        assert q["x"][:, 1].min() > -1e-3
        now = []
        for k, part in enumerate(parts):
            y, v = (q[name][k * n : (k + 1) * n].astype(np.float64) for name in ("x", "v"))
            now.append(0.5 * part.mass @ (v**2).sum(1) + strain_energy(part, y))
        most = max(most, *now)
    assert most < 3 * begin  # for a moment more than half of it may be strain that the sweeps have not taken out yet
    assert max(now) < begin  # without gravity, friction and the wall only take
