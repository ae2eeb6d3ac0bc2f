"""The whole way from Gaussians to pixels, with room for pairs that grows when a frame needs more."""

import numpy as np
import taichi as ti

from core.camera import Camera
from core.errors import BadInput
from core.fields import keep_compiled_kernels
from render.binning import DepthOrder, TileBins
from render.blend import CPU_TILE, GPU_TILE, Blend
from render.per_pixel_sort import WINDOW, PerPixelSort
from render.projection import Projection
from render.splats import Splats

PAIRS_PER_SPLAT = 8  # room at the start; scenes were seen to need 3 to 6
FIRST_PAIRS = 1 << 24  # but not more than 256 MiB until they are needed
MOST_PAIRS = 1 << 28  # 4 GiB of sort buffers


@ti.data_oriented
class Rasterizer:
    """Draws Gaussians of `splats` from `views` cameras of equal size into a sink (see Blend.draw)."""

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
        window: int = WINDOW,
    ):
        tile = GPU_TILE if ti.cfg.arch == ti.cuda else (CPU_TILE, CPU_TILE)
        self.splats, self.sink = splats, sink
        self.blend, self.wants = Blend, {"with_color": color, "with_depth": depth}
        if sort == "pixel":
            self.blend, self.wants = PerPixelSort, {**self.wants, "window": window}
        self.projection = Projection(
            splats, width, height, views, tile=tile, antialias=antialias, color=color, sort=sort
        )
        self.order = DepthOrder(self.projection)
        self.stage = None
        self._cameras = {}  # numbers on the device, by view
        self._make_room(min(PAIRS_PER_SPLAT * views * splats.capacity, FIRST_PAIRS))

    def _make_room(self, pairs: int) -> None:
        if pairs > MOST_PAIRS:
            raise BadInput(f"the picture needs {pairs} tile-Gaussian pairs, more than {MOST_PAIRS}: draw it smaller")
        if self.stage is not None:
            with keep_compiled_kernels():
                self.stage.bins.destroy()
        capacity = min(MOST_PAIRS, 1 << (pairs + pairs // 4 - 1).bit_length())
        self.stage = TilePass(self.blend(TileBins(self.order, capacity), **self.wants), self.sink)

    def resize(self, width: int, height: int) -> None:
        """Draw pictures of another size from now on, with the same kernels unless they need more tiles."""
        self.projection.set_size(width, height)
        if self.stage.bins.tiles > self.stage.bins.tile_capacity:
            self._make_room(self.stage.bins.capacity * 4 // 5)

    def destroy(self) -> None:
        """Give the device memory back; the object must not be used after."""
        self.stage.bins.destroy()
        self.order.destroy()
        self.projection.destroy()

    def set_camera(self, view: int, camera: Camera) -> None:
        """Camera of a view; its size must be the raster's."""
        rows = np.asarray(camera.world_to_camera, np.float64)[:3].ravel().tolist()
        numbers = [*rows, camera.fx, camera.fy, camera.cx, camera.cy]
        if self._cameras.get(view) != numbers:
            self.projection.set_camera(view, *numbers)
            self._cameras[view] = numbers

    def draw(self, out, begin: int = 0, end: int | None = None, *, wait: bool = True) -> None:
        """Draw Gaussians begin..end-1 through the cameras that were set. `out` is handed to the sink. Without `wait` it
        only counts once `settle` was called."""
        self._arrange(begin, self.splats.count if end is None else end)
        self.stage.draw(out)
        if wait:
            self.settle(out)

    def settle(self, out) -> bool:
        """Wait for what was drawn last. Was there no room for it? Then it is drawn again."""
        pairs = self.order.pairs[None]  # the one number that is read back
        if pairs <= self.stage.bins.capacity:
            return False
        self._make_room(pairs)
        self.stage.draw(out)
        return True

    @ti.kernel
    def _arrange(self, begin: ti.i32, end: ti.i32):
        self.projection.project(begin, end, self.order.sorter)
        self.order.arrange()


@ti.data_oriented
class TilePass:
    """The kernels that know the room for pairs; a larger room is a new object, compiled anew."""

    def __init__(self, blend: Blend, sink):
        self.bins, self.blend, self.sink = blend.bins, blend, sink

    def draw(self, out) -> None:
        self._fill()
        if isinstance(out, ti.Ndarray):
            self._draw_ndarray(out)
        else:
            self._draw_number(out)

    @ti.kernel
    def _fill(self):
        self.bins.fill()

    @ti.kernel
    def _draw_ndarray(self, out: ti.types.ndarray(ti.u32, ndim=2)):
        self.blend.draw(self.sink, out)

    @ti.kernel
    def _draw_number(self, out: ti.i32):
        self.blend.draw(self.sink, out)
