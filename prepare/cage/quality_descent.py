"""Gradient steps that lower a cage's E (prepare/cage/quality_energy.py), its surface kept on a level of the signed distance."""

import numpy as np
import taichi as ti

from prepare.cage.quality_energy import Reals, Rows, Stiffness

MOST = 0.35  # lattice cells a vertex may travel
FIRST_STEP, LAST_STEP = 0.05, 1e-4  # lattice cells
WORST = 95  # [per cent] vertices above take the full step, the others one in proportion
INNER = 2.0**100  # the level of a vertex that does not lie on the surface; float32 holds it exactly

vec3 = ti.types.vector(3, ti.f64)
Values = ti.types.ndarray(ti.f32, ndim=3)


@ti.func
def distance_at(values: ti.template(), origin, spacing, p):
    """Signed distance at p, trilinear; beyond the grid that of its border."""
    last = vec3(values.shape[0] - 1, values.shape[1] - 1, values.shape[2] - 1)
    u = ti.min(ti.max((p - origin) / spacing, 0.0), last)
    i = ti.min(ti.cast(ti.floor(u), ti.i32), ti.cast(last, ti.i32) - 1)
    f = u - ti.cast(i, ti.f64)
    found = ti.cast(0.0, ti.f64)
    for a, b, c in ti.static(ti.ndrange(2, 2, 2)):
        share = (f[0] if a else 1 - f[0]) * (f[1] if b else 1 - f[1]) * (f[2] if c else 1 - f[2])
        found += share * values[i[0] + a, i[1] + b, i[2] + c]
    return found


@ti.kernel
def _step(
    x: Rows, gradient: Rows, start: Rows, size: Reals, level: Reals, values: Values, origin: vec3, spacing: ti.f64,
    step: ti.f64, full: ti.f64, most: ti.f64, moved: Rows,
):  # fmt: skip
    """moved = x against the gradient, back on its level, at most `most` cells from the start."""
    for v in size:
        p = vec3(x[v, 0], x[v, 1], x[v, 2])
        way = size[v] * vec3(gradient[v, 0], gradient[v, 1], gradient[v, 2])
        p -= step * size[v] * way / ti.max(way.norm(), full)
        if level[v] < INNER:  # one Newton step, as prepare.cage.relaxation.Surface.back
            slope = vec3(0.0, 0.0, 0.0)
            for d in ti.static(range(3)):
                h = vec3(0.0, 0.0, 0.0)
                h[d] = 0.5 * spacing
                slope[d] = (
                    distance_at(values, origin, spacing, p + h) - distance_at(values, origin, spacing, p - h)
                ) / spacing
            off = distance_at(values, origin, spacing, p) - level[v]
            p -= off / ti.max(slope.norm_sqr(), 0.25) * slope
        from_start = p - vec3(start[v, 0], start[v, 1], start[v, 2])
        far = from_start.norm()
        if far > most * size[v]:
            p -= (1 - most * size[v] / far) * from_start
        for d in ti.static(range(3)):
            moved[v, d] = p[d]


class Descent:
    """Steps of the vertices of given tets (T, 4) in a given signed distance. Taichi must be running.

    values, origin, spacing  node (i, j, k) lies at origin + spacing (i, j, k)
    """

    def __init__(self, tets: np.ndarray, count: int, values: np.ndarray, origin, spacing: float) -> None:
        self.stiffness = Stiffness(tets, count)
        self.values = ti.ndarray(ti.f32, values.shape)
        self.values.from_numpy(np.ascontiguousarray(values, np.float32))
        self.place = vec3(*map(float, origin)), float(spacing)

    def run(self, x: np.ndarray, outer: np.ndarray, level: np.ndarray, size: np.ndarray, small: float, steps: int):
        """x (V, 3) after at most so many steps.

        outer, level  vertices that stay on the surface (M,), and on which level of it (M,)
        size          width of a cell at each vertex (V,)
        small         volume of a small tet: tets of that size, and smaller ones, count as much as their kappa
        """
        stiffness = self.stiffness
        start, now, moved = (stiffness.vectors(x) for _ in range(3))
        slope, other = stiffness.vectors(), stiffness.vectors()
        stiffness.energy(now, slope, 1.0)
        own, kappa = stiffness.volume.to_numpy(), stiffness.kappa.to_numpy()
        unit = float(np.median(kappa * np.maximum(1, own / small) ** (2 / 3)))
        total = stiffness.energy(now, slope, unit)
        levels = np.full(len(x), INNER)
        levels[outer] = level
        sizes, levels = _real(size), _real(levels)
        step = FIRST_STEP
        for _ in range(steps):
            full = float(np.percentile(np.linalg.norm(slope.to_numpy(), axis=1) * size, WORST))
            while step > LAST_STEP:
                _step(now, slope, start, sizes, levels, self.values, *self.place, step, full, MOST, moved)
                energy = stiffness.energy(moved, other, unit)
                if energy < total:
                    break
                step /= 2
            else:
                break
            now, moved, slope, other, total = moved, now, other, slope, energy
            step = min(1.5 * step, 2 * FIRST_STEP)
        return now.to_numpy()


def _real(values: np.ndarray) -> ti.Ndarray:
    made = ti.ndarray(ti.f64, len(values))
    made.from_numpy(np.ascontiguousarray(values, np.float64))
    return made
