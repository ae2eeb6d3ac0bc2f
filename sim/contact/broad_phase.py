"""Broad phase: bounding boxes of the bodies' positions and velocities, and a spatial hash of points, on the device."""

from typing import TYPE_CHECKING

import numpy as np
import taichi as ti
from taichi.math import vec3

from core.fields import FieldGroup, round_up_capacity
from core.lanes import max_lanes
from sim.model import MAX_BODIES

if TYPE_CHECKING:
    from sim.state import State

# [m] added to the motion that is expected: what that estimate lacks, such as a push out of the floor or through several
# bodies. With half as much, a cube that is pushed out of the floor enters one that floats 1.5 mm above it by 3 mm in a
# frame. It also keeps the time until the next look finite: what rests without gravity is expected not to move at all.
CONTACT_MARGIN = 0.002
FLOAT_MAX = 3.0e38  # larger than any coordinate, finite in float32
MAX_QUERY_CELLS = 24  # of the hash along each axis; a box that large has exploded, and would take hours


@ti.func
def outside_box(low, high, x):
    """Distance [m] of x outside of a box along the axis where that is most; negative inside."""
    return ti.max(low - x, x - high).max()


@ti.func
def gap_of_boxes(low, high, other_low, other_high):
    """Gap [m] between two boxes along the axis where it is largest; negative where they overlap."""
    return ti.max(low - other_high, other_low - high).max()


@ti.data_oriented
class BodyBounds:
    """Per body: box of positions low, high vec3[B] [m], and of velocities v_min, v_max vec3[B] [m/s].

    speed f32[B] [m/s]: upper bound of the speed of its vertices
    speed_gain f32[B] [m/s]: what may come on top until the next search, see sim/contact/swept_bounds.py
    max_speed f32[B] [m/s]: the speed that no vertex is expected to exceed, on average, until the next search.
    """

    def __init__(self, state: "State", blocks):
        self.state, self.blocks = state, blocks
        group = self._group = FieldGroup()
        self.partial = group.vector(blocks.size, 4)
        with group.interleaved(MAX_BODIES):
            self.low, self.high, self.v_min, self.v_max = (group.vector() for _ in range(4))
        self.max_speed, self.speed, self.speed_gain = (group.scalar(MAX_BODIES) for _ in range(3))
        group.build()

    @ti.func
    def update(self):
        """Bounds of positions and velocities as they are now. Outermost level of a kernel."""
        s = self.state
        c = self.blocks
        for w in range(c.size * c.lanes):
            j, lane = w // c.lanes, w % c.lanes
            span = c.span[j]
            low, high = vec3(FLOAT_MAX), vec3(-FLOAT_MAX)
            v_min, v_max = low, high
            i = span[0] + lane
            while i < span[1]:
                low, high = ti.min(low, s.x[i]), ti.max(high, s.x[i])
                v_min, v_max = ti.min(v_min, s.v[i]), ti.max(v_max, s.v[i])
                i += c.lanes
            low, high, v_min, v_max = self._combined(low, high, v_min, v_max)
            if lane == 0:
                self.partial[j, 0], self.partial[j, 1], self.partial[j, 2], self.partial[j, 3] = low, high, v_min, v_max
        for w in range(MAX_BODIES * c.lanes):
            b, lane = w // c.lanes, w % c.lanes
            if b < s.body_count[None]:
                low, high = vec3(FLOAT_MAX), vec3(-FLOAT_MAX)
                v_min, v_max = low, high
                j = c.begin[b] + lane
                while j < c.begin[b + 1]:
                    low, high = ti.min(low, self.partial[j, 0]), ti.max(high, self.partial[j, 1])
                    v_min, v_max = ti.min(v_min, self.partial[j, 2]), ti.max(v_max, self.partial[j, 3])
                    j += c.lanes
                low, high, v_min, v_max = self._combined(low, high, v_min, v_max)
                if lane == 0:
                    self.low[b], self.high[b], self.v_min[b], self.v_max[b] = low, high, v_min, v_max
                    self.speed[b] = ti.max(abs(v_min), abs(v_max)).norm()
                    self.widen(b, 0.0)

    @ti.func
    def _combined(self, low, high, v_min, v_max):
        """The bounds of all lanes together, in the first of them."""
        lanes = ti.static(self.blocks.lanes)
        for k in ti.static(range(3)):
            low[k], high[k] = -max_lanes(-low[k], lanes), max_lanes(high[k], lanes)
            v_min[k], v_max[k] = -max_lanes(-v_min[k], lanes), max_lanes(v_max[k], lanes)
        return low, high, v_min, v_max

    @ti.func
    def widen(self, b, gain):
        """Expect body b to gain this much speed [m/s], in any direction."""
        self.v_min[b] -= gain
        self.v_max[b] += gain
        self.speed_gain[b] = gain
        self.max_speed[b] = self.speed[b] + gain + CONTACT_MARGIN / self.state.detect_dt[None]


@ti.data_oriented
class PointHash:
    """Spatial hash of points (Teschner et al. 2003): `count`, then `allocate`, then `insert`, then query.

    cell f32 is a cell's size [m]; entry i32[N] the points and position vec3[N] where they are, cell after cell; begin,
    size i32[] the range of each bucket.

    An atomic counter decides where a cell's points lie: it differs from run to run, but what a query finds does not.
    """

    def __init__(self, points: int):
        self.points, self.buckets = round_up_capacity(points), 1 << max(8, int(np.ceil(np.log2(2 * points + 1))))
        group = self._group = FieldGroup()
        with group.interleaved(self.points):
            self.bucket, self.rank = group.scalar(dtype=ti.i32), group.scalar(dtype=ti.i32)
        with group.interleaved(self.points):
            self.entry, self.position = group.scalar(dtype=ti.i32), group.vector()
        with group.interleaved(self.buckets):
            self.size, self.begin = group.scalar(dtype=ti.i32), group.scalar(dtype=ti.i32)
        self.total, self.cell = group.scalar(dtype=ti.i32), group.scalar()
        group.build()

    @ti.func
    def cell_of(self, p):
        return ti.floor(p / self.cell[None], ti.i32)

    @ti.func
    def bucket_of(self, c):
        return (c[0] * 73856093 ^ c[1] * 19349663 ^ c[2] * 83492791) & (self.buckets - 1)

    @ti.func
    def clear(self, bucket):
        self.size[bucket] = 0

    @ti.func
    def count(self, k, p):
        """Count point k at p in its bucket."""
        bucket = self.bucket_of(self.cell_of(p))
        self.bucket[k] = bucket
        self.rank[k] = ti.atomic_add(self.size[bucket], 1)

    @ti.func
    def allocate(self, bucket):
        """Give a bucket its range of entries; `total` must be 0 before the first."""
        if self.size[bucket] > 0:
            self.begin[bucket] = ti.atomic_add(self.total[None], self.size[bucket])

    @ti.func
    def insert(self, k, p):
        """Put point k at p into its bucket's range; returns its entry."""
        e = self.begin[self.bucket[k]] + self.rank[k]
        self.entry[e], self.position[e] = k, p
        return e

    @ti.func
    def cell_range(self, low, high):
        """First cell of a box and one past its last, at most MAX_QUERY_CELLS along each axis."""
        first = self.cell_of(low)
        return first, ti.min(self.cell_of(high) + 1, first + MAX_QUERY_CELLS)
