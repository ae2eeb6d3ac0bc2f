"""From Gaussians to splats: EWA projection, colour, footprint and the tiles it touches, per view."""

import math

import taichi as ti

from render.color import color_of
from render.footprint import SLACK, STEPS, Footprint, clamp
from render.radix_sort import DROPPED, item_of
from render.ray_depth import slope
from render.sort_modes import SORTS
from render.splats import Splats

NEAR = 0.01  # [m] of camera z
DILATION = 0.3  # [px^2] added to the variance: a splat is never thinner than a pixel's filter
EDGE = 0.3  # the Jacobian's x/z is held within the picture plus this share of tan(fov / 2)
BRIGHTEST, WIDEST = 1e6, 1e15  # a colour, a variance [px^2] beyond is broken, and is not drawn
MOST_REACH = 2 * math.log(255) + 0.01  # [sigma^2] where the most opaque splat ends
HALF_LOG2_E = 0.5 * math.log2(math.e)  # exp(-q/2) = 2^(-HALF_LOG2_E q)

vec3, vec4 = ti.math.vec3, ti.math.vec4


@ti.data_oriented
class Projection(Footprint):
    """Splats of all `views` in pixels, and the depth by which they are sorted.

    `tile`, (width, height) of a tile [px].
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
        tile: tuple[int, int],
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
        builder.dense(ti.j, splats.capacity).dense(ti.i, views).place(self.window)  # both eyes' side by side
        self.tree = builder.finalize()
        self.near.fill(NEAR)
        self.set_size(width, height)

    def set_size(self, width: int, height: int) -> None:
        """Pictures are width x height [px] from now on."""
        self.tiles = (-(-width // self.tile[0]), -(-height // self.tile[1]))  # columns, rows
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
            depth = ti.f64(0.0)
            seen = 0
            for v in range(self.views):
                p = self._to_camera(v, mean)
                depth += p.norm() if ti.static(self.radial) else p.z
                window = ti.Vector([0, 0])
                if p.z >= self.near[v] and opacity >= 1 / 255:
                    window = self._project_to(v, g, ti.cast(p, ti.f32), ti.min(opacity, 1.0))
                self.window[v, g] = window
                seen |= window[1]
            key = ti.u32(DROPPED)
            if ti.static(self.with_color):  # noqa: SIM102, one is for the compiler
                if seen != 0:
                    c = color_of(self.splats, g, mean - self._eye())
                    if not (ti.abs(c).sum() < BRIGHTEST):  # nor if it is no number
                        seen = 0
                    c = ti.max(0.0, c) * self.splats.light[g]
                    for v in range(self.views):
                        for k in ti.static(range(3)):
                            self.color[v, g][k] = c[k]
            if seen != 0:
                key = ordered_bits(ti.cast(depth / self.views, ti.f32))
            sorter.items[g - begin] = item_of(key, g)
        sorter.count[None] = ti.max(end - begin, 0)

    @ti.func
    def _to_camera(self, v: ti.i32, x: vec3):
        """In float64, so that the order of what is nearly as far is the same on every device."""
        p = ti.Vector([0.0, 0.0, 0.0], dt=ti.f64)
        for k in ti.static(range(3)):
            row = ti.cast(self.camera[v, k], ti.f64)
            p[k] = row.xyz.dot(ti.cast(x, ti.f64)) + row.w
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
            # In float64: a needle's determinant is the small difference of large numbers.
            wide, ax, ay = ti.cast(s, ti.f64), ti.cast(jx, ti.f64), ti.cast(jy, ti.f64)
            sx = times(wide, ax)
            sharp_xx, sharp_xy, sharp_yy = ax.dot(sx), ay.dot(sx), ay.dot(times(wide, ay))
            sharp = sharp_xx * sharp_yy - sharp_xy * sharp_xy
            exact = sharp + DILATION * (sharp_xx + sharp_yy) + DILATION * DILATION
            if ti.static(self.antialias):
                opacity *= ti.cast(ti.sqrt(ti.max(0.0, sharp / exact)), ti.f32)
            xx, yy = ti.cast(sharp_xx + DILATION, ti.f32), ti.cast(sharp_yy + DILATION, ti.f32)
            xy, det = ti.cast(sharp_xy, ti.f32), ti.cast(exact, ti.f32)
            if xx < WIDEST and yy < WIDEST and exact > 0 and is_covariance(wide) and opacity >= 1 / 255:
                log_opacity = ti.log(opacity) * (2 * HALF_LOG2_E)
                reach = (log_opacity + STEPS + SLACK) / HALF_LOG2_E  # squared, in sigmas
                half_width, half_height = ti.sqrt(reach * xx), ti.sqrt(reach * yy)
                if self._meets_picture(mx, my, half_width, half_height):
                    A, B, C = yy * HALF_LOG2_E / det, -xy * HALF_LOG2_E / det, xx * HALF_LOG2_E / det
                    place = vec4(mx, my, log_opacity, p.z)
                    conic = vec4(A, B, C, HALF_LOG2_E * HALF_LOG2_E / det)
                    box = vec4(half_width, half_height, -B / C * half_width, 0.0)
                    if ti.static(self.with_slope):
                        change = slope(self.camera, v, p, s, DILATION, MOST_REACH)
                        box[3], self.color[v, g][3] = change.x, change.y
                    self.place[v, g], self.conic[v, g], self.box[v, g] = place, conic, box
                    window = self._window(place, conic, box)
        return window


@ti.func
def times(s: ti.template(), x: ti.template()):
    """Symmetric matrix (xx, xy, xz, yy, yz, zz) times x."""
    return ti.Vector(
        [
            s[0] * x[0] + s[1] * x[1] + s[2] * x[2],
            s[1] * x[0] + s[3] * x[1] + s[4] * x[2],
            s[2] * x[0] + s[4] * x[1] + s[5] * x[2],
        ]
    )


@ti.func
def is_covariance(s: ti.template()):
    """Whether (xx, xy, xz, yy, yz, zz) can be one, but for rounding: no axis explains less than nothing."""
    xy, xz, yz = 1.001 * s[0] * s[3] - s[1] ** 2, 1.001 * s[0] * s[5] - s[2] ** 2, 1.001 * s[3] * s[5] - s[4] ** 2
    return s[0] >= 0 and s[3] >= 0 and s[5] >= 0 and xy >= 0 and xz >= 0 and yz >= 0


@ti.func
def ordered_bits(x: ti.f32) -> ti.u32:
    """Bits of x that compare as unsigned integers the way floats compare."""
    bits = ti.bit_cast(x, ti.u32)
    flip = ti.u32(0x80000000)
    if x < 0:
        flip = ti.u32(0xFFFFFFFF)
    return bits ^ flip
