"""How stiff and how badly shaped the tets of a cage are: one number to be lowered, and its gradient, as kernels.

    E = sum_t (kappa_t W^(2/3) / unit)^p + (SHAPE q_t)^p
    kappa_t = 1 / 9 sum_a A_a^2 / (V_t m_a),  m_a = sum of V / 4 around a,  q_t = (sum of squared edges)^1.5 / V_t

with the area A_a of the face opposite corner a, the cage's volume W, and q = 1 for a regular tet. The longest stable
substep falls with the largest kappa (MATH: elasticity, division-safe step); with W growing is no way out.
What tets add to their vertices is summed by the vertices, in one order: the same cage gives the same bits.
"""

import numpy as np
import taichi as ti

POWER = 8  # high enough for the worst tets to lead, low enough for their neighbours to follow
SHAPE = 2.0  # a tet this many times worse in shape than a regular one counts as much as one of median kappa
REGULAR = 6**1.5 * 6 * 2**0.5  # (sum of squared edges)^1.5 / V of a regular tet

Reals = ti.types.ndarray(dtype=ti.f64, ndim=1)
Rows = ti.types.ndarray(dtype=ti.f64, ndim=2)
Indices = ti.types.ndarray(dtype=ti.i32, ndim=1)
Tets = ti.types.ndarray(dtype=ti.i32, ndim=2)


FACES = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))  # opposite each corner, counter-clockwise from outside


@ti.func
def corner(x: ti.template(), tets: ti.template(), t, k: ti.template()):
    v = tets[t, k]
    return ti.Vector([x[v, 0], x[v, 1], x[v, 2]], ti.f64)


@ti.func
def normal(p, q, r):
    """Twice the area of a face, outward."""
    return (q - p).cross(r - p)


@ti.kernel
def _volumes(x: Rows, tets: Tets, volume: Reals):
    for t in volume:
        c = [corner(x, tets, t, k) for k in ti.static(range(4))]
        volume[t] = (c[1] - c[0]).dot((c[2] - c[0]).cross(c[3] - c[0])) / 6


@ti.kernel
def _gather(value: Reals, first: Indices, slot: Indices, out: Reals):
    """Sum over the tets around each vertex of one number a tet."""
    for v in out:
        total = ti.cast(0.0, ti.f64)
        for s in range(first[v], first[v + 1]):
            total += value[slot[s] // 4]
        out[v] = total


@ti.kernel
def _gather_corners(value: Rows, first: Indices, slot: Indices, out: Reals):
    """Sum over the tets around each vertex of one number a corner."""
    for v in out:
        total = ti.cast(0.0, ti.f64)
        for s in range(first[v], first[v + 1]):
            total += value[slot[s] // 4, slot[s] % 4]
        out[v] = total


@ti.kernel
def _gather_vectors(value: Rows, first: Indices, slot: Indices, out: Rows):
    for v in range(out.shape[0]):
        total = ti.Vector([0.0, 0.0, 0.0], ti.f64)
        for s in range(first[v], first[v + 1]):
            t, k = slot[s] // 4, slot[s] % 4
            total += ti.Vector([value[t, 3 * k], value[t, 3 * k + 1], value[t, 3 * k + 2]], ti.f64)
        for d in ti.static(range(3)):
            out[v, d] = total[d]


@ti.kernel
def _terms(
    x: Rows, tets: Tets, volume: Reals, mass: Reals, scale: ti.f64, unit: ti.f64, shape: ti.f64,
    kappa: Reals, stiff: Reals, poor: Reals, by_mass: Rows,
):  # fmt: skip
    """Both terms of E of each tet, and by_mass = dE / d(mass of each corner).

    scale = W^(2/3) / 9; shape = SHAPE / REGULAR: literals would be float32
    """
    for t in volume:
        c = [corner(x, tets, t, k) for k in ti.static(range(4))]
        n = [normal(c[f[0]], c[f[1]], c[f[2]]) for f in ti.static(FACES)]
        common = scale / volume[t]
        total, square = ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64)
        mean = (c[0] + c[1] + c[2] + c[3]) / 4
        for a in ti.static(range(4)):
            total += common * n[a].norm_sqr() / (4 * mass[tets[t, a]])
            square += 4 * (c[a] - mean).norm_sqr()
        kappa[t] = total
        stiff[t] = (total / unit) ** POWER
        poor[t] = (shape * square * ti.sqrt(square) / volume[t]) ** POWER
        for a in ti.static(range(4)):
            m = mass[tets[t, a]]
            by_mass[t, a] = -POWER * stiff[t] / total * common * n[a].norm_sqr() / (4 * m * m)


@ti.kernel
def _slopes(
    x: Rows, tets: Tets, volume: Reals, mass: Reals, scale: ti.f64, spread: ti.f64,
    kappa: Reals, stiff: Reals, poor: Reals, of_mass: Reals, slope: Rows,
):  # fmt: skip
    """dE / dx of each corner of each tet. of_mass: dE / dm of each vertex; spread: dE / dW."""
    for t in volume:
        c = [corner(x, tets, t, k) for k in ti.static(range(4))]
        n = [normal(c[f[0]], c[f[1]], c[f[2]]) for f in ti.static(FACES)]
        common = scale / volume[t]
        by_volume = spread - POWER * (stiff[t] + poor[t]) / volume[t]
        mean, square = (c[0] + c[1] + c[2] + c[3]) / 4, ti.cast(0.0, ti.f64)
        for a in ti.static(range(4)):
            by_volume += of_mass[tets[t, a]] / 4
            square += 4 * (c[a] - mean).norm_sqr()
        out = [12 * POWER * poor[t] / square * (c[a] - mean) - by_volume / 6 * n[a] for a in ti.static(range(4))]
        for a in ti.static(range(4)):
            h = POWER * stiff[t] / kappa[t] * common / (2 * mass[tets[t, a]]) * n[a]  # dE / dnormal_a
            p, q, r = ti.static(FACES[a])
            out[p] += h.cross(c[r] - c[q])
            out[q] += h.cross(c[p] - c[r])
            out[r] += h.cross(c[q] - c[p])
        for a in ti.static(range(4)):
            for d in ti.static(range(3)):
                slope[t, 3 * a + d] = out[a][d]


class Stiffness:
    """E of the vertices of given tets (T, 4). Taichi must be running."""

    def __init__(self, tets: np.ndarray, count: int) -> None:
        flat = np.asarray(tets).ravel()
        self.count, n = count, len(tets)
        self.tets = _device(np.asarray(tets, np.int32))
        self.slot = _device(np.argsort(flat, kind="stable").astype(np.int32))
        self.first = _device(np.concatenate([[0], np.bincount(flat, minlength=count).cumsum()]).astype(np.int32))
        self.x = ti.ndarray(ti.f64, (count, 3))
        self.volume, self.kappa, self.stiff, self.poor = (ti.ndarray(ti.f64, n) for _ in range(4))
        self.by_mass, self.slope = ti.ndarray(ti.f64, (n, 4)), ti.ndarray(ti.f64, (n, 12))
        self.mass, self.of_mass = ti.ndarray(ti.f64, count), ti.ndarray(ti.f64, count)
        self.gradient = ti.ndarray(ti.f64, (count, 3))

    def at(self, x: np.ndarray, unit: float = 1.0):
        """E at x (V, 3), infinite if a tet is inverted; its gradient (V, 3); and kappa_t W^(2/3) (T,)."""
        self.x.from_numpy(np.ascontiguousarray(x, np.float64))
        _volumes(self.x, self.tets, self.volume)
        volume = self.volume.to_numpy()
        if not volume.min() > 0:
            return np.inf, None, None
        whole = float(volume.sum())
        scale = whole ** (2 / 3) / 9
        _gather(self.volume, self.first, self.slot, self.mass)
        self.mass.from_numpy(self.mass.to_numpy() / 4)
        _terms(
            self.x, self.tets, self.volume, self.mass, scale, unit, SHAPE / REGULAR,
            self.kappa, self.stiff, self.poor, self.by_mass,
        )  # fmt: skip
        stiff, poor = float(self.stiff.to_numpy().sum()), float(self.poor.to_numpy().sum())
        _gather_corners(self.by_mass, self.first, self.slot, self.of_mass)
        _slopes(
            self.x, self.tets, self.volume, self.mass, scale, POWER * stiff * (2 / 3) / whole,
            self.kappa, self.stiff, self.poor, self.of_mass, self.slope,
        )  # fmt: skip
        _gather_vectors(self.slope, self.first, self.slot, self.gradient)
        return stiff + poor, self.gradient.to_numpy(), self.kappa.to_numpy()


def _device(a: np.ndarray):
    out = ti.ndarray(ti.i32, a.shape)
    out.from_numpy(a)
    return out
