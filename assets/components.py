"""Split an asset into its connected components, each of which is a body of its own in a scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from assets.asset import Asset, Cage, CageEmbedding
from core.tetmesh import vertex_components


def split_components(asset: Asset) -> list[Asset]:
    """The asset's components, the largest first, in its own frame: [asset] if it is connected, or has no cage.

    The solver treats a body as one thing: it damps relative to one rigid motion, restores one shape, and ignores
    contacts between points close at rest. So separate components become separate bodies. Gaussians go to the component
    that holds most of their corners. The asset's distance grid is that of all components together, so they have none
    (the solver makes its own). An animated asset stays whole.
    """
    if asset.cage is None or asset.embedding is None or asset.animation is not None:
        return [asset]
    cage, embedding = asset.cage, asset.embedding
    tet_component = vertex_components(cage.tets)
    count = int(tet_component.max()) + 1
    if count == 1:
        return [asset]
    component = np.empty(len(cage.vertices), np.int64)  # of each vertex
    component[cage.tets] = tet_component[:, None]
    corner_component = tet_component[embedding.host]
    home = np.array([(corner_component == k).sum(1) for k in range(count)]).argmax(0)
    found = []
    for k in range(count):
        vertex_index = np.cumsum(component == k) - 1
        tet_index = np.cumsum(tet_component == k) - 1
        mine = home == k
        host, weights = _rehosted(asset, mine, tet_component == k)
        own = Cage(
            cage.vertices[component == k],
            vertex_index[cage.tets[tet_component == k]].astype(np.int32),
            vertex_index[cage.surface[component[cage.surface[:, 0]] == k]].astype(np.int32),
        )
        hosts = CageEmbedding(tet_index[host].astype(np.int32), weights)
        found.append(replace(asset, gaussians=asset.gaussians.select(mine), cage=own, embedding=hosts, sdf=None))
    return found


def _rehosted(asset: Asset, mine: np.ndarray, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Hosts and weights of the Gaussians `mine` (N,), with all corners in the tets `own` (T,) of their component.

    A corner in another component's tet goes to the tet of one that is not; its weights extrapolate there.
    """
    x, tets = asset.cage.vertices.astype(np.float64), asset.cage.tets
    host, weights = asset.embedding.host[mine].copy(), asset.embedding.weights[mine].copy()
    row, corner = np.nonzero(~own[host])
    if len(row):
        position = np.einsum("nj,njc->nc", weights[row, corner], x[tets[host[row, corner]]])
        first = np.argmax(own[host[row]], axis=1)
        tet = host[row, first]
        origin, *others = np.moveaxis(x[tets[tet]], 1, 0)
        last = np.linalg.solve(np.stack(others, 2) - origin[..., None], (position - origin)[..., None])[..., 0]
        host[row, corner] = tet
        weights[row, corner] = np.concatenate([1 - last.sum(1, keepdims=True), last], 1)
    return host, weights
