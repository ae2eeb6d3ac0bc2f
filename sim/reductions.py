"""Reductions over the vertices of each body, on the device, and small readbacks for the host."""

from copy import copy
from functools import cached_property
from itertools import pairwise

import numpy as np
import taichi as ti

from core.fields import FieldGroup, Upload, round_up_capacity
from core.lanes import lane_count, max_lanes, sum_lanes
from core.rotation import best_fit_rotation
from core.vocabulary import BodyState
from sim.model import MAX_BODIES, Model, stacked
from sim.state import State

BLOCK_SIZE = 64  # vertices
FLOAT_MAX = 3.0e38  # larger than any distance, finite in float32
MIN_MOTION = 1e-5  # [m] smaller motions are invisible
# First index of a body's values: centre of mass [m], its velocity [m/s], sum m x (rest - its centre)^T (9), lowest
# and highest coordinates [m] (3 each), 1 if all is finite ...
CENTER, VELOCITY, SHAPE, LOW, HIGH, FINITE = 0, 3, 6, 15, 18, 21
# ... and by `observe`: of the first body, 1 if any vertex moved; of each, state.inverted, asleep and rest_time
ANY_MOVED, INVERTED, ASLEEP, REST_TIME = 22, 23, 24, 25
VALUES = 26


@ti.func
def finite(a) -> ti.i32:
    """Return whether a float32 is neither infinite nor NaN; by its bits, since fast-math assumes that it is."""
    return (ti.bit_cast(a, ti.i32) & 0x7F800000) != 0x7F800000


@ti.data_oriented
class ReductionBlocks:
    """Blocks of at most BLOCK_SIZE vertices of one body, over which `lanes` threads sum: sums so have a fixed order.

    span vec3i[size]: first vertex, end, and body of each block, empty ranges at the end;
    begin i32[B+1]: first block of each body.
    """

    def __init__(self, state: State):
        self.size, self.lanes = round_up_capacity(state.V // BLOCK_SIZE + MAX_BODIES), lane_count()
        g = self._group = FieldGroup()
        self.span = g.vector(self.size, dtype=ti.i32)
        self.begin = g.scalar(MAX_BODIES + 1, dtype=ti.i32)
        g.build()
        self._upload = Upload([self.span, self.begin])

    def load(self, model: Model) -> None:
        """Divide the vertices of these bodies."""
        rows = [
            (begin, min(begin + BLOCK_SIZE, last), b)
            for b, (first, last) in enumerate(pairwise(model.vertex_begin.tolist()))
            for begin in range(first, last, BLOCK_SIZE)
        ]
        table = np.array(rows, np.int64).reshape(-1, 3)
        self._upload([table, np.searchsorted(table[:, 2], np.arange(MAX_BODIES + 1))])

    @ti.func
    def write_sum(self, partial: ti.template(), j, k, value, lane):
        """partial[j, k] = the sum of `value` over all lanes."""
        total = sum_lanes(value, self.lanes)
        if lane == 0:
            partial[j, k] = total

    @ti.func
    def sum_by_lanes(self, partial: ti.template(), b, k, lane, lanes: ti.template()):
        """Sum of column k of the blocks' values `partial` over body b, by so many lanes, in the first of them."""
        total, j = 0.0, self.begin[b] + lane
        while j < self.begin[b + 1]:
            total += partial[j, k]
            j += ti.static(lanes)
        return sum_lanes(total, lanes)

    @ti.func
    def max_by_lanes(self, partial: ti.template(), b, k, sign, lane):
        """Largest of `sign` times column k over body b, by all lanes together, in the first of them."""
        most, j = -FLOAT_MAX, self.begin[b] + lane
        while j < self.begin[b + 1]:
            most = ti.max(most, sign * partial[j, k])
            j += self.lanes
        return max_lanes(most, self.lanes)


class Observation:
    """State of all bodies at one time; the device is waited for when a property is first read.

    Read it before the solver does anything else.
    """

    def __init__(self, reductions: "Reductions", held: list[bool]):
        self._reductions, self._held, self._is_new = reductions, held, True

    @cached_property
    def _total(self) -> np.ndarray:
        return self._reductions.observed()

    @cached_property
    def bodies(self) -> list[BodyState]:
        """The state of each body, in the order they were given."""
        return self._reductions.states(self._total, self._held)

    @property
    def moved(self) -> bool:
        """True if any vertex has moved more than MIN_MOTION since this was last true."""
        return self._is_new and bool(self._total[0, ANY_MOVED])

    def repeated(self) -> "Observation":
        """The same, of a later time until which nothing has changed."""
        again = copy(self)
        again._is_new = False
        return again


@ti.data_oriented
class Reductions:
    """Sums over each body, for `bodies`, `observe` and `pick` of the solver."""

    def __init__(self, state: State, blocks: ReductionBlocks):
        self.state, self.blocks = state, blocks
        g = self._group = FieldGroup()
        self.rest_center = g.vector(MAX_BODIES)  # centre of mass in the body's frame [m]
        self.last = g.vector(state.V)  # positions when `Observation.moved` was last true [m]
        self.partial, self.total = g.scalar(blocks.size, VALUES), g.scalar(MAX_BODIES, VALUES)
        self.any_moved = g.scalar(dtype=ti.i32)
        self.distance, self.hit = g.scalar(), g.scalar(dtype=ti.i32)  # of the last `pick`
        g.build()
        self._upload = Upload([self.rest_center])
        self.forget()

    def load(self, model: Model) -> None:
        """Take other bodies."""
        self.names = [p.body.name for p in model.bodies]
        self.driven = [p.body.pinned is not None for p in model.bodies]
        self.flattest = [s.flattest for s in model.shapes]
        self._upload([stacked([s.center[None] for s in model.shapes], 3)])
        self.forget()

    def bodies(self, held: list[bool]) -> list[BodyState]:
        """The state of each body, in the order they were given."""
        return self.states(self._summed(), held)

    def states(self, total: np.ndarray, held: list[bool]) -> list[BodyState]:
        """States of the bodies, from `total`."""
        total = total[: len(self.names)].astype(np.float64)
        finite = total[:, FINITE] > 0
        rotations = np.broadcast_to(np.eye(3), (len(total), 3, 3)).copy()
        rotations[finite] = best_fit_rotation(total[finite, SHAPE:LOW].reshape(-1, 3, 3))
        rows = zip(self.names, total, rotations, self.flattest, held, self.driven, strict=True)
        return [
            BodyState(name, t[:VELOCITY], t[VELOCITY:SHAPE], t[LOW:HIGH], t[HIGH:FINITE], R @ n, holds, driven)
            for name, t, R, n, holds, driven in rows
        ]

    def _summed(self) -> np.ndarray:
        """Sum up, and wait for `total`."""
        self.sum_up()
        return self.total.to_numpy()

    def observe(self, held: list[bool]) -> "Observation":
        """Launch the sums over all bodies, unless nothing has changed since the last ones."""
        if self._observed is not None:
            return self._observed.repeated()
        self._observe()
        self._observed = Observation(self, held)
        return self._observed

    def observed(self) -> np.ndarray:
        """Wait for the last sums, and return `total`."""
        total = self.total.to_numpy()
        self._flags = total[:, INVERTED:].T
        return total

    def flags(self) -> np.ndarray:
        """`inverted`, `asleep` and `rest_time` of the state, (3, MAX_BODIES); `observe` has looked at them already."""
        if self._flags is None:
            self._flags = np.zeros((3, MAX_BODIES), np.float32)
            self._read_flags(self._flags)
        return self._flags

    def boxes(self) -> np.ndarray:
        """Lowest and highest coordinates of each body [m], (B, 2, 3)."""
        if self._boxes is None:
            self._boxes = self._summed()[: len(self.names), LOW:FINITE].reshape(-1, 2, 3)
        return self._boxes

    def forget(self) -> None:
        """The bodies or their flags have changed: read them from the device when they are wanted next."""
        self._flags = self._observed = self._boxes = None

    def finite(self) -> bool:
        """Return whether every position and velocity is finite."""
        return bool(self._summed()[: len(self.names), FINITE].all())

    @ti.kernel
    def sum_up(self):
        """Fill `total`, (MAX_BODIES, VALUES)."""
        self._sum_up()

    @ti.kernel
    def _observe(self):
        self._find_motion()
        self._sum_up()
        for b in range(MAX_BODIES):
            self.total[b, ANY_MOVED] = self.any_moved[None]
            self.total[b, INVERTED] = self.state.inverted[b]
            self.total[b, ASLEEP], self.total[b, REST_TIME] = self.state.asleep[b], self.state.rest_time[b]

    @ti.kernel
    def _read_flags(self, out: ti.types.ndarray(ti.f32, 2)):
        s = self.state
        for b in range(MAX_BODIES):
            out[0, b], out[1, b], out[2, b] = s.inverted[b], s.asleep[b], s.rest_time[b]

    @ti.func
    def _sum_up(self):
        """Outermost level of a kernel."""
        s = self.state
        c = self.blocks
        for w in range(c.size * c.lanes):
            j, lane = w // c.lanes, w % c.lanes
            span = c.span[j]
            p, q = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
            A = ti.Matrix.zero(ti.f32, 3, 3)
            low, high = ti.Vector([FLOAT_MAX, FLOAT_MAX, FLOAT_MAX]), ti.Vector([-FLOAT_MAX, -FLOAT_MAX, -FLOAT_MAX])
            bad = 0.0
            center = self.rest_center[span[2]]
            i = span[0] + lane
            while i < span[1]:
                m, x, v = s.mass[i], s.x[i], s.v[i]
                p += m * x
                q += m * v
                A += m * x.outer_product(s.rest[i] - center)
                low, high = ti.min(low, x), ti.max(high, x)
                for k in ti.static(range(3)):
                    if not (finite(x[k]) and finite(v[k])):
                        bad = 1.0
                i += c.lanes
            for k in ti.static(range(3)):
                c.write_sum(self.partial, j, CENTER + k, p[k], lane)
                c.write_sum(self.partial, j, VELOCITY + k, q[k], lane)
                low[k], high[k] = -max_lanes(-low[k], c.lanes), max_lanes(high[k], c.lanes)
                for l in ti.static(range(3)):
                    c.write_sum(self.partial, j, SHAPE + 3 * k + l, A[k, l], lane)
            bad = max_lanes(bad, c.lanes)
            if lane == 0:
                for k in ti.static(range(3)):
                    self.partial[j, LOW + k], self.partial[j, HIGH + k] = low[k], high[k]
                self.partial[j, FINITE] = 1.0 - bad
        for w in range(MAX_BODIES * VALUES * c.lanes):
            bk, lane = w // c.lanes, w % c.lanes
            b, k = bk // VALUES, bk % VALUES
            if b < s.body_count[None] and k < ANY_MOVED:
                value = 0.0
                if k < LOW:
                    value = c.sum_by_lanes(self.partial, b, k, lane, c.lanes)
                else:
                    sign = -1.0 if k < HIGH or k == FINITE else 1.0  # the least
                    value = sign * c.max_by_lanes(self.partial, b, k, sign, lane)
                if k < SHAPE:
                    value /= s.body_mass[b]
                if lane == 0:
                    self.total[b, k] = value

    @ti.func
    def _find_motion(self):
        """Outermost level of a kernel."""
        s = self.state
        self.any_moved[None] = 0
        for i in range(s.V):
            if i < s.vertex_count[None] and (s.x[i] - self.last[i]).norm_sqr() > MIN_MOTION * MIN_MOTION:
                self.any_moved[None] = 1  # all writers write the same
        for i in range(s.V):
            if self.any_moved[None] == 1:
                self.last[i] = s.x[i]

    def pick(self, origin, direction) -> tuple[float, int] | None:
        """Distance [m] along the ray to the nearest surface triangle, and its body; None if it misses."""
        d = np.asarray(direction, np.float64)
        self._cast(*map(float, origin), *(d / np.linalg.norm(d)))
        distance = self.distance[None]
        return None if distance >= FLOAT_MAX else (float(distance), int(self.hit[None]))

    @ti.func
    def _distance(self, j, origin, direction):
        """Ray parameter of triangle j, FLOAT_MAX if it is missed (Moeller and Trumbore 1997, both sides)."""
        s = self.state
        a = s.triangles[j]
        e1, e2 = s.x[a[1]] - s.x[a[0]], s.x[a[2]] - s.x[a[0]]
        h = direction.cross(e2)
        det = e1.dot(h)
        result = FLOAT_MAX
        if ti.abs(det) > 1e-20:
            t = origin - s.x[a[0]]
            u = t.dot(h) / det
            g = t.cross(e1)
            v = direction.dot(g) / det
            along = e2.dot(g) / det
            if u >= 0.0 and v >= 0.0 and u + v <= 1.0 and along > 0.0:
                result = along
        return result

    @ti.kernel
    def _cast(self, ox: ti.f32, oy: ti.f32, oz: ti.f32, dx: ti.f32, dy: ti.f32, dz: ti.f32):
        s = self.state
        origin, direction = ti.Vector([ox, oy, oz]), ti.Vector([dx, dy, dz])
        self.distance[None] = FLOAT_MAX
        self.hit[None] = MAX_BODIES
        for j in range(s.S):
            if j < s.triangle_count[None]:
                ti.atomic_min(self.distance[None], self._distance(j, origin, direction))
        for j in range(s.S):
            if j < s.triangle_count[None] and self._distance(j, origin, direction) <= self.distance[None]:
                ti.atomic_min(self.hit[None], s.body_of_triangle[j])
