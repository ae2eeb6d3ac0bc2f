"""Contact samples: points on the bodies' surfaces that are tested against everything else (NumPy, then fields)."""

from dataclasses import dataclass

import numpy as np
import taichi as ti
from scipy.spatial import cKDTree

from core.distance_grid import DistanceGrid
from core.fields import Upload, round_up_capacity
from scenes.scene import Capsule
from sim.body_model import BodyModel, RestShape
from sim.contact.static_shapes import Shape, StaticGrid
from sim.model import Capacity, Model, fit, stacked
from sim.state import State

FINEST, COARSEST = 0.004, 0.02  # [m] spacing that is worth its cost; spacing that still finds a finger
CLOSE = 0.75  # [spacings] between points that are thinned out: so far apart at least, one spacing at most on average
RIGID = 0.1  # of the size of a rigid body, the finest spacing of its samples
MOST = 6000  # samples a body; a longer list is thinned by a larger spacing
# Of E, the pressure of a body's own weight at its foot, above which its inner vertices are samples too: it cannot carry
# them, and they would hang through the floor by many times its size.
LIMP = 0.5


@dataclass(frozen=True)
class SurfacePoints:
    """Points sum_k weights[k] x[ids[k]] of one body: ids (P, 3) local vertex indices, weights (P, 3) float64."""

    ids: np.ndarray
    weights: np.ndarray

    def joined(self, other: "SurfacePoints") -> "SurfacePoints":
        return SurfacePoints(np.concatenate([self.ids, other.ids]), np.concatenate([self.weights, other.weights]))


def spacing_for(shapes: list[Shape]) -> float:
    """Spacing [m] at which nothing static slips between samples: half of the thinnest capsule, two voxels of a grid."""
    thin = [0.5 * s.radius for s in shapes if isinstance(s, Capsule)]
    thin += [2.0 * s.grid.spacing * s.scale for s in shapes if isinstance(s, StaticGrid)]
    return float(np.clip(min(thin, default=COARSEST), FINEST, COARSEST))


def surface_points(vertices: np.ndarray, surface: np.ndarray, spacing: float, most: int = MOST) -> SurfacePoints:
    """The surface's vertices, and points on its triangles where these lie further apart than `spacing` [m].

    Of a fine lattice (i, j, k)/n on every triangle those points are taken, one after the other, that are further than
    CLOSE spacings from all taken before. If more than `most` points come out, the spacing grows.
    """
    x, surface = np.asarray(vertices, np.float64), np.asarray(surface, np.int64)
    used = np.unique(surface)
    ids, weights = np.repeat(used[:, None], 3, axis=1), np.tile([1.0, 0.0, 0.0], (len(used), 1))
    edges = np.linalg.norm(x[surface] - x[np.roll(surface, -1, axis=1)], axis=-1).max(1)
    area = np.linalg.norm(np.cross(*np.diff(x[surface], axis=1).swapaxes(0, 1)), axis=1).sum() / 2
    spacing = max(spacing, 0.8 * np.sqrt(area / most))  # as many points would be far too many already
    while True:
        lattice = [
            triangle_lattice(surface[steps == n], n)
            for steps in [np.ceil(edges / (0.5 * spacing) - 1e-6).astype(int)]
            for n in np.unique(steps[edges > spacing])
        ]
        all_ids = np.concatenate([ids, *(i for i, _ in lattice)])
        all_weights = np.concatenate([weights, *(w for _, w in lattice)])
        taken = thin_out((x[all_ids] * all_weights[..., None]).sum(1), CLOSE * spacing, len(used))
        if len(taken) <= max(most, len(used)):
            return SurfacePoints(all_ids[taken], all_weights[taken])
        spacing *= 1.25


def triangle_lattice(triangles: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertex indices (P, 3) and weights (P, 3) of the points (i, j, k)/n of each triangle, but for its corners."""
    parts = np.array([(i, j, n - i - j) for i in range(n + 1) for j in range(n + 1 - i) if max(i, j, n - i - j) < n])
    return np.repeat(triangles, len(parts), axis=0), np.tile(parts / n, (len(triangles), 1))


def thin_out(points: np.ndarray, distance: float, keep: int) -> np.ndarray:
    """Indices of the first `keep` points and of each later one that is `distance` or more from all taken before."""
    neighbours = cKDTree(points).query_ball_point(points, distance * (1 - 1e-9))
    free = np.ones(len(points), bool)
    taken = []
    for p, near in enumerate(neighbours):
        if p < keep or free[p]:
            taken.append(p)
            free[near] = False
    return np.array(taken)


def skin(points: SurfacePoints, vertices: np.ndarray, sdf: DistanceGrid | None) -> np.ndarray:
    """How far under each point the visible surface lies [m], (P,): a cage is dilated around what is seen.

    The rest distance there, at most two voxels (more would be a wrong grid); 0 without a grid.
    """
    if sdf is None:
        return np.zeros(len(points.ids))
    x = (np.asarray(vertices, np.float64)[points.ids] * points.weights[..., None]).sum(1)
    values = np.asarray(sdf.values, np.float64)
    q = (x - np.asarray(sdf.origin)) / sdf.spacing
    q = np.clip(q, 0, np.array(values.shape) - 1.001)
    i = q.astype(int)
    f = q - i
    phi = np.zeros(len(x))
    for corner in np.ndindex(2, 2, 2):
        weight = np.where(corner, f, 1 - f).prod(1)
        phi += weight * values[tuple((i + corner).T)]
    return np.clip(phi, -2 * sdf.spacing, 2 * sdf.spacing)


def points_of(shape: RestShape, spacing: float) -> SurfacePoints:
    if shape.rigid:  # it bends nowhere: between its corners and edges few points will do
        spacing = max(spacing, RIGID * float(np.ptp(shape.vertices, axis=0).max()))
    return surface_points(shape.vertices, shape.surface, spacing)


def skin_of(shape: RestShape, spacing: float) -> np.ndarray:
    return skin(shape.once(points_of, spacing), shape.vertices, shape.sdf)


def inner_of(shape: RestShape) -> SurfacePoints:
    """The vertices that are not on the surface."""
    inside = np.setdiff1d(np.arange(len(shape.vertices)), shape.surface)
    return SurfacePoints(np.repeat(inside[:, None], 3, axis=1), np.tile([1.0, 0.0, 0.0], (len(inside), 1)))


def limp(part: BodyModel) -> bool:
    """Whether a body cannot carry itself on Earth."""
    m, height = part.material, float(np.ptp(part.shape.vertices, axis=0).max())
    return not part.shape.rigid and m.density * 9.81 * height > LIMP * m.young


@ti.data_oriented
class ContactSamples:
    """Samples of all bodies on the device.

    ids vec3i[P] global vertex indices;   weight vec3[P];   body i32[P];   skin f32[P] [m]
    of_vertex i32[V]: the sample that is vertex i, -1 for none;   single i32[P]: whether a sample is a vertex
    host_ids, host_weights: the same in NumPy
    """

    def __init__(self, state: State, first: Model, spacing: float, capacity: Capacity = Capacity()):
        self.state, self.spacing = state, spacing
        count = sum(len(p.ids) for p in self._points(first))
        inner = sum(len(p.shape.once(inner_of).ids) for p in first.bodies if limp(p))
        self.capacity = round_up_capacity(capacity.sized("samples", count + inner))
        self.builder = ti.FieldsBuilder()
        self.ids, self.weight = ti.Vector.field(3, ti.i32), ti.Vector.field(3, ti.f32)
        self.body, self.single, self.skin = ti.field(ti.i32), ti.field(ti.i32), ti.field(ti.f32)
        self.builder.dense(ti.i, self.capacity).place(self.ids, self.weight, self.body, self.single, self.skin)
        self.of_vertex = ti.field(ti.i32)
        self.builder.dense(ti.i, state.V).place(self.of_vertex)
        self.count = ti.field(ti.i32)
        self.builder.place(self.count)
        self.tree = self.builder.finalize()
        self._upload = Upload(
            [self.ids, self.weight, self.single, self.of_vertex, self.body, self.skin, self.count],
        )

    def _points(self, model: Model) -> list[SurfacePoints]:
        return [s.once(points_of, self.spacing) for s in model.shapes]

    def check_capacity(self, model: Model) -> None:
        fit("samples", sum(len(p.ids) for p in self._points(model)), self.capacity)

    def triangle_points(self, model: Model) -> int:
        """How many samples are not vertices."""
        return sum(int((p.weights[:, 0] != 1.0).sum()) for p in self._points(model))

    def load(self, model: Model) -> None:
        """Take the samples of these bodies; inner vertices of limp ones too, as far as there is room."""
        points = self._points(model)
        skins = [s.once(skin_of, self.spacing) for s in model.shapes]
        left = self.capacity - sum(len(p.ids) for p in points)
        for k, part in enumerate(model.bodies):
            inner = part.shape.once(inner_of)
            if limp(part) and len(inner.ids) <= left:
                left -= len(inner.ids)
                points[k] = points[k].joined(inner)
                skins[k] = np.r_[skins[k], np.zeros(len(inner.ids))]
        ids = [p.ids + o for p, o in zip(points, model.vertex_begin, strict=False)]
        self.host_ids, self.host_weights = stacked(ids, 3), stacked([p.weights for p in points], 3)
        single = self.host_weights[:, 0] == 1.0
        of_vertex = np.full(self.state.V, -1)
        of_vertex[self.host_ids[single, 0]] = np.flatnonzero(single)
        body = np.repeat(np.arange(len(points)), [len(p.ids) for p in points])
        self._upload([self.host_ids, self.host_weights, single, of_vertex, body, stacked(skins), len(body)])

    @ti.func
    def blend(self, p, field: ti.template()):
        """sum_k weight_k field[ids_k] of sample p."""
        ids, b = self.ids[p], self.weight[p]
        return b[0] * field[ids[0]] + b[1] * field[ids[1]] + b[2] * field[ids[2]]

    @ti.func
    def put(self, p, r, rows: ti.template()):
        """Make the sample's vertices the first three of row r."""
        for k in ti.static(range(3)):
            rows.set_vertex(r, k, self.ids[p][k], self.weight[p][k])

    def destroy(self) -> None:
        self.tree.destroy()
