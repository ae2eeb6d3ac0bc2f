"""Swapchains, and the composition layer made of them: both eyes' pictures with their depth.

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

from core.errors import BadInput
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


class Swapchain:
    """An XrSwapchain of 2-D textures of `size` (width, height) [px], for colour or for depth.

    handle    None once it is closed
    textures  OpenGL's names of its images
    """

    def __init__(self, xr, session, size: tuple[int, int], texture_format: int, *, depth: bool = False):
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
        self.xr, self.handle = xr, xr.create_swapchain(session, info)
        images = xr.enumerate_swapchain_images(self.handle, xr.SwapchainImageOpenGLKHR)
        self.textures = [image.image for image in images]

    @contextlib.contextmanager
    def acquired(self):
        """Acquire the next image and wait for it; release it at the end. Yields its index."""
        xr = self.xr
        index = xr.acquire_swapchain_image(self.handle, xr.SwapchainImageAcquireInfo())
        xr.wait_swapchain_image(self.handle, xr.SwapchainImageWaitInfo(timeout=xr.INFINITE_DURATION))
        yield index
        xr.release_swapchain_image(self.handle, xr.SwapchainImageReleaseInfo())

    def close(self) -> None:
        """Give the textures back. Further calls do nothing."""
        handle, self.handle = self.handle, None
        if handle is not None:
            with contextlib.suppress(self.xr.exception.ResultException):  # it may have gone with its session
                self.xr.destroy_swapchain(handle)


def supported_format(xr, session, wanted: tuple[int, ...]) -> int | None:
    """The first of the `wanted` formats that the runtime has."""
    offered = list(xr.enumerate_swapchain_formats(session))
    return next((f for f in wanted if f in offered), None)


class ColourTarget:
    """A swapchain of 8-bit colour textures of `size` (width, height) [px], as framebuffers to draw into, and of depth
    textures where there is a `depth_format`.

    Raises BadInput where the runtime has no such format.
    """

    def __init__(self, runtime, session, gl, size: tuple[int, int], *, opaque: bool, depth_format: int | None = None):
        self._gl, xr = gl, runtime.xr
        chosen = supported_format(xr, session, (SRGB8_ALPHA8, RGBA8))
        if chosen is None:
            raise BadInput(f"--xr: {runtime.name} has neither sRGB nor plain textures of 8 bits")
        self._program = gl.program(VERTEX, FRAGMENT)
        self._program["opaque"], self._program["decode"] = opaque, chosen != SRGB8_ALPHA8
        self._triangle = gl.vertex_array(self._program, [])
        self.swapchain = Swapchain(xr, session, size, chosen)
        textures = [gl.external_texture(name, size, 4, 0, "f1") for name in self.swapchain.textures]
        self._framebuffers = [gl.framebuffer(color_attachments=[t]) for t in textures]
        self.depth = None if depth_format is None else DepthTarget(xr, session, gl, depth_format, size)

    def draw(self, texture, *, first_row: int, size: tuple[int, int]) -> None:
        """Draw `size` (width, height) [px] of a texture, from a row on, into the lower left of the next image."""
        gl = self._gl
        gl.disable(gl.BLEND | gl.DEPTH_TEST | gl.CULL_FACE)
        with self.swapchain.acquired() as index:
            framebuffer = self._framebuffers[index]
            framebuffer.use()
            with self.depth.attached(framebuffer) if self.depth is not None else contextlib.nullcontext():
                gl.viewport = (0, 0, *size)
                texture.use(0)
                self._program["rows"] = (first_row, size[1])
                self._triangle.render(gl.TRIANGLES, vertices=3)

    def close(self) -> None:
        """Give the textures back. Further calls do nothing."""
        if self.swapchain.handle is not None:
            for resource in (*self._framebuffers, self._triangle, self._program):
                resource.release()
            self.swapchain.close()
            if self.depth is not None:
                self.depth.swapchain.close()


class DepthTarget:
    """A swapchain of depth textures of `size` (width, height) [px] for one eye."""

    def __init__(self, xr, session, gl, texture_format: int, size: tuple[int, int]):
        self._gl = gl
        kind = ctypes.CFUNCTYPE(None, ctypes.c_uint, ctypes.c_uint, ctypes.c_uint, ctypes.c_uint, ctypes.c_int)
        self._attach = kind(gl.extra("glFramebufferTexture2D"))  # moderngl attaches no foreign depth texture
        self.swapchain = Swapchain(xr, session, size, texture_format, depth=True)
        self._info = xr.CompositionLayerDepthInfoKHR(min_depth=0.0, max_depth=1.0, near_z=DEPTH_NEAR, far_z=DEPTH_FAR)
        self._info.sub_image.swapchain = self.swapchain.handle

    @contextlib.contextmanager
    def attached(self, framebuffer):
        """Let what is drawn into a framebuffer, the one in use, leave its depth in the next image."""
        gl = self._gl
        with self.swapchain.acquired() as index:
            self._attach(FRAMEBUFFER, DEPTH_ATTACHMENT, TEXTURE_2D, self.swapchain.textures[index], 0)
            framebuffer.depth_mask = True
            gl.enable(gl.DEPTH_TEST)
            gl.depth_func = ALWAYS
            yield
            gl.disable(gl.DEPTH_TEST)
            self._attach(FRAMEBUFFER, DEPTH_ATTACHMENT, TEXTURE_2D, 0, 0)

    def chained(self, rectangle) -> ctypes.c_void_p:
        """The `next` of a view of the projection layer: the depth of the same rectangle of the texture."""
        self._info.sub_image.image_rect = rectangle
        return ctypes.cast(ctypes.pointer(self._info), ctypes.c_void_p)


class EyeSwapchains:
    """A colour swapchain of `size` (width, height) [px] for each eye, and a depth one where the runtime takes depth.

    A smaller picture fills a part of the textures.
    """

    def __init__(self, runtime, session, gl, size: tuple[int, int], views: int):
        self.xr, self._drawn = runtime.xr, size  # of the last pictures
        takes_depth = DEPTH_EXTENSION in runtime.enabled
        chosen = supported_format(self.xr, session, DEPTH_FORMATS) if takes_depth else None
        self.has_depth = chosen is not None
        self._eyes = [ColourTarget(runtime, session, gl, size, opaque=True, depth_format=chosen) for _ in range(views)]

    def draw(self, texture, size: tuple[int, int]) -> None:
        """Hand over the views of a picture, each of `size` [px], one below the other in a texture of that width."""
        self._drawn = size
        for view, eye in enumerate(self._eyes):
            eye.draw(texture, first_row=view * size[1], size=size)

    def layer(self, space, views):
        """The projection layer of what was drawn for these XrViews."""
        xr = self.xr
        shown = [xr.CompositionLayerProjectionView() for _ in self._eyes]
        for at, eye, view in zip(shown, self._eyes, views, strict=True):
            at.pose, at.fov = view.pose, view.fov
            set_sub_image(at.sub_image, eye.swapchain, self._drawn)
            if eye.depth is not None:
                at.next = eye.depth.chained(at.sub_image.image_rect)
        return xr.CompositionLayerProjection(space=space, views=shown)

    def close(self) -> None:
        """Give the textures back. Further calls do nothing."""
        for eye in self._eyes:
            eye.close()


def set_sub_image(sub_image, swapchain: Swapchain, size: tuple[int, int]) -> None:
    """Let an XrSwapchainSubImage be the lower left `size` (width, height) [px] of a swapchain."""
    sub_image.swapchain = swapchain.handle
    sub_image.image_rect.offset[:] = [0, 0]
    sub_image.image_rect.extent[:] = list(size)
