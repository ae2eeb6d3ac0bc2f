"""`vrgs.py prepare`: make a splat an elastic body, or a room playable."""

from __future__ import annotations

import argparse
from pathlib import Path

from assets.file_access import file_size
from commands.conditions import Condition
from commands.options import SPLATS, add_arch, add_preparation, positive
from commands.prepared import cached_body, cached_environment, is_animated, suited
from core.errors import BadInput
from core.material import MATERIALS
from core.runtime import start_taichi

HELP = "make a splat an elastic body, or a room playable"
EXAMPLES = ("prepare cat.ply --out cat.h5 --vertices 2000", "prepare room.ply --static --out room.h5")
CONDITIONS = (
    Condition(("--cell", "--cut"), lambda args: args.static, "belongs to --static"),
    Condition(
        ("--pieces",), lambda args: not args.static, "belongs to bodies; objects are cut out of a scene with --cut"
    ),
    Condition(
        ("--front", "--vertices", "--cells", "--material", "--mesher", "--rig", "--landmarks", "--no-report"),
        lambda args: not args.static,
        "belongs to bodies; with --static nothing is simulated",
    ),
    Condition(
        ("--cell", "--cut", "--material", "--mesher", "--rig", "--landmarks", "--no-report", "--force", "--quantised"),
        lambda args: not args.cache,
        "belongs to --out",
    ),
    Condition(("--up", "--scale"), lambda args: not (args.cache and args.static), "belongs to --out"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("splats", type=Path, metavar="SPLATS", help=f"{SPLATS}, skinned .glb; --static: or .h5")
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--out", type=Path, metavar="ASSET.h5", help="file to write")
    text = "keep it where --body and --stage look for it, so that a play begins at once"
    where.add_argument("--cache", action="store_true", help=text)
    parser.add_argument("--rig", type=Path, metavar="RIG.glb", help="animate a standing person by this rig's motion")
    text = "positions of the person's joints (default: guessed)"
    parser.add_argument("--landmarks", type=Path, metavar="L.json", help=text)
    add_preparation(parser)
    *others, last = MATERIALS
    text = f"{', '.join(others)} or {last} (default plush, stiffer where a slender shape needs it; with a rig flesh)"
    parser.add_argument("--material", metavar="NAME", help=text)
    text = "the splat is a room or garden to play in"
    parser.add_argument("--static", action="store_true", help=text)
    text = "--static: spacing of the distance grid (default: by size)"
    parser.add_argument("--cell", type=positive(float), metavar="M", help=text)
    text = "--static: objects to cut out, each into a file"
    parser.add_argument("--cut", type=positive(int), nargs="+", metavar="ID", help=text)
    parser.add_argument("--force", action="store_true", help="overwrite OUT")
    text = "maker of the tetrahedra (default stuffing; tetgen as in the paper: see requirements-tetgen.txt)"
    parser.add_argument("--mesher", choices=("stuffing", "tetgen"), default="stuffing", help=text)
    text = "leave out ASSET.report.html and ASSET.report.json"
    parser.add_argument("--no-report", action="store_true", help=text)
    text = "a third to a fifth of the file's size, with losses that are hardly seen (docs/formats.md)"
    parser.add_argument("--quantised", action="store_true", help=text)
    add_arch(parser)


def run(args: argparse.Namespace) -> None:
    """Prepare a body, or with --static an environment, after a check of where its files go. Raises BadInput."""
    if args.cache:
        print((cached_environment if args.static else cached_body)(args.splats, args))
        return
    from prepare.environment.environment_pipeline import EnvironmentOptions
    from prepare.pipeline import Options
    from prepare.preparation_report import report_names
    from prepare.prepared_files import device_vertices, object_file, prepare_environment_file, prepare_file
    from prepare.report_pictures import strip_name

    out = Path(args.out)
    cut = tuple(sorted(set(args.cut or ())))
    file_size(Path(args.splats))  # before other errors
    if out.suffix.lower() != ".h5":
        raise BadInput(f"{out}: an asset's name ends in .h5")
    if not out.parent.is_dir():
        raise BadInput(f"{out}: the folder {out.parent} does not exist")
    reports = () if args.static or args.no_report else report_names(out)
    strips = () if args.up or (args.no_report and not args.static) else (strip_name(out),)
    for file in (out, *strips, *reports, *(object_file(out, k) for k in cut)):
        if file.exists() and not args.force:
            raise BadInput(f"{file}: exists already; --force overwrites it")
    start_taichi(args.arch)
    if args.static:
        options = EnvironmentOptions(up=args.up, scale=args.scale, cell=args.cell, cut=cut)
        for file in prepare_environment_file(args.splats, out, options, pictures=True, quantised=args.quantised):
            print(f"wrote {file}")
        return
    vertices = () if args.vertices else device_vertices(animated=is_animated(args.splats, args.rig))
    options = Options(
        args.vertices or vertices[0],
        args.scale,
        args.up,
        args.material,
        args.mesher,
        args.cells == "adaptive",
        args.pieces,
        front=args.front,
    )
    if vertices:
        print(suited(vertices[0]))
    files = {"rig": args.rig, "landmarks": args.landmarks, "quantised": args.quantised}
    prepare_file(args.splats, out, options, vertices=vertices, **files, pictures=True, page=bool(reports))
    print(f"wrote {out}" + (f" and {reports[0]}" if reports else ""))
