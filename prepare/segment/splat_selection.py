"""Selection of an object's Gaussians in a splat, from marks on its pictures.

Marks give seeds: Gaussians that are certainly inside or outside of the object. A random walk on the graph of neighbours
tells how easily each Gaussian is reached from the seeds inside. Of the sets above a threshold of that probability, the
object is the one with the clearest border: with the least weight of cut edges for its size. Edges that no view shows
cost next to nothing, so that an object lying on its whole bottom is cut off as easily as one on three feet. Gaussians
that no view shows then join the side that they are most alike with.

In a large splat this is done twice: with a thinned splat, and with all Gaussians along the border found.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from assets.gaussians import Gaussians
from core.camera import Camera, directions_around, look_at, perspective
from core.morton import morton_order
from prepare.blending_weights import BlendingWeights
from prepare.segment import graph_cut
from prepare.segment.marks import ViewMarks, drawn_boxes, drawn_strokes
from render.projection import DILATION

VIEWS = 24  # 40 degrees apart
PICTURE = 200  # [px] across that ball
ROOM = 1 << 18  # least number of Gaussians for which there is room: another needs other kernels
DISTANCE = 4.0  # radii of a ball that holds the Gaussians: so far away that parallel rays describe the views
STROKE_WIDTH = 0.008  # fraction of a picture's height: a thin felt pen
SEED_SHARE = 0.8  # fraction of a stroke's weight that its seeds carry; the rest shines through or spills in
BOX_MIDDLE = 1 / 3  # fraction of a box's sides: this middle part is taken for the object if there is no stroke
CLEARLY = 2.0  # a Gaussian under strokes of both sides is a seed of one if its weight there is this many times larger
NEARBY = 2.5  # radii of the strokes around the inner ones within which an object may lie
NEARBY_ALONE = 5.0  # the same if there is no stroke outside, which says how far the object reaches
RIM = 1.2  # of these radii: Gaussians between there and here lie outside
NEARLY_ALL = 95.0  # [%] of the seeds lie within one radius: some shine through from far behind
SEEN = 0.4  # share of a Gaussian that counts as all of it: those of a surface overlap, and hide one another
UNSEEN = 1e-3  # factor for an edge that no view shows
MORTON_BITS = 21  # of a coordinate: few Gaussians far away leave the others in few cells of 10 bits
NODES = 1 << 15  # of a graph, which takes a second: of more, some stand for the others until the border is found
WEAKEST = 1e-3  # least likeness along a border: none is free


class ViewsAround:
    """Draws Gaussians from all sides; kept between selections, as it takes seconds to start. Taichi must be running.

    A Gaussian that no view shows, inside an object or under it, has an arbitrary colour after training, and is no
    evidence of where one object ends and another begins.
    """

    def __init__(self):
        self._weights = None

    def shares(self, gaussians: Gaussians) -> np.ndarray:
        """Visible share (VIEWS, N) float32, 0..1, of each Gaussian in each view."""
        n, plain = len(gaussians), gaussians.with_sh_degree(0)
        if self._weights is None:
            self._weights = BlendingWeights(plain, sort="z", capacity=ROOM)
        self._weights.replace(plain)
        middle = 0.5 * (gaussians.means.min(axis=0) + gaussians.means.max(axis=0)).astype(np.float64)
        radius = np.linalg.norm(gaussians.means - middle, axis=1).max()
        everywhere = [np.ones((PICTURE, PICTURE), np.float32)]
        sigma, means = gaussians.covariances, gaussians.means.astype(np.float64)
        shares = np.empty((VIEWS, n), np.float32)
        for view, way in enumerate(directions_around(VIEWS)):
            eye = middle + DISTANCE * radius * way
            camera = perspective(PICTURE, PICTURE, 2.0 * np.arcsin(1.0 / DISTANCE), look_at(eye, middle))
            seen = self._weights.sums(camera, everywhere)[:n, 0]
            shares[view] = seen / free_weights(means, sigma, gaussians.opacities, camera, way)
        return shares.clip(0.0, 1.0, out=shares)

    def destroy(self) -> None:
        """Free the device memory."""
        if self._weights is not None:
            self._weights.destroy()
        self._weights = None


def free_weights(means: np.ndarray, sigma: np.ndarray, opacities: np.ndarray, camera: Camera, way: np.ndarray):
    """Blending weights (N,) [px] that unoccluded Gaussians have in the picture of a far camera that looks along -way.

    means (N, 3), sigma (N, 6) covariances, opacities (N,)
    The projection along a unit vector d has det Sigma_2D = d^T adj(Sigma) d and tr Sigma_2D = tr Sigma - d^T Sigma d;
    a splat weighs 2 pi opacity sqrt(det(s^2 Sigma_2D + dilation I)), s = f / z.
    """
    scale2 = (camera.fx / ((camera.position - means) @ way).clip(1e-9, None)) ** 2
    flat = graph_cut.quadratic_form(graph_cut.adjugate(sigma), way).clip(0.0, None)
    trace = sigma[:, [0, 3, 5]].sum(1) - graph_cut.quadratic_form(sigma, way)
    det = scale2**2 * flat + DILATION * scale2 * trace + DILATION**2
    return 2.0 * np.pi * opacities * np.sqrt(det)


@dataclass(frozen=True)
class ViewSeeds:
    """Seeds by the marks of one view: indices of those inside and outside, and what no box holds, (N,) bool."""

    inside: np.ndarray
    outside: np.ndarray
    barred: np.ndarray | None


class Seeds:
    """Seeds (N,) bool of an object: `inside`, `outside`, and `barred`, which no box around it holds."""

    def __init__(self, count: int, views: Iterable[ViewSeeds]):
        self.inside, self.outside, self.barred = (np.zeros(count, bool) for _ in range(3))
        for view in views:
            self.inside[view.inside] = self.outside[view.outside] = True
            if view.barred is not None:
                self.barred |= view.barred
        self.inside &= ~self.outside


def view_seeds(gaussians: Gaussians, weights, camera: Camera, marks: ViewMarks) -> ViewSeeds:
    """Seeds of an object by its marks in a view."""
    under = stroke_weights(weights, camera, marks)
    inside, outside = (strongest(w) for w in under)
    barred = None
    if marks.boxes:
        x, y, z = camera.projected(gaussians.means.astype(np.float64))
        within = [(x >= b[0]) & (x <= b[2]) & (y >= b[1]) & (y <= b[3]) for b in marks.boxes]
        barred = ~(np.any(within, axis=0) & (z > 0))
    return ViewSeeds(
        inside[under[0][inside] > CLEARLY * under[1][inside]],
        outside[under[1][outside] > CLEARLY * under[0][outside]],
        barred,
    )


def stroke_weights(weights, camera: Camera, marks: ViewMarks) -> tuple[np.ndarray, np.ndarray]:
    """Weights (N,) [px] of each Gaussian under what is inside and outside; a box without strokes counts as one."""
    shape = (camera.height, camera.width)
    width = max(3, round(STROKE_WIDTH * camera.height))
    inside, outside = (drawn_strokes(strokes, shape, width) for strokes in (marks.inside, marks.outside))
    if marks.boxes and not marks.inside:
        middles = [np.tile(0.5 * (b[:2] + b[2:]), 2) for b in marks.boxes]
        half = [0.5 * BOX_MIDDLE * (b[2:] - b[:2]) for b in marks.boxes]
        inside |= drawn_boxes([m + np.concatenate([-h, h]) for m, h in zip(middles, half, strict=True)], shape)
    return tuple(weights.sums(camera, [inside, outside]).T)


def strongest(weights: np.ndarray) -> np.ndarray:
    """Indices of the Gaussians of the largest weights (N,) that make up SEED_SHARE of their sum."""
    some = np.flatnonzero(weights)
    order = some[np.argsort(-weights[some])]
    total = np.cumsum(weights[order], dtype=np.float64)
    return order[: int(np.searchsorted(total, SEED_SHARE * total[-1])) + 1] if len(order) else order


class SplatSelection:
    """Selects one object after another in a splat, looking only at its surroundings. Taichi must be running.

    `views` may be taken over from another selection that is no longer used.
    """

    def __init__(self, gaussians: Gaussians, views: ViewsAround | None = None):
        self._order = morton_order(gaussians.means, bits=MORTON_BITS)  # trees are searched in it in half the time
        self._gaussians = gaussians.select(self._order).with_sh_degree(0)
        self._views = ViewsAround() if views is None else views
        self._rim: tuple | None = None  # of the selection that was grown last
        self._kept: dict[tuple, np.ndarray] = {}  # what was selected, packed in bits: undo, grow and shrink are fast

    def select(self, inside: np.ndarray, outside: np.ndarray, barred: np.ndarray | None = None) -> np.ndarray:
        """The object's Gaussians (N,) bool.

        inside, outside  seeds (N,) bool: belong to the object; do not
        barred           (N,) bool: cannot belong to it, though not marked
        """
        barred = outside if barred is None else outside | barred
        inside = inside & ~barred
        if not inside.any():
            return inside
        key = tuple(np.packbits(each).tobytes() for each in (inside, outside, barred))
        if key not in self._kept:
            found = np.zeros(len(inside), bool)
            found[self._order] = self._selected(*(each[self._order] for each in (inside, outside, barred)))
            self._kept[key] = np.packbits(found)
        return np.unpackbits(self._kept[key], count=len(inside)) > 0

    def _selected(self, inside: np.ndarray, outside: np.ndarray, barred: np.ndarray) -> np.ndarray:
        distance, reach = distances(self._gaussians.means, inside, outside)
        index = np.flatnonzero((distance < RIM * reach) | inside)
        others = ~inside & (barred | (distance > reach))
        out = np.zeros(len(inside), bool)
        out[index] = self._cut(self._gaussians.select(index), inside[index], others[index])
        return out

    def _cut(self, near: Gaussians, own: np.ndarray, others: np.ndarray) -> np.ndarray:
        """Cut some Gaussians by seeds (N,) bool; returns the inside (N,) bool.

        Many are first cut as a thinned splat; then the Gaussians of the cells at its border, with the cells beside
        these as seeds.
        """
        if len(near) <= NODES:
            return self._whole_cut(near, own, others)[0]
        thin = graph_cut.thinned(near, NODES)
        count = len(thin.some)
        held = np.bincount(thin.cell, own, count)
        lead = held - np.bincount(thin.cell, others, count)
        firm = lead > 0
        firm[np.where(held > 0, lead, -np.inf).argmax()] = True  # else nothing of what is smaller than a cell is left
        coarse, low, high, shares = self._whole_cut(thin.gaussians, firm, ~firm & (lead < 0))
        at = touched(low, high, coarse[low] != coarse[high], count)
        beside = touched(low, high, at[low] | at[high], count) & ~at
        found = (coarse[thin.cell] | own) & ~others
        free, rim = at[thin.cell], beside[thin.cell]
        index = np.flatnonzero(free | rim)
        found[index] = self._whole_cut(
            near.select(index),
            own[index] | (found & rim)[index],
            others[index] | (~found & rim)[index],
            shares[:, thin.cell[index]],
        )[0]
        return found

    def _whole_cut(self, near: Gaussians, own: np.ndarray, others: np.ndarray, shares=None):
        """Cut all of these Gaussians at once.

        Returns the inside (N,) bool, both ends of the edges (E,), and the visible `shares` (V, N) if not given.
        """
        low, high, likeness = graph_cut.neighbour_edges(near)
        if shares is None:
            shares = self._views.shares(near) / SEEN
        graph = graph_cut.graph_of(low, high, border_costs(low, high, likeness, shares), len(near))
        inside = graph_cut.random_walk(graph, np.where(own, 1, np.where(others, 0, -1)), 2)[:, 1]
        cut = graph_cut.clearest_level(graph, inside, own, others)
        return graph_cut.most_alike(low, high, likeness, cut, own | others | (shares.max(0) > 1.0)), low, high, shares

    def grown(self, cut: np.ndarray, rings: int) -> np.ndarray:
        """The selection (N,) bool grown by so many rings of neighbours, or shrunk if negative."""
        if not rings or not cut.any():
            return cut
        key = np.packbits(cut).tobytes()
        if self._rim is None or self._rim[0] != key or self._rim[1] < abs(rings):
            index, links = self._rim_of(cut[self._order], 2 * abs(rings))
            self._rim = key, 2 * abs(rings), self._order[index], links
        index, links = self._rim[2:]
        part = cut[index]
        for _ in range(abs(rings)):
            part = part | (links @ part > 0) if rings > 0 else part & ~(links @ ~part > 0)
        out = cut.copy()
        out[index] = part
        return out

    def _rim_of(self, cut: np.ndarray, rings: int) -> tuple[np.ndarray, csr_matrix]:
        """Indices (R,) of all Gaussians within so many rings of a selection's border, at least, and their graph.

        cut  (N,) bool: the selection
        """
        points = self._gaussians.means
        distance = np.linalg.norm(points - points[cut].mean(axis=0, dtype=np.float64), axis=1)
        index = np.flatnonzero(distance <= 2.0 * distance[cut].max())
        if len(index) > NODES:
            thin, part = graph_cut.thinned(self._gaussians.select(index), NODES), cut[index]
            low, high, _ = graph_cut.neighbours_of(
                thin.gaussians.means.astype(np.float64), graph_cut.log_widths(thin.gaussians)
            )
            here, there = (np.bincount(thin.cell, side, len(thin.some)) > 0 for side in (part, ~part))
            near = touched(low, high, here[low] & there[high] | there[low] & here[high], len(here)) | (here & there)
            for _ in range(rings):
                near |= touched(low, high, near[low] | near[high], len(near))
            index = index[near[thin.cell]]
        near = self._gaussians.select(index)
        low, high, _ = graph_cut.neighbours_of(near.means.astype(np.float64), graph_cut.log_widths(near))
        return index, graph_cut.graph_of(low, high, np.ones(len(low)), len(index))

    def destroy(self) -> None:
        """Free the device memory."""
        self._views.destroy()


def distances(points: np.ndarray, inside: np.ndarray, outside: np.ndarray) -> tuple[np.ndarray, float]:
    """Distances (N,) of points (N, 3) from the middle of the seeds inside, and the largest one within an object.

    inside, outside  (N,) bool: the seeds
    """
    distance = np.linalg.norm(points - np.median(points[inside], axis=0), axis=1)
    strokes = float(np.percentile(distance[inside | outside], NEARLY_ALL))
    return distance, strokes * (NEARBY if outside.any() else NEARBY_ALONE)


def border_costs(low: np.ndarray, high: np.ndarray, likeness: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Costs (E,) of cutting edges: the likeness of their ends, where a view shows both.

    shares  (V, N), visible share of each Gaussian in each view; 1 and more: fully visible
    """
    together = np.zeros(len(low), np.float32)
    for view in shares:
        np.maximum(together, np.minimum(view[low], view[high]), out=together)
    return np.maximum(likeness, WEAKEST) * together.clip(UNSEEN, 1.0)


def touched(low: np.ndarray, high: np.ndarray, edges: np.ndarray, count: int) -> np.ndarray:
    """Nodes (count,) bool at an end of some of the edges (E,), (E,)."""
    out = np.zeros(count, bool)
    out[low[edges]] = out[high[edges]] = True
    return out
