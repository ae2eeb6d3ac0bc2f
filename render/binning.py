"""Which splats each tile of the picture draws, front to back."""

import taichi as ti

from render.footprint import WINDOW_COLUMNS
from render.prefix_sum import PrefixSum
from render.projection import Projection
from render.radix_sort import RadixSort, item_of, key_of, value_of

# [bits] of a tile's number, at least: pictures of common sizes share the room and the kernels. By backend, on_gpu:
FIRST_TILE_BITS = {False: 12, True: 16}  # what the sort does in one pass (640 x 360 in tiles of 8), in two passes


@ti.data_oriented
class DepthOrder:
    """Seen Gaussians from front to back, one order for all views, and where the pairs of each begin.

    A pair is a (tile, Gaussian) that touch. `first_pair[k]` belongs to the k-th Gaussian in order.
    """

    def __init__(self, projection: Projection):
        self.projection = projection
        capacity = projection.splats.capacity
        self.sorter = RadixSort(capacity, drop=True)
        self.scan = PrefixSum(capacity)
        self.pairs = self.scan.total
        self.first_pair = ti.field(ti.i32)
        builder = ti.FieldsBuilder()
        builder.dense(ti.i, capacity).place(self.first_pair)
        self.tree = builder.finalize()

    def destroy(self) -> None:
        """Give the device memory back; the object must not be used after."""
        self.sorter.destroy()
        self.scan.destroy()
        self.tree.destroy()

    @ti.func
    def arrange(self):
        """Sort by depth and count pairs; outermost level of a kernel."""
        self.sorter.sort()
        for k in range(self.sorter.kept[None]):
            g = value_of(self.sorter.sorted_items[k])
            touched = 0
            for v in range(self.projection.views):
                touched += self.projection.touched(v, g)
            self.first_pair[k] = touched
        self.scan.exclusive(self.first_pair, self.sorter.kept, self.first_pair)


@ti.data_oriented
class TileBins:
    """Room for `capacity` pairs, sorted by tile; within a tile they stay in depth order.

    `begin[t]..end[t]` of `members`, i64 of (t, Gaussian), belong to tile t; tiles of all views are numbered
    row by row, view by view. With more pairs than room nothing is binned: the owner must look at
    `order.pairs` and come back with larger bins.
    """

    def __init__(self, order: DepthOrder, capacity: int):
        self.order, self.projection, self.capacity = order, order.projection, capacity
        bits = max(FIRST_TILE_BITS[ti.cfg.arch == ti.cuda], (self.tiles - 1).bit_length())
        self.tile_capacity = 1 << bits
        self.sorter = RadixSort(capacity, bits=bits)
        self.members = self.sorter.sorted_items
        self.begin, self.end = ti.field(ti.i32), ti.field(ti.i32)
        self.large, self.large_count = ti.field(ti.i32), ti.field(ti.i32)  # places in order of what exceeds a window
        self.crew = 32 if ti.cfg.arch == ti.cuda else 1  # threads that share a large splat
        builder = ti.FieldsBuilder()
        builder.dense(ti.i, self.tile_capacity).place(self.begin, self.end)
        builder.dense(ti.i, self.projection.splats.capacity).place(self.large)
        builder.place(self.large_count)
        self.tree = builder.finalize()

    @property
    def tiles(self) -> int:
        """Tiles of all views in pictures of the present size; more than `tile_capacity` need larger bins."""
        columns, rows = self.projection.tiles
        return self.projection.views * columns * rows

    def destroy(self) -> None:
        """Give the device memory back; the object must not be used after."""
        self.sorter.destroy()
        self.tree.destroy()

    @ti.func
    def tiles_per_view(self) -> ti.i32:
        """As the device knows it."""
        return self.projection.grid[None][2] * self.projection.grid[None][3]

    @ti.func
    def fill(self):
        """Emit all pairs in depth order and sort them stably by tile; outermost level of a kernel."""
        self.sorter.count[None] = 0
        self.large_count[None] = 0
        if self.order.pairs[None] <= self.capacity:
            self.sorter.count[None] = self.order.pairs[None]
        for k in range(self.order.sorter.kept[None]):
            if self.sorter.count[None] > 0:
                larger = self._emit(value_of(self.order.sorter.sorted_items[k]), self.order.first_pair[k])
                if larger:
                    self.large[ti.atomic_add(self.large_count[None], 1)] = k
        for i in range(self.large_count[None] * self.crew):
            k = self.large[i // self.crew]
            self._emit_large(value_of(self.order.sorter.sorted_items[k]), self.order.first_pair[k], i % self.crew)
        self.sorter.sort()
        for t in range(self.projection.views * self.tiles_per_view()):
            self.begin[t] = 0
            self.end[t] = 0
        for i in range(self.sorter.kept[None]):
            t, last = self._tile_of(i), self.sorter.kept[None] - 1
            if i == 0 or self._tile_of(ti.max(i - 1, 0)) != t:
                self.begin[t] = i
            if i == last or self._tile_of(ti.min(i + 1, last)) != t:
                self.end[t] = i + 1

    @ti.func
    def _tile_of(self, i: ti.i32) -> ti.i32:
        return ti.cast(key_of(self.members[i]), ti.i32)

    @ti.func
    def _emit(self, g: ti.i32, slot: ti.i32):
        """Write the pairs of a Gaussian from `slot` on; returns whether larger splats of it are left."""
        left_over = False
        columns = self.projection.grid[None][2]
        for v in range(self.projection.views):
            window = self.projection.window[v, g]
            bits = window[1]
            corner = v * self.tiles_per_view() + (window[0] >> 16) * columns + (window[0] & 0xFFFF)
            while bits > 0:
                place = ti.cast(ti.math.popcnt((bits & -bits) - 1), ti.i32)  # of the lowest bit
                tile = corner + place // WINDOW_COLUMNS * columns + place % WINDOW_COLUMNS
                self.sorter.items[slot] = item_of(tile, g)
                slot += 1
                bits &= bits - 1
            if bits < 0:
                left_over = True
                slot -= bits
        return left_over

    @ti.func
    def _emit_large(self, g: ti.i32, slot: ti.i32, member: ti.i32):
        """Write every `crew`-th row, from row `member` on, of the splats of a Gaussian that exceed a window."""
        for v in range(self.projection.views):
            if self.projection.window[v, g][1] >= 0:
                slot += self.projection.touched(v, g)
            else:
                place, conic = self.projection.place[v, g], self.projection.conic[v, g]
                box = self.projection.box[v, g]
                left, right, top, bottom = self.projection.tile_box(place, box)
                for row in range(top, bottom):
                    first, last = self.projection.tile_columns(row, left, right, place, conic, box)
                    if (row - top) % self.crew == member:
                        tile = v * self.tiles_per_view() + row * self.projection.grid[None][2]
                        for column in range(first, last):
                            self.sorter.items[slot + column - first] = item_of(tile + column, g)
                    slot += last - first
