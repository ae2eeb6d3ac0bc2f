"""Skin weights on a cage: each vertex follows the joint whose bone is nearest inside the cage, softened by diffusion.

    (L + H) W = H P       L the cage's Laplacian, P the joint that each vertex belongs to (0 or 1), H = HOLD m / d^2

with d the distance to the bone: where a limb is thin, or close to its bone, the change from joint to joint is quick
(Baran & Popovic, Automatic Rigging and Animation of 3D Characters, 2007, there on surfaces). L has positive weights on
edges alone, so that all W lie in 0..1 and each vertex's sum to 1.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, diags
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.sparse.linalg import splu

from assets.animation import JOINTS_PER_VERTEX

HOLD = 4.0  # how much quicker weights change than over the distance to the bone
FIRM = 0.7  # share of its first joint from which on a vertex is driven; others bend, and are simulated
CRUSHED = 0.6  # volume, of 1 at rest: what skinning leaves less to is left to the simulation, with what is about it
ABOUT = 0.055  # of the body's size: so far about it. Joints bend the more gently, the longer what is left free
EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])


def laplacian(vertices: np.ndarray, tets: np.ndarray):
    """L (V, V) [m] with positive weights on edges, and the volume m of each vertex [m^3], (V,)."""
    x = np.asarray(vertices, np.float64)
    volume = np.linalg.det(x[tets[:, 1:]] - x[tets[:, :1]]) / 6
    ends = tets[:, EDGES].reshape(-1, 2)
    length2 = ((x[ends[:, 0]] - x[ends[:, 1]]) ** 2).sum(1)
    k = np.repeat(volume, 6) / length2  # a box of tets then has about the Laplacian of its finite differences
    V = len(x)
    A = coo_matrix((np.r_[k, k], (np.r_[ends[:, 0], ends[:, 1]], np.r_[ends[:, 1], ends[:, 0]])), shape=(V, V)).tocsr()
    mass = np.bincount(tets.ravel(), np.repeat(volume / 4, 4), minlength=V)
    return (diags(np.asarray(A.sum(1)).ravel()) - A).tocsc(), mass


def diffused(vertices: np.ndarray, tets: np.ndarray, held: np.ndarray, target: np.ndarray) -> np.ndarray:
    """W of (L + diag(m held)) W = diag(m held) target, (V, J); held [1/m^2] (V,), target (V, J) rows sum to 1."""
    L, mass = laplacian(vertices, tets)
    H = mass * held
    return splu((L + diags(H)).tocsc()).solve(H[:, None] * target)


def strongest(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The largest weights of each row (V, J), to sum 1 again: joints (V, 4) int32, weights (V, 4) float32."""
    if weights.shape[1] < JOINTS_PER_VERTEX:
        weights = np.pad(weights, ((0, 0), (0, JOINTS_PER_VERTEX - weights.shape[1])))
    joints = np.argsort(-weights, axis=1, kind="stable")[:, :JOINTS_PER_VERTEX]
    w = np.take_along_axis(weights, joints, 1).clip(0)
    w[w < 1e-3 * w[:, :1]] = 0.0
    return np.where(w > 0, joints, 0).astype(np.int32), (w / w.sum(1, keepdims=True)).astype(np.float32)


def firm(
    vertices: np.ndarray,
    weights: np.ndarray,
    tets: np.ndarray,
    surface: np.ndarray,
    shapes: np.ndarray,
    core: np.ndarray | None = None,
    leader: np.ndarray | None = None,
) -> np.ndarray:
    """Which vertices are driven, (V,) bool: those of the surface that one joint leads, not near what this crushes.

    weights  (V, 4) of each vertex's joints, the largest first;  surface  indices of the surface's vertices
    shapes   where skinning puts all vertices in some frames, the first at rest (F, V, 3)
    core     vertices in the bones, (V,) bool: they are driven too, lest the flesh about them crumple by its inertia
    leader   first joint of each vertex, (V,); -1 where that leads no other: a foot is held, however little leads it
    """
    driven = np.zeros(len(weights), bool) if core is None else core.copy()
    driven[surface] = True
    driven &= weights[:, 0] >= FIRM
    x = np.asarray(vertices, np.float64)
    ends = np.unique(np.sort(tets[:, EDGES].reshape(-1, 2), axis=1), axis=0)
    length = np.linalg.norm(x[ends[:, 0]] - x[ends[:, 1]], axis=1)
    graph = coo_matrix((length, ends.T), shape=(len(x),) * 2).tocsr()
    tight = np.unique(tets[least_volumes(tets, shapes) < CRUSHED])
    if len(tight):
        reach = ABOUT * np.ptp(x, axis=0).max()
        driven &= dijkstra(graph, directed=False, indices=tight, min_only=True, limit=reach) > reach
        loose = islands(x, ends, driven, reach, leader)
        loose[np.setdiff1d(np.arange(len(x)), surface)] = False  # in coarse cages what is in a bone does lie alone
        driven &= ~loose
    return driven


def islands(
    x: np.ndarray, ends: np.ndarray, driven: np.ndarray, reach: float, leader: np.ndarray | None = None
) -> np.ndarray:
    """Mask (V,) of driven vertices in patches less than `reach` [m] across, round which none is driven; twice as large
    if a patch is the only one of its joint.

    Such a patch in an armpit is dragged through flesh that is free to go elsewhere, and turns tets inside out.
    ends  (E, 2) of the edges of x (V, 3); leader as of `firm`
    """
    both = ends[driven[ends].all(1)]
    count, patch = connected_components(coo_matrix((np.ones(len(both)), both.T), shape=(len(x),) * 2), directed=False)
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, patch, x)
    np.maximum.at(high, patch, x)
    across = np.linalg.norm(high - low, axis=1)[patch]
    if leader is None:
        return driven & (across < reach)
    led = np.unique(np.stack([leader, patch])[:, driven & (across > 0)], axis=1)[0]  # of each patch, by whom
    patches = np.bincount(led[led >= 0], minlength=leader.max() + 2)
    return driven & (leader >= 0) & (across < np.where(patches[leader] == 1, 2 * reach, reach))


def least_volumes(tets: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """The smallest volume that each tet has in shapes (F, V, 3), of 1 in the first, (T,)."""

    def volumes(x):
        return np.linalg.det(x[tets[:, 1:]] - x[tets[:, :1]])

    rest, least = volumes(shapes[0]), np.ones(len(tets))
    for x in shapes[1:]:
        least = np.minimum(least, volumes(x) / rest)
    return least
