"""Backward pass of blending in each pixel's own order (render/per_pixel_sort.py)."""

import math

import taichi as ti

from render.blend import splat_color
from render.footprint import CUTOFF_BITS
from render.per_pixel_sort import EMPTY_INV_DEPTH, PIXEL_THREADS, pushed
from render.radix_sort import value_of
from render.tile_batch import ALPHA_MAX, CELL, MIN_TRANSMITTANCE, exp2, tile_origin

LN2 = math.log(2.0)
BEHIND_ALL = 0.0  # [1/m] of empty splats that follow the last one: they drain the buffer


@ti.func
def add_by_pixel(own: ti.template(), buffer_size: ti.template()):
    """Add the gradients of all tiles to those of `own`, a BlendGradients; outermost level of a kernel.

    Each pixel is traversed as in `PerPixelSort`, with the same buffer: the splat that leaves the buffer is the next one
    from front to back, and its gradients are as in `BlendGradients`. The order itself has no gradient. A splat that
    leaves is fetched again, since its offset from the pixel is not in the buffer.
    """
    tile_width, tile_height = ti.static(own.projection.tile[0], own.projection.tile[1])
    pixels = ti.static(tile_width * tile_height)
    ti.loop_config(block_dim=PIXEL_THREADS)
    for thread in range(own.bins.tiles_per_view() * pixels):
        tile, lane = thread // pixels, thread % pixels
        x0, y0 = tile_origin(own.projection, tile, own.projection.tile)
        cell, member = lane // (CELL * CELL), lane % (CELL * CELL)
        x = x0 + cell % (tile_width // CELL) * CELL + member % CELL
        y = y0 + cell // (tile_width // CELL) * CELL + member // CELL
        begin, end = own.bins.begin[tile], own.bins.end[tile]
        if x < own.projection.grid[None][0] and y < own.projection.grid[None][1] and begin < end:
            d_c, d_sum, d_alpha_sum, behind = own.pixel(y, x)
            T = 1.0
            inv_depths, alphas = ti.Vector([EMPTY_INV_DEPTH] * buffer_size), ti.Vector([0.0] * buffer_size)
            indices = ti.Vector([0] * buffer_size)
            for i in range(begin, end + buffer_size):
                touches, g, alpha, inv_depth = True, 0, 0.0, BEHIND_ALL
                if i < end:
                    g = value_of(own.bins.members[i])
                    mean2d, conic = own.projection.mean2d[0, g], own.projection.conic[0, g]
                    dx, dy = x + 0.5 - mean2d.x, y + 0.5 - mean2d.y
                    power = mean2d.z - conic[2] * dy * dy - dx * (conic[0] * dx + 2 * conic[1] * dy)
                    touches = power >= -CUTOFF_BITS
                    if touches:
                        alpha = ti.min(ALPHA_MAX, exp2(power))
                        slope_x, slope_y = own.projection.box[0, g][3], own.projection.color[0, g][3]
                        inv_depth = 1.0 / mean2d.w + slope_y * dy + slope_x * dx
                if touches:
                    front_alpha, front = pushed(inv_depths, alphas, indices, inv_depth, alpha, g)
                    after = T * (1.0 - front_alpha)
                    if after <= MIN_TRANSMITTANCE:
                        break
                    if front_alpha > 0.0:
                        behind = _add(own, x, y, front, front_alpha, T, d_c, d_sum, d_alpha_sum, behind)
                        T = after


@ti.func
def _add(own: ti.template(), x, y, g, alpha, T, d_c, d_sum, d_alpha_sum, behind) -> ti.f32:
    """Add a pixel's gradients of splat g; the sum behind it."""
    mean2d = own.projection.mean2d[0, g]
    dx, dy = x + 0.5 - mean2d.x, y + 0.5 - mean2d.y
    weight, value = alpha * T, d_c.dot(splat_color(own, 0, g))
    if ti.static(own.with_depth):
        value += d_sum * mean2d.w + d_alpha_sum
        own.geometry[g, 6] += weight * d_sum
    left = behind - weight * value
    if alpha < ALPHA_MAX:
        p = LN2 * alpha * (T * value - left / (1.0 - alpha))
        own.geometry[g, 0] += p
        own.geometry[g, 1] += p * dx
        own.geometry[g, 2] += p * dy
        own.geometry[g, 3] += p * dx * dx
        own.geometry[g, 4] += p * dx * dy
        own.geometry[g, 5] += p * dy * dy
    for k in ti.static(range(3)):
        own.sums[g, 7 + k] += weight * d_c[k]
    return left
