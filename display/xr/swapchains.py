"""Swapchains and the composition layers made of them: both eyes' pictures with their depth, and a quad.

The bytes of a picture are as they are to be shown, so they go unchanged into a texture that is sRGB by its format: the
runtime decodes them. A runtime without sRGB textures gets them decoded. Rows: the picture's first is the top, OpenGL's
first is the bottom.

Depth (XR_KHR_composition_layer_depth) lets a runtime shift late pictures to where the head is by now: a depth texture
for each eye beside its picture, drawn in the same pass (gl_FragDepth). 0 is at render.renderer.DEPTH_NEAR, 1 at
DEPTH_FAR, between them as in OpenGL's depth buffer; nearer is less.
"""

from __future__ import annotations

import contextlib
import ctypes

import numpy as np

from core.errors import BadInput
from display.xr.poses import position_rotation
from render.renderer import DEPTH_FAR, DEPTH_NEAR

DEPTH_EXTENSION = "XR_KHR_composition_layer_depth"
SRGB8_ALPHA8, RGBA8 = 0x8C43, 0x8058  # OpenGL's names of formats, best first
DEPTH_FORMATS = (0x8CAC, 0x81A6, 0x81A5)  # DEPTH_COMPONENT32F, 24, 16; without an unused stencil
FRAMEBUFFER, DEPTH_ATTACHMENT, TEXTURE_2D = 0x8D40, 0x8D00, 0x0DE1
ALWAYS = "1"  # of moderngl's depth_func: nothing was there before
VERTEX = """
#version 330
void main() {  // one triangle that covers the viewport
    gl_Position = vec4(vec2((gl_VertexID << 1) & 2, gl_VertexID & 2) * 2.0 - 1.0, 0.0, 1.0);
}
"""
FRAGMENT = """
#version 330
uniform sampler2D picture;
uniform ivec2 rows;  // first row of this view, how many it has
uniform bool opaque;  // alpha holds depth
uniform bool decode;  // the texture is linear
out vec4 colour;
void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 c = texelFetch(picture, ivec2(at.x, rows.x + rows.y - 1 - at.y), 0);
    gl_FragDepth = c.a;  // where there is something to take it
    vec3 linear = mix(c.rgb / 12.92, pow((c.rgb + 0.055) / 1.055, vec3(2.4)), step(0.04045, c.rgb));
    colour = vec4(decode ? linear : c.rgb, opaque ? 1.0 : c.a);
}
"""


def create_swapchain(xr, session, size: tuple[int, int], texture_format: int, *, depth: bool = False):
    """Create a swapchain of 2-D textures of `size` (width, height) [px], for colour or for depth."""
    flags = xr.SwapchainUsageFlags
    attachment = flags.DEPTH_STENCIL_ATTACHMENT_BIT if depth else flags.COLOR_ATTACHMENT_BIT
    info = xr.SwapchainCreateInfo(
        usage_flags=attachment | flags.SAMPLED_BIT,
        format=texture_format,
        sample_count=1,
        width=size[0],
        height=size[1],
        face_count=1,
        array_size=1,
        mip_count=1,
    )
    return xr.create_swapchain(session, info)


def supported_format(xr, session, wanted: tuple[int, ...]) -> int | None:
    """The first of the `wanted` formats that the runtime has."""
    offered = list(xr.enumerate_swapchain_formats(session))
    return next((f for f in wanted if f in offered), None)


def image_names(xr, swapchain) -> list[int]:
    """OpenGL's texture names of a swapchain's images."""
    return [image.image for image in xr.enumerate_swapchain_images(swapchain, xr.SwapchainImageOpenGLKHR)]


@contextlib.contextmanager
def acquired_image(xr, swapchain):
    """Acquire a swapchain's next image and wait for it; release it at the end. Yields its index."""
    index = xr.acquire_swapchain_image(swapchain, xr.SwapchainImageAcquireInfo())
    xr.wait_swapchain_image(swapchain, xr.SwapchainImageWaitInfo(timeout=xr.INFINITE_DURATION))
    yield index
    xr.release_swapchain_image(swapchain, xr.SwapchainImageReleaseInfo())


class ColourSwapchain:
    """A swapchain of 8-bit colour textures of `size` (width, height) [px], as framebuffers to draw into.

    Raises BadInput where the runtime has no such format.
    """

    def __init__(self, runtime, session, gl, size: tuple[int, int], *, opaque: bool):
        self.xr, self.size, self._gl = runtime.xr, size, gl
        chosen = supported_format(self.xr, session, (SRGB8_ALPHA8, RGBA8))
        if chosen is None:
            raise BadInput(f"--xr: {runtime.name} has neither sRGB nor plain textures of 8 bits")
        self._program = gl.program(VERTEX, FRAGMENT)
        self._program["opaque"], self._program["decode"] = opaque, chosen != SRGB8_ALPHA8
        self._triangle = gl.vertex_array(self._program, [])
        self.handle = create_swapchain(self.xr, session, size, chosen)
        textures = [gl.external_texture(name, size, 4, 0, "f1") for name in image_names(self.xr, self.handle)]
        self._targets = [gl.framebuffer(color_attachments=[t]) for t in textures]

    def draw(self, texture, *, first_row: int, size: tuple[int, int], depth: DepthSwapchain | None = None) -> None:
        """Draw `size` (width, height) [px] of a texture, from a row on, into the lower left of the next image."""
        gl = self._gl
        gl.disable(gl.BLEND | gl.DEPTH_TEST | gl.CULL_FACE)
        with acquired_image(self.xr, self.handle) as index:
            self._targets[index].use()
            with depth.attached(self._targets[index]) if depth is not None else contextlib.nullcontext():
                gl.viewport = (0, 0, *size)
                texture.use(0)
                self._program["rows"] = (first_row, size[1])
                self._triangle.render(gl.TRIANGLES, vertices=3)

    def close(self) -> None:
        """Give the textures back. Further calls do nothing."""
        if self.handle is None:
            return
        for resource in (*self._targets, self._triangle, self._program):
            resource.release()
        handle, self.handle = self.handle, None
        with contextlib.suppress(self.xr.exception.ResultException):  # it may have gone with its session
            self.xr.destroy_swapchain(handle)


class DepthSwapchain:
    """A swapchain of depth textures of `size` (width, height) [px] for one eye."""

    def __init__(self, xr, session, gl, texture_format: int, size: tuple[int, int]):
        self.xr, self._gl = xr, gl
        kind = ctypes.CFUNCTYPE(None, ctypes.c_uint, ctypes.c_uint, ctypes.c_uint, ctypes.c_uint, ctypes.c_int)
        self._attach = kind(gl.extra("glFramebufferTexture2D"))  # moderngl attaches no foreign depth texture
        self.handle = create_swapchain(xr, session, size, texture_format, depth=True)
        self._textures = image_names(xr, self.handle)
        self._info = xr.CompositionLayerDepthInfoKHR(min_depth=0.0, max_depth=1.0, near_z=DEPTH_NEAR, far_z=DEPTH_FAR)
        self._info.sub_image.swapchain = self.handle

    @contextlib.contextmanager
    def attached(self, target):
        """Let what is drawn into `target`, the framebuffer in use, leave its depth in the next image."""
        gl = self._gl
        with acquired_image(self.xr, self.handle) as index:
            self._attach(FRAMEBUFFER, DEPTH_ATTACHMENT, TEXTURE_2D, self._textures[index], 0)
            target.depth_mask = True
            gl.enable(gl.DEPTH_TEST)
            gl.depth_func = ALWAYS
            yield
            gl.disable(gl.DEPTH_TEST)
            self._attach(FRAMEBUFFER, DEPTH_ATTACHMENT, TEXTURE_2D, 0, 0)

    def chained(self, rectangle) -> ctypes.c_void_p:
        """The `next` of a view of the projection layer: the depth of the same rectangle of the texture."""
        self._info.sub_image.image_rect = rectangle
        return ctypes.cast(ctypes.pointer(self._info), ctypes.c_void_p)

    def close(self) -> None:
        """Give the textures back. Further calls do nothing."""
        handle, self.handle = self.handle, None
        if handle is not None:
            with contextlib.suppress(self.xr.exception.ResultException):  # it may have gone with its session
                self.xr.destroy_swapchain(handle)


class EyeSwapchains:
    """A colour swapchain of `size` (width, height) [px] for each eye, and a depth one where the runtime takes depth.

    A smaller picture fills a part of the textures.
    """

    def __init__(self, runtime, session, gl, size: tuple[int, int], views: int):
        self.xr, self.size = runtime.xr, size
        self._drawn = size  # of the last pictures
        self._colour = [ColourSwapchain(runtime, session, gl, size, opaque=True) for _ in range(views)]
        chosen = None
        if DEPTH_EXTENSION in runtime.enabled:
            chosen = supported_format(self.xr, session, DEPTH_FORMATS)
        self.has_depth = chosen is not None
        self._depth: list[DepthSwapchain | None] = [None] * views
        if self.has_depth:
            self._depth = [DepthSwapchain(self.xr, session, gl, chosen, size) for _ in range(views)]

    def draw(self, texture, size: tuple[int, int]) -> None:
        """Hand over the views of a picture, each of `size` [px], one below the other in a texture of that width."""
        self._drawn = size
        for view, (colour, depth) in enumerate(zip(self._colour, self._depth, strict=True)):
            colour.draw(texture, first_row=view * size[1], size=size, depth=depth)

    def layer(self, space, views):
        """The projection layer of what was drawn for these XrViews."""
        xr = self.xr
        shown = [xr.CompositionLayerProjectionView() for _ in self._colour]
        for at, colour, depth, view in zip(shown, self._colour, self._depth, views, strict=True):
            at.pose, at.fov = view.pose, view.fov
            set_sub_image(at.sub_image, colour.handle, self._drawn)
            if depth is not None:
                at.next = depth.chained(at.sub_image.image_rect)
        return xr.CompositionLayerProjection(space=space, views=shown)

    def close(self) -> None:
        """Give the textures back. Further calls do nothing."""
        for swapchain in (*self._depth, *self._colour):
            if swapchain is not None:
                swapchain.close()


class QuadLayer:
    """A picture of `size` (width, height) [px] on a rectangle in space, `width` [m] wide.

    The runtime lays it into the world itself, as sharp as the headset can.
    """

    def __init__(self, runtime, session, gl, size: tuple[int, int], width: float):
        self.xr, self.size, self.width = runtime.xr, size, width
        self._swapchain = ColourSwapchain(runtime, session, gl, size, opaque=False)
        self._texture = gl.texture(size, 4)

    def draw(self, pixels: np.ndarray) -> None:
        """Show a picture (H, W, 4) uint8, colours times alpha, row 0 on top."""
        self._texture.write(pixels)
        self._swapchain.draw(self._texture, first_row=0, size=self.size)

    def layer(self, space, pose: np.ndarray):
        """The quad layer of the last picture, centred at `pose` (4, 4) in `space`, facing its +z."""
        xr = self.xr
        quad = xr.CompositionLayerQuad(
            layer_flags=xr.CompositionLayerFlags.BLEND_TEXTURE_SOURCE_ALPHA_BIT,
            space=space,
            eye_visibility=xr.EyeVisibility.BOTH,
        )
        set_sub_image(quad.sub_image, self._swapchain.handle, self.size)
        position, (w, x, y, z) = position_rotation(pose)
        quad.pose.position[:] = list(position)
        quad.pose.orientation[:] = [x, y, z, w]
        quad.size.width, quad.size.height = self.width, self.width * self.size[1] / self.size[0]
        return quad

    def close(self) -> None:
        """Give the textures back."""
        self._texture.release()
        self._swapchain.close()


def set_sub_image(sub_image, swapchain, size: tuple[int, int]) -> None:
    """Let an XrSwapchainSubImage be the lower left `size` (width, height) [px] of a swapchain."""
    sub_image.swapchain = swapchain
    sub_image.image_rect.offset[:] = [0, 0]
    sub_image.image_rect.extent[:] = list(size)
