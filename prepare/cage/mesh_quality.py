"""Quality of a tetrahedral mesh: dihedral angles, where its surface is no manifold, and an energy to be minimised.

The energy takes stiffness and shape of all tets as one number; its gradient moves the vertices (relaxation.py):

    E = sum_t (kappa_t W^(2/3) / unit)^p + (SHAPE q_t)^p
    kappa_t = 1 / 9 sum_a A_a^2 / (V_t m_a),  m_a = sum of V / 4 around a,  q_t = (sum of squared edges)^1.5 / V_t

with the area A_a of the face opposite corner a, the cage's volume W, and q = 1 for a regular tet. The longest stable
substep falls with the largest kappa (sim/time_step.py); the factor W makes E scale-invariant, so that growing does not
lower it. Vertices gather what tets contribute in a fixed order, so that the same cage gives the same bits.
"""

import numpy as np
import taichi as ti
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from core.tetmesh import TET_EDGES, TET_FACES, cross_columns, edge_vectors, vertex_set_keys

POWER = 8  # high enough for the worst tets to dominate, low enough for their neighbours to follow
SHAPE = 2.0  # a tet this many times worse in shape than a regular one counts as much as one of median kappa
REGULAR = 6**1.5 * 6 * 2**0.5  # (sum of squared edges)^1.5 / V of a regular tet
FACES = tuple(map(tuple, TET_FACES.tolist()))

Vector = ti.types.ndarray(dtype=ti.f64, ndim=1)
Matrix = ti.types.ndarray(dtype=ti.f64, ndim=2)
Indices = ti.types.ndarray(dtype=ti.i32, ndim=1)
Tets = ti.types.ndarray(dtype=ti.i32, ndim=2)


@ti.func
def corner(x: ti.template(), tets: ti.template(), t, k: ti.template()):
    """Position of corner k of tet t."""
    v = tets[t, k]
    return ti.Vector([x[v, 0], x[v, 1], x[v, 2]], ti.f64)


@ti.func
def face_normals(c: ti.template()):
    """Outward normals of the faces of a tet with corners c, twice the areas long."""
    return [(c[f[1]] - c[f[0]]).cross(c[f[2]] - c[f[0]]) for f in ti.static(FACES)]


@ti.kernel
def _volumes(x: Matrix, tets: Tets, first: Indices, slot: Indices, volume: Vector, mass: Vector):
    """Out: volumes of the tets, and of the vertices (m_a)."""
    for t in volume:
        c = [corner(x, tets, t, k) for k in ti.static(range(4))]
        volume[t] = (c[1] - c[0]).dot((c[2] - c[0]).cross(c[3] - c[0])) / 6
    for v in mass:
        total = ti.cast(0.0, ti.f64)
        for s in range(first[v], first[v + 1]):
            total += volume[slot[s] // 4]
        mass[v] = total / 4


@ti.kernel
def _terms(
    x: Matrix, tets: Tets, scale: ti.f64, unit: ti.f64, shape: ti.f64, volume: Vector, mass: Vector, kappa: Vector,
    stiffness: Vector, distortion: Vector,
):  # fmt: skip
    """Out: kappa_t W^(2/3), and both terms of E of each tet.

    scale = W^(2/3) / 9; shape = SHAPE / REGULAR: an argument, because a literal would be float32
    """
    for t in volume:
        c = [corner(x, tets, t, k) for k in ti.static(range(4))]
        n = face_normals(c)
        total, square = ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64)
        mean = (c[0] + c[1] + c[2] + c[3]) / 4
        for a in ti.static(range(4)):
            total += scale / volume[t] * n[a].norm_sqr() / (4 * mass[tets[t, a]])
            square += 4 * (c[a] - mean).norm_sqr()
        kappa[t] = total
        stiffness[t] = (total / unit) ** POWER
        distortion[t] = (shape * square * ti.sqrt(square) / volume[t]) ** POWER


@ti.kernel
def _gradient(
    x: Matrix, tets: Tets, first: Indices, slot: Indices, scale: ti.f64, by_whole: ti.f64, volume: Vector, mass: Vector,
    kappa: Vector, stiffness: Vector, distortion: Vector, by_mass: Matrix, mass_gradient: Vector,
    corner_gradient: Matrix, gradient: Matrix,
):  # fmt: skip
    """Chain rule through volumes, vertex masses, face normals and edges. Out: gradient = dE / dx, (V, 3).

    scale = W^(2/3) / 9; by_whole = dE / dW
    """
    for t in volume:
        common = scale / volume[t]
        c = [corner(x, tets, t, k) for k in ti.static(range(4))]
        n = face_normals(c)
        for a in ti.static(range(4)):
            m = mass[tets[t, a]]
            by_mass[t, a] = -POWER * stiffness[t] / kappa[t] * common * n[a].norm_sqr() / (4 * m * m)
    for v in mass_gradient:
        total = ti.cast(0.0, ti.f64)
        for s in range(first[v], first[v + 1]):
            total += by_mass[slot[s] // 4, slot[s] % 4]
        mass_gradient[v] = total
    for t in volume:
        common = scale / volume[t]
        c = [corner(x, tets, t, k) for k in ti.static(range(4))]
        n = face_normals(c)
        by_volume = by_whole - POWER * (stiffness[t] + distortion[t]) / volume[t]
        mean, square = (c[0] + c[1] + c[2] + c[3]) / 4, ti.cast(0.0, ti.f64)
        for a in ti.static(range(4)):
            by_volume += mass_gradient[tets[t, a]] / 4
            square += 4 * (c[a] - mean).norm_sqr()
        out = [12 * POWER * distortion[t] / square * (c[a] - mean) - by_volume / 6 * n[a] for a in ti.static(range(4))]
        for a in ti.static(range(4)):
            h = POWER * stiffness[t] / kappa[t] * common / (2 * mass[tets[t, a]]) * n[a]  # dE / dnormal_a
            p, q, r = ti.static(FACES[a])
            out[p] += h.cross(c[r] - c[q])
            out[q] += h.cross(c[p] - c[r])
            out[r] += h.cross(c[q] - c[p])
        for a in ti.static(range(4)):
            for d in ti.static(range(3)):
                corner_gradient[t, 3 * a + d] = out[a][d]
    for v in range(gradient.shape[0]):
        total = ti.Vector([0.0, 0.0, 0.0], ti.f64)
        for s in range(first[v], first[v + 1]):
            t, k = slot[s] // 4, slot[s] % 4
            total += ti.Vector(
                [corner_gradient[t, 3 * k], corner_gradient[t, 3 * k + 1], corner_gradient[t, 3 * k + 2]], ti.f64
            )
        for d in ti.static(range(3)):
            gradient[v, d] = total[d]


class QualityEnergy:
    """E of `count` vertices and given tets (T, 4). Taichi must be running.

    volume  signed volume of each tet at the last evaluation, (T,) on the device
    kappa   kappa_t W^(2/3) of each tet there, (T,) on the device
    """

    def __init__(self, tets: np.ndarray, count: int) -> None:
        flat = np.asarray(tets, np.int64).ravel()
        self.count, n = count, len(tets)
        self._tets = device_array(ti.i32, tets)
        self._slot = device_array(ti.i32, np.sort(flat * len(flat) + np.arange(len(flat))) % len(flat))
        self._first = device_array(ti.i32, np.concatenate([[0], np.bincount(flat, minlength=count).cumsum()]))
        self.volume, self.kappa, self._stiffness, self._distortion = (ti.ndarray(ti.f64, n) for _ in range(4))
        self._by_mass, self._corner_gradient = ti.ndarray(ti.f64, (n, 4)), ti.ndarray(ti.f64, (n, 12))
        self._mass, self._mass_gradient = ti.ndarray(ti.f64, count), ti.ndarray(ti.f64, count)

    def vectors(self, x: np.ndarray | None = None) -> ti.Ndarray:
        """A device array (V, 3): of x, or uninitialised."""
        return ti.ndarray(ti.f64, (self.count, 3)) if x is None else device_array(ti.f64, x)

    def energy(self, x: ti.Ndarray, gradient: ti.Ndarray, unit: float) -> float:
        """E at x (V, 3), infinite if a tet is inverted. Out: gradient (V, 3), undefined where E is infinite."""
        mesh, numbers, volumes = (x, self._tets), (self._first, self._slot), (self.volume, self._mass)
        _volumes(*mesh, *numbers, *volumes)
        volume = self.volume.to_numpy()
        if not volume.min() > 0:
            return np.inf
        whole = float(volume.sum())
        scale, terms = whole ** (2 / 3) / 9, (self.kappa, self._stiffness, self._distortion)
        _terms(*mesh, scale, unit, SHAPE / REGULAR, *volumes, *terms)
        stiffness = float(self._stiffness.to_numpy().sum())
        by_whole = POWER * stiffness * (2 / 3) / whole
        scratch = self._by_mass, self._mass_gradient, self._corner_gradient
        _gradient(*mesh, *numbers, scale, by_whole, *volumes, *terms, *scratch, gradient)
        return stiffness + float(self._distortion.to_numpy().sum())


def device_array(dtype, values: np.ndarray) -> ti.Ndarray:
    """A copy of host values on the device, of type ti.i32 or ti.f64."""
    values = np.ascontiguousarray(values, {ti.i32: np.int32, ti.f64: np.float64}[dtype])
    array = ti.ndarray(dtype, values.shape)
    array.from_numpy(values)
    return array


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
