"""How far away is what each pixel shows: for a runtime that shifts late pictures to where the head is by now.

XR_KHR_composition_layer_depth: a depth texture for each eye beside its picture, drawn in the same pass (gl_FragDepth);
0 is at render.renderer.NEAR, 1 at FAR, between them as in OpenGL's depth buffer; nearer is less.
"""

from __future__ import annotations

import contextlib
import ctypes

from display.xr.swapchain import format_of, swapchain
from render.renderer import FAR, NEAR

EXTENSION = "XR_KHR_composition_layer_depth"
FORMATS = (0x8CAC, 0x81A6, 0x81A5)  # OpenGL's DEPTH_COMPONENT32F, 24, 16; without a stencil, which nobody draws
FRAMEBUFFER, DEPTH_ATTACHMENT, TEXTURE_2D = 0x8D40, 0x8D00, 0x0DE1
ALWAYS = "1"  # of moderngl's depth_func: nothing was there before


class Depth:
    """A depth swapchain for each eye, all of `size` (width, height) [px]."""

    @classmethod
    def of(cls, runtime, session, gl, size: tuple[int, int], views: int) -> Depth | None:
        """None where the runtime does not take depth."""
        if EXTENSION not in runtime.enabled:
            return None
        chosen = format_of(runtime.xr, session, FORMATS)
        return None if chosen is None else cls(runtime.xr, session, gl, chosen, size, views)

    def __init__(self, xr, session, gl, chosen: int, size: tuple[int, int], views: int):
        self.xr, self._gl = xr, gl
        address = gl.extra("glFramebufferTexture2D")  # moderngl attaches no depth texture that is not its own
        kind = ctypes.CFUNCTYPE(None, ctypes.c_uint, ctypes.c_uint, ctypes.c_uint, ctypes.c_uint, ctypes.c_int)
        self._attach = kind(address)
        self._chains, self._textures, self._infos = [], [], []
        for _ in range(views):
            chain = swapchain(xr, session, size, chosen, depth=True)
            self._chains.append(chain)
            images = xr.enumerate_swapchain_images(chain, xr.SwapchainImageOpenGLKHR)
            self._textures.append([image.image for image in images])
            info = xr.CompositionLayerDepthInfoKHR(min_depth=0.0, max_depth=1.0, near_z=NEAR, far_z=FAR)
            info.sub_image.swapchain = chain
            self._infos.append(info)

    def begin(self, view: int, target) -> None:
        """Let what is drawn into `target`, the framebuffer in use, leave its depth."""
        xr, chain, gl = self.xr, self._chains[view], self._gl
        index = xr.acquire_swapchain_image(chain, xr.SwapchainImageAcquireInfo())
        xr.wait_swapchain_image(chain, xr.SwapchainImageWaitInfo(timeout=xr.INFINITE_DURATION))
        self._attach(FRAMEBUFFER, DEPTH_ATTACHMENT, TEXTURE_2D, self._textures[view][index], 0)
        target.depth_mask = True
        gl.enable(gl.DEPTH_TEST)
        gl.depth_func = ALWAYS

    def end(self, view: int) -> None:
        """It is drawn."""
        self._gl.disable(self._gl.DEPTH_TEST)
        self._attach(FRAMEBUFFER, DEPTH_ATTACHMENT, TEXTURE_2D, 0, 0)
        self.xr.release_swapchain_image(self._chains[view], self.xr.SwapchainImageReleaseInfo())

    def chained(self, view: int, rectangle):
        """What goes behind a view of the projection layer: the depth of the same part of the texture."""
        info = self._infos[view]
        info.sub_image.image_rect = rectangle
        return ctypes.cast(ctypes.pointer(info), ctypes.c_void_p)

    def close(self) -> None:
        """Give the textures back."""
        for chain in self._chains:
            with contextlib.suppress(self.xr.exception.ResultException):  # it may have gone with its session
                self.xr.destroy_swapchain(chain)
        self._chains = []
