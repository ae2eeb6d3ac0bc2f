"""Linear elasticity of a cage: its stiffness matrix, its slow modes, and the shape that markers give it."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from core.tetmesh import TET_EDGES, tet_volumes

MARKER_STIFFNESS = (
    1e3  # of the springs to the markers together, in units of the cage's own stiffness in its slowest mode
)


def fem_stiffness(x: np.ndarray, tets: np.ndarray, young: float, poisson: float) -> sp.csr_matrix:
    """Stiffness matrix (3V, 3V) [N/m] of linear elasticity with constant-strain tets, float64."""
    lam, mu = young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))
    D = np.swapaxes(x[tets[:, 1:]] - x[tets[:, :1]], 1, 2)
    volume, inner = np.linalg.det(D) / 6, np.linalg.inv(D)
    g = np.concatenate([-inner.sum(1, keepdims=True), inner], axis=1)  # (T, 4, 3) gradients of the shape functions
    # K_ab = V (lam g_a g_b^T + mu g_b g_a^T + mu (g_a . g_b) I)
    K = lam * np.einsum("tai,tbj->taibj", g, g) + mu * np.einsum("taj,tbi->taibj", g, g)
    K += mu * np.einsum("tak,tbk,ij->taibj", g, g, np.eye(3))
    K *= volume[:, None, None, None, None]
    dof = (3 * tets[:, :, None] + np.arange(3)).reshape(len(tets), 12)
    rows, cols = np.repeat(dof, 12, axis=1).ravel(), np.tile(dof, (1, 12)).ravel()
    n = 3 * len(x)
    return sp.coo_matrix((K.reshape(-1), (rows, cols)), shape=(n, n)).tocsr()


class ElasticShape:
    """A cage as linear elasticity knows it, of Young's modulus 1 Pa and density 1 kg/m^3.

    vertices, tets   at rest [m] (V, 3), (T, 4);   held  vertices that stand still (H,)
    modes            the slowest `count` deformations, (K, V, 3), of root mean square 1
    stiffness        of each, w^2 at 1 Pa and 1 kg/m^3 [1/s^2], (K,)
    """

    def __init__(self, vertices: np.ndarray, tets: np.ndarray, held: np.ndarray, poisson: float, count: int):
        x = np.asarray(vertices, np.float64)
        self.x, self.free = x, np.setdiff1d(np.arange(len(x)), held)
        quarters = np.repeat(tet_volumes(x, tets) / 4, 4)
        mass = np.bincount(np.asarray(tets).ravel(), quarters, minlength=len(x))
        self.mass = mass
        dofs = (3 * self.free[:, None] + np.arange(3)).ravel()
        self.K = fem_stiffness(x, np.asarray(tets, np.int64), 1.0, poisson)[dofs][:, dofs].tocsc()
        M = sp.diags(np.repeat(mass[self.free], 3)).tocsc()
        rigid = 0 if len(held) else 6
        size = np.ptp(x, axis=0).max()
        shift = -1e-3 / size**2  # below all squared frequencies, which are of some 1 / size^2: K - shift M is regular
        start = np.random.default_rng(0).normal(size=len(dofs))  # ARPACK's own start is a random one
        squares, found = spla.eigsh(self.K, count + rigid, M, sigma=shift, v0=start)
        order = np.argsort(squares)[rigid:]
        self.stiffness = squares[order]
        self.modes = np.zeros((count, *x.shape))
        for k, i in enumerate(order):
            mode = found[:, i].reshape(-1, 3)
            self.modes[k, self.free] = mode / np.sqrt((mode**2).sum(1).mean())

    def through(self, embedding: sp.csr_matrix, slopes: np.ndarray, displacement: np.ndarray) -> np.ndarray:
        """The displacements (V, 3) [m] of least elastic energy of a cage that springs pull to those of markers.

        embedding  the markers' weights, (M, V);   slopes  what is seen of a marker's displacement, (M, D, 3)
        """
        W = (sp.block_diag(slopes) @ sp.kron(embedding[:, self.free], sp.identity(3))).tocsc()
        pull = MARKER_STIFFNESS * self.stiffness[0] * self.mass.sum() / max(len(displacement), 1)
        u = spla.spsolve((self.K + pull * (W.T @ W)).tocsc(), pull * (W.T @ displacement.ravel()))
        full = np.zeros_like(self.x)
        full[self.free] = u.reshape(-1, 3)
        return full


def subdivided(vertices: np.ndarray, tets: np.ndarray) -> tuple[np.ndarray, np.ndarray, sp.csr_matrix]:
    """The mesh with each tet cut in eight at its edges' middles: vertices (V', 3), tets (8 T, 4), weights (V', V).

    The new vertices are `weights @ vertices`, the old ones first. The octahedron that is left in the middle of a tet
    is cut along its shortest diagonal.
    """
    x, tets = np.asarray(vertices, np.float64), np.asarray(tets, np.int64)
    ends = np.sort(tets[:, TET_EDGES], axis=2).reshape(-1, 2)
    edges, inverse = np.unique(ends, axis=0, return_inverse=True)
    middle = len(x) + inverse.reshape(-1, 6)  # of edges 01, 02, 03, 12, 13, 23
    rows = np.r_[np.arange(len(x)), np.repeat(len(x) + np.arange(len(edges)), 2)]
    weights = np.r_[np.ones(len(x)), np.full(2 * len(edges), 0.5)]
    W = sp.csr_matrix((weights, (rows, np.r_[np.arange(len(x)), edges.ravel()])), (len(x) + len(edges), len(x)))
    new = W @ x
    corners = [
        np.c_[tets[:, k], middle[:, touching]]
        for k, touching in enumerate(([0, 1, 2], [0, 3, 4], [1, 3, 5], [2, 4, 5]))
    ]
    cut = np.empty((len(tets), 4, 4), np.int64)
    rings = (
        ((0, 5), (1, 2, 4, 3)),
        ((1, 4), (0, 2, 5, 3)),
        ((2, 3), (0, 1, 5, 4)),
    )  # a diagonal, and what goes round it
    lengths = np.stack([np.linalg.norm(new[middle[:, a]] - new[middle[:, b]], axis=1) for (a, b), _ in rings], 1)
    for k, ((a, b), ring) in enumerate(rings):
        mine = lengths.argmin(1) == k
        for j in range(4):
            cut[mine, j] = middle[mine][:, [a, b, ring[j], ring[(j + 1) % 4]]]
    every = np.concatenate([*corners, cut.reshape(-1, 4)])
    negative = tet_volumes(new, every) < 0
    every[negative] = every[negative][:, [0, 2, 1, 3]]
    return new, every, W
