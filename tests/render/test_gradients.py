"""The backward pass: against gsplat's gradients, and against finite differences of the float64 renderer."""

from dataclasses import replace

import numpy as np
import pytest
import taichi as ti

from assets.gaussians import Gaussians
from core.camera import Camera, look_at, perspective
from core.spherical_harmonics import C0
from prepare.train.population import Parameters
from render.blend import Blend
from render.blend_gradients import BlendGradients
from render.per_pixel_sort import PerPixelSort
from render.projection_gradients import ProjectionGradients
from render.renderer import FloatImages, Renderer
from render.splats import Splats
from tests.support import reference_render as reference

NAMES = ("means", "quats", "log_scales", "logit_opacities", "sh")
COUNT, HEIGHT, WIDTH = 400, 80, 96  # of gsplat's gradients
SIZE = 24  # [px] of the pictures of finite differences


@ti.data_oriented
class Differentiable:
    """A picture of Gaussians of degree 3, and the gradient of a loss that is linear in its channels."""

    def __init__(self, *, antialias: bool = False, sort: str = "z"):
        rows = np.zeros((COUNT, 3)), np.tile([1.0, 0, 0, 0], (COUNT, 1)), np.zeros((COUNT, 3))
        self.splats = Splats(Gaussians.of(*rows, np.zeros(COUNT), np.zeros((COUNT, 16, 3))))
        self.splats.sh_range = (0, self.splats.capacity)
        self.parameters = Parameters(self.splats)
        how = {"outputs": "float", "antialias": antialias, "sort": sort, "linear": True}
        self.renderer = Renderer(self.splats, WIDTH, HEIGHT, **how)
        self.blend = BlendGradients(self.renderer.rasterizer.tile_pass.bins, self.renderer.sink)
        self.gradients = ProjectionGradients(self.blend)
        n = self.splats.capacity
        self.d_quat, self.d_log_scale = ti.Vector.field(4, ti.f32, n), ti.Vector.field(3, ti.f32, n)
        self.d_logit = ti.field(ti.f32, n)

        self.labels = ti.Vector.field(3, ti.f32, n)  # of a second picture from the same bins
        self.labelled = FloatImages(1, HEIGHT, WIDTH)
        bins = self.blend.bins
        drawer = PerPixelSort if sort == "pixel" else Blend
        self.draw_labels = drawer(bins, with_color=True, with_depth=False, color=self.labels)
        self.by_labels = BlendGradients(bins, self.labelled, color=self.labels, into=self.blend)

    @ti.kernel
    def draw_second(self):
        self.draw_labels.draw(self.labelled, 0)

    @ti.kernel
    def activate(self, count: ti.i32):
        self.parameters.activate(0, count)

    @ti.kernel
    def backward(self, count: ti.i32, second: ti.template()):
        self.blend.clear(0, count)
        self.blend.backward()
        if ti.static(second):
            self.by_labels.clear(0, count)
            self.by_labels.backward()
        self.gradients.backward(0, count)
        for g in range(count):
            self.d_quat[g], self.d_log_scale[g], self.d_logit[g] = self.parameters.backward(g, self.gradients)

    def __call__(self, g: Gaussians, camera: Camera, d_rgb, d_alpha, d_depth, labels=None, d_labelled=None):
        """Picture (rgb, alpha, depth), gradients by NAMES, and by the camera's rows (3, 4).

        With labels (N, 3): the picture of those, and the gradient by them, follow.
        """
        p, s, b, n = self.parameters, self.splats, self.blend, len(g)
        s.count = n
        fields = (s.mean, p.quat, p.log_scale, p.logit, s.sh)
        for field, name in zip(fields, NAMES, strict=True):
            field.from_numpy(s.padded(getattr(g, name)))
        pixels = [(b.d_rgb, d_rgb), (b.d_alpha, d_alpha), (b.d_depth, d_depth)]
        if labels is not None:
            self.labels.from_numpy(s.padded(labels))
            pixels.append((self.by_labels.d_rgb, d_labelled))
        for field, values in pixels:
            whole = np.zeros((HEIGHT, WIDTH, *values.shape[2:]), np.float32)
            whole[: camera.height, : camera.width] = values
            field.from_numpy(whole)
        self.activate(n)
        r = self.renderer
        r.resize(camera.width, camera.height)
        r.render([camera])
        if labels is not None:
            self.draw_second()
        self.backward(n, labels is not None)
        out = (self.gradients.d_mean, self.d_quat, self.d_log_scale, self.d_logit, self.gradients.d_sh)
        picture = [image.to_numpy()[0, : camera.height, : camera.width] for image in (r.rgb, r.alpha, r.depth)]
        results = picture, [field.to_numpy()[:n] for field in out], self.gradients.d_camera.to_numpy()
        if labels is None:
            return results
        labelled = self.labelled.rgb.to_numpy()[0, : camera.height, : camera.width]
        return *results, labelled, self.by_labels.sums.to_numpy()[:n, 7:]


@pytest.fixture(scope="module")
def differentiable(ti_cpu):
    return {antialias: Differentiable(antialias=antialias) for antialias in (False, True)}


def assert_near(value, truth, tolerance: float, name: str) -> None:
    """Every entry within `tolerance` of the array's largest magnitude."""
    assert np.abs(value - truth).max() <= tolerance * np.abs(truth).max(), name


def differences(loss, values: np.ndarray, entries=None, step: float = 1e-5) -> np.ndarray:
    """Central differences of loss(values) by all entries of an array, or by some."""
    found = []
    for at in np.ndindex(values.shape) if entries is None else entries:
        ends = []
        for sign in (1, -1):
            new = values.copy()
            new[at] += sign * step
            ends.append(loss(new))
        found.append((ends[0] - ends[1]) / (2 * step))
    return np.array(found) if entries is not None else np.reshape(found, values.shape)


@pytest.mark.shared
def test_gradients_equal_those_of_gsplat(differentiable, shared):
    truth = np.load(shared / "reference" / "gradients.npz")
    K = truth["K"]
    camera = Camera(WIDTH, HEIGHT, K[0, 0], K[1, 1], K[0, 2], K[1, 2], truth["world_to_camera"])
    g = Gaussians(*(truth[name] for name in NAMES), np.zeros(COUNT, np.uint16))
    weight = truth["weight"]
    picture, gradients, _ = differentiable[False](g, camera, weight, 0.5 * weight[..., 0], 0.0 * weight[..., 0])
    np.testing.assert_allclose(picture[0], truth["rgb"], atol=1e-5)
    for name, gradient in zip(NAMES, gradients, strict=True):
        assert_near(gradient, truth[f"grad_{name}"], 1e-4, name)


@pytest.mark.parametrize("antialias", [False, True])
def test_gradients_equal_finite_differences(differentiable, antialias):
    """By all parameters and the camera, of colour, opacity and depth; splats cover the picture: no pixel is cut off."""
    rng = np.random.default_rng(5)
    n = 9
    sh = rng.normal(0.0, 0.1, (n, 16, 3))
    sh[:, 0] += 1.0
    means = rng.uniform(-0.5, 0.5, (n, 3))
    shapes = rng.normal(size=(n, 4)), rng.uniform(0.0, 0.5, (n, 3)), rng.uniform(-1.5, -0.5, n)
    g = Gaussians(means, *shapes, sh, np.zeros(n, np.uint16))
    camera = perspective(SIZE, SIZE, 0.8, look_at((0.3, 0.4, -2.6), (0, 0, 0)))
    weights = rng.normal(size=(SIZE, SIZE, 3)), rng.normal(size=(SIZE, SIZE)), 0.3 * rng.normal(size=(SIZE, SIZE))
    picture, gradients, by_camera = differentiable[antialias](g, camera, *weights)
    for image, truth in zip(picture, reference.render(g, camera, antialias=antialias, linear=True), strict=True):
        np.testing.assert_allclose(image, truth, atol=2e-5)

    def loss(g, camera) -> float:
        images = reference.render(g, camera, antialias=antialias, linear=True)
        return sum(float((w * image).sum()) for w, image in zip(weights, images, strict=True))

    for name, gradient in zip(NAMES, gradients, strict=True):
        entries = list(np.ndindex(gradient.shape))
        chosen = [entries[k] for k in rng.choice(len(entries), min(len(entries), 20), replace=False)]
        truth = differences(lambda v, name=name: loss(replace(g, **{name: v}), camera), getattr(g, name), chosen)
        assert_near(np.array([gradient[at] for at in chosen]), truth, 1e-3, name)
    rows = list(np.ndindex(3, 4))
    truth = differences(lambda m: loss(g, replace(camera, world_to_camera=m)), camera.world_to_camera, rows)
    assert_near(by_camera.reshape(-1), truth, 2e-3, "camera")


def test_what_is_not_seen_has_no_gradient(differentiable):
    """A Gaussian behind an opaque one is hardly pulled, one behind the camera not at all."""
    means = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5], [0.0, 0.0, -5.0]])
    n = len(means)
    shapes = np.tile([1.0, 0, 0, 0], (n, 1)), np.full((n, 3), 1.0), np.array([20.0, 0.0, 0.0])
    g = Gaussians(means, *shapes, np.ones((n, 16, 3)), np.zeros(n, np.uint16))
    camera = perspective(16, 16, 0.1, look_at((0, 0, -2.0), (0, 0, 0)))
    made = differentiable[False]
    made.gradients.d_sh.fill(0.0)
    ones = np.ones((16, 16))
    _, gradients, _ = made(g, camera, np.ones((16, 16, 3)), ones, ones)
    sh = np.abs(gradients[NAMES.index("sh")]).max(axis=(1, 2))
    assert sh[0] > 1.0 and sh[1] <= 2e-3 * sh[0] and sh[2] == 0.0


def test_gradients_of_a_second_picture_of_other_numbers_equal_finite_differences(differentiable):
    """By those numbers, and, added to those of the first picture, by all that both are drawn from."""
    rng = np.random.default_rng(6)
    n = 7
    shapes = rng.normal(size=(n, 4)), rng.uniform(-0.5, 0.2, (n, 3)), rng.uniform(-1.5, -0.5, n)
    sh = np.zeros((n, 16, 3))
    sh[:, 0] = rng.uniform(0.2, 2.0, (n, 3))
    g = Gaussians(rng.uniform(-0.5, 0.5, (n, 3)), *shapes, sh, np.zeros(n, np.uint16))
    labels = rng.uniform(0.1, 0.9, (n, 3))
    camera = perspective(SIZE, SIZE, 0.8, look_at((0.3, 0.4, -2.6), (0, 0, 0)))
    nothing, first, second = np.zeros((SIZE, SIZE)), rng.normal(size=(SIZE, SIZE, 3)), rng.normal(size=(SIZE, SIZE, 3))
    picture, gradients, _, labelled, by_labels = differentiable[False](
        g, camera, first, nothing, nothing, labels, second
    )

    def drawn(g: Gaussians, labels: np.ndarray) -> np.ndarray:
        return reference.render(replace(g, sh=((labels - 0.5) / C0)[:, None]), camera, linear=True)[0]

    def loss(g: Gaussians, labels: np.ndarray) -> float:
        return float((first * reference.render(g, camera, linear=True)[0]).sum() + (second * drawn(g, labels)).sum())

    np.testing.assert_allclose(picture[0], reference.render(g, camera, linear=True)[0], atol=2e-5)
    np.testing.assert_allclose(labelled, drawn(g, labels), atol=2e-5)
    assert_near(by_labels, differences(lambda v: loss(g, v), labels), 1e-3, "labels")
    for name, gradient in zip(NAMES[:4], gradients[:4], strict=True):
        truth = differences(lambda v, name=name: loss(replace(g, **{name: v}), labels), getattr(g, name))
        assert_near(gradient, truth, 1e-3, name)
