"""`vrgs.py bench`, `check`, `figures` and `tune`: speed, the physics table, the paper's figures, a body's stiffness."""

from __future__ import annotations

import importlib
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from assets.asset import Asset
from assets.file_access import check_writable, write_json
from assets.library import default_material, find_asset, is_asset
from commands import options as cli
from commands.prepared import cached_body
from core.errors import BadInput
from core.material import Material
from core.runtime import start_taichi
from display.picture import save_picture

DROP_HEIGHT_MIN = 0.1  # [m], without --height

SUBJECTS = {  # module, options that it takes, and what it measures
    "sim": ("bench.sim_speed", "sizes rounds", "the solver, 400 substeps a frame"),
    "scene": (
        "bench.scene_speed",
        "asset sizes materials acts frames quick",
        "the solver, real bodies dropped, thrown, squeezed, piled up",
    ),
    "render": ("bench.render_speed", "gaussians size rounds", "a headset's picture, both eyes"),
    "frame": ("bench.frame_time", "", "a headset's whole frame, ring toss"),
    "demos": ("bench.demos", "names detail frames quick size", "the paper's nine demos, beside its figures"),
    "hitches": ("bench.hitches", "names size", "the worst frame of each thing that one does, in every scene"),
    "train": (
        "bench.training_speed",
        "names variants steps at cap seed reduce test_every",
        "training on captures: quality, speed, memory",
    ),
}
TAKERS = {  # subjects that take an option
    name: tuple(subject for subject, (_, takes, _) in SUBJECTS.items() if name in takes.split())
    for name in " ".join(takes for _, takes, _ in SUBJECTS.values()).split()
}
Variant = Literal["plain", "fast"]
Act = Literal["drop", "throw", "squeeze", "stack"]
RoomSize = Literal["0.305M", "1.313M", "2.526M"]


@dataclass(kw_only=True)
class BenchOptions(cli.Options):
    EXAMPLES = (
        "bench sim --json sim.json",
        "bench demos ring_toss --quick",
        "bench train fox/ bear/ --variants plain fast --json train.json",
    )
    CONDITIONS = tuple(
        cli.Condition(
            (f"--{name.replace('_', '-')}",),
            lambda o, takers=takers: o.subject in takers,
            f"belongs to bench {' and '.join(takers)}",
        )
        for name, takers in TAKERS.items()
        if name != "names"
    )

    subject: Literal["sim", "scene", "render", "frame", "demos", "hitches", "train"] = cli.argument(
        None, "; ".join(f"{name}: {what}" for name, (_, _, what) in SUBJECTS.items())
    )
    names: list[str] = cli.argument("NAME", "demos, hitches: which (default: all that are there); train: captures", [])
    detail: cli.Detail = cli.option(None, "demos: assets as shipped, or at the paper's sizes", "shipped")
    sizes: list[str] | None = cli.option("N", "vertices; sim: of 1.7k 9.3k 24k 46k; scene: any (default 10k 20k 46k)")
    asset: list[str] | None = cli.option("FILE", "scene: shipped bodies by name, or splat files (default: a few toys)")
    materials: list[str] = cli.option("NAME", "scene: (default: plush rubber wood)", ["plush", "rubber", "wood"])
    acts: list[Act] = cli.option(None, "scene: (default: all)", list(get_args(Act)))
    frames: cli.Count | None = cli.option("N", "scene, demos: a row (default 1000; quick 240, 30)")
    quick: bool = cli.switch("scene: one row, 2 s; demos: few frames")
    gaussians: list[RoomSize] = cli.option(None, "render: rooms (default: all)", list(get_args(RoomSize)))
    size: cli.Size = cli.option("WxH", "render, demos, hitches: picture of an eye (default 1800x1920)", (1800, 1920))
    rounds: cli.Count = cli.option("N", "sim, render: frames measured (default 12)", 12)
    steps: cli.Count | None = cli.option("N", "train: steps (default 30000 on a GPU, 3000 on a CPU)")
    at: list[cli.Count] = cli.option("N", "train: steps after which it is tested as well (default 7000)", [7000])
    reduce: cli.Count = cli.option("N", "train: divide the photographs' sides by N", 1)
    test_every: cli.Count = cli.option("N", "train: keep every Nth photograph for the test (default 8)", 8)
    cap: cli.Count | None = cli.option("N", "train: most Gaussians (default as train's)")
    seed: int = cli.option("S", "train: seed of all random numbers", 0)
    variants: list[Variant] = cli.option(None, "train: plain, fast, or both in turn (default: plain)", ["plain"])
    json: Path | None = cli.option("OUT.json", "write the rows")
    arch: cli.Arch | None = cli.arch_option()


@dataclass(kw_only=True)
class CheckOptions(cli.Options):
    EXAMPLES = ("check --quick --json table.json",)

    quick: bool = cli.switch("minutes, not hours: fewer substeps, throws and seconds")
    json: Path | None = cli.option("OUT.json", "write the table")
    arch: cli.Arch | None = cli.arch_option()


@dataclass(kw_only=True)
class FiguresOptions(cli.Options):
    EXAMPLES = ("figures --out figures", "figures --out /tmp/figures --quick")

    out: Path = cli.option("DIR", "folder of figures.html, with all pictures, and figures.json", cli.REQUIRED)
    capture: Path | None = cli.option("DIR", "a capture with its truth (python -m studio --capture DIR): inpainting")
    quick: bool = cli.switch("small pictures, one demo, one toy: two minutes")
    arch: cli.Arch | None = cli.arch_option()


def bench(options: BenchOptions) -> int:
    """Measure the subject, writing --json after each row; returns 1 if a body exploded. Raises BadInput."""
    module, takes, _ = SUBJECTS[options.subject]
    if options.names and "names" not in takes:
        raise BadInput(f"bench {options.subject} takes no names: {' '.join(options.names)}")
    if options.json:
        check_writable(options.json)
    start_taichi(options.arch)
    rows = []
    for row in importlib.import_module(module).run(**{name: getattr(options, name) for name in takes.split()}):
        rows.append(row)
        if options.json:
            write_json(options.json, rows)
    return 0 if all(row.get("sound", row.get("finite", True)) for row in rows) else 1


def check(options: CheckOptions) -> int:
    """Print the physics table; returns 1 if a row fails."""
    start_taichi(options.arch)
    from bench import check

    return check.run(quick=options.quick, json=options.json)


def figures(options: FiguresOptions) -> None:
    """Make the page of figures. Raises BadInput."""
    if options.out.exists() and not options.out.is_dir():
        raise BadInput(f"{options.out}: is a file, not a folder")
    if options.capture is not None and not options.capture.is_dir():
        raise BadInput(f"{options.capture}: no such folder")
    start_taichi(options.arch)
    from bench.paper_figures import run

    run(out=options.out, capture=options.capture, quick=options.quick)


@dataclass(kw_only=True)
class TuneOptions(cli.Options):
    EXAMPLES = ("tune cat.h5 --from 3e3 --to 3e5 --out cat_tune.png",)
    CONDITIONS = (
        cli.Condition(("--from", "--to", "--steps"), lambda o: not o.young, "is for moduli that --young does not list"),
    )

    asset: str = cli.argument("ASSET", "a prepared asset, a shipped one by name, or a splat file")
    young: list[cli.Amount] | None = cli.option("E", "Young's moduli to try [Pa]")
    lowest: cli.Amount = cli.option("E", "without --young: lowest modulus (default 1e3)", 1e3, flag="--from")
    highest: cli.Amount = cli.option("E", "highest modulus (default 1e6)", 1e6, flag="--to")
    steps: cli.Count = cli.option("N", "number of moduli (default 6)", 6)
    material: str | None = cli.option("NAME", "material whose modulus is varied (default: the asset's)")
    height: cli.Amount | None = cli.option("M", f"of the drop (default: half the body's, at least {DROP_HEIGHT_MIN})")
    out: Path | None = cli.option("STRIP.png", "strip of pictures (default: ASSET_tune.png)")
    json: Path | None = cli.option("OUT.json", "write the table")
    arch: cli.Arch | None = cli.arch_option()


def tune(options: TuneOptions) -> None:
    """Print the table and write the strip. Raises BadInput."""
    start_taichi(options.arch)
    from display.headless.stiffness_sweep import drop_each, strip

    path, name = find_asset(options.asset), Path(options.asset).stem
    if not is_asset(options.asset):
        path, _ = cached_body(path, cli.Preparation(), options.arch)
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
        write_json(options.json, [d.row() for d in drops])
    print(f"wrote {out}", file=sys.stderr)
