"""The clearest of several views of a static scene: floaters before the eye hide what is behind them, as fog does."""

from __future__ import annotations

import numpy as np

from assets.gaussians import Gaussians
from core.camera import look_at, perspective

WIDTH, HEIGHT, FOV_Y = 96, 54, 0.9  # [px], [rad] of the pictures that are compared
NEAR = 0.4  # of the way to the target: what is nearer hides it
SOLID = 0.8  # opacity of a pixel that shows something
CLEAR = 0.7  # of a picture's pixels; below, a view is poor


def clearest(gaussians: Gaussians, eyes: list[np.ndarray], target: np.ndarray) -> tuple[np.ndarray, float]:
    """The eye (3,) [m] with the clearest view of a target, the first of equal ones, and how clear that is.

    Clear is the part of the picture that shows something solid, and nothing much nearer than the target. Taichi must be
    running.
    """
    from render.renderer import Renderer
    from render.splats import Splats

    splats = Splats(gaussians)
    renderer = Renderer(splats, WIDTH, HEIGHT, outputs="float", sort="radial")
    shares = []
    for eye in eyes:
        renderer.render([perspective(WIDTH, HEIGHT, FOV_Y, look_at(eye, target))])
        alpha, depth = renderer.alpha.to_numpy()[0], renderer.depth.to_numpy()[0]
        shares.append(float(((alpha > SOLID) & (depth > NEAR * np.linalg.norm(target - eye))).mean()))
    renderer.destroy()
    splats.destroy()
    best = int(np.argmax(np.round(shares, 1)))
    return eyes[best], shares[best]
