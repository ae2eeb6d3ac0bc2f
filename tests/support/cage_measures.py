"""Measured properties of cages: what the mesher promises, and the bending of a thin part."""

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from assets.asset import Cage
from assets.gaussians import Gaussians
from bench.physics import fem_stiffness
from core.point_location import TetLocator
from core.tetmesh import face_components, tet_volumes
from prepare.cage.cage_generation import cage_of
from prepare.cage.mesh_quality import dihedral_angles, non_manifold_vertices
from prepare.pipeline import Options, prepare

SOUND = {"angle": 12.0, "volume": 3.0, "inside": 99.5, "count": 15.0}  # degrees, per cent
RADIUS, LENGTH, WIDTH, THICK = 0.08, 0.11, 0.06, 0.008  # [m]
YOUNG, POISSON, FORCE = 3e4, 0.3, 0.01  # [Pa], [-], [N]
TIP = RADIUS + LENGTH - 0.015  # [m] what lies above is pushed
CHUNK = 100_000  # tets whose matrices are made at once


def figures(cage: Cage, filled: float, points: np.ndarray, wanted: int) -> dict:
    """Measured guarantees of a cage. filled: volume [m^3] of the filled shape; points (N, 3) to be inside."""
    volume = tet_volumes(cage.vertices, cage.tets)
    return {
        "vertices": len(cage.vertices),
        "tets": len(cage.tets),
        "angle": float(dihedral_angles(cage.vertices, cage.tets).min()),
        "positive": bool((volume > 0).all()),
        "pinched": len(non_manifold_vertices(cage.surface)),
        "pieces": int(face_components(cage.tets).max()) + 1,
        "volume": 100 * (float(volume.sum()) / filled - 1),
        "inside": 100 * float((TetLocator(cage.vertices, cage.tets).find(points) >= 0).mean()),
        "count": 100 * (len(cage.vertices) / wanted - 1),
    }


def faults(row: dict, wanted: int) -> list[str]:
    """The promises that a row of `figures` breaks."""
    broken = {
        "angle": row["angle"] < SOUND["angle"],
        "inverted": not row["positive"],
        "manifold": row["pinched"] > 0,
        "pieces": row["pieces"] > 1,
        "volume": wanted >= 10_000 and abs(row["volume"]) > SOUND["volume"],
        "inside": row["inside"] < SOUND["inside"],
        "count": abs(row["count"]) > SOUND["count"],
    }
    return [name for name, is_broken in broken.items() if is_broken]


def measured(gaussians: Gaussians, vertices: int, **options) -> dict:
    """Prepare a splat and return the `figures` of its cage. Raises BadInput."""
    asset = prepare(gaussians, Options(vertices=vertices, **options))
    g = asset.gaussians
    points = g.means[g.opacities > 0.5].astype(np.float64)
    return figures(asset.cage, asset.provenance["figures"]["filled"], points, vertices)


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
    """Deflection [m] of the ear's tip under FORCE across it, the ball's lower half held."""
    x = cage.vertices.astype(np.float64) * spacing + np.array([-RADIUS - 0.02] * 3)
    tip = x[:, 1] > TIP
    volume = cage.volumes() * spacing**3
    weight = np.bincount(cage.tets.ravel(), np.repeat(volume / 4, 4), len(x)) * tip
    force = np.zeros_like(x)
    force[:, 2] = FORCE * weight / weight.sum()
    moves = x[:, 1] > 0
    tets = cage.tets[moves[cage.tets].any(1)]  # the others hold nothing that moves
    parts = [fem_stiffness(x, tets[k : k + CHUNK], YOUNG, POISSON) for k in range(0, len(tets), CHUNK)]
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


def bending(vertices: int, *, adaptive: bool, spacing: float = 0.00125, thick: float = THICK) -> dict:
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
