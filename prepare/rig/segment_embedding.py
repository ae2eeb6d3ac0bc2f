"""Embedding of an animated body: each Gaussian follows tets of its own segment of the cage."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, eye

from assets.asset import Cage, CageEmbedding
from assets.gaussians import Gaussians
from core.point_location import TetLocator
from core.rotation import matrices_from_quaternions
from core.tetmesh import TET_EDGES
from prepare.cage.embedding_hosts import CORNERS, MAX_WEIGHT
from prepare.rig.body_segmentation import Segments

MAX_SEGMENT_DISTANCE = 4.0  # edges; a Gaussian farther from all tets of its segment keeps its hosts
MAX_EDGE_STRETCH = 1.3  # of all edges of a tet that is called calm
MAX_GROWTH = 1.35  # of a Gaussian; one that would grow more, to a spike, follows calm tets
HALF_AXIS = 0.35  # edges; of re-hosted local tetrahedra, so that F is a mean over several tets


def keep_to_segments(
    embedded: CageEmbedding, means: np.ndarray, cage: Cage, segments: Segments
) -> tuple[CageEmbedding, int]:
    """Re-host Gaussians on both sides of a cut, or in another segment than their own; and their number.

    Tets are coarse: a Gaussian may lie in one of another segment, or outside of all. Then its local tetrahedron is
    placed where its own segment is nearest.
    """
    locator = TetLocator(cage.vertices, cage.tets)
    home = locator.find(means)
    out = np.flatnonzero(home < 0)
    if len(out):
        home[out] = locator.nearest(means[out])[0]
    label, wanted = segments.tets, segments.gaussians
    astray = (label[home] != wanted) & ~segments.joined(label[home], wanted, means)
    moved = np.flatnonzero(astray | across_cut(embedded, home, cage, label))
    edge = locator.edge_length(home, means)
    return rehosted(embedded, moved, np.ones(len(label), bool), means, edge, cage, segments)


def rehosted(
    embedded: CageEmbedding,
    which: np.ndarray,
    tets: np.ndarray,
    means: np.ndarray,
    edge: np.ndarray,
    cage: Cage,
    segments: Segments,
) -> tuple[CageEmbedding, int]:
    """Gaussians `which` (k,) hosted by the nearest of the allowed `tets` (T,) bool of their segment; and their number.

    edge  of the cage at each Gaussian [m], (N,)
    """
    host, weights = embedded.host.copy(), embedded.weights.copy()
    count = 0
    for j in np.unique(segments.gaussians[which]):
        chosen, own = which[segments.gaussians[which] == j], np.flatnonzero(tets & (segments.tets == j))
        if not len(own):
            continue
        segment = TetLocator(cage.vertices, cage.tets[own])
        foot, tet = means[chosen].copy(), segment.find(means[chosen])
        off = np.flatnonzero(tet < 0)
        if len(off):
            tet[off], foot[off] = segment.nearest(means[chosen[off]])
        near = np.linalg.norm(means[chosen] - foot, axis=1) < MAX_SEGMENT_DISTANCE * edge[chosen]
        chosen, foot, tet = chosen[near], foot[near], tet[near]
        h, w = local_tetrahedra(segment, foot, tet, HALF_AXIS * edge[chosen])
        host[chosen], weights[chosen] = own[h], w
        count += len(chosen)
    return CageEmbedding(host, weights), count


def without_spikes(
    embedded: CageEmbedding, g: Gaussians, cage: Cage, segments: Segments, shapes: np.ndarray
) -> tuple[CageEmbedding, int]:
    """Re-host Gaussians that the cage would stretch to spikes, as between an arm and the side; and their number.

    They follow calm tets of their segment. shapes  cage vertices (F, V, 3) [m] of some frames, the first at rest
    """
    ends = cage.tets[:, TET_EDGES]
    length = [np.linalg.norm(x[ends[..., 0]] - x[ends[..., 1]], axis=-1) for x in shapes]
    calm = (np.max(length[1:], axis=0) / length[0]).max(1) < MAX_EDGE_STRETCH
    some = np.flatnonzero(~calm[embedded.host].all(1))
    if not len(some):
        return embedded, 0
    weights, vertex = embedded.weights[some].astype(np.float64), cage.tets[embedded.host[some]]
    axes = (
        matrices_from_quaternions(g.quats[some].astype(np.float64))
        * np.exp(g.log_scales[some].astype(np.float64))[:, None]
    )

    def corners(x: np.ndarray) -> np.ndarray:
        y = np.einsum("nkj,nkjd->nkd", weights, x[vertex])
        return np.swapaxes(y[:, 1:] - y[:, :1], 1, 2)

    rest = np.linalg.inv(corners(shapes[0])) @ axes
    size = np.max([np.linalg.norm(corners(x) @ rest, axis=(1, 2)) for x in shapes[1:]], axis=0)
    wild = some[size > MAX_GROWTH * np.linalg.norm(axes, axis=(1, 2))]
    means = g.means.astype(np.float64)
    edge = np.zeros(len(means))
    edge[wild] = length[0][embedded.host[wild, 0]].mean(1)
    return rehosted(embedded, wild, calm, means, edge, cage, segments)


def local_tetrahedra(
    segment: TetLocator, foot: np.ndarray, tet: np.ndarray, half: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Hosts (n, 4) and weights (n, 4, 4) of the corners of local tetrahedra.

    Their half axes are `half` (n,) [m], about points `foot` (n, 3) in or on the tets `tet` (n,) of a segment.
    """
    corner = (foot[:, None] + half[:, None, None] * CORNERS).reshape(-1, 3)
    host = segment.find(corner)
    out = np.flatnonzero(host < 0)
    if len(out):
        host[out] = segment.nearest(corner[out])[0]
    weights = segment.weights(host, corner).reshape(-1, 4, 4)
    host = host.reshape(-1, 4)
    wild = np.abs(weights).max((1, 2)) > MAX_WEIGHT
    if wild.any():  # in slivers: one tet, as small as the bound asks
        host[wild] = tet[wild][:, None]
        w = segment.weights(np.repeat(tet[wild], 4), corner.reshape(-1, 4, 3)[wild].reshape(-1, 3)).reshape(-1, 4, 4)
        middle = segment.weights(tet[wild], foot[wild])[:, None]
        spread = w - middle
        weights[wild] = middle + spread / np.maximum(np.abs(spread).max((1, 2)), 1.0)[:, None, None]
    return host, weights


def across_cut(embedded: CageEmbedding, home: np.ndarray, cage: Cage, label: np.ndarray) -> np.ndarray:
    """Mask (N,) of Gaussians with a corner in a tet of another segment that is cut off from `home`.

    No path of one or two edges leads from there to home.
    """
    V, ends = len(cage.vertices), cage.tets[:, TET_EDGES].reshape(-1, 2)
    link = coo_matrix((np.ones(len(ends)), ends.T), shape=(V, V))
    link = (link + link.T + eye(V)).tocsr()
    link = (link @ link).tocsr()
    which, corner = np.nonzero(label[embedded.host] != label[home][:, None])
    a, b = cage.tets[home[which]], cage.tets[embedded.host[which, corner]]
    linked = np.zeros(len(which), bool)
    for i in range(4):
        for j in range(4):
            linked |= np.asarray(link[a[:, i], b[:, j]]).ravel() > 0
    torn = np.zeros(len(home), bool)
    torn[which[~linked]] = True
    return torn
