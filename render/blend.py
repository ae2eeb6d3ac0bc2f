"""Front-to-back blending of a tile's splats.

C = sum c_i alpha_i T_i,  T_i = prod_{j<i} (1 - alpha_j),
alpha_i = min(0.999, o_i exp(-0.5 d^T Sigma_2D^-1 d)).                    Kerbl 2023, eq. 3

On CUDA a tile consists of cells, each drawn by a warp. A tile's members say which cells they touch: splats outside
of its cell cost a warp next to nothing. A thread draws PIXELS of a column, or twice as many where tiles are large.
"""

import math

import taichi as ti

from core.fields import load_quad
from core.lanes import WARP, dealt, rank_lanes, sync_lanes, vote
from core.runtime import CUDA, QUADRANTS
from render.binning import CELLS_AT, TileBins
from render.footprint import ACROSS, CELL, CUTOFF_BITS, DOWN
from render.radix_sort import key_of, value_of

ALPHA_MAX = 0.999  # as gsplat: a pixel never becomes fully opaque, so its weights stay finite
MIN_TRANSMITTANCE = 1e-4  # a pixel is finished where its transmittance would fall to this
# CUDA's 2^x is 0 below the least normal float. Alphas are computed as multiples of 1 / SCALE, so that this least one is
# 1/255, where a splat ends: without comparisons, a tenth of the instructions.
SCALE = 2.0**126 / 255
LOG_SCALE, LOG_ALPHA_MAX, LN2 = math.log2(SCALE), math.log2(ALPHA_MAX), math.log(2.0)
CPU_TILE = 8  # [px] a row of a tile is one vector register of floats
CHECK_INTERVAL = 16  # splats between two tests, on the CPU, of whether all pixels are finished
GPU_TILE = (32, 16)  # [px]
# In a picture of many pixels, where warps are enough, tiles are larger: fewer pairs to sort, and half the work that
# does not depend on the pixels. A photograph of 540 x 960 would take a quarter more.
LARGE_GPU_TILE, MANY_PIXELS = (32, 32), 1 << 21
TILE_THREADS = ACROSS * DOWN * WARP
PLACE = 12  # words in shared memory of a splat for a cell
BATCH = 512  # splats in shared memory at a time; a power of two
QUAD = 4 * BATCH  # words of shared memory between quads of a splat: its first four numbers, the next, the last two
CELL_BITS = 2 * QUAD + 2  # first of the words that say which of 32 splats touch a cell
INDEX = 2 * QUAD + 3  # word with the index of a splat's Gaussian, for gradients
PIXELS = 2  # of a column, per thread: a cell is one warp
ROW_STEP = 32 // CELL  # [px] between a thread's pixels


@ti.func
def exp2(x: ti.f32) -> ti.f32:
    """2^x for -CUTOFF_BITS <= x <= 0.01, relative error 4e-6; undefined outside, but on CUDA 0 for x < -126.

    One instruction on CUDA. Elsewhere (2^(x/16))^16 with a polynomial for the inner part: products only, which a CPU
    vectorises.
    """
    y = x
    if ti.static(ti.cfg.arch == ti.cuda and not QUADRANTS):
        CUDA.exp2(y)
    elif ti.static(ti.cfg.arch == ti.cuda):
        y = ti.select(x < -126.0, 0.0, ti.exp(LN2 * x))
    else:
        y = 0.0009379154316623323 + x * (1.3388277327798619e-05 + x * 1.2325647990480442e-07)
        y = 0.9999999187056234 + x * (0.04332121602645622 + x * y)
        y *= y
        y *= y
        y *= y
        y *= y
    return y


@ti.func
def pixel_of(x0, y0, cell, member, height: ti.template(), across: ti.template() = ACROSS):
    """Column and row [px] of a pixel of a cell `height` [px] high, in a tile that begins at (x0, y0) and is `across`
    cells wide."""
    return x0 + cell % across * CELL + member % CELL, y0 + cell // across * height + member // CELL


@ti.func
def covered_rows(y, half_height, top, bottom):
    """First and last row of a CPU tile, within top..bottom, that a splat's box meets; y: of its centre [px]."""
    first = ti.max(top, ti.cast(ti.ceil(ti.max(-y - half_height, 0.0)), ti.i32))
    last = ti.min(bottom, ti.cast(ti.floor(ti.min(half_height - y, CPU_TILE - 1.0)), ti.i32))
    return first, last


@ti.func
def load_batch(drawer: ti.template(), shared: ti.template(), v, first, end, lane, threads: ti.template()):
    """Load the next BATCH of the members first..end-1 of the bins; all threads of a block together, CUDA only."""
    for load in range((ti.min(BATCH, end - first) + threads - 1) // threads):
        j = load * threads + lane
        if j < BATCH:  # the same for the whole warp
            load_member(drawer, shared, v, first + j, j, ti.cast(first + j < end, ti.i32))
    ti.simt.block.sync()


@ti.func
def fetched(shared: ti.template(), j, count: ti.template()):
    """The first `count` numbers of the splat at position j of the batch."""
    splat = ti.Vector([0.0] * count)
    for k in ti.static(range(count)):  # in a row and within known bounds: three wide loads
        splat[k] = shared[QUAD * (k // 4) + 4 * (j & (BATCH - 1)) + k % 4]
    return splat


@ti.func
def load_member(drawer: ti.template(), shared: ti.template(), v, i, j, exists):
    """Write member `i` of the bins at position `j` of the batch, and its bit to every cell that it touches.

    `drawer.words(v, g, mean2d, conic)` are the numbers of a splat that blending reads, ten at most; with
    `drawer.keeps_index` the index of its Gaussian follows.
    """
    touches = ti.u32(0)  # a bit for each cell
    if exists != 0:
        item = drawer.bins.members[i]
        g, touches = value_of(item), key_of(item) >> ti.u32(CELLS_AT)
        mean2d, conic = load_quad(drawer.projection.mean2d, v, g), load_quad(drawer.projection.conic, v, g)
        words = drawer.words(v, g, mean2d, conic)
        for k in ti.static(range(10)):
            shared[QUAD * (k // 4) + 4 * (j & (BATCH - 1)) + k % 4] = words[k]
        if ti.static(drawer.keeps_index):
            shared[INDEX + 4 * j] = ti.bit_cast(ti.cast(g, ti.i32), ti.f32)
    for cell in ti.static(range(ACROSS * DOWN)):
        ones = vote((touches >> ti.u32(cell)) & ti.u32(1), WARP)
        if j % 32 == cell:
            shared[CELL_BITS + 4 * j] = ti.bit_cast(ones, ti.f32)


@ti.data_oriented
class Blend:
    """Draws binned splats. `with_color` and `with_depth` select the sums to compute; the others stay 0.

    color     three numbers a Gaussian, vec3 (capacity,), to be blended in place of its colour
    fast      a splat that finishes a pixel counts, too, which is nearer to the sum above; else a pixel stays as it was
              before, as in gsplat and BlendGradients. An alpha is at most ALPHA_MAX by its splat's opacity
    segments  equal parts of each tile's splats that are drawn side by side, as pictures of their own: where a few tiles
              have most of the splats, all others would wait for them
    """

    def __init__(
        self, bins: TileBins, *, with_color: bool, with_depth: bool, color=None, segments: int = 1, fast: bool = False
    ):
        self.bins, self.projection, self.segments, self.fast = bins, bins.projection, segments, fast
        self.color, self.other_color = color, color is not None
        self.with_color, self.with_depth = with_color, with_depth
        self.on_gpu = ti.cfg.arch == ti.cuda
        self.pixels = PIXELS * self.projection.tile[1] // GPU_TILE[1]

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
        """One tile per loop iteration; the states of its pixels are arrays that stay in the first-level cache."""
        blocks = self.projection.views * self.bins.tiles_per_view() * self.segments
        for k in range(blocks):
            block = dealt(k, blocks)
            tile, s = block // self.segments, block % self.segments
            if not self.projection.draws(tile):
                continue
            v, x0, y0 = self.projection.place_of(tile, (CPU_TILE, CPU_TILE))
            T, red, green, blue, depth = filled(1.0), filled(0.0), filled(0.0), filled(0.0), filled(0.0)
            top, bottom = 0, CPU_TILE - 1  # rows that are not finished
            begin, end = self._segment(tile, s)
            for i in range(begin, end):
                g = value_of(self.bins.members[i])
                mean2d, conic = self.projection.mean2d[v, g], self.projection.conic[v, g]
                color = splat_color(self, v, g)
                A, B, C, top_power = conic[0], 2 * conic[1], conic[2], mean2d.z
                if ti.static(self.fast):
                    top_power = ti.min(top_power, LOG_ALPHA_MAX)
                dx0, dy0 = x0 + 0.5 - mean2d.x, y0 + 0.5 - mean2d.y
                first, last = covered_rows(dy0, self.projection.color[v, g][3], top, bottom)
                for row in range(first, last + 1):
                    dy = dy0 + row
                    base, tilt = top_power - C * dy * dy, B * dy
                    for column in range(CPU_TILE):
                        q = (row & (CPU_TILE - 1)) * CPU_TILE + column  # the mask tells the compiler that q cannot wrap
                        dx = dx0 + column
                        power = base - dx * (A * dx + tilt)
                        alpha = exp2(power)
                        if ti.static(not self.fast):
                            alpha = ti.select(alpha < ALPHA_MAX, alpha, ALPHA_MAX)
                        alpha = ti.select(power < -CUTOFF_BITS, 0.0, alpha)
                        weight, T[q] = blended(T[q], alpha, 1.0, self.fast)
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
                if self.projection.inside(x, y):
                    rgb = ti.math.vec3(red[q], green[q], blue[q])
                    sink.write(out, v * self.segments + s, y, x, rgb, depth[q], 1.0 - ti.abs(T[q]))

    @ti.func
    def _draw_gpu(self, sink: ti.template(), out: ti.template()):
        """A warp draws a cell alone, `pixels` of a column per thread.

        Its lanes look through 32 of the tile's splats, and write those that touch the cell side by side into the warp's
        own places in shared memory. No warp waits for another, nor for what touches other cells.
        """
        pixels, height = ti.static(self.pixels, self.pixels * ROW_STEP)
        ti.loop_config(block_dim=TILE_THREADS)
        for thread in range(self.projection.views * self.bins.tiles_per_view() * self.segments * TILE_THREADS):
            block, cell, lane = thread // TILE_THREADS, thread % TILE_THREADS // WARP, thread % WARP
            tile, s = self.bins.turn[block // self.segments], block % self.segments
            v, x0, y0 = self.projection.place_of(tile, self.projection.tile)
            left, top = pixel_of(x0, y0, cell, 0, height)
            x, y = pixel_of(x0, y0, cell, lane, height)
            shared = ti.simt.block.SharedArray((PLACE * TILE_THREADS,), ti.f32)
            T, depth = ti.Vector([SCALE] * pixels), ti.Vector([0.0] * pixels)  # T, times SCALE
            red, green, blue = ti.Vector([0.0] * pixels), ti.Vector([0.0] * pixels), ti.Vector([0.0] * pixels)
            for p in ti.static(range(pixels)):
                if not self.projection.inside(x, y + p * ROW_STEP):
                    T[p] = -SCALE
            begin, end = self._segment(tile, s)
            for group in range((end - begin + WARP - 1) // WARP):
                if vote(T.max() > SCALE * MIN_TRANSMITTANCE, WARP) == ti.u32(0):
                    break
                i, item, touches = begin + group * WARP + lane, ti.cast(0, ti.i64), 0
                if i < end:
                    item = self.bins.members[i]
                    touches = ti.cast(key_of(item) >> ti.cast(CELLS_AT + cell, ti.u32), ti.i32) & 1
                place, count = rank_lanes(touches, lane, WARP)
                if touches != 0:
                    words = self._words(v, value_of(item), left, top)
                    for k in ti.static(range(10)):
                        shared[PLACE * ((cell * WARP + place) & (TILE_THREADS - 1)) + k] = words[k]
                sync_lanes(WARP)
                for k in range(count):
                    splat = ti.Vector([0.0] * 10)
                    for n in ti.static(range(10)):  # within known bounds: wide loads
                        splat[n] = shared[PLACE * ((cell * WARP + k) & (TILE_THREADS - 1)) + n]
                    along = splat[0] * (x - left + 0.5) - splat[1]
                    across = splat[4] * (y - top + 0.5) + (splat[5] * (x - left + 0.5) - splat[3])
                    base = splat[2] - along * along
                    for p in ti.static(range(pixels)):  # without branches: most splats of a cell touch some pixel
                        u = across + p * ROW_STEP * splat[4]
                        alpha = exp2(base - u * u)
                        if ti.static(not self.fast):
                            alpha = ti.min(ALPHA_MAX / SCALE, alpha)
                        weight, T[p] = blended(T[p], alpha, SCALE, self.fast)
                        if ti.static(self.with_depth):
                            depth[p] += weight * splat[9]
                        if ti.static(self.with_color):
                            red[p] += weight * splat[6]
                            green[p] += weight * splat[7]
                            blue[p] += weight * splat[8]
                sync_lanes(WARP)  # all have read, before the next splats are written
            for p in ti.static(range(pixels)):
                if self.projection.inside(x, y + p * ROW_STEP):
                    rgb = ti.math.vec3(red[p], green[p], blue[p])
                    alpha = 1.0 - ti.abs(T[p]) / SCALE
                    sink.write(out, v * self.segments + s, y + p * ROW_STEP, x, rgb, depth[p], alpha)

    @ti.func
    def _words(self, v, g, left, top):
        """Numbers of a splat at (x, y) [px] from the corner of a cell, (left, top) [px], by its factors q, s and t.

        q, q x, log2 (opacity / SCALE), s y + t x, s, t, r, g, b, z
        """
        mean2d, color = load_quad(self.projection.mean2d, v, g), ti.math.vec3(0.0)
        if ti.static(self.with_color):
            color = splat_color(self, v, g)
        q, s, t = factors(load_quad(self.projection.conic, v, g))
        x, y = mean2d.x - left, mean2d.y - top
        if ti.static(self.fast):
            mean2d.z = ti.min(mean2d.z, LOG_ALPHA_MAX)
        return ti.Vector([q, q * x, mean2d.z - LOG_SCALE, s * y + t * x, s, t, color[0], color[1], color[2], mean2d.w])


@ti.func
def blended(before, alpha, scale: ti.template(), fast: ti.template()):
    """Weight of a splat in a pixel, and the pixel's transmittance behind it; both transmittances times `scale`.

    A finished pixel keeps its transmittance negated: no product of it passes the test again, and there is no branch.
    """
    weight = before * alpha
    after = before - scale * weight
    if ti.static(not fast):
        visible = after > scale * MIN_TRANSMITTANCE
        weight = ti.select(visible, weight, 0.0)
        after = ti.select(visible, after, -ti.abs(before))
    return weight, after


@ti.func
def factors(conic):
    """q, s and t with A x^2 + 2 B x y + C y^2 = (q x)^2 + (s y + t x)^2.

    The terms on the left cancel along a needle, and rounding would lose what it covers.
    """
    s = ti.sqrt(conic[2])
    return ti.sqrt(conic[3] / conic[2]), s, conic[1] / s


@ti.func
def unfinished_rows(T: ti.template()):
    """First and last row of a CPU tile with an unfinished pixel, by its transmittances; the last is -1 without one."""
    top, bottom = CPU_TILE, -1
    for row in range(CPU_TILE):
        alive = 0
        for column in range(CPU_TILE):
            alive += ti.cast(T[row * CPU_TILE + column] > MIN_TRANSMITTANCE, ti.i32)
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
        value = load_quad(drawer.projection.color, v, g).xyz
    return value


@ti.func
def filled(value: ti.f32):
    """A value for each pixel of a CPU tile."""
    return ti.Vector([value] * (CPU_TILE * CPU_TILE))
