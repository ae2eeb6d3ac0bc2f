"""Quality of cages over eight splats and three sizes, as Markdown: `python -m bench.cage_table`."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from assets.asset import Cage
from assets.gaussians import Gaussians
from assets.splat_files import read_gaussians
from bench.cage_cases import CASES, case
from core.errors import BadInput
from core.point_location import Locator
from prepare.cage.mesh_quality import dihedral_angles, non_manifold_vertices, pieces, volumes
from prepare.pipeline import STAGES, prepare

SPLATS = Path(__file__).resolve().parents[2] / "shared" / "data" / "splats"
CAPTURES = ("toy_cat", "plush_dragon", "biker_human")
SIZES = (1000, 10_000, 30_000)
SOUND = {"angle": 12.0, "volume": 3.0, "inside": 99.5, "count": 15.0}  # degrees, per cent


def splat(name: str, count: int = 20_000) -> Gaussians:
    """A splat of CASES or CAPTURES."""
    return case(name, count) if name in CASES else read_gaussians(SPLATS / f"{name}.ply")


def figures(cage: Cage, filled: float, points: np.ndarray, wanted: int) -> dict:
    """What is promised of a cage, measured. filled: volume [m^3] of the filled shape; points (N, 3) to be inside."""
    volume = volumes(cage.vertices, cage.tets)
    return {
        "vertices": len(cage.vertices),
        "tets": len(cage.tets),
        "angle": float(dihedral_angles(cage.vertices, cage.tets).min()),
        "positive": bool((volume > 0).all()),
        "pinched": len(non_manifold_vertices(cage.surface)),
        "pieces": int(pieces(cage.tets).max()) + 1,
        "volume": 100 * (float(volume.sum()) / filled - 1),
        "inside": 100 * float((Locator(cage.vertices, cage.tets).find(points) >= 0).mean()),
        "count": 100 * (len(cage.vertices) / wanted - 1),
    }


def faults(row: dict, wanted: int) -> list[str]:
    """The promises that a row of `figures` breaks."""
    broken = {
        "angle": row["angle"] < SOUND["angle"],
        "inverted": not row["positive"],
        "manifold": row["pinched"] > 0,
        "pieces": row["pieces"] > 1,
        "volume": wanted >= 10_000 and abs(row["volume"]) > SOUND["volume"],
        "inside": row["inside"] < SOUND["inside"],
        "count": abs(row["count"]) > SOUND["count"],
    }
    return [name for name, is_broken in broken.items() if is_broken]


class Clock:
    """Seconds of each stage."""

    def __init__(self) -> None:
        self.seconds, self.stage, self.since = dict.fromkeys(STAGES, 0.0), None, 0.0

    def __call__(self, stage: str, done: float) -> None:
        now = time.perf_counter()
        if self.stage:
            self.seconds[self.stage] += now - self.since
        self.stage, self.since = stage, now


def measured(gaussians: Gaussians, vertices: int, **options) -> tuple[dict, dict]:
    """Figures of the cage and seconds of the stages. Raises BadInput."""
    clock, begin = Clock(), time.process_time()
    asset = prepare(gaussians, vertices=vertices, progress=clock, **options)
    g = asset.gaussians
    points = g.means[g.opacities > 0.5].astype(np.float64)
    clock.seconds["CPU s"] = time.process_time() - begin  # tells more than the clock on a busy machine
    return figures(asset.cage, asset.provenance["figures"]["filled"], points, vertices), clock.seconds


def main() -> None:
    import taichi as ti

    from core.runtime import quicken

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--names", nargs="+", default=[*CASES, *CAPTURES])
    parser.add_argument("--sizes", nargs="+", type=int, default=SIZES)
    parser.add_argument("--gaussians", type=int, default=20_000)
    parser.add_argument("--arch", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--uniform", action="store_true", help="cells of one size")
    args = parser.parse_args()
    ti.init(arch={"cpu": ti.cpu, "cuda": ti.cuda}[args.arch], offline_cache=True, log_level=ti.WARN)
    quicken()
    head = ["splat", "asked", "vertices", "tets", "angle", "volume %", "inside %", *STAGES, "CPU s", "faults"]
    print(f"| {' | '.join(head)} |\n" + "| --- " * len(head) + "|", flush=True)
    for name in args.names:
        for size in args.sizes:
            g = splat(name, args.gaussians)
            try:
                row, seconds = measured(g, size, up="+y" if name in CASES else None, adaptive=not args.uniform)
            except BadInput as e:
                print(f"| {name} | {size} | refused: {e} |", flush=True)
                continue
            times = " | ".join(f"{second:.1f}" for second in seconds.values())
            print(
                f"| {name} | {size} | {row['vertices']} | {row['tets']} | {row['angle']:.1f} | {row['volume']:+.1f} "
                f"| {row['inside']:.2f} | {times} | {', '.join(faults(row, size))} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
