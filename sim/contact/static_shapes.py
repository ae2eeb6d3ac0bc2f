"""Static shapes on the device: signed distances and normals of planes, capsules, boxes and distance grids."""

from dataclasses import dataclass, replace

import numpy as np
import taichi as ti
from taichi.math import vec3

from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.fields import FieldGroup
from core.rotation import matrices_from_quaternions, quaternions_from_matrices
from core.vocabulary import IDENTITY, Box, Capsule, Plane, Quat, Vec3
from sim.contact.broad_phase import outside_box
from sim.contact.signed_distance import UNKNOWN_DISTANCE, DistanceGrids, known

PLANE, CAPSULE, BOX, GRID = range(4)
MAX_SHAPES = 128
MAX_DEPTH = 4.0  # [voxels] under the surface of a scanned grid that still push; deeper, the scan knows nothing


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
        """Put the shapes, the same ones as at first, where these are."""
        gridded = 0
        for k, shape in enumerate(shapes):
            self._put(k, shape, gridded)
            gridded += isinstance(shape, StaticGrid)

    def _put(self, k: int, shape: Shape, grid: int) -> None:
        low, high = (-UNKNOWN_DISTANCE,) * 3, (UNKNOWN_DISTANCE,) * 3
        if isinstance(shape, Plane):
            kind, a, b = PLANE, shape.point, np.asarray(shape.normal) / np.linalg.norm(shape.normal)
        elif isinstance(shape, Capsule):
            kind, a, b = CAPSULE, shape.a, shape.b
            self.radius[k] = float(shape.radius)
            low, high = np.minimum(a, b) - shape.radius, np.maximum(a, b) + shape.radius
        elif isinstance(shape, Box):
            kind, a, b = BOX, shape.center, shape.half_size
            low, high = np.subtract(a, b), np.add(a, b)
        elif isinstance(shape, StaticGrid):
            kind, a, b = GRID, shape.position, (0, 0, 0)
            self.grid[k], self.scale[k] = grid, float(shape.scale)
            R = matrices_from_quaternions(np.asarray(shape.rotation, np.float64)[None])[0]
            self.frame[k] = R.T.tolist()
            low, high = grid_box(shape, R)
        else:
            raise TypeError(f"not a static shape: {shape!r}")
        self.kind[k], self.friction[k] = kind, float(shape.friction)
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
            normal = r / length if length > 1e-9 else any_normal(axis)
        elif kind == BOX:
            phi, normal = box_distance(p - a, b)
        else:
            phi, normal = self._grid_distance(k, p)
        return phi, normal

    @ti.func
    def _to_grid(self, k, p):
        return self.frame[k] @ (p - self.a[k]) / self.scale[k]

    @ti.func
    def _grid_distance(self, k, p):
        g = self.grid[k]
        phi, gradient = self.grids.sample(g, self._to_grid(k, p))
        length = gradient.norm()
        normal = vec3(0.0)
        if phi > -MAX_DEPTH * self.grids.spacing[g] and length > 0.0:
            phi *= self.scale[k]
            normal = self.frame[k].transpose() @ gradient / length
        else:
            phi = UNKNOWN_DISTANCE
        return phi, normal


def placed(shape: Shape, pose: np.ndarray) -> Shape:
    """The shape at a rigid transform (4, 4) of where it is. Raises BadInput for a box: its sides are along the axes."""
    R = pose[:3, :3]

    def at(point) -> Vec3:
        return tuple((R @ np.asarray(point, np.float64) + pose[:3, 3]).tolist())

    match shape:
        case StaticGrid():
            q = quaternions_from_matrices(R @ matrices_from_quaternions(np.asarray(shape.rotation, np.float64)))
            return replace(shape, rotation=tuple(q.tolist()), position=at(shape.position))
        case Plane():
            return replace(shape, point=at(shape.point), normal=tuple((R @ np.asarray(shape.normal)).tolist()))
        case Capsule():
            return replace(shape, a=at(shape.a), b=at(shape.b))
    if np.abs(R - np.eye(3)).max() > 1e-9:
        raise BadInput("a room with a box for a collider cannot be turned")
    return replace(shape, center=at(shape.center))


def grid_box(shape: StaticGrid, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World bounding box of the grid's own box."""
    origin = np.asarray(shape.grid.origin, np.float64)
    ends = np.stack(np.meshgrid(*zip(origin, shape.grid.upper, strict=True), indexing="ij"), -1).reshape(-1, 3)
    world = shape.scale * ends @ R.T + np.asarray(shape.position)
    return world.min(0), world.max(0)


@ti.func
def any_normal(axis):
    """A unit vector perpendicular to axis: the normal on a capsule's own axis, where any will do."""
    n = axis.cross(ti.Vector([1.0, 0.0, 0.0]))
    if axis.y**2 + axis.z**2 < axis.x**2:
        n = axis.cross(ti.Vector([0.0, 1.0, 0.0]))
    return n.normalized() if n.norm_sqr() > 1e-18 else ti.Vector([0.0, 1.0, 0.0])


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
