"""Gaussians on the device: the embedding moves them, the renderer draws them."""

import numpy as np
import taichi as ti

from assets.gaussians import Gaussians
from core import spherical_harmonics as harmonics
from core.fields import FieldGroup, round_up_capacity
from core.quaternion import rotate_inverse
from core.rotation import quaternions_from_matrices

mat3, vec3, vec4 = ti.math.mat3, ti.math.vec3, ti.math.vec4


@ti.data_oriented
class Splats:
    """Device fields of N Gaussians, flat over all bodies; entries from `count` to `capacity` are unused.

    count       of Gaussians, to be set when some are added at the end, or taken away there
    mean        world position [m], vec3
    cov         world covariance [m^2], vec6 = (xx, xy, xz, yy, yz, zz)
    opacity     0..1
    sh          spherical harmonics, vec3, (capacity, coefficients)
    rotation    quaternion wxyz that turns the frame of `sh` into the world; identity at the start
    visibility  of the light, 0..1: factor of the colour; 1 at the start
    exposed     fraction of the light that reached it when its colours were captured, 0..1; 1 at the start, and for what
                has no captured shadows

    `sh_range` = [begin, end) contains all Gaussians whose colour depends on the view: a room of degree 0 that was
    padded to the degree of a shiny body is not evaluated to it. `capacity`: for at least this many Gaussians.
    """

    def __init__(self, gaussians: Gaussians, *, capacity: int = 0):
        self.count = len(gaussians)
        self.capacity = round_up_capacity(max(self.count, capacity))
        self.coefficients = gaussians.sh.shape[1]
        self.fields = f = FieldGroup()
        self.mean = f.vector(self.capacity)
        self.cov = f.vector(self.capacity, n=6)
        self.opacity = f.scalar(self.capacity)
        self.rotation = f.vector(self.capacity, n=4)
        self.visibility = f.scalar(self.capacity)
        self.exposed = f.scalar(self.capacity)
        on_gpu = ti.cfg.arch == ti.cuda  # neighbouring threads read neighbouring words
        self.sh = f.vector(self.capacity, self.coefficients, column_major=on_gpu)
        f.build()
        self.replace(gaussians)
        view_dependent = np.flatnonzero((gaussians.sh[:, 1:] != 0).any(axis=(1, 2)))
        self.sh_range = (int(view_dependent[0]), int(view_dependent[-1]) + 1) if view_dependent.size else (0, 0)
        if capacity > self.count and self.sh_range[1]:
            self.sh_range = (self.sh_range[0], self.capacity)
        self.rotation.fill(ti.Vector([1.0, 0.0, 0.0, 0.0]))
        self.visibility.fill(1.0)
        self.exposed.fill(1.0)

    def replace(self, gaussians: Gaussians) -> None:
        """Hold other Gaussians, at most `capacity`, of as many coefficients. Kernels know `sh_range` from their first
        run: it must hold for these, too."""
        self.count = len(gaussians)
        for field, values in (
            (self.mean, gaussians.means),
            (self.cov, gaussians.covariances),
            (self.opacity, gaussians.opacities),
            (self.sh, gaussians.sh),
        ):
            field.from_numpy(self.padded(values))
        self._initial_means = gaussians.means  # [m], on the host

    def padded(self, values: np.ndarray) -> np.ndarray:
        """Values (count, ...) as float32 (capacity, ...), zero beyond `count`."""
        out = np.zeros((self.capacity, *values.shape[1:]), np.float32)
        out[: self.count] = values
        return out

    def radius_about(self, center) -> float:
        """Distance from `center` within which 95% of the Gaussians lay at the start [m]; at least 1 mm."""
        if self.count == 0:
            return 1.0
        return max(1e-3, float(np.percentile(np.linalg.norm(self._initial_means - np.asarray(center), axis=1), 95)))

    def read(self, first: int, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Opacities (count,), harmonics (count, coefficients, 3) and `exposed` (count,) of the Gaussians from `first`
        on, on the host."""
        opacity, exposed = np.zeros((2, max(count, 1)), np.float32)  # Taichi takes no empty arrays
        sh = np.zeros((max(count, 1), self.coefficients, 3), np.float32)
        self._read(first, count, opacity, sh, exposed)
        return opacity[:count], sh[:count], exposed[:count]

    def write(self, first: int, opacity: np.ndarray, sh: np.ndarray, exposed: np.ndarray) -> None:
        """Write the result of `read` to the Gaussians from `first` on; the embedding writes the other fields."""
        if len(opacity):
            self._write(first, opacity, sh, exposed)

    @ti.kernel
    def _read(
        self, first: ti.i32, count: ti.i32,
        opacity: ti.types.ndarray(ti.f32, 1), sh: ti.types.ndarray(ti.f32, 3), exposed: ti.types.ndarray(ti.f32, 1),
    ):  # fmt: skip
        for i in range(count):
            opacity[i], exposed[i] = self.opacity[first + i], self.exposed[first + i]
            for k in range(self.coefficients):
                for c in ti.static(range(3)):
                    sh[i, k, c] = self.sh[first + i, k][c]

    @ti.kernel
    def _write(
        self, first: ti.i32,
        opacity: ti.types.ndarray(ti.f32, 1), sh: ti.types.ndarray(ti.f32, 3), exposed: ti.types.ndarray(ti.f32, 1),
    ):  # fmt: skip
        for i in range(opacity.shape[0]):
            self.opacity[first + i], self.exposed[first + i] = opacity[i], exposed[i]
            for k in range(self.coefficients):
                for c in ti.static(range(3)):
                    self.sh[first + i, k][c] = sh[i, k, c]

    def destroy(self) -> None:
        """Free the device memory."""
        self.fields.destroy()


@ti.func
def color_of(splats: ti.template(), g: ti.i32, ray: vec3) -> vec3:
    """0.5 + SH(R^T d) as seen from a direction; d is that of `ray`, from the eye to the Gaussian's mean."""
    value = harmonics.C0 * splats.sh[g, 0]
    if ti.static(splats.coefficients > 1):
        view_dependent = g >= splats.sh_range[0] and g < splats.sh_range[1]
        if view_dependent:
            value += higher_degrees(splats, g, rotate_inverse(splats.rotation[g], ray.normalized(1e-12)))
    return 0.5 + value


@ti.func
def higher_degrees(splats: ti.template(), g: ti.i32, d: vec3) -> vec3:
    """Degrees 1 to 3 of the harmonics at unit direction d, in the basis of core/spherical_harmonics.py."""
    sh = ti.static(splats.sh)
    x, y, z = d.x, d.y, d.z
    value = harmonics.C1 * (z * sh[g, 2] - y * sh[g, 1] - x * sh[g, 3])
    if ti.static(splats.coefficients > 4):
        xx, yy, zz = x * x, y * y, z * z
        C2 = ti.static(harmonics.C2)
        value += C2[0] * x * y * sh[g, 4] + C2[1] * y * z * sh[g, 5] + C2[2] * (2 * zz - xx - yy) * sh[g, 6]
        value += C2[3] * x * z * sh[g, 7] + C2[4] * (xx - yy) * sh[g, 8]
        if ti.static(splats.coefficients > 9):
            C3 = ti.static(harmonics.C3)
            value += C3[0] * y * (3 * xx - yy) * sh[g, 9] + C3[1] * x * y * z * sh[g, 10]
            value += C3[2] * y * (4 * zz - xx - yy) * sh[g, 11]
            value += C3[3] * z * (2 * zz - 3 * xx - 3 * yy) * sh[g, 12]
            value += C3[4] * x * (4 * zz - xx - yy) * sh[g, 13]
            value += C3[5] * z * (xx - yy) * sh[g, 14] + C3[6] * x * (xx - 3 * yy) * sh[g, 15]
    return value


@ti.data_oriented
class StillPose:
    """Pose of the first `count` splats, which stand still but for a room that the user turns as a whole.

    mean, cov  what they were when it was made
    """

    def __init__(self, splats: Splats, count: int):
        self.splats, self.count = splats, count
        self.fields = f = FieldGroup()
        self.mean, self.cov = f.vector(count), f.vector(count, n=6)
        f.build()
        self._copy()

    def place(self, pose: np.ndarray) -> None:
        """Let them stand at a rigid transform (4, 4) of where they were."""
        R = np.asarray(pose, np.float64)[:3, :3]
        self._place(mat3(R.tolist()), vec3(pose[:3, 3].tolist()), vec4(quaternions_from_matrices(R).tolist()))

    @ti.kernel
    def _copy(self):
        for g in self.mean:
            if g < self.count:
                self.mean[g], self.cov[g] = self.splats.mean[g], self.splats.cov[g]

    @ti.kernel
    def _place(self, R: mat3, t: vec3, q: vec4):
        """mu = R mu_0 + t,   Sigma = R Sigma_0 R^T."""
        for g in self.mean:
            if g < self.count:
                c = self.cov[g]
                sigma = R @ mat3(c[0], c[1], c[2], c[1], c[3], c[4], c[2], c[4], c[5]) @ R.transpose()
                self.splats.mean[g] = R @ self.mean[g] + t
                self.splats.cov[g] = ti.Vector(
                    [sigma[0, 0], sigma[0, 1], sigma[0, 2], sigma[1, 1], sigma[1, 2], sigma[2, 2]]
                )
                self.splats.rotation[g] = q
