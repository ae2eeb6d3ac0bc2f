"""The clearest of several views of a static scene: floaters before the eye hide what is behind them, as fog does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from assets.gaussians import Gaussians
from core.camera import look_at, perspective
from core.spherical_harmonics import C0

WIDTH, HEIGHT, FOV_Y = 96, 54, 0.9  # [px], [rad] of the pictures that are compared
NEAR = 0.4  # of the way to the target: what is nearer hides it
SOLID = 0.8  # opacity of a pixel that shows something
FOG_WIDTH = 0.1  # [rad] two standard deviations of a Gaussian that hides what is behind it without showing anything
FOG_SHARE = 0.3  # of a pixel
CLEAR = 0.7  # of a picture's pixels; below, a view is poor


def clearest(gaussians: Gaussians, eyes: list[np.ndarray], target: np.ndarray) -> tuple[np.ndarray, float]:
    """The eye (3,) [m] with the clearest view of a target, the first of equal ones, and how clear that is.

    Clear is the part of the picture that shows something solid, and nothing much nearer than the target. Taichi must be
    running.
    """
    from render.renderer import Renderer
    from render.splats import Splats

    black = np.zeros((len(gaussians), 1, 3), np.float32)
    splats = Splats(replace(gaussians, sh=black))
    renderer = Renderer(splats, WIDTH, HEIGHT, outputs="float", sort="radial")
    shares = []
    for eye in eyes:
        splats.write(0, gaussians.opacities, fog_colours(gaussians, eye, target), np.ones(len(gaussians), np.float32))
        renderer.render([perspective(WIDTH, HEIGHT, FOV_Y, look_at(eye, target))])
        fog, alpha, depth = (f.to_numpy()[0] for f in (renderer.rgb, renderer.alpha, renderer.depth))
        clear = (alpha > SOLID) & (depth > NEAR * np.linalg.norm(target - eye)) & (fog[..., 0] < FOG_SHARE)
        shares.append(float(clear.mean()))
    renderer.destroy()
    splats.destroy()
    best = int(np.argmax(np.round(shares, 1)))
    return eyes[best], shares[best]


def fog_colours(gaussians: Gaussians, eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Harmonics (N, 1, 3) that draw Gaussians which are fog for an eye in white: wide ones before the target; all
    others in black."""
    away = np.linalg.norm(gaussians.means - eye, axis=1)
    width = 2.0 * np.exp(np.sort(gaussians.log_scales, axis=1)[:, 1])
    fog = (away < np.linalg.norm(target - eye)) & (width > FOG_WIDTH * away)
    return np.where(fog, 0.5 / C0, -0.5 / C0)[:, None, None].repeat(3, axis=2).astype(np.float32)
