"""Linear tetrahedral FEM in float64 with SciPy: the reference for small loads, on the same mesh, the same masses."""

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla


def stiffness(x: np.ndarray, tets: np.ndarray, young: float, poisson: float) -> sp.csr_matrix:
    """Stiffness matrix (3V, 3V) [N/m] of linear elasticity with constant-strain tets."""
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


def solve(K: sp.csr_matrix, force: np.ndarray, fixed: np.ndarray, displacement=0.0) -> np.ndarray:
    """Displacements (V, 3) under nodal forces (V, 3), with the vertices `fixed` displaced as given."""
    u = np.zeros_like(force, np.float64)
    u[fixed] = displacement
    held = np.zeros(force.shape, bool)
    held[fixed] = True
    free = np.flatnonzero(~held.ravel())
    load = force.ravel() - K @ u.ravel()
    flat = u.ravel()
    flat[free] += spla.spsolve(K[free][:, free].tocsc(), load[free])
    return flat.reshape(-1, 3)
