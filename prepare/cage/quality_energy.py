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
PARTS = 64  # sums of all tets are made of so many, each in one order
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
def _energy(
    x: Rows, tets: Tets, first: Indices, slot: Indices, unit: ti.f64, shape: ti.f64, power: ti.f64, volume: Reals,
    mass: Reals, kappa: Reals, stiff: Reals, poor: Reals, by_mass: Rows, of_mass: Reals, slope: Rows, part: Rows,
    sums: Reals, gradient: Rows,
):  # fmt: skip
    """sums = least volume, W, sum of both terms of E; gradient = dE / dx, if no tet is inverted.

    shape = SHAPE / REGULAR; power = 2 / 3: literals would be float32
    """
    for t in volume:
        c = [corner(x, tets, t, k) for k in ti.static(range(4))]
        volume[t] = (c[1] - c[0]).dot((c[2] - c[0]).cross(c[3] - c[0])) / 6
    for b in range(PARTS):
        least, total = volume[0], ti.cast(0.0, ti.f64)
        for t in range(b * volume.shape[0] // PARTS, (b + 1) * volume.shape[0] // PARTS):
            least = ti.min(least, volume[t])
            total += volume[t]
        part[b, 0], part[b, 1] = least, total
    for _ in range(1):
        least, total = part[0, 0], ti.cast(0.0, ti.f64)
        for b in range(PARTS):
            least = ti.min(least, part[b, 0])
            total += part[b, 1]
        sums[0], sums[1] = least, total
    for v in mass:
        total = ti.cast(0.0, ti.f64)
        for s in range(first[v], first[v + 1]):
            total += volume[slot[s] // 4]
        mass[v] = total / 4
    for t in volume:
        if sums[0] > 0.0:
            common = sums[1] ** power / 9 / volume[t]
            c = [corner(x, tets, t, k) for k in ti.static(range(4))]
            n = [normal(c[f[0]], c[f[1]], c[f[2]]) for f in ti.static(FACES)]
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
    for b in range(PARTS):
        one, other = ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64)
        for t in range(b * volume.shape[0] // PARTS, (b + 1) * volume.shape[0] // PARTS):
            one += stiff[t]
            other += poor[t]
        part[b, 0], part[b, 1] = one, other
    for _ in range(1):
        one, other = ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64)
        for b in range(PARTS):
            one += part[b, 0]
            other += part[b, 1]
        sums[2], sums[3] = one, other
    for v in of_mass:
        total = ti.cast(0.0, ti.f64)
        for s in range(first[v], first[v + 1]):
            total += by_mass[slot[s] // 4, slot[s] % 4]
        of_mass[v] = total
    for t in volume:
        if sums[0] > 0.0:
            common = sums[1] ** power / 9 / volume[t]
            c = [corner(x, tets, t, k) for k in ti.static(range(4))]
            n = [normal(c[f[0]], c[f[1]], c[f[2]]) for f in ti.static(FACES)]
            by_volume = POWER * sums[2] * power / sums[1] - POWER * (stiff[t] + poor[t]) / volume[t]
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
    for v in range(gradient.shape[0]):
        total = ti.Vector([0.0, 0.0, 0.0], ti.f64)
        for s in range(first[v], first[v + 1]):
            t, k = slot[s] // 4, slot[s] % 4
            total += ti.Vector([slope[t, 3 * k], slope[t, 3 * k + 1], slope[t, 3 * k + 2]], ti.f64)
        for d in ti.static(range(3)):
            gradient[v, d] = total[d]


class Stiffness:
    """E of the vertices of given tets (T, 4). Taichi must be running."""

    def __init__(self, tets: np.ndarray, count: int) -> None:
        flat = np.asarray(tets, np.int64).ravel()
        self.count, n = count, len(tets)
        self.tets = _device(np.asarray(tets, np.int32))
        self.slot = _device((np.sort(flat * len(flat) + np.arange(len(flat))) % len(flat)).astype(np.int32))
        self.first = _device(np.concatenate([[0], np.bincount(flat, minlength=count).cumsum()]).astype(np.int32))
        self.volume, self.kappa, self.stiff, self.poor = (ti.ndarray(ti.f64, n) for _ in range(4))
        self.by_mass, self.slope = ti.ndarray(ti.f64, (n, 4)), ti.ndarray(ti.f64, (n, 12))
        self.mass, self.of_mass = ti.ndarray(ti.f64, count), ti.ndarray(ti.f64, count)
        self.part, self.sums = ti.ndarray(ti.f64, (PARTS, 2)), ti.ndarray(ti.f64, 4)

    def vectors(self, x: np.ndarray | None = None) -> ti.Ndarray:
        """Numbers (V, 3) on the device: those of x, or anything."""
        made = ti.ndarray(ti.f64, (self.count, 3))
        if x is not None:
            made.from_numpy(np.ascontiguousarray(x, np.float64))
        return made

    def energy(self, x: ti.Ndarray, gradient: ti.Ndarray, unit: float) -> float:
        """E at x (V, 3), infinite if a tet is inverted. Out: gradient (V, 3), which else means nothing."""
        _energy(
            x, self.tets, self.first, self.slot, unit, SHAPE / REGULAR, 2 / 3, self.volume, self.mass, self.kappa,
            self.stiff, self.poor, self.by_mass, self.of_mass, self.slope, self.part, self.sums, gradient,
        )  # fmt: skip
        least, _, stiff, poor = self.sums.to_numpy()
        return float(stiff + poor) if least > 0 else np.inf

    def at(self, x: np.ndarray, unit: float = 1.0):
        """E at x (V, 3), infinite if a tet is inverted; its gradient (V, 3); and kappa_t W^(2/3) (T,)."""
        gradient = self.vectors()
        energy = self.energy(self.vectors(x), gradient, unit)
        return (energy, gradient.to_numpy(), self.kappa.to_numpy()) if energy < np.inf else (energy, None, None)


def _device(a: np.ndarray):
    out = ti.ndarray(ti.i32, a.shape)
    out.from_numpy(a)
    return out
