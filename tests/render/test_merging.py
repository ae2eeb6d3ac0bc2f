"""Merging of Gaussians: moments, cost and choice against float64, and pictures against dropping the smallest."""

from dataclasses import replace

import numpy as np
import pytest

from assets.gaussians import Gaussians, symmetric_matrices
from core.spherical_harmonics import C0
from display.viewed_file import camera_around
from render.merging import Merging, decimated
from tests.support.samples import discs, some_gaussians


def close_pair(degree: int = 2) -> Gaussians:
    g = some_gaussians(2, degree, seed=4)
    return replace(g, means=(0.05 * g.means).astype(np.float32), log_scales=g.log_scales.clip(-4, -2))


def test_a_pair_keeps_the_moments_of_its_mass(ti_cpu):
    """Against the mixture of two normal distributions of these masses."""
    g = close_pair()
    merging = Merging(g, 1)
    (mean,), (cov,), (opacity,), (sh,), _ = merging.read(merging.decimate())
    merging.destroy()
    sigma, x = symmetric_matrices(g.covariances), g.means.astype(float)
    area = [np.sqrt(0.5 * (np.trace(s) ** 2 - np.trace(s @ s))) for s in sigma]  # the second invariant
    w = g.opacities * area
    w, mass = w / w.sum(), w.sum()
    expected = w @ x
    second = sum(w[i] * (sigma[i] + np.outer(x[i], x[i])) for i in range(2)) - np.outer(expected, expected)
    np.testing.assert_allclose(mean, expected, atol=1e-6)
    np.testing.assert_allclose(symmetric_matrices(cov[None])[0], second, atol=1e-5 * np.trace(second))
    np.testing.assert_allclose(sh, np.tensordot(w, g.sh, 1), atol=1e-6)
    invariant = np.sqrt(0.5 * (np.trace(second) ** 2 - np.trace(second @ second)))
    assert opacity == pytest.approx(min(mass / invariant, 0.999), rel=1e-4)


def test_the_cost_is_the_squared_error_of_the_pictures(ti_cpu):
    """Against pictures of 400 x 400 points, orthographic along x, y and z."""
    g = close_pair(0)
    merging = Merging(g, 1)
    best, cost = np.empty(2, np.int32), np.empty(2, np.float32)
    merging._find_partners(np.arange(2, dtype=np.int32), best, cost)
    live = merging.decimate()
    parts = [a.astype(float) for a in merging.read(np.array([0, 1, *live], np.int32))[:4]]
    merging.destroy()
    error = 0.0
    for axes in ((0, 1), (1, 2), (0, 2)):
        line = np.linspace(-1.5, 1.5, 400)
        p, total = np.stack(np.meshgrid(line, line), -1), 0.0
        for sign, m, s, o, h in zip((1, 1, -1), *parts, strict=True):
            d, S = p - m[list(axes)], symmetric_matrices(s[None])[0][np.ix_(axes, axes)]
            height = o * np.exp(-0.5 * np.einsum("yxi,ij,yxj->yx", d, np.linalg.inv(S), d))
            total = total + sign * height[..., None] * np.append(0.5 + C0 * h[0], 1.0)
        error += (total**2).sum() * (line[1] - line[0]) ** 2 / 3
    assert list(best) == [1, 0] and cost[0] == cost[1]
    assert cost[0] == pytest.approx(error, rel=2e-3)


def test_objects_are_not_mixed_and_the_rest_is_kept(ti_cpu):
    g = replace(some_gaussians(40, 1), object_id=np.arange(40, dtype=np.uint16) % 2 + 1, objects=("cat", "dog"))
    g = replace(g, sort="radial", antialias=True)
    few = decimated(g, 10)
    few.check("merged")
    assert len(few) == 10 and set(few.object_id) == {1, 2}
    assert (few.objects, few.sort, few.antialias) == (("cat", "dog"), "radial", True)
    assert len(decimated(g, 1)) == 2  # one an object
    assert decimated(g, 40) is g


def test_what_is_too_large_or_too_far_for_float32_stays_as_it_is(ti_cpu):
    g = some_gaussians(40, 0)
    g.log_scales[3], g.means[7] = 39.0, 9e14
    few = decimated(g, 10)
    few.check("merged")
    assert len(few) == 10
    assert (few.means.max(1) > 8e14).sum() == (few.log_scales.min(1) > 38).sum() == 1


def test_merging_looks_more_alike_than_dropping_the_smallest(ti_cpu):
    """A wall of two colours: its border must stay, and what is merged must stay opaque."""
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.uniform(-1, 1, (4000, 2)), 0.01 * rng.normal(size=(4000, 1))], 1)
    colours = np.where(points[:, :1] > 0.2, (0.9, 0.2, 0.1), (0.1, 0.3, 0.8))
    wall = discs(points, 0.015 * rng.uniform(0.5, 1, (4000, 1)), colours)
    largest = np.argsort(-wall.log_scales[:, 0])
    truth = picture(wall)
    errors = [np.mean((picture(g) - truth) ** 2) for g in (decimated(wall, 1000), wall.select(largest[:1000]))]
    assert errors[0] < 0.7 * errors[1]


def picture(g: Gaussians) -> np.ndarray:
    from render.renderer import Renderer
    from render.splats import Splats

    camera = camera_around(some_gaussians(300), 96, 72, 0.3)
    splats = Splats(g)
    renderer = Renderer(splats, 96, 72, outputs="float")
    renderer.render([camera])
    rgb = renderer.rgb.to_numpy()[0]
    renderer.destroy()
    splats.destroy()
    return rgb
