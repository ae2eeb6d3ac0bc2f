"""`vrgs.py tune`: find a body's stiffness by dropping it with one Young's modulus after another."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from assets.asset import Asset
from assets.file_access import check_writable
from assets.library import default_material, find_asset
from commands.options import Amount, Arch, Condition, Count, Options, Preparation, arch_option, argument, option
from commands.prepared import cached_body, is_asset
from core.errors import BadInput
from core.material import Material
from core.runtime import start_taichi

DROP_HEIGHT_MIN = 0.1  # [m], without --height


@dataclass(kw_only=True)
class TuneOptions(Options):
    """Options of `tune`."""

    EXAMPLES = ("tune cat.h5 --from 3e3 --to 3e5 --out cat_tune.png",)
    CONDITIONS = (
        Condition(("--from", "--to", "--steps"), lambda o: not o.young, "is for moduli that --young does not list"),
    )

    asset: str = argument("ASSET", "a prepared asset, a shipped one by name, or a splat file")
    young: list[Amount] | None = option("E", "Young's moduli to try [Pa]")
    lowest: Amount = option("E", "without --young: lowest modulus (default 1e3)", 1e3, flag="--from")
    highest: Amount = option("E", "highest modulus (default 1e6)", 1e6, flag="--to")
    steps: Count = option("N", "number of moduli (default 6)", 6)
    material: str | None = option(
        "NAME", "material whose modulus is varied (default: the asset's; see: vrgs.py materials)"
    )
    height: Amount | None = option("M", f"height of the drop (default: half the body's, at least {DROP_HEIGHT_MIN})")
    out: Path | None = option("STRIP.png", "strip of pictures (default: ASSET_tune.png)")
    json: Path | None = option("OUT.json", "write the table")
    arch: Arch | None = arch_option()


def tune(options: TuneOptions) -> None:
    """Print the table and write the strip. Raises BadInput."""
    start_taichi(options.arch)
    from display.headless.stiffness_sweep import drop_each, strip
    from display.picture import save_picture
    from display.timing import write_stats

    path, name = find_asset(options.asset), Path(options.asset).stem
    if not is_asset(options.asset):
        path, _ = cached_body(path, Preparation(), options.arch)
    asset = Asset.load(path)
    if asset.cage is None:
        raise BadInput(f"{options.asset}: has no cage to simulate (make one: python vrgs.py prepare)")
    youngs = options.young or np.geomspace(options.lowest, options.highest, options.steps).tolist()
    out = options.out or Path(f"{name}_tune.png")
    for file in filter(None, (out, options.json)):
        check_writable(file)
    material = Material.named(options.material) if options.material else default_material(str(path))
    height = np.ptp(asset.cage.vertices[:, 1])
    drop_height = options.height or float(max(DROP_HEIGHT_MIN, 0.5 * height))
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
    if options.json:
        write_stats(options.json, [d.row() for d in drops])
    print(f"wrote {out}", file=sys.stderr)
