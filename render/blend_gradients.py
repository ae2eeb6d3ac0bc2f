"""Backward pass of blending: gradients of the splats in a picture from the gradient of its pixels."""

import taichi as ti

from core.fields import FieldGroup
from core.lanes import first_of
from render.binning import TileBins
from render.blend import (
    ALPHA_MAX,
    BATCH,
    CELL,
    CELL_BITS,
    CHECK_INTERVAL,
    CPU_TILE,
    GPU_TILE,
    LN2,
    MIN_TRANSMITTANCE,
    PIXELS,
    QUAD,
    ROW_STEP,
    TILE_THREADS,
    blended,
    covered_rows,
    exp2,
    factors,
    fetched,
    filled,
    load_batch,
    pixel_of,
    splat_color,
    unfinished_rows,
)
from render.footprint import CUTOFF_BITS
from render.per_pixel_sort import BUFFER_SIZE, EMPTY_INV_DEPTH, PIXEL_THREADS, pushed
from render.radix_sort import value_of

BEHIND_ALL = 0.0  # [1/m] of empty splats that follow the last one: they drain the buffer
MIN_ALPHA = 1e-10  # least opacity by which a pixel's depth is divided, as in the picture
SUMS = 10  # accumulated numbers per Gaussian
GEOMETRY = 7  # of them, the first, which `into` shares

vec2, vec3, vec4 = ti.math.vec2, ti.math.vec3, ti.math.vec4


@ti.data_oriented
class BlendGradients:
    """Gradients of a loss with respect to binned splats of one view.

    In, fields of shape (height, width): `d_rgb` vec3, `d_alpha`, `d_depth`, derivatives with respect to the picture of
    a FloatImages sink, which has been drawn from the same bins. `with_depth=False`: the loss depends on colours alone,
    and the last two do not exist. `with_geometry=False`: d_color is wanted alone, which takes half the time on the CPU.

    Out, functions of a Gaussian, zero for those that are not in the picture:
    d_mean2d   (x, y [1/px], log2 opacity, camera z [1/m])
    d_conic    (A, B, C), as in `Projection.conic`
    d_color    (r, g, b)

    With `color`, vec3 (capacity,), the picture shows those three numbers per Gaussian instead of colours. With `into`,
    the BlendGradients of another picture from the same bins, d_mean2d and d_conic are shared: both add to them. With
    `background`, vec3 (1,), the picture's colours were laid over that colour: it acts as a splat behind all.

    With w_i = alpha_i T_i and s_i = dL/dC . c_i + dL/dD z_i + dL/dA, a pixel's loss changes by sum w_i s_i, and

        dL/dalpha_i = T_i s_i - (sum_{j > i} w_j s_j) / (1 - alpha_i).

    The sum behind i is that of the whole pixel, known from the picture, minus the sum up to i: so splats are traversed
    front to back as in the forward pass, and each pixel stops where it stopped there. Pixels that have an order
    of their own (sort="pixel", with a buffer of BUFFER_SIZE splats) are walked one by one.

    `sums` (capacity, SUMS) accumulate over pixels, with d their offset [px] from the splat's centre and p the
    derivative with respect to the exponent: p, p d_x, p d_y, p d_x^2, p d_x d_y, p d_y^2, then dL/dz, dL/dcolour.
    """

    def __init__(
        self, bins: TileBins, picture, *, with_depth: bool = True, with_geometry: bool = True, color=None,
        into: "BlendGradients | None" = None, background=None,
    ):  # fmt: skip
        self.bins, self.projection, self.picture = bins, bins.projection, picture
        self.color, self.other_color, self.adds = color, color is not None, into is not None
        self.background, self.has_background = background, background is not None
        self.with_geometry = with_geometry
        self.with_depth, self.on_gpu, self.keeps_index = with_depth, ti.cfg.arch == ti.cuda, True
        self.by_pixel = self.projection.with_slope
        if self.projection.views != 1:
            raise ValueError("gradients are those of one view")
        _, height, width = picture.alpha.shape
        self.fields = f = FieldGroup()
        self.d_rgb = f.vector(height, width)
        if with_depth:
            self.d_alpha, self.d_depth = f.scalar(height, width), f.scalar(height, width)
        self.sums = f.scalar(self.projection.splats.capacity, SUMS)
        self.geometry = self.sums if into is None else into.geometry
        f.build()

    def destroy(self) -> None:
        """Free the device memory."""
        self.fields.destroy()

    @ti.func
    def clear(self, begin: ti.i32, end: ti.i32):
        """Set the gradients of Gaussians [begin, end) to zero, except those of `into`; outermost level of a kernel."""
        for g in range(begin, end):
            for k in ti.static(range(SUMS)):
                self.sums[g, k] = 0.0

    @ti.func
    def d_mean2d(self, g: ti.i32) -> vec4:
        """Gradient with respect to (x, y, log2 opacity, z) of Gaussian g."""
        conic, x, y = self.projection.conic[0, g], self.geometry[g, 1], self.geometry[g, 2]
        d_x, d_y = 2 * (conic[0] * x + conic[1] * y), 2 * (conic[1] * x + conic[2] * y)
        return vec4(d_x, d_y, self.geometry[g, 0], self.geometry[g, 6])

    @ti.func
    def d_conic(self, g: ti.i32) -> vec3:
        """Gradient with respect to (A, B, C) of Gaussian g."""
        return -vec3(self.geometry[g, 3], 2 * self.geometry[g, 4], self.geometry[g, 5])

    @ti.func
    def d_color(self, g: ti.i32) -> vec3:
        """Gradient with respect to the colour, or to `color`, of Gaussian g."""
        return vec3(self.sums[g, 7], self.sums[g, 8], self.sums[g, 9])

    @ti.func
    def backward(self):
        """Add the gradients of all tiles; after `clear`.

        Outermost level of a kernel that has no other shared arrays.
        """
        if ti.static(self.by_pixel):
            self._backward_by_pixel()
        elif ti.static(self.on_gpu):
            self._backward_gpu()
        else:
            self._backward_cpu()

    @ti.func
    def pixel(self, y: ti.i32, x: ti.i32):
        """Derivatives with respect to a pixel's sums of w c, w z and w; and those times the sums themselves, added."""
        d_c, c, d_sum, d_alpha = self.d_rgb[y, x], self.picture.rgb[0, y, x], 0.0, 0.0
        total = d_c.dot(c)
        if ti.static(self.has_background):  # its share is 1 - A
            d_alpha = -d_c.dot(self.background[0])
            total += d_alpha
        if ti.static(self.with_depth):
            alpha, z = self.picture.alpha[0, y, x], self.picture.depth[0, y, x]
            d_sum = self.d_depth[y, x] / ti.max(alpha, MIN_ALPHA)  # depth = sum w z / alpha
            d_alpha = self.d_alpha[y, x] - d_sum * z
            total += d_sum * z * alpha + d_alpha * alpha
        return d_c, d_sum, d_alpha, total

    @ti.func
    def _backward_cpu(self):
        for tile in range(self.bins.tiles_per_view()):
            self._backward_tile(tile)

    @ti.func
    def _backward_tile(self, tile: ti.i32):
        """Add the gradients of a tile; the pixels' states are arrays, as in `Blend`."""
        _, x0, y0 = self.projection.place_of(tile, (CPU_TILE, CPU_TILE))
        T, behind = filled(1.0), filled(0.0)
        red, green, blue, depth, opaque = filled(0.0), filled(0.0), filled(0.0), filled(0.0), filled(0.0)
        for q in range(CPU_TILE * CPU_TILE):
            x, y = x0 + q % CPU_TILE, y0 + q // CPU_TILE
            if self.projection.inside(x, y):
                d_c, d_sum, d_alpha, total = self.pixel(y, x)
                red[q], green[q], blue[q], depth[q], opaque[q] = d_c.r, d_c.g, d_c.b, d_sum, d_alpha
                behind[q] = total
            else:
                T[q] = -1.0
        top, bottom = 0, CPU_TILE - 1  # rows that are not finished
        begin, end = self.bins.begin[tile], self.bins.end[tile]
        for i in range(begin, end):
            g = value_of(self.bins.members[i])
            mean2d, conic, color = self.projection.mean2d[0, g], self.projection.conic[0, g], splat_color(self, 0, g)
            A, B, C = conic[0], conic[1], conic[2]
            dx0, dy0 = x0 + 0.5 - mean2d.x, y0 + 0.5 - mean2d.y
            first, last = covered_rows(dy0, self.projection.color[0, g][3], top, bottom)
            sums = ti.Vector([0.0] * SUMS)
            for row in range(first, last + 1):
                dy = dy0 + row
                base, tilt = mean2d.z - C * dy * dy, 2 * B * dy
                for column in range(CPU_TILE):
                    q = (row & (CPU_TILE - 1)) * CPU_TILE + column
                    dx = dx0 + column
                    power = base - dx * (A * dx + tilt)
                    exact = ti.select(power < -CUTOFF_BITS, 0.0, exp2(power))
                    alpha = ti.min(exact, ALPHA_MAX)
                    before = T[q]
                    weight, T[q] = blended(before, alpha, 1.0, False)
                    if ti.static(self.with_geometry):
                        value = (
                            red[q] * color.r + green[q] * color.g + blue[q] * color.b + depth[q] * mean2d.w + opaque[q]
                        )
                        behind[q] -= weight * value
                        d_alpha = before * value - behind[q] / (1.0 - alpha)
                        p = ti.select(T[q] > 0.0 and exact < ALPHA_MAX, LN2 * alpha * d_alpha, 0.0)
                        add_moments(sums, p, dx, dy)
                        sums[6] += weight * depth[q]
                    sums[7] += weight * red[q]
                    sums[8] += weight * green[q]
                    sums[9] += weight * blue[q]
            if last >= first:
                if ti.static(self.with_geometry):
                    for k in ti.static(range(GEOMETRY)):
                        self.geometry[g, k] += sums[k]
                for k in ti.static(range(GEOMETRY, SUMS)):
                    self.sums[g, k] += sums[k]
            if (i - begin) % CHECK_INTERVAL == CHECK_INTERVAL - 1:
                top, bottom = unfinished_rows(T)
                if bottom < 0:
                    break

    @ti.func
    def _backward_gpu(self):
        """One tile per block of threads, one cell per warp, PIXELS of a column per thread, as `Blend` draws."""
        ti.loop_config(block_dim=TILE_THREADS)
        for thread in range(self.bins.tiles_per_view() * TILE_THREADS):
            tile, lane = thread // TILE_THREADS, thread % TILE_THREADS
            _, x0, y0 = self.projection.place_of(tile, GPU_TILE)
            cell, member = lane // 32, lane % 32
            x, y = pixel_of(x0, y0, cell, member, ti.static(PIXELS * ROW_STEP))
            shared = ti.simt.block.SharedArray((3 * QUAD,), ti.f32)
            all_lanes = ti.u32(0xFFFFFFFF)
            T, behind = ti.Vector([1.0] * PIXELS), ti.Vector([0.0] * PIXELS)
            red, green, blue = ti.Vector([0.0] * PIXELS), ti.Vector([0.0] * PIXELS), ti.Vector([0.0] * PIXELS)
            depth, opaque = ti.Vector([0.0] * PIXELS), ti.Vector([0.0] * PIXELS)
            for p in ti.static(range(PIXELS)):
                if self.projection.inside(x, y + p * ROW_STEP):
                    d_c, d_sum, d_alpha, total = self.pixel(y + p * ROW_STEP, x)
                    red[p], green[p], blue[p], depth[p], opaque[p] = d_c.r, d_c.g, d_c.b, d_sum, d_alpha
                    behind[p] = total
                else:
                    T[p] = -1.0
            place = place_of_lane(member)
            begin, end = self.bins.begin[tile], self.bins.end[tile]
            for batch in range((end - begin + BATCH - 1) // BATCH):
                # the barrier also keeps the last batch in place until every thread has read it
                if ti.simt.block.sync_all_nonzero(ti.cast(T.max() < 0.0, ti.i32)) != 0:
                    break
                first = begin + batch * BATCH
                load_batch(self, shared, 0, first, end, lane, TILE_THREADS)
                for group in range((ti.min(BATCH, end - first) + 31) // 32):
                    bits = ti.bit_cast(shared[CELL_BITS + 4 * (group * 32 + cell)], ti.u32)
                    # a warp goes through its splats together: all lanes add up what a splat gets from its cell
                    if ti.simt.warp.any_nonzero(all_lanes, ti.cast(T.max() > 0.0, ti.i32)) == 0:
                        bits = ti.u32(0)
                    while bits != ti.u32(0):
                        splat = fetched(shared, group * 32 + first_of(bits), 12)
                        bits &= bits - ti.u32(1)
                        sums = ti.Vector([0.0] * SUMS)
                        touched = 0
                        dx, dy0 = x + 0.5 - splat[0], y + 0.5 - splat[1]
                        base, across = splat[2] - (splat[3] * dx) ** 2, splat[4] * dy0 + splat[5] * dx
                        for p in ti.static(range(PIXELS)):
                            dy = dy0 + p * ROW_STEP
                            u = across + p * ROW_STEP * splat[4]
                            power = base - u * u
                            exact = ti.select(power < -CUTOFF_BITS, 0.0, exp2(power))
                            alpha = ti.min(ALPHA_MAX, exact)
                            before = T[p]
                            weight, T[p] = blended(before, alpha, 1.0, False)
                            value = red[p] * splat[6] + green[p] * splat[7] + blue[p] * splat[8]
                            if ti.static(self.has_background):
                                value += opaque[p]
                            if ti.static(self.with_depth):
                                value += depth[p] * splat[9] + opaque[p]
                                sums[6] += weight * depth[p]
                            behind[p] -= weight * value
                            d_alpha = before * value - behind[p] / (1.0 - alpha)
                            q = ti.select((T[p] > 0.0) & (exact < ALPHA_MAX), LN2 * alpha * d_alpha, 0.0)
                            touched |= ti.cast(weight > 0.0, ti.i32)
                            add_moments(sums, q, dx, dy)
                            sums[7] += weight * red[p]
                            sums[8] += weight * green[p]
                            sums[9] += weight * blue[p]
                        if ti.simt.warp.any_nonzero(all_lanes, touched) != 0:
                            total = warp_sums(sums, member)
                            g = ti.bit_cast(splat[11], ti.i32)
                            if place >= 0:
                                if ti.static(self.adds):
                                    if place < GEOMETRY:
                                        self.geometry[g, place] += total
                                    else:
                                        self.sums[g, place] += total
                                else:
                                    self.sums[g, place] += total

    @ti.func
    def _backward_by_pixel(self):
        """Backward pass of blending in each pixel's own order (render/per_pixel_sort.py).

        Each pixel is traversed as in `PerPixelSort`, with the same buffer: the splat that leaves the buffer is the next
        one from front to back. The order itself has no gradient. A splat that leaves is fetched again, since its offset
        from the pixel is not in the buffer.
        """
        tile_width, tile_height = ti.static(self.projection.tile[0], self.projection.tile[1])
        pixels = ti.static(tile_width * tile_height)
        ti.loop_config(block_dim=PIXEL_THREADS)
        for thread in range(self.bins.tiles_per_view() * pixels):
            tile, lane = thread // pixels, thread % pixels
            _, x0, y0 = self.projection.place_of(tile, self.projection.tile)
            cell, member = lane // (CELL * CELL), lane % (CELL * CELL)
            x, y = pixel_of(x0, y0, cell, member, CELL, ti.static(tile_width // CELL))
            begin, end = self.bins.begin[tile], self.bins.end[tile]
            if self.projection.inside(x, y) and begin < end:
                d_c, d_sum, d_alpha_sum, behind = self.pixel(y, x)
                T = 1.0
                inv_depths, alphas = ti.Vector([EMPTY_INV_DEPTH] * BUFFER_SIZE), ti.Vector([0.0] * BUFFER_SIZE)
                indices = ti.Vector([0] * BUFFER_SIZE)
                for i in range(begin, end + BUFFER_SIZE):
                    touches, g, alpha, inv_depth = True, 0, 0.0, BEHIND_ALL
                    if i < end:
                        g = value_of(self.bins.members[i])
                        mean2d, conic = self.projection.mean2d[0, g], self.projection.conic[0, g]
                        dx, dy = x + 0.5 - mean2d.x, y + 0.5 - mean2d.y
                        power = mean2d.z - conic[2] * dy * dy - dx * (conic[0] * dx + 2 * conic[1] * dy)
                        touches = power >= -CUTOFF_BITS
                        if touches:
                            alpha = ti.min(ALPHA_MAX, exp2(power))
                            inv_depth = 1.0 / mean2d.w + self.projection.slope[0, g].dot(ti.math.vec2(dx, dy))
                    if touches:
                        front_alpha, front = pushed(inv_depths, alphas, indices, inv_depth, alpha, g)
                        after = T * (1.0 - front_alpha)
                        if after <= MIN_TRANSMITTANCE:
                            break
                        if front_alpha > 0.0:
                            behind = self._add(x, y, front, front_alpha, T, d_c, d_sum, d_alpha_sum, behind)
                            T = after

    @ti.func
    def _add(self, x, y, g, alpha, T, d_c, d_sum, d_alpha_sum, behind) -> ti.f32:
        """Add a pixel's gradients of splat g; the sum behind it."""
        mean2d = self.projection.mean2d[0, g]
        dx, dy = x + 0.5 - mean2d.x, y + 0.5 - mean2d.y
        weight, value = alpha * T, d_c.dot(splat_color(self, 0, g))
        if ti.static(self.has_background):
            value += d_alpha_sum
        if ti.static(self.with_depth):
            value += d_sum * mean2d.w + d_alpha_sum
            self.geometry[g, 6] += weight * d_sum
        left = behind - weight * value
        if alpha < ALPHA_MAX:
            p = LN2 * alpha * (T * value - left / (1.0 - alpha))
            self.geometry[g, 0] += p
            self.geometry[g, 1] += p * dx
            self.geometry[g, 2] += p * dy
            self.geometry[g, 3] += p * dx * dx
            self.geometry[g, 4] += p * dx * dy
            self.geometry[g, 5] += p * dy * dy
        for k in ti.static(range(3)):
            self.sums[g, 7 + k] += weight * d_c[k]
        return left

    @ti.func
    def words(self, v, g, mean2d, conic):
        """Numbers of a splat in shared memory: x, y, log2 opacity, the factors q, s and t, rgb, z."""
        q, s, t = factors(conic)
        c = splat_color(self, v, g)
        return ti.Vector([mean2d.x, mean2d.y, mean2d.z, q, s, t, c[0], c[1], c[2], mean2d.w])


@ti.func
def add_moments(sums: ti.template(), p: ti.f32, dx: ti.f32, dy: ti.f32):
    """Add a pixel's derivative p with respect to the exponent, by its offset [px], to the first six of the SUMS."""
    sums[0] += p
    sums[1] += p * dx
    sums[2] += p * dy
    sums[3] += p * dx * dx
    sums[4] += p * dx * dy
    sums[5] += p * dy * dy


@ti.func
def warp_sums(values: ti.template(), lane: ti.i32) -> ti.f32:
    """Sum over a warp of the SUMS values of each lane; a lane gets the sum of value `place_of_lane`.

    Each lane exchanges half of its values with the lane 16 away, then a quarter with the one 8 away, and so on: 12
    exchanges instead of 50.
    """
    a = ti.Vector([0.0] * 5)
    for k in ti.static(range(5)):
        a[k] = halved(values[k], values[5 + k], lane, 16)
    b = ti.Vector([0.0] * 3)
    b[0], b[1], b[2] = halved(a[0], a[3], lane, 8), halved(a[1], a[4], lane, 8), halved(a[2], 0.0, lane, 8)
    c0, c1 = halved(b[0], b[2], lane, 4), halved(b[1], 0.0, lane, 4)
    d = halved(c0, c1, lane, 2)
    return d + exchanged(d, 1)


@ti.func
def place_of_lane(lane: ti.i32) -> ti.i32:
    """Index of the value whose sum `warp_sums` gives to a lane; -1 for a lane that has none, or a double."""
    inner = (lane >> 2 & 1) * 2 + (lane >> 1 & 1)
    within = (lane >> 3 & 1) * 3 + inner
    return ti.select((lane & 1 == 0) & (inner < 3) & (within < 5), (lane >> 4) * 5 + within, -1)


@ti.func
def halved(low: ti.f32, high: ti.f32, lane: ti.i32, distance: ti.i32) -> ti.f32:
    """`low`, or `high` where `distance` is a bit of the lane, and what the partner adds to it."""
    upper = (lane & distance) != 0
    return ti.select(upper, high, low) + exchanged(ti.select(upper, low, high), distance)


@ti.func
def exchanged(value: ti.f32, distance: ti.i32) -> ti.f32:
    """The value of the lane whose number differs by the bit `distance`."""
    bits = ti.simt.warp.shfl_xor_i32(ti.u32(0xFFFFFFFF), ti.bit_cast(value, ti.i32), distance)
    return ti.bit_cast(bits, ti.f32)
