"""Seconds from the start of `vrgs.py view` to the first picture of a room on an Xvfb screen.

    python -m bench.first_picture [--gaussians 100000] [--degree 3] [--rounds 5] [--arch cpu]

The screen's memory is polled every 10 ms. A first window, which closes by itself, is not counted: it compiles, and
Taichi caches kernels only when a program ends normally.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from time import perf_counter, sleep

import numpy as np

from assets.splat_files import write_gaussians
from bench.synthetic_room import room
from tests.support.xvfb import XServer

PROGRAM = Path(__file__).resolve().parents[1] / "vrgs.py"
SIZE = (960, 540)
COLORS = 2000  # distinct ones in every seventh pixel: a picture has more, a line of text far fewer
LONGEST = 120.0  # [s]


def first_picture(screen: XServer, command: list) -> tuple[float, float]:
    """Wall and CPU seconds until a picture is shown; then close the window."""
    begin = perf_counter()
    process = subprocess.Popen(command, env=screen.env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        while len(np.unique(screen.pixels(seconds=0.0)[100:500:2, 300:900].reshape(-1, 3)[::7], axis=0)) < COLORS:
            if perf_counter() - begin > LONGEST or process.poll() is not None:
                sys.exit("no picture came")
            sleep(0.01)
        wall = perf_counter() - begin
        ticks = Path(f"/proc/{process.pid}/stat").read_text().split()[13:15]
        return wall, sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")
    finally:
        process.kill()
        process.wait()


def main() -> None:
    """Print every round, then the median."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--gaussians", type=int, default=100_000)
    p.add_argument("--degree", type=int, choices=range(4), default=3)
    p.add_argument("--rounds", type=int, default=5)
    p.add_argument("--arch", choices=("cuda", "cpu"), default="cpu")
    args = p.parse_args()
    with tempfile.TemporaryDirectory() as folder, XServer(*SIZE) as screen:
        file = Path(folder, "room.ply")
        write_gaussians(file, room(args.gaussians, args.degree))
        command = [sys.executable, str(PROGRAM), "view", str(file), "--arch", args.arch]
        warm = subprocess.run([*command, "--frames", "2"], env=screen.env, capture_output=True, text=True)
        if warm.returncode:
            sys.exit(warm.stderr.strip())
        took = []
        for _ in range(args.rounds):
            took.append(first_picture(screen, command))
            print(f"{took[-1][0]:.2f} s, of CPU time {took[-1][1]:.2f} s", flush=True)
        print(f"median {median(wall for wall, _ in took):.2f} s")


if __name__ == "__main__":
    main()
