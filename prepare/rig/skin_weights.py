"""Skin weights of a cage for linear blend skinning: nearest bone inside the cage, softened by heat diffusion.

    (L + H) W = H P       L the cage's Laplacian, P the joint that each vertex belongs to (0 or 1), H = HOLD m / d^2

with d the distance to the bone: where a limb is thin, or close to its bone, weights change quickly from joint to joint
(Baran & Popovic, Automatic Rigging and Animation of 3D Characters, 2007, there on surfaces). L has positive weights on
edges alone, so that all W lie in 0..1 and each vertex's sum to 1.

Each Gaussian of an animated body follows tets of its own segment of the cage.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, diags, eye
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.sparse.linalg import splu

from assets.animation import JOINTS_PER_VERTEX
from assets.asset import Cage, CageEmbedding
from assets.gaussians import Gaussians
from core.point_location import TetLocator
from core.rotation import matrices_from_quaternions
from core.tetmesh import TET_EDGES, tet_volumes
from prepare.cage.embedding_hosts import CORNERS, MAX_WEIGHT
from prepare.rig.body_segmentation import Segments

HOLD = 4.0  # relative rate of change of weights; 1: over the distance to the bone
MIN_FIRST_WEIGHT = 0.7  # of its first joint for a vertex to be driven; others bend, and are simulated
MIN_VOLUME = 0.6  # of 1 at rest; a tet that skinning compresses more is simulated, and so are its surroundings
FREE_RADIUS = 0.055  # of the body's size; radius of these surroundings: larger ones bend joints more gently


def diffuse_weights(vertices: np.ndarray, tets: np.ndarray, held: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Solution W (V, J) of (L + diag(m held)) W = diag(m held) target; held (V,) [1/m^2], rows of target sum to 1.

    m  volume of each vertex [m^3]
    """
    x, V = np.asarray(vertices, np.float64), len(vertices)
    volume = tet_volumes(x, tets)
    a, b = tets[:, TET_EDGES].reshape(-1, 2).T
    k = np.repeat(volume, 6) / ((x[a] - x[b]) ** 2).sum(1)  # so a box of tets has about the finite differences' L
    A = coo_matrix((np.r_[k, k], (np.r_[a, b], np.r_[b, a])), shape=(V, V)).tocsr()
    H = held * np.bincount(tets.ravel(), np.repeat(volume / 4, 4), minlength=V)
    return splu((diags(np.asarray(A.sum(1)).ravel() + H) - A).tocsc()).solve(H[:, None] * target)


def largest_influences(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest JOINTS_PER_VERTEX weights of each row (V, J), normalised: joints (V, 4) int32, weights (V, 4) float32."""
    if weights.shape[1] < JOINTS_PER_VERTEX:
        weights = np.pad(weights, ((0, 0), (0, JOINTS_PER_VERTEX - weights.shape[1])))
    joints = np.argsort(-weights, axis=1, kind="stable")[:, :JOINTS_PER_VERTEX]
    w = np.take_along_axis(weights, joints, 1).clip(0)
    w[w < 1e-3 * w[:, :1]] = 0.0
    return np.where(w > 0, joints, 0).astype(np.int32), (w / w.sum(1, keepdims=True)).astype(np.float32)


def driven_vertices(
    vertices: np.ndarray,
    weights: np.ndarray,
    tets: np.ndarray,
    surface: np.ndarray,
    shapes: np.ndarray,
    core: np.ndarray,
    leader: np.ndarray,
) -> np.ndarray:
    """Mask (V,) of driven (kinematic) vertices: of the surface, led by one joint, not near what skinning crushes.

    weights  (V, 4) of each vertex's joints, the largest first;  surface  indices of the surface's vertices
    shapes   skinned positions of all vertices in some frames, the first at rest (F, V, 3)
    core     vertices in the bones, (V,) bool: driven too, as the inertia of the flesh around them would crush it
    leader   first joint of each vertex, (V,); -1 where that has no child: a foot is driven, however small
    """
    driven = core.copy()
    driven[surface] = True
    driven &= weights[:, 0] >= MIN_FIRST_WEIGHT
    x = np.asarray(vertices, np.float64)
    ends = np.unique(np.sort(tets[:, TET_EDGES].reshape(-1, 2), axis=1), axis=0)
    length = np.linalg.norm(x[ends[:, 0]] - x[ends[:, 1]], axis=1)
    graph = coo_matrix((length, ends.T), shape=(len(x),) * 2).tocsr()
    crushed = np.unique(tets[least_volumes(tets, shapes) < MIN_VOLUME])
    if len(crushed):
        radius = FREE_RADIUS * np.ptp(x, axis=0).max()
        driven &= dijkstra(graph, directed=False, indices=crushed, min_only=True, limit=radius) > radius
        loose = isolated_patches(x, ends, driven, radius, leader)
        loose[np.setdiff1d(np.arange(len(x)), surface)] = False  # in coarse cages vertices in a bone do lie alone
        driven &= ~loose
    return driven


def isolated_patches(
    x: np.ndarray, ends: np.ndarray, driven: np.ndarray, size: float, leader: np.ndarray
) -> np.ndarray:
    """Mask (V,) of driven vertices in connected patches less than `size` [m] across; 2 `size` if a joint has no other.

    Such a patch in an armpit is dragged through simulated flesh and inverts tets.
    ends  (E, 2) of the edges of x (V, 3); leader as of `driven_vertices`
    """
    both = ends[driven[ends].all(1)]
    count, patch = connected_components(coo_matrix((np.ones(len(both)), both.T), shape=(len(x),) * 2), directed=False)
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, patch, x)
    np.maximum.at(high, patch, x)
    across = np.linalg.norm(high - low, axis=1)[patch]
    leaders = np.unique(np.stack([leader, patch])[:, driven & (across > 0)], axis=1)[0]  # of each patch
    patches = np.bincount(leaders[leaders >= 0], minlength=leader.max() + 2)
    return driven & (leader >= 0) & (across < np.where(patches[leader] == 1, 2 * size, size))


def least_volumes(tets: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """Smallest volume of each tet (T,) in shapes (F, V, 3), relative to the first."""
    rest = tet_volumes(shapes[0], tets)
    return np.min([tet_volumes(x, tets) / rest for x in shapes], axis=0).clip(max=1.0)


MAX_SEGMENT_DISTANCE = 4.0  # edges; a Gaussian farther from all tets of its segment keeps its hosts
MAX_EDGE_STRETCH = 1.3  # of all edges of a tet that is called calm
MAX_GROWTH = 1.35  # of a Gaussian; one that would grow more, to a spike, follows calm tets
HALF_AXIS = 0.35  # edges; of re-hosted local tetrahedra, so that F is a mean over several tets


def located(locator: TetLocator, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The tet (n,) that holds each point (n, 3), or the nearest; and the point, or the nearest in that tet."""
    tet, foot = locator.find(points), points.copy()
    out = np.flatnonzero(tet < 0)
    if len(out):
        tet[out], foot[out] = locator.nearest(points[out])
    return tet, foot


def keep_to_segments(embedded: CageEmbedding, means: np.ndarray, cage: Cage, segments: Segments) -> CageEmbedding:
    """Re-host Gaussians on both sides of a cut, or in another segment than their own.

    Tets are coarse: a Gaussian may lie in one of another segment, or outside of all. Then its local tetrahedron is
    placed where its own segment is nearest.
    """
    locator = TetLocator(cage.vertices, cage.tets)
    home, _ = located(locator, means)
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
) -> CageEmbedding:
    """Gaussians `which` (k,) hosted by the nearest of the allowed `tets` (T,) bool of their segment.

    edge  of the cage at each Gaussian [m], (N,)
    """
    host, weights = embedded.host.copy(), embedded.weights.copy()
    for j in np.unique(segments.gaussians[which]):
        chosen, own = which[segments.gaussians[which] == j], np.flatnonzero(tets & (segments.tets == j))
        if not len(own):
            continue
        segment = TetLocator(cage.vertices, cage.tets[own])
        tet, foot = located(segment, means[chosen])
        near = np.linalg.norm(means[chosen] - foot, axis=1) < MAX_SEGMENT_DISTANCE * edge[chosen]
        chosen, foot, tet = chosen[near], foot[near], tet[near]
        h, w = local_tetrahedra(segment, foot, tet, HALF_AXIS * edge[chosen])
        host[chosen], weights[chosen] = own[h], w
    return CageEmbedding(host, weights)


def without_spikes(
    embedded: CageEmbedding, g: Gaussians, cage: Cage, segments: Segments, shapes: np.ndarray
) -> CageEmbedding:
    """Let Gaussians that the cage would stretch to spikes, as between an arm and the side, follow calm tets of their
    segment. shapes: cage vertices (F, V, 3) [m] of some frames, the first at rest."""
    ends = cage.tets[:, TET_EDGES]
    length = [np.linalg.norm(x[ends[..., 0]] - x[ends[..., 1]], axis=-1) for x in shapes]
    calm = (np.max(length[1:], axis=0) / length[0]).max(1) < MAX_EDGE_STRETCH
    some = np.flatnonzero(~calm[embedded.host].all(1))
    if not len(some):
        return embedded
    weights, vertex = embedded.weights[some].astype(np.float64), cage.tets[embedded.host[some]]
    sigma = np.exp(g.log_scales[some].astype(np.float64))
    axes = matrices_from_quaternions(g.quats[some].astype(np.float64)) * sigma[:, None]

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
    host, _ = located(segment, corner)
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
