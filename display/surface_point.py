"""Points of the surface that a picture shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from core.camera import Camera

SIDE = 16  # [px] of the part of the picture that is drawn for its depth: a tile
OPAQUE = 0.5  # of a pixel; fainter ones show no surface


def surface_point(splats, camera: Camera, u: float, v: float) -> np.ndarray | None:
    """The point (3,) [m] of splats (render/splats.py) that is seen at a pixel; None: nothing opaque is there."""
    from render.renderer import Renderer

    if not (0 <= u < camera.width and 0 <= v < camera.height):
        return None
    left, top = int(u) - SIDE // 2, int(v) - SIDE // 2
    near = replace(camera, width=SIDE, height=SIDE, cx=camera.cx - left, cy=camera.cy - top)
    renderer = Renderer(splats, SIDE, SIDE, outputs="float", sort="z")
    renderer.render([near])
    depth, alpha = (field.to_numpy()[0, SIDE // 2, SIDE // 2] for field in (renderer.depth, renderer.alpha))
    renderer.destroy()
    if alpha < OPAQUE:
        return None
    origin, direction = camera.ray(u, v)
    return origin + direction * float(depth / alpha) / float(direction @ camera.world_to_camera[2, :3])
