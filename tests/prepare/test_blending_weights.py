"""Sums of blending weights over maps of pixels."""

import numpy as np
import pytest

from assets.gaussians import concatenate
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


def test_weights_in_a_picture_that_was_drawn_are_those_of_the_gaussians_now(ti_cpu):
    """Another colour changes no weight, other Gaussians do."""
    g, camera = painted_gaussians(), perspective(40, 30, 0.8, look_at((0.0, 0.0, 1.9), (0.0, 0.0, 0.0)))
    everywhere = [np.ones((30, 40))]
    weights = BlendingWeights(g)
    first = weights.sums(camera, everywhere)
    weights.picture(camera)
    weights.recolour(0.0 * g.sh)
    np.testing.assert_allclose(weights.sums(camera, everywhere), first, rtol=1e-5)
    assert np.ptp(weights.picture(camera)[0][15, 20]) == 0.0
    weights.replace(g.select(np.arange(len(g) // 2)))
    half = weights.sums(camera, everywhere)
    both = concatenate([g, g])  # more than there was room for
    weights.replace(both)
    sums, alpha = weights.sums(camera, everywhere), weights.drawn()[2]
    assert sums.shape == (len(both), 1) and sums.sum() == pytest.approx(alpha.sum(), rel=1e-4)
    assert sums.sum() > 1.05 * first.sum()
    weights.destroy()
    alone = BlendingWeights(g.select(np.arange(len(g) // 2)))
    np.testing.assert_allclose(half, alone.sums(camera, everywhere), rtol=1e-4)
    alone.destroy()
