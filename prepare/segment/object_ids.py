"""Object ids of trained Gaussians by labels and a vote of neighbours; IoU with masks; objects by themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_dilation, binary_erosion, label
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from assets.gaussians import Gaussians, Report, concatenate
from core.errors import BadInput
from prepare.blending_weights import BlendingWeights
from prepare.progress import Progress, no_progress
from prepare.segment.mask_files import VIEWS_MIN, Masks, read_masks
from prepare.train.capture import Capture
from prepare.train.densification import logit
from prepare.train.object_labels import UNKNOWN, nearest_label
from prepare.train.photographs import Photograph, over
from prepare.train.train_options import TrainOptions
from prepare.train.trainer import Trainer

BACKGROUND = "background"  # name of the part that belongs to no object
NEIGHBOURS = 16  # that vote on a Gaussian
FURTHER_STEPS = 400  # of a training that goes on; some 50 that see a Gaussian move its label to an object
SOLID = 0.5  # opacity from which a pixel shows a surface
CELLS, BOUNDS = 24, (1.5, 98.5)  # cells along an object, between percentiles of its Gaussians' places
FAR_OUT = 3.0  # times the distance between quartiles; what lies farther beyond them is far out (Tukey 1977)
NEAREST, WIDTH = 6, 0.6  # Gaussians that tell the colour of a hidden side; standard deviation there, in cells


def masks_beside(capture: Capture, report: Report) -> Path | None:
    """The folder masks/ of a capture, or None if it is missing or empty.

    None also if transforms.json uses it for the pixels that count, which is reported.
    """
    beside = capture.folder / "masks"
    if not beside.is_dir() or not any(p.is_file() for p in beside.iterdir()):
        return None
    if any(v.mask is not None and v.mask.parent == beside for v in capture.views):
        report(f"{beside}: used as the pixels that count, as transforms.json says; as objects: --masks {beside}")
        return None
    return beside


def masks_of(capture: Capture, folder: Path | None, report: Report) -> tuple[Capture, Masks | None]:
    """The capture and the masks of its objects, in `folder` or in masks/ of the capture.

    Masks that transforms.json names select the pixels that count; they are object masks only if `folder` names them,
    and then all pixels count. It is reported if masks/ is not used. Raises BadInput for a given folder only.
    """
    found = folder or masks_beside(capture, report)
    if found is None:
        return capture, None
    try:
        masks = read_masks(found, capture.views)
    except BadInput as e:
        if folder is not None:
            raise
        report(f"masks/ is not used: {e}")
        return capture, None
    where = found.resolve()
    views = [replace(v, mask=None) if v.mask and v.mask.resolve().parent == where else v for v in capture.views]
    return replace(capture, views=views), masks


def check_learned(names: list[str], photographs: list[Photograph]) -> None:
    """Raise BadInput for an object that fewer than VIEWS_MIN of the training photographs show."""
    there = [np.unique(p.objects[p.mask]) for p in photographs if p.objects is not None]
    for k, name in enumerate(names, 1):
        count = sum(k in ids for ids in there)
        if count < VIEWS_MIN:
            raise BadInput(
                f"{name!r} is seen in {count} of the photographs that are learned from, {VIEWS_MIN} are needed; "
                "mask it in more (vrgs.py train --test-every 0 learns from all)"
            )


def identified(trainer, photographs: Sequence[Photograph]) -> Gaussians:
    """The Gaussians of a trainer that learned labels from photographs, with ids and names of their objects, after a
    vote, and after what was seen through objects is left to the background."""
    g, count = trainer.gaussians(), len(trainer.objects)
    ids = voted(g, nearest_label(trainer.labels(), count), trainer.evidence(), count)
    ids[seen_through(g.means.astype(np.float64), ids, photographs)] = 0
    return replace(g, object_id=ids.astype(np.uint16), objects=trainer.objects)


def seen_through(means: np.ndarray, ids: np.ndarray, photographs: Sequence[Photograph]) -> np.ndarray:
    """Mask (N,) of objects' Gaussians that lie outside of their object's masks in most photographs that show their
    places, or far from all others: a wall behind an object shows through it, and learns its label.

    Where a photograph shows another object, that may stand before them.
    """
    inside, outside = np.zeros(len(means), int), np.zeros(len(means), int)
    for p in photographs:
        if p.objects is None:
            continue
        x, y, z = p.camera.projected(means)
        rows = np.flatnonzero((z > 0) & (x >= 0) & (x < p.camera.width) & (y >= 0) & (y < p.camera.height))
        shown = p.objects[y[rows].astype(int), x[rows].astype(int)]
        inside[rows] += shown == ids[rows]
        outside[rows] += shown == 0
    found = (ids > 0) & (inside <= outside)
    for k in np.unique(ids[(ids > 0) & ~found]):
        own = np.flatnonzero((ids == k) & ~found)
        low, high = np.percentile(means[own], (25, 75), axis=0)
        reach = FAR_OUT * (high - low).max()
        found[own] = ((means[own] < low - reach) | (means[own] > high + reach)).any(axis=1)
    return found


def learned_objects(
    g: Gaussians,
    capture: Capture,
    photographs: list[Photograph],
    names: Sequence[str],
    progress: Progress = no_progress,
) -> Gaussians:
    """Learn the objects in the photographs' masks by a short further training with L_seg: returns the Gaussians with
    ids and names. Their number stays; those at the borders of objects adapt. Taichi must be running."""
    trainer = _further(g, capture, photographs, names)
    trainer.rates = replace(trainer.rates, mean=trainer.rates.mean_end)  # as at the end of the first training
    _run(trainer, "masks", progress)
    found = identified(trainer, photographs)
    trainer.destroy()
    return replace(found, view=g.view)


def trained_alone(
    g: Gaussians, capture: Capture, photographs: list[Photograph], progress: Progress = no_progress
) -> Gaussians:
    """The Gaussians, those of objects last, with closed hidden sides, after a short further training of the objects
    without the others, over ground of random colours: what the background hides of them or adds to them shows once they
    are moved. Taichi must be running.

    photographs  with the ids of what they show; the others are left out
    """
    own = g.object_id > 0
    targets, depths = objects_alone(g.select(own), g.select(~own), [p for p in photographs if p.objects is not None])
    if not targets:
        return g
    parts = [g.select(g.object_id == k) for k in np.unique(g.object_id[own])]
    whole = concatenate([*parts, *(hidden_sides(part, targets, depths) for part in parts)])
    found = _trained_on(whole, capture, targets, "objects alone", progress)
    return replace(concatenate([g.select(~own), found]), view=g.view)


def background_around(
    g: Gaussians, capture: Capture, photographs: list[Photograph], progress: Progress = no_progress
) -> Gaussians:
    """The Gaussians, those of objects last and as they are, bit for bit, after a short further training of the others:
    the background was learned beneath the soft edges that objects had before they were trained alone. Taichi must be
    running.

    Pixels that show objects do not count, or the background would mend these with colours that stay where they stood.
    """
    own = g.object_id > 0
    beside = [p if p.objects is None else p._replace(mask=p.mask & (p.objects == 0)) for p in photographs]
    beside = [p for p in beside if p.mask.any()]
    if own.all() or not own.any() or not beside:
        return g
    objects, rest = g.select(own), g.select(~own)
    around = concatenate([objects, rest])
    found = _trained_on(around, capture, beside, "background", progress, frozen=len(objects))
    return replace(concatenate([found.select(slice(len(objects), None)), objects]), view=g.view)


def objects_alone(
    own: Gaussians, rest: Gaussians, photographs: Sequence[Photograph]
) -> tuple[list[Photograph], list[np.ndarray]]:
    """Photographs of objects on transparent ground, by their masks, and the depth (H, W) of what each shows.

    Pixels do not count along a mask's border, which mix colours; where the `rest` stands before an object; and where
    the object is not drawn: what its mask took of something else is no part of it any more.
    """
    cameras = [p.camera for p in photographs]
    drawings, found, depths = [BlendingWeights(part, cameras) for part in (own, rest)], [], []
    for p in photographs:
        (_, depth, alpha), (_, rest_depth, rest_alpha) = (drawing.picture(p.camera) for drawing in drawings)
        inside, drawn = p.objects > 0, alpha > SOLID
        depth, rest_depth = np.where(drawn, depth, np.inf), np.where(rest_alpha > SOLID, rest_depth, np.inf)
        border = binary_dilation(inside) & binary_dilation(~inside)
        counts = np.where(inside, drawn, ~binary_dilation(drawn & (rest_depth < depth)))
        counts &= p.mask & (p.objects != UNKNOWN) & ~border
        if counts.any():
            alpha = 255 * inside.astype(np.uint8)
            found.append(Photograph(over(p.pixels, alpha), counts, p.camera, p.objects, alpha))
            depths.append(np.minimum(depth, rest_depth))
    for drawing in drawings:
        drawing.destroy()
    return found, depths


def hidden_sides(part: Gaussians, photographs: Sequence[Photograph], depths: Sequence[np.ndarray]) -> Gaussians:
    """Gaussians over the sides of an object that no photograph shows, in the colours of those nearest to them.

    The object is what photographs do not show to be empty, and most show as the object; of that the largest piece. Its
    cells at the border that no photograph shows become Gaussians. depths: (H, W) of what each photograph shows.
    """
    opaque = part.opaque()
    low, high = np.percentile(opaque.means.astype(np.float64), BOUNDS, axis=0)
    cell = (high - low).max() / CELLS
    shape = tuple(np.ceil((high - low) / cell).astype(int) + 1)
    points = low + cell * np.indices(shape).reshape(3, -1).T
    empty, seen, shown, as_object = (np.zeros(len(points), int) for _ in range(4))
    for p, depth in zip(photographs, depths, strict=True):
        x, y, z = p.camera.projected(points)
        rows = np.flatnonzero((z > 0) & (x >= 0) & (x < p.camera.width) & (y >= 0) & (y < p.camera.height))
        pixels, z = (y[rows].astype(int), x[rows].astype(int)), z[rows]
        rows, pixels, z = rows[known := p.objects[pixels] != UNKNOWN], tuple(a[known] for a in pixels), z[known]
        inside, there = p.objects[pixels] == part.object_id[0], depth[pixels]
        empty[rows] += there > z
        seen[rows] += inside & (np.abs(there - z) < 2 * cell)
        as_object[rows] += inside
        shown[rows] += 1
    pieces, count = label(((empty == 0) & (2 * as_object > shown)).reshape(shape))
    solid = pieces == 1 + np.argmax(np.bincount(pieces.ravel(), minlength=count + 1)[1:]) if count else pieces > 0
    places = points[(solid & ~binary_erosion(solid)).ravel() & (seen == 0)]
    if not len(places):
        return part.select(slice(0))
    away, near = cKDTree(opaque.means).query(places, k=min(NEAREST, len(opaque)))
    away, near = away.reshape(len(places), -1), near.reshape(len(places), -1)
    weight = 1.0 / np.maximum(away, cell) ** 2
    sh = np.zeros((len(places), *part.sh.shape[1:]))
    sh[:, 0] = np.einsum("nk,nkc->nc", weight / weight.sum(axis=1, keepdims=True), opaque.sh[near, 0])
    quats, scales = np.tile([1.0, 0.0, 0.0, 0.0], (len(places), 1)), np.full((len(places), 3), np.log(WIDTH * cell))
    ids = np.full(len(places), part.object_id[0], np.uint16)
    return Gaussians.of(places, quats, scales, np.full(len(places), logit(0.9)), sh, ids, part.objects)


def _trained_on(
    g: Gaussians, capture: Capture, photographs: list[Photograph], what: str, progress: Progress, frozen: int = 0
) -> Gaussians:
    """The same Gaussians, with their ids, after a short further training of all but the first `frozen`."""
    trainer = _further(g, capture, photographs, (), frozen)
    trainer.strategy.fading = 0.0  # nothing is pruned
    _run(trainer, what, progress)
    found = replace(trainer.gaussians(), object_id=g.object_id, objects=g.objects)
    trainer.destroy()
    return found


def _further(
    g: Gaussians, capture: Capture, photographs: list[Photograph], names: Sequence[str], frozen: int = 0
) -> Trainer:
    """A short training of all that is learned of Gaussians that were trained before, but the first `frozen`."""
    trained = {"degree": g.sh_degree, "sort": g.sort or "radial", "antialias": g.antialias, "frozen": frozen}
    options = TrainOptions(steps=FURTHER_STEPS, cap=len(g), free_space=False, **trained)
    return Trainer(photographs, g, capture.extent, options, names)


def _run(trainer: Trainer, what: str, progress: Progress) -> None:
    while trainer.done < trainer.options.steps:
        trainer.step()
        if trainer.done % 10 == 0:
            trainer.recent_loss()  # waits for the device
            progress(what, trainer.done / trainer.options.steps)


def voted(g: Gaussians, ids: np.ndarray, evidence: np.ndarray, count: int) -> np.ndarray:
    """Ids (N,) after a vote among each Gaussian's nearest neighbours, weighted by opacity, which removes small islands.

    evidence  mask pixels in which each Gaussian was visible, (N,). One that is as visible as its neighbours has as many
              votes as they have together: unseen ones, inside an object or faint, follow their neighbours, and a large
              one of a wall is not outvoted by many small ones in front of it.
    """
    near = cKDTree(g.means).query(g.means, k=min(NEIGHBOURS + 1, len(g)), workers=-1)[1].reshape(len(g), -1)
    weights, rows = g.opacities[near], np.arange(len(g))
    votes = np.stack([(weights * (ids[near] == k)).sum(axis=1) for k in range(count + 1)], axis=1)
    votes[rows, ids] += NEIGHBOURS * evidence / np.maximum(evidence[near].mean(axis=1), 1e-12)
    ids = votes.argmax(axis=1).astype(ids.dtype)
    apart = _islands(near, ids, count)
    votes = np.stack([(weights * (ids[near] == k) * ~apart[near]).sum(axis=1) for k in range(count + 1)], axis=1)
    return np.where(apart, votes.argmax(axis=1), ids).astype(ids.dtype)


def _islands(near: np.ndarray, ids: np.ndarray, count: int) -> np.ndarray:
    """Mask (N,) of pieces of objects with fewer Gaussians than voters, but the largest piece of each object: they lie
    far behind it and show through its pixels. Pieces are linked by neighbours `near` (N, K)."""
    i, j = np.nonzero(ids[near] == ids[:, None])
    links = coo_matrix((np.ones(len(i), np.uint8), (i, near[i, j])), shape=(len(ids), len(ids)))
    piece = connected_components(links, directed=False)[1]
    sizes = np.bincount(piece)
    apart = (sizes[piece] < NEIGHBOURS) & (ids > 0)
    for k in range(1, count + 1):
        own = piece[ids == k]
        if len(own):
            apart &= piece != own[sizes[own].argmax()]
    return apart


def object_ious(trainer, photographs: list[Photograph], ids: np.ndarray) -> dict[str, float]:
    """Intersection over union of the rendered ids and the masks over all photographs, by object name.

    Objects without a mask are left out.
    """
    count = len(trainer.objects)
    both, either, true = np.zeros(count + 1), np.zeros(count + 1), np.zeros(count + 1)
    for p in photographs:
        if p.objects is None:
            continue
        seen, truth = trainer.seen_objects(p.camera, ids)[p.mask], p.objects[p.mask]
        same = np.bincount(truth[seen == truth], minlength=count + 1)
        of_seen, of_truth = np.bincount(seen, minlength=count + 1), np.bincount(truth, minlength=count + 1)
        both, either, true = both + same, either + of_seen + of_truth - same, true + of_truth
    return {name: float(both[k] / either[k]) for k, name in enumerate(trainer.objects, 1) if true[k]}


def split(g: Gaussians) -> dict[str, Gaussians]:
    """The Gaussians of each object and of the background, by name, without empty parts; ids stay."""
    parts = {name: g.select(g.object_id == k) for k, name in enumerate(g.objects, 1)}
    parts[BACKGROUND] = g.select((g.object_id == 0) | (g.object_id > len(g.objects)))
    return {name: part for name, part in parts.items() if len(part)}


def part_file(out: Path, name: str) -> Path:
    """File of a part, beside that of the whole: room_bear.ply for room.ply."""
    stem = out.name.split(".", 1)[0] if out.name.lower().endswith(".compressed.ply") else out.stem
    return out.with_name(f"{stem}_{name}{out.name[len(stem) :]}")
