"""Skinned props: Gaussians that are drawn but not simulated, such as hands and controllers.

Each Gaussian follows up to four parts by linear blend skinning, with A = sum_k w_k A_k and t = sum_k w_k t_k:

    mu = A mu_0 + t,   Sigma = A Sigma_0 A^T,   n ~ cof(A) n_0,   colour = base * brightness(light, n)
"""

from dataclasses import dataclass

import numpy as np
import taichi as ti

from assets.gaussians import Gaussians, concatenate
from core.fields import FieldGroup, Upload
from core.spherical_harmonics import C0
from core.vocabulary import Light
from render.splats import Splats

HIDDEN_DISTANCE = 1e6  # [m] from the origin: hidden, and casts no shadow
AMBIENT, SKY, SUN = 0.56, 0.14, 0.46  # brightness from everywhere, from above, from the light
MIN_LIGHT_DISTANCE = 0.15  # [m]
HIDDEN_POSE = np.tile(
    np.float32([0.0, 0.0, 0.0, 1e3 * HIDDEN_DISTANCE]), (3, 1)
)  # no NaN: fast-math assumes that there is none


@dataclass(frozen=True)
class Skin:
    """Gaussians in the bind pose of their parts; colours of SH degree 0.

    normal  outward, 0 for emissive Gaussians, which are not shaded, (N, 3)
    part    indices of the parts that carry it, (N, 4)
    weight  of each part, sum 1, (N, 4)
    solid   whether it casts shadows
    """

    gaussians: Gaussians
    normal: np.ndarray
    part: np.ndarray
    weight: np.ndarray
    solid: bool = True


@ti.data_oriented
class SkinnedProps:
    """Moves the Gaussians of skins, which occupy the splats from `begin` on; parts are numbered across all skins."""

    def __init__(self, splats: Splats, skins: list[Skin], begin: int):
        self.splats, self.parts = splats, 1 + max(int(s.part.max()) for s in skins)
        self.count = sum(len(s.gaussians) for s in skins)
        N = max(self.count, 1)
        self.fields = f = FieldGroup()
        self.target = f.scalar(N, dtype=ti.i32)
        self.part = f.vector(N, n=4, dtype=ti.i32)
        self.weight, self.cov = f.vector(N, n=4), f.vector(N, n=6)
        self.mean, self.normal, self.base = f.vector(N), f.vector(N), f.vector(N)
        self.opacity = f.scalar(N)
        f.build()
        if self.count:
            g = concatenate([s.gaussians for s in skins])
            part, weight, normal = (
                np.concatenate(a) for a in zip(*((s.part, s.weight, s.normal) for s in skins), strict=True)
            )
            color = 0.5 + C0 * g.sh[:, 0]
            Upload([self.target, self.part, self.weight, self.cov, self.mean, self.normal, self.base, self.opacity])(
                [begin + np.arange(N), part, weight, g.covariances, g.means, normal, color, g.opacities]
            )
        self.placed = None  # poses of the last call of `place`, (parts, 12)
        self.place(np.tile(HIDDEN_POSE, (self.parts, 1, 1)), None)

    def place(self, poses: np.ndarray, light: Light | None) -> bool:
        """Move part k to x = poses[k] [x_bound, 1], (parts.., 3, 4) [m]; NaN hides it. Returns whether one moved."""
        poses = np.array(poses[: self.parts], np.float32)
        poses[~(np.abs(poses) < HIDDEN_DISTANCE).all(axis=(1, 2))] = HIDDEN_POSE
        poses = poses.reshape(self.parts, 12)
        if self.placed is not None and np.array_equal(self.placed, poses):
            return False
        self.placed = poses
        position = (0.0, 1e3, 0.0) if light is None else light.position
        if light is not None and light.kind == "directional":
            position = np.subtract(light.position, light.target) * 1e3
        table = np.zeros((self.parts + 1, 12), np.float32)  # one array: an argument of its own costs as much again
        table[:-1], table[-1, :3] = poses, position
        self._place(table)
        return True

    @ti.kernel
    def _place(self, poses: ti.types.ndarray(ti.f32, 2)):
        """Place the Gaussians for `poses`, in whose last row the light's position stands [m]."""
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
            if ti.abs(mean).max() < HIDDEN_DISTANCE:
                s = self.cov[k]
                S = A @ ti.Matrix([[s[0], s[1], s[2]], [s[1], s[3], s[4]], [s[2], s[4], s[5]]]) @ A.transpose()
                self.splats.mean[g], self.splats.opacity[g] = mean, self.opacity[k]
                self.splats.cov[g] = ti.Vector([S[0, 0], S[0, 1], S[0, 2], S[1, 1], S[1, 2], S[2, 2]])
                light = ti.Vector([poses[self.parts, 0], poses[self.parts, 1], poses[self.parts, 2]])
                self.splats.sh[g, 0] = (self.base[k] * self._brightness(A, self.normal[k], mean, light) - 0.5) / C0
            else:
                self.splats.mean[g], self.splats.opacity[g] = ti.Vector([HIDDEN_DISTANCE] * 3), 0.0

    @ti.func
    def _brightness(self, A, n0, mean, light):
        """Brightness of a surface of normal cof(A) n0: wrapped diffuse light, so that no side is black."""
        result = 1.0
        a, b, c = A[:, 0], A[:, 1], A[:, 2]
        n = b.cross(c) * n0[0] + c.cross(a) * n0[1] + a.cross(b) * n0[2]
        if n.norm() > 0.0:
            n = n.normalized()
            to_light = light - mean
            facing = n.dot(to_light / ti.max(to_light.norm(), MIN_LIGHT_DISTANCE))
            result = AMBIENT + SKY * (0.5 + 0.5 * n.y) + SUN * (0.5 + 0.5 * facing) ** 2
        return result

    def destroy(self) -> None:
        """Free the device memory."""
        self.fields.destroy()
