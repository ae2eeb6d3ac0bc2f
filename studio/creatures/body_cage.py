"""The cage of a modelled body, from its exact surface: as `prepare` makes it, and then drawn onto that surface.

A cage for a capture is grown until it holds all Gaussians; of few vertices, it would end centimetres outside of what
one sees, and an animal would float over the grass.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.sparse import coo_matrix, csr_matrix

from assets.asset import Cage
from core.distance_grid import DistanceGrid
from core.tetmesh import cross_columns, edge_vectors, tet_volumes
from prepare.cage.mesh_quality import dihedral_angles

Surface = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]  # points -> signed distances, unit gradients

CORE = 0.6  # of the greatest depth: points from there on shall lie inside the cage, which is never in doubt
COARSE = 4  # nodes of the grid from one whose distance is found exactly to the next, but for those near the surface
ROUNDS, STEP = 60, 0.3  # of the way to the surface a round
SLIDE = 0.2  # of the way to the middle of its neighbours that a vertex slides along the surface a round
SPREAD = 12  # averagings of the displacement over the inner vertices
HALVINGS = 3  # of a step that would make tets too flat
ANGLE_MIN = 12.5  # [degrees] smallest dihedral angle of a tet that is changed
STIFFER = 1.1  # than the stiffest tet was, which decides how many substeps a frame takes, none may be moved to be
FOOT = 0.1  # of the height, up to which the lowest vertices of legs are feet, which stand on the ground


def solid_grid(surface: Surface, low, high, vertices: int) -> DistanceGrid:
    """Signed distance (X, Y, Z) float32 [m] in a box and around it, as fine as suits a cage of this many vertices."""
    from prepare.cage.component_cages import Grid

    grid = Grid.over(np.array([low, high], float), vertices)
    found = DistanceGrid(np.zeros(grid.shape, np.float32), grid.origin, grid.spacing)
    points = found.nodes().reshape(-1, 3)
    coarse = np.ix_(*(np.append(np.arange(0, n - 1, COARSE), n - 1) for n in grid.shape))
    nodes = found.nodes()[coarse]
    values = surface(nodes.reshape(-1, 3))[0].reshape(nodes.shape[:-1])
    known = RegularGridInterpolator([k.ravel() for k in coarse], values)
    values = known(np.stack(np.meshgrid(*map(np.arange, grid.shape), indexing="ij"), -1)).ravel()
    near = np.flatnonzero(np.abs(values) < 3 * COARSE * grid.spacing)
    values[near] = surface(points[near])[0]
    return DistanceGrid(values.reshape(grid.shape).astype(np.float32), grid.origin, grid.spacing)


def body_cage(surface: Surface, solid: DistanceGrid, ground: float, vertices: int) -> Cage:
    """Cage of about so many vertices on a surface that stands on y = `ground` [m]. Taichi must be running.

    solid  signed distance of the surface

    Raises NoSoundCage.
    """
    from prepare.cage.cage_generation import cage_of

    phi = solid.values / np.float32(solid.spacing)
    core = np.argwhere(phi < CORE * phi.min()).astype(np.float64)
    cage = cage_of(phi, core, vertices, lambda done: None)
    x = solid.origin + solid.spacing * cage.vertices.astype(np.float64)
    return Cage(drawn_onto(x, cage, surface, ground).astype(np.float32), cage.tets, cage.surface)


def drawn_onto(x: np.ndarray, cage: Cage, surface: Surface, ground: float) -> np.ndarray:
    """Vertices x (V, 3) [m] of the cage, the outer ones moved onto the surface as far as tets stay well shaped."""
    tets, outer = cage.tets, np.unique(cage.surface)
    inner = np.setdiff1d(np.arange(len(x)), outer)
    edges, within, beside = edges_of(cage.surface), averages(tets, len(x)), averages(cage.surface, len(x))
    stiff = STIFFER * stiffness(x, tets).max()
    angle = np.minimum(ANGLE_MIN, dihedral_angles(x, tets).min(1))
    for _ in range(ROUNDS):
        distance, normal = surface(x[outer])
        along = (beside @ x)[outer] - x[outer]
        along -= (along * normal).sum(1, keepdims=True) * normal
        u = np.zeros_like(x)
        u[outer] = SLIDE * along - STEP * distance[:, None] * normal
        lowest = np.full(len(x), np.inf)  # neighbour of each vertex
        np.minimum.at(lowest, edges[:, 0], x[edges[:, 1], 1])
        feet = outer[x[outer, 1] <= np.minimum(lowest[outer], ground + FOOT * np.ptp(x[:, 1]))]
        u[feet, 1] = STEP * (ground - x[feet, 1])
        for _ in range(SPREAD):
            u[inner] = (within @ u)[inner]
        for k in range(HALVINGS + len(x)):  # vertices of a tet that would be too flat move less, or stay
            flat = (tet_volumes(x + u, tets) <= 0) | (dihedral_angles(x + u, tets).min(1) < angle)
            moving = np.unique(tets[flat | (stiffness(x + u, tets) > stiff)])
            moving = moving[(u[moving] != 0).any(1)]
            if not len(moving):
                break
            u[moving] *= 0.5 if k < HALVINGS else 0.0
        x = x + u
    return x


def stiffness(x: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """V sum_a |grad N_a|^2 / V_a [1/m^2] of each tet (T,), V_a being a quarter of the volume around its corner a.

    Times (lambda + 2 mu) / rho it bounds the squared frequency of the tet (sim/time_step.py).
    """
    a, b, c = edge_vectors(x, tets)
    areas = [cross_columns(b, c), cross_columns(c, a), cross_columns(a, b)]  # grad N_a times 6 V, corners 1 to 3
    areas = np.stack([-sum(areas), *areas])  # (4, 3, T)
    volume = np.abs((a * areas[1]).sum(0)) / 6
    around = np.bincount(tets.ravel(), np.repeat(0.25 * volume, 4), len(x))
    squares = ((areas**2).sum(1) / np.maximum(around[tets.T], 1e-20)).sum(0)
    return squares / np.maximum(36 * volume, 1e-30)


def edges_of(simplices: np.ndarray) -> np.ndarray:
    """Edges (E, 2) of triangles or tets (T, K), in both directions, once for each simplex."""
    return np.concatenate([simplices[:, pair] for pair in permutations(range(simplices.shape[1]), 2)])


def averages(simplices: np.ndarray, count: int) -> csr_matrix:
    """Matrix (count, count) that averages over the neighbours of each vertex in triangles or tets (T, K)."""
    edges = edges_of(simplices)
    found = coo_matrix((np.ones(len(edges)), edges.T), (count, count)).tocsr()
    return csr_matrix(found.multiply(1 / np.maximum(found.sum(1), 1)))
