"""Which bone each bit of a person's solid belongs to, and what its hands hold: measured through the solid.

The cage's tets are coarser than the gap between an arm and the side it hangs at; the grid that the cage was made from
is not, and Gaussians lie on its surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from core.distance_grid import DistanceGrid
from prepare.rig.landmarks import to_segment

EXCESS = 1.6  # radii: a person's flesh, boots and jackets lie within, but for patches
LEAST_HELD = 0.015  # of the solid: such patches are smaller
NEXT_TO = 0.06  # of the height: so near to a hand is what it holds
ROUND = 0.12  # of a ball's radius, root mean square: what is off it by less is one
COVERED, MOST_BALLS = 0.9, 12
# half of the 26 neighbours of a node
STEPS = [(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if (i, j, k) > (0, 0, 0)]


@dataclass(frozen=True)
class Solid:
    """Nodes of a grid inside a body: points (n, 3) [m], spacing [m], depth (n,) [m] below the surface."""

    points: np.ndarray
    spacing: float
    depth: np.ndarray
    graph: coo_matrix
    tree: cKDTree

    @classmethod
    def of(cls, sdf: DistanceGrid) -> Solid:
        inside = np.asarray(sdf.values, np.float32) < 0
        spacing = float(sdf.spacing)
        node = np.argwhere(inside)
        number = np.full(inside.shape, -1)
        number[inside] = np.arange(len(node))
        number = np.pad(number, 1, constant_values=-1)
        rows, columns, lengths = [], [], []
        for step in STEPS:
            other = number[tuple((node + 1 + step).T)]
            here = np.flatnonzero(other >= 0)
            rows.append(here)
            columns.append(other[here])
            lengths.append(np.full(len(here), spacing * np.linalg.norm(step)))
        ends = np.concatenate(rows), np.concatenate(columns)
        graph = coo_matrix((np.concatenate(lengths), ends), shape=(len(node),) * 2).tocsr()
        points = np.asarray(sdf.origin, np.float64) + spacing * node
        depth = spacing * ndimage.distance_transform_edt(np.pad(inside, 1))[1:-1, 1:-1, 1:-1][inside]
        return cls(points, spacing, depth, graph, cKDTree(points))

    def ways(self, segments: list) -> np.ndarray:
        """Length [m] of the shortest way through the solid from each segment (a, b) to each point, (n, segments)."""
        result = np.empty((len(self.points), len(segments)))
        for k, (a, b) in enumerate(segments):
            steps = max(int(np.linalg.norm(b - a) / self.spacing), 1) + 1
            start = np.unique(self.tree.query(a + np.linspace(0, 1, steps)[:, None] * (b - a))[1])
            result[:, k] = dijkstra(self.graph, directed=False, indices=start, min_only=True)
        return result


def held_by_hands(solid: Solid, radii: np.ndarray, hands: dict, height: float) -> list[tuple[str, np.ndarray, list]]:
    """What hands hold: a piece of the solid that no bone's radius explains, next to a hand; as balls that cover it.

    radii  how many of its bone's radii each point is off the bone that is nearest by that, (n,)
    hands  {side: (wrist, tip) [m]};  height  [m] of the person
    Out.   [(side, indices of the piece's points, [(centre (3,), radius) [m] of each ball])]
    """
    far = np.flatnonzero(radii > EXCESS)
    count, piece = connected_components(solid.graph[far][:, far], directed=False)
    result = []
    for p in range(count):
        mine = far[piece == p]
        if len(mine) < LEAST_HELD * len(solid.points):
            continue
        near = {s: to_segment(solid.points[mine], *ends).min() for s, ends in hands.items()}
        side = min(near, key=near.get)
        if near[side] < NEXT_TO * height:
            result.append((side, mine, balls(solid, mine)))
    return result


def balls(solid: Solid, mine: np.ndarray) -> list[tuple[np.ndarray, float]]:
    """Balls (centre, radius) [m] that cover these points of the solid: one, if that is what they are, else several."""
    x, depth = solid.points[mine], solid.depth[mine]
    rim = x[depth < 1.1 * solid.spacing]
    if len(rim) > 3:  # |x|^2 = 2 c x + r^2 - |c|^2
        fit = np.linalg.lstsq(np.c_[2 * rim, np.ones(len(rim))], (rim**2).sum(1), rcond=None)[0]
        center, radius = fit[:3], float(np.sqrt(max(fit[3] + fit[:3] @ fit[:3], 0.0)))
        off = np.linalg.norm(rim - center, axis=1) - radius
        inside = np.linalg.norm(x - center, axis=1) < radius + solid.spacing
        if np.sqrt((off**2).mean()) < ROUND * radius and inside.mean() > COVERED:
            return [(center, radius + 0.5 * solid.spacing)]  # nodes are inside
    result, open_ = [], np.ones(len(mine), bool)
    while open_.mean() > 1 - COVERED and len(result) < MOST_BALLS:
        k = np.flatnonzero(open_)[np.argmax(depth[open_])]
        result.append((x[k], float(depth[k] + solid.spacing)))
        open_ &= np.linalg.norm(x - x[k], axis=1) >= result[-1][1]
    return result
