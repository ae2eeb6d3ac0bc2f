"""The same start on CUDA and on the CPU: positions after SUBSTEPS substeps. As a program, the CPU's half.

python -m bench.device_agreement OUT.npy [contacts]
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

SUBSTEPS = 128  # both devices take these in whole pieces; of 100 the CPU makes 105 shorter ones
SIZE = 0.3  # [m] of the longest body
TOLERANCE = 1e-5  # of SIZE: a hundred roundings of fp32 in another order
TOLERANCE_CONTACTS = 1e-3  # which contacts stick turns on roundings: starts 3e-8 m apart end 1.3e-4 apart on one device


def cuda_and_cpu() -> list[dict]:
    """The largest difference of any vertex. Without a CUDA GPU the rows are skipped: neither passed nor failed."""
    import taichi as ti

    rows = []
    for contacts in (False, True):
        check = f"CUDA and CPU, {SUBSTEPS} substeps{', contacts' if contacts else ''}, difference / size"
        most = TOLERANCE_CONTACTS if contacts else TOLERANCE
        row = {"check": check, "reference": 0.0, "measured": None, "tolerance": most, "pass": None}
        if ti.cfg.arch == ti.cuda:
            difference = np.abs(moved(contacts) - moved_in_another_process(contacts)).max() / SIZE
            rows.append({**row, "measured": float(difference), "pass": bool(difference <= most)})
        else:
            rows.append({**row, "note": "runs on a CUDA GPU only"})
    return rows


def moved(contacts: bool) -> np.ndarray:
    """Positions [m] after SUBSTEPS substeps, float64: a bent spinning bar, a block sliding on the floor, one on it."""
    from bench.sample_meshes import box
    from core.material import Material
    from scenes.scene import Plane
    from sim.soft_body import SoftBody
    from sim.solver import Solver

    jelly = Material(1e5, 0.4, 1000.0, friction=0.3, damping=0.0)  # which acts every few substeps, by device
    bar, cube = box((SIZE, 0.1, 0.1), (6, 2, 2)), box((0.1, 0.1, 0.1), (2, 2, 2))
    bodies = [
        SoftBody("bar", *bar, jelly, position=(0, 1, 0)),
        SoftBody("lower", *cube, jelly, position=(1, 0.0005, 0), velocity=(0.5, 0, 0)),
        SoftBody("upper", *cube, jelly, position=(1.03, 0.1005, 0.02), velocity=(0, -0.2, 0)),
    ]
    floor, frame = Plane((0, 0, 0), (0, 1, 0), friction=0.3), SUBSTEPS * 1e-4
    solver = Solver(bodies, [floor], substep=1e-4, frame_dt=frame, contacts=contacts)
    start = solver.snapshot()
    x, v = start["x"].astype(np.float64), start["v"].astype(np.float64)
    n = len(bar[0])
    v[:n] += np.cross([0.0, 0.0, 8.0], x[:n] - x[:n].mean(0))
    x[:n, 1] += 0.3 * (x[:n, 0] - SIZE / 2) ** 2
    solver.restore({"x": x, "v": v})
    solver.step(frame)
    end = solver.snapshot()
    return end["x"].astype(np.float64) + end["carry"]


def moved_in_another_process(contacts: bool) -> np.ndarray:
    """What `moved` gives on the CPU. Taichi runs on one kind of device a process."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "x.npy")
        root = Path(__file__).resolve().parents[1]
        command = [sys.executable, "-m", "bench.device_agreement", str(out), *(["contacts"] if contacts else [])]
        subprocess.run(command, cwd=root, check=True)
        return np.load(out)


if __name__ == "__main__":
    from core.runtime import start_taichi

    start_taichi("cpu")
    np.save(sys.argv[1], moved(contacts="contacts" in sys.argv[2:]))
