"""How much a thin part bends in cages of cells of one size and of several, with as many vertices.

`python -m bench.bending`: a ball of 16 cm with an ear of 8 mm, pushed sideways at its tip; linear elasticity
(bench/fem.py), as a share of what ever finer uniform lattices come to. Printed as Markdown.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from assets.asset import Cage
from bench.fem import stiffness
from core.errors import BadInput
from prepare.cage.cage import cage_of
from prepare.cage.mesh_quality import dihedral_angles
from prepare.cage.stuffing import stuff

RADIUS, LENGTH, WIDTH, THICK = 0.08, 0.11, 0.06, 0.008  # [m]
YOUNG, POISSON, FORCE = 3e4, 0.3, 0.01  # [Pa], [-], [N]
TIP = RADIUS + LENGTH - 0.015  # [m] what lies above is pushed
CHUNK = 100_000  # tets whose matrices are made at once


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
    tip = x[:, 1] > TIP
    volume = cage.volumes() * spacing**3
    weight = np.bincount(cage.tets.ravel(), np.repeat(volume / 4, 4), len(x)) * tip
    force = np.zeros_like(x)
    force[:, 2] = FORCE * weight / weight.sum()
    moves = x[:, 1] > 0
    tets = cage.tets[moves[cage.tets].any(1)]  # the others hold nothing that moves
    parts = [stiffness(x, tets[k : k + CHUNK], YOUNG, POISSON) for k in range(0, len(tets), CHUNK)]
    free = np.flatnonzero(np.repeat(moves, 3))
    A = sum(K[free][:, free] for K in parts).tocsr()
    b = force.ravel()[free]
    u, failed = spla.cg(A, b, rtol=1e-6, maxiter=20_000, M=two_level(A, x[moves]))
    if failed:
        raise RuntimeError("the solver did not converge")
    return float(b @ u) / FORCE  # the work the force does: a mean over the tip


def two_level(A: sp.csr_matrix, x: np.ndarray) -> spla.LinearOperator:
    """A preconditioner: the diagonal, and the rigid motions of boxes of vertices x (N, 3), solved for exactly.

    Slender parts bend by rigid motions of their pieces: without these the steps are counted in thousands.
    """
    width = (np.prod(np.ptp(x, axis=0)) / max(len(x) / 12, 1) / 3) ** (1 / 3)
    _, box = np.unique(np.floor((x - x.min(0)) / width).astype(int), axis=0, return_inverse=True)
    box = box.reshape(-1)
    count = np.bincount(box)
    centre = np.stack([np.bincount(box, a) for a in x.T], 1) / count[:, None]
    r = (x - centre[box]) / width
    columns = np.zeros((len(x), 3, 6))  # row k: what moves coordinate k
    columns[:, [0, 1, 2], [0, 1, 2]] = 1.0
    for k in range(3):
        columns[:, :, 3 + k] = np.cross(np.eye(3)[k], r)
    rows = np.repeat(np.arange(3 * len(x)), 6)
    where = (6 * box[:, None, None] + np.arange(6) + np.zeros((3, 1), int)).ravel()
    P = sp.csr_matrix((columns.ravel(), (rows, where)), shape=(3 * len(x), 6 * len(count)))
    coarse = (P.T @ A @ P).tocsc()
    coarse += 1e-9 * coarse.diagonal().max() * sp.identity(coarse.shape[0], format="csc")  # a box of one vertex
    solve, diagonal = spla.splu(coarse).solve, A.diagonal()
    return spla.LinearOperator(A.shape, lambda v: v / diagonal + P @ solve(P.T @ v))


def reference(cells: list[float], spacing: float = 0.001) -> tuple[list[tuple[int, float]], float]:
    """Uniform lattices of these cells [m], from wide to narrow: vertices and how far [m] the tip goes, of each; and the
    limit by Richardson's extrapolation of the last two. Linear tets are too stiff by the square of a cell, so that it
    is the inverse, the stiffness, that is extrapolated.
    """
    rows = []
    for cell in cells:
        cage = stuff(ball_with_ear(spacing) * np.float32(spacing), np.zeros(3), spacing, cell=cell)
        rows.append((len(cage.vertices), bent_by(cage, 1.0)))
        print(f"cells of {1e3 * cell:.2f} mm, {rows[-1][0]} vertices: {1e3 * rows[-1][1]:.3f} mm", flush=True)
    ratio = (cells[-2] / cells[-1]) ** 2
    return rows, (ratio - 1) / (ratio / rows[-1][1] - 1 / rows[-2][1])


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
    mm = "uniform cells of the reference [m]: the last two are extrapolated (default 8, 4, 2.7 and 2 mm)"
    parser.add_argument("--reference", nargs="+", type=float, default=[0.008, 0.004, 0.008 / 3, 0.002], help=mm)
    args = parser.parse_args()
    ti.init(arch=ti.cpu, offline_cache=True, log_level=ti.WARN)
    begin = time.perf_counter()
    _, fine = reference(args.reference)
    print(f"the limit: {1e3 * fine:.3f} mm ({time.perf_counter() - begin:.0f} s)\n")
    print("| asked | cells | vertices | tets | smallest angle | of vertices in the ear | bends, of the limit |")
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
