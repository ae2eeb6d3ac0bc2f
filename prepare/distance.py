"""Exact Euclidean distances on a grid, all lines of an axis side by side (Felzenszwalb and Huttenlocher 2012)."""

from weakref import WeakKeyDictionary

import numpy as np
import taichi as ti

FAR = 1 << 20  # cells^2: farther than any grid of prepare is wide, and far from the end of i32 when squares are added

Grid = ti.types.ndarray(dtype=ti.i32, ndim=3)


@ti.kernel
def _along_last(mask: ti.types.ndarray(dtype=ti.u8, ndim=3), out: Grid):
    """Squared distance along the last axis to the next set cell."""
    for i, j in ti.ndrange(mask.shape[0], mask.shape[1]):
        n = mask.shape[2]
        steps = 1024
        for k in range(n):
            steps = ti.select(mask[i, j, k] != 0, 0, ti.min(steps + 1, 1024))
            out[i, j, k] = steps * steps
        steps = 1024
        for m in range(n):
            k = n - 1 - m
            steps = ti.select(mask[i, j, k] != 0, 0, ti.min(steps + 1, 1024))
            out[i, j, k] = ti.min(out[i, j, k], steps * steps)


@ti.func
def _at(i, j, k, axis: ti.template()):
    """Cell k of line (i, j) along the axis."""
    return ti.Vector([k, i, j]) if ti.static(axis == 0) else ti.Vector([i, k, j])


@ti.kernel
def _along(f: Grid, out: Grid, apex: Grid, begin: Grid, axis: ti.template()):
    """out(q) = min_p (q - p)^2 + f(p) along an axis: the lower envelope of parabolas.

    apex, begin  scratch: the envelope's parabolas of each line, and from which cell on each is the lowest
    """
    lines = f.shape[1] if ti.static(axis == 0) else f.shape[0]
    for i, j in ti.ndrange(lines, f.shape[2]):
        n = f.shape[axis]
        last = 0
        apex[_at(i, j, 0, axis)] = 0
        begin[_at(i, j, 0, axis)] = 0
        for q in range(1, n):
            fq = f[_at(i, j, q, axis)]
            start = n
            while last >= 0:
                p = apex[_at(i, j, last, axis)]
                fp = f[_at(i, j, p, axis)]
                # The first cell where q's parabola is lower than p's; they meet at (fq + q^2 - fp - p^2) / 2 (q - p).
                above, below = fq + q * q - fp - p * p, 2 * (q - p)
                start = ti.select(above < 0, 0, above // below + 1)
                if start > begin[_at(i, j, last, axis)] or last == 0:
                    break
                last -= 1
            if start <= begin[_at(i, j, last, axis)]:  # of the first parabola nothing is left
                apex[_at(i, j, last, axis)] = q
            elif start < n:
                last += 1
                apex[_at(i, j, last, axis)] = q
                begin[_at(i, j, last, axis)] = start
        for m in range(n):
            q = n - 1 - m
            while begin[_at(i, j, last, axis)] > q:
                last -= 1
            p = apex[_at(i, j, last, axis)]
            out[_at(i, j, q, axis)] = (q - p) * (q - p) + f[_at(i, j, p, axis)]


# Of each runtime, and gone with it: an array that outlives its runtime frees, when it goes, whatever the next one has
# put in its place.
_kept: WeakKeyDictionary = WeakKeyDictionary()


def _buffers(shape: tuple[int, ...]) -> list:
    """Four grids on the device, kept while the shape stays the same: making them takes as long as filling them."""
    runtime = ti.lang.impl.get_runtime()
    known, grids = _kept.get(runtime, (None, None))
    if known != shape:
        _kept[runtime] = shape, (grids := [ti.ndarray(ti.i32, shape) for _ in range(4)])
    return grids


def squared_distance(mask: np.ndarray) -> np.ndarray:
    """Squared distance [cells^2] (X, Y, Z) int32 to the nearest cell of mask (X, Y, Z) bool; at least FAR without one.

    Taichi must be running.
    """
    f, out, apex, begin = _buffers(mask.shape)
    _along_last(np.ascontiguousarray(mask).view(np.uint8), f)
    _along(f, out, apex, begin, 1)
    _along(out, f, apex, begin, 0)
    return f.to_numpy()


def distance(mask: np.ndarray) -> np.ndarray:
    """Distance [cells] (X, Y, Z) float32 to the nearest cell of mask (X, Y, Z) bool. Taichi must be running."""
    return np.sqrt(squared_distance(mask), dtype=np.float32)
