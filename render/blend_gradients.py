"""Backward pass of blending: gradients of the splats in a picture from the gradient of its pixels."""

import math

import taichi as ti

from core.fields import FieldGroup
from render.binning import TileBins
from render.blend import splat_color
from render.footprint import CUTOFF_BITS
from render.radix_sort import value_of
from render.tile_batch import ALPHA_MAX, CPU_TILE, MIN_TRANSMITTANCE, exp2, tile_origin

LN2 = math.log(2.0)
PIXELS = CPU_TILE * CPU_TILE  # of a block that is walked through at once
MIN_ALPHA = 1e-10  # of a pixel whose depth is divided by it, as in the picture

vec2, vec3, vec4 = ti.math.vec2, ti.math.vec3, ti.math.vec4


@ti.data_oriented
class BlendGradients:
    """Gradients of a loss with respect to binned splats of one view.

    In, fields of shape (height, width): `d_rgb` vec3, `d_alpha`, `d_depth`, derivatives with respect to the picture of
    a FloatImages sink, which has been drawn from the same bins.

    Out, of shape (capacity,), zero for Gaussians that are not in the picture:
    d_mean2d   (x, y [1/px], log2 opacity, camera z [1/m])
    d_conic    (A, B, C), as in `Projection.conic`
    d_color    (r, g, b)

    With `color`, three numbers a Gaussian, vec3 (capacity,), the picture is of those in place of colours. With `into`,
    the gradients of another picture from the same bins, d_mean2d and d_conic are added to its, and are the same fields.

    With w_i = alpha_i T_i and s_i = dL/dC . c_i + dL/dD z_i + dL/dA, a pixel's loss changes by sum w_i s_i, and

        dL/dalpha_i = T_i s_i - (sum_{j > i} w_j s_j) / (1 - alpha_i).

    The sum behind i is that of the whole pixel, which the picture gives, less the sum up to i: splats are walked
    through from front to back as when they are drawn, and pixels end where they ended then.
    """

    def __init__(self, bins: TileBins, picture, *, color=None, into: "BlendGradients | None" = None):
        self.bins, self.projection, self.picture = bins, bins.projection, picture
        self.color, self.other_color, self.adds = color, color is not None, into is not None
        if self.projection.views != 1:
            raise ValueError("gradients are those of one view")
        _, height, width = picture.alpha.shape
        self.fields = f = FieldGroup()
        self.d_rgb, self.d_alpha, self.d_depth = (
            f.vector(height, width),
            f.scalar(height, width),
            f.scalar(height, width),
        )
        capacity = self.projection.splats.capacity
        with f.interleaved(capacity):
            if into is None:
                self.d_mean2d, self.d_conic = f.vector(capacity, n=4), f.vector(capacity)
            else:
                self.d_mean2d, self.d_conic = into.d_mean2d, into.d_conic
            self.d_color = f.vector(capacity)
        f.build()

    def destroy(self) -> None:
        """Free the device memory."""
        self.fields.destroy()

    @ti.func
    def clear(self, begin: ti.i32, end: ti.i32):
        """Set the gradients of Gaussians [begin, end) to zero, but those of `into`; outermost level of a kernel."""
        for g in range(begin, end):
            if ti.static(not self.adds):
                self.d_mean2d[g], self.d_conic[g] = vec4(0.0), vec3(0.0)
            self.d_color[g] = vec3(0.0)

    @ti.func
    def backward(self):
        """Add the gradients of all tiles; outermost level of a kernel, after `clear`."""
        columns, rows = ti.static(self.projection.tile[0] // CPU_TILE, self.projection.tile[1] // CPU_TILE)
        ti.loop_config(block_dim=4)
        for block in range(self.bins.tiles_per_view() * columns * rows):
            tile, part = block // (columns * rows), block % (columns * rows)
            x0, y0 = tile_origin(self.projection, tile, self.projection.tile)
            self._backward_block(tile, x0 + part % columns * CPU_TILE, y0 + part // columns * CPU_TILE)

    @ti.func
    def _backward_block(self, tile: ti.i32, x0: ti.i32, y0: ti.i32):
        """Add the gradients of a block of pixels of a tile; the pixels' states are arrays, as in `Blend`."""
        T, behind = filled(1.0), filled(0.0)
        red, green, blue, depth, opaque = filled(0.0), filled(0.0), filled(0.0), filled(0.0), filled(0.0)
        for q in range(PIXELS):
            x, y = x0 + q % CPU_TILE, y0 + q // CPU_TILE
            if x < self.projection.grid[None][0] and y < self.projection.grid[None][1]:
                c, alpha, z = self.picture.rgb[0, y, x], self.picture.alpha[0, y, x], self.picture.depth[0, y, x]
                d_c, d_sum = self.d_rgb[y, x], self.d_depth[y, x] / ti.max(alpha, MIN_ALPHA)  # depth = sum w z / alpha
                d_alpha = self.d_alpha[y, x] - d_sum * z
                red[q], green[q], blue[q], depth[q], opaque[q] = d_c.r, d_c.g, d_c.b, d_sum, d_alpha
                behind[q] = d_c.dot(c) + d_sum * z * alpha + d_alpha * alpha
            else:
                T[q] = -1.0
        for i in range(self.bins.begin[tile], self.bins.end[tile]):
            g = value_of(self.bins.members[i])
            mean2d, conic, color = self.projection.mean2d[0, g], self.projection.conic[0, g], splat_color(self, 0, g)
            half_height = self.projection.box[0, g][1]
            A, B, C = conic[0], conic[1], conic[2]
            dx0, dy0 = x0 + 0.5 - mean2d.x, y0 + 0.5 - mean2d.y
            first = ti.cast(ti.ceil(ti.max(-dy0 - half_height, 0.0)), ti.i32)
            last = ti.cast(ti.floor(ti.min(half_height - dy0, CPU_TILE - 1.0)), ti.i32)
            d_x, d_y, d_log, d_z, d_A, d_B, d_C = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            d_r, d_g, d_b = 0.0, 0.0, 0.0
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
                    after = before * (1.0 - alpha)
                    visible = after > MIN_TRANSMITTANCE
                    weight = ti.select(visible, alpha * before, 0.0)
                    T[q] = ti.select(visible, after, -ti.abs(before))
                    value = red[q] * color.r + green[q] * color.g + blue[q] * color.b + depth[q] * mean2d.w + opaque[q]
                    behind[q] -= weight * value
                    d_alpha = before * value - behind[q] / (1.0 - alpha)
                    d_power = ti.select(visible and exact < ALPHA_MAX, LN2 * alpha * d_alpha, 0.0)
                    d_x += d_power * 2 * (A * dx + B * dy)
                    d_y += d_power * 2 * (B * dx + C * dy)
                    d_log += d_power
                    d_A -= d_power * dx * dx
                    d_B -= d_power * 2 * dx * dy
                    d_C -= d_power * dy * dy
                    d_r += weight * red[q]
                    d_g += weight * green[q]
                    d_b += weight * blue[q]
                    d_z += weight * depth[q]
            if last >= first:
                self.d_mean2d[g] += vec4(d_x, d_y, d_log, d_z)
                self.d_conic[g] += vec3(d_A, d_B, d_C)
                self.d_color[g] += vec3(d_r, d_g, d_b)


@ti.func
def filled(value: ti.f32):
    """A value for each pixel of a block."""
    return ti.Vector([value] * PIXELS)
