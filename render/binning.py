"""Tile binning: the splats of each tile of the picture, front to back."""

import taichi as ti

from core.fields import FieldGroup, load_quad
from core.lanes import lane_count, sums_before
from render.footprint import box_of, masked_tile, tile_box, tile_columns, touched_cells
from render.prefix_sum import PrefixSum
from render.projection import DEPTH_BITS, MANY, Projection
from render.radix_sort import RadixSort, item_of, key_of, value_of

# [bits] of a tile's number, at least, so that pictures of common sizes share the capacity and the kernels; by backend:
MIN_TILE_BITS = {"cpu": 12, "cuda": 16}  # one pass of the sort (640 x 360 in tiles of 8), two passes
CELLS_AT = 24  # first of the bits of a key, above those of the tile, that say which cells of it the splat touches


@ti.data_oriented
class DepthOrder:
    """Visible Gaussians from front to back, one order for all views, and the offset of each one's pairs.

    A pair is a tile and a Gaussian that touches it. `first_pair[k]` belongs to the k-th Gaussian in order; `pairs` is
    their total.
    """

    def __init__(self, projection: Projection):
        self.projection = projection
        capacity = projection.splats.capacity
        self.sorter = RadixSort(capacity, bits=DEPTH_BITS, drop=True)
        self.scan = PrefixSum(capacity)
        self.pairs = self.scan.total
        self.fields = f = FieldGroup()
        self.first_pair = f.scalar(capacity, dtype=ti.i32)
        f.build()

    def destroy(self) -> None:
        """Free the device memory."""
        self.sorter.destroy()
        self.scan.destroy()
        self.fields.destroy()

    @ti.func
    def gaussian(self, k: ti.i32) -> ti.i32:
        """Index of the k-th Gaussian from the front."""
        return value_of(self.sorter.sorted_items[k])

    @ti.func
    def number(self, k: ti.i32) -> ti.i32:
        """Number of the pairs of the k-th Gaussian from the front."""
        pairs = ti.cast(key_of(self.sorter.sorted_items[k]) >> ti.u32(DEPTH_BITS), ti.i32)
        if pairs == MANY or ti.static(self.projection.compares):
            pairs = 0
            for v in range(self.projection.views):
                pairs += self.projection.tile_count(v, self.gaussian(k))
        return pairs

    @ti.func
    def count_pairs(self):
        """Count the tiles of each Gaussian in order and scan the counts; outermost level of a kernel."""
        self.scan.exclusive(self, self.sorter.kept, self.first_pair)


@ti.data_oriented
class TileBins:
    """Pairs of tile and Gaussian, sorted by tile; within a tile they stay in depth order.

    `begin[t]..end[t]` of `members`, i64 items of (t, Gaussian), belong to tile t; tiles of all views are numbered
    row by row, view by view. On CUDA a key holds `touched_cells`, too: a cell reads no splat in vain. With more pairs
    than `capacity` all bins are empty: the owner must compare `order.pairs` and replace the bins by larger ones.
    """

    def __init__(self, order: DepthOrder, capacity: int):
        self.order, self.projection, self.capacity = order, order.projection, capacity
        self.on_gpu = ti.cfg.arch == ti.cuda
        bits = max(MIN_TILE_BITS["cuda" if self.on_gpu else "cpu"], (self.tiles - 1).bit_length())
        self.tile_capacity = 1 << bits
        self.sorter = RadixSort(capacity, bits=bits)
        self.members = self.sorter.sorted_items
        self.lanes = lane_count()
        self.fields = f = FieldGroup()
        with f.interleaved(self.tile_capacity):
            self.begin, self.end, self.turn = (f.scalar(self.tile_capacity, dtype=ti.i32) for _ in range(3))
        self.full, self.others = f.scalar(dtype=ti.i32), f.scalar(dtype=ti.i32)
        splats = self.projection.views * self.projection.splats.capacity
        self.large = f.scalar(splats, dtype=ti.i32)  # numbers of large splats, see `_splat`
        self.large_count = f.scalar(dtype=ti.i32)
        f.build()

    @property
    def tiles(self) -> int:
        """Tiles of all views in pictures of the present size; more than `tile_capacity` need larger bins."""
        columns, rows = self.projection.tiles
        return self.projection.views * columns * rows

    def destroy(self) -> None:
        """Free the device memory."""
        self.sorter.destroy()
        self.fields.destroy()

    @ti.func
    def tiles_per_view(self) -> ti.i32:
        """Number of tiles in a view, from the device's `grid`."""
        return self.projection.grid[None][2] * self.projection.grid[None][3]

    @ti.func
    def emit(self):
        """Write all pairs in depth order, and empty all tiles; outermost level of a kernel.

        A splat that exceeds a tile mask waits for the second loop, where lanes share it: a capture has thousands behind
        each other that cover much of the picture.
        """
        self.large_count[None], self.full[None], self.others[None] = 0, 0, 0
        self.sorter.count[None] = 0
        if self.order.pairs[None] <= self.capacity:
            self.sorter.count[None] = self.order.pairs[None]
        for i in range(self.projection.views * ti.max(self.order.sorter.kept[None], self.tiles_per_view())):
            if i < self.projection.views * self.tiles_per_view():
                if ti.static(self.on_gpu):
                    self._take_turn(i)
                self.begin[i], self.end[i] = 0, 0
            if i < self.projection.views * self.order.sorter.kept[None] and self.sorter.count[None] > 0:
                v, g, pair = self._splat(i)
                if self.projection.tile_mask[v, g][1] >= 0:
                    self._emit_masked(v, g, pair)
                else:
                    self.large[ti.atomic_add(self.large_count[None], 1)] = i
        for i in range(self.large_count[None] * self.lanes):
            v, g, pair = self._splat(self.large[i // self.lanes])
            self._emit_large(v, g, pair, i % self.lanes)

    @ti.func
    def _take_turn(self, tile: ti.i32):
        """Let a tile be drawn early if it had many members in the last picture: or all would wait for it in the end."""
        tiles = self.projection.views * self.tiles_per_view()
        if self.end[tile] - self.begin[tile] > self.order.pairs[None] / tiles:
            self.turn[ti.atomic_add(self.full[None], 1)] = tile
        else:
            self.turn[tiles - 1 - ti.atomic_add(self.others[None], 1)] = tile

    @ti.func
    def find_ranges(self):
        """Set `begin` and `end` of each tile that has members; outermost level of a kernel."""
        for i in range(self.sorter.kept[None]):
            t, last = self._tile_of(i), self.sorter.kept[None] - 1
            if i == 0 or self._tile_of(ti.max(i - 1, 0)) != t:
                self.begin[t] = i
            if i == last or self._tile_of(ti.min(i + 1, last)) != t:
                self.end[t] = i + 1

    @ti.func
    def _tile_of(self, i: ti.i32) -> ti.i32:
        return ti.cast(key_of(self.members[i]) & ti.u32((1 << CELLS_AT) - 1), ti.i32)

    @ti.func
    def _write(self, pair: ti.i32, v, g, row, column, mean2d, conic, box) -> ti.i32:
        """Write the pair of a tile and splat g of view v, if the tile is drawn; returns the place of the next."""
        tile = self.projection.tile_at(v, row, column)
        if self.projection.draws(tile):
            key = ti.cast(tile, ti.u32)
            if ti.static(self.on_gpu):
                cells = touched_cells(row, column, mean2d, conic, box, self.projection.tile)
                key |= ti.cast(cells, ti.u32) << CELLS_AT
            self.sorter.items[pair] = item_of(key, g)
            pair += 1
        return pair

    @ti.func
    def _splat(self, i: ti.i32):
        """View, Gaussian and first pair of the i-th splat from the front; the two eyes' stand side by side."""
        k, v = i // self.projection.views, i % self.projection.views
        g, pair = self.order.gaussian(k), self.order.first_pair[k]
        for before in ti.static(range(self.projection.views - 1)):
            if before < v:
                pair += self.projection.tile_count(before, g)
        return v, g, pair

    @ti.func
    def _emit_masked(self, v: ti.i32, g: ti.i32, pair: ti.i32):
        """Write the pairs of a splat from `pair` on."""
        p = self.projection
        mean2d, conic = load_quad(p.mean2d, v, g), load_quad(p.conic, v, g)
        box = box_of(mean2d, conic)
        mask, bits = p.tile_mask[v, g], p.tile_mask[v, g][1]
        while bits > 0:
            row, column = masked_tile(mask[0], bits)
            pair = self._write(pair, v, g, row, column, mean2d, conic, box)
            bits &= bits - 1

    @ti.func
    def _emit_large(self, v: ti.i32, g: ti.i32, pair: ti.i32, lane: ti.i32):
        """Write the pairs of a splat without a tile mask; each lane has every so many rows."""
        p = self.projection
        mean2d, conic = load_quad(p.mean2d, v, g), load_quad(p.conic, v, g)
        box = box_of(mean2d, conic)
        left, right, top, bottom = tile_box(mean2d, box, p.tile, p.grid)
        for step in range((bottom - top + self.lanes - 1) // self.lanes):
            row, column, last = top + step * self.lanes + lane, 0, 0
            if row < bottom:
                column, last = tile_columns(row, left, right, mean2d, conic, box, p.tile)
            before, all_rows = sums_before(last - column, lane, self.lanes)
            at = pair + before
            # The second bound is read again at each step, else the loop's vectorised forms take half a second to
            # compile.
            while column < ti.min(last, p.grid[None][2]):
                at = self._write(at, v, g, row, column, mean2d, conic, box)
                column += 1
            pair = pair + all_rows if ti.static(self.lanes > 1) else at  # one lane may leave out tiles
