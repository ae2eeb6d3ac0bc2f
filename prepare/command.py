"""vrgs.py prepare: a splat file in, a simulatable asset out."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from assets.border import file_size
from assets.errors import BadInput
from assets.files import read_gaussians
from prepare.pipeline import STAGES, Progress, prepare
from prepare.report import report_names, write_report

APART = 0.05  # of the Gaussians; when more lie apart from the object, they are no floaters


class ProgressLines:
    """Prints a line a stage on stderr when it ends, with the time it took."""

    def __init__(self) -> None:
        self.stage, self.since = None, time.perf_counter()

    def __call__(self, stage: str, done: float) -> None:
        if stage != self.stage:
            self._end()
            self.stage, self.since = stage, time.perf_counter()
        if done >= 1:
            self._end()

    def _end(self) -> None:
        if self.stage is not None:
            number = STAGES.index(self.stage) + 1
            seconds = time.perf_counter() - self.since
            print(f"  {number}/{len(STAGES)} {self.stage:<8} {seconds:5.1f} s", file=sys.stderr, flush=True)
        self.stage = None


def prepare_file(
    path: str | Path,
    out: str | Path,
    *,
    vertices: int = 2000,
    scale: float | None = None,
    up: str | None = None,
    material: str | None = None,
    mesher: str = "stuffing",
    progress: Progress | None = None,
    report: Callable[[str], None] = print,
    pictures: bool = False,
) -> Path:
    """Prepare the splat file `path` and write the asset `out`, whole or not at all; `report` takes the summary.

    pictures  also write the report beside it: ASSET.report.html and ASSET.report.json

    The options are those of `prepare`. Raises BadInput, naming the file.
    """
    path, out = Path(path), Path(out)
    if path.suffix.lower() == ".h5":
        raise BadInput(f"{path}: is an asset already; a splat file (.ply, .spz, .sog ...) is needed")
    gaussians = read_gaussians(path, report)
    progress = progress or ProgressLines()
    options = {"vertices": vertices, "scale": scale, "up": up, "material": material}
    made, notes = [], []
    try:
        asset = prepare(gaussians, **options, mesher=mesher, progress=progress, look=made.append, say=notes.append)
    except BadInput as e:
        raise BadInput(f"{path}: {e}") from e
    asset = replace(asset, provenance={"source": path.name} | asset.provenance)
    asset.save(out)
    for line in notes + summary(asset.provenance):
        report(line)
    if pictures:
        write_report(asset, made[0], out, notes=tuple(notes))
    return out


def summary(provenance: dict) -> list[str]:
    """What was made, in a few lines."""
    counts, figures, options = provenance["counts"], provenance["figures"], provenance["options"]
    left_out = ", ".join(f"{counts[k]} {k}" for k in ("transparent", "huge", "apart", "stray") if counts[k])
    up = provenance["up"] if options["up"] else f"{provenance['up']} (guessed; --up overrides)"
    size = f"{provenance['size']:.3g} m" + ("" if options["scale"] else " (guessed; --scale overrides)")
    pieces = []
    if counts["apart"] > APART * counts["read"]:
        pieces = [f"the splat has pieces that lie apart: the largest is taken, {counts['apart']} Gaussians left out"]
    return pieces + [
        f"Gaussians: {counts['kept']} of {counts['read']}" + (f"; left out: {left_out}" if left_out else ""),
        f"up {up}, largest extent {size}",
        f"cage: {figures['vertices']} vertices, {figures['tets']} tets, smallest dihedral angle "
        f"{figures['min_dihedral']:.1f} degrees, volume {1e6 * figures['volume']:.4g} cm^3",
        f"inside the cage: {figures['inside']:.2%} of the opaque Gaussians; {figures['seconds']:.1f} s",
    ]


def run(args: argparse.Namespace) -> None:
    """vrgs.py prepare SPLATS --out ASSET.h5 [--vertices N] [--scale S] [--up AXIS] [--material NAME] [--force]."""
    out = Path(args.out)
    file_size(Path(args.splats))  # before the other complaints
    if out.suffix.lower() != ".h5":
        raise BadInput(f"{out}: an asset's name ends in .h5")
    if not out.parent.is_dir():
        raise BadInput(f"{out}: the folder {out.parent} does not exist")
    if out.exists() and not args.force:
        raise BadInput(f"{out}: exists already; --force overwrites it")
    options = {"vertices": args.vertices, "scale": args.scale, "up": args.up, "material": args.material}
    prepare_file(args.splats, out, **options, mesher=args.mesher, pictures=not args.no_report)
    print(f"wrote {out}" + ("" if args.no_report else f" and {report_names(out)[0]}"))
