"""The pose of the Gaussians that stand still: a room that the user turns, as a whole."""

import numpy as np
import taichi as ti

from core.fields import FieldGroup
from core.rotation import quaternions_from_matrices
from render.splats import Splats

mat3, vec3, vec4 = ti.math.mat3, ti.math.vec3, ti.math.vec4


@ti.data_oriented
class StillPose:
    """Turns and moves the first `count` splats rigidly, from where they were when it was made.

    mean, cov  what they were then
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
