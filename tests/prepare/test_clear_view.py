"""The clearest of several views of a static scene, and how clear it is said to be."""

import numpy as np

from assets.gaussians import Gaussians, concatenate
from prepare.environment.support_planes import CLEAR, clearest


def discs(points, sigma: float) -> Gaussians:
    """Opaque round Gaussians of a standard deviation [m] at points (N, 3)."""
    n = len(points)
    quats = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    return Gaussians.of(points, quats, np.full((n, 3), np.log(sigma)), np.full(n, 3.0), np.zeros((n, 1, 3)))


def test_fog_before_the_eye_is_no_clear_view(ti_cpu):
    """A wall at z = 0, and wide Gaussians on the way to it, before one of two eyes."""
    u = np.linspace(-2.5, 2.5, 60)
    wall = discs(np.insert(np.stack(np.meshgrid(u, u), -1).reshape(-1, 2), 2, 0.0, axis=1), 0.07)
    fog = discs(np.random.default_rng(0).uniform((-1.4, -0.5, 0.7), (-0.4, 0.5, 0.8), (60, 3)), 0.15)
    eyes, target = [np.array([-1.2, 0.0, 2.0]), np.array([1.2, 0.0, 2.0])], np.zeros(3)
    chosen, share = clearest(concatenate([wall, fog]), eyes, target)
    assert (chosen == eyes[1]).all() and share > CLEAR
    far = np.array([0.0, 0.0, 200.0])  # for which nothing is fog, and which sees next to nothing
    assert clearest(concatenate([wall, fog]), [far, eyes[0]], target)[1] < CLEAR
