"""The pipeline from Gaussians to pixels, stage by stage, with a pair capacity that grows on demand."""

import taichi as ti

from core.camera import Camera
from core.errors import BadInput
from core.runtime import keep_compiled_kernels, launch
from render.binning import DepthOrder, TileBins
from render.blend import CPU_TILE, GPU_TILE, LARGE_GPU_TILE, MANY_PIXELS, Blend
from render.footprint import ChangedTiles
from render.per_pixel_sort import BUFFER_SIZE, PerPixelSort
from render.projection import COLOR_REACH, Projection, camera_words
from render.splats import Splats

PAIRS_PER_GAUSSIAN = 8  # initial capacity per view; scenes were seen to need 3 to 6
MAX_INITIAL_PAIRS = 1 << 24  # 256 MiB of sort buffers, until more are needed
MAX_PAIRS = 1 << 28  # 4 GiB of sort buffers
NO_CAMERA = [0] * 8  # words in place of a camera that has not changed


@ti.data_oriented
class Rasterizer:
    """Draws Gaussians of `splats` from one or two cameras, `views`, of equal size into a sink (see `Blend.draw`).

    A frame is three kernels: `_order` (project, sort by depth, count pairs), `TilePass._bin` (emit pairs, sort them by
    tile, find each tile's range) and the blending of all tiles. Only the last two depend on the capacity for pairs of
    tile and Gaussian: more pairs need a new `TilePass`, not a new rasterizer.

    still  number of Gaussians at the beginning of which only the visibility changes: they are projected again only if
           the cameras or the size have changed, and all draws must begin with them; with `fast`, their colours are seen
           anew when the eye has moved by COLOR_REACH
    segments  see Blend; not with sort "pixel"
    keeps  tiles of which nothing has changed since the last draw keep their pixels, if `out` is the same: on a CPU,
           where blending takes most of the time
    linear  see Projection
    fast  for pictures without gradients: those of many pixels may have LARGE_GPU_TILEs; see Blend
    """

    def __init__(
        self,
        splats: Splats,
        width: int,
        height: int,
        *,
        views: int,
        sink,
        antialias=False,
        color=True,
        depth=True,
        sort: str = "z",
        buffer_size: int = BUFFER_SIZE,
        segments: int = 1,
        still: int = 0,
        keeps: bool = False,
        fast: bool = False,
        linear: bool = False,
    ):
        many = fast and sort != "pixel" and segments * views * width * height >= MANY_PIXELS
        gpu_tile = LARGE_GPU_TILE if many else GPU_TILE
        tile = gpu_tile if ti.cfg.arch == ti.cuda else (CPU_TILE, CPU_TILE)
        self.splats, self.sink = splats, sink
        self._changed = ChangedTiles() if keeps and ti.cfg.arch != ti.cuda else None
        self._last: tuple | None = None  # range and `out` of the last draw, unless all has changed since
        self.projection = Projection(
            splats, width, height, views,
            tile=tile, antialias=antialias, color=color, sort=sort, still=still, changed=self._changed,
            linear=linear,
            color_reach=COLOR_REACH if fast else 0.0,
        )  # fmt: skip
        self._kept = -1  # Gaussians that are projected for the cameras and the size of now; see `Projection.project`
        self.order = DepthOrder(self.projection)
        self._with_color, self._with_depth = color, depth
        self._segments, self._fast = segments, fast
        self._buffer_size = buffer_size if sort == "pixel" else None
        self._cameras: list[list[int]] = []  # words of each, on the device or to be sent with the next draw
        self._unsent = False
        self.tile_pass = self._tile_pass(min(PAIRS_PER_GAUSSIAN * views * splats.capacity, MAX_INITIAL_PAIRS))

    def draw(self, out, begin: int = 0, end: int | None = None, *, wait: bool = True) -> None:
        """Draw Gaussians [begin, end) through the cameras that were set; `out` is passed to the sink.

        Without `wait` the result is final only after `finish`.
        """
        end = self.splats.count if end is None else end
        cameras = self._cameras if self._unsent else []
        words = [*cameras, NO_CAMERA, NO_CAMERA][:2]
        whole = self._last != (begin, end, id(out))
        launch(self._order, begin, end, self._kept, whole, len(cameras), *words[0], *words[1])
        self._unsent = False
        self._kept, self._last = self.projection.still, (begin, end, id(out))
        self.tile_pass.draw(out)
        if wait:
            self.finish(out)

    @ti.kernel
    def _order(
        self, begin: ti.i32, end: ti.i32, kept: ti.i32, whole: ti.i32, cameras: ti.i32,
        a0: ti.i64, a1: ti.i64, a2: ti.i64, a3: ti.i64, a4: ti.i64, a5: ti.i64, a6: ti.i64, a7: ti.i64,
        b0: ti.i64, b1: ti.i64, b2: ti.i64, b3: ti.i64, b4: ti.i64, b5: ti.i64, b6: ti.i64, b7: ti.i64,
    ):  # fmt: skip
        """The first `cameras` of two are new: as scalars, which need no copy to wait for nor a launch of their own. A
        matrix takes four times as long to pass."""
        if cameras > 0:
            self.projection.set_camera(0, [a0, a1, a2, a3, a4, a5, a6, a7])
        if cameras > 1:
            self.projection.set_camera(1, [b0, b1, b2, b3, b4, b5, b6, b7])
        self.projection.project(begin, end, kept, whole, self.order.sorter)
        if ti.static(self.projection.compares):
            self.projection.drop_unchanged(self.order.sorter)
        self.order.sorter.sort()
        self.order.count_pairs()

    def finish(self, out) -> bool:
        """Wait for the last `draw` and repeat it if its pairs exceeded the capacity; returns whether they did."""
        pairs = self.pairs
        if pairs <= self.pair_capacity:
            return False
        self.reserve(pairs)
        self.tile_pass.draw(out)
        return True

    @property
    def pairs(self) -> int:
        """Pairs of tile and Gaussian in the last `draw`; waits for the device."""
        return self.order.pairs[None]

    @property
    def pair_capacity(self) -> int:
        """Most pairs that can be drawn without growing."""
        return self.tile_pass.bins.capacity

    def reserve(self, pairs: int) -> None:
        """Replace the tile pass by one for `pairs` and a margin. Raises BadInput above MAX_PAIRS."""
        if pairs > MAX_PAIRS:
            raise BadInput(f"the picture needs {pairs} tile-Gaussian pairs, more than {MAX_PAIRS}: draw it smaller")
        with keep_compiled_kernels():
            self.tile_pass.bins.destroy()
        self.tile_pass = self._tile_pass(pairs)

    def _tile_pass(self, pairs: int) -> "TilePass":
        capacity = min(MAX_PAIRS, 1 << (pairs + pairs // 4 - 1).bit_length())
        bins = TileBins(self.order, capacity)
        color, depth = self._with_color, self._with_depth
        if self._buffer_size is None:
            blend = Blend(bins, with_color=color, with_depth=depth, segments=self._segments, fast=self._fast)
        else:
            blend = PerPixelSort(bins, with_color=color, with_depth=depth, buffer_size=self._buffer_size)
        return TilePass(blend, self.sink)

    def resize(self, width: int, height: int) -> None:
        """Draw pictures of another size from now on, with the same kernels unless they need more tiles."""
        self.projection.set_size(width, height)
        self.forget()
        bins = self.tile_pass.bins
        if bins.tiles > bins.tile_capacity:
            self.reserve(bins.capacity * 4 // 5)

    def forget(self) -> None:
        """Draw all anew: what was said to stand still has moved."""
        self._cameras, self._kept, self._last = [], -1, None

    def set_cameras(self, cameras: list[Camera]) -> None:
        """Set the cameras of all views; their size must be the rasterizer's."""
        words = [camera_words(camera) for camera in cameras]
        if self._cameras != words:
            self._cameras, self._unsent, self._kept, self._last = words, True, min(self._kept, 0), None

    def destroy(self) -> None:
        """Free the device memory."""
        self.tile_pass.bins.destroy()
        self.order.destroy()
        self.projection.destroy()
        if self._changed is not None:
            self._changed.destroy()


@ti.data_oriented
class TilePass:
    """The kernels that depend on the capacity for pairs; a larger capacity is a new object, compiled again."""

    def __init__(self, blend: Blend | PerPixelSort, sink):
        self.bins, self.blend, self.sink = blend.bins, blend, sink

    def draw(self, out) -> None:
        """Bin and blend; `out` is an ndarray of pixels or a number."""
        launch(self._bin)
        if isinstance(out, ti.Ndarray):
            self._blend_to_ndarray(out)
        else:
            self._blend_to_fields(out)

    @ti.kernel
    def _bin(self):
        self.bins.emit()
        self.bins.sorter.sort()
        self.bins.find_ranges()

    @ti.kernel
    def _blend_to_ndarray(self, out: ti.types.ndarray(ti.u32, ndim=2)):
        self.blend.draw(self.sink, out)

    @ti.kernel
    def _blend_to_fields(self, out: ti.i32):
        self.blend.draw(self.sink, out)
