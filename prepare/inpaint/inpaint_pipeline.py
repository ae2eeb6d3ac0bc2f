"""Inpainting of a splat: the place where an object stood is closed by a patch of new Gaussians."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from assets.gaussians import Gaussians, concatenate
from core.camera import Camera
from core.errors import BadInput
from core.program import in_threads
from core.spherical_harmonics import C0
from prepare.inpaint.hole_patch import HOLE_PIXELS, VIEWS_MAX, seed_patch, target, train_patch
from prepare.inpaint.hole_views import HoleView, Surroundings, cameras_around, draw_views, spread_indices, within_object
from prepare.inpaint.object_shadow import find_shadow, textures_without_shadow, views_of, without_shadow
from prepare.inpaint.picture_inpainting import Painter, paint_from_patches
from prepare.inpaint.support_surface import SurfaceTexture, part_of_surface, shows_colors, support_surfaces, texture_of
from prepare.progress import Progress, no_progress
from prepare.train.photographs import Photograph

STAGES = ("views", "hole", "shadow", "paint", "patch")
STEPS = 200  # of training the patch
OBJECT_MIN = 20  # Gaussians of an object
RIM_KNOWN = 0.6  # known share of the rim of a hole on a further surface; else it is the side of a nearby thing
CONTEXT = 48  # texels around a hole that the painter sees
SEEN_MIN = 50  # pixels of the object in all views; with fewer it counts as unseen


class NoSurface(BadInput):
    """No surface was found that the object stands on or leans against, so nothing tells what is behind it."""


@dataclass(frozen=True)
class Hole:
    """The hole that an object leaves behind.

    background  the remaining Gaussians
    dropped     number of Gaussians inside the object, which no camera saw and which are left out
    removed     Gaussians of the object
    views       of the scene without the object, and of the object alone
    support     texture of the surface that the object stands on
    textures    of the support surfaces that have a hole, not painted yet; empty if cameras saw everything behind it
    """

    background: Gaussians
    dropped: int
    removed: Gaussians
    ball: Surroundings
    views: list[HoleView]
    support: SurfaceTexture
    textures: list[SurfaceTexture]

    @property
    def area(self) -> float:
        """Area of the hole [m^2]."""
        return sum(t.area for t in self.textures)


def inpaint(
    background: Gaussians,
    removed: Gaussians,
    cameras: list[Camera] | None,
    *,
    name: str = "the object",
    others: Gaussians | None = None,
    standing: Gaussians | None = None,
    painter: Painter = paint_from_patches,
    steps: int = STEPS,
    progress: Progress = no_progress,
) -> Gaussians:
    """Remove an object from a splat: returns the background, followed by a patch where no camera saw behind the object.

    The background's Gaussians stay as they are, bit for bit, but for their colours in the object's shadow; those inside
    the object, which no camera saw, are dropped.

    others    Gaussians of other objects that are removed, too: what they hid was not seen either
    standing  other objects that cast shadows on the background, besides those with an id in it
    cameras   of the photographs, in the frame of the Gaussians; without any (None) the hole is what is empty when the
              object's place is rendered from all sides
    painter   fills a picture's hole
    progress  is called with STAGES

    Taichi must have been started. Raises BadInput, naming the object, if it has no support or is not seen.
    """
    hole = find_hole(background, removed, cameras, name=name, others=others, progress=progress)
    hole = take_shadow(hole, standing, progress)
    return close_hole(hole, paint_hole(hole, painter, progress), steps, progress)


def in_support(
    background: Gaussians,
    removed: Gaussians,
    cameras: list[Camera] | None,
    *,
    others: Gaussians | None = None,
    progress: Progress = no_progress,
) -> np.ndarray:
    """Mask (N,) of an object's Gaussians that belong to the surface it stands on: its masks covered them.

    Arguments as of `inpaint`.
    """
    textures = []
    if len(removed) >= OBJECT_MIN and len(background):
        ball, photographed = Surroundings.of(removed), cameras is not None
        cameras = cameras if photographed else cameras_around(background, removed, ball)
        hiding = removed if others is None else concatenate([removed, others])
        views = draw_views(background, hiding, cameras, ball, progress)
        textures = textures_around(views, removed, ball, photographed=photographed)
    if not textures:
        return np.zeros(len(removed), bool)
    like = shows_colors(textures[0], removed.sh[:, 0] * C0 + 0.5)
    return part_of_surface(removed.means, textures[0].surface, ball, like)


def without_support(
    background: Gaussians, removed: Gaussians, cameras: list[Camera] | None, **options
) -> tuple[Gaussians, Gaussians]:
    """The background with the Gaussians of `in_support`, and the object without them."""
    part = in_support(background, removed, cameras, **options)
    own = removed.select(part)
    return concatenate([background, replace(own, object_id=np.zeros_like(own.object_id))]), removed.select(~part)


def find_hole(
    background: Gaussians,
    removed: Gaussians,
    cameras: list[Camera] | None,
    *,
    name: str,
    others: Gaussians | None = None,
    progress: Progress = no_progress,
) -> Hole:
    """Find the hole that an object leaves behind. Arguments and errors as of `inpaint`."""
    if len(removed) < OBJECT_MIN:
        raise BadInput(f"{name}: only {len(removed)} Gaussians; an object has at least {OBJECT_MIN}")
    if not len(background):
        raise BadInput(f"{name}: nothing is left without it")
    ball, photographed = Surroundings.of(removed), cameras is not None
    cameras = cameras if photographed else cameras_around(background, removed, ball)
    hiding = [removed] if others is None else [removed, others]
    views = draw_views(background, concatenate(hiding), cameras, ball, progress)
    if sum(int(v.in_front().sum()) for v in views) < SEEN_MIN:
        raise BadInput(f"{name}: no camera sees it")
    progress("hole", 0.0)
    kept, dropped = background, 0
    if photographed and (unseen := within_object(background, views, ball, progress)).any():
        kept, dropped = background.select(~unseen), int(unseen.sum())
        hiding.append(background.select(unseen))
        views = draw_views(kept, concatenate(hiding), cameras, ball, no_progress)
    textures = textures_around(views, removed, ball, photographed=photographed)
    if not textures:
        raise NoSurface(f"{name}: no surface was found that it stands on or leans at; nothing tells what is behind it")
    holes = [t for k, t in enumerate(textures) if t.hole.any() and (k == 0 or t.rim > RIM_KNOWN)]
    progress("hole", 1.0)
    return Hole(kept, dropped, removed, ball, views, textures[0], holes)


def textures_around(
    views: list[HoleView], removed: Gaussians, ball: Surroundings, *, photographed: bool
) -> list[SurfaceTexture]:
    """Textures of an object's support surfaces, the one that it stands on first."""
    surfaces = support_surfaces(views, removed.means, ball, np.random.default_rng(0))
    bounds = [[other for other in surfaces if other is not s] for s in surfaces]
    return with_hole_first(
        [texture_of(s, b, views, ball, photographed=photographed) for s, b in zip(surfaces, bounds, strict=True)]
    )


def with_hole_first(textures: list[SurfaceTexture]) -> list[SurfaceTexture]:
    """Sort textures by how likely they carry the object: those with a hole, and with its rim known, first.

    Remains of the object's own side in the background touch it more than the surface it stands on does, but have no
    hole, or end beside it.
    """
    return sorted(textures, key=lambda t: (not t.hole.any(), -min(t.rim, RIM_KNOWN)))


def take_shadow(hole: Hole, standing: Gaussians | None = None, progress: Progress = no_progress) -> Hole:
    """The hole in surroundings without the shadow of the removed object. `standing` as of `inpaint`."""
    progress("shadow", 0.0)
    others = [hole.background.select(hole.background.object_id > 0), *([] if standing is None else [standing])]
    shadow = find_shadow(hole.removed, concatenate(others), hole.support, hole.ball)
    if shadow is None:
        return hole
    background = without_shadow(hole.background, shadow, hole.ball, hole.views)
    support, *textures = textures_without_shadow([hole.support, *hole.textures], shadow)
    views = views_of(background, hole.views, progress)
    return replace(hole, background=background, views=views, support=support, textures=textures)


def paint_hole(hole: Hole, painter: Painter, progress: Progress = no_progress) -> list[SurfaceTexture]:
    """The textures with their holes painted."""
    painted = []
    for k, t in enumerate(hole.textures):
        progress("paint", k / len(hole.textures))
        y, x = (slice(max(0, a.min() - CONTEXT), a.max() + 1 + CONTEXT) for a in np.nonzero(t.hole))
        color = t.color.copy()
        color[y, x] = painter(t.color[y, x], ~t.known[y, x])
        painted.append(replace(t, color=color))
    progress("paint", 1.0)
    return painted


def close_hole(
    hole: Hole, textures: list[SurfaceTexture], steps: int = STEPS, progress: Progress = no_progress
) -> Gaussians:
    """The background, followed by the trained patch."""
    if not textures:
        progress("patch", 1.0)
        return hole.background
    patch = concatenate([seed_patch(t, hole.background, hole.background.sh_degree) for t in textures])
    targets = []
    wanted = in_threads(lambda view: target(view, textures), hole.views)
    for view, (color, pixels, counts) in zip(hole.views, wanted, strict=True):
        if pixels.sum() >= HOLE_PIXELS:
            picture = (color.clip(0.0, 1.0) * 255).round().astype(np.uint8)
            targets.append(Photograph(picture, counts, view.camera))
    targets = [targets[i] for i in spread_indices(len(targets), VIEWS_MAX)]
    if targets:
        patch = train_patch(hole.background, patch, targets, hole.ball.radius, progress, steps)
    return concatenate([hole.background, patch])
