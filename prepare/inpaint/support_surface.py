"""Support surfaces of an object, the planes that it stands on or leans against, and their textures.

A texture holds the part that cameras saw, and the hole that none saw.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.ndimage import binary_dilation, binary_opening, binary_propagation, distance_transform_edt, label
from scipy.spatial import cKDTree

from core.planes import fit_plane
from core.program import in_threads
from prepare.inpaint.hole_views import SOLID, TRACE, HoleView, Surroundings, image_positions, sampled

POINTS, POINTS_MIN = 6000, 50  # sampled on the background around the object, from all views
OBJECT_POINTS = 2000  # sampled on the object
TRIALS = 400  # RANSAC planes through three points
REFITS = 8  # of the best plane
NEAR = 1.7  # radii from the object's middle: the rim on which planes are fitted
CONTACT = 0.08  # radii from the object at which a point's weight is a quarter
FLAT = 0.06  # radii: largest distance of a plane's points from it
SHARE = 0.08  # of all points' weight that a plane needs
PARALLEL = 0.85  # cosine between a point's normal and its plane's
NEIGHBOURS = 32  # points from which a normal is estimated
PART_SHARE = 0.06, 0.5  # least and most of an object that may be a part of its support
HALO = 2  # [px] around the object in which its colour leaks into the background
REACH = 1.7  # half the side of the texture, in radii of the object
TEXELS = (96, 384)  # least and most along a side
NEAR_SURFACE = 0.04  # radii: a pixel whose depth is this near shows the surface
GRAZING = 0.12  # cosine of the steepest angle from which a surface is sampled
SEEN_SHARE = 0.05  # share of the views that must show a texel; fewer are glimpses or noise of the depth
EMPTY_SHARE = 0.25  # share of the views that must see through it, beside such texels of those past the object
COVERED_SHARE = 0.3  # share of the views in which the object must cover it; else something else hides it
LEAK, RIM = 2, 6  # texels repainted around a hole, and compared for its known share
SLIVER = 2  # texels: half the width of a gap that is a dent at the object's foot, not the end of the surface
HOLE_MIN = 4  # texels of a connected hole; smaller ones are noise of the depth
EDGE_POINTS = 50, 400  # least and most from which a surface's edge is continued
HUE = 0.15  # largest distance of RGB, 0..1, from a shade of a surface's colour
COLORS = 500  # texels that colours are compared with
COMMON = 0.05  # share of the texels that have a colour of the surface; fewer are of things on it
SURE = 0.5  # share of the views past the object that must show no surface, where there are no photographs


@dataclass(frozen=True)
class SupportSurface:
    """A plane. Its frame: origin [m] (3,), rows of `axes` (3, 3) along it and towards the object.

    spread  standard deviation [m] of the points it was found from, by their median
    share   of all points around the object, by their nearness to it
    """

    origin: np.ndarray
    axes: np.ndarray
    spread: float
    share: float = 1.0

    def points(self, at: np.ndarray) -> np.ndarray:
        """Points [m] (..., 3) of the surface at places (..., 2) [m]."""
        return self.origin + at @ self.axes[:2]

    def local(self, points: np.ndarray) -> np.ndarray:
        """Places and distances from the plane (..., 3) [m] of points."""
        return (points - self.origin) @ self.axes.T


def rim_points(views: list[HoleView], ball: Surroundings, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) [m] of the background around the object that the cameras saw, and their normals (N, 3)."""
    found = [np.zeros((0, 3))]
    for view in views:
        seen = (view.alpha > 0.9) & ~binary_dilation(view.object_alpha > TRACE, iterations=HALO)
        y, x = np.nonzero(seen)
        at = view.camera.points_at(view.depth, x, y)
        near = np.flatnonzero(np.linalg.norm(at - ball.centre, axis=1) < NEAR * ball.radius)
        found.append(at[near[rng.permutation(len(near))[: max(50, 4 * POINTS // len(views))]]])
    points = np.concatenate(found)
    points = points[rng.permutation(len(points))[:POINTS]]
    if len(points) < NEIGHBOURS:
        return points, np.zeros_like(points)
    # Of neighbours from all views: between a picture's pixels, the noise of its depth is larger than the slope.
    return points, normals_of(points)


def support_surfaces(
    views: list[HoleView], removed_means: np.ndarray, ball: Surroundings, rng: np.random.Generator
) -> list[SupportSurface]:
    """Planes that an object touches, with the object and most cameras on one side; the one it touches most comes first.

    Points are weighted by nearness to the object: it stands on the slab at its feet, not on the larger ground below.
    """
    points, normals = rim_points(views, ball, rng)
    near = _nearness(points, removed_means, ball)
    eyes = np.array([v.camera.position for v in views])
    found, total = [], near.sum()
    while len(points) >= POINTS_MIN:
        plane = _supporting_plane(points, normals, near, removed_means, eyes, ball, rng)
        if plane is None:
            break
        origin, normal, spread = plane
        along = np.abs(normals @ normal) > PARALLEL
        on = along & (np.abs((points - origin) @ normal) < FLAT * ball.radius)
        share = float(near[on].sum() / total)
        if share < SHARE:
            break
        foot = ball.centre - normal * (normal @ (ball.centre - origin))
        found.append(SupportSurface(foot, _frame(normal), spread, share))
        points, normals, near = points[~along], normals[~along], near[~along]  # parallel ones: the same with noise
    return found


def _nearness(points: np.ndarray, others: np.ndarray, ball: Surroundings) -> np.ndarray:
    """Weights (N,) of points by their distance from others: 1 in contact, a quarter at CONTACT, soon 0 beyond."""
    return (1.0 + (cKDTree(others).query(points)[0] / (CONTACT * ball.radius)) ** 2) ** -2.0


def part_of_surface(
    means: np.ndarray, surface: SupportSurface, ball: Surroundings, like: np.ndarray | bool = True
) -> np.ndarray:
    """Mask (N,) of an object's Gaussians that belong to the surface it stands on: its masks covered them.

    Empty if most of the object lies there (it is flat itself) or very little (its own underside). `like` (N,) selects
    Gaussians in the surface's colours; flat feet of the object have others.
    """
    points = means.astype(np.float64)
    lying = np.abs(surface.local(points)[:, 2]) < FLAT * ball.radius
    lying &= np.abs(normals_of(points) @ surface.axes[2]) > PARALLEL
    part = lying & like
    return part & (PART_SHARE[0] < part.mean() and lying.mean() < PART_SHARE[1])


def normals_of(points: np.ndarray) -> np.ndarray:
    """Unit normals (N, 3), of either sign, of the neighbourhoods of points (N, 3)."""
    own = points[cKDTree(points).query(points, k=min(NEIGHBOURS, len(points)))[1]]
    own -= own.mean(axis=1, keepdims=True)
    return np.linalg.eigh(np.einsum("nki,nkj->nij", own, own))[1][:, :, 0]


def _supporting_plane(points, own_normals, near, object_points, eyes, ball: Surroundings, rng):
    """Origin, normal towards the object, and spread of the plane that explains most points; None if none carries it.

    Sample consensus with a truncated quadratic (MSAC) over planes through three points, over tangent planes at the
    nearest points, and over the same planes moved to where they touch the object; the score also counts the object's
    contact. Then weighted least squares, including the object's points: its masks may cover most of the surface that it
    stands on.
    """
    flat = FLAT * ball.radius
    some = object_points[:: max(1, len(object_points) // OBJECT_POINTS)]
    beside = _nearness(some, points, ball)
    corners = points[rng.choice(len(points), (TRIALS, 3), p=near / near.sum())]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    wide = length > 1e-3 * ball.radius**2
    closest = np.argsort(-near)[:TRIALS]
    normals = np.concatenate([normals[wide] / length[wide, None], own_normals[closest]])
    origins = np.concatenate([corners[wide, 0], points[closest]])
    normals *= np.sign(((ball.centre - origins) * normals).sum(axis=1))[:, None]
    lowest = np.percentile(some @ normals.T, 3, axis=0)
    offsets = np.concatenate([(origins * normals).sum(axis=1), lowest])
    normals, lowest = np.concatenate([normals, normals]), np.concatenate([lowest, lowest]) - offsets
    facing = (eyes @ normals.T > offsets).mean(axis=0)
    carries = (lowest >= 0.0) & (facing > SOLID)
    own = (1.0 - ((points @ normals.T - offsets) / flat) ** 2).clip(0.0) * (np.abs(own_normals @ normals.T) > PARALLEL)
    touching = beside @ (1.0 - ((some @ normals.T - offsets) / flat) ** 2).clip(0.0) / beside.sum()
    score = np.where(carries, (near @ own) * touching, 0.0)
    if not score.size or not score.max():
        return None
    best = int(score.argmax())
    normal, origin = normals[best], normals[best] * offsets[best]
    both, both_normals = np.concatenate([points, some]), np.concatenate([own_normals, normals_of(some)])
    nearness = np.sqrt(np.concatenate([near, beside]))  # of a wider base
    for _ in range(REFITS):
        along = np.abs(both_normals @ normal) > PARALLEL
        weights = nearness * along * (1.0 - ((both - origin) @ normal / flat) ** 2).clip(0.0)
        if (weights[: len(points)] > 0).sum() < 10:
            return None
        origin, normal = fit_plane(both, weights, normal)
    off = np.abs((points - origin) @ normal)[np.abs(own_normals @ normal) > PARALLEL]
    return origin, normal, 1.48 * float(np.median(off[off < flat]))


def _frame(normal: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) whose last row is `normal`."""
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(normal, across), normal])


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

    def sample(self, values: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Values (H, W, ...) of texels at places (..., 2) [m], 0 outside: interpolated, but of a mask the nearest."""
        return sampled(values, (places - self.corner) / self.texel - 0.5, linear=values.dtype != bool)

    @property
    def area(self) -> float:
        """Area of the hole [m^2]."""
        return float(self.hole.sum()) * self.texel**2

    def beside(self, other: SurfaceTexture) -> SurfaceTexture:
        """This texture, where it lies in the painted hole of another one known by that."""
        at, apart = other.surface.local(self.surface.points(self.places())), self.surface.spread + other.surface.spread
        same = (
            self.hole & (np.abs(at[..., 2]) < 3 * (other.texel + apart)) & (other.sample(other.hole, at[..., :2]) > 0)
        )
        color = np.where(same[..., None], other.sample(other.color, at[..., :2]), self.color)
        return replace(self, color=color, known=self.known | same, hole=self.hole & ~same)


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
    # Size [m] of a pixel at the object's distance:
    footprint = np.median([np.linalg.norm(v.camera.position - ball.centre) / v.camera.fx for v in views])
    count = int(np.clip(2 * REACH * ball.radius / footprint, *TEXELS))
    nothing, black = np.zeros((count, count), bool), np.zeros((count, count, 3), np.float32)
    corner, texel = np.full(2, -REACH * ball.radius), 2 * REACH * ball.radius / count
    texture = SurfaceTexture(surface, corner, texel, black, nothing, nothing)
    places = texture.places()
    tolerance = max(NEAR_SURFACE * ball.radius, 3 * surface.spread)
    points = surface.points(places)
    known, empty, covered, lacking, color = _seen(texture, points, views, tolerance)
    beyond = np.zeros_like(known)
    for other in others:
        beyond |= other.local(points)[..., 2] < 0.5 * texel
    hole = ~known & ~empty & covered & ~beyond & goes_on(known, empty)
    if not photographed:
        hole &= lacking
    labels, _ = label(hole)
    hole &= np.bincount(labels.ravel())[labels] >= HOLE_MIN
    if hole.any():  # its rim is repainted, as the object's colour leaks there
        hole = binary_dilation(hole, iterations=LEAK) & ~empty & ~beyond
    known &= ~hole
    around = binary_dilation(hole, iterations=RIM) & ~hole & ~beyond
    rim = float(known[around].mean()) if around.any() else 1.0
    color = np.where(known[..., None], color, 0.0).clip(0.0, 1.0).astype(np.float32)
    return replace(texture, color=color, known=known, hole=hole, rim=rim)


def goes_on(known: np.ndarray, empty: np.ndarray) -> np.ndarray:
    """Mask (H, W) of a surface that was seen in `known` and seen to be absent in `empty`, continued to unseen texels.

    Its edge is continued as the zero of a thin-plate spline through signed distances.
    """
    if not known.any() or not empty.any():
        return np.full(known.shape, known.any())
    to = [distance_transform_edt(~mask) for mask in (known, empty)]
    unseen = distance_transform_edt(~binary_opening(~(known | empty), iterations=SLIVER))
    distance = np.where(known, to[1], -to[0])
    sure = (known | empty) & (np.abs(distance) <= unseen)  # nothing unseen is nearer than the edge
    y, x = np.nonzero(sure)
    if len(y) < EDGE_POINTS[0]:
        return to[0] <= to[1]
    chosen = np.random.default_rng(0).permutation(len(y))[: EDGE_POINTS[1]]
    at, unit = np.stack([y, x], axis=-1)[chosen].astype(float), float(max(known.shape))
    plate = RBFInterpolator(at / unit, distance[sure][chosen] / unit, kernel="thin_plate_spline", smoothing=0.01)
    there = known.copy()
    y, x = np.nonzero(~(known | empty))
    if len(y):
        there[y, x] = plate(np.stack([y, x], axis=-1) / unit) > 0
    return there


def _seen(texture: SurfaceTexture, points: np.ndarray, views: list[HoleView], tolerance: float):
    """Visibility and colour of points (H, W, 3) of a surface in all views together, within a tolerance [m].

    Out.  masks (H, W): the surface is known; is absent; was covered by the object; and was lacking behind the object;
          the colour (H, W, 3), from the view that shows a texel largest and least slanted
    """
    color, best = np.zeros((*texture.hole.shape, 3), np.float32), np.zeros(texture.hole.shape)
    counts = np.zeros((5, *texture.hole.shape), np.int32)
    looks = in_threads(lambda view: _look(texture, points, view, tolerance), views)
    for (masks, merit, at), view in zip(looks, views, strict=True):
        counts += masks
        drawn = cv2.remap(view.color, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        better = merit > best
        color[better], best[better] = drawn[better], merit[better]
    looking, shown, through, covered, lacking = counts
    known = (shown > through) & (shown > SEEN_SHARE * looking)
    empty = binary_opening(~known & (through > EMPTY_SHARE * looking), iterations=SLIVER)
    past = binary_opening(~known & (through > EMPTY_SHARE * (looking - covered)), iterations=SLIVER)
    empty = binary_propagation(empty, mask=empty | past)  # beside a plinth most views show the object before the air
    return known, empty, covered > COVERED_SHARE * looking, lacking > SURE * covered, color


def _look(texture: SurfaceTexture, points: np.ndarray, view: HoleView, tolerance: float):
    """Visibility of points (H, W, 3) of a surface in one view.

    Out.  masks (5, H, W): in the picture; the surface; something behind it; the object in front of it; no surface
          behind the object; how large a texel appears (H, W), 0 where it does not; its pixel (H, W, 2)
    """
    at, z = image_positions(view.camera, points)
    rays = view.camera.position - points
    away = np.linalg.norm(rays, axis=-1)
    cosine = rays @ texture.surface.axes[2] / np.maximum(away, 1e-12)
    alpha = sampled(view.alpha, at, outside=-1.0)
    inside = (z > 0) & (cosine > GRAZING) & (alpha >= 0)
    touched = binary_dilation(view.object_alpha > TRACE, iterations=1)
    # The point on the ray of a texel at another depth is off the plane by this:
    slope = -cosine * away / np.maximum(z, 1e-9)
    before = (sampled(touched, at) > 0) & ((sampled(view.object_depth, at) - z) * slope > -tolerance)
    height = (sampled(view.depth, at) - z) * slope
    solid = alpha > SOLID
    shows = inside & ~before & solid & (np.abs(height) < tolerance)
    behind = inside & ~before & (~solid | (height < -2 * tolerance))
    covered = inside & before
    lacks = covered & (~solid | (height < -tolerance))
    merit = np.where(shows, cosine / np.maximum(z / view.camera.fx, 1e-12), 0.0)
    return np.stack([inside, shows, behind, covered, lacks]), merit.astype(np.float32), at


def shows_colors(texture: SurfaceTexture, colors: np.ndarray) -> np.ndarray:
    """Mask (N,) of the RGB colours (N, 3) that occur on a surface, in any shade."""
    shown = texture.color[texture.known].astype(np.float64)
    if not len(shown):
        return np.zeros(len(colors), bool)
    shown = shown[:: -(-len(shown) // COLORS)]
    hues = shown / np.maximum(np.linalg.norm(shown, axis=1, keepdims=True), 1e-6)
    off = (colors**2).sum(axis=1, keepdims=True) - (colors @ hues.T).clip(0.0) ** 2
    return (off < HUE**2).mean(axis=1) > COMMON
