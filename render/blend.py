"""Front-to-back blending of a tile's splats.

C = sum c_i alpha_i T_i,  T_i = prod_{j<i} (1 - alpha_j),
alpha_i = min(0.999, o_i exp(-0.5 d^T Sigma_2D^-1 d)).                    Kerbl 2023, eq. 3
"""

import taichi as ti

from render.binning import TileBins
from render.footprint import CUTOFF_BITS
from render.radix_sort import value_of
from render.tile_batch import (
    ACROSS,
    ALPHA_MAX,
    BATCH,
    CELL,
    CELL_BITS,
    CHECK_INTERVAL,
    CPU_TILE,
    DOWN,
    GPU_TILE,
    MIN_TRANSMITTANCE,
    QUAD,
    exp2,
    load_member,
    tile_origin,
)

PIXELS = 2  # of a column, per thread: a cell is one warp
ROW_STEP = 32 // CELL  # [px] between a thread's pixels
BLEND_THREADS = 32 * ACROSS * DOWN  # of a block


@ti.data_oriented
class Blend:
    """Draws binned splats. `with_color` and `with_depth` select the sums to compute; the others stay 0.

    color     three numbers a Gaussian, vec3 (capacity,), to be blended in place of its colour
    segments  equal parts of each tile's splats that are drawn side by side, as pictures of their own: where a few tiles
              have most of the splats, all others would wait for them
    """

    def __init__(self, bins: TileBins, *, with_color: bool, with_depth: bool, color=None, segments: int = 1):
        self.bins, self.projection, self.segments = bins, bins.projection, segments
        self.color, self.other_color = color, color is not None
        self.with_color, self.with_depth = with_color, with_depth
        self.on_gpu = ti.cfg.arch == ti.cuda

    @ti.func
    def draw(self, sink: ti.template(), out: ti.template()):
        """Blend all tiles; outermost level of a kernel that has no other shared arrays (SHARED_WORDS).

        Out: `sink.write(out, v * segments + s, y, x, rgb, depth, alpha)` is called once per pixel of segment s, counted
        from the front, of view v: rgb = sum w c, depth = sum w z, alpha = sum w, with w = alpha_i T_i.
        """
        if ti.static(self.on_gpu):
            self._draw_gpu(sink, out)
        else:
            self._draw_cpu(sink, out)

    @ti.func
    def _segment(self, tile, s):
        """Range of the members of segment s of a tile."""
        begin, count = self.bins.begin[tile], self.bins.end[tile] - self.bins.begin[tile]
        length = (count + self.segments - 1) // self.segments
        return begin + ti.min(s * length, count), begin + ti.min((s + 1) * length, count)

    @ti.func
    def _draw_cpu(self, sink: ti.template(), out: ti.template()):
        """One tile per loop iteration; the states of its pixels are arrays that stay in the first-level cache.

        A finished pixel keeps its transmittance negated: no product of it can pass the test against
        MIN_TRANSMITTANCE again, and the loop over a row needs no branch.
        """
        ti.loop_config(block_dim=4)
        for block in range(self.projection.views * self.bins.tiles_per_view() * self.segments):
            tile, s = block // self.segments, block % self.segments
            width, height = self.projection.grid[None][0], self.projection.grid[None][1]
            if ti.static(self.projection.compares):  # noqa: SIM102
                if not self.projection.changed.has(tile):
                    continue
            v, in_view = tile // self.bins.tiles_per_view(), tile % self.bins.tiles_per_view()
            x0, y0 = tile_origin(self.projection, in_view, (CPU_TILE, CPU_TILE))
            T, red, green, blue, depth = filled(1.0), filled(0.0), filled(0.0), filled(0.0), filled(0.0)
            top, bottom = 0, CPU_TILE - 1  # rows that are not finished
            begin, end = self._segment(tile, s)
            for i in range(begin, end):
                g = value_of(self.bins.members[i])
                mean2d, conic = self.projection.mean2d[v, g], self.projection.conic[v, g]
                color = splat_color(self, v, g)
                A, B, C = conic[0], 2 * conic[1], conic[2]
                half_height = self.projection.box[v, g][1]
                dx0, dy0 = x0 + 0.5 - mean2d.x, y0 + 0.5 - mean2d.y
                first = ti.max(top, ti.cast(ti.ceil(ti.max(-dy0 - half_height, 0.0)), ti.i32))
                last = ti.min(bottom, ti.cast(ti.floor(ti.min(half_height - dy0, CPU_TILE - 1.0)), ti.i32))
                for row in range(first, last + 1):
                    dy = dy0 + row
                    base, tilt = mean2d.z - C * dy * dy, B * dy
                    for column in range(CPU_TILE):
                        q = (row & (CPU_TILE - 1)) * CPU_TILE + column  # the mask tells the compiler that q cannot wrap
                        dx = dx0 + column
                        power = base - dx * (A * dx + tilt)
                        alpha = exp2(power)
                        alpha = ti.select(alpha < ALPHA_MAX, alpha, ALPHA_MAX)
                        alpha = ti.select(power < -CUTOFF_BITS, 0.0, alpha)
                        before = T[q]
                        after = before * (1.0 - alpha)
                        visible = after > MIN_TRANSMITTANCE
                        weight = ti.select(visible, alpha * before, 0.0)
                        T[q] = ti.select(visible, after, -ti.abs(before))
                        if ti.static(self.with_color):
                            red[q] += weight * color.r
                            green[q] += weight * color.g
                            blue[q] += weight * color.b
                        if ti.static(self.with_depth):
                            depth[q] += weight * mean2d.w
                if (i - begin) % CHECK_INTERVAL == CHECK_INTERVAL - 1:
                    top, bottom = unfinished_rows(T)
                    if bottom < 0:
                        break
            for q in range(CPU_TILE * CPU_TILE):
                x, y = x0 + q % CPU_TILE, y0 + q // CPU_TILE
                if x < width and y < height:
                    rgb = ti.math.vec3(red[q], green[q], blue[q])
                    sink.write(out, v * self.segments + s, y, x, rgb, depth[q], 1.0 - ti.abs(T[q]))

    @ti.func
    def _draw_gpu(self, sink: ti.template(), out: ti.template()):
        """One tile per block of threads, one cell per warp, PIXELS of a column per thread."""
        ti.loop_config(block_dim=BLEND_THREADS)
        for thread in range(self.projection.views * self.bins.tiles_per_view() * self.segments * BLEND_THREADS):
            block, lane = thread // BLEND_THREADS, thread % BLEND_THREADS
            tile, s = block // self.segments, block % self.segments
            width, height = self.projection.grid[None][0], self.projection.grid[None][1]
            v, in_view = tile // self.bins.tiles_per_view(), tile % self.bins.tiles_per_view()
            x0, y0 = tile_origin(self.projection, in_view, GPU_TILE)
            cell, member = lane // 32, lane % 32
            x, y = x0 + cell % ACROSS * CELL + member % CELL, y0 + cell // ACROSS * CELL + member // CELL
            shared = ti.simt.block.SharedArray((3 * QUAD,), ti.f32)
            T, depth = ti.Vector([1.0] * PIXELS), ti.Vector([0.0] * PIXELS)
            limit = ti.Vector([MIN_TRANSMITTANCE] * PIXELS)  # T must stay above it to go on; no T is above 1
            red, green, blue = ti.Vector([0.0] * PIXELS), ti.Vector([0.0] * PIXELS), ti.Vector([0.0] * PIXELS)
            for p in ti.static(range(PIXELS)):
                if x >= width or y + p * ROW_STEP >= height:
                    limit[p] = 1.0
            begin, end = self._segment(tile, s)
            for batch in range((end - begin + BATCH - 1) // BATCH):
                # the barrier also keeps the last batch in place until every thread has read it
                if ti.simt.block.sync_all_nonzero(ti.cast(limit.min() == 1.0, ti.i32)) != 0:
                    break
                first = begin + batch * BATCH
                for load in range((BATCH + BLEND_THREADS - 1) // BLEND_THREADS):
                    j = load * BLEND_THREADS + lane
                    if j < BATCH:  # the same for the whole warp
                        load_member(self, shared, v, first + j, j, ti.cast(first + j < end, ti.i32), x0, y0)
                ti.simt.block.sync()
                for group in range((ti.min(BATCH, end - first) + 31) // 32):
                    bits = ti.bit_cast(shared[CELL_BITS + 4 * (group * 32 + cell)], ti.u32)
                    while (bits != ti.u32(0)) & (limit.min() < 1.0):
                        less = bits - ti.u32(1)
                        j = group * 32 + ti.cast(ti.math.popcnt(less & ~bits), ti.i32)
                        bits &= less
                        splat = ti.Vector([0.0] * 12)
                        for k in ti.static(range(12)):  # in a row and within known bounds: three wide loads
                            splat[k] = shared[QUAD * (k // 4) + 4 * (j & (BATCH - 1)) + k % 4]
                        dx, dy = x + 0.5 - splat[0], y + 0.5 - splat[1]
                        tilt, base = splat[5] * dx, splat[2] - splat[4] * dx * dx
                        for p in ti.static(range(PIXELS)):  # without branches: most splats of a cell touch some pixel
                            power = base - (dy + p * ROW_STEP) * (tilt + splat[6] * (dy + p * ROW_STEP))
                            alpha = ti.select(power < -CUTOFF_BITS, 0.0, ti.min(ALPHA_MAX, exp2(power)))
                            after = T[p] - alpha * T[p]
                            visible = after > limit[p]
                            limit[p] = ti.select(visible, limit[p], 1.0)
                            after = ti.select(visible, after, T[p])
                            weight = T[p] - after
                            T[p] = after
                            if ti.static(self.with_depth):
                                depth[p] += weight * splat[3]
                            if ti.static(self.with_color):
                                red[p] += weight * splat[7]
                                green[p] += weight * splat[8]
                                blue[p] += weight * splat[9]
            for p in ti.static(range(PIXELS)):
                if x < width and y + p * ROW_STEP < height:
                    rgb = ti.math.vec3(red[p], green[p], blue[p])
                    sink.write(out, v * self.segments + s, y + p * ROW_STEP, x, rgb, depth[p], 1.0 - T[p])

    @ti.func
    def words(self, v, g, mean2d, conic):
        """Numbers of a splat in shared memory."""
        color = ti.math.vec3(0.0)
        if ti.static(self.with_color):
            color = splat_color(self, v, g)
        return splat_words(mean2d, conic, color)


@ti.func
def splat_words(mean2d, conic, color):
    """Numbers of a splat in shared memory: x, y, log2 opacity, z, A, 2 B, C, r, g, b."""
    x, y, log_opacity, z = mean2d[0], mean2d[1], mean2d[2], mean2d[3]
    return ti.Vector([x, y, log_opacity, z, conic[0], 2 * conic[1], conic[2], color[0], color[1], color[2]])


@ti.func
def unfinished_rows(T: ti.template()):
    """First and last row of a CPU tile with an unfinished pixel, by its transmittances; the last is -1 without one."""
    top, bottom = CPU_TILE, -1
    for row in range(CPU_TILE):
        alive = 0
        for column in range(CPU_TILE):
            alive += ti.cast(T[row * CPU_TILE + column] > 0, ti.i32)
        if alive > 0:
            top, bottom = ti.min(top, row), row
    return top, bottom


@ti.func
def splat_color(drawer: ti.template(), v, g) -> ti.math.vec3:
    """The numbers that are blended of Gaussian g in view v: those of `drawer.color` if it has such, else the colour."""
    value = ti.math.vec3(0.0)
    if ti.static(drawer.other_color):
        value = drawer.color[g]
    else:
        value = drawer.projection.color[v, g].xyz
    return value


@ti.func
def filled(value: ti.f32):
    """A value for each pixel of a CPU tile."""
    return ti.Vector([value] * (CPU_TILE * CPU_TILE))
