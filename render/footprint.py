"""Footprint of a splat: the tiles that its ellipse touches, and the plane on which it lies along each pixel's ray.

A splat is given by `mean2d` and `conic` (render/projection.py), and `box` by `box_of`; `tile` is (width, height) of a
tile [px], `grid` the field (width, height [px], columns, rows of tiles) of the picture.
"""

import math

import taichi as ti

from core.fields import FieldGroup

CUTOFF_BITS = math.log2(255)  # a splat ends where its alpha falls below one 8-bit step, 2^-CUTOFF_BITS
ACROSS, DOWN = 4, 2  # cells of a tile on CUDA, each of which a warp draws
CELL = 8  # [px] width of a cell
MASK_COLUMNS, MASK_ROWS = 6, 5  # [tiles], 30 bits; a larger splat has no mask and is rasterised again when binned
CUTOFF_SLACK = 1e-3  # widens the tile test: rounding must not lose a pixel
MAX_TILT = 0.5  # of the distance: largest change of depth within the splat; beyond it, the plane is flattened
TILES = 1 << 18  # tiles of all views that are told apart; those beyond, of larger pictures, always count as changed

vec2, vec3, vec4 = ti.math.vec2, ti.math.vec3, ti.math.vec4


@ti.func
def clamp(x, low, high):
    """x within [low, high]."""
    return ti.min(ti.max(x, low), high)


@ti.func
def meets_picture(x: ti.f32, y: ti.f32, half_width: ti.f32, half_height: ti.f32, grid: ti.template()):
    """True if a box about the pixel position (x, y) overlaps the picture."""
    middle_x, middle_y = 0.5 * grid[None][0], 0.5 * grid[None][1]
    return ti.abs(x - middle_x) < half_width + middle_x and ti.abs(y - middle_y) < half_height + middle_y


@ti.func
def box_of(mean2d: vec4, conic: vec4) -> vec3:
    """Half width, half height and dy of the rightmost point [px] of a splat's visible ellipse."""
    size = (mean2d.z + CUTOFF_BITS + CUTOFF_SLACK) / conic[3]
    half_width = ti.sqrt(size * conic[2])
    return vec3(half_width, ti.sqrt(size * conic[0]), -conic[1] / conic[2] * half_width)


@ti.func
def tile_mask_of(mean2d: vec4, conic: vec4, box: vec3, tile: ti.template(), grid: ti.template()):
    """The entry of `Projection.tile_mask` for a splat."""
    left, right, top, bottom = tile_box(mean2d, box, tile, grid)
    fits = right - left <= MASK_COLUMNS and bottom - top <= MASK_ROWS
    touched, bits = 0, 0
    for row in range(top, bottom):
        first, last = tile_columns(row, left, right, mean2d, conic, box, tile)
        touched += last - first
        if fits:
            bits |= ((1 << (last - first)) - 1) << ((row - top) * MASK_COLUMNS + first - left)
    if not fits:
        bits = -touched
    return ti.Vector([left | top << 16, bits])


@ti.func
def tiles_in(mask) -> ti.i32:
    """Number of tiles of a tile mask."""
    return -mask[1] if mask[1] < 0 else ti.cast(ti.math.popcnt(mask[1]), ti.i32)


@ti.func
def masked_tile(corner: ti.i32, bits: ti.i32):
    """Row and column of the tile of the lowest bit of a tile mask."""
    lowest = ti.cast(ti.math.popcnt((bits & -bits) - 1), ti.i32)
    return (corner >> 16) + lowest // MASK_COLUMNS, (corner & 0xFFFF) + lowest % MASK_COLUMNS


@ti.func
def tile_box(mean2d: vec4, box: vec3, tile: ti.template(), grid: ti.template()):
    """Columns [left, right) and rows [top, bottom) of tiles with a pixel centre within the splat's box."""
    left, right = tiles_between(mean2d.x - box[0], mean2d.x + box[0], 0, grid[None][2], tile[0])
    top, bottom = tiles_between(mean2d.y - box[1], mean2d.y + box[1], 0, grid[None][3], tile[1])
    return left, right, top, bottom


@ti.func
def tile_columns(row: ti.i32, left: ti.i32, right: ti.i32, mean2d: vec4, conic: vec4, box: vec3, tile: ti.template()):
    """Columns [first, last) of tiles in a row of tiles that hold a pixel centre column of the ellipse.

    left and right are those of the splat's box.
    """
    first, last = left, right
    if right - left > 1:
        top = row * tile[1] + 0.5
        low, high = horizontal_extent(top, top + (tile[1] - 1), mean2d, conic, box)
        first, last = tiles_between(low, high, left, right, tile[0])
    return first, last


@ti.func
def touched_cells(row: ti.i32, column: ti.i32, mean2d: vec4, conic: vec4, box: vec3, tile: ti.template()):
    """A bit for each cell of a tile that a splat touches, row by row."""
    x0, height, bits = column * tile[0], ti.static(tile[1] // DOWN), 0
    for down in ti.static(range(DOWN)):
        top = row * tile[1] + down * height + 0.5
        if mean2d.y - box[1] <= top + (height - 1) and mean2d.y + box[1] >= top:
            left, right = horizontal_extent(top, top + (height - 1), mean2d, conic, box)
            for across in ti.static(range(ACROSS)):
                if left <= x0 + across * CELL + CELL - 0.5 and right >= x0 + across * CELL + 0.5:
                    bits |= 1 << (down * ACROSS + across)
    return bits


@ti.func
def horizontal_extent(top: ti.f32, bottom: ti.f32, mean2d: vec4, conic: vec4, box: vec3):
    """Left and right end [px] of an ellipse between two heights [px], where its box has a part.

    The right end x(dy) of an ellipse is concave in dy, so on a strip it is greatest at the
    rightmost point, clamped to the strip; likewise the left end, by symmetry.
    """
    left, right = mean2d.x - box[0], mean2d.x + box[0]
    A, B, C, det = conic[0], conic[1], conic[2], conic[3]
    if det > 1e-6 * A * C:  # a thinner one would need more digits: it keeps its box
        low, high = ti.max(top - mean2d.y, -box[1]), ti.min(bottom - mean2d.y, box[1])
        d = clamp(vec2(box[2], -box[2]), low, high)  # dy of the right and of the left end
        root = ti.sqrt(ti.max(A * (mean2d.z + CUTOFF_BITS + CUTOFF_SLACK) - det * d * d, 0.0))
        middle = mean2d.x - B / A * d
        left, right = middle[1] - root[1] / A, middle[0] + root[0] / A
    return left, right


@ti.func
def tiles_between(low: ti.f32, high: ti.f32, left: ti.i32, right: ti.i32, side: ti.template()):
    """Tiles [first, last) of `side` pixels, within [left, right), with a pixel centre in [low, high]."""
    first = ti.cast(ti.floor(clamp((low + 0.5) / side, float(left), float(right))), ti.i32)
    last = ti.cast(ti.floor(clamp((high + (side - 0.5)) / side, float(left), float(right))), ti.i32)
    return first, ti.max(first, last)


@ti.func
def depth_slope(camera: ti.template(), v: ti.i32, p: vec3, s: ti.template(), blur: ti.f32, cutoff: ti.f32) -> vec2:
    """Change of 1/z per pixel, (gx, gy) [1/(m px)], of a Gaussian along the rays of its pixels.

    p: its mean [m] in the frame of view `v`; s: its covariance [m^2] in the world; blur: variance of the pixel filter
    [px^2]; cutoff: where a splat ends [sigma^2].

    Along a ray from the eye with unit direction d, a Gaussian with mean p (seen from the eye) and covariance Sigma is
    densest at distance t = d^T Sigma^-1 p / d^T Sigma^-1 d.            Radl 2024 (StopThePop), per-pixel depth
    To first order about the mean this is where the ray meets a plane through the mean,

        1/t = a . d,   a = Sigma^-1 p / p^T Sigma^-1 p = (p/r - h) / r,   r = |p|,   h . p = 0.

    In ray space h is the slope of the Gaussian's conditional mean: the distance of a point w beside p is r + h . w.
    The plane is fixed in the world, so a turn of the head reorders nothing; for a flat Gaussian it is exact. A camera's
    pixel has d = (x, y, 1) / |(x, y, 1)|. Splats of a pixel are sorted in descending order of

        (x, y, 1) . a = 1/z_0 + gx dx + gy dy,   gx = a_x / fx,   gy = a_y / fy,

    at (dx, dy) [px] from the splat's centre, z_0 being the camera z of the mean. Sigma is thickened by the filter of a
    pixel at distance r: a Gaussian thinner than that gets no slope from rounding.
    """
    from_eye = vec3(0.0)  # p, along the world's axes
    for k in ti.static(range(3)):
        from_eye += p[k] * camera[v, k].xyz
    intrinsics = camera[v, 3]  # fx, fy, cx, cy
    a = depth_plane(from_eye, s, blur * p.dot(p) / (intrinsics.x * intrinsics.y), cutoff)
    return vec2(a.dot(camera[v, 0].xyz) / intrinsics.x, a.dot(camera[v, 1].xyz) / intrinsics.y)


@ti.func
def depth_plane(p: vec3, s: ti.template(), thickness: ti.f32, cutoff: ti.f32) -> vec3:
    """a [1/m] of the plane {x: a . x = 1} that approximates a Gaussian as seen from the eye.

    p: its mean [m]; s: Sigma as (xx, xy, xz, yy, yz, zz) [m^2]; thickness: added to each variance [m^2];
    cutoff: where a splat ends [sigma^2].
    """
    xx, yy, zz = s[0] + thickness, s[3] + thickness, s[5] + thickness
    n = vec3(
        (yy * zz - s[4] * s[4]) * p.x + (s[2] * s[4] - s[1] * zz) * p.y + (s[1] * s[4] - s[2] * yy) * p.z,
        (s[2] * s[4] - s[1] * zz) * p.x + (xx * zz - s[2] * s[2]) * p.y + (s[1] * s[2] - xx * s[4]) * p.z,
        (s[1] * s[4] - s[2] * yy) * p.x + (s[1] * s[2] - xx * s[4]) * p.y + (xx * yy - s[1] * s[1]) * p.z,
    )  # det(Sigma) Sigma^-1 p
    r = p.norm()
    ray = p / r
    h = vec3(0.0)
    if n.dot(ray) > 0:
        h = ray - n / n.dot(ray)
    edge = xx * h.x * h.x + yy * h.y * h.y + zz * h.z * h.z
    edge = cutoff * (edge + 2 * (s[1] * h.x * h.y + s[2] * h.x * h.z + s[4] * h.y * h.z))  # [m^2], squared
    if not (edge <= (MAX_TILT * r) ** 2):  # also if it is not a number
        h *= MAX_TILT * r / ti.sqrt(edge)
    return (ray - h) / r


@ti.data_oriented
class ChangedTiles:
    """Tiles of a picture that differ from the picture drawn before; the others keep their pixels.

    A tile is drawn anew if a splat that touches it, or touched it in the last picture, has changed.

    last i32[TILES]: number of the picture in which a tile changed last;   picture i32: number of this one;
    whole i32: number of the last picture of which everything is drawn.
    """

    def __init__(self):
        self.fields = f = FieldGroup()
        self.last = f.scalar(TILES, dtype=ti.i32)
        self.picture, self.whole = f.scalar(dtype=ti.i32), f.scalar(dtype=ti.i32)
        f.build()

    @ti.func
    def begin(self, whole: ti.i32):
        """Begin a picture, of which everything is drawn if `whole`; outermost level of a kernel."""
        self.picture[None] += 1
        if whole:
            self.whole[None] = self.picture[None]

    @ti.func
    def everywhere(self):
        """True if everything is drawn."""
        return self.whole[None] == self.picture[None]

    @ti.func
    def add(self, v, mean2d, conic, tile: ti.template(), grid: ti.template()):
        """Mark all tiles in the box of a splat of view v, see `Projection`."""
        if not self.everywhere():
            columns, rows = grid[None][2], grid[None][3]
            left, right, top, bottom = tile_box(mean2d, box_of(mean2d, conic), tile, grid)
            for row in range(top, bottom):
                for column in range(left, right):
                    t = (v * rows + row) * columns + column
                    if t < TILES:
                        self.last[t] = self.picture[None]

    @ti.func
    def has(self, t):
        """True if tile t must be drawn anew."""
        changed = t >= TILES or self.everywhere()
        if not changed:
            changed = self.last[t] == self.picture[None]
        return changed

    def destroy(self) -> None:
        """Free the device memory."""
        self.fields.destroy()


@ti.func
def differ(a, b):
    """True if two vectors of four differ anywhere."""
    result = False
    for k in ti.static(range(4)):
        if a[k] != b[k]:
            result = True
    return result
