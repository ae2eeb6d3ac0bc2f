"""Sums of blending weights over maps of pixels."""

import numpy as np
import pytest

from core.camera import look_at, perspective
from prepare.blending_weights import BlendingWeights
from tests.support.painted_capture import painted_gaussians


def test_weights_over_a_picture_add_up_to_its_opacity(ti_cpu):
    """Whatever the pictures' sizes, one after the other."""
    g, pose = painted_gaussians(), look_at((0.0, 0.0, 1.9), (0.0, 0.0, 0.0))
    weights = BlendingWeights(g)
    for width, height in ((40, 60), (64, 32), (20, 20)):
        left = np.zeros((height, width))
        left[:, : width // 2] = 1.0
        sums = weights.sums(perspective(width, height, 0.8, pose), [left, 1.0 - left])
        alpha = weights.drawn()[2]
        assert sums.shape == (len(g), 2) and alpha.shape == (height, width)
        assert sums.sum(0) == pytest.approx([(alpha * left).sum(), (alpha * (1.0 - left)).sum()], rel=1e-4)
    weights.destroy()
