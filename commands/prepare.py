"""vrgs.py prepare: a splat file in, a simulatable asset out."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from assets.file_access import atomic_write_all, file_size
from assets.images import thumbnail_of
from assets.splat_files import read_gaussians
from assets.up_axis import describe_guess
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from prepare.checkpoints import Checkpoints
from prepare.pipeline import STAGES, VERSION, prepare
from prepare.progress import Progress, progress_on
from prepare.report import report_names, report_texts
from prepare.report_pictures import camera_for, splat_picture
from prepare.rig.rig_command import Mover, described, mover

APART = 0.05  # of the Gaussians; when more lie apart from the object, they are no floaters


def prepare_file(
    path: str | Path,
    out: str | Path,
    *,
    vertices: int = 2000,
    scale: float | None = None,
    up: str | None = None,
    material: str | None = None,
    rig: str | Path | None = None,
    landmarks: str | Path | None = None,
    mesher: str = "stuffing",
    cells: str = "adaptive",
    pieces: bool = False,
    progress: Progress | None = None,
    report: Callable[[str], None] = print,
    pictures: bool = False,
    page: bool = False,
) -> Path:
    """Prepare the splat file `path` and write the asset `out`, whole or not at all; `report` takes the summary.

    pictures  draw a thumbnail into the asset
    page      also write the report beside it: ASSET.report.html and ASSET.report.json

    The options are those of `prepare`; `cells` is "adaptive" or "uniform". With the motion of `rig`, a .glb, the body
    moves by itself; `landmarks` is a JSON file of where its joints are. `path` may be a .glb too: its skinned mesh.
    Raises BadInput, naming the file.
    """
    path, out = Path(path), Path(out)
    if path.suffix.lower() == ".h5":
        raise BadInput(f"{path}: is an asset already; a splat file (.ply, .spz, .sog ...) is needed")
    if pieces and (rig is not None or path.suffix.lower() == ".glb"):
        raise BadInput(f"{path}: what moves by a rig is one body; --pieces is for other splats")
    moved: Mover | None = mover(path, rig, landmarks)
    gaussians = read_gaussians(path, report) if moved is None or moved.gaussians is None else moved.gaussians
    if moved is not None:
        up, material = up or moved.up, material or moved.material
    bar = progress_on(sys.stderr, STAGES if moved is None else (*STAGES, "rig"))
    progress = progress or bar
    options = {"vertices": vertices, "scale": scale, "up": up, "material": material}
    options |= {} if cells == "adaptive" else {"adaptive": False}
    options |= {"pieces": True} if pieces else {}
    kept = Checkpoints(path, options | {"mesher": mesher}, VERSION)
    made, notes = [], []
    how = {"mesher": mesher, "progress": progress, "look": made.append, "say": notes.append, "kept": kept}
    try:
        try:
            asset = prepare(gaussians, **options, **how)
        except (BadInput, LookupError, TypeError, ValueError):
            if not kept.resumed:
                raise
            kept.clear()  # what was kept may be at fault
            made.clear()
            notes.clear()
            kept.resumed.clear()
            asset = prepare(gaussians, **options, **how)
        if moved is not None:
            progress("rig", 0.0)
            asset = moved.move(asset, DistanceGrid(made[0].phi, made[0].origin, float(made[0].spacing)))
            progress("rig", 1.0)
    except BadInput as e:
        kept.clear()
        raise BadInput(f"{path}: {e}") from e
    finally:
        bar.close()
    if kept.resumed:
        notes.append(f"went on after {kept.resumed[-1]}: a run before had come so far")
    asset = replace(asset, provenance={"source": path.name} | asset.provenance)
    splat = None
    if pictures or page:
        splat = splat_picture(asset, camera_for(asset.cage.vertices.astype(np.float64)))
        asset = replace(asset, thumbnail=thumbnail_of(splat))
    texts = report_texts(asset, made, out.name, notes=tuple(notes), splat=splat) if page else ()
    with atomic_write_all(out, *(report_names(out) if page else ())) as (beside, *others):
        asset.check(str(out))  # before `save` does, which would name the file beside
        asset.save(beside)
        for other, text in zip(others, texts, strict=True):
            other.write_text(text, encoding="utf-8")
    kept.clear()
    for line in notes + summary(asset.provenance):
        report(line)
    return out


def summary(provenance: dict) -> list[str]:
    """What was made, in a few lines."""
    counts, figures, options = provenance["counts"], provenance["figures"], provenance["options"]
    left_out = ", ".join(f"{counts[k]} {k}" for k in ("transparent", "huge", "apart", "stray") if counts[k])
    up = provenance["up"] if options["up"] else describe_guess(provenance["up"], provenance["up_sure"])
    size = f"{provenance['size']:.3g} m" + ("" if options["scale"] else " (guessed; --scale overrides)")
    moving = provenance.get("rig")
    apart, pieces = counts["apart"] + counts["stray"], []
    if figures["pieces"] > 1:
        pieces = [f"{figures['pieces']} pieces, each with a cage of its own; in a scene each is a body of its own"]
    elif apart > APART * counts["read"] and not options.get("pieces"):
        pieces = [
            f"the splat has pieces that lie apart: the largest is taken, {apart} Gaussians left out; --pieces keeps all"
        ]
    if counts.get("specks"):
        pieces.append(f"{counts['specks']} more pieces were too small or too flat for a cage and are left out")
    return pieces + [
        f"Gaussians: {counts['kept']} of {counts['read']}" + (f"; left out: {left_out}" if left_out else ""),
        f"up {up}, largest extent {size}",
        f"cage: {figures['vertices']} vertices, {figures['tets']} tets in {figures['cells']} cells, smallest angle "
        f"{figures['min_dihedral']:.1f} degrees, volume {1e6 * figures['volume']:.4g} cm^3",
        f"inside the cage: {figures['inside']:.2%} of the opaque Gaussians; {figures['seconds']:.1f} s",
        *(described(moving) if moving else ()),
    ]


def run(args: argparse.Namespace) -> None:
    """vrgs.py prepare SPLATS --out ASSET.h5 [--vertices N] [--scale S] [--up AXIS] [--material NAME] [--force]
    [--rig RIG.glb [--landmarks L.json]] [--cells adaptive|uniform] [--pieces]."""
    out = Path(args.out)
    file_size(Path(args.splats))  # before the other complaints
    if out.suffix.lower() != ".h5":
        raise BadInput(f"{out}: an asset's name ends in .h5")
    if not out.parent.is_dir():
        raise BadInput(f"{out}: the folder {out.parent} does not exist")
    for file in (out, *(() if args.no_report else report_names(out))):
        if file.exists() and not args.force:
            raise BadInput(f"{file}: exists already; --force overwrites it")
    names = ("vertices", "scale", "up", "material", "rig", "landmarks", "mesher", "cells", "pieces")
    options = {key: getattr(args, key) for key in names}
    prepare_file(args.splats, out, **options, pictures=True, page=not args.no_report)
    print(f"wrote {out}" + ("" if args.no_report else f" and {report_names(out)[0]}"))
