"""Inpainting of a splat: the place where an object stood is closed by a patch of new Gaussians."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from assets.gaussians import Gaussians, concatenate
from core.camera import Camera
from core.errors import BadInput
from core.spherical_harmonics import C0
from prepare.blending_weights import BlendingWeights
from prepare.inpaint.hole_patch import seed_patch, targets_of, train_patch
from prepare.inpaint.hole_views import HoleView, Surroundings, cameras_around, draw_views, drawing_of, within_object
from prepare.inpaint.object_shadow import find_shadow, textures_without_shadow, without_shadow
from prepare.inpaint.picture_inpainting import Painter, paint_from_patches
from prepare.inpaint.support_surface import SurfaceTexture, part_of_surface, shows_colors, support_surfaces, texture_of
from prepare.progress import Progress, no_progress

STAGES = ("views", "hole", "shadow", "paint", "patch")
STEPS = 200  # of training the patch of a hole
OBJECT_MIN = 20  # Gaussians of an object
RIM_KNOWN = 0.6  # known share of the rim of a hole on a further surface; else it is the side of a nearby thing
CONTEXT = 48  # texels around a hole that the painter sees
SEEN_MIN = 50  # pixels of the object in all views; with fewer it counts as unseen
ObjectProgress = Callable[[str, int, int], Progress]


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
    textures    of the support surfaces that have a hole; empty if cameras saw everything behind it
    patch       Gaussians over the hole, none until it is painted
    """

    name: str
    background: Gaussians
    dropped: int
    removed: Gaussians
    ball: Surroundings
    views: list[HoleView]
    support: SurfaceTexture
    textures: list[SurfaceTexture]
    patch: Gaussians

    @property
    def area(self) -> float:
        """Area of the hole [m^2]."""
        return sum(t.area for t in self.textures)


def inpaint(
    background: Gaussians,
    objects: Mapping[str, Gaussians],
    cameras: list[Camera] | None,
    *,
    shadows: bool = True,
    painter: Painter | None = None,
    steps: int = STEPS,
    progress: ObjectProgress = lambda *_: no_progress,
    say: Callable[[str], None] | None = None,
) -> tuple[Gaussians, list[Hole]]:
    """Remove objects, by name, from a splat: returns the background, followed by a patch where no camera saw behind
    them, and their holes.

    First all shadows go, then the holes are painted, each beside what was painted in those before, and trained
    together. The background's Gaussians stay as they are, bit for bit, but for their colours in the objects' shadows;
    those inside an object, which no camera saw, are dropped.

    cameras    of the photographs, in the frame of the Gaussians; without any (None) a hole is what is empty when the
               object's place is rendered from all sides
    shadows    are removed with their objects
    painter    fills a picture's hole, by default from patches
    steps      of training, a hole
    progress   of an object, by name, number and number of all, is called with STAGES
    say        is told of an object without a surface behind it, which else ends all

    Taichi must have been started. Raises BadInput, naming the object, if it has no support or is not seen.
    """
    holes, tell = [], no_progress
    with drawing_of(background, *objects.values()) as drawing:
        for k, (name, removed) in enumerate(objects.items()):
            tell, others = progress(name, k, len(objects)), [g for other, g in objects.items() if other != name]
            try:
                hole = find_hole(drawing, background, removed, cameras, name=name, others=others, progress=tell)
            except NoSurface as e:
                if say is None:
                    raise
                say(f"what it hid stays open: {e}")
                continue
            holes.append(hole)
            if shadows:  # those before took theirs along
                holes = take_shadow(drawing, holes, others[k:], tell)
            background = holes[-1].background
        for k, hole in enumerate(holes):
            tell, before = progress(hole.name, k, len(holes)), [t for h in holes[:k] for t in h.textures]
            holes[k] = paint_hole(hole, before, painter or paint_from_patches, tell)
        return close_holes(drawing, background, holes, steps, tell), holes


def without_supports(
    background: Gaussians,
    objects: Mapping[str, Gaussians],
    cameras: list[Camera] | None,
    progress: ObjectProgress = lambda *_: no_progress,
) -> tuple[Gaussians, dict[str, Gaussians]]:
    """The background with those Gaussians of objects that belong to the surface an object stands on, and the objects
    without them: masks took them along. Arguments as of `inpaint`."""
    objects = dict(objects)
    with drawing_of(background, *objects.values()) as drawing:
        for k, (name, removed) in enumerate(objects.items()):
            if len(removed) < OBJECT_MIN or not len(background):
                continue
            tell, others = progress(name, k, len(objects)), [g for other, g in objects.items() if other != name]
            ball = Surroundings.of(removed)
            around = cameras_around(drawing, background, removed, ball) if cameras is None else cameras
            tell("views", k / len(objects))
            views = draw_views(drawing, background, concatenate([removed, *others]), around, ball)
            textures = textures_around(views, removed, ball, photographed=cameras is not None)
            if textures:
                like = shows_colors(textures[0], removed.sh[:, 0] * C0 + 0.5)
                part = part_of_surface(removed.means, textures[0].surface, ball, like)
                given = removed.select(part)
                background = concatenate([background, replace(given, object_id=np.zeros_like(given.object_id))])
                objects[name] = removed.select(~part)
    return background, objects


def find_hole(
    drawing: BlendingWeights,
    background: Gaussians,
    removed: Gaussians,
    cameras: list[Camera] | None,
    *,
    name: str,
    others: Sequence[Gaussians] = (),
    progress: Progress = no_progress,
) -> Hole:
    """Find the hole that an object leaves behind. Arguments and errors as of `inpaint`; what `others` hide was not seen
    either."""
    if len(removed) < OBJECT_MIN:
        raise BadInput(f"{name}: only {len(removed)} Gaussians; an object has at least {OBJECT_MIN}")
    if not len(background):
        raise BadInput(f"{name}: nothing is left without it")
    ball, photographed = Surroundings.of(removed), cameras is not None
    cameras = cameras if photographed else cameras_around(drawing, background, removed, ball)
    hiding = [removed, *others]
    progress("views", 0.0)
    views = draw_views(drawing, background, concatenate(hiding), cameras, ball)
    if sum(int(v.in_front().sum()) for v in views) < SEEN_MIN:
        raise BadInput(f"{name}: no camera sees it")
    progress("hole", 0.0)
    kept, dropped = background, 0
    if photographed and (unseen := within_object(drawing, background, views, ball, progress)).any():
        kept, dropped = background.select(~unseen), int(unseen.sum())
        hiding.append(background.select(unseen))
        views = draw_views(drawing, kept, concatenate(hiding), cameras, ball)
    textures = textures_around(views, removed, ball, photographed=photographed)
    if not textures:
        raise NoSurface(f"{name}: no surface was found that it stands on or leans at; nothing tells what is behind it")
    holes = [t for k, t in enumerate(textures) if t.hole.any() and (k == 0 or t.rim > RIM_KNOWN)]
    progress("hole", 1.0)
    return Hole(name, kept, dropped, removed, ball, views, textures[0], holes, kept.select(slice(0)))


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
    """Sort textures by how likely they carry the object: those with a hole, by the geometric mean of the shares of the
    points around and of the hole's rim that are known to lie on them, first.

    Remains of the object's own side in the background touch it more than the surface it stands on does, but have no
    hole, or end beside it.
    """
    return sorted(textures, key=lambda t: (not t.hole.any(), -t.rim * t.surface.share))


def take_shadow(
    drawing: BlendingWeights, holes: list[Hole], standing: Sequence[Gaussians] = (), progress: Progress = no_progress
) -> list[Hole]:
    """Holes in surroundings without the shadow of the last one's object, whose background is that of all; `standing`
    are other objects that cast shadows on it, besides those with an id in it."""
    progress("shadow", 0.0)
    *before, hole = holes
    others = concatenate([hole.background.select(hole.background.object_id > 0), *standing])
    shadow = find_shadow(drawing, hole.removed, others, hole.support, hole.ball)
    if shadow is None:
        return holes
    background = without_shadow(hole.background, shadow, hole.ball, hole.views)
    support, *textures = textures_without_shadow([hole.support, *hole.textures], shadow)
    lit = [replace(h, textures=textures_without_shadow(h.textures, shadow)) for h in before]
    return [*lit, replace(hole, background=background, support=support, textures=textures)]


def paint_hole(hole: Hole, before: list[SurfaceTexture], painter: Painter, progress: Progress = no_progress) -> Hole:
    """The hole, painted, but for what others, painted `before`, show in the same place."""
    painted = []
    for k, t in enumerate(hole.textures):
        progress("paint", k / len(hole.textures))
        for other in before:
            t = t.beside(other)
        if not t.hole.any():
            continue
        y, x = (slice(max(0, a.min() - CONTEXT), a.max() + 1 + CONTEXT) for a in np.nonzero(t.hole))
        color = t.color.copy()
        color[y, x] = painter(t.color[y, x], ~t.known[y, x])
        painted.append(replace(t, color=color))
    progress("paint", 1.0)
    seeds = (seed_patch(t, hole.background, hole.background.sh_degree) for t in painted)
    return replace(hole, textures=painted, patch=concatenate([hole.patch, *seeds]))


def close_holes(
    drawing: BlendingWeights, background: Gaussians, holes: Sequence[Hole], steps: int, progress: Progress
) -> Gaussians:
    """The background, followed by the patches of painted holes, which are trained together."""
    holes = [h for h in holes if len(h.patch)]
    patch, textures = [h.patch for h in holes], [t for h in holes for t in h.textures]
    drawing.replace(background)
    if targets := [t for h in holes for t in targets_of(drawing, h.views, textures)]:
        radius = float(np.median([h.ball.radius for h in holes]))
        patch = [train_patch(background, concatenate(patch), targets, radius, progress, steps * len(holes))]
    else:
        progress("patch", 1.0)
    return concatenate([background, *patch])
