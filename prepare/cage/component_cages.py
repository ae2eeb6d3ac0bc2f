"""Cages of the connected components of a splat: grid, Gaussians, number of vertices and mesher of each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from assets.asset import Cage, CageEmbedding
from assets.gaussians import Gaussians
from core.errors import BadInput
from prepare.cage.cage_generation import EXACT_VERTICES, VERTEX_RANGE, cage_of
from prepare.cage.embedding_hosts import embed
from prepare.cage.level_set import dilated_26
from prepare.cage.tetgen_mesher import MeshFailed, check_installed, tetgen_cage
from prepare.cleaning import MIN_GAUSSIANS

MESHERS = ("stuffing", "tetgen")
GRID_NODES = 96  # on the longest side for 2,000 vertices: seven a lattice cell
GRID_NODES_RANGE = (64, 192)  # with the border below 256, which `level_set.interior` counts in bytes
GRID_POWER = 0.2  # of the number of vertices; 1/3 would keep seven, but four are enough and memory is limited
BORDER = 1 / 8  # of the grid, left free on each side for what closing and widening add
MAX_STRAY = 0.05  # of the extent: a Gaussian this far off the surface belongs to another component
OPAQUE = 0.5  # opacity from which on a Gaussian belongs to the surface
MIN_COMPONENT = 0.02  # of the largest component's cells; smaller ones are specks
MAX_COMPONENTS = 32  # a solver holds twice as many bodies
MINOR_COMPONENT = 0.1  # of all vertices: a component this small may be left out if no cage fits it


@dataclass(frozen=True)
class Grid:
    """Nodes (i, j, k) at origin + spacing (i, j, k), in the file's units; `nodes` of them on the longest side."""

    origin: np.ndarray
    spacing: float
    shape: tuple[int, int, int]
    nodes: int

    @classmethod
    def over(cls, points: np.ndarray, vertices: float) -> Grid:
        """Grid around points (N, 3), as fine as suits a cage of this many vertices."""
        low, high = points.min(0), points.max(0)
        nodes = int(np.clip(GRID_NODES * (vertices / 2000) ** GRID_POWER, *GRID_NODES_RANGE))
        spacing = float((high - low).max()) / nodes
        shape = tuple(int(k) for k in np.ceil((high - low) / spacing + 2 * BORDER * nodes) + 1)
        return cls(low - BORDER * nodes * spacing, spacing, shape, nodes)


@dataclass(frozen=True)
class Component:
    """A connected solid that gets a cage of its own.

    phi      signed distance (X, Y, Z) [grid cells]
    indices  its Gaussians (N,)
    cells    {"shell", "solid", "flap"}: of its whole cluster, dense cells (X, Y, Z) bool, these with what they enclose,
             and those of a thin part that is in neither (prepare/cage/flap.py)
    """

    grid: Grid
    phi: np.ndarray
    indices: np.ndarray
    cells: dict[str, np.ndarray]

    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner (3,) of its cells, in the file's units."""
        inside = np.argwhere(self.phi < 0)
        low, high = inside.min(0) - 0.5, inside.max(0) + 0.5
        return self.grid.origin + self.grid.spacing * low, self.grid.origin + self.grid.spacing * high

    def area(self) -> float:
        """Approximate surface area, in the file's units: nodes within half a cell of it."""
        return float((np.abs(self.phi) < 0.5).sum()) * self.grid.spacing**2

    def in_flap(self, g: Gaussians) -> np.ndarray:
        """Mask (N,) of the Gaussians that are outside the solid because they belong to the flap."""
        return in_flap(self.cells, (g.means - self.grid.origin) / self.grid.spacing)


@dataclass(frozen=True)
class ComponentCage:
    """A component, its cage in the file's units (float64), and the name of the mesher that made it."""

    component: Component
    cage: Cage
    mesher: str


def check_mesher(mesher: str) -> None:
    """Raise BadInput unless that mesher is known and installed."""
    if mesher not in MESHERS:
        raise BadInput(f"{mesher!r} is not a mesher; known: {', '.join(MESHERS)}")
    if mesher == "tetgen":
        check_installed()


def surface_mask(g: Gaussians) -> np.ndarray:
    """Mask (N,) of the Gaussians that make up the surface: opacity above a half; all of them in a faint splat."""
    mask = g.opacities > OPAQUE
    return mask if mask.sum() >= MIN_GAUSSIANS else np.ones(len(g), bool)


def cluster_grids(g: Gaussians, clusters: list[np.ndarray], vertices: int) -> list[Grid]:
    """Grid of each cluster, given as indices of Gaussians."""
    seen = [g.means[m][surface_mask(g.select(m))].astype(np.float64) for m in clusters]
    size = np.array([np.ptp(p, axis=0).max() for p in seen]) ** 2
    return [Grid.over(p, vertices * s) for p, s in zip(seen, size / size.sum(), strict=True)]


def components_of(g: Gaussians, indices: np.ndarray, grid: Grid, cells: dict, phis: np.ndarray) -> list[Component]:
    """Components phis (P, X, Y, Z) of a cluster, each with those of its Gaussians `indices` that are nearest to it.

    A Gaussian near none of them is left out, and so is a component without Gaussians.
    """
    points = (g.means[indices] - grid.origin) / grid.spacing
    values = np.stack([_nearest_value(phi, points) for phi in phis])
    own = values.argmin(0)
    close = (values.min(0) < MAX_STRAY * grid.nodes) | in_flap(cells, points)
    found = [Component(grid, phi, indices[close & (own == k)], cells) for k, phi in enumerate(phis)]
    return found if len(found) == 1 else [c for c in found if len(c.indices) >= MIN_GAUSSIANS]


def in_flap(cells: dict[str, np.ndarray], points: np.ndarray) -> np.ndarray:
    """Mask (N,) of the points (N, 3) in grid cells that are in the flap's cells or beside these, not in the solid."""
    if not cells["flap"].any():
        return np.zeros(len(points), bool)
    beside = dilated_26(cells["flap"]) & ~cells["solid"]
    return _nearest_value(np.where(beside, 0.0, np.inf), points) == 0.0


def _nearest_value(phi: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Values of phi (N,) at the nodes next to points (N, 3) in grid cells; infinite beyond the grid."""
    node = np.rint(points.clip(-1e9, 1e9)).astype(np.int64)
    within = ((node >= 0) & (node < phi.shape)).all(1)
    values = np.full(len(points), np.inf)
    values[within] = phi[tuple(node[within].T)]
    return values


def vertex_counts(areas: np.ndarray, vertices: int) -> np.ndarray:
    """Vertices of each component by its area (P,): 0 for one too small for a cage, and beyond MAX_COMPONENTS."""
    kept = np.zeros(len(areas), bool)
    kept[np.argsort(-areas, kind="stable")[:MAX_COMPONENTS]] = True
    while True:
        counts = np.where(kept, areas, 0.0) * vertices / areas[kept].sum()
        small = kept & (counts < VERTEX_RANGE[0])
        if not small.any() or kept.sum() == 1:
            return np.rint(counts).astype(int)
        kept[np.flatnonzero(small)[counts[small].argmin()]] = False


def component_cages(
    components: list[Component],
    g: Gaussians,
    vertices: int,
    mesher: str,
    report: Callable[[float], None],
    *,
    adaptive: bool,
    say: Callable[[str], None] | None,
    checkpoint: Callable[[str, Callable[[], dict]], dict],
) -> list[ComponentCage]:
    """Cages of the components, without those too small for one. Raises BadInput where a large component gets none.

    checkpoint  keeps what is made under a name, as Checkpoints.step does
    """
    counts = vertex_counts(np.array([c.area() for c in components]), vertices)
    found = []
    for k, (component, count) in enumerate(zip(components, counts, strict=True)):
        if not count:
            continue
        grid = component.grid
        minor = len(components) > 1 and count <= MINOR_COMPONENT * vertices

        def make(component=component, count=int(count), minor=minor, k=k) -> dict:
            def progress(done: float) -> None:
                report((k + done) / len(components))

            progress(0.0)
            own = g.select(component.indices)
            held = surface_mask(own) & ~component.in_flap(own)
            points = (own.means[held].astype(np.float64) - component.grid.origin) / component.grid.spacing
            # A few vertices hold no thin feature exactly: a minor component may be inexact, or left out.
            exact = vertices >= EXACT_VERTICES and not minor
            try:
                cage, used = mesh(
                    mesher, component.phi, points, count, progress, adaptive=adaptive, exact=exact, say=say
                )
            except BadInput:
                if not minor:
                    raise
                return {"tets": np.zeros((0, 4), np.int32)}
            return {**vars(cage), "tetgen": np.array(used == "tetgen")}

        made = checkpoint(f"cage{k or ''}", make)
        if len(made["tets"]):
            x = grid.origin + grid.spacing * made["vertices"].astype(np.float64)
            cage = Cage(x, made["tets"], made["surface"])
            found.append(ComponentCage(component, cage, MESHERS[int(made["tetgen"])]))
    return found


def mesh(
    mesher: str,
    phi: np.ndarray,
    points: np.ndarray,
    vertices: int,
    report: Callable[[float], None],
    *,
    adaptive: bool = True,
    exact: bool | None = None,
    say: Callable[[str], None] | None = None,
) -> tuple[Cage, str]:
    """The cage of `cage_of`, and its mesher: stuffing where TetGen fails, which `say` is told. Raises BadInput."""
    if mesher == "tetgen":
        try:
            return tetgen_cage(phi, points, vertices, report, exact), "tetgen"
        except MeshFailed as e:
            if say:
                say(f"TetGen: {e}; the cage is made by stuffing instead")
    return cage_of(phi, points, vertices, report, adaptive=adaptive, exact=exact), "stuffing"


def extent_of(cages: list[ComponentCage]) -> tuple[float, np.ndarray]:
    """Largest extent of all components together, and the centre of their cages' footprint; in file units."""
    boxes = np.array([c.component.box() for c in cages])
    longest = float((boxes[:, 1].max(0) - boxes[:, 0].min(0)).max())
    low = np.min([c.cage.vertices.min(0) for c in cages], axis=0)
    high = np.max([c.cage.vertices.max(0) for c in cages], axis=0)
    middle = (low + high) / 2
    return longest, np.array([middle[0], low[1], middle[2]])


def joined_cage(cages: list[ComponentCage], place: Callable[[np.ndarray], np.ndarray]) -> tuple[Cage, np.ndarray]:
    """One cage of all, its vertices transformed by `place`, and the first tet of each component and the end, (P+1,)."""
    first = np.cumsum([0, *(len(c.cage.vertices) for c in cages)])
    vertices = [place(c.cage.vertices).astype(np.float32) for c in cages]
    tets = [c.cage.tets + np.int32(k) for c, k in zip(cages, first, strict=False)]
    surface = [c.cage.surface + np.int32(k) for c, k in zip(cages, first, strict=False)]
    begin = np.cumsum([0, *(len(t) for t in tets)])
    return Cage(np.concatenate(vertices), np.concatenate(tets), np.concatenate(surface)), begin


def embedded_in(cage: Cage, begin: np.ndarray, g: Gaussians, counts: list[int]) -> CageEmbedding:
    """Embedding of each Gaussian in its own component: `counts` of them in turn; `begin` as of `joined_cage`."""
    host, weights, first = [], [], 0
    for k, count in enumerate(counts):
        own, tets = g.select(slice(first, first + count)), cage.tets[begin[k] : begin[k + 1]]
        found = embed(own.means, own.quats, np.exp(own.log_scales), cage.vertices, tets)
        host.append(found.host + np.int32(begin[k]))
        weights.append(found.weights)
        first += count
    return CageEmbedding(np.concatenate(host), np.concatenate(weights))
