"""The very same Gaussians and camera in plain PyTorch, by gsplat's rules, and in ours, both on the CPU.

    python -m venv .dev/torch && .dev/torch/bin/pip install -r tests/bench/requirements-torch.txt
    python -m tests.bench.peer_torch [--torch PYTHON] [--size 640x360] [--rounds 9] [--json OUT.json]

PyTorch runs in its own environment, in another process; before and after it runs ours, whose rounds count together.
Both give colour, opacity and depth. CPU time counts all threads: what to compare where others use the machine too.
Exit status 1 if pictures differ by more than 1e-4 on average.
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from time import perf_counter, process_time

import numpy as np

from assets.camera import Camera, look_at, perspective
from assets.files import read_gaussians
from assets.gaussians import Gaussians
from assets.library import SHIPPED
from assets.order import morton_order
from display.argument_types import positive, size
from display.device import start_taichi
from display.stats import write_stats
from display.viewing import camera_around
from tests.bench.room import eyes, room

ROOT = Path(__file__).resolve().parents[2]
AGREE = 1e-4  # mean absolute difference of rgb and alpha


def cases(width: int, height: int):
    """Name, Gaussians, camera: a small thing, the dining room from the player's eye, a room of many Gaussians."""
    ring = read_gaussians(SHIPPED / "ring_red.h5")
    yield "ring_red", ring, camera_around(ring, width, height, 0.4)
    dining_room = read_gaussians(SHIPPED / "dining_room.h5")
    dining_room = dining_room.select(morton_order(dining_room.means))
    yield "dining_room", dining_room, perspective(width, height, 0.9, look_at((0.0, 1.42, 1.15), (0.0, 0.86, -0.12)))
    yield "a room of 305,000", room(305_000), eyes(width, height)[0]


def by_torch(g: Gaussians, camera: Camera, rounds: int, python: Path) -> dict:
    """What tests/bench/torch_splats.py writes."""
    with tempfile.TemporaryDirectory() as folder:
        case, out = Path(folder, "case.npz"), Path(folder, "out.npz")
        numbers = {"means": g.means, "quats": g.quats, "scales": np.exp(g.log_scales), "opacities": g.opacities}
        numbers |= {"sh": g.sh, "world_to_camera": camera.world_to_camera, "rounds": rounds}
        lens, sides = [camera.fx, camera.fy, camera.cx, camera.cy], [camera.width, camera.height]
        np.savez(case, lens=lens, size=sides, **numbers)
        program = Path(__file__).with_name("torch_splats.py")
        run = subprocess.run([python, program, case, out], capture_output=True, text=True)
        if run.returncode:
            sys.exit(run.stderr.strip().splitlines()[-1])
        with np.load(out) as data:
            return {key: data[key] for key in data}


def compare(name: str, g: Gaussians, camera: Camera, rounds: int, python: Path) -> dict:
    """One row: medians [ms] and mean differences of the pictures."""
    from render.renderer import Renderer
    from render.splats import Splats

    renderer = Renderer(Splats(g), camera.width, camera.height, outputs="float")
    for _ in range(2):  # compile, make room
        renderer.render([camera])
    took, cpu, theirs = [], [], {}
    for half in range(2):
        for _ in range(rounds):
            begin, spent = perf_counter(), process_time()
            renderer.render([camera])
            took.append(perf_counter() - begin)
            cpu.append(process_time() - spent)
        if half == 0:
            theirs = by_torch(g, camera, rounds, python)
    images = {key: getattr(renderer, key).to_numpy()[0] for key in ("rgb", "alpha", "depth")}
    solid = theirs["alpha"] > 0.5
    depth = np.abs(images["depth"] / np.where(solid, theirs["depth"], 1.0) - 1.0)[solid]
    ours_ms, torch_ms = 1e3 * median(took), 1e3 * float(np.median(theirs["seconds"]))
    return {
        "bench": "peer_torch",
        "splats": name,
        "gaussians": len(g),
        "width": camera.width,
        "height": camera.height,
        "ours_ms": ours_ms,
        "torch_ms": torch_ms,
        "ratio": torch_ms / ours_ms,
        "ours_cpu_ms": 1e3 * median(cpu),
        "torch_cpu_ms": 1e3 * float(np.median(theirs["cpu"])),
        "rgb_difference": float(np.abs(images["rgb"] - theirs["rgb"]).mean()),
        "alpha_difference": float(np.abs(images["alpha"] - theirs["alpha"]).mean()),
        "depth_difference": float(depth.mean()) if solid.any() else 0.0,
        "torch": str(theirs["version"]),
        "torch_threads": int(theirs["threads"]),
    }


def main() -> int:
    """Print a row for each splat; exit status 1 if pictures disagree."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--torch", type=Path, default=ROOT / ".dev" / "torch" / "bin" / "python", help="its Python")
    p.add_argument("--size", type=size, default=(640, 360), metavar="WxH", help="(default 640x360)")
    p.add_argument("--rounds", type=positive(int), default=9, metavar="N", help="pictures (default 9)")
    p.add_argument("--json", type=Path, metavar="OUT.json", help="write the rows")
    args = p.parse_args()
    if not args.torch.is_file():
        sys.exit(f"{args.torch}: no such interpreter; see the first lines of this program's --help")
    start_taichi("cpu")
    rows = []
    titles = (
        f"{'ours ms':>9} {'torch ms':>9} {'torch / ours':>12} {'of CPU time':>17} {'rgb':>9} {'alpha':>9} {'depth':>9}"
    )
    print(f"{'splats':20} {'Gaussians':>9} {titles}")
    for name, g, camera in cases(*args.size):
        row = compare(name, g, camera, args.rounds, args.torch)
        rows.append(row)
        figures = f"{row['ours_ms']:9.1f} {row['torch_ms']:9.0f} {row['ratio']:12.1f}"
        figures += f" {row['torch_cpu_ms']:9.0f} {row['ours_cpu_ms']:7.1f}"
        errors = " ".join(f"{row[f'{k}_difference']:9.1e}" for k in ("rgb", "alpha", "depth"))
        print(f"{name:20} {len(g):9} {figures} {errors}", flush=True)
    print(f"torch {rows[0]['torch']}, {rows[0]['torch_threads']} threads")
    if args.json:
        write_stats(args.json, rows)
    return int(any(max(row["rgb_difference"], row["alpha_difference"]) > AGREE for row in rows))


if __name__ == "__main__":
    sys.exit(main())
