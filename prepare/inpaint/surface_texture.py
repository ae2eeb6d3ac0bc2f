"""Texture of a support surface: the part that cameras saw, and the hole that none saw."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from scipy.ndimage import binary_dilation, binary_opening, distance_transform_edt, label

from core.threads import in_threads
from prepare.inpaint.hole_views import SOLID, TRACE, HoleView, Surroundings, image_positions, nearest_pixels
from prepare.inpaint.support_surface import SupportSurface, fit_relief

REACH = 1.7  # half the side of the texture, in radii of the object
TEXELS = (96, 384)  # least and most along a side
NEAR_SURFACE = 0.04  # radii: a pixel whose depth is this near shows the surface
GRAZING = 0.12  # cosine of the steepest angle from which a surface is sampled
SEEN_SHARE = 0.05  # share of the views that must show a texel; fewer are glimpses or noise of the depth
EMPTY_SHARE = 0.25  # share of the views that must see through it; fewer graze a dent in the surface
COVERED_SHARE = 0.3  # share of the views in which the object must cover it; else something else hides it
LEAK, RIM = 2, 6  # texels repainted around a hole, and compared for its known share
SLIVER = 2  # texels: half the width of a gap that is a dent at the object's foot, not the end of the surface
ROW = 1024  # texels sampled per row (cv2.remap limits rows)
HOLE_MIN = 4  # texels of a connected hole; smaller ones are noise of the depth
SURE = 0.5  # share of the views past the object that must show no surface, where there are no photographs


@dataclass(frozen=True)
class SurfaceTexture:
    """Square texels of a support surface, (H, W).

    corner  place [m] (2,) of the first texel's outer corner; `texel` [m] is its side
    color   (H, W, 3) float32, 0..1; black where it is not known
    known   bool: a camera saw the surface there
    hole    bool: no camera saw whether there is a surface, as the object was in front
    rim     share of the hole's rim that is known: low where the surface ends at the hole
    """

    surface: SupportSurface
    corner: np.ndarray
    texel: float
    color: np.ndarray
    known: np.ndarray
    hole: np.ndarray
    rim: float = 1.0

    def places(self) -> np.ndarray:
        """Places [m] (H, W, 2) of the texels' middles."""
        y, x = np.mgrid[: self.hole.shape[0], : self.hole.shape[1]]
        return self.corner + self.texel * (np.stack([x, y], axis=-1) + 0.5)

    def sample(self, values: np.ndarray, places: np.ndarray, *, linear: bool = True) -> np.ndarray:
        """Values (H, W, ...) of texels at places (..., 2) [m], 0 outside."""
        at = ((places - self.corner) / self.texel - 0.5).astype(np.float32).reshape(-1, 2)
        rows = np.full((-(-len(at) // ROW), ROW, 2), -2.0, np.float32)  # cv2.remap takes no row of 32,768 and more
        rows.reshape(-1, 2)[: len(at)] = at
        flag = cv2.INTER_LINEAR if linear else cv2.INTER_NEAREST
        found = cv2.remap(values, rows[..., 0], rows[..., 1], flag, borderMode=cv2.BORDER_CONSTANT)
        return found.reshape(-1, *values.shape[2:])[: len(at)].reshape(*places.shape[:-1], *values.shape[2:])

    @cached_property
    def relief(self) -> np.ndarray:
        """Height [m] (H, W) of the surface over its plane, in and around the hole; 0 elsewhere."""
        near, heights = binary_dilation(self.hole, iterations=RIM), np.zeros(self.hole.shape, np.float32)
        heights[near] = self.surface.heights(self.places()[near])
        return heights

    @property
    def area(self) -> float:
        """Area of the hole [m^2]."""
        return float(self.hole.sum()) * self.texel**2


def texture_of(
    surface: SupportSurface,
    others: list[SupportSurface],
    views: list[HoleView],
    ball: Surroundings,
    *,
    photographed: bool,
) -> SurfaceTexture:
    """The texture of a surface from all views, and its hole.

    others        surfaces that bound this one: it does not continue behind them
    photographed  True if the cameras took photographs: then a hole is what none of them saw, even if something is
                  rendered there; else a hole is where nothing is rendered.
    """
    footprint = np.median([_footprint(v, ball) for v in views])
    count = int(np.clip(2 * REACH * ball.radius / footprint, *TEXELS))
    nothing = np.zeros((count, count), bool)
    color = np.zeros((count, count, 3), np.float32)
    corner, texel = np.full(2, -REACH * ball.radius), 2 * REACH * ball.radius / count
    texture = SurfaceTexture(surface, corner, texel, color, nothing, nothing)
    tolerance = max(NEAR_SURFACE * ball.radius, 3 * surface.spread)
    places = texture.places()
    looking, seen, through, covered, lacking = (np.zeros((count, count), np.int32) for _ in range(5))
    heights = np.zeros((count, count))
    flat = surface.points(places)
    for look in in_threads(lambda view: _look(texture, flat, view, tolerance), views):
        looking += look.inside
        seen += look.shows
        through += look.behind
        covered += look.covered
        lacking += look.lacks
        heights += np.where(look.shows, look.height, 0.0)
    known = (seen > through) & (seen > SEEN_SHARE * looking)
    empty = binary_opening(~known & (through > EMPTY_SHARE * looking), iterations=SLIVER)
    surface = fit_relief(surface, places[known], heights[known] / seen[known], ball.radius)
    points = surface.points(places)
    beyond = np.zeros_like(known)
    for other in others:
        beyond |= other.local(points)[..., 2] < 0.5 * texel
    hole = ~known & ~empty & (covered > COVERED_SHARE * looking) & ~beyond
    if not photographed:
        hole &= lacking > SURE * covered
    if known.any():  # the surface ends where the nearest place that was seen has none
        nearest = distance_transform_edt(~(known | empty), return_distances=False, return_indices=True)
        hole &= known[tuple(nearest)]
    hole = _without_specks(hole)
    if hole.any():  # its rim is repainted, as the object's colour leaks there
        hole = binary_dilation(hole, iterations=LEAK) & ~empty & ~beyond
    known &= ~hole
    around = binary_dilation(hole, iterations=RIM) & ~hole & ~beyond
    rim = float(known[around].mean()) if around.any() else 1.0
    texture = replace(texture, surface=surface, known=known, hole=hole, rim=rim)
    return replace(texture, color=_colors(texture, points, views, tolerance))


@dataclass(frozen=True)
class _Look:
    """Classes of the texels that a view looks at: the surface, something behind it, the object before it (and nothing
    where the surface should be then); and the height [m] of what it shows."""

    inside: np.ndarray
    shows: np.ndarray
    behind: np.ndarray
    covered: np.ndarray
    lacks: np.ndarray
    height: np.ndarray


def _look(texture: SurfaceTexture, points: np.ndarray, view: HoleView, tolerance: float) -> _Look:
    at, z, cosine = projected(view, points, texture.surface.axes[2])
    inside = (z > 0) & (cosine > GRAZING)

    alpha = nearest_pixels(view.alpha, at, -1.0)
    inside &= alpha >= 0
    touched = binary_dilation(view.object_alpha > TRACE, iterations=1).astype(np.float32)
    depth_of_object = nearest_pixels(view.object_depth, at, 0.0)
    # The point on the ray of a texel at another depth is off the plane by this:
    slope = -cosine * np.linalg.norm(points - view.camera.position, axis=-1) / np.maximum(z, 1e-9)
    before = (nearest_pixels(touched, at, 0.0) > 0) & ((depth_of_object - z) * slope > -tolerance)
    height = (nearest_pixels(view.depth, at, 0.0) - z) * slope
    solid = alpha > SOLID
    shows = inside & ~before & solid & (np.abs(height) < tolerance)
    behind = inside & ~before & (~solid | (height < -2 * tolerance))
    covered = inside & before
    return _Look(inside, shows, behind, covered, covered & (~solid | (height < -tolerance)), height)


def projected(view: HoleView, points: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions for cv2.remap (..., 2) float32 of points (..., 3), their depth z [m], and the cosine of the view."""
    at, z = image_positions(view.camera, points)
    rays = view.camera.position - points
    cosine = rays @ normal / np.maximum(np.linalg.norm(rays, axis=-1), 1e-12)
    return at, z, cosine


def _colors(texture: SurfaceTexture, points: np.ndarray, views: list[HoleView], tolerance: float) -> np.ndarray:
    """Colour of each known texel, from the view with the best resolution and angle."""

    def seen_in(view: HoleView) -> tuple[np.ndarray, np.ndarray]:
        shows = _look(texture, points, view, tolerance).shows
        at, z, cosine = projected(view, points, texture.surface.axes[2])
        merit = np.where(shows, cosine / np.maximum(z / view.camera.fx, 1e-12), 0.0)
        return merit, cv2.remap(view.color, at[..., 0], at[..., 1], cv2.INTER_LINEAR)

    color = np.zeros((*texture.hole.shape, 3), np.float32)
    best = np.zeros(texture.hole.shape)
    for merit, drawn in in_threads(seen_in, views):
        better = merit > best
        color[better], best[better] = drawn[better], merit[better]
    return np.where(texture.known[..., None], color, 0.0).clip(0.0, 1.0).astype(np.float32)


def _footprint(view: HoleView, ball: Surroundings) -> float:
    """Size [m] of a pixel at the object's distance."""
    return float(np.linalg.norm(view.camera.position - ball.centre)) / view.camera.fx


def _without_specks(hole: np.ndarray) -> np.ndarray:
    labels, _ = label(hole)
    sizes = np.bincount(labels.ravel())
    return hole & (sizes[labels] >= HOLE_MIN)
