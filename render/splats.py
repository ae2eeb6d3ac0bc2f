"""The Gaussians as the device holds them: what the embedding moves and the renderer draws."""

import numpy as np
import taichi as ti

from assets.gaussians import Gaussians
from core.fields import round_up_capacity
from core.rotation import matrices_from_quaternions


@ti.data_oriented
class Splats:
    """Device fields of N Gaussians, flat over all bodies; entries from `count` to `capacity` are unused.

    mean      world position [m], vec3
    cov       world covariance [m^2], vec6 = (xx, xy, xz, yy, yz, zz)
    opacity   0..1
    sh        spherical harmonics, vec3, (capacity, coefficients)
    rotation  quaternion wxyz that turns the frame of `sh` into the world; identity at the start
    light     multiplier of the colour, 1 at the start

    `banded` = [begin, end) holds all Gaussians whose colour depends on the view: a room of degree 0
    that was padded for the sake of a shiny body is not evaluated to the body's degree. `room`: for at least so many.
    """

    def __init__(self, gaussians: Gaussians, *, room: int = 0):
        self.count = len(gaussians)
        self.capacity = round_up_capacity(max(self.count, room))
        self.coefficients = gaussians.sh.shape[1]
        self.mean = ti.Vector.field(3, ti.f32)
        self.cov = ti.Vector.field(6, ti.f32)
        self.opacity = ti.field(ti.f32)
        self.sh = ti.Vector.field(3, ti.f32)
        self.rotation = ti.Vector.field(4, ti.f32)
        self.light = ti.field(ti.f32)
        builder = ti.FieldsBuilder()
        for f in (self.mean, self.cov, self.opacity, self.rotation, self.light):
            builder.dense(ti.i, self.capacity).place(f)
        if ti.cfg.arch == ti.cuda:  # neighbouring threads read neighbouring words
            builder.dense(ti.j, self.coefficients).dense(ti.i, self.capacity).place(self.sh)
        else:
            builder.dense(ti.ij, (self.capacity, self.coefficients)).place(self.sh)
        self.tree = builder.finalize()
        self.mean.from_numpy(self._padded(gaussians.means))
        self.cov.from_numpy(self._padded(covariances(gaussians)))
        self.opacity.from_numpy(self._padded(gaussians.opacities))
        self.sh.from_numpy(self._padded(gaussians.sh))
        colored_by_view = np.flatnonzero((gaussians.sh[:, 1:] != 0).any(axis=(1, 2)))
        self.banded = (int(colored_by_view[0]), int(colored_by_view[-1]) + 1) if colored_by_view.size else (0, 0)
        if room > self.count and self.banded[1]:
            self.banded = (self.banded[0], self.capacity)
        self._start = gaussians.means  # where they were at the start [m], for the host
        self.rotation.fill(ti.Vector([1.0, 0.0, 0.0, 0.0]))
        self.light.fill(1.0)

    def _padded(self, values: np.ndarray) -> np.ndarray:
        out = np.zeros((self.capacity, *values.shape[1:]), np.float32)
        out[: self.count] = values
        return out

    def reach(self, center) -> float:
        """Distance from `center` within which 95% of the Gaussians lay at the start [m]; at least 1 mm."""
        if self.count == 0:
            return 1.0
        return max(1e-3, float(np.percentile(np.linalg.norm(self._start - np.asarray(center), axis=1), 95)))

    def read(self, first: int, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Opacities (count,) and harmonics (count, coefficients, 3) of some, on the host."""
        opacity = np.zeros(max(count, 1), np.float32)  # Taichi takes no empty arrays
        sh = np.zeros((max(count, 1), self.coefficients, 3), np.float32)
        self._read(first, count, opacity, sh)
        return opacity[:count], sh[:count]

    def put(self, first: int, opacity: np.ndarray, sh: np.ndarray) -> None:
        """Write what `read` gave to other places; the embedding writes the rest."""
        if len(opacity):
            self._put(first, opacity, sh)

    def larger(self, room: int) -> "Splats":
        """The same Gaussians with room for more, of which any may have a colour that depends on the view."""
        none = Gaussians.of(*(np.zeros((0, k)) for k in (3, 4, 3)), np.zeros(0), np.zeros((0, self.coefficients, 3)))
        other = Splats(none, room=max(room, self.count))
        other.count, other._start = self.count, self._start
        if self.coefficients > 1:
            other.banded = (self.banded[0], other.capacity) if self.banded[1] else (0, 0)
        other._take(
            self.count, self.mean, self.cov, self.opacity, self.sh, self.rotation, self.light,
        )  # fmt: skip
        return other

    @ti.kernel
    def _read(
        self, first: ti.i32, count: ti.i32, opacity: ti.types.ndarray(ti.f32, 1), sh: ti.types.ndarray(ti.f32, 3)
    ):
        for i in range(count):
            opacity[i] = self.opacity[first + i]
            for k in range(self.coefficients):
                for c in ti.static(range(3)):
                    sh[i, k, c] = self.sh[first + i, k][c]

    @ti.kernel
    def _put(self, first: ti.i32, opacity: ti.types.ndarray(ti.f32, 1), sh: ti.types.ndarray(ti.f32, 3)):
        for i in range(opacity.shape[0]):
            self.opacity[first + i] = opacity[i]
            for k in range(self.coefficients):
                for c in ti.static(range(3)):
                    self.sh[first + i, k][c] = sh[i, k, c]

    @ti.kernel
    def _take(
        self, count: ti.i32, mean: ti.template(), cov: ti.template(), opacity: ti.template(), sh: ti.template(),
        rotation: ti.template(), light: ti.template(),
    ):  # fmt: skip
        for i in range(count):
            self.mean[i], self.cov[i], self.rotation[i] = mean[i], cov[i], rotation[i]
            self.opacity[i], self.light[i] = opacity[i], light[i]
            for k in range(self.coefficients):
                self.sh[i, k] = sh[i, k]

    def destroy(self) -> None:
        """Give the device memory back; the object must not be used after."""
        self.tree.destroy()


def covariances(gaussians: Gaussians) -> np.ndarray:
    """Sigma = R S S R^T [m^2] as (N, 6) = (xx, xy, xz, yy, yz, zz), float64 inside."""
    axes = matrices_from_quaternions(gaussians.quats) * np.exp(gaussians.log_scales.astype(np.float64))[:, None, :]
    sigma = axes @ axes.transpose(0, 2, 1)
    i, j = np.triu_indices(3)
    return sigma[:, i, j].astype(np.float32)
