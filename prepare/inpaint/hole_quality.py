"""Quality of an inpainted hole: against the truth behind the object, and from view to view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from assets.gaussians import Gaussians
from prepare.inpaint.hole_patch import target
from prepare.inpaint.hole_views import Drawing, HoleView
from prepare.inpaint.inpaint_pipeline import Hole
from prepare.inpaint.surface_texture import GRAZING, SurfaceTexture, projected
from prepare.train.photographs import Photograph

PSNR_MAX = 99.0  # [dB] reported for equal pictures


@dataclass(frozen=True)
class Comparison:
    """Pictures of a view, (H, W, 3) float32: before and after, and the truth or None; and its pixels (H, W) bool:
    that the object covered, and of the hole."""

    view: HoleView
    before: np.ndarray
    after: np.ndarray
    truth: np.ndarray | None
    covered: np.ndarray
    hole: np.ndarray


def compare(
    hole: Hole,
    textures: list[SurfaceTexture],
    before: Gaussians,
    after: Gaussians,
    truths: Sequence[Photograph | None],
    *,
    antialias: bool,
    sort: str,
) -> list[Comparison]:
    """Each view of a hole before and after; `truths`: photographs without the object, one a camera, or empty."""
    cameras = [v.camera for v in hole.views]
    drawings = [Drawing(g, cameras, antialias=antialias, sort=sort) for g in (before, after)]
    found = []
    for view in hole.views:
        pictures = [drawing(view.camera)[0].clip(0.0, 1.0) for drawing in drawings]
        photograph = truths[view.index] if truths else None
        truth = None if photograph is None else cut_out(photograph, view)
        found.append(Comparison(view, *pictures, truth, view.in_front(), target(view, textures)[1]))
    for drawing in drawings:
        drawing.destroy()
    return found


def cut_out(photograph: Photograph, view: HoleView) -> np.ndarray:
    """The part of a photograph that a view shows, in its size, (H, W, 3) float32."""
    cut, whole = view.camera, photograph.camera
    sx, sy = cut.fx / whole.fx, cut.fy / whole.fy
    x, y = round(whole.cx - cut.cx / sx), round(whole.cy - cut.cy / sy)
    part = photograph.pixels[y : y + round(cut.height / sy), x : x + round(cut.width / sx)]
    return cv2.resize(part, (cut.width, cut.height), interpolation=cv2.INTER_AREA).astype(np.float32) / 255


def uncovered_psnr(views: list[Comparison]) -> dict[str, dict[str, float]]:
    """PSNR [dB] before and after, over all pixels that the object covered, and over those of the hole."""
    found = {}
    for name, pixels in (("object", "covered"), ("hole", "hole")):
        error = {}
        for when in ("before", "after"):
            squares = [(getattr(v, when) - v.truth)[getattr(v, pixels)] ** 2 for v in views if v.truth is not None]
            squares = np.concatenate([np.zeros((0, 3)), *squares])
            if len(squares):
                error[when] = _psnr(squares)
        found[name] = error
    return found


def psnr_by_view(views: list[Comparison]) -> list[float]:
    """PSNR [dB] after, over the pixels that the object covered, of each view with a truth that shows some."""
    shown = [v for v in views if v.truth is not None and v.covered.any()]
    return [_psnr((v.after - v.truth)[v.covered] ** 2) for v in shown]


def _psnr(squares: np.ndarray) -> float:
    return float(min(PSNR_MAX, -10 * np.log10(max(squares.mean(), 1e-12))))


def inconsistency(views: list[Comparison], textures: list[SurfaceTexture], pictures: Sequence[np.ndarray]) -> float:
    """Standard deviation between views of the colour that pictures show at a place of the hole, in 8-bit levels; the
    mean over places that at least two views show."""
    deviations = []
    for texture in textures:
        places = texture.places()[texture.hole]
        points = texture.surface.points(places)
        total, squares, count = np.zeros((len(points), 3)), np.zeros((len(points), 3)), np.zeros(len(points))
        for view, picture in zip(views, pictures, strict=True):
            at, z, cosine = projected(view.view, points[None], texture.surface.axes[2])
            color = cv2.remap(picture, at[..., 0], at[..., 1], cv2.INTER_LINEAR)[0].astype(np.float64)
            own = cv2.remap(view.hole.astype(np.uint8), at[..., 0], at[..., 1], cv2.INTER_NEAREST)[0] > 0
            own &= (z[0] > 0) & (cosine[0] > GRAZING)
            total[own] += color[own]
            squares[own] += color[own] ** 2
            count += own
        several = count > 1
        mean = total[several] / count[several, None]
        variance = squares[several] / count[several, None] - mean**2
        deviations.append(np.sqrt(variance.clip(0.0).mean(axis=1)))
    found = np.concatenate([np.zeros(0), *deviations])
    return float(255 * found.mean()) if len(found) else 0.0
