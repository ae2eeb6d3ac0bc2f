"""One body settled by newton's SolverVBD on the CPU. Runs in newton's own environment, without this project.

    python newton_vbd.py CASE.npz OUT.npz

CASE holds vertices (V, 3) [m], tets (T, 4), pinned (P,), and the numbers density [kg/m^3], mu, lam [Pa] (Lame's),
gravity [m/s^2] along -y, duration, dt [s], iterations. OUT: positions (V, 3), speed [m/s] of the fastest vertex at the
end, seconds of running, version.

Viscosity slows the convergence of the descent, so the body settles without: each time its kinetic energy falls it is
stopped (dynamic relaxation, Cundall 1976).
"""

import sys
import time

try:
    import newton
    import warp as wp
except ImportError as e:
    sys.exit(f"newton cannot be imported ({e}): pip install -r bench/peers/requirements-newton.txt")
import numpy as np


def run_to_rest(case) -> dict:
    number = {key: case[key].item() for key in case if case[key].ndim == 0}
    builder = newton.ModelBuilder(up_axis=newton.Axis.Y, gravity=(0.0, -number["gravity"], 0.0))
    builder.add_soft_mesh(
        pos=wp.vec3(0.0),
        rot=wp.quat_identity(),
        scale=1.0,
        vel=wp.vec3(0.0),
        vertices=case["vertices"].tolist(),
        indices=case["tets"].ravel().tolist(),
        density=number["density"],
        k_mu=number["mu"],
        k_lambda=number["lam"],
        k_damp=0.0,
    )
    for i in case["pinned"]:
        builder.particle_mass[int(i)] = 0.0
    builder.color()
    model = builder.finalize(device="cpu")
    solver = newton.solvers.SolverVBD(model, iterations=int(number["iterations"]), particle_enable_tile_solve=False)
    now, after, control = model.state(), model.state(), model.control()
    steps = round(number["duration"] / number["dt"])
    solver.step(now, after, control, None, 1e-9)  # compiles
    masses, before = model.particle_mass.numpy(), 0.0
    begin = time.perf_counter()
    for _ in range(steps):
        now.clear_forces()
        solver.step(now, after, control, None, number["dt"])
        now, after = after, now
        velocities = now.particle_qd.numpy()
        energy = masses @ (velocities**2).sum(1)
        if energy < before:
            now.particle_qd.zero_()
            energy = 0.0
        before = energy
    seconds = time.perf_counter() - begin
    speed = np.linalg.norm(velocities, axis=1).max()
    return {"positions": now.particle_q.numpy(), "speed": speed, "seconds": seconds, "version": newton.__version__}


if __name__ == "__main__":
    wp.config.quiet = True
    np.savez(sys.argv[2], **run_to_rest(np.load(sys.argv[1])))
