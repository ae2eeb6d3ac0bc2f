"""Where a splat's ellipse is seen: which tiles hold a pixel centre of it."""

import math

import taichi as ti

STEPS = math.log2(255)  # a splat ends where its alpha falls below one 8-bit step, 2^-STEPS
WINDOW_COLUMNS, WINDOW_ROWS = 6, 5  # [tiles], 30 bits; larger splats are looked at again when they are binned
SLACK = 1e-3  # widens the tile test: rounding must not lose a pixel

vec2, vec4 = ti.math.vec2, ti.math.vec4


@ti.data_oriented
class Footprint:
    """What Projection knows of the ellipses that it writes; `place`, `conic`, `box`, `window` and `grid` are there."""

    @ti.func
    def _window(self, place: vec4, conic: vec4, box: vec4):
        left, right, top, bottom = self.tile_box(place, box)
        fits = right - left <= WINDOW_COLUMNS and bottom - top <= WINDOW_ROWS
        touched, bits = 0, 0
        for row in range(top, bottom):
            first, last = self.tile_columns(row, left, right, place, conic, box)
            touched += last - first
            if fits:
                bits |= ((1 << (last - first)) - 1) << ((row - top) * WINDOW_COLUMNS + first - left)
        if not fits:
            bits = -touched
        return ti.Vector([left | top << 16, bits])

    @ti.func
    def touched(self, v: ti.i32, g: ti.i32) -> ti.i32:
        """How many tiles of view `v` splat `g` touches."""
        bits = self.window[v, g][1]
        return -bits if bits < 0 else ti.cast(ti.math.popcnt(bits), ti.i32)

    @ti.func
    def _meets_picture(self, x: ti.f32, y: ti.f32, half_width: ti.f32, half_height: ti.f32):
        """Whether a box around pixel position (x, y) and the picture overlap."""
        middle_x, middle_y = 0.5 * self.grid[None][0], 0.5 * self.grid[None][1]
        return ti.abs(x - middle_x) < half_width + middle_x and ti.abs(y - middle_y) < half_height + middle_y

    @ti.func
    def tile_box(self, place: vec4, box: vec4):
        """Columns [left, right) and rows [top, bottom) of tiles with a pixel centre within the splat's box."""
        left, right = self._tiles_between(place.x - box[0], place.x + box[0], 0, self.grid[None][2], self.tile[0])
        top, bottom = self._tiles_between(place.y - box[1], place.y + box[1], 0, self.grid[None][3], self.tile[1])
        return left, right, top, bottom

    @ti.func
    def tile_columns(self, row: ti.i32, left: ti.i32, right: ti.i32, place: vec4, conic: vec4, box: vec4):
        """Columns of tiles [first, last) of a row that hold a pixel centre column of the ellipse's part in it.

        left and right are those of the splat's box.
        """
        first, last = left, right
        if right - left > 1:
            top = row * self.tile[1] + 0.5
            low, high = self.ends(top, top + (self.tile[1] - 1), place, conic, box)
            first, last = self._tiles_between(low, high, left, right, self.tile[0])
        return first, last

    @ti.func
    def ends(self, top: ti.f32, bottom: ti.f32, place: vec4, conic: vec4, box: vec4):
        """Left and right end [px] of the ellipse's part between two heights [px], where its box has a part.

        The right end x(dy) of an ellipse is concave in dy, so on a strip it is greatest at the
        rightmost point, clamped to the strip; likewise the left end, by symmetry.
        """
        left, right = place.x - box[0], place.x + box[0]
        A, B, C, det = conic[0], conic[1], conic[2], conic[3]
        if det > 1e-6 * A * C:  # a thinner one would need more digits: it keeps its box
            low, high = ti.max(top - place.y, -box[1]), ti.min(bottom - place.y, box[1])
            d = clamp(vec2(box[2], -box[2]), low, high)  # where the right and the left end are
            root = ti.sqrt(ti.max(A * (place.z + STEPS + SLACK) - det * d * d, 0.0))
            middle = place.x - B / A * d
            left, right = middle[1] - root[1] / A, middle[0] + root[0] / A
        return left, right

    @ti.func
    def _tiles_between(self, low: ti.f32, high: ti.f32, left: ti.i32, right: ti.i32, tile: ti.template()):
        """Tiles [first, last) of `tile` pixels, within [left, right), with a pixel centre in [low, high]."""
        first = ti.cast(ti.floor(clamp((low + 0.5) / tile, float(left), float(right))), ti.i32)
        last = ti.cast(ti.floor(clamp((high + (tile - 0.5)) / tile, float(left), float(right))), ti.i32)
        return first, ti.max(first, last)


@ti.func
def clamp(x, low, high):
    return ti.min(ti.max(x, low), high)
