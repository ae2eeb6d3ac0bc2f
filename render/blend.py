"""Front-to-back blending of a tile's splats.

C = sum c_i alpha_i T_i,  T_i = prod_{j<i} (1 - alpha_j),
alpha_i = min(0.999, o_i exp(-0.5 d^T Sigma_2D^-1 d)).                    Kerbl 2023, eq. 3
"""

import taichi as ti

from render.bin import Bins
from render.project import STEPS
from render.shared import WORDS

ALPHA_MAX = 0.999  # as gsplat: a pixel never becomes fully opaque, so its weights stay finite
OPAQUE = 1e-4  # a pixel is finished before its transmittance would sink to this
CPU_TILE = 8  # [px] a row of a tile is one vector register of floats
GPU_TILE = 16  # [px] a tile is one block of 256 threads
CHECK = 16  # splats between two looks at whether a tile is finished
BLOCK = GPU_TILE * GPU_TILE
SHARED_FLOATS = WORDS // BLOCK  # 12: x, y, log2 opacity, z; A, B, C; r, g, b; the rest aligns


@ti.func
def exp2(x: ti.f32) -> ti.f32:
    """2^x for -126 < x <= 0, relative error 3e-6; any number outside.

    On the CPU a polynomial, which the compiler vectorises (a call to the C library it would not).
    """
    result = 0.0
    if ti.static(ti.cfg.arch == ti.cuda):
        result = ti.exp(x * 0.6931471805599453)
    else:
        whole = ti.floor(x)
        f = x - whole
        y = 1.0000026 + f * (0.6930038 + f * (0.24144275 + f * (0.052011475 + f * 0.01353416)))
        result = ti.bit_cast(ti.bit_cast(y, ti.i32) + (ti.cast(whole, ti.i32) << 23), ti.f32)
    return result


@ti.data_oriented
class Blend:
    """Draws binned splats; `with_color` and `with_depth` say which sums are wanted, the others stay 0."""

    def __init__(self, bins: Bins, *, with_color: bool, with_depth: bool):
        self.bins = bins
        projection = bins.projection
        self.place, self.conic = projection.place, projection.conic
        self.color, self.box = projection.color, projection.box
        self.grid = projection.grid
        self.with_color, self.with_depth = with_color, with_depth
        self.on_gpu = ti.cfg.arch == ti.cuda

    @ti.func
    def draw(self, sink: ti.template(), out: ti.template()):
        """Blend all tiles; outermost level of a kernel.

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
                g = self.bins.members[i][1]
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
        """One tile a block of threads, one pixel a thread; splats come through shared memory in batches."""
        ti.loop_config(block_dim=BLOCK)
        for thread in range(self.bins.projection.views * self.bins.tiles_per_view() * BLOCK):
            tile, lane = thread // BLOCK, thread % BLOCK
            width, height, columns = self.grid[None][0], self.grid[None][1], self.grid[None][2]
            v, in_view = tile // self.bins.tiles_per_view(), tile % self.bins.tiles_per_view()
            x = in_view % columns * GPU_TILE + lane % GPU_TILE
            y = in_view // columns * GPU_TILE + lane // GPU_TILE
            shared = ti.simt.block.SharedArray((WORDS,), ti.f32)
            T, depth, rgb = 1.0, 0.0, ti.math.vec3(0.0)
            done = 0
            if x >= width or y >= height:
                done = 1
            begin, end = self.bins.begin[tile], self.bins.end[tile]
            for batch in range((end - begin + BLOCK - 1) // BLOCK):
                # the barrier also keeps the last batch in place until every thread has read it
                if ti.simt.block.sync_all_nonzero(done) != 0:
                    break
                size = ti.min(BLOCK, end - begin - batch * BLOCK)
                if lane < size:
                    g = self.bins.members[begin + batch * BLOCK + lane][1]
                    place, conic, color = self.place[v, g], self.conic[v, g], self.color[v, g]
                    for k in ti.static(range(4)):
                        shared[lane * SHARED_FLOATS + k] = place[k]
                    for k in ti.static(range(3)):
                        shared[lane * SHARED_FLOATS + 4 + k] = conic[k]
                        if ti.static(self.with_color):
                            shared[lane * SHARED_FLOATS + 7 + k] = color[k]
                ti.simt.block.sync()
                for j in range(size):
                    if done != 0:
                        break
                    s = j * SHARED_FLOATS
                    dx, dy = x + 0.5 - shared[s], y + 0.5 - shared[s + 1]
                    power = shared[s + 2] - shared[s + 4] * dx * dx - shared[s + 6] * dy * dy
                    power -= 2 * shared[s + 5] * dx * dy
                    if power >= -STEPS:
                        alpha = ti.min(ALPHA_MAX, exp2(power))
                        after = T * (1.0 - alpha)
                        if after <= OPAQUE:
                            done = 1
                        else:
                            weight = alpha * T
                            T = after
                            if ti.static(self.with_depth):
                                depth += weight * shared[s + 3]
                            if ti.static(self.with_color):
                                for k in ti.static(range(3)):
                                    rgb[k] += weight * shared[s + 7 + k]
            if x < width and y < height:
                sink.write(out, v, y, x, rgb, depth, 1.0 - T)


@ti.func
def filled(value: ti.f32):
    """One number per pixel of a CPU tile."""
    return ti.Vector([value] * (CPU_TILE * CPU_TILE))
