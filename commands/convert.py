"""`vrgs.py convert`: convert between splat formats."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from assets.formats.ply import chunk_order
from assets.gaussians import SH_COUNTS, Gaussians
from assets.splat_files import COMPRESSED, kind_to_write, read_gaussians, write_gaussians
from commands import options as cli
from core.errors import BadInput
from core.spherical_harmonics import C0

PROGRESS_SIZE_MIN = 20 << 20  # [bytes] of input; less takes about a second


@dataclass(kw_only=True)
class ConvertOptions(cli.Options):
    EXAMPLES = ("convert cat.sog cat.spz",)

    input: Path = cli.argument("IN", f"{cli.SPLATS} or .h5")
    output: Path = cli.argument("OUT", ".ply, .compressed.ply, .spz or .splat")


def convert(options: ConvertOptions) -> None:
    """Convert the input to the output, and print what was written and what was lost. Raises BadInput."""
    source, target = options.input, options.output
    kind = kind_to_write(target)
    exist = [os.path.isfile(path) for path in (source, target)]  # False where Path.exists may raise
    if all(exist) and source.samefile(target):
        raise BadInput(f"{target}: is the input itself; choose another name")
    long = exist[0] and source.stat().st_size >= PROGRESS_SIZE_MIN

    def progress(stage: str) -> None:
        if long:
            print(f"  {stage}", file=sys.stderr, flush=True)

    progress(f"1/3 reading {source.name}")
    before = read_gaussians(source)
    progress(f"2/3 writing {len(before)} Gaussians to {target.name}")
    write_gaussians(target, before, report=lambda line: None)  # the losses below say it
    progress("3/3 comparing")
    after = read_gaussians(target)
    if kind == COMPRESSED:
        before = before.select(chunk_order(before.means))
    lost = losses(before, after)
    if source.suffix.lower() == ".h5":
        lost.append("all of the asset but its Gaussians")
    size = f"{target.stat().st_size / 1e6:.2f} MB"
    if source.suffix.lower() != ".json":  # most of an unzipped SOG stands in its images
        size += f", was {source.stat().st_size / 1e6:.2f} MB"
    what = f"{len(after)} Gaussians of SH degree {after.sh_degree} ({size})"
    print(f"{target}: {what}; lost: {', '.join(lost) or 'nothing'}")


def losses(before: Gaussians, after: Gaussians) -> list[str]:
    """Measured losses of a conversion: the largest errors in words, [] if none."""
    if len(before) != len(after):
        return [f"{len(before) - len(after)} Gaussians"]
    lost = []
    if after.sh_degree < before.sh_degree:
        lost.append(f"SH of degree {', '.join(map(str, range(after.sh_degree + 1, before.sh_degree + 1)))}")
    shared = SH_COUNTS[min(before.sh_degree, after.sh_degree)]
    for name, values, unit in (
        ("positions", (before.means, after.means), "m"),
        ("log-scales", (before.log_scales, after.log_scales), ""),
        ("opacities", (before.opacities, after.opacities), ""),
        ("colours", (before.sh[:, 0] * C0, after.sh[:, 0] * C0), ""),
        ("SH coefficients", (before.sh[:, 1:shared], after.sh[:, 1:shared]), ""),
    ):
        error = float(np.abs(values[0] - values[1]).max(initial=0.0))
        if error > 0:
            lost.append(f"{name} up to {error:.2g} {unit}".rstrip())
    angle = 2 * np.arccos(np.clip(np.abs((before.quats * after.quats).sum(1, dtype=np.float64)), 0, 1)).max()
    if angle > 1e-3:  # [rad]; float32 alone turns by up to about 5e-4 in this formula
        lost.append(f"rotations up to {np.degrees(angle):.2g} degrees")
    if (before.object_id != after.object_id).any() or before.objects != after.objects:
        lost.append("object ids")
    return lost
