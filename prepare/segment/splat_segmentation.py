"""Objects of a splat without photographs, from marks on its renderings: their Gaussians, and a file for each.

Gaussians that straddle the border of an object are cut in two, one part on each side.

A Gaussian cut by a plane is, on each side, a truncated normal distribution; the Gaussian with its moments takes its
place. With t the distance of the plane from the mean in standard deviations across it, u the unit normal to the own
side, s^2 = u^T Sigma u and l = phi(t) / Phi(t):

    mu' = mu + l Sigma u / s,   Sigma' = Sigma - (1 - v) Sigma u u^T Sigma / s^2,   v = 1 - t l - l^2
                                                                after GaussianTrimmer (arXiv 2601.12683)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import log_ndtr, logit

from assets.file_access import atomic_write_all, make_folder
from assets.formats.ply import write_ply
from assets.gaussians import Gaussians, concatenate, symmetric_matrices
from core.camera import Camera
from core.errors import BadInput
from core.rotation import quaternions_from_matrices
from core.spherical_harmonics import C0
from prepare.blending_weights import BlendingWeights
from prepare.segment.graph_cut import mahalanobis
from prepare.segment.marks import SplatMarks, ViewMarks
from prepare.segment.mask_files import object_colors
from prepare.segment.object_ids import split
from prepare.segment.splat_selection import Seeds, SplatSelection, ViewSeeds, view_seeds

RESERVED = ("background", "scene")  # names of output files
OVERLAY = 0.55  # opacity of an object's colour over the picture
SMALLEST = 10  # least number of Gaussians of an object
REACH = 2.0  # standard deviations: a Gaussian covers neighbours within this distance
COVERED_MAX = 48  # covered neighbours that are used to locate the border
OTHERS_MIN = 0.3  # share of covered neighbours on the other side; with fewer it only touches the border
FLATNESS = 0.1  # relative thickness at least assumed, so that a flat Gaussian covers its neighbours in the surface
OPACITY_MAX = 0.999  # as in the renderer


@dataclass(frozen=True)
class SegmentedSplat:
    """A splat whose Gaussians have the ids of objects; `cut` of them straddled a border and were split in two."""

    gaussians: Gaussians
    cut: int


def segment_splat(gaussians: Gaussians, marks: SplatMarks, report: Callable[[str], None]) -> SegmentedSplat:
    """Give each marked object's Gaussians its id, in the order of the marks. Taichi must be running.

    Raises BadInput for marks without a Gaussian under them, and for an object that ends up empty.
    """
    live, names = LiveSelection(gaussians), list(marks.marks.objects)
    counts = live.select(marks, {name: k for k, name in enumerate(names, 1)})
    live.destroy()
    for name in names:
        if counts.get(name, 0) < SMALLEST:
            raise BadInput(f"{name!r}: only {counts.get(name, 0)} Gaussians are left of it; mark more of it")
        report(f"{name}: {counts[name]:,} Gaussians")
    return with_ids(gaussians, live.ids, names)


def with_ids(gaussians: Gaussians, ids: np.ndarray, names: list[str]) -> SegmentedSplat:
    """The Gaussians with ids of objects (N,), and those cut in two that straddle a border."""
    count = 0
    for k in range(1, len(names) + 1):
        before = ids
        gaussians, own, more = trimmed(gaussians, ids == k)
        ids = np.concatenate([before, np.zeros(len(own) - len(before), before.dtype)])
        # A part that is cut off an object goes to the background, and what is cut off that to the object.
        ids[len(before) :][own[len(before) :]] = k
        count += more
    return SegmentedSplat(replace(gaussians, object_id=ids.astype(np.uint16), objects=tuple(names)), count)


def output_files(folder: Path, names: list[str]) -> dict[str, Path]:
    """The files of each object, of the background and of the whole scene. Raises BadInput."""
    for name in names:
        if name.lower() in RESERVED:
            raise BadInput(f"an object cannot be called {name!r}: a file has that name; choose another")
    return {name: folder / f"{name}.ply" for name in (*names, *RESERVED)}


def write_segmented(folder: Path, segmented: SegmentedSplat) -> dict[str, Path]:
    """Write a splat per object, `background.ply`, and `scene.ply` with all ids; all or none. Raises BadInput."""
    make_folder(folder)
    parts = split(segmented.gaussians) | {"scene": segmented.gaussians}
    files = {
        name: path for name, path in output_files(folder, list(segmented.gaussians.objects)).items() if name in parts
    }
    with atomic_write_all(*files.values()) as besides:
        for beside, name in zip(besides, files, strict=True):
            write_ply(beside, parts[name])
    return files


def painted(gaussians: Gaussians, objects: int) -> Gaussians:
    """The Gaussians with those of the objects 1, 2, ... tinted in their colours."""
    colors = np.concatenate([np.zeros((1, 3)), object_colors(objects) / 255.0])[gaussians.object_id]
    chosen = gaussians.object_id > 0
    plain = gaussians.with_sh_degree(0)
    sh = plain.sh.copy()
    sh[chosen, 0] = (1 - OVERLAY) * sh[chosen, 0] + OVERLAY * (colors[chosen] - 0.5) / C0
    return replace(plain, sh=sh)


def overlay_of(segmented: SegmentedSplat, marks: SplatMarks) -> dict[str, np.ndarray]:
    """A picture of each marked view with the objects in colours, (H, W, 3) uint8 RGB. Taichi must be running."""
    g = segmented.gaussians
    weights = BlendingWeights(painted(g, len(g.objects)), sort="z")
    pictures = {name: weights.picture(marks.cameras[name])[0] for name in marks.marks.views}
    weights.destroy()
    return {name: (p.clip(0.0, 1.0) * 255.0 + 0.5).astype(np.uint8) for name, p in pictures.items()}


class LiveSelection:
    """Selects the marked objects of a splat again as marks change, and draws them in colours. Taichi must be running.

    ids  (N,) uint16 of the objects that the Gaussians are selected for, 0: none
    """

    def __init__(self, gaussians: Gaussians):
        self.ids = np.zeros(len(gaussians), np.uint16)
        self._gaussians, self._selection = gaussians, SplatSelection(gaussians)
        self._drawn = BlendingWeights(painted(replace(gaussians, object_id=self.ids), 1), sort="z")
        self._seeds: dict[tuple, ViewSeeds] = {}

    def select(self, marks: SplatMarks, numbers: Mapping[str, int]) -> dict[str, int]:
        """Select all objects with marks inside, in order; returns the number of Gaussians of each.

        numbers  ids of the objects by name, 1, 2, ... Raises BadInput if no Gaussian lies under an object's marks.
        """
        objects = {n: v for n, v in marks.marks.objects.items() if any(m.inside or m.boxes for m in v.values())}
        seeds = [
            Seeds(len(self.ids), [self._of_view(marks.cameras[view], mark) for view, mark in views.items()])
            for views in objects.values()
        ]
        ids = np.zeros_like(self.ids)
        for name, own in zip(objects, seeds, strict=True):
            if not own.inside.any():
                raise BadInput(f"{name!r}: no Gaussian lies under its marks inside")
            others = np.logical_or.reduce([np.zeros(len(ids), bool), *(s.inside for s in seeds if s is not own)])
            cut = self._selection.select(own.inside & ~others, own.outside | others, own.barred | (ids > 0))
            ids[self._selection.grown(cut, marks.grow.get(name, 0)) & (ids == 0)] = numbers[name]
        self.ids = ids
        self._drawn.recolour(painted(replace(self._gaussians, object_id=ids), max(numbers.values())).sh)
        return {name: int((ids == numbers[name]).sum()) for name in objects}

    def _of_view(self, camera: Camera, marks: ViewMarks) -> ViewSeeds:
        """Seeds of an object by its marks in a view."""
        kinds = (tuple(array.tobytes() for array in kind) for kind in (marks.inside, marks.outside, marks.boxes))
        key = (camera.world_to_camera.tobytes(), *kinds)
        if key not in self._seeds:
            self._seeds[key] = view_seeds(self._gaussians, self._drawn, camera, marks)
        return self._seeds[key]

    def picture(self, camera: Camera) -> np.ndarray:
        """Picture (H, W, 3) uint8 RGB."""
        return (self._drawn.picture(camera)[0].clip(0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)

    def destroy(self) -> None:
        """Free the device memory."""
        self._drawn.destroy()
        self._selection.destroy()


def trimmed(gaussians: Gaussians, selected: np.ndarray) -> tuple[Gaussians, np.ndarray, int]:
    """Cut the Gaussians that straddle the border of a selection (N,) bool in two; the parts beyond it are appended.

    Returns all Gaussians, the selection among them, and how many were cut.
    """
    which, normal, distance = straddlers(gaussians, selected)
    if not len(which):
        return gaussians, selected, 0
    g = gaussians.select(which)
    own, rest = halves(g, normal, distance)
    arrays = {name: getattr(gaussians, name).copy() for name in ("means", "quats", "log_scales", "logit_opacities")}
    for name, array in arrays.items():
        array[which] = getattr(own, name)
    whole = concatenate([replace(gaussians, **arrays), rest])
    return whole, np.concatenate([selected, ~selected[which]]), len(which)


def straddlers(gaussians: Gaussians, selected: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gaussians that straddle the border of a selection: their indices (K,), unit normals (K, 3) of the border towards
    their own side, and its distance (K,) from their means in standard deviations."""
    nothing = np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0)
    if not selected.any() or selected.all():
        return nothing
    points = gaussians.means.astype(np.float64)
    radius = REACH * np.exp(gaussians.log_scales.astype(np.float64)).max(1)
    near = np.zeros(len(points), bool)
    for side in (selected, ~selected):
        low, high = points[~side].min(0), points[~side].max(0)
        candidates = np.flatnonzero(
            side & ((points > low - radius[:, None]) & (points < high + radius[:, None])).all(1)
        )
        gap = cKDTree(points[~side]).query(points[candidates], workers=-1)[0]
        near[candidates[gap < radius[candidates]]] = True
    which = np.flatnonzero(near)
    if not len(which):
        return nothing
    count = min(COVERED_MAX + 1, len(points))
    index = cKDTree(points).query(points[which], count, workers=-1)[1][:, 1:]
    offset = points[index] - points[which][:, None]
    sigma = gaussians.covariances[which]
    slab = (FLATNESS * np.exp(np.median(gaussians.log_scales[which].astype(np.float64), axis=1))) ** 2
    k = index.shape[1]
    gap = mahalanobis(offset.reshape(-1, 3), np.repeat(sigma, k, axis=0), np.repeat(slab, k)).reshape(-1, k)
    weight = np.where(gap < REACH**2, np.exp(-0.5 * gap), 0.0)
    side = np.where(selected[index] == selected[which][:, None], 1.0, -1.0)
    total = weight.sum(1)
    others = (weight * (side < 0)).sum(1)
    normal, shift = fitted_planes(offset, side, weight)
    full = symmetric_matrices(sigma)
    across = np.sqrt(np.einsum("ki,kij,kj->k", normal, full, normal).clip(1e-30))
    distance = (shift / across).clip(0.0, None)
    # One whose covered neighbours are all on the other side lies under the thing, or is wider than they reach.
    keep = (others > OTHERS_MIN * total) & (others < (1.0 - OTHERS_MIN) * total)
    return which[keep], normal[keep], distance[keep]


def fitted_planes(offset: np.ndarray, side: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Planes between points (K, M, 3) of two sides (K, M), 1 and -1, by weighted least squares: unit normals (K, 3)
    towards side 1, and the distance (K,) of the origin from the plane, positive on that side."""
    scale = np.sqrt((weight[..., None] * offset**2).sum((1, 2)) / np.maximum(weight.sum(1), 1e-30)).clip(1e-12)
    x = np.concatenate([offset / scale[:, None, None], np.ones((*side.shape, 1))], axis=2)
    normal_matrix = np.einsum("km,kmi,kmj->kij", weight, x, x)
    ridge = 1e-2 * np.trace(normal_matrix, axis1=1, axis2=2).clip(1e-12)
    normal_matrix += ridge[:, None, None] * np.diag([1.0, 1.0, 1.0, 1e-3])
    plane = np.linalg.solve(normal_matrix, np.einsum("km,km,kmi->ki", weight, side, x)[..., None])[..., 0]
    length = np.linalg.norm(plane[:, :3], axis=1).clip(1e-12)
    return plane[:, :3] / length[:, None], plane[:, 3] / length * scale


def halves(g: Gaussians, normal: np.ndarray, distance: np.ndarray) -> tuple[Gaussians, Gaussians]:
    """Cut each Gaussian by a plane: the part on its own side, to which `normal` (K, 3) points, and the part beyond. The
    plane lies `distance` (K,) standard deviations from the mean. The mass is kept."""
    return _part(g, normal, distance), _part(g, -normal, -distance)


def _part(g: Gaussians, normal: np.ndarray, t: np.ndarray) -> Gaussians:
    sigma = symmetric_matrices(g.covariances)
    across = np.einsum("kij,kj->ki", sigma, normal)
    s = np.sqrt(np.einsum("ki,ki->k", normal, across).clip(1e-30))
    log_mass = log_ndtr(t)
    ratio = np.exp(-0.5 * t * t - 0.5 * np.log(2 * np.pi) - log_mass)  # phi / Phi
    variance = (1.0 - t * ratio - ratio**2).clip(1e-3, 1.0)
    means = g.means + (ratio / s)[:, None] * across
    sigma = sigma - ((1.0 - variance) / s**2)[:, None, None] * across[:, :, None] * across[:, None, :]
    values, axes = np.linalg.eigh(sigma)
    axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]
    opacity = (g.opacities * np.exp(log_mass) / np.sqrt(variance)).clip(1e-6, OPACITY_MAX)
    log_scales = 0.5 * np.log(values.clip(1e-16, None))
    shape = {"means": means, "quats": quaternions_from_matrices(axes), "log_scales": log_scales}
    shape["logit_opacities"] = logit(opacity)
    return replace(g, **{name: values.astype(np.float32) for name, values in shape.items()})
