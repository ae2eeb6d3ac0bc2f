"""Object ids of trained Gaussians: from their labels and a vote of neighbours; IoU with masks; splitting by object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from assets.gaussians import Gaussians, Report
from core.errors import BadInput
from prepare.progress import Progress, no_progress
from prepare.segment.mask_files import VIEWS_MIN, Masks, read_masks
from prepare.train.capture import Capture
from prepare.train.object_labels import nearest_label
from prepare.train.photographs import Photograph
from prepare.train.train_options import TrainOptions
from prepare.train.trainer import Trainer

BACKGROUND = "background"  # name of the part that belongs to no object
NEIGHBOURS = 16  # that vote on a Gaussian
LEARNING_STEPS = 400  # of labels alone; some 50 that see a Gaussian move its label from the background to an object


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


def identified(trainer) -> Gaussians:
    """The Gaussians of a trainer that learned labels, with ids and names of their objects, after a vote."""
    g, count = trainer.gaussians(), len(trainer.objects)
    ids = voted(g, nearest_label(trainer.labels(), count), trainer.evidence(), count)
    return replace(g, object_id=ids.astype(np.uint16), objects=trainer.objects)


def learned_objects(
    g: Gaussians,
    capture: Capture,
    photographs: list[Photograph],
    names: Sequence[str],
    progress: Progress = no_progress,
) -> Gaussians:
    """Learn the objects in the photographs' masks by a short further training with L_seg: returns the Gaussians with
    ids and names. Their number stays; those at the borders of objects adapt. Taichi must be running."""
    trained = {"degree": g.sh_degree, "sort": g.sort or "radial", "antialias": g.antialias}
    options = TrainOptions(steps=LEARNING_STEPS, cap=len(g), free_space=False, **trained)
    trainer = Trainer(photographs, g, capture.extent, options, names)
    trainer.rates = replace(trainer.rates, mean=trainer.rates.mean_end)  # as at the end of the first training
    while trainer.done < options.steps:
        trainer.step()
        if trainer.done % 10 == 0:
            trainer.recent_loss()  # waits for the device
            progress("masks", trainer.done / options.steps)
    found = identified(trainer)
    trainer.destroy()
    return replace(found, view=g.view)


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
