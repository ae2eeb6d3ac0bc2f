"""The panel as a layer of its own: a quad that the runtime lays into the world, as sharp as the headset can."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from time import monotonic

import numpy as np

from display.xr.eye_swapchains import VERTEX
from display.xr.panel_paint import Content, paint, prepare
from display.xr.poses import position_rotation
from display.xr.swapchain import RGBA8, SRGB8_ALPHA8, format_of, swapchain
from display.xr.wrist_panel import PIXELS, WIDTH

REFRESH = 0.5  # [s] between two readings of the rate
FRAGMENT = """
#version 330
uniform sampler2D picture;
out vec4 colour;
void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 c = texelFetch(picture, ivec2(at.x, textureSize(picture, 0).y - 1 - at.y), 0);
    colour = c;
}
"""
DECODED = FRAGMENT.replace(  # for a runtime that only has linear textures; see display/xr/eye_swapchains.py
    "colour = c;",
    "vec3 s = c.rgb;\n    colour = vec4(mix(s / 12.92, pow((s + 0.055) / 1.055, vec3(2.4)), step(0.04045, s)), c.a);",
)


class PanelLayer:
    """A swapchain of the panel's size; a picture goes into it when what it shows has changed."""

    def __init__(self, runtime, session, gl):
        self.xr, self._gl = runtime.xr, gl
        xr = self.xr
        chosen = format_of(xr, session, (SRGB8_ALPHA8,)) or RGBA8
        self._program = gl.program(VERTEX, FRAGMENT if chosen == SRGB8_ALPHA8 else DECODED)
        self._triangle = gl.vertex_array(self._program, [])
        self._texture = gl.texture(PIXELS, 4)
        self._chain = swapchain(xr, session, PIXELS, chosen)
        images = xr.enumerate_swapchain_images(self._chain, xr.SwapchainImageOpenGLKHR)
        self._targets = [
            gl.framebuffer(color_attachments=[gl.external_texture(image.image, PIXELS, 4, 0, "f1")]) for image in images
        ]
        self._shown: Content | None = None
        self._read = 0.0  # [s] when its rate was read
        prepare()

    def show(self, content: Content) -> None:
        """Let the panel look like this; its rate is read less often than it changes."""
        now = monotonic()
        if self._shown is not None and now - self._read < REFRESH:
            content = replace(content, rate=self._shown.rate)
        else:
            self._read = now
        if content == self._shown:
            return
        xr, gl = self.xr, self._gl
        self._texture.write(paint(content))
        index = xr.acquire_swapchain_image(self._chain, xr.SwapchainImageAcquireInfo())
        xr.wait_swapchain_image(self._chain, xr.SwapchainImageWaitInfo(timeout=xr.INFINITE_DURATION))
        gl.disable(gl.BLEND | gl.DEPTH_TEST | gl.CULL_FACE)
        self._targets[index].use()
        gl.viewport = (0, 0, *PIXELS)
        self._texture.use(0)
        self._triangle.render(gl.TRIANGLES, vertices=3)
        xr.release_swapchain_image(self._chain, xr.SwapchainImageReleaseInfo())
        self._shown = content

    def layer(self, space, pose: np.ndarray):
        """The quad that stands at `pose` (4, 4) in `space`."""
        xr = self.xr
        quad = xr.CompositionLayerQuad(
            layer_flags=xr.CompositionLayerFlags.BLEND_TEXTURE_SOURCE_ALPHA_BIT,
            space=space,
            eye_visibility=xr.EyeVisibility.BOTH,
        )
        quad.sub_image.swapchain = self._chain
        quad.sub_image.image_rect.offset[:] = [0, 0]
        quad.sub_image.image_rect.extent[:] = list(PIXELS)
        position, (w, x, y, z) = position_rotation(pose)
        quad.pose.position[:] = list(position)
        quad.pose.orientation[:] = [x, y, z, w]
        quad.size.width, quad.size.height = WIDTH, WIDTH * PIXELS[1] / PIXELS[0]
        return quad

    def close(self) -> None:
        """Give the textures back."""
        for thing in (*self._targets, self._texture, self._triangle, self._program):
            thing.release()
        self._targets = []
        with contextlib.suppress(self.xr.exception.ResultException):  # it may have gone with its session
            self.xr.destroy_swapchain(self._chain)
