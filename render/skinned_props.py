"""Things that are drawn but not simulated, such as hands and controllers: Gaussians that parts carry.

Each Gaussian follows a few parts by linear blend skinning, with A = sum_k w_k A_k and t = sum_k w_k t_k:

    mu = A mu_0 + t,   Sigma = A Sigma_0 A^T,   n ~ cof(A) n_0,   colour = base (AMBIENT + ...), by the light and n
"""

from dataclasses import dataclass

import numpy as np
import taichi as ti

from assets.gaussians import Gaussians
from render.splats import Splats, covariances
from scenes.scene import Light

AWAY = 1e6  # [m] from the origin: hidden, and no caster of shadows
C0 = 0.28209479  # SH of degree 0
AMBIENT, SKY, SUN = 0.56, 0.14, 0.46  # shares of the colour: from everywhere, from above, from the light
NEAREST = 0.15  # [m]; a light is at least so far away
HIDDEN = np.tile(np.float32([0.0, 0.0, 0.0, 1e3 * AWAY]), (3, 1))  # no NaN: compilers may think that there is none


@dataclass(frozen=True)
class Skin:
    """Gaussians in the frame in which their parts are bound; colours of degree 0.

    normal (N, 3) outward, 0 for what glows and is not shaded;   part (N, 4) and weight (N, 4), sums 1: what carries it
    solid: casts shadows
    """

    gaussians: Gaussians
    normal: np.ndarray
    part: np.ndarray
    weight: np.ndarray
    solid: bool = True


@ti.data_oriented
class SkinnedProps:
    """Moves the Gaussians of skins, which lie one after the other in the splats from `begin` on. Their parts are
    numbered across all of them."""

    def __init__(self, splats: Splats, skins: list[Skin], begin: int):
        self.splats, self.parts = splats, 1 + max(int(s.part.max()) for s in skins)
        self.count = sum(len(s.gaussians) for s in skins)
        N = max(self.count, 1)
        self.target, self.part = ti.field(ti.i32), ti.Vector.field(4, ti.i32)
        self.weight, self.cov = ti.Vector.field(4, ti.f32), ti.Vector.field(6, ti.f32)
        self.mean, self.normal, self.base = (ti.Vector.field(3, ti.f32) for _ in range(3))
        self.opacity = ti.field(ti.f32)
        builder = ti.FieldsBuilder()
        fields = (self.target, self.part, self.weight, self.cov, self.mean, self.normal, self.base, self.opacity)
        for f in fields:
            builder.dense(ti.i, N).place(f)
        self.tree = builder.finalize()
        columns = {f: [] for f in fields}
        for skin in skins:
            g = skin.gaussians
            values = (begin + np.arange(len(g)), skin.part, skin.weight, covariances(g), g.means, skin.normal)
            for f, value in zip(fields, (*values, 0.5 + C0 * g.sh[:, 0], g.opacities), strict=True):
                columns[f].append(value)
            begin += len(g)
        for f, values in columns.items():
            kind = np.int32 if f.dtype == ti.i32 else np.float32
            f.from_numpy(np.concatenate(values).astype(kind) if self.count else np.zeros((N, *f.shape[1:]), kind))
        self.shown = None  # what was placed last
        self.place(np.tile(HIDDEN, (self.parts, 1, 1)), None)

    def place(self, poses: np.ndarray, light: Light | None) -> bool:
        """Put part k at x = poses[k] [x_bound, 1], (parts, 3, 4) [m]; not a number hides it. Whether that is new."""
        poses = np.array(poses, np.float32)
        poses[~(np.abs(poses) < AWAY).all(axis=(1, 2))] = HIDDEN
        poses = poses.reshape(self.parts, 12)
        if self.shown is not None and np.array_equal(self.shown, poses):
            return False
        self.shown = poses
        at = (0.0, 1e3, 0.0) if light is None else light.position
        if light is not None and light.kind == "directional":
            at = np.subtract(light.position, light.target) * 1e3
        self._place(poses, ti.Vector([float(c) for c in at]))
        return True

    @ti.kernel
    def _place(self, poses: ti.types.ndarray(ti.f32, 2), light: ti.types.vector(3, ti.f32)):
        for k in range(self.count):
            g = self.target[k]
            A, t = ti.Matrix.zero(ti.f32, 3, 3), ti.Vector([0.0, 0.0, 0.0])
            for j in ti.static(range(4)):
                w, p = self.weight[k][j], self.part[k][j]
                if w > 0.0:
                    for r in ti.static(range(3)):
                        for c in ti.static(range(3)):
                            A[r, c] += w * poses[p, 4 * r + c]
                        t[r] += w * poses[p, 4 * r + 3]
            mean = A @ self.mean[k] + t
            if ti.abs(mean).max() < AWAY:
                s = self.cov[k]
                S = A @ ti.Matrix([[s[0], s[1], s[2]], [s[1], s[3], s[4]], [s[2], s[4], s[5]]]) @ A.transpose()
                self.splats.mean[g], self.splats.opacity[g] = mean, self.opacity[k]
                self.splats.cov[g] = ti.Vector([S[0, 0], S[0, 1], S[0, 2], S[1, 1], S[1, 2], S[2, 2]])
                self.splats.sh[g, 0] = (self.base[k] * self._shade(A, self.normal[k], mean, light) - 0.5) / C0
            else:
                self.splats.mean[g], self.splats.opacity[g] = ti.Vector([AWAY, AWAY, AWAY]), 0.0

    @ti.func
    def _shade(self, A, n0, mean, light):
        """How bright a surface is that looks along cof(A) n0: soft, so that no side is black."""
        result = 1.0
        a, b, c = A[:, 0], A[:, 1], A[:, 2]
        n = b.cross(c) * n0[0] + c.cross(a) * n0[1] + a.cross(b) * n0[2]
        if n.norm() > 0.0:
            n = n.normalized()
            way = light - mean
            facing = n.dot(way / ti.max(way.norm(), NEAREST))
            result = AMBIENT + SKY * (0.5 + 0.5 * n.y) + SUN * (0.5 + 0.5 * facing) ** 2
        return result

    def destroy(self) -> None:
        """Give the device memory back; the object must not be used after."""
        self.tree.destroy()
