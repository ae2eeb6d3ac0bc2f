"""Front-to-back blending in each pixel's own order.

Splats come to a tile sorted by distance. Each pixel keeps the next few in a buffer (a k-buffer), sorted by the distance
at which its own ray meets them (`footprint.depth_slope`); when one more comes, the nearest is blended. Splats out of
order by fewer places than the buffer has are put right.             Radl 2024 (StopThePop), local resorting
"""

import taichi as ti

from core.lanes import dealt, first_of
from render.binning import TileBins
from render.blend import (
    ALPHA_MAX,
    BATCH,
    CELL,
    CELL_BITS,
    CHECK_INTERVAL,
    CPU_TILE,
    GPU_TILE,
    MIN_TRANSMITTANCE,
    QUAD,
    blended,
    exp2,
    fetched,
    load_batch,
    pixel_of,
    splat_color,
)
from render.footprint import CUTOFF_BITS
from render.radix_sort import value_of

BUFFER_SIZE = 16  # splats; 8 leave twice the error in four fifths of the time (bench/NOTES.md)
OVERTAKE_RATIO = 1.0 + 1e-4  # a splat overtakes if nearer by this factor: coplanar ones keep their order under rounding
PIXEL_THREADS = GPU_TILE[0] * GPU_TILE[1]  # one pixel per thread: its buffer takes all registers there are
EMPTY_INV_DEPTH = 1e30  # [1/m] of empty places in the buffer: they leave first


@ti.data_oriented
class PerPixelSort:
    """Draws binned splats as `Blend` does, but each pixel in the order of its own ray, within `buffer_size` splats.

    A place of the buffer holds the inverse depth at which the ray meets the splat, its alpha, and the Gaussian's index.
    The first place is the nearest. A new splat takes the place behind all that it does not overtake; those move up,
    and the first of them leaves.
    """

    def __init__(
        self, bins: TileBins, *, with_color: bool, with_depth: bool, color=None, buffer_size: int = BUFFER_SIZE
    ):
        self.bins, self.projection = bins, bins.projection
        self.color, self.other_color = color, color is not None
        self.with_color, self.with_depth, self.buffer_size = with_color, with_depth, buffer_size
        self.on_gpu, self.keeps_index = ti.cfg.arch == ti.cuda, False

    @ti.func
    def draw(self, sink: ti.template(), out: ti.template()):
        """Blend all tiles; see `Blend.draw`."""
        if ti.static(self.on_gpu):
            self._draw_gpu(sink, out)
        else:
            self._draw_cpu(sink, out)

    @ti.func
    def _draw_cpu(self, sink: ti.template(), out: ti.template()):
        """One row of a tile per loop iteration; a finished pixel is as in Blend.

        Each place of the buffer is three vector registers over the row's pixels, so nothing branches: a splat that
        misses a pixel enters with EMPTY_INV_DEPTH and leaves at once; the last one is followed by `buffer_size` empty
        splats behind all others.
        """
        lines = self.projection.views * self.bins.tiles_per_view() * CPU_TILE
        for k in range(lines):
            line = dealt(k, lines)
            tile, row = line // CPU_TILE, line % CPU_TILE
            if not self.projection.draws(tile):
                continue
            v, x0, y0 = self.projection.place_of(tile, (CPU_TILE, CPU_TILE))
            y = y0 + row
            T, red, green, blue, depth = across(1.0), across(0.0), across(0.0), across(0.0), across(0.0)
            inv_depths = [across(EMPTY_INV_DEPTH) for _ in ti.static(range(self.buffer_size))]
            alphas = [across(0.0) for _ in ti.static(range(self.buffer_size))]
            indices = [across(0) for _ in ti.static(range(self.buffer_size))]
            weight, front_index = across(0.0), across(0)
            begin, end = self.bins.begin[tile], self.bins.end[tile]
            stop = end + self.buffer_size
            if begin == end or not self.projection.inside(x0, y):
                stop = begin
            visited = 0
            for i in range(begin, stop):
                touches, g, dx0, A, tilt, base, center, slope, missing = self._along_row(i, end, v, x0, y)
                if touches:
                    for q in range(CPU_TILE):
                        dx = dx0 + q
                        power = base - dx * (A * dx + tilt)
                        alpha = exp2(power)
                        alpha = ti.select(alpha < ALPHA_MAX, alpha, ALPHA_MAX)
                        alpha = ti.select(power < -CUTOFF_BITS, 0.0, alpha)
                        inv_depth = ti.select(power < -CUTOFF_BITS, missing, center + slope * dx)
                        front_alpha, front_index[q] = entered(inv_depths, alphas, indices, q, inv_depth, alpha, g)
                        weight[q], T[q] = blended(T[q], front_alpha, 1.0, False)  # what has left
                    for q in range(CPU_TILE):
                        if ti.static(self.with_color):
                            color = splat_color(self, v, front_index[q])
                            red[q] += weight[q] * color.r
                            green[q] += weight[q] * color.g
                            blue[q] += weight[q] * color.b
                        if ti.static(self.with_depth):
                            depth[q] += weight[q] * self.projection.mean2d[v, front_index[q]][3]
                    visited += 1
                    if visited % CHECK_INTERVAL == 0:
                        alive = 0
                        for q in range(CPU_TILE):
                            alive += ti.cast(T[q] > 0, ti.i32)
                        if alive == 0:
                            break
            for q in range(CPU_TILE):
                if self.projection.inside(x0 + q, y):
                    rgb = ti.math.vec3(red[q], green[q], blue[q])
                    sink.write(out, v, y, x0 + q, rgb, depth[q], 1.0 - ti.abs(T[q]))

    @ti.func
    def _along_row(self, i: ti.i32, end: ti.i32, v: ti.i32, x0: ti.i32, y: ti.i32):
        """True if member i of the bins touches a row of pixels, its Gaussian, and its numbers along the row.

        log2 alpha = base - dx (A dx + tilt) and 1/z = center + slope dx, at dx = dx0 + q of pixel q; `missing`: 1/z of
        pixels outside its ellipse. From `end` on: an empty splat, behind all others.
        """
        g, touches, missing = 0, True, 0.0
        base, tilt, A, dx0, center, slope = -2 * CUTOFF_BITS, 0.0, 0.0, 0.0, 0.0, 0.0
        if i < end:
            g, missing = value_of(self.bins.members[i]), EMPTY_INV_DEPTH
            mean2d, conic = self.projection.mean2d[v, g], self.projection.conic[v, g]
            dx0, dy = x0 + 0.5 - mean2d.x, y + 0.5 - mean2d.y
            touches = ti.abs(dy) <= self.projection.color[v, g][3]
            A, tilt, base = conic[0], 2 * conic[1] * dy, mean2d.z - conic[2] * dy * dy
            change = self.projection.slope[v, g]
            center, slope = 1.0 / mean2d.w + change.y * dy, change.x
        return touches, g, dx0, A, tilt, base, center, slope, missing

    @ti.func
    def _draw_gpu(self, sink: ti.template(), out: ti.template()):
        """One tile per block of threads, one pixel per thread.

        All indices into the buffer are compile-time constants, so that it stays in registers. Colours are read when a
        splat leaves: by then its batch may have been replaced.
        """
        ti.loop_config(block_dim=PIXEL_THREADS)
        for thread in range(self.projection.views * self.bins.tiles_per_view() * PIXEL_THREADS):
            tile, lane = thread // PIXEL_THREADS, thread % PIXEL_THREADS
            v, x0, y0 = self.projection.place_of(tile, GPU_TILE)
            cell, member = lane // (CELL * CELL), lane % (CELL * CELL)  # a cell is two warps
            x, y = pixel_of(x0, y0, cell, member, CELL)
            shared = ti.simt.block.SharedArray((3 * QUAD,), ti.f32)
            T, depth, rgb = 1.0, 0.0, ti.math.vec3(0.0)
            inv_depths, alphas = ti.Vector([EMPTY_INV_DEPTH] * self.buffer_size), ti.Vector([0.0] * self.buffer_size)
            indices = ti.Vector([0] * self.buffer_size)
            done = 0
            if not self.projection.inside(x, y):
                done = 1
            begin, end = self.bins.begin[tile], self.bins.end[tile]
            for batch in range((end - begin + BATCH - 1) // BATCH):
                # the barrier also keeps the last batch in place until every thread has read it
                if ti.simt.block.sync_all_nonzero(done) != 0:
                    break
                first = begin + batch * BATCH
                load_batch(self, shared, v, first, end, lane, PIXEL_THREADS)
                for group in range((ti.min(BATCH, end - first) + 31) // 32):
                    bits = ti.bit_cast(shared[CELL_BITS + 4 * (group * 32 + cell)], ti.u32)
                    while (bits != ti.u32(0)) & (done == 0):
                        splat = fetched(shared, group * 32 + first_of(bits), 10)
                        bits &= bits - ti.u32(1)
                        dx, dy = x + 0.5 - splat[0], y + 0.5 - splat[1]
                        power = splat[2] - dx * (splat[4] * dx + splat[5] * dy) - splat[6] * dy * dy
                        if power >= -CUTOFF_BITS:
                            inv_depth = splat[3] + splat[7] * dx + splat[8] * dy
                            alpha, g = ti.min(ALPHA_MAX, exp2(power)), ti.bit_cast(splat[9], ti.i32)
                            front_alpha, front_index = pushed(inv_depths, alphas, indices, inv_depth, alpha, g)
                            if T * (1.0 - front_alpha) <= MIN_TRANSMITTANCE:
                                done = 1
                            elif front_alpha > 0:
                                rgb, depth = self._blended(rgb, depth, front_alpha * T, v, front_index)
                                T *= 1.0 - front_alpha
            for k in ti.static(range(self.buffer_size)):
                if T * (1.0 - alphas[k]) <= MIN_TRANSMITTANCE:
                    done = 1
                if done == 0 and alphas[k] > 0:
                    rgb, depth = self._blended(rgb, depth, alphas[k] * T, v, indices[k])
                    T *= 1.0 - alphas[k]
            if self.projection.inside(x, y):
                sink.write(out, v, y, x, rgb, depth, 1.0 - T)

    @ti.func
    def words(self, v, g, mean2d, conic):
        """Numbers of a splat in shared memory: x, y, log2 opacity, 1/z, A, 2 B, C, gx, gy, Gaussian index."""
        x, y, log_opacity, inv_depth = mean2d[0], mean2d[1], mean2d[2], 1.0 / mean2d[3]
        A, B2, C = conic[0], 2 * conic[1], conic[2]
        change = self.projection.slope[v, g]
        return ti.Vector([x, y, log_opacity, inv_depth, A, B2, C, change.x, change.y, ti.bit_cast(g, ti.f32)])

    @ti.func
    def _blended(self, rgb: ti.math.vec3, depth: ti.f32, weight: ti.f32, v: ti.i32, g: ti.i32):
        """The sums of colour and depth, with splat `g` of view `v` added."""
        if ti.static(self.with_color):
            rgb += weight * splat_color(self, v, g)
        if ti.static(self.with_depth):
            depth += weight * self.projection.mean2d[v, g][3]
        return rgb, depth


@ti.func
def pushed(
    inv_depths: ti.template(),
    alphas: ti.template(),
    indices: ti.template(),
    inv_depth: ti.f32,
    alpha: ti.f32,
    g: ti.i32,
):
    """Put a splat into a pixel's buffer; alpha and index of the one that leaves, which may be the same.

    All indices are compile-time constants: the buffer's three vectors stay in registers.
    """
    last = ti.static(inv_depths.n - 1)
    front_alpha, front_index = alpha, g
    stays = inv_depth <= OVERTAKE_RATIO * inv_depths[0]  # behind all entries so far
    if stays:
        front_alpha, front_index = alphas[0], indices[0]
        for k in ti.static(range(1, last + 1)):
            behind = stays & (inv_depth <= OVERTAKE_RATIO * inv_depths[k])
            inv_depths[k - 1] = ti.select(behind, inv_depths[k], ti.select(stays, inv_depth, inv_depths[k - 1]))
            alphas[k - 1] = ti.select(behind, alphas[k], ti.select(stays, alpha, alphas[k - 1]))
            indices[k - 1] = ti.select(behind, indices[k], ti.select(stays, g, indices[k - 1]))
            stays = behind
        if stays:
            inv_depths[last], alphas[last], indices[last] = inv_depth, alpha, g
    return front_alpha, front_index


@ti.func
def entered(
    inv_depths: ti.template(), alphas: ti.template(), indices: ti.template(), q: ti.i32,
    inv_depth: ti.f32, alpha: ti.f32, g: ti.i32,
):  # fmt: skip
    """As `pushed`, without branches, for pixel q of a row: each place of the buffer holds a value for each of them."""
    last = ti.static(len(inv_depths) - 1)
    stays = inv_depth <= OVERTAKE_RATIO * inv_depths[0][q]  # behind all entries so far
    front_alpha, front_index = ti.select(stays, alphas[0][q], alpha), ti.select(stays, indices[0][q], g)
    for k in ti.static(range(1, last + 1)):
        behind = stays & (inv_depth <= OVERTAKE_RATIO * inv_depths[k][q])
        kept = ti.select(stays, inv_depth, inv_depths[k - 1][q])
        inv_depths[k - 1][q] = ti.select(behind, inv_depths[k][q], kept)
        alphas[k - 1][q] = ti.select(behind, alphas[k][q], ti.select(stays, alpha, alphas[k - 1][q]))
        indices[k - 1][q] = ti.select(behind, indices[k][q], ti.select(stays, g, indices[k - 1][q]))
        stays = behind
    inv_depths[last][q] = ti.select(stays, inv_depth, inv_depths[last][q])
    alphas[last][q] = ti.select(stays, alpha, alphas[last][q])
    indices[last][q] = ti.select(stays, g, indices[last][q])
    return front_alpha, front_index


@ti.func
def across(value):
    """A value for each pixel of a row of a CPU tile."""
    return ti.Vector([value] * CPU_TILE)
