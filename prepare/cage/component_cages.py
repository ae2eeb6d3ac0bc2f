"""A splat of several pieces: the grid of each, which Gaussians belong to which, how vertices are shared out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from assets.asset import Cage, CageEmbedding
from assets.gaussians import Gaussians
from core.errors import BadInput
from prepare.cage.cage import COUNTS, EXACT
from prepare.cage.embedding_hosts import embed_on_device
from prepare.cage.meshers import MESHERS, mesh
from prepare.cleaning import FEWEST

NODES = 96  # of the grid on the longest side for 2,000 vertices: seven a lattice cell
NODES_RANGE = (64, 192)  # with the border below fill.CELLS_MAX
NODES_POWER = 0.2  # of the number of vertices; 1/3 would keep seven, but four are enough and memory is not
BORDER = 1 / 8  # of the grid, left free on each side for what closing and widening add
STRAY = 0.05  # of the extent: what lies this far off the surface belongs to another piece
OPAQUE = 0.5
LEAST = 0.02  # of the largest piece's cells; what is smaller is a speck
MOST = 32  # pieces: a solver holds twice as many bodies
MINOR = 0.1  # of all vertices: a piece that small may be left out if no cage fits it


@dataclass(frozen=True)
class Grid:
    """Nodes (i, j, k) at origin + spacing (i, j, k), in the file's units; `nodes` of them on the longest side."""

    origin: np.ndarray
    spacing: float
    shape: tuple[int, int, int]
    nodes: int

    @classmethod
    def over(cls, points: np.ndarray, vertices: float) -> Grid:
        """Round points (N, 3), as fine as suits a cage of so many vertices."""
        low, high = points.min(0), points.max(0)
        nodes = int(np.clip(NODES * (vertices / 2000) ** NODES_POWER, *NODES_RANGE))
        spacing = float((high - low).max()) / nodes
        shape = tuple(int(k) for k in np.ceil((high - low) / spacing + 2 * BORDER * nodes) + 1)
        return cls(low - BORDER * nodes * spacing, spacing, shape, nodes)


@dataclass(frozen=True)
class Part:
    """A piece that gets a cage of its own: its signed distance phi [grid cells], and its Gaussians by number (N,)."""

    grid: Grid
    phi: np.ndarray
    mine: np.ndarray
    cluster: int = 0

    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner (3,) of its cells, in the file's units."""
        inside = np.argwhere(self.phi < 0)
        low, high = inside.min(0) - 0.5, inside.max(0) + 0.5
        return self.grid.origin + self.grid.spacing * low, self.grid.origin + self.grid.spacing * high

    def area(self) -> float:
        """Of its surface, about, in the file's units: nodes within half a cell of it."""
        return float((np.abs(self.phi) < 0.5).sum()) * self.grid.spacing**2


@dataclass(frozen=True)
class Caged:
    """A part, its cage in the file's units (float64), and which mesher made that."""

    part: Part
    cage: Cage
    mesher: str


def opaque(g: Gaussians) -> np.ndarray:
    """Mask (N,) of the Gaussians that make up the surface: opacity above a half; all of them in a faint splat."""
    mask = g.opacities > OPAQUE
    return mask if mask.sum() >= FEWEST else np.ones(len(g), bool)


def grids_of(g: Gaussians, number: np.ndarray, vertices: int) -> list[Grid]:
    """The grid of each cluster of Gaussians; `number` (N,) tells which one each belongs to."""
    seen = [g.means[m][opaque(g.select(m))].astype(np.float64) for m in members(number)]
    size = np.array([np.ptp(p, axis=0).max() for p in seen]) ** 2
    return [Grid.over(p, vertices * s) for p, s in zip(seen, size / size.sum(), strict=True)]


def members(number: np.ndarray) -> list[np.ndarray]:
    """The indices with each number 0, 1, ..."""
    return [np.flatnonzero(number == k) for k in range(int(number.max()) + 1)]


def parts_of(g: Gaussians, mine: np.ndarray, grid: Grid, phis: np.ndarray) -> list[Part]:
    """The pieces phis (P, X, Y, Z) of a cluster, each with those of its Gaussians `mine` that are nearest to it.

    What is near none of them is left out, and so is a piece without Gaussians.
    """
    points = (g.means[mine] - grid.origin) / grid.spacing
    values = np.stack([value_at(phi, points) for phi in phis])
    own = values.argmin(0)
    close = values.min(0) < STRAY * grid.nodes
    found = [Part(grid, phi, mine[close & (own == k)]) for k, phi in enumerate(phis)]
    return found if len(found) == 1 else [p for p in found if len(p.mine) >= FEWEST]


def value_at(phi: np.ndarray, points: np.ndarray) -> np.ndarray:
    """phi (N,) at the nodes next to points (N, 3) in grid cells; infinite beyond the grid."""
    node = np.rint(points.clip(-1e9, 1e9)).astype(np.int64)
    within = ((node >= 0) & (node < phi.shape)).all(1)
    values = np.full(len(points), np.inf)
    values[within] = phi[tuple(node[within].T)]
    return values


def shared_out(areas: np.ndarray, vertices: int) -> np.ndarray:
    """Vertices of each piece by its area (P,): 0 for one too small for a cage, and for what is beyond MOST pieces."""
    kept = np.zeros(len(areas), bool)
    kept[np.argsort(-areas, kind="stable")[:MOST]] = True
    while True:
        share = np.where(kept, areas, 0.0) * vertices / areas[kept].sum()
        small = kept & (share < COUNTS[0])
        if not small.any() or kept.sum() == 1:
            return np.rint(share).astype(int)
        kept[np.flatnonzero(small)[share[small].argmin()]] = False


def cages_of(
    parts: list[Part],
    g: Gaussians,
    vertices: int,
    mesher: str,
    report: Callable[[float], None],
    *,
    adaptive: bool,
    say: Callable[[str], None] | None,
    kept: Callable[[str, Callable[[], dict]], dict],
) -> list[Caged]:
    """The cage of each part, but of those too small for one.

    kept  keeps what is made under a name, as Checkpoints.stage does
    Raises BadInput where a large part gets none.
    """
    shares = shared_out(np.array([p.area() for p in parts]), vertices)
    found = []
    for k, (part, count) in enumerate(zip(parts, shares, strict=True)):
        if not count:
            continue
        grid, centres = part.grid, g.means[part.mine]
        points = (centres[opaque(g.select(part.mine))].astype(np.float64) - grid.origin) / grid.spacing

        minor = len(parts) > 1 and count <= MINOR * vertices

        def meshed(part=part, count=int(count), points=points, minor=minor, k=k) -> dict:
            def share(done: float) -> None:
                report((k + done) / len(parts))

            share(0.0)
            exact, reason = vertices >= EXACT, None
            for strict in (True, False) if exact and minor else (exact,):  # few vertices hold no thin part exactly
                try:
                    how = {"adaptive": adaptive, "exact": strict, "say": say}
                    cage, used = mesh(mesher, part.phi, points, count, share, **how)
                except BadInput as e:
                    reason = e
                else:
                    return {**vars(cage), "tetgen": np.array(used == "tetgen")}
            if not minor:
                raise reason
            return {"tets": np.zeros((0, 4), np.int32)}

        made = kept(f"cage{k or ''}", meshed)
        if len(made["tets"]):
            x = grid.origin + grid.spacing * made["vertices"].astype(np.float64)
            found.append(Caged(part, Cage(x, made["tets"], made["surface"]), MESHERS[int(made["tetgen"])]))
    return found


def mesher_of(caged: list[Caged]) -> str:
    """What made the cages: one name, or both."""
    return " and ".join(sorted({c.mesher for c in caged}))


def extent_of(caged: list[Caged]) -> tuple[float, np.ndarray]:
    """The largest extent of all pieces together, and the middle of their cages' lowest points; in the file's units."""
    boxes = np.array([c.part.box() for c in caged])
    longest = float((boxes[:, 1].max(0) - boxes[:, 0].min(0)).max())
    low = np.min([c.cage.vertices.min(0) for c in caged], axis=0)
    high = np.max([c.cage.vertices.max(0) for c in caged], axis=0)
    middle = (low + high) / 2
    return longest, np.array([middle[0], low[1], middle[2]])


def joined(caged: list[Caged], place: Callable[[np.ndarray], np.ndarray]) -> tuple[Cage, np.ndarray]:
    """One cage of all, its vertices carried by `place`, and at which tet each one's begin and end, (P+1,)."""
    first = np.cumsum([0, *(len(c.cage.vertices) for c in caged)])
    vertices = [place(c.cage.vertices).astype(np.float32) for c in caged]
    tets = [c.cage.tets + np.int32(k) for c, k in zip(caged, first, strict=False)]
    surface = [c.cage.surface + np.int32(k) for c, k in zip(caged, first, strict=False)]
    begin = np.cumsum([0, *(len(t) for t in tets)])
    return Cage(np.concatenate(vertices), np.concatenate(tets), np.concatenate(surface)), begin


def embedded_in(cage: Cage, begin: np.ndarray, g: Gaussians, counts: list[int]) -> CageEmbedding:
    """Each Gaussian in the tets of its own piece: `counts` of them, one after the other. Taichi must be running."""
    host, weights, first = [], [], 0
    for k, count in enumerate(counts):
        own = g.select(slice(first, first + count))
        tets = cage.tets[begin[k] : begin[k + 1]]
        used = slice(int(tets.min()), int(tets.max()) + 1)
        how = (own.means, own.quats, np.exp(own.log_scales), cage.vertices[used], tets - np.int32(used.start))
        found = embed_on_device(*how)
        host.append(found.host + np.int32(begin[k]))
        weights.append(found.weights)
        first += count
    return CageEmbedding(np.concatenate(host), np.concatenate(weights))
