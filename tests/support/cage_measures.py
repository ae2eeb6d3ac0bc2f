"""Measured properties of cages: what the mesher promises, and the bending of a thin part."""

import numpy as np
from scipy.sparse.linalg import spsolve

from assets.asset import Cage
from assets.gaussians import Gaussians
from bench.physics import fem_stiffness
from core.point_location import TetLocator
from core.tetmesh import face_components, tet_volumes
from prepare.cage.cage_generation import cage_of
from prepare.cage.mesh_quality import dihedral_angles, non_manifold_vertices
from prepare.pipeline import Options, prepare
from tests.support.distance_shapes import box

ANGLE = 12.0  # [degrees] least dihedral angle
RADIUS, LENGTH, WIDTH, THICK = 0.08, 0.11, 0.06, 0.008  # [m]
YOUNG, POISSON, FORCE = 3e4, 0.3, 0.01  # [Pa], [-], [N]
TIP = RADIUS + LENGTH - 0.015  # [m] what lies above is pushed


def faults(gaussians: Gaussians, wanted: int) -> list[str]:
    """The promises that the cage of a prepared splat, +y up, breaks: none if it is sound. Raises BadInput."""
    asset = prepare(gaussians, Options(vertices=wanted, up="+y"))
    cage, g = asset.cage, asset.gaussians
    volume = tet_volumes(cage.vertices, cage.tets)
    points = g.means[g.opacities > 0.5].astype(np.float64)
    inside = (TetLocator(cage.vertices, cage.tets).find(points) >= 0).mean()
    broken = {
        "angle": dihedral_angles(cage.vertices, cage.tets).min() < ANGLE,
        "inverted": not (volume > 0).all(),
        "manifold": len(non_manifold_vertices(cage.surface)) > 0,
        "pieces": face_components(cage.tets).max() > 0,
        "volume": wanted >= 10_000 and abs(volume.sum() / asset.provenance["figures"]["filled"] - 1) > 0.03,
        "inside": inside < 0.995,
        "count": abs(len(cage.vertices) / wanted - 1) > 0.15,
    }
    return [name for name, is_broken in broken.items() if is_broken]


def ball_with_ear(spacing: float, thick: float = THICK) -> np.ndarray:
    """Signed distance [cells] of a ball about the origin with a plate that stands on it, across z."""
    low = np.array([-RADIUS - 0.02] * 3)
    high = np.array([RADIUS + 0.02, RADIUS + LENGTH + 0.02, RADIUS + 0.02])
    n = np.ceil((high - low) / spacing).astype(int)
    p = low + spacing * np.stack(np.meshgrid(*map(np.arange, n), indexing="ij"), -1)
    ball = np.linalg.norm(p, axis=-1) - RADIUS
    half = np.array([WIDTH, RADIUS + LENGTH, thick]) / 2
    ear = box(p - [0, half[1], 0], half)
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
    free = np.flatnonzero(np.repeat(moves, 3))
    A, b = fem_stiffness(x, tets, YOUNG, POISSON)[free][:, free].tocsc(), force.ravel()[free]
    return float(b @ spsolve(A, b)) / FORCE  # the work the force does: a mean over the tip


def bending(vertices: int, *, adaptive: bool, spacing: float, thick: float) -> dict:
    """A cage of the ball with the ear and how far it bends. Taichi must be running. Raises BadInput."""
    phi = ball_with_ear(spacing, thick)
    cage = cage_of(phi, np.zeros((0, 3)), vertices, lambda done: None, adaptive=adaptive)
    return {
        "vertices": len(cage.vertices),
        "angle": float(dihedral_angles(cage.vertices, cage.tets).min()),
        "bent": bent_by(cage, spacing),
    }
