"""Tiles of the picture and, on CUDA, the batches of splats that a tile's threads share.

A CUDA block draws a tile of ACROSS x DOWN cells, CELL x CELL pixels each. Splats come through shared memory in batches.
The thread that loads a splat finds the cells that it touches; a warp reads them as one bit per splat and visits the set
bits, so that splats outside of its cell cost it nothing.
"""

import taichi as ti

from render.footprint import horizontal_extent
from render.radix_sort import value_of

ALPHA_MAX = 0.999  # as gsplat: a pixel never becomes fully opaque, so its weights stay finite
MIN_TRANSMITTANCE = 1e-4  # a pixel is finished before its transmittance would fall to this
CPU_TILE = 8  # [px] a row of a tile is one vector register of floats
CHECK_INTERVAL = 16  # splats between two tests, on the CPU, of whether all pixels are finished
CELL = 8  # [px]
ACROSS, DOWN = 4, 2  # cells of a tile; larger tiles make fewer pairs to sort
GPU_TILE = (ACROSS * CELL, DOWN * CELL)  # [px]
BATCH = 512  # splats in shared memory at a time; a power of two
QUAD = 4 * BATCH  # words of shared memory between quads of a splat: its first four numbers, the next, the last two
CELL_BITS = 2 * QUAD + 2  # first of the words that say which of 32 splats touch a cell


@ti.func
def exp2(x: ti.f32) -> ti.f32:
    """2^x for -CUTOFF_BITS <= x <= 0.01, relative error 4e-6; undefined outside.

    (2^(x/16))^16 with a polynomial for the inner part: products only, which a CPU vectorises, and half as many
    instructions as the library's function on CUDA.
    """
    y = 0.0009379154316623323 + x * (1.3388277327798619e-05 + x * 1.2325647990480442e-07)
    y = 0.9999999187056234 + x * (0.04332121602645622 + x * y)
    y *= y
    y *= y
    y *= y
    return y * y


@ti.func
def tile_origin(projection: ti.template(), in_view: ti.i32, size: ti.template()):
    """First column and row [px] of a tile of a view; `size`: (width, height) of a tile."""
    columns = projection.grid[None][2]
    return in_view % columns * size[0], in_view // columns * size[1]


@ti.func
def load_member(drawer: ti.template(), shared: ti.template(), v, i, j, exists, x0, y0):
    """Write member `i` of the bins at position `j` of the batch, and its bit to every cell that it touches.

    `drawer.words(v, g, mean2d, conic)` are the numbers of a splat that blending reads, ten at most.
    """
    touches = 0  # a bit for each cell
    if exists != 0:
        g = value_of(drawer.bins.members[i])
        mean2d, conic = drawer.projection.mean2d[v, g], drawer.projection.conic[v, g]
        box = drawer.projection.box[v, g]
        at, words = 4 * (j & (BATCH - 1)), drawer.words(v, g, mean2d, conic)
        for k in ti.static(range(10)):
            shared[QUAD * (k // 4) + at + k % 4] = words[k]
        for row in ti.static(range(DOWN)):
            top = y0 + row * CELL + 0.5
            if mean2d.y - box[1] <= top + (CELL - 1) and mean2d.y + box[1] >= top:
                left, right = horizontal_extent(top, top + (CELL - 1), mean2d, conic, box)
                for column in ti.static(range(ACROSS)):
                    if left <= x0 + column * CELL + CELL - 0.5 and right >= x0 + column * CELL + 0.5:
                        touches |= 1 << (row * ACROSS + column)
    all_lanes = ti.u32(0xFFFFFFFF)
    for cell in ti.static(range(ACROSS * DOWN)):
        own = (touches >> cell) & 1
        ones = ti.cast(ti.simt.warp.match_any(all_lanes, own), ti.u32)  # lanes with the same bit
        if own == 0:
            ones = ~ones
        if j % 32 == cell:
            shared[CELL_BITS + 4 * j] = ti.bit_cast(ones, ti.f32)
