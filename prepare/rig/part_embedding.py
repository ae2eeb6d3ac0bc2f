"""Gaussians of a body that moves by itself: each hangs on its own part of the cage."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, eye

from assets.asset import Cage, CageEmbedding
from assets.gaussians import Gaussians
from core.point_location import TetLocator
from core.rotation import matrices_from_quaternions
from prepare.cage.embedding_hosts_reference import CORNERS, FURTHEST
from prepare.rig.body_parts import Parts
from prepare.rig.skin_weights import EDGES

REACH = 4.0  # edges: what is farther from all tets of its own part stays where it is
CALM = 1.3  # times its length at rest: a tet none of whose edges becomes longer
GROWN = 1.35  # times its size at rest: a Gaussian that would be drawn out farther follows calm tets, lest it be a spike
SPREAD = 0.35  # edges: half axis of the local tetrahedra of what follows its part: F is a mean over some of its tets


def within(embedded: CageEmbedding, means: np.ndarray, cage: Cage, parts: Parts) -> tuple[CageEmbedding, int]:
    """No Gaussian hangs on both sides of a cut, or on another part than its own; and how many were hung anew.

    Tets are coarse: a Gaussian may lie in one of another part, or outside of all. Then its local tetrahedron stands
    where its own part is nearest, and carries it from there.
    """
    where = TetLocator(cage.vertices, cage.tets)
    home = where.find(means)
    out = np.flatnonzero(home < 0)
    if len(out):
        home[out] = where.nearest(means[out])[0]
    label, wanted = parts.tets, parts.gaussians
    astray = (label[home] != wanted) & ~parts.joined(label[home], wanted, means)
    moved = np.flatnonzero(astray | across_cut(embedded, home, cage, label))
    edge = where.edge_length(home, means)
    return hung(embedded, moved, np.ones(len(label), bool), means, edge, cage, parts)


def hung(
    embedded: CageEmbedding,
    which: np.ndarray,
    tets: np.ndarray,
    means: np.ndarray,
    edge: np.ndarray,
    cage: Cage,
    parts: Parts,
) -> tuple[CageEmbedding, int]:
    """Gaussians `which` (k,) hung on those `tets` (T,) bool of their own part that are nearest; and how many were.

    edge  of the cage at each Gaussian [m], (N,)
    """
    host, weights = embedded.host.copy(), embedded.weights.copy()
    count = 0
    for j in np.unique(parts.gaussians[which]):
        mine, own = which[parts.gaussians[which] == j], np.flatnonzero(tets & (parts.tets == j))
        if not len(own):
            continue
        part = TetLocator(cage.vertices, cage.tets[own])
        foot, tet = means[mine].copy(), part.find(means[mine])
        off = np.flatnonzero(tet < 0)
        if len(off):
            tet[off], foot[off] = part.nearest(means[mine[off]])
        near = np.linalg.norm(means[mine] - foot, axis=1) < REACH * edge[mine]
        mine, foot, tet = mine[near], foot[near], tet[near]
        h, w = stood(part, foot, tet, SPREAD * edge[mine])
        host[mine], weights[mine] = own[h], w
        count += len(mine)
    return CageEmbedding(host, weights), count


def calmed(embedded: CageEmbedding, g: Gaussians, cage: Cage, parts: Parts, shapes: np.ndarray) -> tuple[CageEmbedding, int]:
    """No Gaussian is drawn out to a spike where the cage is, between an arm and the side: in these shapes (F, V, 3) of
    the cage, the first at rest, those that would be follow what is calm of their part; and how many do."""
    ends = cage.tets[:, EDGES]
    length = [np.linalg.norm(x[ends[..., 0]] - x[ends[..., 1]], axis=-1) for x in shapes]
    calm = (np.max(length[1:], axis=0) / length[0]).max(1) < CALM
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
    wild = some[size > GROWN * np.linalg.norm(axes, axis=(1, 2))]
    means = g.means.astype(np.float64)
    edge = np.zeros(len(means))
    edge[wild] = length[0][embedded.host[wild, 0]].mean(1)
    return hung(embedded, wild, calm, means, edge, cage, parts)


def stood(part: TetLocator, foot: np.ndarray, tet: np.ndarray, half: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Local tetrahedra of these half axes (n,) [m] about points (n, 3) in or on the tets (n,) of a part: the hosts of
    their corners (n, 4), and the weights there (n, 4, 4)."""
    corner = (foot[:, None] + half[:, None, None] * CORNERS).reshape(-1, 3)
    host = part.find(corner)
    out = np.flatnonzero(host < 0)
    if len(out):
        host[out] = part.nearest(corner[out])[0]
    weights = part.weights(host, corner).reshape(-1, 4, 4)
    host = host.reshape(-1, 4)
    wild = np.abs(weights).max((1, 2)) > FURTHEST
    if wild.any():  # in slivers: one tet, and as small as it asks for
        host[wild] = tet[wild][:, None]
        w = part.weights(np.repeat(tet[wild], 4), corner.reshape(-1, 4, 3)[wild].reshape(-1, 3)).reshape(-1, 4, 4)
        middle = part.weights(tet[wild], foot[wild])[:, None]
        spread = w - middle
        weights[wild] = middle + spread / np.maximum(np.abs(spread).max((1, 2)), 1.0)[:, None, None]
    return host, weights


def across_cut(embedded: CageEmbedding, home: np.ndarray, cage: Cage, label: np.ndarray) -> np.ndarray:
    """Gaussians (N,) with a corner in a tet of another part than `home`, from which it is cut off: no way of one or two
    edges leads from there to here."""
    V, ends = len(cage.vertices), cage.tets[:, EDGES].reshape(-1, 2)
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
