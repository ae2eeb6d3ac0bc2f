"""Front-to-back blending of a tile's splats.

C = sum c_i alpha_i T_i,  T_i = prod_{j<i} (1 - alpha_j),
alpha_i = min(0.999, o_i exp(-0.5 d^T Sigma_2D^-1 d)).                    Kerbl 2023, eq. 3

A CUDA block draws a tile of cells, a warp each. Splats come through shared memory in batches. The thread that loads a
splat finds the cells that it touches; a warp reads them as one bit per splat and visits the set bits, so that splats
outside of its cell cost it nothing. A thread draws PIXELS of a column, or twice as many in a large picture.
"""

import taichi as ti

from core.lanes import WARP, dealt, first_of, vote
from core.runtime import CUDA, QUADRANTS
from render.binning import TileBins
from render.footprint import CUTOFF_BITS, horizontal_extent
from render.radix_sort import value_of

ALPHA_MAX = 0.999  # as gsplat: a pixel never becomes fully opaque, so its weights stay finite
MIN_TRANSMITTANCE = 1e-4  # a pixel is finished before its transmittance would fall to this
CPU_TILE = 8  # [px] a row of a tile is one vector register of floats
CHECK_INTERVAL = 16  # splats between two tests, on the CPU, of whether all pixels are finished
GPU_TILE = (32, 16)  # [px]; larger tiles make fewer pairs to sort
CELL = 8  # [px] width of a cell
ACROSS = GPU_TILE[0] // CELL
BATCH = 512  # splats in shared memory at a time; a power of two
QUAD = 4 * BATCH  # words of shared memory between quads of a splat: its first four numbers, the next, the last two
CELL_BITS = 2 * QUAD + 2  # first of the words that say which of 32 splats touch a cell
INDEX = 2 * QUAD + 3  # word with the index of a splat's Gaussian, for gradients
PIXELS = 2  # of a column, per thread: a cell is one warp
ROW_STEP = 32 // CELL  # [px] between a thread's pixels
TILE_PIXELS = GPU_TILE[0] * GPU_TILE[1]
# From this many tiles on, a thread has 2 PIXELS: half the work that does not depend on the pixels, and still enough
# warps. Two eyes of 1800 x 1920 take a tenth less, a photograph of 540 x 960 would take a quarter more.
MANY_TILES = 4096


@ti.func
def exp2(x: ti.f32) -> ti.f32:
    """2^x for -CUTOFF_BITS <= x <= 0.01, relative error 4e-6; undefined outside.

    One instruction on CUDA. Elsewhere (2^(x/16))^16 with a polynomial for the inner part: products only, which a CPU
    vectorises.
    """
    y = x
    if ti.static(ti.cfg.arch == ti.cuda and not QUADRANTS):
        CUDA.exp2(y)
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
def load_batch(drawer: ti.template(), shared: ti.template(), v, first, end, lane, threads: ti.template(), x0, y0):
    """Load the next BATCH of the members first..end-1 of the bins; all threads of a block together, CUDA only."""
    for load in range((ti.min(BATCH, end - first) + threads - 1) // threads):
        j = load * threads + lane
        if j < BATCH:  # the same for the whole warp
            load_member(drawer, shared, v, first + j, j, ti.cast(first + j < end, ti.i32), x0, y0)
    ti.simt.block.sync()


@ti.func
def fetched(shared: ti.template(), j, count: ti.template()):
    """The first `count` numbers of the splat at position j of the batch."""
    splat = ti.Vector([0.0] * count)
    for k in ti.static(range(count)):  # in a row and within known bounds: three wide loads
        splat[k] = shared[QUAD * (k // 4) + 4 * (j & (BATCH - 1)) + k % 4]
    return splat


@ti.func
def load_member(drawer: ti.template(), shared: ti.template(), v, i, j, exists, x0, y0):
    """Write member `i` of the bins at position `j` of the batch, and its bit to every cell that it touches.

    `drawer.words(v, g, mean2d, conic)` are the numbers of a splat that blending reads, ten at most; with
    `drawer.keeps_index` the index of its Gaussian follows. A thread draws `drawer.pixels` of a column.
    """
    height = ti.static(drawer.pixels * ROW_STEP)  # [px] of a cell
    down = ti.static(GPU_TILE[1] // height)
    touches = 0  # a bit for each cell
    if exists != 0:
        g = value_of(drawer.bins.members[i])
        mean2d, conic = drawer.projection.mean2d[v, g], drawer.projection.conic[v, g]
        box = drawer.projection.box[v, g]
        at, words = 4 * (j & (BATCH - 1)), drawer.words(v, g, mean2d, conic)
        for k in ti.static(range(10)):
            shared[QUAD * (k // 4) + at + k % 4] = words[k]
        if ti.static(drawer.keeps_index):
            shared[INDEX + 4 * j] = ti.bit_cast(ti.cast(g, ti.i32), ti.f32)
        for row in ti.static(range(down)):
            top = y0 + row * height + 0.5
            if mean2d.y - box[1] <= top + (height - 1) and mean2d.y + box[1] >= top:
                left, right = horizontal_extent(top, top + (height - 1), mean2d, conic, box)
                for column in ti.static(range(ACROSS)):
                    if left <= x0 + column * CELL + CELL - 0.5 and right >= x0 + column * CELL + 0.5:
                        touches |= 1 << (row * ACROSS + column)
    for cell in ti.static(range(ACROSS * down)):
        ones = vote((touches >> cell) & 1, WARP)
        if j % 32 == cell:
            shared[CELL_BITS + 4 * j] = ti.bit_cast(ones, ti.f32)


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
        self.on_gpu, self.keeps_index = ti.cfg.arch == ti.cuda, False
        self.pixels = PIXELS if segments * bins.tiles < MANY_TILES else 2 * PIXELS

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
                A, B, C = conic[0], 2 * conic[1], conic[2]
                dx0, dy0 = x0 + 0.5 - mean2d.x, y0 + 0.5 - mean2d.y
                first, last = covered_rows(dy0, self.projection.box[v, g][1], top, bottom)
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
                if self.projection.inside(x, y):
                    rgb = ti.math.vec3(red[q], green[q], blue[q])
                    sink.write(out, v * self.segments + s, y, x, rgb, depth[q], 1.0 - ti.abs(T[q]))

    @ti.func
    def _draw_gpu(self, sink: ti.template(), out: ti.template()):
        """One tile per block of threads, one cell per warp, `pixels` of a column per thread."""
        pixels, threads = ti.static(self.pixels, TILE_PIXELS // self.pixels)
        ti.loop_config(block_dim=threads)
        for thread in range(self.projection.views * self.bins.tiles_per_view() * self.segments * threads):
            block, lane = thread // threads, thread % threads
            tile, s = block // self.segments, block % self.segments
            v, x0, y0 = self.projection.place_of(tile, GPU_TILE)
            cell, member = lane // 32, lane % 32
            x, y = pixel_of(x0, y0, cell, member, ti.static(pixels * ROW_STEP))
            shared = ti.simt.block.SharedArray((3 * QUAD,), ti.f32)
            T, depth = ti.Vector([1.0] * pixels), ti.Vector([0.0] * pixels)  # T is negated as on the CPU
            red, green, blue = ti.Vector([0.0] * pixels), ti.Vector([0.0] * pixels), ti.Vector([0.0] * pixels)
            for p in ti.static(range(pixels)):
                if not self.projection.inside(x, y + p * ROW_STEP):
                    T[p] = -1.0
            begin, end = self._segment(tile, s)
            for batch in range((end - begin + BATCH - 1) // BATCH):
                # the barrier also keeps the last batch in place until every thread has read it
                if ti.simt.block.sync_all_nonzero(ti.cast(T.max() < 0.0, ti.i32)) != 0:
                    break
                first = begin + batch * BATCH
                load_batch(self, shared, v, first, end, lane, threads, x0, y0)
                for group in range((ti.min(BATCH, end - first) + 31) // 32):
                    bits = ti.bit_cast(shared[CELL_BITS + 4 * (group * 32 + cell)], ti.u32)
                    while (bits != ti.u32(0)) & (T.max() > 0.0):
                        splat = fetched(shared, group * 32 + first_of(bits), 12)
                        bits &= bits - ti.u32(1)
                        dx, dy = x + 0.5 - splat[0], y + 0.5 - splat[1]
                        tilt, base = splat[5] * dx, splat[2] - splat[4] * dx * dx
                        for p in ti.static(range(pixels)):  # without branches: most splats of a cell touch some pixel
                            power = base - (dy + p * ROW_STEP) * (tilt + splat[6] * (dy + p * ROW_STEP))
                            alpha = ti.select(power < -CUTOFF_BITS, 0.0, ti.min(ALPHA_MAX, exp2(power)))
                            weight = alpha * T[p]
                            after = T[p] - weight
                            visible = after > MIN_TRANSMITTANCE
                            weight = ti.select(visible, weight, 0.0)
                            T[p] = ti.select(visible, after, -ti.abs(T[p]))
                            if ti.static(self.with_depth):
                                depth[p] += weight * splat[3]
                            if ti.static(self.with_color):
                                red[p] += weight * splat[7]
                                green[p] += weight * splat[8]
                                blue[p] += weight * splat[9]
            for p in ti.static(range(pixels)):
                if self.projection.inside(x, y + p * ROW_STEP):
                    rgb = ti.math.vec3(red[p], green[p], blue[p])
                    sink.write(out, v * self.segments + s, y + p * ROW_STEP, x, rgb, depth[p], 1.0 - ti.abs(T[p]))

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
