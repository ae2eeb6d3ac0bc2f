"""Selection of an object's Gaussians in a splat, from seeds inside and outside of it.

In each round a random walk on the graph of neighbours measures how close each Gaussian is to the current selection,
colours measure whether it looks alike, and the minimum cut by both is the next selection. Seeds alone are too few for
a cut: the minimum one would run right around them.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.sparse.csgraph import connected_components

from assets.gaussians import Gaussians
from core.morton import morton_order
from prepare.segment.gaussian_graph import Clusters, border_graph, merge_matrix, merged, neighbour_graph, rgb_of
from prepare.segment.graph_cut import banded_cut, random_walk

ORDER_BITS = 20  # an axis: of a far floater's extent, a cell is still smaller than a Gaussian
CLUSTERS = 20_000  # nodes of the coarse graph that is cut first, in a tenth of a second
CLEARER = 0.75  # a round counts if it lowers the share of edges cut to this; else it would creep into the support
NEARBY = 2.5  # radii of the selection within which it may grow
COLOUR_BINS = 24  # of the histogram, per channel
COLOUR_BLUR = 1.2  # [bins]
COLOUR_FLOOR = 0.05  # share added to every colour, so that a colour seen on neither side is neutral
COLOUR_AGAINST_MAX = 1.0  # bound on the log likelihood against unknown colours: the far side may have them
COLOUR_WALK = 0.002  # weight of one unit of log likelihood, relative to an edge
COLOUR_CUT = 0.045
WALK_CUT = 0.6  # weight of a certain result of the random walk, relative to an edge
HOLE_MAX = 0.02  # an enclosed part up to this fraction of the selection is filled


class SplatSelection:
    """Graph of a splat, in which one object after another is selected: table of seconds in bench/NOTES.md.

    order  (N,) of the Gaussians in the graph: neighbours are near in memory, which halves the time
    """

    def __init__(self, gaussians: Gaussians):
        self.order = morton_order(gaussians.means, bits=ORDER_BITS)
        gaussians = gaussians.with_sh_degree(0).select(self.order)
        self._points, self.graph = gaussians.means, neighbour_graph(gaussians)
        self._clusters = Clusters(self.graph, CLUSTERS)
        self._degree = np.asarray(self.graph.sum(1)).ravel()
        self._kept: dict[tuple, np.ndarray] = {}  # what was selected, packed in bits: undo, grow and shrink are fast
        widths = np.sort(np.exp(gaussians.log_scales.astype(np.float64)), axis=1)
        self._width = np.sqrt(widths[:, 1] * widths[:, 2])  # [m]
        self._area = widths[:, 1] * widths[:, 2] * gaussians.opacities  # [m^2]: dense parts do not count for more
        bins = (rgb_of(gaussians) * (COLOUR_BINS - 1e-3)).astype(np.int64)
        self._colour = np.ravel_multi_index(tuple(bins.T), (COLOUR_BINS,) * 3)

    def select(self, inside: np.ndarray, outside: np.ndarray, barred: np.ndarray | None = None) -> np.ndarray:
        """The object's Gaussians (N,) bool.

        inside, outside  seeds (N,) bool: belong to the object; do not
        barred           (N,) bool: cannot belong to it, but are no examples of its surroundings' colours
        """
        barred = outside if barred is None else outside | barred
        inside = inside & ~barred
        if not inside.any():
            return inside
        seeds = inside, outside, barred = inside[self.order], outside[self.order], barred[self.order]
        key = tuple(np.packbits(each).tobytes() for each in seeds)
        if key not in self._kept:
            self._kept[key] = np.packbits(self._selected(inside, outside, barred))
        return self._in_file(np.unpackbits(self._kept[key], count=len(inside)) > 0)

    def _selected(self, inside: np.ndarray, outside: np.ndarray, barred: np.ndarray) -> np.ndarray:
        """As `select`, in the order of the graph."""
        region = self._around(inside, inside | outside, NEARBY if outside.any() else 2 * NEARBY)
        cut, others = inside, outside | ~region
        before = np.inf
        while True:
            more = self._cut(cut, inside, barred, others, region | inside)
            leak = self._conductance(more)
            if not leak < CLEARER * before:
                break
            cut, before, region = more, leak, self._around(more, more, NEARBY)
            others = region & ~cut
        return self._without_holes(cut, barred)

    def _cut(self, cut, inside, barred, others, region) -> np.ndarray:
        """The next selection, of the Gaussians in a region; what is beyond it is outside."""
        index = np.flatnonzero(region)
        rows = self.graph[index]
        graph, beyond = rows[:, index].tocsr(), rows @ (~region).astype(float)
        cut_here, inside_here, barred_here = cut[index], inside[index], barred[index]
        likely = self._colour_ratio(cut, others)[index]
        likes, dislikes = likely.clip(0.0, None), (-likely).clip(0.0, None)
        clusters = self._clusters.of(index, CLUSTERS, inside_here + 2 * barred_here)
        merge = merge_matrix(clusters)
        whole = np.asarray(merge.sum(1)).ravel()
        barred_clusters = merge @ barred_here > 0
        core = (merge @ (cut_here & (rows @ (~cut).astype(float) <= 0.0)) >= whole) | (merge @ inside_here > 0)
        p = random_walk(
            merged(graph, clusters),
            core & ~barred_clusters,
            barred_clusters,
            COLOUR_WALK * (merge @ likes),
            COLOUR_WALK * (merge @ dislikes) + merge @ beyond,
        )[clusters]
        leaving_out = COLOUR_CUT * likes + WALK_CUT * (p - 0.5).clip(0.0, None)
        putting_in = COLOUR_CUT * dislikes + WALK_CUT * (0.5 - p).clip(0.0, None) + beyond
        leaving_out = np.where(inside_here, np.inf, np.where(barred_here, 0.0, leaving_out))
        putting_in = np.where(barred_here, np.inf, np.where(inside_here, 0.0, putting_in))
        out = np.zeros(len(cut), bool)
        priced = border_graph(graph, self._width[index] / np.median(self._width[inside]))
        out[index] = banded_cut(priced, leaving_out, putting_in, clusters)
        return self._joined_to(out, inside)

    def _conductance(self, cut: np.ndarray) -> float:
        """Weights of the edges that leave the selection, as a share of all edges of its Gaussians or of the others,
        whichever is larger: of a whole thing, little; of nearly the whole splat, much."""
        leaving = float((self.graph[cut] @ (~cut).astype(float)).sum())
        own = float(self._degree[cut].sum())
        return leaving / max(min(own, float(self._degree.sum()) - own), 1e-30)

    def _colour_ratio(self, inside: np.ndarray, outside: np.ndarray) -> np.ndarray:
        """Logarithm of the ratio of likelihoods (N,) of each Gaussian's colour inside and outside."""
        ratio = np.zeros(COLOUR_BINS**3)
        for which, sign in ((inside, 1.0), (outside, -1.0)):
            counts = np.bincount(self._colour[which], self._area[which], COLOUR_BINS**3)
            counts = gaussian_filter(counts.reshape((COLOUR_BINS,) * 3), COLOUR_BLUR, mode="constant").ravel()
            ratio += sign * np.log(counts / max(counts.max(), 1e-30) + COLOUR_FLOOR)
        return ratio.clip(-COLOUR_AGAINST_MAX, None)[self._colour]

    def _around(self, which: np.ndarray, seen: np.ndarray, radii: float) -> np.ndarray:
        """Gaussians (N,) bool within some radii of the middle of `which`; one radius holds nearly all of `seen`."""
        distance = np.linalg.norm(self._points - np.median(self._points[which], axis=0), axis=1)
        return distance < radii * np.percentile(distance[seen], 95.0)

    def _joined_to(self, cut: np.ndarray, seeds: np.ndarray) -> np.ndarray:
        """The connected parts of a selection that hold a seed."""
        index = np.flatnonzero(cut)
        part = self._parts(index)
        out = np.zeros(len(cut), bool)
        out[index] = np.isin(part, part[seeds[index]])
        return out

    def _without_holes(self, cut: np.ndarray, barred: np.ndarray) -> np.ndarray:
        """The selection with small parts that it encloses."""
        beyond = ~cut
        index = np.flatnonzero(beyond & self._around(cut, cut, NEARBY))
        beyond[index] = False
        part, rows = self._parts(index), self.graph[index]
        small = np.bincount(part) <= HOLE_MAX * cut.sum()
        small[part[barred[index] | (rows @ beyond > 0)]] = False
        touches = np.zeros(len(small), bool)
        touches[part[rows @ cut > 0]] = True
        out = cut.copy()
        out[index] = (small & touches)[part]
        return out

    def _parts(self, index: np.ndarray) -> np.ndarray:
        """Number (M,) of the connected part among the Gaussians `index` (M,) that each of them belongs to."""
        return connected_components(self.graph[index][:, index], directed=False)[1]

    def grown(self, cut: np.ndarray, rings: int) -> np.ndarray:
        """The selection grown by so many rings of neighbours, or shrunk if negative."""
        cut = cut[self.order]
        for _ in range(abs(rings)):
            cut = cut | (self.graph @ cut > 0) if rings > 0 else cut & ~(self.graph @ ~cut > 0)
        return self._in_file(cut)

    def _in_file(self, cut: np.ndarray) -> np.ndarray:
        """A selection (N,) in the order of the file, of one in that of the graph."""
        out = np.empty_like(cut)
        out[self.order] = cut
        return out
