"""Broad phase: boxes around the bodies and their velocities, and a hash of points in space, on the device."""

import numpy as np
import taichi as ti

from core.fields import round_up_capacity
from sim.model import MAX_BODIES
from sim.reductions import ReductionBlocks
from sim.state import State

MARGIN = 0.002  # [m] besides the way that is foreseen: what that estimate may lack
HUGE = 3.0e38  # larger than any coordinate, finite in float32
MAX_CELLS = 24  # of the hash along each axis of a query; a box that large has exploded


@ti.data_oriented
class BodyBounds:
    """Per body: box of positions low, high vec3[B] [m], and of velocities slow, fast vec3[B] [m/s].

    speed f32[B] [m/s]: that of the fastest vertex, at most
    extra f32[B] [m/s]: what may come on top until the next search (sim/contact/swept_bounds.py), already part of slow and fast
    pace f32[B] [m/s]: the speed that no vertex is expected to exceed, on average, until the next search.
    """

    def __init__(self, state: State, blocks: ReductionBlocks):
        self.state, self.blocks = state, blocks
        self.builder = ti.FieldsBuilder()
        self.partial = ti.Vector.field(3, ti.f32)
        self.builder.dense(ti.ij, (blocks.size, 4)).place(self.partial)
        self.low, self.high, self.slow, self.fast = (ti.Vector.field(3, ti.f32) for _ in range(4))
        self.pace, self.speed, self.extra = (ti.field(ti.f32) for _ in range(3))
        self.builder.dense(ti.i, MAX_BODIES).place(self.low, self.high, self.slow, self.fast)
        self.builder.dense(ti.i, MAX_BODIES).place(self.pace, self.speed, self.extra)
        self.tree = self.builder.finalize()

    @ti.kernel
    def update(self):
        s = self.state
        c = self.blocks
        for j in range(c.size):
            span = c.span[j]
            low, high = ti.Vector([HUGE, HUGE, HUGE]), ti.Vector([-HUGE, -HUGE, -HUGE])
            slow, fast = low, high
            for i in range(span[0], span[1]):
                low, high = ti.min(low, s.x[i]), ti.max(high, s.x[i])
                slow, fast = ti.min(slow, s.v[i]), ti.max(fast, s.v[i])
            self.partial[j, 0], self.partial[j, 1], self.partial[j, 2], self.partial[j, 3] = low, high, slow, fast
        for b in range(MAX_BODIES):
            if b < s.body_count[None]:
                low, high = ti.Vector([HUGE, HUGE, HUGE]), ti.Vector([-HUGE, -HUGE, -HUGE])
                slow, fast = low, high
                for j in range(c.begin[b], c.begin[b + 1]):
                    low, high = ti.min(low, self.partial[j, 0]), ti.max(high, self.partial[j, 1])
                    slow, fast = ti.min(slow, self.partial[j, 2]), ti.max(fast, self.partial[j, 3])
                self.low[b], self.high[b], self.slow[b], self.fast[b] = low, high, slow, fast
                self.speed[b] = ti.max(abs(slow), abs(fast)).norm()
                self.widen(b, 0.0)

    @ti.func
    def widen(self, b, extra):
        """Expect body b to gain so much speed [m/s], in any direction."""
        self.slow[b] -= extra
        self.fast[b] += extra
        self.extra[b] = extra
        self.pace[b] = 1.2 * self.speed[b] + extra + MARGIN / self.state.detect_dt[None]

    def destroy(self) -> None:
        self.tree.destroy()


@ti.data_oriented
class PointHash:
    """Points sorted into cells of a hash (Teschner et al. 2003): `count`, then `allot`, then `fill`, then query.

    cell f32 is a cell's size [m]; entry i32[N] the points and at vec3[N] where they are, cell after cell; begin, size
    i32[] the range of each bucket.

    Where a cell's points lie is decided by an atomic counter and differs from run to run; what a query finds does not.
    """

    def __init__(self, points: int):
        self.points, self.buckets = round_up_capacity(points), 1 << max(8, int(np.ceil(np.log2(2 * points + 1))))
        self.builder = ti.FieldsBuilder()
        self.bucket, self.place, self.entry = (ti.field(ti.i32) for _ in range(3))
        self.at = ti.Vector.field(3, ti.f32)
        self.builder.dense(ti.i, self.points).place(self.bucket, self.place)
        self.builder.dense(ti.i, self.points).place(self.entry, self.at)
        self.size, self.begin = ti.field(ti.i32), ti.field(ti.i32)
        self.builder.dense(ti.i, self.buckets).place(self.size, self.begin)
        self.total, self.cell = ti.field(ti.i32), ti.field(ti.f32)
        self.builder.place(self.total, self.cell)
        self.tree = self.builder.finalize()

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
        """Announce point k at p."""
        bucket = self.bucket_of(self.cell_of(p))
        self.bucket[k] = bucket
        self.place[k] = ti.atomic_add(self.size[bucket], 1)

    @ti.func
    def allot(self, bucket):
        """Give a bucket its run of entries; `total` must be 0 before the first."""
        if self.size[bucket] > 0:
            self.begin[bucket] = ti.atomic_add(self.total[None], self.size[bucket])

    @ti.func
    def fill(self, k, p):
        """Put point k at p into its bucket's run."""
        e = self.begin[self.bucket[k]] + self.place[k]
        self.entry[e], self.at[e] = k, p

    @ti.func
    def range_of(self, low, high):
        """First cell of a box and one past its last, at most MAX_CELLS along each axis."""
        first = self.cell_of(low)
        return first, ti.min(self.cell_of(high) + 1, first + MAX_CELLS)

    def destroy(self) -> None:
        self.tree.destroy()
