"""The patch of new Gaussians that closes a hole: seeded on its surfaces, trained with all others frozen; its PSNR."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.ndimage import binary_dilation

from assets.gaussians import SH_COUNTS, Gaussians, concatenate
from core.program import in_threads
from core.rotation import quaternions_from_matrices
from core.spherical_harmonics import C0
from prepare.blending_weights import BlendingWeights
from prepare.inpaint.hole_views import SOLID, HoleView, spread_indices
from prepare.inpaint.support_surface import SurfaceTexture
from prepare.progress import Progress
from prepare.train.densification import logit
from prepare.train.photographs import Photograph

SEEDS = (400, 20_000)  # least and most new Gaussians of a surface
OPACITY = 0.95
WIDTH, THICKNESS = 0.6, 0.1  # standard deviations along the surface and across it, in spacings
RIM = 8  # [px] around the hole in which the patch must not change the picture
VIEWS_MAX = 16  # views used in training
HOLE_PIXELS = 20  # a view that shows fewer is not used
PSNR_MAX = 99.0  # [dB] reported for equal pictures


def seed_patch(texture: SurfaceTexture, background: Gaussians, degree: int) -> Gaussians:
    """Gaussians over the hole of a surface, in its colours and as dense as the background is on the known part."""
    spacing = _spacing(texture, background)
    extent = texture.texel * np.array(texture.hole.shape[::-1])
    steps = np.floor(extent / spacing).astype(int)
    v, u = np.mgrid[: steps[1], : steps[0]]
    places = texture.corner + spacing * np.stack([u + 0.25 + 0.5 * (v % 2), v + 0.5], axis=-1).reshape(-1, 2)
    wide = cv2.dilate(texture.hole.astype(np.uint8), np.ones((3, 3), np.uint8))
    places = places[texture.sample(wide > 0, places) > 0]
    color = texture.sample(texture.color, places)
    n, sh = len(places), np.zeros((len(places), SH_COUNTS[degree], 3))
    sh[:, 0] = (color - 0.5) / C0
    axes = texture.surface.axes.T  # columns: along, along, across
    scales = np.log(spacing * np.array([WIDTH, WIDTH, THICKNESS]))
    quats = np.tile(quaternions_from_matrices(axes), (n, 1))
    return Gaussians.of(texture.surface.points(places), quats, np.tile(scales, (n, 1)), np.full(n, logit(OPACITY)), sh)


def _spacing(texture: SurfaceTexture, background: Gaussians) -> float:
    """Distance [m] between neighbouring Gaussians on the known part of the surface, within the bounds of SEEDS."""
    local = texture.surface.local(background.means.astype(np.float64))
    near = (np.abs(local[:, 2]) < 2 * texture.texel + 3 * texture.surface.spread) & (background.opacities > 0.3)
    on = texture.sample(texture.known, local[near, :2]) > 0
    spacing = texture.texel * np.sqrt(texture.known.sum() / max(1, on.sum()))
    low, high = (np.sqrt(texture.area / n) for n in SEEDS[::-1])
    return float(np.clip(spacing, max(low, texture.texel), max(high, texture.texel)))


def target(view: HoleView, textures: list[SurfaceTexture]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Target of a view: colour (H, W, 3), and masks (H, W) of the hole and of the pixels to train on."""
    c = view.camera
    y, x = np.mgrid[: c.height, : c.width]
    rays = np.stack([(x + 0.5 - c.cx) / c.fx, (y + 0.5 - c.cy) / c.fy, np.ones(x.shape)], axis=-1)
    rays = rays @ c.world_to_camera[:3, :3]  # of depth 1
    color, hole, nearest = view.color.copy(), np.zeros(x.shape, bool), np.full(x.shape, np.inf)
    for texture in textures:
        surface = texture.surface
        eye, slope = surface.local(c.position), rays @ surface.axes.T
        falling = (slope[..., 2] < -1e-9) & (eye[2] > 0)
        depth = np.where(falling, -eye[2] / np.minimum(slope[..., 2], -1e-9), np.inf)
        places = eye[:2] + np.where(falling, depth, 0.0)[..., None] * slope[..., :2]
        occluded = (view.alpha > SOLID) & ((view.depth - depth) * slope[..., 2] > 3 * texture.texel)
        own = (texture.sample(texture.hole, places) > 0) & falling & ~occluded
        own &= depth < nearest
        color[own], nearest[own] = texture.sample(texture.color, places)[own], depth[own]
        hole |= own
    return color, hole, binary_dilation(hole, iterations=RIM)


def targets_of(drawing: BlendingWeights, views: list[HoleView], textures: list[SurfaceTexture]) -> list[Photograph]:
    """Pictures to train patches on: the background as it is drawn now, and painted textures, from views of a hole."""
    views = [replace(v, color=drawing.picture(v.camera)[0]) for v in views]
    found = []
    for view, (color, pixels, counts) in zip(views, in_threads(lambda v: target(v, textures), views), strict=True):
        if pixels.sum() >= HOLE_PIXELS:
            picture = (color.clip(0.0, 1.0) * 255).round().astype(np.uint8)
            found.append(Photograph(picture, counts, view.camera))
    return [found[i] for i in spread_indices(len(found), VIEWS_MAX)]


def train_patch(
    background: Gaussians, patch: Gaussians, targets: list[Photograph], extent: float, progress: Progress, steps: int
) -> Gaussians:
    """Train the patch on the targets, with the background frozen, and return it."""
    from prepare.train.trainer import Trainer, TrainOptions

    start = concatenate([background, patch])
    options = TrainOptions(
        steps=steps,
        cap=len(start),
        degree=start.sh_degree,
        sort=start.sort or "radial",
        antialias=start.antialias,
        frozen=len(background),
        sparse=True,  # a view shows one of the holes
        free_space=False,  # nobody stood where its views are drawn from
    )
    trainer = Trainer(targets, start, extent, options)
    for k in range(steps):
        trainer.step()
        if k % 10 == 9 or k + 1 == steps:
            trainer.recent_loss()  # waits for the device
            progress("patch", (k + 1) / steps)
    grown = trainer.population.gaussians()
    trainer.destroy()
    return grown.select(slice(len(background), None))


@dataclass(frozen=True)
class Comparison:
    """Pictures (H, W, 3) float32 of a view before and after inpainting and, if known, of the truth; masks (H, W) of
    the pixels that the object covered and of those of the hole."""

    view: HoleView
    before: np.ndarray
    after: np.ndarray
    truth: np.ndarray | None
    covered: np.ndarray
    hole: np.ndarray


def compare(
    views: list[HoleView],
    textures: list[SurfaceTexture],
    before: Gaussians,
    after: Gaussians,
    truths: Sequence[Photograph | None],
) -> list[Comparison]:
    """Draw each view of a hole before and after. `truths`: photographs without the object, one a camera, or none."""
    cameras = [v.camera for v in views]
    drawings = [BlendingWeights(g, cameras) for g in (before, after)]
    found = []
    for view in views:
        pictures = [drawing.picture(view.camera)[0].clip(0.0, 1.0) for drawing in drawings]
        photograph = truths[view.index] if truths else None
        truth = None if photograph is None else cut_out(photograph, view)
        found.append(Comparison(view, *pictures, truth, view.in_front(), target(view, textures)[1]))
    for drawing in drawings:
        drawing.destroy()
    return found


def cut_out(photograph: Photograph, view: HoleView) -> np.ndarray:
    """The part of a photograph that a view shows, resized to the view, (H, W, 3) float32."""
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
                error[when] = float(min(PSNR_MAX, -10 * np.log10(max(squares.mean(), 1e-12))))
        found[name] = error
    return found
