"""Objects of a splat without photographs, from marks on its renderings: their Gaussians, and a file for each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import numpy as np

from assets.file_access import atomic_write_all, make_folder
from assets.formats.ply import write_ply
from assets.gaussians import Gaussians
from core.errors import BadInput
from core.spherical_harmonics import C0
from prepare.blending_weights import BlendingWeights
from prepare.segment.mask_files import object_colors
from prepare.segment.object_ids import split
from prepare.segment.splat_marks import SplatMarks
from prepare.segment.splat_seeds import Seeds, seeds_of
from prepare.segment.splat_selection import SplatSelection
from prepare.segment.trimming import trimmed

RESERVED = ("background", "scene")  # names of output files
OVERLAY = 0.55  # opacity of an object's colour over the picture
SMALLEST = 10  # least number of Gaussians of an object


@dataclass(frozen=True)
class SegmentedSplat:
    """A splat whose Gaussians have the ids of objects; `cut` of them straddled a border and were split in two."""

    gaussians: Gaussians
    cut: int


def segment_splat(gaussians: Gaussians, marks: SplatMarks, report: Callable[[str], None]) -> SegmentedSplat:
    """Give each marked object's Gaussians its id, in the order of the marks. Taichi must be running.

    Raises BadInput for marks without a Gaussian under them, and for an object that ends up empty.
    """
    selection = SplatSelection(gaussians)
    weights = BlendingWeights(gaussians)
    names = list(marks.marks.objects)
    seeds = [seeds_of(gaussians, weights, marks.cameras, marks.marks.objects[name]) for name in names]
    weights.destroy()
    ids = np.zeros(len(gaussians), np.uint16)
    for k, (name, own) in enumerate(zip(names, seeds, strict=True), 1):
        start = perf_counter()
        ids[selected(selection, name, own, seeds, ids, marks.grow.get(name, 0))] = k
        count = int((ids == k).sum())
        if count < SMALLEST:
            raise BadInput(f"{name!r}: only {count} Gaussians are left of it; mark more of it")
        report(f"{name}: {count:,} Gaussians, {perf_counter() - start:.1f} s")
    selection.destroy()
    return with_ids(gaussians, ids, names)


def selected(selection: SplatSelection, name: str, own: Seeds, seeds: list[Seeds], ids, rings: int) -> np.ndarray:
    """Gaussians (N,) bool of an object, none of those that `ids` (N,) give to another one. Raises BadInput."""
    others = np.zeros(len(ids), bool)
    for other in seeds:
        if other is not own:
            others |= other.inside
    if not own.inside.any():
        raise BadInput(f"{name!r}: no Gaussian lies under its marks inside")
    cut = selection.select(own.inside & ~others, own.outside | others, own.barred | (ids > 0))
    return selection.grown(cut, rings) & (ids == 0)


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
    weights = BlendingWeights(painted(g, len(g.objects)))
    pictures = {name: weights.picture(marks.cameras[name])[0] for name in marks.marks.views}
    weights.destroy()
    return {name: (p.clip(0.0, 1.0) * 255.0 + 0.5).astype(np.uint8) for name, p in pictures.items()}
