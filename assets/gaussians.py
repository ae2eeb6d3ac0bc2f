"""The Gaussians of a splat, as they lie in files and in host memory."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from core.rotation import multiply_quaternions, quaternions_from_matrices
from core.spherical_harmonics import rotate_sh

SH_COUNTS = (1, 4, 9, 16)  # coefficients of degree 0, 1, 2, 3


@dataclass(frozen=True)
class Gaussians:
    """N Gaussians. All arrays are float32 but `object_id`.

    means            centres [m], (N, 3)
    quats            unit quaternions wxyz, (N, 4)
    log_scales       natural log of the standard deviations [m], (N, 3)
    logit_opacities  logit of the opacity, (N,)
    sh               spherical harmonics, (N, K, 3), K = 1, 4, 9 or 16; colour = 0.5 + SH(d)
    object_id        uint16, (N,); 0 = background
    """

    means: np.ndarray
    quats: np.ndarray
    log_scales: np.ndarray
    logit_opacities: np.ndarray
    sh: np.ndarray
    object_id: np.ndarray

    @classmethod
    def of(cls, means, quats, log_scales, logit_opacities, sh, object_id=None) -> Gaussians:
        """Convert dtypes, normalise quaternions; the inputs must be finite already."""
        n = len(means)
        quats = np.asarray(quats, np.float32).reshape(n, 4)
        quats = quats / np.maximum(np.linalg.norm(quats, axis=1, keepdims=True), 1e-12)
        sh = np.ascontiguousarray(sh, np.float32)
        count = sh.size // (3 * n) if n else sh.shape[1] if sh.ndim == 3 else 1
        ids = np.zeros(n, np.uint16) if object_id is None else np.asarray(object_id, np.uint16)
        return cls(
            np.ascontiguousarray(means, np.float32).reshape(n, 3),
            np.ascontiguousarray(quats, np.float32),
            np.ascontiguousarray(log_scales, np.float32).reshape(n, 3),
            np.ascontiguousarray(logit_opacities, np.float32).reshape(n),
            sh.reshape(n, count, 3),
            np.ascontiguousarray(ids).reshape(n),
        )

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        """0 to 3."""
        return SH_COUNTS.index(self.sh.shape[1])

    @property
    def opacities(self) -> np.ndarray:
        """Opacity in 0..1, (N,)."""
        return 1.0 / (1.0 + np.exp(-self.logit_opacities.clip(-80, 80)))

    def select(self, which: np.ndarray) -> Gaussians:
        """The Gaussians of an index array or boolean mask."""
        return Gaussians(*(getattr(self, f.name)[which] for f in fields(self)))

    def with_sh_degree(self, degree: int) -> Gaussians:
        """Pad with zeros, or cut, to the given SH degree."""
        k = SH_COUNTS[degree]
        sh = np.zeros((len(self), k, 3), np.float32)
        shared = min(k, self.sh.shape[1])
        sh[:, :shared] = self.sh[:, :shared]
        return replace(self, sh=sh)

    def transformed(self, rotation: np.ndarray, translation=(0.0, 0.0, 0.0), scale: float = 1.0) -> Gaussians:
        """Apply x -> scale * rotation @ x + translation, the view-dependent colour included."""
        rotation = np.asarray(rotation, np.float64)
        means = scale * self.means @ rotation.T + np.asarray(translation)
        quats = multiply_quaternions(quaternions_from_matrices(rotation)[None], self.quats)
        sh = rotate_sh(self.sh, rotation)
        return Gaussians.of(means, quats, self.log_scales + np.log(scale), self.logit_opacities, sh, self.object_id)


def concatenate(parts: list[Gaussians]) -> Gaussians:
    """One set of all parts, padded to the highest SH degree among them."""
    degree = max(p.sh_degree for p in parts)
    parts = [p.with_sh_degree(degree) for p in parts]
    return Gaussians(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Gaussians)))
