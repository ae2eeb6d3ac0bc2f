"""Second level of the embedding: host tets and weights of the corners of each Gaussian's local tetrahedron.

The corners are mu + sqrt(3) H {(1,1,1), (1,-1,-1), (-1,1,-1), (-1,-1,1)}, H = (k^2 Sigma + floor^2 h^2 I)^(1/2), with
h [m] the edge of a tet of the cage there. They surround the k-sigma ellipsoid (VR-GS, Sec. 4.3.2) and, what the paper
leaves open, span a fraction of a cage tet even where the Gaussian is tiny or flat. With `floor=0` a small Gaussian lies
in one tet and its F jumps to its neighbour's as in the one-level scheme, and an F from corners 1e-6 m apart is noise.
Where the floor dominates, H tends to floor h I, however the Gaussian is rotated: all neighbours take the same
difference stencil, so their F differ little. (A stencil rotated with each Gaussian would see the second derivatives of
the deformation differently: that alone is as rough as one level.)

Defaults, measured on a stuffed bar with tets of 4.5 cm, twisted by 180 degrees per metre and stretched, Gaussians of
4.5 mm: F of neighbours jumps 3.7 times less than with one level (95th percentile; on the surface 6 times), and means, F
and Sigma are at least as near to the truth as there. At floor = 0.2 it is 4.9 and 7.4 times, but Sigma is off by a
quarter more: a tetrahedron of four corners takes a fraction of the second derivatives for F, in proportion to its size.
k = 1/3 puts the corners of a large Gaussian at one sigma; k = 1 is 2.5 times rougher. The corners of a small Gaussian
on the surface leave the cage by at most 0.45 h: less than the usual dilation.
"""

import numpy as np

from assets.asset import CageEmbedding
from core.point_location import TetLocator
from core.program import batches
from core.rotation import matrices_from_quaternions

CORNERS = np.sqrt(3.0) * np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])  # around the unit sphere
MAX_WEIGHT = 3.0  # absolute barycentric weight of a corner: two tet heights outside of the face it is seen through
MAX_HALF_AXIS = 4.0  # of a local tetrahedron, in tets of the cage: bounds its aspect ratio, whatever the file holds
SHRINKS = (1.0, 0.5, 0.25, 0.125)  # of a local tetrahedron, tried in turn before all corners share one tet
AT_ONCE = 1 << 17  # Gaussians: some hundred MB


def fraction_inside(vertices: np.ndarray, tets: np.ndarray, points: np.ndarray) -> float:
    """Fraction of the points (N, 3) [m] that lie in a tet; 1 where there are none."""
    return float((TetLocator(vertices, tets).find(points) >= 0).mean()) if len(points) else 1.0


def embed(
    means: np.ndarray,
    quats: np.ndarray,
    scales: np.ndarray,
    vertices: np.ndarray,
    tets: np.ndarray,
    *,
    k: float = 1 / 3,
    floor: float = 0.15,
) -> CageEmbedding:
    """Host tets and weights of the local tetrahedra's corners.

    means [m] (N, 3), quats wxyz (N, 4), scales = standard deviations [m] (N, 3); vertices [m] (V, 3), tets (T, 4).
    """
    host, weights = np.zeros((len(means), 4), np.int32), np.zeros((len(means), 4, 4), np.float32)
    cage = TetLocator(vertices, tets)
    for some in batches(len(means), AT_ONCE):
        home, centre, depth = _bring_home(cage, np.asarray(means[some], np.float64))
        R = matrices_from_quaternions(quats[some])
        h = cage.edge_length(home, centre)[:, None]
        half = np.sqrt(np.minimum(k * np.asarray(scales[some], np.float64), MAX_HALF_AXIS * h) ** 2 + (floor * h) ** 2)
        offsets = CORNERS @ ((R * half[:, None]) @ np.moveaxis(R, 1, 2))  # of the corners from the centre, (n, 4, 3)
        host[some], weights[some] = _embedded(cage, home, centre, depth, offsets)
    return CageEmbedding(host, weights)


def _bring_home(cage: TetLocator, means: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tet of each centre, or the nearest; the centre, pulled towards the cage as MAX_WEIGHT asks; its depth [m]."""
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


def _embedded(cage: TetLocator, home, centre, depth, offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Host (n, 4) and weights (n, 4, 4) of the corners centre + offsets (n, 4, 3), as far in as MAX_WEIGHT asks."""
    host, weights = np.repeat(home[:, None], 4, 1), np.empty((len(home), 4, 4))
    todo = np.arange(len(home))
    for shrink in SHRINKS:
        found, w = _host_corners(cage, home[todo], centre[todo], depth[todo], shrink * offsets[todo])
        good = np.abs(w).max((1, 2)) <= MAX_WEIGHT
        host[todo[good]], weights[todo[good]] = found[good], w[good]
        todo = todo[~good]
        if not len(todo):
            return host, weights
    own = home[todo]  # one tet holds all corners, as small as needed: |w| grows by at most 1 from the centre's
    change = np.einsum("nkc,njc->nkj", offsets[todo], cage.gradients(own))
    change /= np.maximum(1.0, np.abs(change).max((1, 2), keepdims=True))
    weights[todo] = cage.weights(own, centre[todo])[:, None] + change
    return host, weights


def _host_corners(cage: TetLocator, home, centre, depth, offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Host (n, 4) and weights (n, 4, 4) of the corners centre + offsets.

    The extension of each boundary tet meets that of the next with a gap that grows with the distance, which would tear
    a tetrahedron wholly outside: its corners share one tet.
    """
    corner = (centre[:, None] + offsets).reshape(-1, 3)
    host = cage.find(corner)
    out = np.flatnonzero(host < 0)
    if len(out):
        far = np.repeat(depth, 4)[out] > np.linalg.norm(offsets, axis=2).ravel()[out]
        host[out[far]] = np.repeat(home, 4)[out[far]]
        near = out[~far]
        if len(near):
            host[near] = cage.nearest(corner[near])[0]
    return host.reshape(-1, 4), cage.weights(host, corner).reshape(-1, 4, 4)
