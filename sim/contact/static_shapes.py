"""Signed distances: grids on the device; planes, capsules, boxes and grids that stand still; and lines of sight."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
import taichi as ti
from scipy.ndimage import distance_transform_edt
from taichi.math import vec3

from core.distance_grid import DistanceGrid, same_grid
from core.errors import BadInput
from core.fields import FieldGroup, Upload, round_up_capacity
from core.rotation import matrices_from_quaternions, quaternions_from_matrices
from core.vocabulary import IDENTITY, Box, Capsule, Plane, Quat, Vec3
from sim.contact.broad_phase import outside_box
from sim.model import Capacity, RestShape, fit

PLANE, CAPSULE, BOX, GRID = range(4)
MAX_SHAPES = 128
MAX_DEPTH = 4.0  # [voxels] under the surface of a scanned grid that still push; deeper, the scan knows nothing
UNKNOWN_DISTANCE = 1e3  # [m], the distance where a grid says nothing
MAX_GRIDS = 128  # per-grid fields are tiny; one size for all scenes keeps compiled kernels in the cache
# [nodes] around the surface with exact distances, and of the grid around the cage's box: skins are up to two nodes
# thick, and a gradient there asks for the corners of its cell, another 1.7 away. Elsewhere sign and trend matter only.
EXACT_BAND = 4
UNREACHED = 1e9  # [nodes] where no triangle is near
STEP, MAX_STEPS = 0.005, 300  # [m] between the points of a line that are looked at; longer lines have longer steps
TOLERANCE, GRID_TOLERANCE = 0.004, 0.35  # [m] and [voxels] under a surface that hide nothing: shapes are not exact
MAX_FALL = 2.0  # [m] below a point in which its ground is looked for
GROUND_RADIUS, GROUND_ANGLES = 0.25, np.arange(9) * (2 * np.pi / 9)  # [m], [rad] of the places around it


@ti.func
def known(phi):
    """True if phi [m] is a distance, not UNKNOWN_DISTANCE."""
    return phi < 0.5 * UNKNOWN_DISTANCE


@ti.data_oriented
class DistanceGrids:
    """Distance grids, each in its own frame, concatenated.

    values   f32[N]   signed distances [m], grid after grid, last axis fastest
    begin    i32[G]   where a grid's values begin
    dims     vec3i[G] nodes per axis;   origin vec3[G] [m];   spacing f32[G] [m]
    """

    def __init__(self, first: list[DistanceGrid], capacity: Capacity = Capacity()):
        self.size = round_up_capacity(capacity.sized("nodes", sum(g.values.size for g in distinct(first))))
        group = self._group = FieldGroup()
        self.values = group.scalar(self.size)
        self.begin, self.spacing = group.scalar(MAX_GRIDS, dtype=ti.i32), group.scalar(MAX_GRIDS)
        self.dims, self.origin = group.vector(MAX_GRIDS, dtype=ti.i32), group.vector(MAX_GRIDS)
        group.build()
        self._upload = Upload([self.begin, self.spacing, self.dims, self.origin])
        self.stored: list[tuple[int, DistanceGrid]] = []  # where values begin, in order

    def check_capacity(self, grids: list[DistanceGrid]) -> None:
        fit("grid nodes", sum(g.values.size for g in distinct(grids)), self.size)

    def load(self, grids: list[DistanceGrid]) -> None:
        """Take these grids; values already on the device are not copied again."""
        wanted = distinct(grids)
        kept = [(at, g) for at, g in self.stored if any(g is w for w in wanted)]
        new = [w for w in wanted if not any(g is w for _, g in kept)]
        at = max((at + g.values.size for at, g in kept), default=0)
        if at + sum(g.values.size for g in new) > self.size:  # close the gaps that other grids left
            at, kept, new = 0, [], wanted
        for grid in new:
            self._copy(np.ascontiguousarray(grid.values, np.float32).reshape(-1), at)
            kept.append((at, grid))
            at += grid.values.size
        self.stored = kept
        begins = [next(at for at, w in kept if same_grid(w, g)) for g in grids]
        spacings, origins = [float(g.spacing) for g in grids], [np.asarray(g.origin, np.float64) for g in grids]
        self._upload([begins, spacings, [g.values.shape for g in grids], origins])

    @ti.kernel
    def _copy(self, values: ti.types.ndarray(ti.f32, 1), first: ti.i32):
        for i in range(values.shape[0]):
            self.values[first + i] = values[i]

    @ti.func
    def box_distance(self, k, p):
        """Distance [m] from p (grid frame) to the box that grid k fills; 0 inside."""
        high = self.origin[k] + self.spacing[k] * ti.cast(self.dims[k] - 1, ti.f32)
        return ti.max(self.origin[k] - p, p - high, vec3(0.0)).norm()

    @ti.func
    def sample(self, k, p):
        """Trilinear distance [m] and its gradient (not normalised) of grid k at p (grid frame).

        phi = sum over the cell's corners of prod_a (1 - f_a or f_a) phi_corner; outside the grid UNKNOWN_DISTANCE, 0.
        """
        phi, gradient = UNKNOWN_DISTANCE, vec3(0.0)
        q = (p - self.origin[k]) / self.spacing[k]
        n = self.dims[k]
        if q.min() >= 0.0 and (ti.cast(n - 1, ti.f32) - q).min() >= 0.0:
            i = ti.min(ti.cast(q, ti.i32), n - 2)
            f = q - ti.cast(i, ti.f32)
            at = self.begin[k] + (i[0] * n[1] + i[1]) * n[2] + i[2]
            dx, dy = n[1] * n[2], n[2]
            c = ti.static(self.values)
            # along z, then y, then x; d.. are differences along the axis that was blended
            c00, d00 = ti.math.mix(c[at], c[at + 1], f[2]), c[at + 1] - c[at]
            c01, d01 = ti.math.mix(c[at + dy], c[at + dy + 1], f[2]), c[at + dy + 1] - c[at + dy]
            c10, d10 = ti.math.mix(c[at + dx], c[at + dx + 1], f[2]), c[at + dx + 1] - c[at + dx]
            c11, d11 = ti.math.mix(c[at + dx + dy], c[at + dx + dy + 1], f[2]), c[at + dx + dy + 1] - c[at + dx + dy]
            c0, c1 = ti.math.mix(c00, c01, f[1]), ti.math.mix(c10, c11, f[1])
            phi = ti.math.mix(c0, c1, f[0])
            gz = ti.math.mix(ti.math.mix(d00, d01, f[1]), ti.math.mix(d10, d11, f[1]), f[0])
            gradient = ti.Vector([c1 - c0, ti.math.mix(c01 - c00, c11 - c10, f[0]), gz]) / self.spacing[k]
        return phi, gradient

    @ti.func
    def extrapolated(self, k, p):
        """Distance and gradient as of `sample`, continued beyond the grid; and how far [m] p is outside.

        With e the nearest point of the grid, e - phi grad phi is on the surface: phi is the distance from p to there.
        """
        low = self.origin[k]
        high = low + self.spacing[k] * ti.cast(self.dims[k] - 1, ti.f32)
        inset = vec3(1e-3 * self.spacing[k])  # rounding must not put it outside again
        edge = ti.min(ti.max(p, low + inset), high - inset)
        phi, gradient = self.sample(k, edge)
        beyond = self.box_distance(k, p)
        if known(phi) and beyond > 0.0:
            total = p - edge + ti.max(phi, 0.0) * gradient / ti.max(gradient.norm(), 1e-9)
            phi = total.norm()
            gradient = total / ti.max(phi, 1e-9)
        return phi, gradient, beyond


def distinct(grids: list[DistanceGrid]) -> list[DistanceGrid]:
    """The grids without repetitions."""
    kept: list[DistanceGrid] = []
    for grid in grids:
        if not any(same_grid(grid, k) for k in kept):
            kept.append(grid)
    return kept


def rest_grid(vertices: np.ndarray, tets: np.ndarray, surface: np.ndarray, *, nodes: int = 48) -> DistanceGrid:
    """Distance grid [m], negative inside, of a cage (V, 3), (T, 4), (S, 3): about `nodes` nodes along its longest side.

    Exact within EXACT_BAND nodes of the surface; beyond, the distance to the nearest such node is added.
    """
    x = np.asarray(vertices, np.float32)
    spacing = float(np.ptp(x, axis=0).max()) / nodes
    origin = x.min(0).astype(np.float64) - EXACT_BAND * spacing
    dims = np.ceil((x.max(0) - origin) / spacing).astype(int) + EXACT_BAND + 1
    local = ((x - origin) / spacing).astype(np.float32)  # in nodes
    values, inside = np.full(dims, UNREACHED, np.float32), np.zeros(dims, np.int32)
    _surface_distances(values, np.ascontiguousarray(local[np.asarray(surface)]))
    _mark_inside(inside, np.ascontiguousarray(local[np.asarray(tets)]))
    far, nearest = distance_transform_edt(values > EXACT_BAND, return_indices=True)
    phi = np.where(values <= EXACT_BAND, values, far + values[tuple(nearest)])
    return DistanceGrid((spacing * np.where(inside > 0, -phi, phi)).astype(np.float32), origin, spacing)


@ti.func
def node_range(low, high, padding, values: ti.template()):
    """First and one past the last node of the box low - padding .. high + padding."""
    shape = ti.Vector([values.shape[0], values.shape[1], values.shape[2]])
    first = ti.max(ti.ceil(low - padding, ti.i32), 0)
    last = ti.min(ti.floor(high + padding, ti.i32) + 1, shape)
    return first, last


@ti.kernel
def _surface_distances(values: ti.types.ndarray(ti.f32, 3), corners: ti.types.ndarray(ti.f32, 3)):
    """values = min over triangles of the distance to them, in nodes, where that is below EXACT_BAND."""
    for t in range(corners.shape[0]):
        c = ti.Matrix([[corners[t, row, axis] for axis in range(3)] for row in range(3)])
        a, b, d = c[0, :], c[1, :], c[2, :]
        first, last = node_range(ti.min(a, b, d), ti.max(a, b, d), EXACT_BAND, values)
        for i, j, k in ti.ndrange((first[0], last[0]), (first[1], last[1]), (first[2], last[2])):
            p = ti.Vector([i, j, k], ti.f32)
            ti.atomic_min(values[i, j, k], ti.sqrt(triangle_distance_squared(a - p, b - p, d - p)))


@ti.kernel
def _mark_inside(inside: ti.types.ndarray(ti.i32, 3), corners: ti.types.ndarray(ti.f32, 3)):
    """inside = 1 at nodes that some tet holds."""
    for t in range(corners.shape[0]):
        c = ti.Matrix([[corners[t, row, axis] for axis in range(3)] for row in range(4)])
        x0, x1, x2, x3 = c[0, :], c[1, :], c[2, :], c[3, :]
        inverse = ti.Matrix.cols([x1 - x0, x2 - x0, x3 - x0]).inverse()
        first, last = node_range(ti.min(x0, x1, x2, x3), ti.max(x0, x1, x2, x3), 0.0, inside)
        for i, j, k in ti.ndrange((first[0], last[0]), (first[1], last[1]), (first[2], last[2])):
            b = inverse @ (ti.Vector([i, j, k], ti.f32) - x0)
            if b.min() >= -1e-5 and b.sum() <= 1.00001:
                inside[i, j, k] = 1


@ti.func
def segment_distance_squared(a, b):
    """Squared distance from the origin to segment ab."""
    e = b - a
    return (a + e * ti.math.clamp(-a.dot(e) / ti.max(e.norm_sqr(), 1e-20), 0.0, 1.0)).norm_sqr()


@ti.func
def triangle_distance_squared(a, b, c):
    """Squared distance from the origin to the triangle a, b, c."""
    n = (b - a).cross(c - a)
    nearest = ti.min(segment_distance_squared(a, b), segment_distance_squared(b, c), segment_distance_squared(c, a))
    within = n.dot(a.cross(b)) >= 0.0 and n.dot(b.cross(c)) >= 0.0 and n.dot(c.cross(a)) >= 0.0
    if within and n.norm_sqr() > 1e-20:
        nearest = ti.min(nearest, n.dot(a) ** 2 / n.norm_sqr())
    return nearest


def grid_of(shape: RestShape) -> DistanceGrid:
    """Distance grid of a rest shape: the body's own, or one made from its mesh; an empty grid for a box."""
    if shape.boxed:
        return DistanceGrid(np.full((2, 2, 2), UNKNOWN_DISTANCE, np.float32), np.zeros(3), 1e-3)
    if shape.sdf is not None:
        return shape.sdf
    if shape.root is not shape:
        return shape.root.once(grid_of).scaled(shape.factor)
    return rest_grid(shape.vertices, shape.solid, shape.surface)


@dataclass(frozen=True)
class StaticGrid:
    """Static shape given by a distance grid: x_world = scale * R(rotation) x_grid + position."""

    grid: DistanceGrid
    rotation: Quat = IDENTITY
    position: Vec3 = (0.0, 0.0, 0.0)
    scale: float = 1.0
    friction: float = 0.5


Shape = Plane | Capsule | Box | StaticGrid


@ti.data_oriented
class StaticShapes:
    """All static shapes in flat fields, one element each.

    kind i32, a vec3, b vec3, radius f32, friction f32, frame mat3 (grid from world, without scale), scale f32,
    grid i32, low, high vec3: the world box outside of which a shape is farther than zero.
    Plane: a = point, b = normal. Capsule: a, b = ends. Box: a = center, b = half size. Grid: a = position.
    """

    def __init__(self, shapes: list[Shape]):
        if len(shapes) > MAX_SHAPES:
            raise BadInput(f"{len(shapes)} static shapes, the limit is {MAX_SHAPES}")
        grids = [s.grid for s in shapes if isinstance(s, StaticGrid)]
        self.grids = DistanceGrids(grids)
        self.grids.load(grids)
        group = self._group = FieldGroup()
        self.kind, self.grid = (group.scalar(MAX_SHAPES, dtype=ti.i32) for _ in range(2))
        self.radius, self.friction, self.scale = (group.scalar(MAX_SHAPES) for _ in range(3))
        self.a, self.b, self.low, self.high = (group.vector(MAX_SHAPES) for _ in range(4))
        self.frame, self.count = group.matrix(MAX_SHAPES), group.scalar(dtype=ti.i32)
        group.build()
        self.count[None] = len(shapes)
        self.place(shapes)

    def place(self, shapes: list[Shape]) -> None:
        """Move the shapes: these are the same ones as at first, in other places."""
        grids = count()
        for k, shape in enumerate(shapes):
            match shape:
                case Plane():
                    kind, a, b = PLANE, shape.point, np.asarray(shape.normal) / np.linalg.norm(shape.normal)
                case Capsule():
                    kind, a, b = CAPSULE, shape.a, shape.b
                    self.radius[k] = float(shape.radius)
                case Box():
                    kind, a, b = BOX, shape.center, shape.half_size
                case StaticGrid():
                    kind, a, b = GRID, shape.position, (0, 0, 0)
                    self.grid[k], self.scale[k] = next(grids), float(shape.scale)
                    self.frame[k] = matrices_from_quaternions(shape.rotation).T.tolist()
            self.kind[k], self.friction[k] = kind, float(shape.friction)
            low, high = bounding_box(shape)
            for field, value in ((self.a, a), (self.b, b), (self.low, low), (self.high, high)):
                field[k] = [float(c) for c in value]

    @ti.func
    def distance_within(self, k, p, margin):
        """Distance [m] from p to shape k, or to its grid's box from outside; UNKNOWN_DISTANCE unless below margin."""
        phi = UNKNOWN_DISTANCE
        if outside_box(self.low[k], self.high[k], p) < margin:
            phi, _ = self.distance(k, p)
            if self.kind[k] == GRID and not known(phi):
                outside = self.grids.box_distance(self.grid[k], self._to_grid(k, p)) * self.scale[k]
                phi = outside if outside > 0.0 else phi
        return phi if phi < margin else UNKNOWN_DISTANCE

    @ti.func
    def distance(self, k, p):
        """Signed distance [m] from p to shape k and outward unit normal; UNKNOWN_DISTANCE, 0 where a grid has none."""
        phi, normal = UNKNOWN_DISTANCE, vec3(0.0)
        kind, a, b = self.kind[k], self.a[k], self.b[k]
        if kind == PLANE:
            normal = b
            phi = b.dot(p - a)
        elif kind == CAPSULE:
            axis = b - a
            r = p - a - axis * ti.math.clamp((p - a).dot(axis) / ti.max(axis.norm_sqr(), 1e-12), 0.0, 1.0)
            length = r.norm()
            phi = length - self.radius[k]
            normal, _tangent = tangents(axis / ti.max(axis.norm(), 1e-9))  # on the axis, where any will do
            if length > 1e-9:
                normal = r / length
        elif kind == BOX:
            phi, normal = box_distance(p - a, b)
        else:
            g = self.grid[k]
            value, gradient = self.grids.sample(g, self._to_grid(k, p))
            length = gradient.norm()
            if value > -MAX_DEPTH * self.grids.spacing[g] and length > 0.0:
                phi = self.scale[k] * value
                normal = self.frame[k].transpose() @ gradient / length
        return phi, normal

    @ti.func
    def _to_grid(self, k, p):
        return self.frame[k] @ (p - self.a[k]) / self.scale[k]


def placed(shape: Shape, pose: np.ndarray) -> Shape:
    """The shape moved by a rigid transform (4, 4). Raises BadInput if a box is turned: its sides follow the axes."""
    R = pose[:3, :3]

    def at(point) -> Vec3:
        return tuple((R @ np.asarray(point, np.float64) + pose[:3, 3]).tolist())

    match shape:
        case StaticGrid():
            q = quaternions_from_matrices(R @ matrices_from_quaternions(shape.rotation))
            return replace(shape, rotation=tuple(q.tolist()), position=at(shape.position))
        case Plane():
            return replace(shape, point=at(shape.point), normal=tuple((R @ np.asarray(shape.normal)).tolist()))
        case Capsule():
            return replace(shape, a=at(shape.a), b=at(shape.b))
    if np.abs(R - np.eye(3)).max() > 1e-9:
        raise BadInput("a room with a box for a collider cannot be turned")
    return replace(shape, center=at(shape.center))


def bounding_box(shape: Shape) -> tuple[np.ndarray, np.ndarray]:
    """Corners of a shape's bounding box [m], for a grid that of its nodes; +-UNKNOWN_DISTANCE for a plane."""
    if isinstance(shape, Plane):
        return np.full(3, -UNKNOWN_DISTANCE), np.full(3, UNKNOWN_DISTANCE)
    if isinstance(shape, Capsule):
        return np.minimum(shape.a, shape.b) - shape.radius, np.maximum(shape.a, shape.b) + shape.radius
    if isinstance(shape, Box):
        return np.subtract(shape.center, shape.half_size), np.add(shape.center, shape.half_size)
    origin = np.asarray(shape.grid.origin, np.float64)
    ends = np.stack(np.meshgrid(*zip(origin, shape.grid.upper, strict=True), indexing="ij"), -1).reshape(-1, 3)
    world = shape.scale * ends @ matrices_from_quaternions(shape.rotation).T + np.asarray(shape.position)
    return world.min(0), world.max(0)


@ti.func
def tangents(n):
    """Two unit vectors that are perpendicular to a unit vector n and to each other (Duff et al. 2017)."""
    sign = 1.0 if n.z >= 0.0 else -1.0
    a = -1.0 / (sign + n.z)
    b = n.x * n.y * a
    return vec3(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x), vec3(b, sign + n.y * n.y * a, -n.y)


@ti.func
def box_distance(p, half):
    """Signed distance and normal of the box |p| <= half; inside, those of the nearest face."""
    q = abs(p) - half
    side = ti.select(p >= 0.0, vec3(1.0), vec3(-1.0))
    phi, normal = q.max(), vec3(0.0)
    if phi > 0.0:
        out = ti.max(q, 0.0)
        phi = out.norm()
        normal = side * out / phi
    elif q.x >= q.y and q.x >= q.z:
        normal[0] = side[0]
    elif q.y >= q.z:
        normal[1] = side[1]
    else:
        normal[2] = side[2]
    return phi, normal


class LineOfSight:
    """Lines of sight among static shapes, and the height of what lies below a point (on the host)."""

    def __init__(self, shapes: Sequence[Shape]):
        self.shapes = list(shapes)
        self._low, self._high = np.array([bounding_box(s) for s in shapes]).reshape(-1, 2, 3).swapaxes(0, 1)

    def hides(self, origin, direction, distance: float) -> bool:
        """True if an obstacle lies between an eye and a point at `distance` [m] along a ray.

        A shape that the eye itself is inside does not count.
        """
        origin, direction = np.asarray(origin, np.float64), np.asarray(direction, np.float64)
        points = line(origin, origin + distance * direction / np.linalg.norm(direction))
        inside = self._inside(points)
        return bool(not inside.all() and inside[np.argmin(inside) :].any())

    def ground(self, point) -> float | None:
        """Height [m] of what lies below a point, table or floor; None if nothing is near.

        The median of places around it, so that an object that stands there is not taken for ground.
        """
        x, y, z = np.asarray(point, np.float64)
        around = [(x + GROUND_RADIUS * np.cos(a), y, z + GROUND_RADIUS * np.sin(a)) for a in GROUND_ANGLES]
        lines = np.stack([line(np.array(p), np.subtract(p, [0.0, MAX_FALL, 0.0])) for p in around])
        inside = self._inside(lines.reshape(-1, 3)).reshape(lines.shape[:2])
        hit = inside.any(1) & ~inside[:, 0]
        heights = lines[0, np.argmax(inside[hit], axis=1), 1]
        return float(np.median(heights)) if len(heights) else None

    def _inside(self, points: np.ndarray) -> np.ndarray:
        """Mask of the points (N, 3) that are under a surface by more than the tolerance, (N,) bool."""
        low, high = points.min(0), points.max(0)
        inside = np.zeros(len(points), bool)
        for k in np.flatnonzero(((self._low <= high) & (self._high >= low)).all(1)):
            inside |= within(self.shapes[k], points)
        return inside


def line(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Points (N, 3) from start to end."""
    count = min(int(np.linalg.norm(end - start) / STEP) + 2, MAX_STEPS)
    return start + np.linspace(0.0, 1.0, count)[:, None] * (end - start)


def within(shape: Shape, points: np.ndarray) -> np.ndarray:
    """Mask of the points (N, 3) under the surface of a shape by more than its tolerance, (N,) bool."""
    if isinstance(shape, Plane):
        normal = np.asarray(shape.normal, np.float64)
        return (points - shape.point) @ (normal / np.linalg.norm(normal)) < -TOLERANCE
    if isinstance(shape, Capsule):
        axis = np.subtract(shape.b, shape.a)
        along = np.clip((points - shape.a) @ axis / max(axis @ axis, 1e-12), 0.0, 1.0)
        return np.linalg.norm(points - shape.a - along[:, None] * axis, axis=1) < shape.radius - TOLERANCE
    if isinstance(shape, Box):
        return (np.abs(points - shape.center) < np.asarray(shape.half_size) - TOLERANCE).all(1)
    local = (points - shape.position) @ matrices_from_quaternions(shape.rotation) / shape.scale
    grid, result = shape.grid, np.zeros(len(points), bool)
    known = ((local >= grid.origin) & (local <= grid.upper)).all(1)
    tolerance = max(TOLERANCE / shape.scale, GRID_TOLERANCE * grid.spacing)
    result[known] = interpolate(grid, local[known]) < -tolerance
    return result


def interpolate(grid, points: np.ndarray) -> np.ndarray:
    """Trilinear distance [m] at points (N, 3) within a grid; unlike its `sample` it converts no other cells."""
    cells = (points - grid.origin) / grid.spacing
    first = np.minimum(cells.astype(np.int64), np.array(grid.shape) - 2)
    f = cells - first
    total = np.zeros(len(points))
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(corner, f, 1.0 - f), axis=1)
        total += weight * grid.values[tuple((first + corner).T)]
    return total
