"""The eyes' swapchains, and how the finished picture gets into them.

The bytes of the picture are as they are to be shown, so they go unchanged into a texture that is sRGB by its format:
the runtime decodes them. Rows: the picture's first is the top, OpenGL's first is the bottom.
"""

from __future__ import annotations

import contextlib

from core.errors import BadInput
from display.xr.depth_layer import Depth
from display.xr.swapchain import RGBA8, SRGB8_ALPHA8, format_of, swapchain

VERTEX = """
#version 330
void main() {  // one triangle that covers the viewport
    gl_Position = vec4(vec2((gl_VertexID << 1) & 2, gl_VertexID & 2) * 2.0 - 1.0, 0.0, 1.0);
}
"""
FRAGMENT = """
#version 330
uniform sampler2D picture;
uniform ivec2 rows;  // first row of this eye's picture, how many it has
out vec4 colour;
void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 c = texelFetch(picture, ivec2(at.x, rows.x + rows.y - 1 - at.y), 0);
    gl_FragDepth = c.a;  // where there is something to take it
    colour = vec4(c.rgb, 1.0);
}
"""
LINEAR = FRAGMENT.replace(  # for a runtime that only has linear textures: what it will encode is decoded first
    "c.rgb, 1.0)", "mix(c.rgb / 12.92, pow((c.rgb + 0.055) / 1.055, vec3(2.4)), step(0.04045, c.rgb)), 1.0)"
)


class Eyes:
    """One swapchain for each eye, all of `size` (width, height) [px], and one for its `depth` where the runtime takes
    that. A smaller picture fills a part of the textures."""

    def __init__(self, runtime, session, gl, size: tuple[int, int], views: int):
        self.xr, self.size, self._gl = runtime.xr, size, gl
        self.drawn = size  # of the last pictures
        xr = self.xr
        chosen = format_of(xr, session, (SRGB8_ALPHA8, RGBA8))
        if chosen is None:
            raise BadInput(f"--xr: {runtime.name} has neither sRGB nor plain textures of 8 bits")
        self._program = gl.program(VERTEX, FRAGMENT if chosen == SRGB8_ALPHA8 else LINEAR)
        self._triangle = gl.vertex_array(self._program, [])
        self._chains, self._targets = [], []
        for _ in range(views):
            chain = swapchain(xr, session, size, chosen)
            self._chains.append(chain)
            images = xr.enumerate_swapchain_images(chain, xr.SwapchainImageOpenGLKHR)
            textures = [gl.external_texture(image.image, size, 4, 0, "f1") for image in images]
            self._targets.append([gl.framebuffer(color_attachments=[t]) for t in textures])
        self.depth = Depth.of(runtime, session, gl, size, views)

    def draw(self, texture, size: tuple[int, int] | None = None) -> None:
        """Hand over the views of a picture, each of `size` [px] (or of the textures'), one below the other in a texture
        of the same width."""
        self.drawn = size or self.size
        xr, gl, (width, height) = self.xr, self._gl, self.drawn
        gl.disable(gl.BLEND | gl.DEPTH_TEST | gl.CULL_FACE)
        for view, (chain, targets) in enumerate(zip(self._chains, self._targets, strict=True)):
            index = xr.acquire_swapchain_image(chain, xr.SwapchainImageAcquireInfo())
            xr.wait_swapchain_image(chain, xr.SwapchainImageWaitInfo(timeout=xr.INFINITE_DURATION))
            targets[index].use()
            if self.depth is not None:
                self.depth.begin(view, targets[index])
            gl.viewport = (0, 0, width, height)
            texture.use(0)
            self._program["rows"] = (view * height, height)
            self._triangle.render(gl.TRIANGLES, vertices=3)
            if self.depth is not None:
                self.depth.end(view)
            xr.release_swapchain_image(chain, xr.SwapchainImageReleaseInfo())

    def layer(self, space, views):
        """The projection layer of what was drawn for these XrViews."""
        xr = self.xr
        shown = [xr.CompositionLayerProjectionView() for _ in self._chains]
        for k, (at, chain, view) in enumerate(zip(shown, self._chains, views, strict=True)):
            at.pose, at.fov, at.sub_image.swapchain = view.pose, view.fov, chain
            at.sub_image.image_rect.offset[:] = [0, 0]
            at.sub_image.image_rect.extent[:] = list(self.drawn)
            if self.depth is not None:
                at.next = self.depth.chained(k, at.sub_image.image_rect)
        return xr.CompositionLayerProjection(space=space, views=shown)

    def close(self) -> None:
        """Give the textures back."""
        if self.depth is not None:
            self.depth.close()
            self.depth = None
        for targets in self._targets:
            for target in targets:
                target.release()
        for chain in self._chains:
            with contextlib.suppress(self.xr.exception.ResultException):  # it may have gone with its session
                self.xr.destroy_swapchain(chain)
        self._chains, self._targets = [], []
