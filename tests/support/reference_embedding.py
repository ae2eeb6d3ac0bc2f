"""NumPy twin of prepare/cage/embedding_hosts.py: the same search and formula, all Gaussians at once."""

import numpy as np

from assets.asset import CageEmbedding
from core.point_location import TetLocator
from core.rotation import matrices_from_quaternions

CORNERS = np.sqrt(3.0) * np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
MAX_WEIGHT, MAX_HALF_AXIS = 3.0, 4.0


def embed(means, quats, scales, vertices, tets, *, k: float = 1 / 3, floor: float = 0.15) -> CageEmbedding:
    """Host tets (N, 4) and weights (N, 4, 4), float64 inside, of the local tetrahedra's corners."""
    cage = TetLocator(vertices, tets)
    means, quats, scales = (np.asarray(a, np.float64) for a in (means, quats, scales))
    home, centre, depth = _bring_home(cage, means)
    R = matrices_from_quaternions(quats)
    h = cage.edge_length(home, centre)[:, None]
    half = np.sqrt(np.minimum(k * scales, MAX_HALF_AXIS * h) ** 2 + (floor * h) ** 2)
    shape = CORNERS @ ((R * half[:, None]) @ np.moveaxis(R, 1, 2))  # relative to the centre, (n, 4, 3)
    host, weights = np.repeat(home[:, None], 4, 1), np.empty((len(means), 4, 4))
    todo = np.arange(len(means))
    for shrink in (1.0, 0.5, 0.25, 0.125):
        h, w = _host_corners(cage, home[todo], centre[todo], depth[todo], shrink * shape[todo])
        good = np.abs(w).max((1, 2)) <= MAX_WEIGHT
        host[todo[good]], weights[todo[good]] = h[good], w[good]
        todo = todo[~good]
        if not len(todo):
            break
    if len(todo):  # one tet holds all corners: |w| grows by at most 1 from the centre's
        own = home[todo]
        spread = np.einsum("nkc,njc->nkj", shape[todo], cage.gradients(own))
        spread /= np.maximum(1.0, np.abs(spread).max((1, 2), keepdims=True))
        weights[todo] = cage.weights(own, centre[todo])[:, None] + spread
    return CageEmbedding(host.astype(np.int32), weights.astype(np.float32))


def _bring_home(cage: TetLocator, means: np.ndarray):
    """Tet of each centre (or the nearest), the centre pulled towards the cage as MAX_WEIGHT asks, its depth [m]."""
    home = cage.find(means)
    centre, depth = means.copy(), np.zeros(len(means))
    out = np.flatnonzero(home < 0)
    if len(out):
        home[out], foot = cage.nearest(means[out])
        depth[out] = np.linalg.norm(means[out] - foot, axis=1)
        at, to = cage.weights(home[out], foot), cage.weights(home[out], means[out])
        # |at + t (to - at)| <= MAX_WEIGHT for all four weights; at is within 0..1
        with np.errstate(divide="ignore"):
            t = ((MAX_WEIGHT - np.sign(to - at) * at) / np.abs(to - at)).min(1).clip(max=1)
        centre[out] = foot + t[:, None] * (means[out] - foot)
    return home, centre, depth


def _host_corners(cage: TetLocator, home, centre, depth, shape):
    """Host (n, 4) and weights (n, 4, 4) of the corners centre + shape; those of a tetrahedron outside share one tet."""
    corner = (centre[:, None] + shape).reshape(-1, 3)
    host = cage.find(corner)
    out = np.flatnonzero(host < 0)
    if len(out):
        far = np.repeat(depth, 4)[out] > np.linalg.norm(shape, axis=2).ravel()[out]
        host[out[far]] = np.repeat(home, 4)[out[far]]
        near = out[~far]
        if len(near):
            host[near] = cage.nearest(corner[near])[0]
    return host.reshape(-1, 4), cage.weights(host, corner).reshape(-1, 4, 4)
