"""The picture on its way from Taichi to OpenGL: on the device where both are on the GPU, else through the host."""

import numpy as np
import pytest

from core.errors import BadInput
from display.window import gl_context as module
from display.window.gl_context import Copy2D, NoInterop, PictureTexture


class Texture:
    """Stand-in for a moderngl texture."""

    def __init__(self, size, components):
        self.size, self.written, self.released = size, [], False

    def write(self, pixels):
        self.written.append(np.array(pixels))

    def release(self):
        self.released = True


class Gl:
    """As much of a context as PictureTexture asks for."""

    def program(self, **_):
        return {}

    def vertex_array(self, *_):
        return None

    def texture(self, size, components):
        return Texture(size, components)


def picture(ti, height: int, width: int):
    values = np.random.default_rng(height).integers(0, 2**32, (height, width), dtype=np.uint32)
    made = ti.ndarray(ti.u32, (height, width))
    made.from_numpy(values)
    return made, values


def test_on_the_cpu_it_passes_through_the_host(ti_cpu):
    if ti_cpu.cfg.arch == ti_cpu.cuda:
        pytest.skip("of the CPU")
    texture = PictureTexture(Gl())
    for height, width in ((6, 4), (6, 4), (8, 2)):
        given, values = picture(ti_cpu, height, width)
        before = texture.texture
        texture.upload(given)
        assert texture.size == (width, height) and texture.through_host
        np.testing.assert_array_equal(texture.texture.written[-1].view(np.uint32)[..., 0], values)
        kept = before is not None and before.size == (width, height)
        assert texture.texture is before if kept else (before is None or before.released)


def test_where_opengl_is_elsewhere_it_is_said_once_and_passes_through_the_host(ti_cpu, monkeypatch, capsys):
    def refused(texture):
        raise NoInterop("cuGraphicsGLRegisterImage says 219")

    monkeypatch.setattr(module, "CudaTexture", refused)
    texture = PictureTexture(Gl())
    texture.through_host = False  # as on CUDA
    given, values = picture(ti_cpu, 4, 4)
    for _ in range(2):
        texture.upload(given)
        np.testing.assert_array_equal(texture.texture.written[-1].view(np.uint32)[..., 0], values)
    assert len(texture.texture.written) == 2
    assert capsys.readouterr().err.count("through the host") == 1


def test_the_copy_is_laid_out_as_the_driver_wants_it():
    """CUDA_MEMCPY2D of cuda.h on 64-bit machines."""
    assert [getattr(Copy2D, n).offset for n in ("srcXInBytes", "srcDevice", "srcPitch", "dstXInBytes", "dstArray")] == [
        0, 32, 48, 56, 96,
    ]  # fmt: skip
    assert (Copy2D.WidthInBytes.offset, Copy2D.Height.offset) == (112, 120)


def test_on_cuda_the_texture_has_the_picture_without_the_host(ti_cpu):
    if ti_cpu.cfg.arch != ti_cpu.cuda:
        pytest.skip("needs CUDA, and OpenGL through EGL on the same GPU")
    from display.window.gl_context import EglContext

    try:
        egl = EglContext()
    except BadInput as e:
        pytest.skip(f"no OpenGL: {e}")
    texture = PictureTexture(egl.gl)
    for height, width in ((480, 640), (480, 640), (200, 300)):
        given, values = picture(ti_cpu, height, width)
        texture.upload(given)
        assert texture.through_host is False
        np.testing.assert_array_equal(np.frombuffer(texture.texture.read(), np.uint32).reshape(height, width), values)
    texture.release()
    egl.close()
