"""Front-to-back blending of a tile's splats.

C = sum c_i alpha_i T_i,  T_i = prod_{j<i} (1 - alpha_j),
alpha_i = min(0.999, o_i exp(-0.5 d^T Sigma_2D^-1 d)).                    Kerbl 2023, eq. 3
"""

import taichi as ti

from render.binning import TileBins
from render.footprint import STEPS
from render.radix_sort import value_of

ALPHA_MAX = 0.999  # as gsplat: a pixel never becomes fully opaque, so its weights stay finite
OPAQUE = 1e-4  # a pixel is finished before its transmittance would sink to this
CPU_TILE = 8  # [px] a row of a tile is one vector register of floats
CHECK = 16  # splats between two looks at whether a tile is finished
CELL, PIXELS = 8, 2  # [px] a cell is one warp, whose threads have 2 pixels each
ROWS = 32 // CELL  # [px] between a thread's pixels
ACROSS, DOWN = 4, 2  # cells of a tile, which is one block of threads; larger ones make fewer pairs to sort
GPU_TILE = (ACROSS * CELL, DOWN * CELL)  # [px]
THREADS = 32 * ACROSS * DOWN
BATCH = 512  # splats that are in shared memory at a time; a power of two
QUAD = 4 * BATCH  # words of shared memory between quads of a splat: its first four numbers, the next, the last two
CELL_BITS = 2 * QUAD + 2  # and then which of 32 splats touch a cell


@ti.func
def exp2(x: ti.f32) -> ti.f32:
    """2^x for -STEPS <= x <= 0.01, relative error 4e-6; any number outside.

    (2^(x/16))^16 with a polynomial for the inner part: nothing but products, which a CPU does for a whole
    vector, and half as many instructions as the library's function on CUDA.
    """
    y = 0.0009379154316623323 + x * (1.3388277327798619e-05 + x * 1.2325647990480442e-07)
    y = 0.9999999187056234 + x * (0.04332121602645622 + x * y)
    y *= y
    y *= y
    y *= y
    return y * y


@ti.data_oriented
class Blend:
    """Draws binned splats; `with_color` and `with_depth` say which sums are wanted, the others stay 0."""

    def __init__(self, bins: TileBins, *, with_color: bool, with_depth: bool):
        self.bins = bins
        projection = bins.projection
        self.place, self.conic = projection.place, projection.conic
        self.color, self.box = projection.color, projection.box
        self.grid = projection.grid
        self.with_color, self.with_depth = with_color, with_depth
        self.on_gpu = ti.cfg.arch == ti.cuda

    @ti.func
    def draw(self, sink: ti.template(), out: ti.template()):
        """Blend all tiles; outermost level of a kernel that has no other shared arrays (render/shared_arrays.py).

        Out: `sink.write(out, v, y, x, rgb, depth, alpha)` receives each pixel of view v once:
        rgb = sum w c, depth = sum w z, alpha = sum w, with w = alpha_i T_i.
        """
        if ti.static(self.on_gpu):
            self._draw_gpu(sink, out)
        else:
            self._draw_cpu(sink, out)

    @ti.func
    def _draw_cpu(self, sink: ti.template(), out: ti.template()):
        """One tile a loop iteration; its pixels' states are arrays that stay in the first-level cache.

        A finished pixel keeps its transmittance with a minus sign: no product of it can pass the
        test against OPAQUE again, and the loop over a row needs no branch.
        """
        ti.loop_config(block_dim=4)
        for tile in range(self.bins.projection.views * self.bins.tiles_per_view()):
            width, height, columns = self.grid[None][0], self.grid[None][1], self.grid[None][2]
            v, in_view = tile // self.bins.tiles_per_view(), tile % self.bins.tiles_per_view()
            x0, y0 = in_view % columns * CPU_TILE, in_view // columns * CPU_TILE
            T, red, green, blue, depth = filled(1.0), filled(0.0), filled(0.0), filled(0.0), filled(0.0)
            top, bottom = 0, CPU_TILE - 1  # rows that are not finished
            for i in range(self.bins.begin[tile], self.bins.end[tile]):
                g = value_of(self.bins.members[i])
                place, conic, color = self.place[v, g], self.conic[v, g], self.color[v, g]
                A, B, C = conic[0], 2 * conic[1], conic[2]
                half_height = self.box[v, g][1]
                dx0, dy0 = x0 + 0.5 - place.x, y0 + 0.5 - place.y
                first = ti.max(top, ti.cast(ti.ceil(ti.max(-dy0 - half_height, 0.0)), ti.i32))
                last = ti.min(bottom, ti.cast(ti.floor(ti.min(half_height - dy0, CPU_TILE - 1.0)), ti.i32))
                for row in range(first, last + 1):
                    dy = dy0 + row
                    base, tilt = place.z - C * dy * dy, B * dy
                    for column in range(CPU_TILE):
                        q = (row & (CPU_TILE - 1)) * CPU_TILE + column  # the mask tells the compiler that q cannot wrap
                        dx = dx0 + column
                        power = base - dx * (A * dx + tilt)
                        alpha = exp2(power)
                        alpha = ti.select(alpha < ALPHA_MAX, alpha, ALPHA_MAX)
                        alpha = ti.select(power < -STEPS, 0.0, alpha)
                        before = T[q]
                        after = before * (1.0 - alpha)
                        goes_on = after > OPAQUE
                        weight = ti.select(goes_on, alpha * before, 0.0)
                        T[q] = ti.select(goes_on, after, -ti.abs(before))
                        if ti.static(self.with_color):
                            red[q] += weight * color.r
                            green[q] += weight * color.g
                            blue[q] += weight * color.b
                        if ti.static(self.with_depth):
                            depth[q] += weight * place.w
                if (i - self.bins.begin[tile]) % CHECK == CHECK - 1:
                    top, bottom = CPU_TILE, -1
                    for row in range(CPU_TILE):
                        alive = 0
                        for column in range(CPU_TILE):
                            alive += ti.cast(T[row * CPU_TILE + column] > 0, ti.i32)
                        if alive > 0:
                            top, bottom = ti.min(top, row), row
                    if bottom < 0:
                        break
            for q in range(CPU_TILE * CPU_TILE):
                x, y = x0 + q % CPU_TILE, y0 + q // CPU_TILE
                if x < width and y < height:
                    rgb = ti.math.vec3(red[q], green[q], blue[q])
                    sink.write(out, v, y, x, rgb, depth[q], 1.0 - ti.abs(T[q]))

    @ti.func
    def _draw_gpu(self, sink: ti.template(), out: ti.template()):
        """One tile a block of threads, one cell of 8 x 8 pixels a warp, PIXELS of a column a thread.

        Splats come through shared memory in batches. Who loads a splat finds the cells that it touches; a warp gets
        them as one bit a splat and goes through the set bits, so that what a cell does not see costs it nothing.
        """
        ti.loop_config(block_dim=THREADS)
        for thread in range(self.bins.projection.views * self.bins.tiles_per_view() * THREADS):
            tile, lane = thread // THREADS, thread % THREADS
            width, height, columns = self.grid[None][0], self.grid[None][1], self.grid[None][2]
            v, in_view = tile // self.bins.tiles_per_view(), tile % self.bins.tiles_per_view()
            x0, y0 = in_view % columns * GPU_TILE[0], in_view // columns * GPU_TILE[1]
            cell, member = lane // 32, lane % 32
            x, y = x0 + cell % ACROSS * CELL + member % CELL, y0 + cell // ACROSS * CELL + member // CELL
            shared = ti.simt.block.SharedArray((3 * QUAD,), ti.f32)
            T, depth = ti.Vector([1.0] * PIXELS), ti.Vector([0.0] * PIXELS)
            least = ti.Vector([OPAQUE] * PIXELS)  # what T must stay above to go on; no T is above 1
            red, green, blue = ti.Vector([0.0] * PIXELS), ti.Vector([0.0] * PIXELS), ti.Vector([0.0] * PIXELS)
            for p in ti.static(range(PIXELS)):
                if x >= width or y + p * ROWS >= height:
                    least[p] = 1.0
            begin, end = self.bins.begin[tile], self.bins.end[tile]
            for batch in range((end - begin + BATCH - 1) // BATCH):
                # the barrier also keeps the last batch in place until every thread has read it
                if ti.simt.block.sync_all_nonzero(ti.cast(least.min() == 1.0, ti.i32)) != 0:
                    break
                first = begin + batch * BATCH
                for load in range((BATCH + THREADS - 1) // THREADS):
                    j = load * THREADS + lane
                    if j < BATCH:  # the same for the whole warp
                        self._load(shared, v, first + j, j, ti.cast(first + j < end, ti.i32), x0, y0)
                ti.simt.block.sync()
                for group in range((ti.min(BATCH, end - first) + 31) // 32):
                    bits = ti.bit_cast(shared[CELL_BITS + 4 * (group * 32 + cell)], ti.u32)
                    while (bits != ti.u32(0)) & (least.min() < 1.0):
                        less = bits - ti.u32(1)
                        j = group * 32 + ti.cast(ti.math.popcnt(less & ~bits), ti.i32)
                        bits &= less
                        splat = ti.Vector([0.0] * 12)
                        for k in ti.static(range(12)):  # in a row and within known bounds: three wide loads
                            splat[k] = shared[QUAD * (k // 4) + 4 * (j & (BATCH - 1)) + k % 4]
                        dx, dy = x + 0.5 - splat[0], y + 0.5 - splat[1]
                        tilt, base = splat[5] * dx, splat[2] - splat[4] * dx * dx
                        for p in ti.static(range(PIXELS)):  # without branches: in a cell there is a pixel for most
                            power = base - (dy + p * ROWS) * (tilt + splat[6] * (dy + p * ROWS))
                            alpha = ti.select(power < -STEPS, 0.0, ti.min(ALPHA_MAX, exp2(power)))
                            after = T[p] - alpha * T[p]
                            goes_on = after > least[p]
                            least[p] = ti.select(goes_on, least[p], 1.0)
                            after = ti.select(goes_on, after, T[p])
                            weight = T[p] - after
                            T[p] = after
                            if ti.static(self.with_depth):
                                depth[p] += weight * splat[3]
                            if ti.static(self.with_color):
                                red[p] += weight * splat[7]
                                green[p] += weight * splat[8]
                                blue[p] += weight * splat[9]
            for p in ti.static(range(PIXELS)):
                if x < width and y + p * ROWS < height:
                    rgb = ti.math.vec3(red[p], green[p], blue[p])
                    sink.write(out, v, y + p * ROWS, x, rgb, depth[p], 1.0 - T[p])

    @ti.func
    def _words(self, v, g, place, conic):
        """What shared memory holds of a splat: x, y, log2 opacity, z, A, 2 B, C, r, g, b."""
        color = ti.math.vec4(0.0)
        if ti.static(self.with_color):
            color = self.color[v, g]
        x, y, log_opacity, z = place[0], place[1], place[2], place[3]
        A, B2, C = conic[0], 2 * conic[1], conic[2]
        return ti.Vector([x, y, log_opacity, z, A, B2, C, color[0], color[1], color[2]])

    @ti.func
    def _load(self, shared: ti.template(), v, i, j, exists, x0, y0):
        """Put member `i` of the bins in place `j` of the batch, and a bit for it with every cell that it touches."""
        touches = 0  # a bit for each cell
        if exists != 0:
            g = value_of(self.bins.members[i])
            place, conic, box = self.place[v, g], self.conic[v, g], self.box[v, g]
            at, words = 4 * (j & (BATCH - 1)), self._words(v, g, place, conic)
            for k in ti.static(range(10)):
                shared[QUAD * (k // 4) + at + k % 4] = words[k]
            for row in ti.static(range(DOWN)):
                top = y0 + row * CELL + 0.5
                if place.y - box[1] <= top + (CELL - 1) and place.y + box[1] >= top:
                    left, right = self.bins.projection.ends(top, top + (CELL - 1), place, conic, box)
                    for column in ti.static(range(ACROSS)):
                        if left <= x0 + column * CELL + CELL - 0.5 and right >= x0 + column * CELL + 0.5:
                            touches |= 1 << (row * ACROSS + column)
        everyone = ti.u32(0xFFFFFFFF)
        for cell in ti.static(range(ACROSS * DOWN)):
            own = (touches >> cell) & 1
            ones = ti.cast(ti.simt.warp.match_any(everyone, own), ti.u32)  # who has the same bit
            if own == 0:
                ones = ~ones
            if j % 32 == cell:
                shared[CELL_BITS + 4 * j] = ti.bit_cast(ones, ti.f32)


@ti.func
def filled(value: ti.f32):
    """One number per pixel of a CPU tile."""
    return ti.Vector([value] * (CPU_TILE * CPU_TILE))
