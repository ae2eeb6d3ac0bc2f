"""Projection of Gaussians to splats: their outlines, colour, and the tiles that each splat touches, per view."""

import math

import numpy as np
import taichi as ti

from core.camera import Camera
from core.fields import FieldGroup, load_quad, store_quad
from core.lanes import dealt
from render import SORTS
from render.footprint import (
    ChangedTiles,
    box_of,
    clamp,
    depth_slope,
    differ,
    masked_tile,
    meets_picture,
    tile_box,
    tile_columns,
    tile_mask_of,
    tiles_in,
)
from render.radix_sort import DROPPED, item_of, key_of, value_of
from render.splats import Splats, color_of

NEAR_PLANE = 0.01  # [m] of camera z
DILATION = 0.3  # [px^2] added to the variance: a splat is never thinner than a pixel's filter
GUARD_BAND = 0.3  # with `linear`, the Jacobian's x/z is held within the picture plus this fraction of tan(fov / 2)
OUTLINE = 2 * math.log(2)  # [sigma^2] of the outline that is projected exactly: where half of the opacity is left
# Most OUTLINE var(z) / z^2: what reaches farther towards the eye is flattened along the view. At 1 the outline would
# pass the eye; of 0.15 to 0.7, this has the least error of Gaussians within and beside a picture of 100 degrees.
MAX_REACH = 0.3
# A Gaussian's sort key: its depth in three digits of the sort, and above them the number of its pairs, MANY or more.
DEPTH_BITS, MANY = 24, 255
MAX_DEPTH, KEY_STEP = 2e6, 11  # [m]; [floats] of one key: the 22 * 2^23 floats up to MAX_DEPTH have keys
COLOR_REACH = 0.002  # [m] that an eye may move before colours are seen anew: 79 dB, no pixel off by more than 1/255
MAX_COLOR, MAX_VARIANCE = 1e6, 1e15  # a colour, a variance [px^2] beyond is broken, and is not drawn
MAX_CUTOFF = 2 * math.log(255) + 0.01  # [sigma^2] at which an opaque splat ends
HALF_LOG2_E = 0.5 * math.log2(math.e)  # exp(-q/2) = 2^(-HALF_LOG2_E q)

vec3, vec4 = ti.math.vec3, ti.math.vec4


@ti.data_oriented
class Projection:
    """Splats of all `views` in pixels, and the depths by which they are sorted.

    tile       (width, height) of a tile [px]
    camera     vec4 (views, 4): three rows of world_to_camera, then (fx, fy, cx, cy)
    near       least camera z [m] that is drawn, (views,)
    grid       (width, height [px], columns, rows of tiles): a field, so that another picture size needs no new kernels
    changed    tiles that differ from the last picture, or None if they are not wanted
    linear     splats are projected by the Jacobian at the mean (EWA), as gsplat does and gradients assume
    still      number of Gaussians at the beginning of which nothing but the visibility ever changes: a view that has
               been projected is kept, their sort keys in `kept_key`. Their colours without visibility are `kept_color`,
               (r, g, b, bits of their `color_age`); those of an older age are seen anew. An age ends when the eye has
               moved by more than `color_reach` [m] from `color_eye`

    Out, of shape (views, capacity):
    mean2d     (x, y [px], log2 opacity, camera z [m]); (x, y) is the centre of the outline
    conic      (A, B, C, A C - B^2): alpha = 2^(log2 opacity - A dx^2 - 2 B dx dy - C dy^2)
    color      (r, g, b, on a CPU the half height [px] of `box_of`)
    slope      changes of 1/z per column and per row [1/(m px)], see `depth_slope`; with sort="pixel" only
    tile_mask  vec2 i32, the tiles it touches: the first column | first row << 16; bit MASK_COLUMNS row + column for
               tile (column, row) from there, or minus their number if they exceed the mask
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
        linear: bool = False,
        still: int = 0,
        color_reach: float = 0.0,
        changed: ChangedTiles | None = None,
    ):
        if sort not in SORTS:
            raise ValueError(f"sort must be one of {', '.join(SORTS)}, not {sort!r}")
        self.splats, self.radial, self.with_slope = splats, sort != "z", sort == "pixel"
        self.views, self.tile, self.antialias, self.with_color = views, tile, antialias, color
        self.linear = linear
        self.still, self.keeps, self.color_reach = still, still > 0, color_reach
        self.keeps_color = self.keeps and splats.coefficients > 1  # else it is the same from everywhere
        self.changed, self.compares = changed, changed is not None
        self.on_gpu = ti.cfg.arch == ti.cuda
        self.fields = f = FieldGroup()
        with f.interleaved(views, splats.capacity):
            self.mean2d, self.conic, self.color = (f.vector(views, splats.capacity, n=4) for _ in range(3))
        self.kept_color = f.vector(1, still if self.keeps_color else 1, n=4)  # aligned, see `load_quad`
        self.camera = f.vector(views, 4, n=4)
        self.near = f.scalar(views)
        self.grid = f.vector(n=4, dtype=ti.i32)
        self.tile_mask = f.vector(
            views, splats.capacity, n=2, dtype=ti.i32, column_major=True
        )  # both eyes' side by side
        self.slope = f.vector(views, splats.capacity if self.with_slope else 1, n=2)
        self.kept_key = f.scalar(max(still, 1), dtype=ti.u32)
        self.color_age, self.color_eye = f.scalar(dtype=ti.i32), f.vector()
        f.build()
        self.near.fill(NEAR_PLANE)
        self.set_size(width, height)

    def set_size(self, width: int, height: int) -> None:
        """Set the picture size [px]."""
        self.tiles = (-(-width // self.tile[0]), -(-height // self.tile[1]))  # columns, rows
        self.grid[None] = [width, height, *self.tiles]

    def destroy(self) -> None:
        """Free the device memory."""
        self.fields.destroy()

    @ti.func
    def set_camera(self, v: ti.template(), words: ti.template()):
        """Set the camera of a view to `camera_words`."""
        for k in ti.static(range(4)):
            self.camera[v, k] = vec4(*two_numbers(words[2 * k]), *two_numbers(words[2 * k + 1]))

    @ti.func
    def project(self, begin: ti.i32, end: ti.i32, kept: ti.i32, whole: ti.i32, sorter: ti.template()):
        """Project Gaussians [begin, end) and give `sorter` their depths; outermost level of a kernel.

        Of those below `kept` only the visibility is renewed: the last call projected them for the same cameras. If it
        is negative, what stands still has changed. All tiles count as changed if `whole`.

        Sigma_2D = J W Sigma W^T J^T + 0.3 I, J = [[fx/z, 0, -fx x/z^2], [0, fy/z, -fy y/z^2]]
        with x/z and y/z held near the picture.                       Zwicker 2001; Kerbl 2023
        Unless `linear`, it is corrected to the exact outline, see `_outline`.
        """
        if ti.static(self.compares):
            self.changed.begin(whole)
        sorter.count[None] = ti.max(end - begin, 0)
        if ti.static(self.keeps):
            eye = self._eye()
            if kept < 0 or (eye - self.color_eye[None]).norm() > self.color_reach:
                self.color_eye[None] = eye
                self.color_age[None] += 1
        for k in range(end - begin):
            g = begin + dealt(k, end - begin)
            key, c = ti.u32(DROPPED), vec3(0.0)
            if ti.static(self.keeps) and g < kept:
                key = self.kept_key[g]
                if key != ti.u32(DROPPED):
                    c = self._color(g, self.splats.mean[g])
            else:
                key, c = self._project(g)
                if ti.static(self.keeps):  # noqa: SIM102, the outer one is resolved at compile time
                    if g < self.still:
                        self.kept_key[g] = key
            if ti.static(self.with_color):  # noqa: SIM102
                if key != ti.u32(DROPPED):
                    c = ti.max(0.0, c) * self.splats.visibility[g]
                    for v in range(self.views):
                        self._set_color(v, g, c)
            sorter.items[g - begin] = item_of(key, g)

    @ti.func
    def drop_unchanged(self, sorter: ti.template()):
        """Drop from `sorter` what touches no tile that is drawn anew; outermost level of a kernel."""
        for k in range(sorter.count[None]):
            i = dealt(k, sorter.count[None])
            item = sorter.items[i]
            if not self.changed.everywhere() and key_of(item) != ti.u32(DROPPED):
                touched = 0
                for v in range(self.views):
                    touched += self.tile_count(v, value_of(item))
                if touched == 0:
                    sorter.items[i] = item_of(ti.u32(DROPPED), 0)

    @ti.func
    def _project(self, g: ti.i32):
        """Write the splats of Gaussian g but for their colour; its sort key, and its colour in full light."""
        mean, opacity = self.splats.mean[g], self.splats.opacity[g]
        depth, seen, pairs, c = ti.f64(0.0), 0, 0, vec3(0.0)
        for v in range(self.views):
            p = self._to_camera(v, mean)
            depth += p.norm() if ti.static(self.radial) else p.z
            mask, drawn = ti.Vector([0, 0]), self.tile_mask[v, g][1] != 0
            if p.z >= self.near[v] and opacity >= 1 / 255:
                mask = self._project_to(v, g, ti.cast(p, ti.f32), ti.min(opacity, 1.0), drawn)
            if drawn and mask[1] == 0:
                self._add_changed(v, self.mean2d[v, g], self.conic[v, g])
            self.tile_mask[v, g] = mask
            seen |= mask[1]
            pairs += tiles_in(mask)
        key = ti.u32(DROPPED)
        if ti.static(self.with_color):  # noqa: SIM102, the outer one is resolved at compile time
            if seen != 0:
                c = self._color(g, mean)
                if not (ti.abs(c).sum() < MAX_COLOR):  # also if it is not a number
                    seen = 0
                    for v in range(self.views):
                        self.tile_mask[v, g] = ti.Vector([0, 0])
        if seen != 0:
            key = ti.cast(ti.min(pairs, MANY), ti.u32) << ti.u32(DEPTH_BITS)
            key |= depth_key(ti.cast(depth / self.views, ti.f32))
        return key, c

    @ti.func
    def _color(self, g: ti.i32, mean: vec3) -> vec3:
        """The colour of Gaussian g in full light; of one that stands still, it is kept while it is of this age."""
        c, is_kept = vec3(0.0), False
        if ti.static(self.keeps_color):  # noqa: SIM102, the outer one is resolved at compile time
            if g < self.still:
                kept = load_quad(self.kept_color, 0, g)
                c, is_kept = kept.xyz, ti.bit_cast(kept.w, ti.i32) == self.color_age[None]
        if not is_kept:
            c = color_of(self.splats, g, mean - self._eye())
            if ti.static(self.keeps_color):  # noqa: SIM102, the outer one is resolved at compile time
                if g < self.still:
                    store_quad(self.kept_color, 0, g, vec4(c, ti.bit_cast(self.color_age[None], ti.f32)))
        return c

    @ti.func
    def _set_color(self, v: ti.i32, g: ti.i32, c: vec3):
        """Write the colour of splat `g` of view `v`, which has been projected."""
        new = vec4(c, 0.0)
        if ti.static(not self.on_gpu):
            new[3] = self.color[v, g][3]
        if ti.static(self.compares):  # noqa: SIM102, the outer one is resolved at compile time
            if self.tile_mask[v, g][1] != 0 and differ(new, self.color[v, g]):
                self._add_changed(v, self.mean2d[v, g], self.conic[v, g])
        store_quad(self.color, v, g, new)

    @ti.func
    def _add_changed(self, v: ti.i32, mean2d: vec4, conic: vec4):
        if ti.static(self.compares):
            self.changed.add(v, mean2d, conic, self.tile, self.grid)

    @ti.func
    def tile_count(self, v: ti.i32, g: ti.i32) -> ti.i32:
        """Number of tiles of view `v` that splat `g` touches, of those that are drawn."""
        corner, bits = self.tile_mask[v, g][0], self.tile_mask[v, g][1]
        count = tiles_in(self.tile_mask[v, g])
        if ti.static(self.compares):
            if bits != 0 and not self.changed.everywhere():
                count = 0
                while bits > 0:
                    row, column = masked_tile(corner, bits)
                    count += ti.cast(self.draws(self.tile_at(v, row, column)), ti.i32)
                    bits &= bits - 1
            if bits < 0 and not self.changed.everywhere():
                mean2d, conic = self.mean2d[v, g], self.conic[v, g]
                box = box_of(mean2d, conic)
                left, right, top, bottom = tile_box(mean2d, box, self.tile, self.grid)
                for row in range(top, bottom):
                    first, last = tile_columns(row, left, right, mean2d, conic, box, self.tile)
                    for column in range(first, last):
                        count += ti.cast(self.draws(self.tile_at(v, row, column)), ti.i32)
        return count

    @ti.func
    def inside(self, x: ti.i32, y: ti.i32):
        """True if a pixel lies in the picture, and not in a tile's part beyond its border."""
        return x < self.grid[None][0] and y < self.grid[None][1]

    @ti.func
    def place_of(self, tile: ti.i32, size: ti.template()):
        """View of a tile, and its first column and row [px]; `size`: (width, height) of a tile."""
        columns, rows = self.grid[None][2], self.grid[None][3]
        in_view = tile % (columns * rows)
        return tile // (columns * rows), in_view % columns * size[0], in_view // columns * size[1]

    @ti.func
    def tile_at(self, v: ti.i32, row: ti.i32, column: ti.i32) -> ti.i32:
        """Number of a tile: row by row, view by view."""
        return (v * self.grid[None][3] + row) * self.grid[None][2] + column

    @ti.func
    def draws(self, tile: ti.i32):
        """True if a tile is drawn, and does not keep its pixels."""
        result = True
        if ti.static(self.compares):
            result = self.changed.has(tile)
        return result

    @ti.func
    def _to_camera(self, v: ti.i32, x: vec3):
        """x in the frame of view `v`, in float64, so that nearly equal depths have the same order on every device."""
        p = ti.Vector([0.0, 0.0, 0.0], dt=ti.f64)
        for k in ti.static(range(3)):
            row = ti.cast(self.camera[v, k], ti.f64)
            p[k] = row.xyz.dot(ti.cast(x, ti.f64)) + row.w
        return p

    @ti.func
    def _eye(self) -> vec3:
        """Mean of the camera centres [m]."""
        eye = vec3(0.0)
        for v in ti.static(range(self.views)):
            for k in ti.static(range(3)):
                eye -= self.camera[v, k].w * self.camera[v, k].xyz / self.views
        return eye

    @ti.func
    def held_tangents(self, v: ti.i32, x: ti.f32, y: ti.f32):
        """x/z and y/z of a point in the frame of view `v`, held near the picture."""
        intrinsics = self.camera[v, 3]
        fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
        width, height = self.grid[None][0], self.grid[None][1]
        band = ti.static(0.5 * GUARD_BAND if self.linear else 0.0)
        margin_x, margin_y = band * width / fx, band * height / fy
        held_x = clamp(x, -cx / fx - margin_x, (width - cx) / fx + margin_x)
        held_y = clamp(y, -cy / fy - margin_y, (height - cy) / fy + margin_y)
        return held_x, held_y

    @ti.func
    def _outline(self, v: ti.i32, x: ti.f32, y: ti.f32, p: vec3, s: ti.template()):
        """Tangents of the Jacobian for the exact outline of a Gaussian, its level k^2 [sigma^2], the part of its extent
        along the view that is kept, and k^2 g of that. In float64, like the determinant.

        p: its mean [m] in the frame of view `v`; s: its covariance [m^2]; x, y: the tangents held within the picture

        Seen from the eye, the ellipsoid of k sigma has the dual conic p p^T - k^2 Sigma: an ellipse exactly (Eberly
        1999), which is that of EWA, A = J Sigma J^T, with e = cov(J r, z) / z and g = var(z) / z^2, corrected to

            centre = J's - h e,   Sigma_2D = A / (1 - k^2 g) + h^2 / k^2 e e^T,   h = k^2 / (1 - k^2 g).

        k is that of OUTLINE; of a mean beside the picture that of the ellipse that touches the picture's edge. There,
        and near the eye, k^2 g would reach 1. Then z is flattened by f = sqrt(MAX_REACH / (k^2 g)), along the ray
        through the nearest point of the picture, so that its edge is touched as before: with f = 0 it is EWA's splat
        with held tangents.
        """
        forward = ti.cast(self.camera[v, 2].xyz, ti.f64)
        g = forward.dot(times(s, forward)) / (p.z * p.z)
        level = ti.cast(OUTLINE, ti.f64)
        beyond_x, beyond_y = p.x / p.z - x, p.y / p.z - y
        if x != ti.cast(p.x / p.z, ti.f32):
            across = (self.camera[v, 0].xyz - x * forward) / p.z
            level = ti.max(level, beyond_x * beyond_x / ti.max(across.dot(times(s, across)), 1e-20))
        if y != ti.cast(p.y / p.z, ti.f32):
            across = (self.camera[v, 1].xyz - y * forward) / p.z
            level = ti.max(level, beyond_y * beyond_y / ti.max(across.dot(times(s, across)), 1e-20))
        kept = ti.sqrt(MAX_REACH / ti.max(MAX_REACH, level * g))
        return x + kept * beyond_x, y + kept * beyond_y, level, kept, level * g * kept * kept

    @ti.func
    def _project_to(self, v: ti.i32, g: ti.i32, p: vec3, opacity: ti.f32, drawn: ti.i32):
        """Write splat `g` of view `v` and return its tile mask; `drawn` if the last picture had it."""
        intrinsics = self.camera[v, 3]
        fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
        x, y = self.held_tangents(v, p.x / p.z, p.y / p.z)
        scale_x, scale_y = fx / p.z, fy / p.z  # [px/m]
        mx, my = scale_x * p.x + cx, scale_y * p.y + cy
        s = self.splats.cov[g]
        size = s[0] + s[3] + s[5]  # at least the largest eigenvalue: this box contains the splat's
        bound_x = ti.sqrt(MAX_CUTOFF * (scale_x * scale_x * (1 + x * x) * size + DILATION))
        bound_y = ti.sqrt(MAX_CUTOFF * (scale_y * scale_y * (1 + y * y) * size + DILATION))
        mask = ti.Vector([0, 0])
        if meets_picture(mx, my, bound_x, bound_y, self.grid):
            # In float64: a needle's determinant is the small difference of large numbers.
            wide, forward = ti.cast(s, ti.f64), self.camera[v, 2].xyz
            level, kept, reach = ti.f64(0.0), ti.f64(1.0), ti.f64(0.0)
            if ti.static(not self.linear):
                x, y, level, kept, reach = self._outline(v, x, y, ti.cast(p, ti.f64), wide)
            jx = scale_x * (self.camera[v, 0].xyz - x * forward)  # the rows of J W
            jy = scale_y * (self.camera[v, 1].xyz - y * forward)
            ax, ay = ti.cast(jx, ti.f64), ti.cast(jy, ti.f64)
            sx, sy = times(wide, ax), times(wide, ay)
            sharp_xx, sharp_xy, sharp_yy = ax.dot(sx), ay.dot(sx), ay.dot(sy)
            sharp = sharp_xx * sharp_yy - sharp_xy * sharp_xy
            if ti.static(not self.linear):
                ex, ey = kept / p.z * forward.dot(sx), kept / p.z * forward.dot(sy)
                rest = 1.0 - reach
                bend, shift = level / (rest * rest), level / rest  # h^2 / k^2, h
                sharp = sharp / (rest * rest) + bend / rest * (
                    ex * ex * sharp_yy - 2.0 * ex * ey * sharp_xy + ey * ey * sharp_xx
                )  # the determinant, without the difference of large numbers
                sharp_xx = sharp_xx / rest + bend * ex * ex
                sharp_xy = sharp_xy / rest + bend * ex * ey
                sharp_yy = sharp_yy / rest + bend * ey * ey
                mx -= ti.cast(shift * ex, ti.f32)
                my -= ti.cast(shift * ey, ti.f32)
            exact = sharp + DILATION * (sharp_xx + sharp_yy) + DILATION * DILATION
            if ti.static(self.antialias):
                opacity *= ti.cast(ti.sqrt(ti.max(0.0, sharp / exact)), ti.f32)
            xx, yy = ti.cast(sharp_xx + DILATION, ti.f32), ti.cast(sharp_yy + DILATION, ti.f32)
            xy, det = ti.cast(sharp_xy, ti.f32), ti.cast(exact, ti.f32)
            if xx < MAX_VARIANCE and yy < MAX_VARIANCE and exact > 0 and is_covariance(wide) and opacity >= 1 / 255:
                log_opacity = ti.log(opacity) * (2 * HALF_LOG2_E)
                A, B, C = yy * HALF_LOG2_E / det, -xy * HALF_LOG2_E / det, xx * HALF_LOG2_E / det
                mean2d, conic = vec4(mx, my, log_opacity, p.z), vec4(A, B, C, HALF_LOG2_E * HALF_LOG2_E / det)
                box = box_of(mean2d, conic)
                if meets_picture(mx, my, box[0], box[1], self.grid):
                    if ti.static(self.with_slope):
                        slope = depth_slope(self.camera, v, p, s, DILATION, MAX_CUTOFF)
                        self.slope[v, g] = slope
                        if ti.static(not self.linear):  # at the centre that has been shifted
                            off = ti.math.vec2(mx - scale_x * p.x - cx, my - scale_y * p.y - cy)
                            mean2d.w = 1.0 / (1.0 / p.z + slope.dot(off))
                    if ti.static(self.compares):
                        if not drawn:
                            self._add_changed(v, mean2d, conic)
                        elif differ(mean2d, self.mean2d[v, g]) or differ(conic, self.conic[v, g]):
                            self._add_changed(v, self.mean2d[v, g], self.conic[v, g])
                            self._add_changed(v, mean2d, conic)
                    if ti.static(not self.on_gpu):
                        self.color[v, g][3] = box[1]
                    store_quad(self.mean2d, v, g, mean2d)
                    store_quad(self.conic, v, g, conic)
                    mask = tile_mask_of(mean2d, conic, box, self.tile, self.grid)
        return mask


def camera_values(camera: Camera) -> list[float]:
    """Three rows of world_to_camera, then fx, fy, cx, cy: 16 numbers."""
    rows = np.asarray(camera.world_to_camera, np.float64)[:3].ravel().tolist()
    return [*rows, camera.fx, camera.fy, camera.cx, camera.cy]


def camera_words(camera: Camera) -> list[int]:
    """`camera_values` as float32, two in each of 8 words: half as many arguments of a kernel."""
    return np.array(camera_values(camera), np.float32).view(np.int64).tolist()


@ti.func
def two_numbers(word: ti.i64):
    """The floats in the lower and in the upper half of a word."""
    return ti.bit_cast(key_of(word), ti.f32), ti.bit_cast(value_of(word), ti.f32)


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
    """True if no principal minor up to 2 x 2 of (xx, xy, xz, yy, yz, zz) is negative, within rounding."""
    xy, xz, yz = 1.001 * s[0] * s[3] - s[1] ** 2, 1.001 * s[0] * s[5] - s[2] ** 2, 1.001 * s[3] * s[5] - s[4] ** 2
    return s[0] >= 0 and s[3] >= 0 and s[5] >= 0 and xy >= 0 and xz >= 0 and yz >= 0


@ti.func
def depth_key(x: ti.f32) -> ti.u32:
    """DEPTH_BITS bits that compare as depths x [m] do, from -0.5, since an eye may see what lies behind the other, to
    MAX_DEPTH; in steps of 1e-6 of 1 + x."""
    bits = ti.bit_cast(1.0 + clamp(x, -0.5, MAX_DEPTH), ti.u32)
    return (bits - ti.bit_cast(0.5, ti.u32)) // ti.u32(KEY_STEP)
