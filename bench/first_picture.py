"""Seconds from the start of `vrgs.py view`, or of a demo, until it has shown its first frame and ended, cold and warm.

    xvfb-run -s "-screen 0 960x540x24" python -m bench.first_picture [--gaussians 100000] [--degree 3] [--rounds 5]
    xvfb-run -s "-screen 0 960x540x24" python -m bench.first_picture --scene sandbox --rounds 1

Needs a display. Cold: with an empty cache of compiled kernels. Warm: with the kernels that the cold start left, the
median of the rounds. The window shows one frame and closes; Taichi writes its cache when the program ends.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from time import perf_counter

from assets.splat_files import write_gaussians
from bench.synthetic_room import room

PROGRAM = Path(__file__).resolve().parents[1] / "vrgs.py"


def start_time(command: list[str], cache: Path) -> tuple[float, float]:
    """Wall and CPU seconds of a run. Exits with the program's message if it fails."""
    used, begin = resource.getrusage(resource.RUSAGE_CHILDREN), perf_counter()
    environment = {**os.environ, "TI_OFFLINE_CACHE_FILE_PATH": str(cache)}
    run = subprocess.run(command, env=environment, capture_output=True, text=True)
    if run.returncode:
        sys.exit(run.stderr.strip())
    wall, now = perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime


def main() -> None:
    """Print the cold start, every warm start, and their median."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--scene", metavar="NAME", help="play this demo instead of looking at a room")
    p.add_argument("--program", type=Path, metavar="FILE", help="of `make binary` (default: vrgs.py)")
    p.add_argument("--gaussians", type=int, default=100_000)
    p.add_argument("--degree", type=int, choices=range(4), default=3)
    p.add_argument("--rounds", type=int, default=5)
    p.add_argument("--arch", choices=("cuda", "cpu"), default="cpu")
    args = p.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        what = ["--scene", args.scene]
        if args.scene is None:
            what = ["view", str(Path(folder, "room.ply"))]
            write_gaussians(Path(what[1]), room(args.gaussians, args.degree))
        program = [str(args.program)] if args.program else [sys.executable, str(PROGRAM)]
        command = [*program, *what, "--arch", args.arch, "--frames", "1"]
        walls = []
        for k in range(1 + args.rounds):
            wall, cpu = start_time(command, Path(folder, "cache"))
            print(f"{'warm' if k else 'cold'}: {wall:.2f} s, of CPU time {cpu:.2f} s", flush=True)
            walls.append(wall)
        print(f"median of warm starts {median(walls[1:]):.2f} s")


if __name__ == "__main__":
    main()
