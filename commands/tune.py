"""`vrgs.py tune`: find a body's stiffness by dropping it with one Young's modulus after another."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from assets.asset import Asset
from assets.file_access import check_writable
from assets.library import default_material, find_asset
from commands.conditions import Condition
from commands.options import add_arch, positive
from commands.prepared import cached_body, is_asset
from core.errors import BadInput
from core.material import Material
from core.runtime import start_taichi

HELP = "drop a body with one stiffness after another: what each does, as a table and a strip of pictures"
EXAMPLES = ("tune cat.h5 --from 3e3 --to 3e5 --out cat_tune.png",)
CONDITIONS = (
    Condition(("--from", "--to", "--steps"), lambda args: not args.young, "is for moduli that --young does not list"),
)
DROP_HEIGHT_MIN = 0.1  # [m], without --height


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("asset", metavar="ASSET", help="a prepared asset, a shipped one by name, or a splat file")
    young = {"type": positive(float), "metavar": "E"}
    parser.add_argument("--young", nargs="+", **young, help="Young's moduli to try [Pa]")
    parser.add_argument(
        "--from", dest="lowest", default=1e3, **young, help="without --young: lowest modulus (default 1e3)"
    )
    parser.add_argument("--to", dest="highest", default=1e6, **young, help="highest modulus (default 1e6)")
    parser.add_argument("--steps", type=positive(int), default=6, metavar="N", help="number of moduli (default 6)")
    text = "material whose modulus is varied (default: the asset's; see: vrgs.py materials)"
    parser.add_argument("--material", metavar="NAME", help=text)
    text = f"height of the drop (default: half the body's, at least {DROP_HEIGHT_MIN})"
    parser.add_argument("--height", type=positive(float), metavar="M", help=text)
    parser.add_argument("--out", type=Path, metavar="STRIP.png", help="strip of pictures (default: ASSET_tune.png)")
    parser.add_argument("--json", type=Path, metavar="OUT.json", help="write the table")
    add_arch(parser)


def run(args: argparse.Namespace) -> None:
    """Print the table and write the strip. Raises BadInput."""
    start_taichi(args.arch)
    from display.headless.stiffness_sweep import drop_each, strip
    from display.picture import save_picture
    from display.timing import write_stats

    path, name = find_asset(args.asset), Path(args.asset).stem
    if not is_asset(args.asset):
        path = cached_body(path, args)
    asset = Asset.load(path)
    if asset.cage is None:
        raise BadInput(f"{args.asset}: has no cage to simulate (make one: python vrgs.py prepare)")
    youngs = args.young or np.geomspace(args.lowest, args.highest, args.steps).tolist()
    out = args.out or Path(f"{name}_tune.png")
    for file in filter(None, (out, args.json)):
        check_writable(file)
    material = Material.named(args.material) if args.material else default_material(str(path))
    height = np.ptp(asset.cage.vertices[:, 1])
    drop_height = args.height or float(max(DROP_HEIGHT_MIN, 0.5 * height))
    drops = []
    print(f"{name}, {100 * height:.1f} cm high, dropped from {drop_height:.2f} m")
    print(f"{'young [Pa]':>10} {'compression':>12} {'rebound':>10} {'settled':>9} {'substeps':>9} {'dt [s]':>10}  path")
    for d in drop_each(path, asset.cage.vertices, material, youngs, drop_height):
        notes = ["" if d.at_rest else "still moving", "" if d.finite else "not finite"]
        print(
            f"{d.young:10.3g} {d.compression:12.1%} {100 * d.rebound:7.1f} cm {d.settled:9.1%} {d.substeps:9d}"
            f" {d.dt:10.3g}  {d.path}  {', '.join(filter(None, notes))}".rstrip(),
            flush=True,
        )
        drops.append(d)
    save_picture(out, strip(name, drops, drop_height))
    if args.json:
        write_stats(args.json, [d.row() for d in drops])
    print(f"wrote {out}", file=sys.stderr)
