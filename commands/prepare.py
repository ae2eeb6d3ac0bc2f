"""vrgs.py prepare: a splat file in, a simulatable asset or a static environment out."""

from __future__ import annotations

import argparse
from pathlib import Path

from assets.file_access import file_size
from core.errors import BadInput
from prepare.environment.environment_pipeline import EnvironmentOptions
from prepare.pipeline import Options
from prepare.prepared_files import object_file, prepare_environment_file, prepare_file
from prepare.report import report_names


def run(args: argparse.Namespace) -> None:
    """vrgs.py prepare SPLATS --out ASSET.h5 [--vertices N] [--scale S] [--up AXIS] [--material NAME] [--force]
    [--rig RIG.glb [--landmarks L.json]] [--mesher M] [--cells adaptive|uniform] [--pieces], or with
    --static [--cell M] [--cut ID ...]."""
    out = Path(args.out)
    cut = tuple(sorted(set(args.cut or ())))
    static = args.static or args.cell is not None or bool(cut)
    if static:
        _check_static(args)
    file_size(Path(args.splats))  # before the other complaints
    if out.suffix.lower() != ".h5":
        raise BadInput(f"{out}: an asset's name ends in .h5")
    if not out.parent.is_dir():
        raise BadInput(f"{out}: the folder {out.parent} does not exist")
    reports = () if static or args.no_report else report_names(out)
    for file in (out, *reports, *(object_file(out, k) for k in cut)):
        if file.exists() and not args.force:
            raise BadInput(f"{file}: exists already; --force overwrites it")
    if static:
        options = EnvironmentOptions(up=args.up, scale=args.scale, cell=args.cell, cut=cut)
        for file in prepare_environment_file(args.splats, out, options):
            print(f"wrote {file}")
        return
    options = Options(
        args.vertices, args.scale, args.up, args.material, args.mesher, args.cells == "adaptive", args.pieces
    )
    files = {"rig": args.rig, "landmarks": args.landmarks}
    prepare_file(args.splats, out, options, **files, pictures=True, page=bool(reports))
    print(f"wrote {out}" + (f" and {reports[0]}" if reports else ""))


def _check_static(args: argparse.Namespace) -> None:
    if not args.static:
        raise BadInput("--cell and --cut belong to --static")
    if args.material is not None:
        raise BadInput("--material belongs to bodies; with --static nothing is simulated")
    if args.pieces:
        raise BadInput("--pieces belongs to bodies; objects are cut out of a scene with --cut")
