"""Contact samples: the points on bodies, thin static capsules and fingers that are tested against other shapes."""

from dataclasses import dataclass

import numpy as np
import taichi as ti
from scipy.spatial import cKDTree
from taichi.math import vec3

from core.distance_grid import SKIN_VOXELS, DistanceGrid
from core.fields import FieldGroup, Upload, round_up_capacity
from core.vocabulary import Capsule
from sim.contact.broad_phase import BodyBounds
from sim.contact.finger_capsules import SAMPLES_PER_CAPSULE, FingerCapsules
from sim.contact.static_shapes import Shape, StaticGrid
from sim.model import MAX_BODIES, BodyModel, Capacity, Model, RestShape, fit, stacked
from sim.state import State

MIN_SPACING, MAX_SPACING = 0.004, 0.02  # [m]: a smaller one costs more than it gains; a larger one misses a finger
MIN_SEPARATION = 0.75  # [spacings] between points after thinning: one spacing at most on average
MIN_RIGID_SPACING = 0.1  # of the size of a rigid body: it does not bend, and its contacts are solved one by one
MAX_SAMPLES = 6000  # of a body; a longer list is thinned by a larger spacing
MAX_CAPSULES = 32  # static capsules with samples
STATIC_GROUPS = MAX_BODIES + MAX_CAPSULES  # the next ones are finger capsules
# [spacings] of a thin capsule. Between a body's samples, two a radius, it slips where the body is stretched fourfold:
# of rings that started at twice their size on a peg of 4 cm radius, one in twelve came off.
THIN_RADIUS = 8.0
# Of E, the pressure of a body's own weight at its foot, above which its inner vertices are samples too: it cannot
# support them, and they would hang through the floor by many times its size.
MAX_SELF_WEIGHT = 0.5


@dataclass(frozen=True)
class SurfacePoints:
    """Points on a surface, sum_k weights[k] x[ids[k]] of one body.

    ids (P, 3) local vertex indices, weights (P, 3) float64.
    """

    ids: np.ndarray
    weights: np.ndarray


def points_at(vertices: np.ndarray) -> SurfacePoints:
    """Points at vertices of these indices (N,)."""
    return SurfacePoints(np.repeat(vertices[:, None], 3, axis=1), np.tile([1.0, 0.0, 0.0], (len(vertices), 1)))


def spacing_for(shapes: list[Shape]) -> float:
    """Spacing [m] at which no static shape slips between samples: half the thinnest capsule, two voxels of a grid."""
    thin = [0.5 * s.radius for s in shapes if isinstance(s, Capsule)]
    thin += [2.0 * s.grid.spacing * s.scale for s in shapes if isinstance(s, StaticGrid)]
    return float(np.clip(min(thin, default=MAX_SPACING), MIN_SPACING, MAX_SPACING))


def surface_points(vertices: np.ndarray, surface: np.ndarray, spacing: float, most: int = MAX_SAMPLES) -> SurfacePoints:
    """Samples: the surface's vertices, and points on its triangles where these lie further apart than `spacing` [m].

    Of a fine lattice (i, j, k)/n on every triangle those points are taken, one after the other, that are further than
    MIN_SEPARATION spacings from all taken before. If more than `most` points come out, the spacing grows.
    """
    x, surface = np.asarray(vertices, np.float64), np.asarray(surface, np.int64)
    corners = points_at(np.unique(surface))
    count = len(corners.ids)
    edges = np.linalg.norm(x[surface] - x[np.roll(surface, -1, axis=1)], axis=-1).max(1)
    area = np.linalg.norm(np.cross(*np.diff(x[surface], axis=1).swapaxes(0, 1)), axis=1).sum() / 2
    spacing = max(spacing, 0.8 * np.sqrt(area / most))  # a smaller spacing gives far too many points
    while True:
        steps = np.ceil(edges / (0.5 * spacing) - 1e-6).astype(int)
        lattice = [triangle_lattice(surface[steps == n], n) for n in np.unique(steps[edges > spacing])]
        ids = np.concatenate([corners.ids, *(i for i, _ in lattice)])
        weights = np.concatenate([corners.weights, *(w for _, w in lattice)])
        taken = thin_out((x[ids] * weights[..., None]).sum(1), MIN_SEPARATION * spacing, count)
        if len(taken) <= max(most, count):
            return SurfacePoints(ids[taken], weights[taken])
        spacing *= 1.25


def triangle_lattice(triangles: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertex indices (P, 3) and weights (P, 3) of the points (i, j, k)/n of each triangle, but for its corners."""
    parts = np.array([(i, j, n - i - j) for i in range(n + 1) for j in range(n + 1 - i) if max(i, j, n - i - j) < n])
    return np.repeat(triangles, len(parts), axis=0), np.tile(parts / n, (len(triangles), 1))


def thin_out(points: np.ndarray, distance: float, keep: int) -> np.ndarray:
    """Indices of the first `keep` points and of each later one that is `distance` or more from all taken before."""
    limit = distance * (1 - 1e-9)
    to_kept, _ = cKDTree(points[:keep]).query(points[keep:], distance_upper_bound=limit)
    left = keep + np.flatnonzero(np.isinf(to_kept))
    first, second = cKDTree(points[left]).query_pairs(limit, output_type="ndarray").T  # first < second
    taken, undecided = np.zeros(len(left), bool), np.ones(len(left), bool)
    while undecided.any():  # take all at once that are near to no undecided one before them
        free = undecided.copy()
        free[second] = False
        taken |= free
        undecided &= ~free
        undecided[second[free[first]]] = False
        remain = undecided[first] & undecided[second]
        first, second = first[remain], second[remain]
    return np.r_[np.arange(keep), left[taken]]


def skin_depth(points: SurfacePoints, vertices: np.ndarray, sdf: DistanceGrid | None) -> np.ndarray:
    """Depth [m] of the visible surface under each point, (P,): a cage is larger than the visible surface.

    The rest distance there, at most SKIN_VOXELS (more would be a wrong grid); 0 without a grid.
    """
    if sdf is None:
        return np.zeros(len(points.ids))
    x = (np.asarray(vertices, np.float64)[points.ids] * points.weights[..., None]).sum(1)
    return np.clip(sdf.sample(x), -SKIN_VOXELS * sdf.spacing, SKIN_VOXELS * sdf.spacing)


def root_spacing(shape: RestShape, spacing: float) -> float:
    """Spacing [m] on a shape's root that is about `spacing` on the shape, 0.7 to 1.4 times, and less if it shrank.

    In powers of two: to choose samples takes longer than a frame, and not every size needs others.
    """
    return spacing / 2 ** max(0, round(np.log2(shape.factor)))


def points_of(shape: RestShape, spacing: float) -> SurfacePoints:
    """Samples of a rest shape; those of a scaled one are its root's, at root_spacing."""
    if shape.rigid:  # few points suffice between the corners and edges of a body that does not bend
        spacing = max(spacing, MIN_RIGID_SPACING * shape.length)
    return surface_points(shape.vertices, shape.surface, spacing)


def skin_of(shape: RestShape, spacing: float) -> np.ndarray:
    """Skin depth [m] of each sample of a rest shape, (P,)."""
    return skin_depth(shape.once(points_of, spacing), shape.vertices, shape.sdf)


def inner_of(part: BodyModel) -> np.ndarray:
    """Inner vertices that are samples too: those of a body that cannot carry its own weight on Earth."""
    m, shape = part.material, part.shape
    if shape.rigid or m.density * 9.81 * shape.length <= MAX_SELF_WEIGHT * m.young:
        return np.zeros(0, np.int64)
    return np.setdiff1d(np.arange(len(shape.vertices)), shape.surface)


@ti.data_oriented
class ContactSamples:
    """Samples of all bodies on the device.

    ids vec3i[P] global vertex indices;   weight vec3[P];   body i32[P];   skin f32[P] [m]
    of_vertex i32[V]: the sample that is vertex i, -1 for none;   on_vertex i32[P]: whether a sample is a vertex
    host_ids, host_weights: the same in NumPy
    """

    def __init__(self, state: State, first: Model, spacing: float, capacity: Capacity):
        self.state, self.spacing = state, spacing
        count = sum(len(p.ids) for p in self._points(first))
        inner = sum(len(inner_of(p)) for p in first.bodies)
        self.capacity = round_up_capacity(capacity.sized("samples", count + inner))
        group = self._group = FieldGroup()
        with group.interleaved(self.capacity):
            self.ids, self.weight = group.vector(dtype=ti.i32), group.vector()
            self.body, self.on_vertex = group.scalar(dtype=ti.i32), group.scalar(dtype=ti.i32)
            self.skin = group.scalar()
        self.of_vertex, self.count = group.scalar(state.V, dtype=ti.i32), group.scalar(dtype=ti.i32)
        group.build()
        self._upload = Upload([self.ids, self.weight, self.on_vertex, self.of_vertex, self.body, self.skin, self.count])

    def _points(self, model: Model) -> list[SurfacePoints]:
        return [s.root.once(points_of, root_spacing(s, self.spacing)) for s in model.shapes]

    def check_capacity(self, model: Model) -> None:
        fit("samples", sum(len(p.ids) for p in self._points(model)), self.capacity)

    def triangle_points(self, model: Model) -> int:
        """Number of samples that are not vertices."""
        return sum(int((p.weights[:, 0] != 1.0).sum()) for p in self._points(model))

    def load(self, model: Model) -> None:
        """Take the samples of these bodies; inner vertices of those that collapse too, as far as there is room."""
        points = self._points(model)
        skins = [s.factor * s.root.once(skin_of, root_spacing(s, self.spacing)) for s in model.shapes]
        left = self.capacity - sum(len(p.ids) for p in points)
        for k, part in enumerate(model.bodies):
            inner = inner_of(part)
            if 0 < len(inner) <= left:
                left -= len(inner)
                added = points_at(inner)
                points[k] = SurfacePoints(np.r_[points[k].ids, added.ids], np.r_[points[k].weights, added.weights])
                skins[k] = np.r_[skins[k], np.zeros(len(inner))]
        ids = [p.ids + o for p, o in zip(points, model.vertex_begin, strict=False)]
        self.host_ids, self.host_weights = stacked(ids, 3), stacked([p.weights for p in points], 3)
        on_vertex = self.host_weights[:, 0] == 1.0
        of_vertex = np.full(self.state.V, -1)
        of_vertex[self.host_ids[on_vertex, 0]] = np.flatnonzero(on_vertex)
        body = np.repeat(np.arange(len(points)), [len(p.ids) for p in points])
        self._upload([self.host_ids, self.host_weights, on_vertex, of_vertex, body, stacked(skins), len(body)])

    @ti.func
    def blend(self, p, field: ti.template()):
        """sum_k weight_k field[ids_k] of sample p."""
        ids, b = self.ids[p], self.weight[p]
        return b[0] * field[ids[0]] + b[1] * field[ids[1]] + b[2] * field[ids[2]]

    @ti.func
    def set_vertices(self, p, r, constraints: ti.template()):
        """Make the vertices of sample p the first three of constraint r."""
        for k in ti.static(range(3)):
            constraints.vertex[r, k], constraints.coefficient[r, k] = self.ids[p][k], self.weight[p][k]


@ti.data_oriented
class CapsuleSamples:
    """Points on the axes of thin static capsules, so that nothing thin slips between the samples of a body.

    position vec3, radius f32 [m], friction f32, group i32 = MAX_BODIES + index of the capsule
    Per capsule: low, high vec3 the box of its axis, capsule_radius f32 [m].
    """

    def __init__(self, shapes: list[Shape], spacing: float):
        thin = [s for s in shapes if isinstance(s, Capsule) and s.radius < THIN_RADIUS * spacing][:MAX_CAPSULES]
        samples, low, high = [], np.zeros((MAX_CAPSULES, 3)), np.zeros((MAX_CAPSULES, 3))
        for k, c in enumerate(thin):
            a, b = np.asarray(c.a, np.float64), np.asarray(c.b, np.float64)
            n = int(np.clip(np.ceil(np.linalg.norm(b - a) / (0.5 * spacing)), 1, 256))
            samples += [(*(a + (b - a) * i / n), c.radius, c.friction, MAX_BODIES + k) for i in range(n + 1)]
            low[k], high[k] = np.minimum(a, b), np.maximum(a, b)
        table = np.array(samples).reshape(-1, 6)
        self.size = len(table)
        n, group = round_up_capacity(self.size), FieldGroup()
        self.position, self.radius, self.friction = group.vector(n), group.scalar(n), group.scalar(n)
        self.group = group.scalar(n, dtype=ti.i32)
        self.low, self.high = group.vector(MAX_CAPSULES), group.vector(MAX_CAPSULES)
        self.capsule_radius = group.scalar(MAX_CAPSULES)
        self.count, self.capsule_count = group.scalar(dtype=ti.i32), group.scalar(dtype=ti.i32)
        self._group = group
        group.build()
        fields = [self.position, self.radius, self.friction, self.group, self.low, self.high, self.capsule_radius]
        columns = [table[:, :3], table[:, 3], table[:, 4], table[:, 5], low, high, [c.radius for c in thin]]
        Upload([*fields, self.count, self.capsule_count])([*columns, self.size, len(thin)])


@ti.data_oriented
class QueryPoints:
    """Points of the nearest-tetrahedron query: what may be in a tet, where it is, and which group it belongs to.

    First the samples of bodies, then those of static capsules, and from `first_finger` on those of fingers. Bodies and
    capsules are *groups*, numbered one after the other: first MAX_BODIES for bodies, then up to STATIC_GROUPS for
    static capsules, then finger capsules.

    size: how many there may be;   groups: numbers of groups, used or not
    """

    def __init__(
        self, samples: ContactSamples, capsules: CapsuleSamples, bounds: BodyBounds, fingers: FingerCapsules | None
    ):
        self.state, self.samples, self.capsules, self.bounds = samples.state, samples, capsules, bounds
        self.fingers, self.has_fingers = fingers, fingers is not None
        self.first_finger = samples.capacity + capsules.size
        self.finger_groups = fingers.capsules if self.has_fingers else 0
        self.size = self.first_finger + (fingers.count if self.has_fingers else 0)
        self.groups = STATIC_GROUPS + self.finger_groups

    @ti.func
    def exists(self, p):
        """True if point p is in use."""
        result = p < self.samples.count[None] + self.capsules.count[None]
        if ti.static(self.has_fingers):  # noqa: SIM102
            if self.is_finger(p):
                result = False
                if p - self.first_finger < self.fingers.count:  # a hash has room for a few more points
                    result = self.fingers.radius[p - self.first_finger] > 0.0
        return result

    @ti.func
    def is_finger(self, p):
        """True if point p is a sample of a finger."""
        return p >= self.first_finger if ti.static(self.has_fingers) else False

    @ti.func
    def position(self, p, searching: ti.template()):
        """Position of point p [m] at the start of the substep in progress; in a search, of the next one."""
        n, x = self.samples.count[None], vec3(0.0)
        if self.is_finger(p):
            if ti.static(self.has_fingers):
                x = self.fingers.position(p - self.first_finger, searching)
        elif p < n:
            x = self.samples.blend(p, self.state.x)
        else:
            x = self.capsules.position[p - n]
        return x

    @ti.func
    def spares(self, p, body):
        """True if point p belongs to a hand that passes through this body."""
        result = False
        if ti.static(self.has_fingers):  # noqa: SIM102
            if self.is_finger(p):
                result = self.fingers.spares(p - self.first_finger, body)
        return result

    @ti.func
    def group(self, p):
        """Group of point p."""
        n, g = self.samples.count[None], 0
        if self.is_finger(p):
            if ti.static(self.has_fingers):
                g = STATIC_GROUPS + (p - self.first_finger) // SAMPLES_PER_CAPSULE
        elif p < n:
            g = self.samples.body[p]
        else:
            g = self.capsules.group[p - n]
        return g

    @ti.func
    def group_count(self):
        """Number of groups in use."""
        return self.state.body_count[None] + self.capsules.capsule_count[None] + self.finger_groups

    @ti.func
    def group_at(self, k):
        """The k-th group in use."""
        n, m, g = self.state.body_count[None], self.capsules.capsule_count[None], k
        if k >= n + m:
            g = STATIC_GROUPS + k - n - m
        elif k >= n:
            g = MAX_BODIES + k - n
        return g

    @ti.func
    def is_group(self, g):
        """True if group g is in use."""
        capsules = MAX_BODIES + self.capsules.capsule_count[None]
        return g < self.state.body_count[None] or MAX_BODIES <= g < capsules or g >= STATIC_GROUPS

    @ti.func
    def box(self, g):
        """Boxes of group g's points [m] and velocities [m/s]; a finger's, at rest, holds all that it can touch."""
        low, high, v_min, v_max = vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0)
        if g < MAX_BODIES:
            low, high = self.bounds.low[g], self.bounds.high[g]
            v_min, v_max = self.bounds.v_min[g], self.bounds.v_max[g]
        elif g >= STATIC_GROUPS:
            if ti.static(self.has_fingers):
                low, high = self.fingers.low[g - STATIC_GROUPS], self.fingers.high[g - STATIC_GROUPS]
        else:
            low, high = self.capsules.low[g - MAX_BODIES], self.capsules.high[g - MAX_BODIES]
        return low, high, v_min, v_max

    @ti.func
    def reach(self, g):
        """Distance [m] from its points at which group g touches: a capsule's radius, with a finger's motion."""
        result = 0.0
        if g >= STATIC_GROUPS:
            if ti.static(self.has_fingers):
                result = self.fingers.reach[g - STATIC_GROUPS]
        elif g >= MAX_BODIES:
            result = self.capsules.capsule_radius[g - MAX_BODIES]
        return result
