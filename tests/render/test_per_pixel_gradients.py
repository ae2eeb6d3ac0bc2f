"""Gradients of a picture whose pixels blend in their own order."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assets.gaussians import Gaussians, concatenate
from core.camera import look_at, perspective
from core.spherical_harmonics import C0
from tests.render.test_gradients import NAMES, SIZE, Differentiable, assert_near, differences
from tests.render.test_per_pixel_sort import BUFFER_SIZE, EYE, crowd, slab, sorted_by_pixel
from tests.support import reference_render as reference

NOTHING = np.zeros((EYE.height, EYE.width))


@pytest.fixture(scope="module")
def pixel(ti_cpu):
    return Differentiable(sort="pixel")


@pytest.fixture(scope="module")
def radial(ti_cpu):
    return Differentiable(sort="radial")


def test_gradients_equal_finite_differences_of_a_twin_that_sorts_each_pixel(pixel, radial):
    """Discs that cross each other all over the picture; those of an order of whole splats differ."""
    rng = np.random.default_rng(3)
    n = 7
    shapes = rng.normal(size=(n, 4)), np.log([[0.6, 0.5, 0.02]]) + rng.uniform(0.0, 0.4, (n, 3))
    sh = np.zeros((n, 16, 3))
    sh[:, 0] = rng.uniform(-1.0, 1.0, (n, 3))
    means, logits = rng.uniform(-0.2, 0.2, (n, 3)), rng.uniform(-1.0, 1.0, n)
    g = Gaussians(means, *shapes, logits, sh, np.zeros(n, np.uint16))
    camera = perspective(SIZE, SIZE, 0.4, look_at((0.3, 0.4, -2.6), (0, 0, 0)))
    weights = [rng.normal(size=(SIZE, SIZE, *channels)) for channels in ((3,), (), ())]
    truth = sorted_by_pixel(g, camera, linear=True)
    # where two discs cross, a pixel may fall on either side in float32
    near = np.abs(pixel(g, camera, *weights)[0][0] - truth[0]).max(axis=-1) < 1e-4
    assert near.mean() > 0.97
    for w in weights:
        w[~near] = 0.0
    _, gradients, _ = pixel(g, camera, *weights)
    by_distance = radial(g, camera, *weights)[1]

    def loss(g: Gaussians) -> float:
        return sum(
            float((w * image).sum())
            for w, image in zip(weights, sorted_by_pixel(g, camera, linear=True)[:3], strict=True)
        )

    for name, gradient, other in zip(NAMES[:4], gradients[:4], by_distance[:4], strict=True):
        found = differences(lambda v, name=name: loss(replace(g, **{name: v})), getattr(g, name))
        assert_near(gradient, found, 2e-3, name)
        assert np.abs(other - found).max() > 0.05 * np.abs(found).max(), name


def test_where_the_order_is_the_same_so_are_the_gradients(pixel, radial):
    """Balls behind each other, more than the buffer holds, and so opaque that pixels end before the last."""
    colours = [(k % 3 / 2, 0.5, 0.7) for k in range(BUFFER_SIZE + 8)]
    balls = [slab((0.01 * k, 0.0, 0.6 + 0.3 * k, 0), 0.05, 0.04, 0.03, c, opacity=0.6) for k, c in enumerate(colours)]
    g = concatenate(balls).with_sh_degree(3)
    rng = np.random.default_rng(4)
    weights = [rng.normal(size=(EYE.height, EYE.width, *channels)) for channels in ((3,), (), ())]
    own, one = pixel(g, EYE, *weights), radial(g, EYE, *weights)
    assert one[0][1].max() > 1 - 2e-4
    for name, gradient, truth in zip(NAMES, own[1], one[1], strict=True):
        assert_near(gradient, truth, 1e-4, name)
    assert_near(own[2], one[2], 1e-4, "camera")


def test_what_the_buffer_cannot_sort_has_the_gradients_of_the_picture_that_is_drawn(pixel):
    """A loss is linear in a colour, and in an opacity within the splat's border: differences are exact.

    The crowd is thin: no pixel ends before the last splat, which would be a step.
    """
    g = crowd(250).with_sh_degree(3)
    g = replace(g, logit_opacities=g.logit_opacities - 2.5)
    assert sorted_by_pixel(g, EYE, linear=True)[3].max() > 2 * BUFFER_SIZE
    weight = np.random.default_rng(5).normal(size=(EYE.height, EYE.width, 3))
    uv, sigma, opacity, _, _ = reference.project(g.means, reference.covariances(g), g.opacities, EYE, linear=True)
    v, u = np.mgrid[: EYE.height, : EYE.width] + 0.5

    def loss(weight: np.ndarray, name: str, values: np.ndarray):
        images, gradients, _ = pixel(replace(g, **{name: values}), EYE, weight, NOTHING, NOTHING)
        return float((weight * images[0]).sum()), gradients

    strongest = np.argsort(-np.abs(loss(weight, "sh", g.sh)[1][NAMES.index("sh")][:, 0, 1]))[:4]
    for k in strongest:
        offset = np.stack([u, v], -1) - uv[k]
        inside = np.einsum("hwi,ij,hwj->hw", offset, np.linalg.inv(sigma[k]), offset) < 2 * np.log(100 * opacity[k])
        within = weight * inside[..., None]
        _, gradients = loss(within, "sh", g.sh)
        by_color, by_logit = gradients[NAMES.index("sh")][k, 0, 1], gradients[NAMES.index("logit_opacities")][k]
        sh, logits = ([None, values.copy(), values.copy()] for values in (g.sh, g.logit_opacities))
        for sign in (1, -1):
            sh[sign][k, 0, 1] += 0.1 * sign
            o = opacity[k] + 0.01 * sign
            logits[sign][k] = np.log(o / (1 - o))
        ends = [loss(within, "sh", sh[sign])[0] for sign in (1, -1)]
        assert ends[0] - ends[1] == pytest.approx(0.2 * by_color, rel=1e-3)
        ends = [loss(within, "logit_opacities", logits[sign])[0] for sign in (1, -1)]
        assert ends[0] - ends[1] == pytest.approx(0.02 * by_logit / (opacity[k] * (1 - opacity[k])), rel=1e-2)


def test_a_second_picture_of_other_numbers(pixel):
    """Of the colours themselves as labels: both pictures are equal, and the gradients by geometry are those twice."""
    g = crowd(60).with_sh_degree(3)
    labels = np.maximum(0.0, 0.5 + C0 * g.sh[:, 0])
    weight = np.random.default_rng(6).normal(size=(EYE.height, EYE.width, 3))
    for field in (pixel.gradients.d_mean, pixel.gradients.d_cov, pixel.gradients.d_opacity):
        field.fill(0.0)  # of those that are not seen they stay
    once, twice = pixel(g, EYE, weight, NOTHING, NOTHING), pixel(g, EYE, weight, NOTHING, NOTHING, labels, weight)
    assert_allclose(twice[3], once[0][0], atol=1e-5)
    for name, single, double in zip(NAMES[:4], once[1][:4], twice[1][:4], strict=True):
        assert_near(double, 2 * single, 1e-4, name)
