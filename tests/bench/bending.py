"""How much a thin part bends in cages of cells of one size and of several, with as many vertices.

`python -m tests.bench.bending`: a ball of 16 cm with an ear of 8 mm, pushed sideways at its tip; linear elasticity
(tests/fem.py), as a share of what a fine cage does. Printed as Markdown.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import scipy.sparse.linalg as spla

from assets.asset import Cage
from assets.errors import BadInput
from prepare.cage import cage_of
from prepare.quality import dihedral_angles
from tests.fem import stiffness

RADIUS, LENGTH, WIDTH, THICK = 0.08, 0.11, 0.06, 0.008  # [m]
YOUNG, POISSON, FORCE = 3e4, 0.3, 0.01  # [Pa], [-], [N]
TIP = RADIUS + LENGTH - 0.015  # [m] what lies above is pushed


def ball_with_ear(spacing: float, thick: float = THICK) -> np.ndarray:
    """Signed distance [cells] of a ball about the origin with a plate that stands on it, across z."""
    low = np.array([-RADIUS - 0.02] * 3)
    high = np.array([RADIUS + 0.02, RADIUS + LENGTH + 0.02, RADIUS + 0.02])
    n = np.ceil((high - low) / spacing).astype(int)
    p = low + spacing * np.stack(np.meshgrid(*map(np.arange, n), indexing="ij"), -1)
    ball = np.linalg.norm(p, axis=-1) - RADIUS
    half = np.array([WIDTH, RADIUS + LENGTH, thick]) / 2
    q = np.abs(p - [0, half[1], 0]) - half
    ear = np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(-1), 0)
    return (np.minimum(ball, ear) / spacing).astype(np.float32)


def bent_by(cage: Cage, spacing: float) -> float:
    """How far [m] the ear's tip goes under FORCE across it, the ball's lower half held."""
    x = cage.vertices.astype(np.float64) * spacing + np.array([-RADIUS - 0.02] * 3)
    K = stiffness(x, cage.tets, YOUNG, POISSON)
    tip = x[:, 1] > TIP
    volume = cage.volumes() * spacing**3
    weight = np.bincount(cage.tets.ravel(), np.repeat(volume / 4, 4), len(x)) * tip
    force = np.zeros_like(x)
    force[:, 2] = FORCE * weight / weight.sum()
    free = np.flatnonzero(np.repeat(x[:, 1] > 0, 3))
    A, b = K[free][:, free], force.ravel()[free]
    diagonal = A.diagonal()
    jacobi = spla.LinearOperator(A.shape, lambda r: r / diagonal)
    u, failed = spla.cg(A, b, rtol=1e-6, maxiter=20_000, M=jacobi)
    if failed:
        raise RuntimeError("the solver did not converge")
    return float(b @ u) / FORCE  # the work the force does: a mean over the tip


def measure(vertices: int, *, adaptive: bool, spacing: float = 0.00125, thick: float = THICK) -> dict:
    """A cage of the ball with the ear and how far it bends. Taichi must be running. Raises BadInput."""
    phi = ball_with_ear(spacing, thick)
    cage = cage_of(phi, np.zeros((0, 3)), vertices, lambda done: None, adaptive=adaptive)
    return {
        "vertices": len(cage.vertices),
        "tets": len(cage.tets),
        "angle": float(dihedral_angles(cage.vertices, cage.tets).min()),
        "in the ear": float((cage.vertices[:, 1] * spacing - RADIUS - 0.02 > RADIUS).mean()),
        "bent": bent_by(cage, spacing),
    }


def main() -> None:
    import taichi as ti

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", nargs="+", type=int, default=[1000, 2000, 5000, 10_000])
    parser.add_argument("--fine", type=int, default=60_000)
    args = parser.parse_args()
    ti.init(arch=ti.cpu, offline_cache=True, log_level=ti.WARN)
    begin = time.perf_counter()
    fine = measure(args.fine, adaptive=True)["bent"]
    print(f"{args.fine} vertices bend by {1e3 * fine:.3f} mm ({time.perf_counter() - begin:.0f} s)\n")
    print("| asked | cells | vertices | tets | smallest angle | of vertices in the ear | bends, of the fine cage's |")
    print("| --- " * 7 + "|", flush=True)
    for size in args.sizes:
        for adaptive in (False, True):
            name = "graded" if adaptive else "of one size"
            try:
                row = measure(size, adaptive=adaptive)
            except BadInput as e:
                print(f"| {size} | {name} | refused: {e} |", flush=True)
                continue
            print(
                f"| {size} | {name} | {row['vertices']} | {row['tets']} | {row['angle']:.1f} | "
                f"{row['in the ear']:.0%} | {row['bent'] / fine:.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
