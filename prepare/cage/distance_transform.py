"""Exact Euclidean distances on a grid, all lines of an axis side by side (Felzenszwalb and Huttenlocher 2012).

Where only what is near matters, or next to nothing is far, the minimum over the rows nearby is several times faster.
"""

from weakref import WeakKeyDictionary

import numpy as np
import taichi as ti

FAR = 1 << 20  # cells^2: farther than any grid of prepare is wide, and far from the end of i32 when squares are added

KEPT = 3  # shapes whose grids are kept: a shape, its crop and that at every other node

Grid = ti.types.ndarray(dtype=ti.i32, ndim=3)
Rows = ti.types.ndarray(dtype=ti.i32, ndim=2)


@ti.kernel
def _along_last(mask: ti.types.ndarray(dtype=ti.u8, ndim=3), out: Grid, least: Rows):
    """Squared distance along the last axis to the next set cell, and the least of each row."""
    for i, j in ti.ndrange(mask.shape[0], mask.shape[1]):
        n = mask.shape[2]
        steps = 1024
        for k in range(n):
            steps = ti.select(mask[i, j, k] != 0, 0, ti.min(steps + 1, 1024))
            out[i, j, k] = steps * steps
        steps, lowest = 1024, FAR
        for m in range(n):
            k = n - 1 - m
            steps = ti.select(mask[i, j, k] != 0, 0, ti.min(steps + 1, 1024))
            out[i, j, k] = ti.min(out[i, j, k], steps * steps)
            lowest = ti.min(lowest, out[i, j, k])
        least[i, j] = lowest


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


@ti.kernel
def _near(f: Grid, least: Rows, out: Grid, after: Rows, cap: ti.i32, axis: ti.template()):
    """As _along, but no more than cap: row by row, as far as another row can lower anything in this one."""
    for i, j in ti.ndrange(f.shape[0], f.shape[1]):
        top = 0
        for k in range(f.shape[2]):
            out[i, j, k] = ti.min(f[i, j, k], cap)
            top = ti.max(top, out[i, j, k])
        q = i if ti.static(axis == 0) else j
        d = 1
        while d * d < top:
            for side in range(2):
                p = q + d if side == 1 else q - d
                if p >= 0 and p < f.shape[axis]:
                    a = p if ti.static(axis == 0) else i
                    b = j if ti.static(axis == 0) else p
                    if least[a, b] + d * d < top:
                        for k in range(f.shape[2]):
                            out[i, j, k] = ti.min(out[i, j, k], f[a, b, k] + d * d)
            d += 1
        lowest = cap
        for k in range(f.shape[2]):
            lowest = ti.min(lowest, out[i, j, k])
        after[i, j] = lowest


@ti.kernel
def _roots(f: Grid, cap: ti.i32, out: ti.types.ndarray(dtype=ti.f32, ndim=3)):
    for i, j in ti.ndrange(f.shape[0], f.shape[1]):
        for k in range(f.shape[2]):
            out[i, j, k] = ti.sqrt(ti.cast(f[i, j, k], ti.f32)) if f[i, j, k] < cap else ti.math.inf


# Of each runtime, and gone with it: an array that outlives its runtime frees, when it goes, whatever the next one has
# put in its place.
_kept: WeakKeyDictionary = WeakKeyDictionary()


def _buffers(shape: tuple[int, ...]) -> tuple[list, list]:
    """Four grids and two planes of rows on the device, kept for the last shapes: making them takes as long as filling
    them."""
    kept = _kept.setdefault(ti.lang.impl.get_runtime(), {})
    if shape not in kept:
        if len(kept) == KEPT:
            del kept[next(iter(kept))]
        kept[shape] = [ti.ndarray(ti.i32, shape) for _ in range(4)], [ti.ndarray(ti.i32, shape[:2]) for _ in range(2)]
    return kept[shape]


def _squares(mask: np.ndarray, reach: float | None) -> tuple[ti.Ndarray, int]:
    """Squared distances on the device, and from which on they mean nothing."""
    (f, out, apex, begin), (least, after) = _buffers(mask.shape)
    _along_last(np.ascontiguousarray(mask).view(np.uint8), f, least)
    if reach is None:
        _along(f, out, apex, begin, 1)
        _along(out, f, apex, begin, 0)
        return f, 2**31 - 1
    cap = min(int(reach**2) + 1, FAR)
    _near(f, least, out, after, cap, 1)
    _near(out, after, f, least, cap, 0)
    return f, cap


def squared_distance(mask: np.ndarray) -> np.ndarray:
    """Squared distance [cells^2] (X, Y, Z) int32 to the nearest cell of mask (X, Y, Z) bool; at least FAR without one.

    Taichi must be running.
    """
    return _squares(mask, None)[0].to_numpy()


def distance(mask: np.ndarray, reach: float | None = None) -> np.ndarray:
    """Distance [cells] (X, Y, Z) float32 to the nearest cell of mask (X, Y, Z) bool. Taichi must be running.

    reach  what is farther is infinite; None: nothing is
    """
    found = np.empty(mask.shape, np.float32)
    _roots(*_squares(mask, reach), found)
    return found
