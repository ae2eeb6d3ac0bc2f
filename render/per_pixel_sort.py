"""Front-to-back blending in each pixel's own order.

Splats come to a tile sorted by distance. Each pixel keeps the next few in a window sorted by where its own ray meets
them (render/ray_depth.py); when one more comes, the nearest is blended. What is out of order by fewer places than
the window has is put right.                                      Radl 2024 (StopThePop), local resorting
"""

import taichi as ti

from render.binning import TileBins
from render.blend import ACROSS, ALPHA_MAX, BATCH, CELL, CELL_BITS, CHECK, CPU_TILE, GPU_TILE, OPAQUE, QUAD, Blend, exp2
from render.footprint import STEPS
from render.radix_sort import value_of

WINDOW = 16  # splats; 8 leave twice the error in four fifths of the time (bench/NOTES.md)
CLEARLY = 1.0 + 1e-4  # times as near overtakes: what lies in one plane keeps its order, else rounding would shuffle it
THREADS = GPU_TILE[0] * GPU_TILE[1]  # one pixel a thread: its window takes all registers there are
NEAREST = 1e30  # [1/m] of places in the window that hold nothing: they leave first


@ti.data_oriented
class PerPixelSort(Blend):
    """Draws binned splats as `Blend` does, but each pixel in the order of its own ray, within `window` splats.

    A place in the window is (near, veil, name): 1/z where the ray meets the splat, its alpha, which Gaussian.
    The first place is the nearest. A new splat takes the place behind all that it does not overtake; those move up,
    and the first of them leaves.
    """

    def __init__(self, bins: TileBins, *, with_color: bool, with_depth: bool, window: int = WINDOW):
        super().__init__(bins, with_color=with_color, with_depth=with_depth)
        self.window = window

    @ti.func
    def _draw_cpu(self, sink: ti.template(), out: ti.template()):
        """One row of a tile a loop iteration; a finished pixel is as in Blend.

        Each place of the window is three vector registers over the row's pixels, so nothing branches: what misses
        a pixel comes as NEAREST and leaves at once, and after the last splat come `window` empty ones behind all.
        """
        ti.loop_config(block_dim=4 * CPU_TILE)
        for line in range(self.bins.projection.views * self.bins.tiles_per_view() * CPU_TILE):
            tile, row = line // CPU_TILE, line % CPU_TILE
            width, height, columns = self.grid[None][0], self.grid[None][1], self.grid[None][2]
            v, in_view = tile // self.bins.tiles_per_view(), tile % self.bins.tiles_per_view()
            x0, y = in_view % columns * CPU_TILE, in_view // columns * CPU_TILE + row
            T, red, green, blue, depth = across(1.0), across(0.0), across(0.0), across(0.0), across(0.0)
            near = [across(NEAREST) for _ in ti.static(range(self.window))]
            veil = [across(0.0) for _ in ti.static(range(self.window))]
            name = [across(0) for _ in ti.static(range(self.window))]
            weight, who = across(0.0), across(0)  # of what leaves
            begin, end = self.bins.begin[tile], self.bins.end[tile]
            stop = end + self.window
            if begin == end or y >= height:
                stop = begin
            met = 0
            for i in range(begin, stop):
                g, touches, missing = 0, True, 0.0
                base, tilt, A, dx0, middle, slope = -2 * STEPS, 0.0, 0.0, 0.0, 0.0, 0.0
                if i < end:
                    g, missing = value_of(self.bins.members[i]), NEAREST
                    place, conic, box = self.place[v, g], self.conic[v, g], self.box[v, g]
                    dx0, dy = x0 + 0.5 - place.x, y + 0.5 - place.y
                    touches = ti.abs(dy) <= box[1]
                    A, tilt, base = conic[0], 2 * conic[1] * dy, place.z - conic[2] * dy * dy
                    middle, slope = 1.0 / place.w + self.color[v, g][3] * dy, box[3]
                if touches:
                    for q in range(CPU_TILE):
                        dx = dx0 + q
                        power = base - dx * (A * dx + tilt)
                        alpha = exp2(power)
                        alpha = ti.select(alpha < ALPHA_MAX, alpha, ALPHA_MAX)
                        alpha = ti.select(power < -STEPS, 0.0, alpha)
                        n = ti.select(power < -STEPS, missing, middle + slope * dx)
                        stays = n <= CLEARLY * near[0][q]  # behind all places so far
                        leaving = ti.select(stays, veil[0][q], alpha)
                        who[q] = ti.select(stays, name[0][q], g)
                        for k in ti.static(range(1, self.window)):
                            behind = stays & (n <= CLEARLY * near[k][q])
                            near[k - 1][q] = ti.select(behind, near[k][q], ti.select(stays, n, near[k - 1][q]))
                            veil[k - 1][q] = ti.select(behind, veil[k][q], ti.select(stays, alpha, veil[k - 1][q]))
                            name[k - 1][q] = ti.select(behind, name[k][q], ti.select(stays, g, name[k - 1][q]))
                            stays = behind
                        near[self.window - 1][q] = ti.select(stays, n, near[self.window - 1][q])
                        veil[self.window - 1][q] = ti.select(stays, alpha, veil[self.window - 1][q])
                        name[self.window - 1][q] = ti.select(stays, g, name[self.window - 1][q])
                        before = T[q]
                        after = before * (1.0 - leaving)
                        goes_on = after > OPAQUE
                        weight[q] = ti.select(goes_on, leaving * before, 0.0)
                        T[q] = ti.select(goes_on, after, -ti.abs(before))
                    for q in range(CPU_TILE):
                        if ti.static(self.with_color):
                            red[q] += weight[q] * self.color[v, who[q]][0]
                            green[q] += weight[q] * self.color[v, who[q]][1]
                            blue[q] += weight[q] * self.color[v, who[q]][2]
                        if ti.static(self.with_depth):
                            depth[q] += weight[q] * self.place[v, who[q]][3]
                    met += 1
                    if met % CHECK == 0:
                        alive = 0
                        for q in range(CPU_TILE):
                            alive += ti.cast(T[q] > 0, ti.i32)
                        if alive == 0:
                            break
            for q in range(CPU_TILE):
                if x0 + q < width and y < height:
                    rgb = ti.math.vec3(red[q], green[q], blue[q])
                    sink.write(out, v, y, x0 + q, rgb, depth[q], 1.0 - ti.abs(T[q]))

    @ti.func
    def _draw_gpu(self, sink: ti.template(), out: ti.template()):
        """One tile a block of threads, one pixel a thread; splats come through shared memory in batches.

        The window's places are known to the compiler, so that it stays in registers. Colours are read when a splat
        leaves, by then its batch may be gone.
        """
        ti.loop_config(block_dim=THREADS)
        for thread in range(self.bins.projection.views * self.bins.tiles_per_view() * THREADS):
            tile, lane = thread // THREADS, thread % THREADS
            width, height, columns = self.grid[None][0], self.grid[None][1], self.grid[None][2]
            v, in_view = tile // self.bins.tiles_per_view(), tile % self.bins.tiles_per_view()
            x0, y0 = in_view % columns * GPU_TILE[0], in_view // columns * GPU_TILE[1]
            cell, member = lane // (CELL * CELL), lane % (CELL * CELL)  # a cell is two warps
            x, y = x0 + cell % ACROSS * CELL + member % CELL, y0 + cell // ACROSS * CELL + member // CELL
            shared = ti.simt.block.SharedArray((3 * QUAD,), ti.f32)
            T, depth, rgb = 1.0, 0.0, ti.math.vec3(0.0)
            near, veil = ti.Vector([NEAREST] * self.window), ti.Vector([0.0] * self.window)
            name = ti.Vector([0] * self.window)
            done = 0
            if x >= width or y >= height:
                done = 1
            begin, end = self.bins.begin[tile], self.bins.end[tile]
            for batch in range((end - begin + BATCH - 1) // BATCH):
                # the barrier also keeps the last batch in place until every thread has read it
                if ti.simt.block.sync_all_nonzero(done) != 0:
                    break
                first = begin + batch * BATCH
                for load in range((BATCH + THREADS - 1) // THREADS):
                    j = load * THREADS + lane
                    if j < BATCH:  # the same for the whole warp
                        self._load(shared, v, first + j, j, ti.cast(first + j < end, ti.i32), x0, y0)
                ti.simt.block.sync()
                for group in range((ti.min(BATCH, end - first) + 31) // 32):
                    bits = ti.bit_cast(shared[CELL_BITS + 4 * (group * 32 + cell)], ti.u32)
                    while (bits != ti.u32(0)) & (done == 0):
                        less = bits - ti.u32(1)
                        j = group * 32 + ti.cast(ti.math.popcnt(less & ~bits), ti.i32)
                        bits &= less
                        splat = ti.Vector([0.0] * 10)
                        for k in ti.static(range(10)):
                            splat[k] = shared[QUAD * (k // 4) + 4 * (j & (BATCH - 1)) + k % 4]
                        dx, dy = x + 0.5 - splat[0], y + 0.5 - splat[1]
                        power = splat[2] - dx * (splat[4] * dx + splat[5] * dy) - splat[6] * dy * dy
                        if power >= -STEPS:
                            n = splat[3] + splat[7] * dx + splat[8] * dy
                            alpha, g = ti.min(ALPHA_MAX, exp2(power)), ti.bit_cast(splat[9], ti.i32)
                            leaving, who = alpha, g
                            stays = n <= CLEARLY * near[0]  # behind all places so far
                            if stays:
                                leaving, who = veil[0], name[0]
                                for k in ti.static(range(1, self.window)):
                                    behind = stays & (n <= CLEARLY * near[k])
                                    near[k - 1] = ti.select(behind, near[k], ti.select(stays, n, near[k - 1]))
                                    veil[k - 1] = ti.select(behind, veil[k], ti.select(stays, alpha, veil[k - 1]))
                                    name[k - 1] = ti.select(behind, name[k], ti.select(stays, g, name[k - 1]))
                                    stays = behind
                                if stays:
                                    near[self.window - 1], veil[self.window - 1] = n, alpha
                                    name[self.window - 1] = g
                            if T * (1.0 - leaving) <= OPAQUE:
                                done = 1
                            elif leaving > 0:
                                rgb, depth = self._laid(rgb, depth, leaving * T, v, who)
                                T *= 1.0 - leaving
            for k in ti.static(range(self.window)):
                if T * (1.0 - veil[k]) <= OPAQUE:
                    done = 1
                if done == 0 and veil[k] > 0:
                    rgb, depth = self._laid(rgb, depth, veil[k] * T, v, name[k])
                    T *= 1.0 - veil[k]
            if x < width and y < height:
                sink.write(out, v, y, x, rgb, depth, 1.0 - T)

    @ti.func
    def _words(self, v, g, place, conic):
        """What shared memory holds of a splat: x, y, log2 opacity, 1/z, A, 2 B, C, gx, gy, which Gaussian."""
        x, y, log_opacity, near = place[0], place[1], place[2], 1.0 / place[3]
        A, B2, C = conic[0], 2 * conic[1], conic[2]
        name = ti.bit_cast(g, ti.f32)
        return ti.Vector([x, y, log_opacity, near, A, B2, C, self.box[v, g][3], self.color[v, g][3], name])

    @ti.func
    def _laid(self, rgb: ti.math.vec3, depth: ti.f32, weight: ti.f32, v: ti.i32, g: ti.i32):
        """The sums with splat `g` of view `v` added."""
        if ti.static(self.with_color):
            for k in ti.static(range(3)):
                rgb[k] += weight * self.color[v, g][k]
        if ti.static(self.with_depth):
            depth += weight * self.place[v, g][3]
        return rgb, depth


@ti.func
def across(value):
    """One number per pixel of a tile's row on the CPU."""
    return ti.Vector([value] * CPU_TILE)
