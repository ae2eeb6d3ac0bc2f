"""Stuffing and TetGen on the same splats, as Markdown: `python -m bench.mesher_table [--names ...] [--sizes ...]`."""

from __future__ import annotations

import argparse
import time

import prepare.cage.tetgen_mesher as tetgen
from bench.cage_cases import CASES
from bench.cage_table import CAPTURES, faults, measured, splat
from core.errors import BadInput
from prepare.cage.mesh_quality import dihedral_angles
from prepare.cage.meshers import MESHERS

COLUMNS = ("splat", "asked", "mesher", "vertices", "tets", "angle", "raw angle", "volume %", "inside %", "s", "remarks")


def line(name: str, vertices: int, mesher: str) -> tuple:
    """A row of COLUMNS. `raw angle` is TetGen's own, before its mesh is relaxed; `s` is the stage of the cage."""
    raw, real, said = [], tetgen.run_tetgen, []

    def watched(*args, **options):
        cage = real(*args, **options)
        raw.append(float(dihedral_angles(cage.vertices, cage.tets).min()))
        return cage

    tetgen.run_tetgen = watched
    begin = time.perf_counter()
    try:
        up = "+y" if name in CASES else None
        row, seconds = measured(splat(name), vertices, up=up, mesher=mesher, say=said.append)
    except BadInput as e:
        return (name, vertices, mesher, *["–"] * 6, f"{time.perf_counter() - begin:.0f}", f"refused: {e}")
    finally:
        tetgen.run_tetgen = real
    remarks = ["fell back: " + s.removeprefix("TetGen: ").split(";")[0] for s in said] + faults(row, vertices)
    figures = [f"{row['angle']:.1f}", f"{raw[-1]:.1f}" if raw else "", f"{row['volume']:+.1f}", f"{row['inside']:.2f}"]
    return (
        name,
        vertices,
        mesher,
        row["vertices"],
        row["tets"],
        *figures,
        f"{seconds['cage']:.1f}",
        ", ".join(remarks),
    )


def main() -> None:
    import taichi as ti

    from core.runtime import quicken

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--names", nargs="+", default=[*CASES, *CAPTURES])
    parser.add_argument("--sizes", nargs="+", type=int, default=[2000])
    parser.add_argument("--arch", choices=("cpu", "cuda"), default="cpu")
    args = parser.parse_args()
    tetgen.check_installed()
    ti.init(arch={"cpu": ti.cpu, "cuda": ti.cuda}[args.arch], offline_cache=True, log_level=ti.WARN)
    quicken()
    print("| " + " | ".join(COLUMNS) + " |\n" + "| --- " * len(COLUMNS) + "|", flush=True)
    for name in args.names:
        for size in args.sizes:
            for mesher in MESHERS:
                print("| " + " | ".join(map(str, line(name, size, mesher))) + " |", flush=True)


if __name__ == "__main__":
    main()
