"""The depth that goes with a headset's picture: out of the renderer, and into the runtime's textures."""

from types import SimpleNamespace as N

import numpy as np
import pytest

from assets.gaussians import Gaussians
from core.camera import look_at, perspective
from core.errors import BadInput
from render.renderer import DEPTH_FAR, DEPTH_NEAR, MIN_SURFACE_ALPHA
from tests.support.fake_xr import DEPTH, FakeXr
from tests.support.reference_render import render_stereo

WIDTH, HEIGHT = 24, 16


def depth_of(z):
    """Value of a depth buffer for a distance z [m] along the view."""
    return np.clip(DEPTH_FAR / (DEPTH_FAR - DEPTH_NEAR) * (1 - DEPTH_NEAR / np.maximum(z, 1e-9)), 0, 1)


def wall(rng, count=400):
    """Opaque Gaussians at 0.1 to 5 m before a camera at the origin that looks along -z; nothing on the right."""
    z = rng.uniform(0.1, 5.0, count)
    means = np.stack([-z * rng.uniform(0.0, 0.6, count), z * rng.uniform(-0.4, 0.4, count), -z], 1)
    quats = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    return Gaussians.of(
        means, quats, np.log(0.06 * z)[:, None].repeat(3, 1), np.full(count, 3.0), np.zeros((count, 1, 3))
    )


def test_the_alpha_byte_is_the_depth_of_what_is_seen(ti_cpu):
    from render.renderer import Renderer
    from render.splats import Splats

    gaussians = wall(np.random.default_rng(1))
    cameras = [perspective(WIDTH, HEIGHT, 0.9, look_at((x, 0, 0), (x, 0, -1))) for x in (0.0, 0.05)]
    deep = Renderer(Splats(gaussians), WIDTH, HEIGHT, views=2, outputs="deep", background=(0.2, 0.4, 0.6))
    deep.render(cameras)
    rgb, alpha, z, doubts = render_stereo(gaussians, cameras, least=0.0)
    solid = alpha >= MIN_SURFACE_ALPHA
    assert 0.3 < solid.mean() < 0.8 and (z[solid] < DEPTH_NEAR).any() and (z[solid] > 3).any()
    pixels = deep.pixels().astype(np.float64)
    colours = 255 * np.clip(rgb + (1 - alpha[..., None]) * [0.2, 0.4, 0.6], 0, 1)
    assert np.abs(pixels[..., :3] - colours)[~doubts].max() <= 0.5 + 0.05  # rounded to a byte; float32
    doubts |= np.abs(alpha - MIN_SURFACE_ALPHA) < 1e-3
    expected = np.where(solid, 255 * depth_of(z), 255)
    assert doubts.mean() < 0.2 and np.abs(pixels[..., 3] - expected)[~doubts].max() <= 0.5 + 0.05
    deep.resize(10, 10)
    deep.render([perspective(10, 10, 0.9, look_at((0, 0, 0), (0, 0, -1)))] * 2)
    assert np.ptp(deep.pixels()[..., 3]) > 100


@pytest.fixture(scope="module")
def gl():
    """OpenGL without a window."""
    from display.window.gl_context import EglContext

    try:
        context = EglContext()
    except BadInput as e:
        pytest.skip(f"no OpenGL without a window: {e}")
    yield context.gl
    context.close()


@pytest.fixture
def eyes(gl):
    """(eyes of 40 x 30 px, the textures of the runtime: [colour of an eye's images, depth, ...])."""
    from display.xr.swapchains import EyeSwapchains

    textures = []

    def image(width, height, kind):
        texture = gl.depth_texture((width, height)) if kind == 0x8CAC else gl.texture((width, height), 4)
        textures.append(texture)
        return texture.glo

    xr = FakeXr(images=image)
    runtime, session = N(name="FakeXr", xr=xr, enabled=[DEPTH]), xr.create_session(xr.create_instance(None), None)
    made = EyeSwapchains(runtime, session, gl, (40, 30), 2)
    yield made, textures, xr
    made.close()
    assert not xr.alive & set(xr.swapchains)


@pytest.mark.parametrize("size", [(40, 30), (24, 16)])
def test_colour_and_depth_of_both_eyes_are_in_the_same_part_of_their_textures(gl, eyes, size):
    made, textures, xr = eyes
    width, height = size
    for turn in range(4):  # more than there are images
        picture = np.random.default_rng(turn).integers(0, 256, (2 * height, width, 4), np.uint8)
        made.draw(gl.texture((width, 2 * height), 4, picture.tobytes()), size)
        for view, (colour, deep) in enumerate(zip(textures[::6], textures[3::6], strict=True)):
            at = textures.index(colour) + turn % 3
            shown = np.frombuffer(textures[at].read(), np.uint8).reshape(30, 40, 4)[:height, :width][::-1]
            wanted = picture[view * height : (view + 1) * height]
            np.testing.assert_array_equal(shown[..., :3], wanted[..., :3])
            at = textures.index(deep) + turn % 3
            depth = np.frombuffer(textures[at].read(), np.float32).reshape(30, 40)[:height, :width][::-1]
            np.testing.assert_allclose(depth, wanted[..., 3] / 255, atol=1e-6)
    views = [xr.View(), xr.View()]
    layer = made.layer(xr.create_reference_space(None, None), views)
    seen = [xr.view_of(layer.views[k]) for k in (0, 1)]
    assert [s["rectangle"] for s in seen] == [s["depth"] for s in seen] == [(0, 0, width, height)] * 2
    assert not gl.error or gl.error == "GL_NO_ERROR"
