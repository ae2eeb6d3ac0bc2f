"""Foveation: every pixel is drawn about the gaze, every second around that, every fourth beyond, in each direction.

The samples form a grid of rows and columns that is smaller than the picture, drawn in the same tiles by the same
kernels: a coordinate u of the grid stands at x(u) in the picture, monotone and piecewise linear,

    du/dx = 1 within the fovea,  1/2 in a ring about it,  1/4 beyond.                  Guenter 2012, in one pass

The picture is interpolated between the samples, so no seam shows; within the fovea they are its pixels. All zones
begin at multiples of ALIGNMENT tiles of the picture: samples stay where they are while the gaze moves, and tiles of the
fovea are tiles of a full picture, to the bit.
"""

import math

import numpy as np
import taichi as ti

from core.fields import FieldGroup

RADIUS = 0.12  # of the picture's longer side: 13 degrees in a picture 90 degrees wide, beyond an eye's sharpest 5
ROW_THREADS = 512  # of a row of the picture on CUDA
ALIGNMENT = 4  # [tiles]: a tile of the coarsest zone
# A splat's variance [px^2] grows by this times (spacing^2 - 1). While a toy turns, coarse means of the picture then
# change up to a third less in ways that a full picture's do not; a wider filter would blur more for no gain.
BLUR = 0.075
MAX_BLUR = BLUR * (4**2 - 1)


@ti.data_oriented
class Fovea:
    """Where samples of a picture stand, for each of `views`; coordinates of pixel k's middle are k + 0.5.

    edges   vec4 (views, 2): where ring and fovea begin and end [px] in x and in y;   ends: in the grid
    drawn   (width, height) of the grid [samples]
    samples the grid's pixels, ti.ndarray u32 (views * height, width) as `Picture` has them
    """

    def __init__(self, views: int, tile: tuple[int, int]):
        self.views, self.tile, self.drawn = views, tile, (0, 0)
        self.row_threads = ROW_THREADS if ti.cfg.arch == ti.cuda else 1
        self.fields = f = FieldGroup()
        self.edges, self.ends = f.vector(views, 2, n=4), f.vector(views, 2, n=4)
        f.build()
        self.samples = ti.ndarray(ti.u32, (1, 1))

    def destroy(self) -> None:
        """Free the device memory."""
        self.fields.destroy()

    def zones(self, gazes, width: int, height: int) -> np.ndarray:
        """`edges` for these points (views, 2) [px] of a picture of width x height [px]."""
        radius, steps = RADIUS * max(width, height), [ALIGNMENT * side for side in self.tile]
        sides = (width, height)
        return np.array([[zone_edges(gaze[k], sides[k], radius, steps[k]) for k in range(2)] for gaze in gazes])

    def place(self, gazes, width: int, height: int) -> None:
        """Look at these points (views, 2) [px] of a picture of width x height [px]."""
        edges = self.zones(gazes, width, height)
        ends = [grid_coordinates(edges[:, axis], side) for axis, side in enumerate((width, height))]
        self.drawn = tuple(math.ceil(end.max()) for end in ends)
        self.edges.from_numpy(edges.astype(np.float32))
        self.ends.from_numpy(
            np.stack([grid_coordinates(edges, edges[..., k]) for k in range(4)], -1).astype(np.float32)
        )
        if self.samples.shape != (self.views * height, width):
            self.samples = ti.ndarray(ti.u32, (self.views * height, width))

    @ti.func
    def to_grid(self, v, axis: ti.template(), x: ti.f32) -> ti.f32:
        """Coordinate in the grid of coordinate x [px] in the picture; exact where x is a multiple of 1/2."""
        e = self.edges[v, axis]
        ring, fovea = ti.min(ti.max(x - e[0], 0.0), e[3] - e[0]), ti.min(ti.max(x - e[1], 0.0), e[2] - e[1])
        return 0.25 * x + 0.25 * ring + 0.5 * fovea

    @ti.func
    def to_picture(self, v, axis: ti.template(), u: ti.f32) -> ti.f32:
        """Coordinate [px] in the picture of coordinate u in the grid: the inverse of `to_grid`."""
        ends = self.ends[v, axis]
        ring = ti.min(ti.max(u - ends[0], 0.0), ends[3] - ends[0])
        fovea = ti.min(ti.max(u - ends[1], 0.0), ends[2] - ends[1])
        return 4.0 * u - 2.0 * ring - fovea

    @ti.func
    def spacing(self, v, axis: ti.template(), low: ti.f32, high: ti.f32) -> ti.f32:
        """Least distance [px] between samples from low to high [px]."""
        e, result = self.edges[v, axis], 4.0
        if high > e[0] and low < e[3]:
            result = 2.0
        if high > e[1] and low < e[2]:
            result = 1.0
        return result

    @ti.func
    def interpolate(self, samples: ti.template(), out: ti.template()):
        """Write the picture `out` from `samples`; outermost level of a kernel.

        Between samples 1, 2 or 4 px apart all weights are multiples of 1/8: integers, two channels of a word at a time.
        """
        threads = ti.static(self.row_threads)
        for k in range(out.shape[0] * threads):
            line, height = k // threads, out.shape[0] // self.views
            v, first, width = line // height, line // height * height, out.shape[1]
            last_column, last_row = self.last_sample(v, 0, width), self.last_sample(v, 1, height)
            top, bottom, t = self.neighbours(v, 1, line - first, last_row)
            for step in range((width + threads - 1) // threads):
                x = step * threads + k % threads
                if x < width:
                    left, right, s = self.neighbours(v, 0, x, last_column)
                    packed = samples[first + top, left]
                    if s + t > 0:
                        upper = spread(packed) * (8 - s) + spread(samples[first + top, right]) * s
                        lower = spread(samples[first + bottom, left]) * (8 - s)
                        lower += spread(samples[first + bottom, right]) * s
                        packed = gathered(upper * (8 - t) + lower * t)
                    out[line, x] = packed

    @ti.func
    def neighbours(self, v, axis: ti.template(), x: ti.i32, last: ti.i32):
        """Samples before and after the middle of pixel x, up to `last`, and the weight of the second in eighths."""
        eighths = ti.cast(8.0 * self.to_grid(v, axis, x + 0.5), ti.i32) - 4
        low = ti.max(eighths, 0) // 8
        return low, ti.min(low + 1, last), ti.max(eighths, 0) % 8

    @ti.func
    def last_sample(self, v, axis: ti.template(), side: ti.i32) -> ti.i32:
        """The last sample along a side of the picture [px]."""
        return ti.cast(ti.ceil(self.to_grid(v, axis, ti.cast(side, ti.f32))), ti.i32) - 1


@ti.func
def spread(packed: ti.u32) -> ti.u64:
    """The bytes of a word in 16 bits each."""
    word = ti.cast(packed, ti.u64)
    return (word & ti.u64(0xFF00FF)) | ((word & ti.u64(0xFF00FF00)) << ti.u64(24))


@ti.func
def gathered(sums: ti.u64) -> ti.u32:
    """The bytes of a word from 64 times each, in the places of `spread`, rounded."""
    bytes = (sums + ti.u64(0x0020002000200020)) >> ti.u64(6) & ti.u64(0x00FF00FF00FF00FF)
    return ti.cast((bytes | bytes >> ti.u64(24)) & ti.u64(0xFFFFFFFF), ti.u32)


def zone_edges(gaze: float, side: int, radius: float, step: int) -> list[int]:
    """Ends of ring, fovea and ring [px] along a side: the fovea holds `radius` [px] about the gaze, in whole steps."""
    gaze = min(max(gaze, 0.0), side)
    begin, end = math.floor((gaze - radius) / step) * step, math.ceil((gaze + radius) / step) * step
    ring = math.ceil(radius / step) * step
    return [max(edge, 0) for edge in (begin - ring, begin, end, end + ring)]


def grid_coordinates(edges: np.ndarray, x) -> np.ndarray:
    """`Fovea.to_grid` of x [px] for edges (..., 4), on the host."""
    begin, fovea, end, ring = np.moveaxis(np.asarray(edges, float), -1, 0)
    return x / 4 + np.clip(x - begin, 0, ring - begin) / 4 + np.clip(x - fovea, 0, end - fovea) / 2
