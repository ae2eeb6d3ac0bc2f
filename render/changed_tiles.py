"""Tiles of a picture that differ from the picture drawn before: the others keep their pixels.

A tile is drawn anew if a splat that touches it, or touched it in the last picture, has changed.
"""

import taichi as ti

from core.fields import FieldGroup
from render.footprint import tile_box

TILES = 1 << 18  # tiles of all views that are told apart; those beyond, of larger pictures, always count as changed


@ti.data_oriented
class ChangedTiles:
    """last i32[TILES]: number of the picture in which a tile changed last;   picture i32: number of this one;
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
    def add(self, v, mean2d, box, tile: ti.template(), grid: ti.template()):
        """Mark all tiles in the box of a splat of view v, see `Projection`."""
        if not self.everywhere():
            columns, rows = grid[None][2], grid[None][3]
            left, right, top, bottom = tile_box(mean2d, box, tile, grid)
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
