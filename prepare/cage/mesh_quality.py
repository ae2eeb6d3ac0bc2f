"""Quality of a tetrahedral mesh: dihedral angles, where its surface is no manifold, and an energy to be minimised.

The energy takes stiffness and shape of all tets as one number; its gradient moves the vertices (relaxation.py):

    E = sum_t (kappa_t W^(2/3) / unit)^p + (SHAPE q_t)^p
    kappa_t = 1 / 9 sum_a A_a^2 / (V_t m_a),  m_a = sum of V / 4 around a,  q_t = (sum of squared edges)^1.5 / V_t

with the area A_a of the face opposite corner a, the cage's volume W, and q = 1 for a regular tet. The longest stable
substep falls with the largest kappa (sim/time_step.py); the factor W makes E scale-invariant, so that growing does not
lower it.
"""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from core.tetmesh import TET_EDGES, TET_FACES, cross_columns, edge_vectors, vertex_set_keys

POWER = 8  # high enough for the worst tets to dominate, low enough for their neighbours to follow
SHAPE = 2.0  # a tet this many times worse in shape than a regular one counts as much as one of median kappa
REGULAR = 6**1.5 * 6 * 2**0.5  # (sum of squared edges)^1.5 / V of a regular tet


def quality_energy(x: np.ndarray, tets: np.ndarray, unit: float) -> tuple[float, np.ndarray | None, np.ndarray | None]:
    """E at x (V, 3), its gradient (V, 3), and kappa_t W^(2/3) (T,); infinite and None, None if a tet is inverted."""
    count, tets = len(x), np.ascontiguousarray(tets.T)
    columns = np.ascontiguousarray(x.T)
    corner = [columns.take(own, axis=1) for own in tets]  # (3, T) each, as all vectors here
    edge = {(p, q): corner[q] - corner[p] for p, q in TET_EDGES}
    edge |= {(q, p): -vector for (p, q), vector in edge.items()}
    normal = [cross_columns(edge[p, q], edge[p, r]) for p, q, r in TET_FACES]  # outward, twice the areas long
    volume = _dot(edge[0, 1], normal[0]) / 6
    if not volume.min() > 0:
        return np.inf, None, None
    whole = float(volume.sum())
    mass = sum(np.bincount(own, volume, count) for own in tets) / 4
    mass_at = [mass.take(own) for own in tets]
    scale = whole ** (2 / 3) / 9 / volume
    terms = [scale * _dot(n, n) / (4 * m) for n, m in zip(normal, mass_at, strict=True)]
    kappa = sum(terms)
    stiffness = (kappa / unit) ** POWER
    mean = sum(corner) / 4
    arm = [c - mean for c in corner]
    square = 4 * sum(_dot(a, a) for a in arm)  # of all six edges
    distortion = (SHAPE / REGULAR * square * np.sqrt(square) / volume) ** POWER

    # Chain rule through face normals, edges, vertex masses and volumes.
    by_kappa = POWER * stiffness / kappa
    by_mass = -sum(
        np.bincount(own, by_kappa * term / m, count) for own, term, m in zip(tets, terms, mass_at, strict=True)
    )
    by_volume = POWER * ((2 / 3) * stiffness.sum() / whole - (stiffness + distortion) / volume)
    by_volume += sum(by_mass.take(own) for own in tets) / 4
    by_arm = 12 * POWER * distortion / square
    gradient = [by_arm * a - by_volume / 6 * n for a, n in zip(arm, normal, strict=True)]
    for n, m, (p, q, r) in zip(normal, mass_at, TET_FACES, strict=True):
        by_normal = by_kappa * scale / (2 * m) * n
        gradient[p] += cross_columns(by_normal, edge[q, r])
        gradient[q] += cross_columns(by_normal, edge[r, p])
        gradient[r] += cross_columns(by_normal, edge[p, q])
    flat, by_corner = tets.ravel(), np.concatenate(gradient, axis=1)
    at_vertices = np.stack([np.bincount(flat, along, count) for along in by_corner], axis=1)
    return float(stiffness.sum() + distortion.sum()), at_vertices, kappa


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("it,it->t", a, b)


def dihedral_cosines(vertices: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Cosines of the six dihedral angles of each tet, (6, T), by pairs of the faces opposite corners 0 to 3."""
    a, b, c = edge_vectors(vertices, tets)
    normals = [cross_columns(c, b), cross_columns(a, c), cross_columns(b, a)]
    normals.insert(0, -(normals[0] + normals[1] + normals[2]))  # a closed surface
    normals = [n / np.maximum(np.sqrt(np.einsum("it,it->t", n, n)), 1e-300) for n in normals]
    return -np.stack([np.einsum("it,it->t", normals[i], normals[j]) for i, j in TET_EDGES]).clip(-1, 1)


def dihedral_angles(vertices: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """The six dihedral angles [degrees] of each tet, (T, 6)."""
    return np.degrees(np.arccos(dihedral_cosines(vertices, tets))).T


def smallest_angle(vertices: np.ndarray, tets: np.ndarray) -> float:
    """The smallest of all dihedral angles [degrees]."""
    return float(np.degrees(np.arccos(dihedral_cosines(vertices, tets).max())))


def non_manifold_vertices(surface: np.ndarray) -> np.ndarray:
    """Vertices where a closed surface (S, 3) is no 2-manifold.

    These are the ends of edges that bound other than two faces, and vertices whose faces form more than one fan.
    """
    surface = np.asarray(surface)
    if not len(surface):
        return np.zeros(0, np.int64)
    corner = surface.reshape(-1)
    n = int(corner.max()) + 1
    ends = np.concatenate([np.roll(surface, -k, axis=1).reshape(-1) for k in (1, 2)])
    # Each corner of a face touches two edges, told apart by end: corners that share one are of the same fan.
    _, edge, count = np.unique(np.tile(corner, 2) * np.int64(n) + ends, return_inverse=True, return_counts=True)
    irregular = np.tile(corner, 2)[count[edge] != 2]
    size = len(corner) + len(count)
    links = np.tile(np.arange(len(corner)), 2), len(corner) + edge
    _, fan = connected_components(coo_matrix((np.ones(len(edge), bool), links), (size, size)), directed=False)
    fans = np.unique(corner * np.int64(size) + fan[: len(corner)]) // size
    return np.unique(np.concatenate([irregular, np.flatnonzero(np.bincount(fans) > 1)]))


def euler_characteristic(surface: np.ndarray) -> int:
    """V - E + F: 2 a sphere, 0 a torus; 2 (components - handles) in general."""
    edges = np.sort(vertex_set_keys(np.asarray(surface)[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)))
    return len(np.unique(surface)) - int((np.diff(edges, prepend=-1) != 0).sum()) + len(surface)
