"""Merging of Gaussians, pair by pair, with the least error of their pictures."""

from dataclasses import replace

import numpy as np
import taichi as ti

from assets.gaussians import Gaussians, axes_of, symmetric_matrices
from core import spherical_harmonics as harmonics
from core.fields import FieldGroup
from core.lanes import dealt
from core.morton import morton_order

REACH = 16  # neighbours along the Z-order curve, on either side, of which one is the partner
SHARE = 0.5  # of a round's pairs that are merged, the cheapest: the others may find better partners later
MOST_OPAQUE = 0.999  # finite as a logit
LARGEST = 1e12  # [m^2] of variance, beyond which nothing is merged: float32 has no room for determinants
TINY = 1e-30  # [m^2] keeps quotients finite

vec2, vec4 = ti.math.vec2, ti.math.vec4


@ti.data_oriented
class Merging:
    """Gaussians, and those that they are merged to.

    `decimate` merges in rounds, as parallel locally-ordered clustering does (Meister and Bittner 2018): each Gaussian
    finds its cheapest partner among its neighbours along a Z-order curve, and of the pairs that chose each other the
    cheapest are merged. What a pair is merged to keeps the moments of its mass (Kerbl 2024, H-3DGS), opacity times
    `shadow_area`. Its cost is the squared error of the picture, see `_cost`. Objects are not mixed.

    gaussians  along a Z-order curve;   count  of Gaussians, of those that were merged too
    """

    def __init__(self, gaussians: Gaussians, target: int):
        self.count, self.target, self.coefficients = len(gaussians), target, gaussians.sh.shape[1]
        capacity = 2 * self.count - target
        self.fields = f = FieldGroup()
        self.mean, self.cov = f.vector(capacity), f.vector(capacity, n=6)
        self.opacity, self.object_id = f.scalar(capacity), f.scalar(capacity, dtype=ti.i32)
        self.sh = f.vector(capacity, self.coefficients)
        f.build()
        g = gaussians
        self._load(g.means, g.covariances.astype(np.float32), g.opacities, g.sh, g.object_id.astype(np.int32))

    def decimate(self) -> np.ndarray:
        """Merge until `target` Gaussians are left, or none is beside another of its object; returns their indices."""
        live = np.arange(self.count, dtype=np.int32)
        while len(live) > self.target:
            best, cost = np.empty(len(live), np.int32), np.empty(len(live), np.float32)
            self._find_partners(live, best, cost)
            own = np.arange(len(live))
            lower = np.flatnonzero((own < best) & (best[best] == own))
            if not len(lower):
                break
            merged = min(len(live) - self.target, int(np.ceil(SHARE * len(lower))))
            lower = np.sort(lower[np.argsort(cost[lower], kind="stable")[:merged]])
            self._merge(self.count, np.stack([live[lower], live[best[lower]]], axis=1))
            live[lower] = self.count + np.arange(merged, dtype=np.int32)
            live = np.delete(live, best[lower])
            self.count += merged
        return live

    def read(self, which: np.ndarray):
        """Means, covariances (xx, xy, xz, yy, yz, zz), opacities, harmonics and object ids of these Gaussians."""
        shapes = ((3,), (6,), (), (self.coefficients, 3))
        out = [np.empty((len(which), *shape), np.float32) for shape in shapes]
        ids = np.empty(len(which), np.int32)
        self._read(which, *out, ids)
        return *out, ids

    def destroy(self) -> None:
        """Free the device memory."""
        self.fields.destroy()

    @ti.kernel
    def _load(
        self, mean: ti.types.ndarray(ti.f32, 2), cov: ti.types.ndarray(ti.f32, 2),
        opacity: ti.types.ndarray(ti.f32, 1), sh: ti.types.ndarray(ti.f32, 3), ids: ti.types.ndarray(ti.i32, 1),
    ):  # fmt: skip
        for g in range(mean.shape[0]):
            self.opacity[g], self.object_id[g] = opacity[g], ids[g]
            for c in ti.static(range(3)):
                self.mean[g][c] = mean[g, c]
            for c in ti.static(range(6)):
                self.cov[g][c] = cov[g, c]
            for k in range(self.coefficients):
                for c in ti.static(range(3)):
                    self.sh[g, k][c] = sh[g, k, c]

    @ti.kernel
    def _read(
        self, which: ti.types.ndarray(ti.i32, 1), mean: ti.types.ndarray(ti.f32, 2), cov: ti.types.ndarray(ti.f32, 2),
        opacity: ti.types.ndarray(ti.f32, 1), sh: ti.types.ndarray(ti.f32, 3), ids: ti.types.ndarray(ti.i32, 1),
    ):  # fmt: skip
        for i in range(which.shape[0]):
            g = which[i]
            opacity[i], ids[i] = self.opacity[g], self.object_id[g]
            for c in ti.static(range(3)):
                mean[i, c] = self.mean[g][c]
            for c in ti.static(range(6)):
                cov[i, c] = self.cov[g][c]
            for k in range(self.coefficients):
                for c in ti.static(range(3)):
                    sh[i, k, c] = self.sh[g, k][c]

    @ti.kernel
    def _find_partners(
        self, live: ti.types.ndarray(ti.i32, 1), best: ti.types.ndarray(ti.i32, 1), cost: ti.types.ndarray(ti.f32, 1)
    ):  # fmt: skip
        """The cheapest partner of each of `live`, as an index into it or -1, and its cost. The cost of a pair is
        computed in one order, so that both see the same."""
        n = live.shape[0]
        for k in range(n):
            i = dealt(k, n)
            least, partner = ti.math.inf, -1
            for j in range(ti.max(i - REACH, 0), ti.min(i + REACH + 1, n)):
                a, b = live[ti.min(i, j)], live[ti.max(i, j)]
                if j != i and self.object_id[a] == self.object_id[b]:
                    c = self._cost(a, b)
                    if c < least:
                        least, partner = c, j
            best[i], cost[i] = partner, least

    @ti.kernel
    def _merge(self, first: ti.i32, pairs: ti.types.ndarray(ti.i32, 2)):
        """Merge pairs (N, 2) to Gaussians from `first` on.

        w = opacity A,  t = w_b / (w_a + w_b),  d = mu_b - mu_a,  mu = mu_a + t d,
        Sigma = (1 - t) Sigma_a + t Sigma_b + t (1 - t) d d^T,  opacity = (w_a + w_b) / A.     Kerbl 2024
        """
        for i in range(pairs.shape[0]):
            a, b, p = pairs[i, 0], pairs[i, 1], first + i
            t, cov, opacity = self._merged(a, b)
            self.mean[p] = self.mean[a] + t * (self.mean[b] - self.mean[a])
            self.cov[p], self.opacity[p], self.object_id[p] = cov, opacity, self.object_id[a]
            for k in range(self.coefficients):
                self.sh[p, k] = self.sh[a, k] + t * (self.sh[b, k] - self.sh[a, k])

    @ti.func
    def _merged(self, a: ti.i32, b: ti.i32):
        """Share t of b in what a and b are merged to, its covariance [m^2] and its opacity."""
        sa, sb, d = self.cov[a], self.cov[b], self.mean[b] - self.mean[a]
        wa, wb = self.opacity[a] * shadow_area(sa), self.opacity[b] * shadow_area(sb)
        t = wb / ti.max(wa + wb, TINY)
        outer = ti.Vector([d[0] * d[0], d[0] * d[1], d[0] * d[2], d[1] * d[1], d[1] * d[2], d[2] * d[2]])
        cov = sa + t * (sb - sa) + t * (1 - t) * outer
        return t, cov, ti.min((wa + wb) / ti.max(shadow_area(cov), TINY), MOST_OPAQUE)

    @ti.func
    def _cost(self, a: ti.i32, b: ti.i32) -> ti.f32:
        """Squared error [m^2] of the pictures of a and b when they are merged to p, each picture a sum.

        Mean over the directions x, y, z of the integral of |o_a c_a G_a + o_b c_b G_b - o_p c_p G_p|^2, with the
        shadows G along that direction, and colours c = (r, g, b, 1) without what depends on the view.
        """
        t, sp, op = self._merged(a, b)
        oa, ob, sa, sb, d = self.opacity[a], self.opacity[b], self.cov[a], self.cov[b], self.mean[b] - self.mean[a]
        ca = oa * vec4(0.5 + harmonics.C0 * self.sh[a, 0], 1.0)
        cb = ob * vec4(0.5 + harmonics.C0 * self.sh[b, 0], 1.0)
        base = 0.5 + harmonics.C0 * (self.sh[a, 0] + t * (self.sh[b, 0] - self.sh[a, 0]))
        cp, error = op * vec4(base, 1.0), 0.0
        for x, y in ti.static(((0, 1), (1, 2), (0, 2))):
            A, B, P = shadow(sa, x, y), shadow(sb, x, y), shadow(sp, x, y)
            D = vec2(d[x], d[y])
            error += ca.dot(ca) * overlap(A, A, 0 * D) + cb.dot(cb) * overlap(B, B, 0 * D)
            error += cp.dot(cp) * overlap(P, P, 0 * D) + 2 * ca.dot(cb) * overlap(A, B, D)
            error -= 2 * (ca.dot(cp) * overlap(A, P, t * D) + cb.dot(cp) * overlap(B, P, (1 - t) * D))
        cost = ti.math.inf
        if sp[0] + sp[3] + sp[5] < LARGEST:  # false for what is not a number, too
            cost = ti.max(error / 3, 0.0)
        return cost


@ti.func
def shadow_area(s):
    """Root mean square of the areas of an ellipsoid's shadows along its axes, but for a factor [m^2]; of its covariance
    (xx, xy, xz, yy, yz, zz) it takes no eigenvalues."""
    return ti.sqrt(ti.max(s[0] * s[3] - s[1] ** 2 + s[0] * s[5] - s[2] ** 2 + s[3] * s[5] - s[4] ** 2, 0.0))


@ti.func
def shadow(s, x: ti.template(), y: ti.template()):
    """Covariance of a Gaussian's shadow on the axes x < y as (xx, xy, yy, determinant)."""
    at = ti.static(((0, 1, 2), (1, 3, 4), (2, 4, 5)))
    xx, xy, yy = s[at[x][x]], s[at[x][y]], s[at[y][y]]
    return vec4(xx, xy, yy, ti.max(xx * yy - xy * xy, 0.0))


@ti.func
def overlap(A, B, d):
    """Integral of G_A G_B, two shadows of height 1 at a distance d: 2 pi sqrt(|A| |B| / |A + B|) exp(-q / 2)."""
    S = A + B
    det = ti.max(S[0] * S[2] - S[1] * S[1], TINY)
    q = (S[2] * d[0] * d[0] - 2 * S[1] * d[0] * d[1] + S[0] * d[1] * d[1]) / det
    return 2 * np.pi * ti.sqrt(A[3]) * ti.sqrt(B[3]) / ti.sqrt(det) * ti.exp(-0.5 * q)


def decimated(gaussians: Gaussians, count: int) -> Gaussians:
    """At most `count` Gaussians, at least one, that look as alike as can be; more where objects have no others."""
    if count >= len(gaussians):
        return gaussians
    merging = Merging(gaussians.select(morton_order(gaussians.means)), count)
    means, cov, opacities, sh, ids = merging.read(merging.decimate())
    merging.destroy()
    quats, log_scales = axes_of(symmetric_matrices(cov))
    logits = np.log(np.maximum(opacities, TINY)) - np.log1p(-np.minimum(opacities, MOST_OPAQUE))
    merged = Gaussians.of(means, quats, log_scales, logits.clip(-80, 80), sh, ids)
    about = {name: getattr(gaussians, name) for name in ("objects", "sort", "antialias", "view")}
    return replace(merged, **about)
