"""The backward pass: against gsplat's gradients, and against finite differences of the float64 renderer."""

from dataclasses import replace

import numpy as np
import pytest
import taichi as ti

from assets.gaussians import Gaussians
from core.camera import Camera, look_at, perspective
from prepare.train.parameters import Parameters
from render.blend_gradients import BlendGradients
from render.projection_gradients import ProjectionGradients
from render.renderer import Renderer
from render.splats import Splats
from tests.support import reference_render as reference

NAMES = ("means", "quats", "log_scales", "logit_opacities", "sh")
COUNT, HEIGHT, WIDTH = 400, 80, 96  # of gsplat's gradients
SIZE = 24  # [px] of the pictures of finite differences


@ti.data_oriented
class Differentiable:
    """A picture of Gaussians of degree 3, and the gradient of a loss that is linear in its channels."""

    def __init__(self, *, antialias: bool):
        rows = np.zeros((COUNT, 3)), np.tile([1.0, 0, 0, 0], (COUNT, 1)), np.zeros((COUNT, 3))
        self.splats = Splats(Gaussians.of(*rows, np.zeros(COUNT), np.zeros((COUNT, 16, 3))))
        self.splats.sh_range = (0, self.splats.capacity)
        self.parameters = Parameters(self.splats)
        self.renderer = Renderer(self.splats, WIDTH, HEIGHT, outputs="float", antialias=antialias)
        self.blend = BlendGradients(self.renderer.rasterizer.tile_pass.bins, self.renderer.sink)
        self.gradients = ProjectionGradients(self.blend)
        n = self.splats.capacity
        self.d_quat, self.d_log_scale = ti.Vector.field(4, ti.f32, n), ti.Vector.field(3, ti.f32, n)
        self.d_logit = ti.field(ti.f32, n)

    @ti.kernel
    def activate(self, count: ti.i32):
        self.parameters.activate(0, count)

    @ti.kernel
    def backward(self, count: ti.i32):
        self.blend.clear(0, count)
        self.blend.backward()
        self.gradients.backward(0, count)
        for g in range(count):
            self.d_quat[g], self.d_log_scale[g], self.d_logit[g] = self.parameters.backward(g, self.gradients)

    def __call__(self, g: Gaussians, camera: Camera, d_rgb, d_alpha, d_depth):
        """Picture (rgb, alpha, depth), gradients by NAMES, and by the camera's rows (3, 4)."""
        p, s, b, n = self.parameters, self.splats, self.blend, len(g)
        s.set_count(n)
        fields = (s.mean, p.quat, p.log_scale, p.logit, s.sh)
        for field, name in zip(fields, NAMES, strict=True):
            field.from_numpy(s.padded(getattr(g, name)))
        for field, values in ((b.d_rgb, d_rgb), (b.d_alpha, d_alpha), (b.d_depth, d_depth)):
            whole = np.zeros((HEIGHT, WIDTH, *values.shape[2:]), np.float32)
            whole[: camera.height, : camera.width] = values
            field.from_numpy(whole)
        self.activate(n)
        r = self.renderer
        r.rasterizer.resize(camera.width, camera.height)
        r.width, r.height = camera.width, camera.height
        r.render([camera])
        self.backward(n)
        out = (self.gradients.d_mean, self.d_quat, self.d_log_scale, self.d_logit, self.gradients.d_sh)
        picture = [image.to_numpy()[0, : camera.height, : camera.width] for image in (r.rgb, r.alpha, r.depth)]
        return picture, [field.to_numpy()[:n] for field in out], self.gradients.d_camera.to_numpy()


@pytest.fixture(scope="module")
def differentiable(ti_cpu):
    return {antialias: Differentiable(antialias=antialias) for antialias in (False, True)}


def assert_near(value, truth, tolerance: float, name: str) -> None:
    """Every entry within `tolerance` of the array's largest magnitude."""
    assert np.abs(value - truth).max() <= tolerance * np.abs(truth).max(), name


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
    for image, truth in zip(picture, reference.render(g, camera, antialias=antialias), strict=True):
        np.testing.assert_allclose(image, truth, atol=2e-5)

    def loss(g, camera) -> float:
        images = reference.render(g, camera, antialias=antialias)
        return sum(float((w * image).sum()) for w, image in zip(weights, images, strict=True))

    def slope(moved, step: float = 1e-5) -> float:
        return (loss(*moved(step)) - loss(*moved(-step))) / (2 * step)

    for name, gradient in zip(NAMES, gradients, strict=True):
        values, truth = getattr(g, name), []
        entries = list(np.ndindex(values.shape))
        chosen = [entries[k] for k in rng.choice(len(entries), min(len(entries), 20), replace=False)]
        for at in chosen:

            def moved(by, at=at, name=name, values=values):
                new = values.copy()
                new[at] += by
                return replace(g, **{name: new}), camera

            truth.append(slope(moved))
        assert_near(np.array([gradient[at] for at in chosen]), np.array(truth), 1e-3, name)
    for at in np.ndindex(3, 4):

        def turned(by, at=at):
            matrix = camera.world_to_camera.copy()
            matrix[at] += by
            return g, replace(camera, world_to_camera=matrix)

        assert abs(by_camera[at] - slope(turned)) <= 2e-3 * np.abs(by_camera).max(), at


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
