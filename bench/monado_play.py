"""python -m bench.monado_play [--scene NAME] [--frames N] [--percent P]: a play in Monado, on what OpenGL there is.

Needs Monado (`sh tests/support/monado.sh` builds it) and Xvfb. A scripted player turns the head; prints where the time of a
frame goes, as `--stats` has it, and how busy the machine was: other programs count as much as this one.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import numpy as np

from bench.remote_headset import PORT, Player, monado, surroundings
from bench.xvfb import XServer

ROOT = Path(__file__).resolve().parents[1]


def main() -> int:
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--scene", default="ring_toss")
    words.add_argument("--frames", type=int, default=60)
    words.add_argument("--percent", type=int, default=33, help="of the full size of Monado's pictures, a side")
    args = words.parse_args()
    if monado() is None:
        print("no Monado: build it with `sh tests/support/monado.sh`", file=sys.stderr)
        return 2
    with XServer(1280, 800) as screen, surroundings(percent=args.percent) as environment:
        stats, said = play(args, {**screen.env, **environment})
    print(next((line for line in said.splitlines() if " an eye" in line), "it did not start"))
    print(f"{stats['fps']:.2f} frames a second, {stats['frames']} in all; load {os.getloadavg()[0]:.1f}")
    for name, times in stats["stages"].items():
        print("  {:10} {median_ms:8.1f} ms, worst {worst_ms:8.1f}, first {first_ms:8.1f}".format(name, **times))
    rest = 1e3 / stats["fps"] - sum(times["median_ms"] for times in stats["stages"].values())
    print(f"  {'the rest':10} {rest:8.1f} ms: Monado draws, or is waited for")
    return 0


def play(args, environment: dict) -> tuple[dict, str]:
    """What `--stats` wrote, and what was said on stderr."""
    with tempfile.TemporaryDirectory() as folder:
        out, errors = Path(folder) / "stats.json", Path(folder) / "errors.txt"
        command = [ROOT / "vrgs.py", "--scene", args.scene, "--xr", "--frames", args.frames, "--stats", out]
        with open(errors, "w") as file:
            command = [sys.executable, *map(str, command)]
            process = subprocess.Popen(command, env=environment, stderr=file, cwd=ROOT)
        over = threading.Event()
        threading.Thread(target=sway, args=(int(environment[PORT]), over), daemon=True).start()
        status = process.wait()
        over.set()
        said = errors.read_text()
        if status:
            raise SystemExit(said)
        return json.loads(out.read_text()), said


def sway(port: int, over: threading.Event) -> None:
    """A head that turns a little, so that every picture is a new one."""
    player, k = Player(port, seconds=300.0), 0
    while not over.wait(0.05):
        k += 1
        half = 0.05 * np.sin(0.1 * k)
        player.rotation = (0.0, float(np.sin(half)), 0.0, float(np.cos(half)))
        try:
            player.send()
        except OSError:  # the runtime has gone
            return


if __name__ == "__main__":
    sys.exit(main())
