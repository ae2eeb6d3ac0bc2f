"""Each pixel in the order of its own ray: against a float64 twin that sorts all, and what the order must obey."""

import numpy as np
import pytest

from assets.gaussians import Gaussians, concatenate
from assets.splat_files import read_gaussians
from core.camera import Camera
from tests.support import reference_render as reference
from tests.support.drawing import Drawing
from tests.support.popping import turned

EYE = Camera(61, 45, 60.0, 64.0, 33.5, 20.25, np.eye(4))  # at the origin, along +z
BUFFER_SIZE = 16


def planes(g: Gaussians, camera: Camera, *, steepest: float = 0.5) -> np.ndarray:
    """a (N, 3) [1/m] in the camera's frame: where a ray meets the plane a . x = 1, a Gaussian is densest on it."""
    R, t = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
    p = g.means.astype(np.float64) @ R.T + t
    r = np.linalg.norm(p, axis=1)
    thickness = 0.3 * r**2 / (camera.fx * camera.fy)
    cov = R @ reference.covariances(g) @ R.T + thickness[:, None, None] * np.eye(3)
    n = np.linalg.solve(cov, p[:, :, None])[:, :, 0]
    h = p / r[:, None] - n * (r / (n * p).sum(1))[:, None]
    edge = np.sqrt((2 * np.log(255) + 0.01) * np.einsum("ni,nij,nj->n", h, cov, h))
    h *= np.minimum(1, steepest * r / np.maximum(edge, 1e-30))[:, None]
    return (p / r[:, None] - h) / r[:, None]


def rays(camera: Camera) -> np.ndarray:
    """Through the pixels' centres, (H, W, 3), with z = 1."""
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)


def sorted_by_pixel(g: Gaussians, camera: Camera, *, linear: bool = False):
    """rgb (H, W, 3), alpha (H, W), depth (H, W), and how many splats meet each pixel (H, W)."""
    uv, sigma, opacity, z, kept = reference.project(
        g.means.astype(np.float64), reference.covariances(g), g.opacities, camera, linear=linear
    )
    if not linear:  # that of the plane at the outline's centre
        at = (uv - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
        z = 1 / (np.column_stack([at, np.ones(len(g))]) * planes(g, camera)).sum(1)
    offset = (rays(camera)[..., :2] * [camera.fx, camera.fy] + [camera.cx, camera.cy])[..., None, :] - uv
    power = np.einsum("hwni,nij,hwnj->hwn", offset, np.linalg.inv(sigma), offset)
    alpha = np.where(kept, np.minimum(0.999, opacity * np.exp(-0.5 * power)), 0)
    alpha[alpha < 1 / 255] = 0
    order = np.argsort(-(rays(camera) @ planes(g, camera).T), axis=-1, kind="stable")
    alpha = np.take_along_axis(alpha, order, axis=-1)
    before = np.cumprod(np.concatenate([np.ones((*alpha.shape[:2], 1)), 1 - alpha[..., :-1]], axis=-1), axis=-1)
    weight = np.where(before * (1 - alpha) > 1e-4, alpha * before, 0)
    total = weight.sum(-1)
    rgb = np.einsum("hwn,hwnc->hwc", weight, reference.colors(g, camera)[order])
    return rgb, total, (weight * z[order]).sum(-1) / np.maximum(total, 1e-10), (alpha > 0).sum(-1)


def slab(mean, along, across, thin, colour, *, opacity=0.95) -> Gaussians:
    """One Gaussian: sigma [m] `along` x, `across` y, `thin` z of its own axes, turned by mean[3] [rad] about +y."""
    half = 0.5 * mean[3]
    sh = (np.asarray(colour, float) - 0.5) / 0.28209479177387814
    logit = np.log(opacity / (1 - opacity))
    quat = [[np.cos(half), 0, np.sin(half), 0]]
    return Gaussians.of([mean[:3]], quat, np.log([[along, across, thin]]), [logit], sh.reshape(1, 1, 3))


RED, GREEN = (0.9, 0.1, 0.1), (0.1, 0.9, 0.1)


@pytest.fixture(scope="module")
def pixel(ti_cpu):
    """A drawing for all pictures of this file: its kernels compile for seconds."""
    return Drawing(23_500, 1, 384, degree=3, sort="pixel", buffer_size=BUFFER_SIZE)


@pytest.fixture(scope="module")
def radial(ti_cpu):
    return Drawing(300, 1, EYE.width, degree=0, sort="radial")


def draw(drawing, g: Gaussians, camera: Camera = EYE) -> list[np.ndarray]:
    """rgb, alpha, depth of one view."""
    return [image[0] for image in drawing.draw(g, [camera])]


def crowd(count: int, seed=0, size=0.08) -> Gaussians:
    """Before the eye, long and flat ones among them."""
    rng = np.random.default_rng(seed)
    sh = rng.normal(0, 0.4, (count, 1, 3))
    scales = np.log(size) + rng.normal(0, 0.7, (count, 3))
    means, quats = rng.normal(0, 0.3, (count, 3)) + [0.0, 0.0, 1.2], rng.normal(size=(count, 4))
    return Gaussians.of(means, quats, scales, rng.normal(0, 2, count), sh)


def test_a_buffer_that_holds_all_equals_sorting_each_pixel(pixel, radial):
    g = crowd(35)
    rgb, alpha, depth = draw(pixel, g)
    expected_rgb, expected_alpha, expected_depth, met = sorted_by_pixel(g, EYE)
    assert 8 < met.max() <= BUFFER_SIZE
    close = np.abs(rgb - expected_rgb).max(axis=-1) < 1e-3
    assert close.mean() > 0.998  # where two planes cross, or at a threshold, a pixel may fall on either side in float32
    np.testing.assert_allclose(np.median(np.abs(alpha - expected_alpha)), 0, atol=1e-5)
    np.testing.assert_allclose(np.median(np.abs(depth - expected_depth)), 0, atol=1e-4)
    other = np.abs(draw(radial, g)[0] - expected_rgb).max(axis=-1)
    assert (other > 0.02).mean() > 0.02  # it is not all the same anyway


def test_more_than_the_buffer_holds_are_nearly_sorted(pixel, radial):
    g = crowd(250)
    expected, _, _, met = sorted_by_pixel(g, EYE)
    assert met.max() > 2 * BUFFER_SIZE
    error = np.abs(draw(pixel, g)[0] - expected).mean()
    assert error < 0.2 * np.abs(draw(radial, g)[0] - expected).mean()


def test_what_lies_apart_looks_the_same_however_it_is_sorted(pixel, radial):
    """Balls one behind the other, each nearer than any point of the next."""
    g = concatenate(
        [slab((0.02 * k, 0.01 * k, 0.6 + 0.3 * k, 0), 0.02, 0.02, 0.02, (k % 3 / 2, 0.5, 0.7)) for k in range(9)]
    )
    for a, b in zip(draw(pixel, g), draw(radial, g), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-5)


def test_two_crossing_planks_change_places_where_they_cross(pixel, radial):
    """Seen from above an X: on the left the red one is nearer, on the right the green one."""
    red = slab((0.0, 0.0, 2.0, np.radians(-35)), 0.5, 0.1, 0.002, RED)
    green = slab((0.0, 0.0, 2.0, np.radians(35)), 0.5, 0.1, 0.002, GREEN)
    for pair in ([red, green], [green, red]):
        rgb = draw(pixel, concatenate(pair))[0]
        left, right = rgb[20, 26], rgb[20, 41]
        assert left[0] > 2 * left[1] and right[1] > 2 * right[0]
    once = draw(radial, concatenate([red, green]))[0]
    assert (once[20, 26, 0] > once[20, 26, 1]) == (once[20, 41, 0] > once[20, 41, 1])


def test_what_lies_in_one_plane_keeps_its_order(pixel, radial):
    """Rounding must not shuffle a wall's Gaussians from pixel to pixel."""
    a = np.radians(50)
    middles = [(k * np.cos(a) * 0.05, 0.01 * k, 2.0 - k * np.sin(a) * 0.05, a) for k in range(-3, 4)]
    g = concatenate([slab(m, 0.1, 0.1, 1e-4, RED if k % 2 else GREEN) for k, m in enumerate(middles)])
    np.testing.assert_allclose(draw(pixel, g)[0], draw(radial, g)[0], atol=1e-5)


def device_planes(pixel, g: Gaussians, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """a (N, 3) in the camera's frame as the splats hold it, and which are drawn."""
    draw(pixel, g, camera)
    p = pixel.rasterizer.projection
    mean2d, slope, mask = (f.to_numpy()[0, : len(g)].astype(np.float64) for f in (p.mean2d, p.slope, p.tile_mask))
    drawn = mask[:, 1] != 0
    mean2d[~drawn, 3] = 1
    gx, gy = slope.T
    back = 1 / mean2d[:, 3] - gx * (mean2d[:, 0] - camera.cx) - gy * (mean2d[:, 1] - camera.cy)
    return np.stack([gx * camera.fx, gy * camera.fy, back], axis=1), drawn


def test_the_planes_equal_the_twin_and_stay_when_the_head_turns(pixel):
    g = crowd(250)
    a, drawn = device_planes(pixel, g, EYE)
    size = np.linalg.norm(a, axis=1, keepdims=True)
    np.testing.assert_allclose((a / size)[drawn], (planes(g, EYE) / size)[drawn], atol=1e-3)
    other = turned(EYE, 15.0)
    turn = other.world_to_camera
    b, drawn_too = device_planes(pixel, g, other)
    both = drawn & drawn_too
    assert both.sum() > 100
    np.testing.assert_allclose((b @ turn[:3, :3] / size)[both], (a / size)[both], atol=1e-3)


def test_the_plane_is_where_a_gaussian_is_densest_along_a_ray():
    """t = d^T Sigma^-1 p / d^T Sigma^-1 d: for a disc at all of it, for others to first order in the angle."""
    fine = Camera(100, 100, 1e5, 1e5, 50.0, 50.0, np.eye(4))  # pixels too small to thicken anything
    disc = slab((0.1, 0.2, 2.0, 0.7), 0.2, 0.1, 1e-4, RED)
    others = crowd(30)
    for g, angle, most in ((disc, 0.1, 1e-4), (others, 1e-4, 1e-5)):
        p, a, inverse = (
            g.means.astype(np.float64),
            planes(g, fine, steepest=1e9),
            np.linalg.inv(reference.covariances(g)),
        )
        for side in ([1, 0, 0], [0, 1, 0], [-0.6, 0.8, 0.0]):
            d = p / np.linalg.norm(p, axis=1, keepdims=True) + angle * np.asarray(side)
            d /= np.linalg.norm(d, axis=1, keepdims=True)
            densest = np.einsum("ni,nij,nj->n", d, inverse, p) / np.einsum("ni,nij,nj->n", d, inverse, d)
            np.testing.assert_allclose(1 / (d * a).sum(1), densest, rtol=most)


@pytest.mark.shared
def test_alpha_is_that_of_gsplat_and_colour_where_order_matters_little(pixel, shared):
    """gsplat sorts by camera z; how opaque a pixel becomes does not depend on the order."""
    truth = np.load(shared / "reference" / "toy_cat.npz")
    K, width, height = truth["K"], int(truth["width"]), int(truth["height"])
    camera = Camera(width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2], truth["world_to_camera"][0])
    rgb, alpha, _ = draw(pixel, read_gaussians(shared / "data" / "splats" / "toy_cat.ply"), camera)
    alpha_error, error = np.abs(alpha - truth["alpha"][0]), np.abs(rgb - truth["rgb"][0]).max(axis=-1)
    assert alpha_error.mean() <= 1e-3 and (alpha_error <= 2 / 255).mean() >= 0.999
    assert error.mean() <= 5e-3 and np.median(error) <= 1e-3
