"""vrgs.py prepare --static: the splat of a room or a garden in, a stage to play on out."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from assets.file_access import atomic_write_all, file_size
from assets.formats.ply import write_ply
from assets.splat_files import read_gaussians
from assets.up_axis import describe_guess
from core.errors import BadInput
from prepare.pipeline import Progress
from prepare.progress import progress_on
from prepare.room.static_scene import STAGES, prepare_static

SHOWN = 8  # planes that the summary names


def prepare_stage_file(
    path: str | Path,
    out: str | Path,
    *,
    up: str | None = None,
    scale: float | None = None,
    cell: float | None = None,
    cut: tuple[int, ...] = (),
    progress: Progress | None = None,
    report: Callable[[str], None] = print,
) -> list[Path]:
    """Prepare the scene `path` and write the asset `out`, whole or not at all, and OUT_objectK.ply for each id K that
    is cut out; all of these files. `report` takes the summary. Raises BadInput, naming the file."""
    path, out = Path(path), Path(out)
    gaussians = read_gaussians(path, report)
    bar = progress_on(sys.stderr, STAGES)
    how = {"up": up, "scale": scale, "cell": cell, "cut": cut, "progress": progress or bar}
    try:
        asset, pieces = prepare_static(gaussians, **how)
    except BadInput as e:
        raise BadInput(f"{path}: {e}") from e
    finally:
        bar.close()
    asset = replace(asset, provenance={"source": path.name} | asset.provenance)
    files = [out, *(piece_name(out, k) for k in pieces)]
    asset.check(str(out))
    with atomic_write_all(*files) as (beside, *others):
        for other, piece in zip(others, pieces.values(), strict=True):
            write_ply(other, piece)
        asset.save(beside)
    for k, piece in pieces.items():
        report(f"object {k}: {len(piece)} Gaussians cut out")
    for line in summary(asset):
        report(line)
    return files


def piece_name(out: Path, object_id: int) -> Path:
    """Where the Gaussians of an id go."""
    return out.with_name(f"{out.stem}_object{object_id}.ply")


def summary(asset) -> list[str]:
    """What was found, in a few lines."""
    p, s = asset.provenance, asset.environment
    options = p["options"]
    up = p["up"] if options["up"] else describe_guess(p["up"], p["up_sure"])
    size = f"{p['size']:.3g} m" + ("" if options["scale"] else " (guessed; --scale overrides)")
    grids = ", ".join(f"{n:,} cells of {1000 * h:.0f} mm" for n, h in zip(p["cells"], p["spacings"], strict=True))
    lines = [f"{len(asset.gaussians):,} Gaussians, up {up}, leaning by {p['lean']:.1f} degrees, largest extent {size}"]
    for kind, height, x0, z0, x1, z1 in s.planes[:SHOWN]:
        lines.append(
            f"  {kind:5} at {height:5.2f} m, {x1 - x0:.2f} x {z1 - z0:.2f} m round ({x0 + x1:.2f}, {z0 + z1:.2f})/2"
        )
    if len(s.planes) > SHOWN:
        lines.append(f"  and {len(s.planes) - SHOWN} more planes")
    lines.append(f"bodies drop on the {p['drop_on']}, where a disc of {s.clear_radius:.2f} m is free; grids: {grids}")
    return [*lines, f"{p['seconds']:.1f} s"]


def run(args: argparse.Namespace) -> None:
    """vrgs.py prepare SPLATS --static --out ROOM.h5 [--up AXIS] [--scale M] [--cell M] [--cut ID ...] [--force]."""
    out = Path(args.out)
    if not args.static:
        raise BadInput("--cell and --cut belong to --static")
    if args.material is not None:
        raise BadInput("--material belongs to bodies; with --static nothing is simulated")
    if args.pieces:
        raise BadInput("--pieces belongs to bodies; objects are taken out of a scene with --cut")
    file_size(Path(args.splats))
    if out.suffix.lower() != ".h5":
        raise BadInput(f"{out}: an asset's name ends in .h5")
    if not out.parent.is_dir():
        raise BadInput(f"{out}: the folder {out.parent} does not exist")
    cut = tuple(sorted(set(args.cut or ())))
    for file in (out, *(piece_name(out, k) for k in cut)):
        if file.exists() and not args.force:
            raise BadInput(f"{file}: exists already; --force overwrites it")
    options = {"up": args.up, "scale": args.scale, "cell": args.cell, "cut": cut}
    for file in prepare_stage_file(args.splats, out, **options):
        print(f"wrote {file}")
