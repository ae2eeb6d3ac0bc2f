"""The Gaussians as the device holds them: what the embedding moves and the renderer draws."""

import numpy as np
import taichi as ti

from assets.gaussians import Gaussians, matrices_of_quats


def round_up(count: int) -> int:
    """Capacity for `count` items: at most a quarter more, so that scenes of like size share compiled kernels."""
    step = max(256, 1 << max(0, int(count - 1).bit_length() - 3))
    return max(step, -(-count // step) * step)


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
    that was padded for the sake of a shiny body is not evaluated to the body's degree.
    """

    def __init__(self, gaussians: Gaussians):
        self.count = len(gaussians)
        self.capacity = round_up(self.count)
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

    def destroy(self) -> None:
        """Give the device memory back; the object must not be used after."""
        self.tree.destroy()


def covariances(gaussians: Gaussians) -> np.ndarray:
    """Sigma = R S S R^T [m^2] as (N, 6) = (xx, xy, xz, yy, yz, zz), float64 inside."""
    axes = matrices_of_quats(gaussians.quats) * np.exp(gaussians.log_scales.astype(np.float64))[:, None, :]
    sigma = axes @ axes.transpose(0, 2, 1)
    i, j = np.triu_indices(3)
    return sigma[:, i, j].astype(np.float32)
