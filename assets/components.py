"""The separate pieces of an asset. In a scene each is a body of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from assets.asset import Asset, Cage, CageEmbedding


def piece_of_vertices(cage: Cage) -> np.ndarray:
    """Piece (V,) of each vertex; tets that share a vertex belong to one. Piece 0 has the most tets."""
    label = np.arange(len(cage.vertices))
    while (
        True
    ):  # the least number of each tet's corners spreads, and numbers are followed to their own: O(log V) rounds
        least = label[cage.tets].min(1)
        new = label.copy()
        np.minimum.at(new, label[cage.tets].ravel(), np.repeat(least, 4))
        while not np.array_equal(new, new[new]):
            new = new[new]
        if np.array_equal(new, label):
            break
        label = new
    roots, numbers = np.unique(label, return_inverse=True)
    count = np.bincount(numbers.reshape(-1)[cage.tets[:, 0]], minlength=len(roots))
    return np.argsort(np.argsort(-count, kind="stable"), kind="stable")[numbers.reshape(-1)]


def split_components(asset: Asset) -> list[Asset]:
    """The asset's pieces, the largest first, in its own frame: [asset] if it is in one, or has no cage.

    A solver takes a body for one thing: it damps it towards one motion, leads it back to one shape, and lets what is
    close at rest pass through itself. So separate pieces become separate bodies. Gaussians go to the piece that holds
    most of their corners. The asset's distance grid is that of all pieces together: they have none (the solver makes
    its own), and what is animated stays whole.
    """
    if asset.cage is None or asset.embedded is None or asset.animation is not None:
        return [asset]
    cage, embedded = asset.cage, asset.embedded
    piece = piece_of_vertices(cage)
    count = int(piece.max()) + 1
    if count == 1:
        return [asset]
    of_tet = piece[cage.tets[:, 0]]
    of_corner = of_tet[embedded.host]
    home = np.array([(of_corner == k).sum(1) for k in range(count)]).argmax(0)
    astray = of_corner != home[:, None]
    found = []
    for k in range(count):
        number = np.cumsum(piece == k) - 1  # of a vertex, among those of this piece
        tet = np.cumsum(of_tet == k) - 1
        mine = home == k
        host, weights = embedded.host[mine], embedded.weights[mine].copy()
        lost = np.nonzero(astray[mine])
        if len(lost[0]):  # a corner in another piece's tet goes to a tet that holds one of this piece's
            host, weights = brought_home(asset, host, weights, lost, of_tet == k)
        part = Cage(
            cage.vertices[piece == k],
            number[cage.tets[of_tet == k]].astype(np.int32),
            number[cage.surface[piece[cage.surface[:, 0]] == k]].astype(np.int32),
        )
        inner = CageEmbedding(tet[host].astype(np.int32), weights)
        found.append(replace(asset, gaussians=asset.gaussians.select(mine), cage=part, embedded=inner, sdf=None))
    return found


def brought_home(asset: Asset, host, weights, lost, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Hosts and weights of Gaussians with some corners, `lost`, in other pieces: these follow a tet of their own piece.

    own  mask (T,) of the tets of the Gaussians' piece
    """
    x = asset.cage.vertices.astype(np.float64)
    host = host.copy()
    row, corner = lost
    places = np.einsum("nj,njc->nc", weights[row, corner], x[asset.cage.tets[host[row, corner]]])
    first = np.argmax(own[host[row]], axis=1)  # a corner that is at home
    home = host[row, first]
    corners = x[asset.cage.tets[home]]
    last = np.linalg.solve(np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 2), (places - corners[:, 0])[..., None])[
        ..., 0
    ]
    host[row, corner] = home
    weights[row, corner] = np.concatenate([1 - last.sum(1, keepdims=True), last], 1)
    return host, weights
