"""Selection of an object's Gaussians in a splat, from seeds inside and outside of it.

A random walk on the graph of neighbours says how easily each Gaussian is reached from the seeds. Of the sets of those
that are reached more easily than others, the object is the one that is joined to the rest by the clearest border: by
the least weight of edges for its size. Borders that no view shows cost next to nothing, so that an object that lies on
its whole bottom is cut off as easily as one on three feet. Gaussians that no view shows then go with those most alike.
"""

from __future__ import annotations

import numpy as np

from assets.gaussians import Gaussians
from prepare.segment.gaussian_graph import graph_of, log_widths, neighbour_edges, neighbours_of
from prepare.segment.graph_cut import clearest_level, most_alike, random_walk
from prepare.segment.views_around import ViewsAround

NEARBY = 2.5  # radii of the strokes around the inner ones within which an object may lie
NEARBY_ALONE = 5.0  # the same if there is no stroke outside, which says how far the object reaches
RIM = 1.2  # of these radii: Gaussians between there and here lie outside
NEARLY_ALL = 95.0  # [%] of the seeds lie within one radius: some shine through from far behind
SEEN = 0.4  # share of a Gaussian that counts as all of it: those of a surface overlap, and hide one another
UNSEEN = 1e-3  # factor for an edge that no view shows
WEAKEST = 1e-3  # least likeness along a border: none is free


class SplatSelection:
    """Selects one object after another in a splat; each in its surroundings alone, however large the splat is.

    Taichi must be running. `views` are drawn by another selection that is not used any more.
    """

    def __init__(self, gaussians: Gaussians, views: ViewsAround | None = None):
        self._gaussians = gaussians.with_sh_degree(0)
        self._views = ViewsAround() if views is None else views
        self._kept: dict[tuple, np.ndarray] = {}  # what was selected, packed in bits: undo, grow and shrink are fast

    def select(self, inside: np.ndarray, outside: np.ndarray, barred: np.ndarray | None = None) -> np.ndarray:
        """The object's Gaussians (N,) bool.

        inside, outside  seeds (N,) bool: belong to the object; do not
        barred           (N,) bool: cannot belong to it, but nobody has marked them
        """
        barred = outside if barred is None else outside | barred
        inside = inside & ~barred
        if not inside.any():
            return inside
        key = tuple(np.packbits(each).tobytes() for each in (inside, outside, barred))
        if key not in self._kept:
            self._kept[key] = np.packbits(self._selected(inside, outside, barred))
        return np.unpackbits(self._kept[key], count=len(inside)) > 0

    def _selected(self, inside: np.ndarray, outside: np.ndarray, barred: np.ndarray) -> np.ndarray:
        points = self._gaussians.means.astype(np.float64)
        middle = np.median(points[inside], axis=0)
        distance = np.linalg.norm(points - middle, axis=1)
        reach = np.percentile(distance[inside | outside], NEARLY_ALL) * (NEARBY if outside.any() else NEARBY_ALONE)
        index = np.flatnonzero((distance < RIM * reach) | inside)
        near, own = self._gaussians.select(index), inside[index]
        low, high, likeness = neighbour_edges(near)
        shares = self._views.shares(near, middle, distance[index].max()) / SEEN
        together = np.zeros(len(low), np.float32)
        for view in shares:
            np.maximum(together, np.minimum(view[low], view[high]), out=together)
        graph = graph_of(low, high, np.maximum(likeness, WEAKEST) * together.clip(UNSEEN, 1.0), len(index))
        others = ~own & (barred[index] | (distance[index] > reach))
        cut = clearest_level(graph, random_walk(graph, own, others), own, others)
        out = np.zeros(len(inside), bool)
        out[index] = most_alike(low, high, likeness, cut, own | others | (shares.max(0) > 1.0))
        return out

    def grown(self, cut: np.ndarray, rings: int) -> np.ndarray:
        """The selection (N,) bool grown by so many rings of neighbours, or shrunk if negative."""
        if not rings or not cut.any():
            return cut
        points = self._gaussians.means.astype(np.float64)
        distance = np.linalg.norm(points - points[cut].mean(axis=0), axis=1)
        index = np.flatnonzero(distance <= 2.0 * distance[cut].max())
        one, two, _ = neighbours_of(points[index], log_widths(self._gaussians)[index])
        links, part = graph_of(one, two, np.ones(len(one)), len(index)), cut[index]
        for _ in range(abs(rings)):
            part = part | (links @ part > 0) if rings > 0 else part & ~(links @ ~part > 0)
        out = np.zeros_like(cut)
        out[index] = part
        return out

    def destroy(self) -> None:
        """Free the device memory."""
        self._views.destroy()
