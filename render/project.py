"""From Gaussians to splats: EWA projection, colour, footprint and the tiles it touches, per view."""

import math

import taichi as ti

from render.color import color_of
from render.ray_depth import slope
from render.sort import DROPPED
from render.sorts import SORTS
from render.splats import Splats

NEAR = 0.01  # [m] of camera z
DILATION = 0.3  # [px^2] added to the variance: a splat is never thinner than a pixel's filter
EDGE = 0.3  # the Jacobian's x/z is held within the picture plus this share of tan(fov / 2)
STEPS = math.log2(255)  # a splat ends where its alpha falls below one 8-bit step, 2^-STEPS
BRIGHTEST, LARGEST = 1e6, 1e30  # a colour, a determinant [px^4] beyond is broken, and is not drawn
MOST_REACH = 2 * math.log(255) + 0.01  # [sigma^2] where the most opaque splat ends
HALF_LOG2_E = 0.5 * math.log2(math.e)  # exp(-q/2) = 2^(-HALF_LOG2_E q)
WINDOW_COLUMNS, WINDOW_ROWS = 6, 5  # [tiles], 30 bits; larger splats are looked at again when they are binned
SLACK = 1e-3  # widens the tile test: rounding must not lose a pixel

vec2, vec3, vec4 = ti.math.vec2, ti.math.vec3, ti.math.vec4


@ti.data_oriented
class Projection:
    """Splats of all `views` in pixels, and the depth by which they are sorted.

    `camera`, (views, 4) of vec4: three rows of world_to_camera and (fx, fy, cx, cy); `near`, the
    least camera z [m] that is drawn; `grid`, (width, height [px], columns, rows of tiles): on the device, so that
    a picture of another size needs no other kernels. Out:
    place  (x, y [px], log2 opacity, camera z [m]), (views, capacity)
    conic  (A, B, C, A C - B^2): alpha = 2^(log2 opacity - A dx^2 - 2 B dx dy - C dy^2)
    color  (r, g, b, change of 1/z per row)
    box    (half width, half height, dy of the rightmost point [px], change of 1/z per column) of the visible ellipse;
           changes only for sort="pixel" [1/(m px)], see render/ray_depth.py
    window what tiles it touches, vec2 i32: the first column | first row << 16, and, bit 6 row + column
           for tile (column, row) from there; or, if it spans more than 6 x 5 tiles, minus their number
    """

    def __init__(
        self,
        splats: Splats,
        width: int,
        height: int,
        views: int,
        *,
        tile: int,
        antialias: bool,
        color: bool,
        sort: str = "z",
    ):
        if sort not in SORTS:
            raise ValueError(f"sort must be one of {', '.join(SORTS)}, not {sort!r}")
        self.splats, self.radial, self.with_slope = splats, sort != "z", sort == "pixel"
        self.views, self.tile, self.antialias, self.with_color = views, tile, antialias, color
        self.camera = ti.Vector.field(4, ti.f32)
        self.near = ti.field(ti.f32)
        self.grid = ti.Vector.field(4, ti.i32)
        self.place = ti.Vector.field(4, ti.f32)
        self.conic = ti.Vector.field(4, ti.f32)
        self.color = ti.Vector.field(4, ti.f32)
        self.box = ti.Vector.field(4, ti.f32)
        self.window = ti.Vector.field(2, ti.i32)
        builder = ti.FieldsBuilder()
        splat = builder.dense(ti.ij, (views, splats.capacity))
        splat.place(self.place, self.conic, self.color, self.box)  # 64 bytes: a splat is one cache line
        builder.dense(ti.ij, (views, 4)).place(self.camera)
        builder.dense(ti.i, views).place(self.near)
        builder.place(self.grid)
        builder.dense(ti.ij, (views, splats.capacity)).place(self.window)
        self.tree = builder.finalize()
        self.near.fill(NEAR)
        self.set_size(width, height)

    def set_size(self, width: int, height: int) -> None:
        """Pictures are width x height [px] from now on."""
        self.tiles = (-(-width // self.tile), -(-height // self.tile))  # columns, rows
        self.grid[None] = [width, height, *self.tiles]

    def destroy(self) -> None:
        """Give the device memory back; the object must not be used after."""
        self.tree.destroy()

    @ti.kernel
    def set_camera(
        self, v: ti.i32,
        a0: ti.f32, a1: ti.f32, a2: ti.f32, a3: ti.f32,
        b0: ti.f32, b1: ti.f32, b2: ti.f32, b3: ti.f32,
        c0: ti.f32, c1: ti.f32, c2: ti.f32, c3: ti.f32,
        fx: ti.f32, fy: ti.f32, cx: ti.f32, cy: ti.f32,
    ):  # fmt: skip
        """Rows of world_to_camera and intrinsics of view `v`; scalars reach the device without a copy to wait for."""
        self.camera[v, 0] = vec4(a0, a1, a2, a3)
        self.camera[v, 1] = vec4(b0, b1, b2, b3)
        self.camera[v, 2] = vec4(c0, c1, c2, c3)
        self.camera[v, 3] = vec4(fx, fy, cx, cy)

    @ti.func
    def project(self, begin: ti.i32, end: ti.i32, sorter: ti.template()):
        """Project Gaussians begin..end-1 and hand their depths to `sorter`; outermost level of a kernel.

        Sigma_2D = J W Sigma W^T J^T + 0.3 I, J = [[fx/z, 0, -fx x/z^2], [0, fy/z, -fy y/z^2]]
        with x/z and y/z held near the picture.                       Zwicker 2001; Kerbl 2023
        """
        for g in range(begin, end):
            mean, opacity = self.splats.mean[g], self.splats.opacity[g]
            depth = 0.0
            seen = 0
            for v in range(self.views):
                p = self._to_camera(v, mean)
                depth += p.norm() if ti.static(self.radial) else p.z
                window = ti.Vector([0, 0])
                if p.z >= self.near[v] and opacity >= 1 / 255:
                    window = self._project_to(v, g, p, ti.min(opacity, 1.0))
                self.window[v, g] = window
                seen |= window[1]
            key = ti.u32(DROPPED)
            if ti.static(self.with_color):  # noqa: SIM102, one is for the compiler
                if seen != 0:
                    c = color_of(self.splats, g, mean - self._eye())
                    if not (c.sum() < BRIGHTEST):  # nor if it is no number
                        seen = 0
                    for v in range(self.views):
                        for k in ti.static(range(3)):
                            self.color[v, g][k] = c[k]
            if seen != 0:
                key = ordered_bits(depth / self.views)
            sorter.items[g - begin] = ti.Vector([ti.cast(key, ti.i32), g])
        sorter.count[None] = ti.max(end - begin, 0)

    @ti.func
    def _to_camera(self, v: ti.i32, x: vec3) -> vec3:
        p = vec3(0.0)
        for k in ti.static(range(3)):
            row = self.camera[v, k]
            p[k] = row.xyz.dot(x) + row.w
        return p

    @ti.func
    def _eye(self) -> vec3:
        """The mean of the cameras' centres [m]."""
        eye = vec3(0.0)
        for v in range(self.views):
            for k in ti.static(range(3)):
                eye -= self.camera[v, k].w * self.camera[v, k].xyz / self.views
        return eye

    @ti.func
    def _project_to(self, v: ti.i32, g: ti.i32, p: vec3, opacity: ti.f32):
        """Write splat `g` of view `v`; returns its window."""
        lens = self.camera[v, 3]  # fx, fy, cx, cy
        width, height = self.grid[None][0], self.grid[None][1]
        margin_x, margin_y = EDGE * 0.5 * width / lens[0], EDGE * 0.5 * height / lens[1]
        x = clamp(p.x / p.z, -lens[2] / lens[0] - margin_x, (width - lens[2]) / lens[0] + margin_x)
        y = clamp(p.y / p.z, -lens[3] / lens[1] - margin_y, (height - lens[3]) / lens[1] + margin_y)
        fx, fy = lens[0] / p.z, lens[1] / p.z
        mx, my = fx * p.x + lens[2], fy * p.y + lens[3]
        s = self.splats.cov[g]
        size = s[0] + s[3] + s[5]  # at least the largest eigenvalue, so this box is at least the splat's
        far_x = ti.sqrt(MOST_REACH * (fx * fx * (1 + x * x) * size + DILATION))
        far_y = ti.sqrt(MOST_REACH * (fy * fy * (1 + y * y) * size + DILATION))
        window = ti.Vector([0, 0])
        if self._meets_picture(mx, my, far_x, far_y):
            along = self.camera[v, 2].xyz
            jx = fx * (self.camera[v, 0].xyz - x * along)  # the rows of J W
            jy = fy * (self.camera[v, 1].xyz - y * along)
            sx = times(s, jx)
            sharp_xx, sharp_xy, sharp_yy = jx.dot(sx), jy.dot(sx), jy.dot(times(s, jy))
            xx, yy = sharp_xx + DILATION, sharp_yy + DILATION
            det = xx * yy - sharp_xy * sharp_xy
            if ti.static(self.antialias):
                opacity *= ti.sqrt(ti.max(0.0, (sharp_xx * sharp_yy - sharp_xy * sharp_xy) / det))
            if xx > 0 and det > 0 and det < LARGEST and opacity >= 1 / 255:
                log_opacity = ti.log(opacity) * (2 * HALF_LOG2_E)
                reach = (log_opacity + STEPS + SLACK) / HALF_LOG2_E  # squared, in sigmas
                half_width, half_height = ti.sqrt(reach * xx), ti.sqrt(reach * yy)
                if self._meets_picture(mx, my, half_width, half_height):
                    A, B, C = yy * HALF_LOG2_E / det, -sharp_xy * HALF_LOG2_E / det, xx * HALF_LOG2_E / det
                    place = vec4(mx, my, log_opacity, p.z)
                    conic = vec4(A, B, C, A * C - B * B)
                    box = vec4(half_width, half_height, -B / C * half_width, 0.0)
                    if ti.static(self.with_slope):
                        change = slope(self.camera, v, p, s, DILATION, MOST_REACH)
                        box[3], self.color[v, g][3] = change.x, change.y
                    self.place[v, g], self.conic[v, g], self.box[v, g] = place, conic, box
                    window = self._window(place, conic, box)
        return window

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
        left, right = self._tiles_between(place.x - box[0], place.x + box[0], 0, self.grid[None][2])
        top, bottom = self._tiles_between(place.y - box[1], place.y + box[1], 0, self.grid[None][3])
        return left, right, top, bottom

    @ti.func
    def tile_columns(self, row: ti.i32, left: ti.i32, right: ti.i32, place: vec4, conic: vec4, box: vec4):
        """Columns of tiles [first, last) of a row that hold a pixel centre column of the ellipse's part in it.

        The right end x(dy) of an ellipse is concave in dy, so on a strip it is greatest at the
        rightmost point, clamped to the strip; likewise the left end, by symmetry. left and right
        are those of the splat's box.
        """
        first, last = left, right
        A, B, C, det = conic[0], conic[1], conic[2], conic[3]
        if right - left > 1 and det > 1e-6 * A * C:  # a thinner one would need more digits: it keeps its box
            low = ti.max(row * self.tile + 0.5 - place.y, -box[1])
            high = ti.min(row * self.tile + self.tile - 0.5 - place.y, box[1])
            d = clamp(vec2(box[2], -box[2]), low, high)  # where the right and the left end are
            root = ti.sqrt(ti.max(A * (place.z + STEPS + SLACK) - det * d * d, 0.0))
            middle = place.x - B / A * d
            first, last = self._tiles_between(middle[1] - root[1] / A, middle[0] + root[0] / A, left, right)
        return first, last

    @ti.func
    def _tiles_between(self, low: ti.f32, high: ti.f32, left: ti.i32, right: ti.i32):
        """Tiles [first, last) within [left, right) along a side with a pixel centre in [low, high]."""
        first = ti.cast(ti.floor(clamp((low + 0.5) / self.tile, float(left), float(right))), ti.i32)
        last = ti.cast(ti.floor(clamp((high + (self.tile - 0.5)) / self.tile, float(left), float(right))), ti.i32)
        return first, ti.max(first, last)


@ti.func
def clamp(x, low, high):
    return ti.min(ti.max(x, low), high)


@ti.func
def times(s: ti.template(), x: vec3) -> vec3:
    """Symmetric matrix (xx, xy, xz, yy, yz, zz) times x."""
    return vec3(
        s[0] * x[0] + s[1] * x[1] + s[2] * x[2],
        s[1] * x[0] + s[3] * x[1] + s[4] * x[2],
        s[2] * x[0] + s[4] * x[1] + s[5] * x[2],
    )


@ti.func
def ordered_bits(x: ti.f32) -> ti.u32:
    """Bits of x that compare as unsigned integers the way floats compare."""
    bits = ti.bit_cast(x, ti.u32)
    flip = ti.u32(0x80000000)
    if x < 0:
        flip = ti.u32(0xFFFFFFFF)
    return bits ^ flip
