"""`vrgs.py bench scene`: time of the `simulate` stage of a headset's frame, for real bodies in rough hands.

Each asset, at each size and of each material, is dropped, thrown, squeezed and piled up (bench/scene_acts.py) in frames
of 1/90 s. A size is the number of vertices in all: a pile is two bodies of half of them, or of the largest size twenty
of a twentieth. Times are of Solver.step and Solver.observe with a wait for the device; bodies do not sleep.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
import taichi as ti

from assets.asset import Asset
from bench.measured_bodies import SHAPES, body_name, stripped_body
from bench.scene_acts import ACTS, Cast, room
from core.errors import BadInput
from core.material import Material
from core.program import cache_folder
from sim.model import Capacity, Model, RestShape
from sim.solver import Solver

FRAME = 1 / 90  # [s]
DEFAULT_SIZES = (10_000, 20_000, 46_000)
PILED, MANY, MANY_FROM = 2, 20, 40_000  # bodies of a pile; of this many vertices on, there are MANY
WARM_FRAMES = 4  # of each act, before those that are measured: they compile
QUICK_FRAMES = 240  # all acts of one body, once
SECONDS, QUICK_SECONDS = 20.0, 2.0  # for a row at most: a slow device plays fewer frames
COLUMNS = ("vertices", "tets", "integrator", "substeps", "most_rows", "frames", "median", "p99", "worst")


@dataclass(frozen=True)
class Play:
    """A row: the acts of `count` bodies that are played in turn."""

    acts: tuple[str, ...]
    count: int


def run(
    *,
    asset: list[str] | None,
    sizes: list[str] | None,
    materials: list[str],
    acts: list[str],
    bodies: Path | None,
    frames: int | None,
    quick: bool,
) -> Iterator[dict]:
    """Measure every row; prints and yields it, then prints a summary. Raises BadInput."""
    wanted = [vertices_of(s) for s in sizes] if sizes else list(DEFAULT_SIZES)
    print(f"{'asset':14} {'size':>6} {'acts':18} {'material':9}" + "".join(f" {c:>10}" for c in COLUMNS), flush=True)
    rows = []
    for row in measure_all(
        asset or list(SHAPES),
        wanted,
        {name: Material.named(name) for name in materials},
        acts=acts,
        quick=quick,
        folder=bodies or cache_folder() / "bench",
        frames=frames or (QUICK_FRAMES if quick else 1000),
        seconds=QUICK_SECONDS if quick else SECONDS,
    ):
        rows.append(row)
        figures = "".join(f" {row[c]:>10}" for c in COLUMNS[:6])
        figures += "".join(f" {row[c + '_ms']:>10.2f}" for c in COLUMNS[6:])
        print(f"{row['asset']:14} {row['size']:>6} {row['acts']:18} {row['material']:9}" + figures, flush=True)
        if not row["sound"]:
            print("vrgs: bench scene: not finite: {asset} {size} {acts} {material}".format(**row), file=sys.stderr)
        yield row
    print("\n" + summary(rows, materials))


def summary(rows: list[dict], materials: list[str]) -> str:
    """Markdown table of the slowest asset's median and of the worst frame [ms], by number of vertices and bodies."""
    lines = [f"| vertices | bodies | {' | '.join(materials)} |", "| --- " * (2 + len(materials)) + "|"]
    for size, bodies in dict.fromkeys((row["size"], row["bodies"]) for row in rows):
        cells = []
        for material in materials:
            mine = [r for r in rows if (r["size"], r["bodies"], r["material"]) == (size, bodies, material)]
            cells.append(f"{max(r['median_ms'] for r in mine):.2f} ({max(r['worst_ms'] for r in mine):.2f})")
        lines.append(f"| {size / 1000:g}k | {bodies} | {' | '.join(cells)} |")
    return "\n".join(lines)


def vertices_of(size: str) -> int:
    """Number of vertices that "10k" or "2300" means. Raises BadInput."""
    try:
        return round(1000 * float(size[:-1])) if size.endswith("k") else int(size)
    except ValueError as e:
        raise BadInput(f"{size!r} is not a number of vertices, like 10k") from e


def plays_of(acts: Iterable[str], size: int, quick: bool) -> list[Play]:
    """The rows of a size: one for each act, or with `quick` one for all acts of one body."""
    single = tuple(a for a in acts if a != "stack")
    plays = [Play(single, 1)] if quick and single else [Play((a,), 1) for a in single]
    return plays + ([Play(("stack",), MANY if size >= MANY_FROM else PILED)] if "stack" in acts else [])


def measure_all(
    assets: list[str],
    sizes: list[int],
    materials: dict[str, Material],
    *,
    acts: list[str],
    quick: bool,
    folder: Path,
    frames: int,
    seconds: float,
) -> Iterator[dict]:
    """All rows, size by size: one solver for all assets and materials of a size, so that kernels compile once."""
    for size in sizes:
        plays = plays_of(acts, size, quick)
        shapes = {
            (asset, play.count): rest_shape(stripped_body(asset, size // play.count, folder))
            for asset in assets
            for play in plays
        }
        any_material = next(iter(materials.values()))
        casts = [Cast(body_name(a), shape, any_material, count) for (a, count), shape in shapes.items()]
        solver = Solver([], room(), **options(casts))
        solver.reset(casts[0].models)
        solver.warm_up()
        for asset in assets:
            for play in plays:
                for name, material in materials.items():
                    cast = Cast(body_name(asset), shapes[asset, play.count], material, play.count)
                    row = measure(solver, cast, play, frames, seconds)
                    yield {"asset": body_name(asset), "size": size, "material": name, **row}
        solver.destroy()


def rest_shape(asset: Asset) -> RestShape:
    """Shape of an asset's cage."""
    return RestShape(asset.cage.vertices, asset.cage.tets, asset.cage.surface, asset.sdf)


def options(casts: list[Cast]) -> dict:
    """Options of a solver that each of the casts fits in."""
    sizes = [Model(c.models).sizes for c in casts]
    most = {name: max(getattr(s, name) for s in sizes) for name in ("vertices", "tets", "triangles", "bodies")}
    nodes = max(c.shape.sdf.values.size for c in casts)
    capacity = Capacity(**most, samples=max(c.samples for c in casts), nodes=nodes)
    return {"frame_dt": FRAME, "capacity": capacity, "hands": 2, "sleep": False}


def measure(solver: Solver, cast: Cast, play: Play, frames: int, seconds: float) -> dict:
    """One row: times [ms] of frames, acts played in turn from their beginnings."""
    solver.reset(cast.models)
    for act in play.acts:
        list(played(solver, cast, act, WARM_FRAMES))
    times, rows, recovered, begin = [], [], solver.stats["recovered"], perf_counter()
    length = sum(ACTS[act].frames for act in play.acts)
    while len(times) < frames and perf_counter() - begin < seconds:
        for act in play.acts:
            share, act_begin = seconds * ACTS[act].frames / length, perf_counter()
            for took, contacts in played(solver, cast, act, min(ACTS[act].frames, frames - len(times))):
                times.append(1e3 * took)
                rows.append(contacts)
                if perf_counter() - act_begin > share:  # so that a slow device comes to the next act
                    break
    stats = solver.stats
    return {
        "bench": "scene",
        "acts": "+".join(play.acts),
        "bodies": play.count,
        "vertices": stats["vertices"],
        "tets": stats["tets"],
        "integrator": stats["integrator"],
        "iterations": stats["iterations"],
        "substeps": stats["substeps"],
        "rows": int(np.median(rows)),
        "most_rows": max(rows),
        "frames": len(times),
        "median_ms": float(np.median(times)),
        "p99_ms": float(np.percentile(times, 99)),
        "worst_ms": max(times),
        "sound": stats["finite"] and stats["recovered"] == recovered,
        "arch": str(ti.cfg.arch).removeprefix("Arch."),
    }


def played(solver: Solver, cast: Cast, act: str, frames: int) -> Iterator[tuple[float, int]]:
    """Play an act from its beginning; yields the time of each frame [s] and the number of contact rows."""
    ends = cast.ends(ACTS[act])
    solver.restore(cast.start(ACTS[act]))
    ti.sync()
    for k in range(frames):
        hands = ACTS[act].hands(k, ends)
        begin = perf_counter()
        solver.step(FRAME, hands)
        solver.observe()
        ti.sync()
        yield perf_counter() - begin, int(solver.contacts.constraints.candidate_count[None])
