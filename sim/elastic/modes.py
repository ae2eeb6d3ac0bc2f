"""The softest modes of a body, as a coarse space for stiff bodies (NumPy and SciPy only).

Sweeps over vertices carry a push one ring of tets further each, so in a stiff body a few of them move nothing as a
whole. The modes do: they are those of the body embedded in a coarse lattice of trilinear cells (Galerkin, so they are
no softer than the body itself), the six rigid ones included unless vertices are prescribed.
"""

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from core.material import Material
from sim.body_model import RestShape
from sim.elastic.time_step import lame

MODES = 24  # of a body: six rigid, and a bar's bending, twist and stretch to about the third overtone
CELLS = 4  # of the lattice along the body's longest side
NEGLIGIBLE = 1e-6  # of the heaviest motion's mass, at which a motion of the lattice moves next to no vertex


def lattice_weights(x: np.ndarray) -> sp.csr_matrix:
    """Trilinear weights (V, nodes) of points x (V, 3) in a lattice of nearly cubic cells around them."""
    low, size = x.min(0), np.maximum(np.ptp(x, axis=0), 1e-9 * np.ptp(x))
    cells = np.clip(np.round(CELLS * size / size.max()), 1, CELLS).astype(int)
    u = (x - low) / size * cells
    cell = np.minimum(u.astype(int), cells - 1)
    u -= cell
    corners = np.stack(np.meshgrid(*[(0, 1)] * 3, indexing="ij"), -1).reshape(-1, 3)
    node = cell[:, None] + corners
    node = (node[..., 0] * (cells[1] + 1) + node[..., 1]) * (cells[2] + 1) + node[..., 2]
    weight = np.where(corners, u[:, None], 1 - u[:, None]).prod(-1)
    rows = np.repeat(np.arange(len(x)), 8)
    return sp.csr_matrix((weight.ravel(), (rows, node.ravel())), shape=(len(x), int(np.prod(cells + 1))))


def softest_modes(x, tets, masses, movable, mu: float, lame_1: float) -> tuple[np.ndarray, np.ndarray]:
    """Shapes U (V, MODES, 3) [kg^-1/2] with sum_i m_i U_ki . U_li = delta_kl, and squared frequencies (MODES,) [1/s^2].

    x rest positions (V, 3) [m]; movable (V,) bool: the others stay in all shapes; mu, lame_1: Lame constants [Pa].
    Missing modes of the smallest meshes are zero.
    """
    x, tets = np.asarray(x, np.float64), np.asarray(tets, np.int64)
    U, all_squares = np.zeros((len(x), MODES, 3)), np.zeros(MODES)
    if not np.any(movable):
        return U, all_squares
    P = sp.diags(np.asarray(movable, np.float64)) @ lattice_weights(x)
    D = np.swapaxes(x[tets[:, 1:]] - x[tets[:, :1]], 1, 2)
    inner = np.linalg.inv(D)
    gradient = np.concatenate([-inner.sum(1, keepdims=True), inner], axis=1)  # (T, 4, 3)
    rows, volume = np.repeat(np.arange(len(tets)), 4), sp.diags(np.linalg.det(D) / 6)
    shape = (len(tets), len(x))
    G = [sp.csr_matrix((gradient[..., k].ravel(), (rows, tets.ravel())), shape=shape) @ P for k in range(3)]
    products = [[(G[k].T @ volume @ G[l]).toarray() for l in range(3)] for k in range(3)]
    laplace = products[0][0] + products[1][1] + products[2][2]
    n = P.shape[1]
    K = np.empty((3, n, 3, n))
    for k in range(3):
        for l in range(3):
            K[k, :, l] = lame_1 * products[k][l] + mu * products[l][k] + (mu * laplace if k == l else 0.0)
    # The lattice of a coarse mesh has motions that move no vertex. Without mass or stiffness they would come first, and
    # be all the modes of a body of some thirty vertices: so only what moves the body is looked at, at unit mass.
    weight, W = np.linalg.eigh((P.T @ sp.diags(np.asarray(masses)) @ P).toarray())
    kept = weight > NEGLIGIBLE * weight[-1]
    W = W[:, kept] / np.sqrt(weight[kept])
    r = W.shape[1]
    K = np.einsum("na,knlm,mb->kalb", W, K, W, optimize=True).reshape(3 * r, 3 * r)
    squares, Q = sl.eigh(K, subset_by_index=(0, min(MODES, 3 * r) - 1))
    for k in range(3):
        U[:, : len(squares), k] = P @ (W @ Q[k * r : (k + 1) * r])
    all_squares[: len(squares)] = np.maximum(squares, 0.0)
    return U, all_squares


def modes_of(shape: RestShape, pinned: tuple, material: Material) -> tuple[np.ndarray, np.ndarray]:
    """softest_modes of a body of this shape and material, `pinned` saying of each vertex whether it stays."""
    mu, lam = lame(material)
    return softest_modes(shape.vertices, shape.tets, material.density * shape.share, ~np.array(pinned), mu, lam - mu)
