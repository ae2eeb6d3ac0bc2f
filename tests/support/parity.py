"""The same pictures on CUDA and on the CPU, in two processes: colour, opacity and depth must agree to 1e-4.

    python -m tests.support.parity [--seeds 4] [--json OUT.json]

Pictures that are hard to draw (tests/support/hard_pictures.py), one eye and two, sorted by depth and by distance, plain and
antialiased; clouds whose numbers are broken at random; rooms. Where rounding decides whether a Gaussian of alpha 1/255
is drawn, or whether a pixel is finished, the devices may differ by that one step: the float64 twin knows these pixels
of the hard pictures, which are left out and counted; of clouds and rooms, where also the order of what is equally far
is a matter of rounding, all but one pixel in a thousand must agree. Exit status 0 agreed, 1 not, 2 no CUDA GPU.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from bench.synthetic_room import eyes as room_eyes
from bench.synthetic_room import room
from core.errors import BadInput
from core.runtime import start_taichi
from tests.support import reference_render as reference
from tests.support.drawing import Drawing
from tests.support.hard_pictures import DEGREE, SIDE, cloud, hard_pictures, two_eyes

ROOT = Path(__file__).resolve().parents[2]
TOLERANCE = 1e-4  # of rgb (or of the brightest, where that is above 1), alpha, relative depth where alpha > 0.01
MOST_DOUBTS = 0.06  # of a hard picture's pixels may be at a threshold
MOST_APART = 1e-3  # of a cloud's or a room's
CAPACITY = 4100
WAYS = {"z": {}, "radial": {"sort": "radial"}, "antialiased": {"antialias": True}}
ROOMS = {"a room, 640x360": (100_000, 640, 360), "a room, 333x777": (300_000, 333, 777)}  # Gaussians, width, height
BAD = (np.nan, np.inf, -np.inf, 3e38, -3e38, 1e19, 1e-42, -1e-42, 0.0)
IMAGES = ("rgb", "alpha", "depth")


def draw_all(seeds: int) -> dict[str, list[np.ndarray]]:
    """rgb, alpha and depth of every picture, by name, on the device that Taichi was started on."""
    found, hard = {}, hard_pictures()
    for way, options in WAYS.items():
        for views in (1, 2):
            drawing = Drawing(CAPACITY, views, SIDE, degree=DEGREE, **options)
            for name, (g, eyes) in hard.items():
                found[f"{name}; {way}, {views}"] = drawing.draw(g, eyes[:views])
            for seed in range(seeds if way == "z" else 0):
                found[f"broken numbers {seed}; {way}, {views}"] = drawing.draw_fields(
                    *broken(seed), two_eyes(43, 29)[:views]
                )
    for name, (count, width, height) in ROOMS.items():
        drawing = Drawing(count, 2, max(width, height), degree=DEGREE)
        found[f"{name}; z, 2"] = drawing.draw(room(count), room_eyes(width, height))
    return found


def broken(seed: int) -> list[np.ndarray]:
    """Means, covariances, opacities and harmonics of 300 Gaussians, a number of every third one broken."""
    from render.splats import covariances

    rng = np.random.default_rng(seed)
    g = cloud(rng, 300, center=(0.0, 0.0, 1.5))
    fields = [np.array(f, np.float32) for f in (g.means, covariances(g), g.opacities, g.sh)]
    for k in rng.choice(len(g), 100, replace=False):
        row = fields[rng.integers(4)][k : k + 1].reshape(-1)
        row[rng.integers(row.size)] = rng.choice(BAD)
    return fields


def differences(a: list[np.ndarray], b: list[np.ndarray]) -> dict[str, np.ndarray]:
    """Of rgb, alpha and depth, each (V, H, W), as TOLERANCE measures them; infinite where one is no number."""
    seen = np.minimum(a[1], b[1]) > 0.01
    bright = max(1.0, np.nanmax(np.where(np.isfinite(b[0]), b[0], 0.0), initial=0.0))
    depth = np.abs(a[2] - b[2]) / np.where(seen, np.abs(b[2]), 1.0)
    found = [np.abs(a[0] - b[0]).max(axis=-1) / bright, np.abs(a[1] - b[1]), np.where(seen, depth, 0.0)]
    return {name: np.where(np.isfinite(d), d, np.inf) for name, d in zip(IMAGES, found, strict=True)}


def compare(name: str, a: list[np.ndarray], b: list[np.ndarray], doubts: np.ndarray | None) -> dict:
    """A row: the largest differences of what is not `doubts` (V, H, W), and whether that passes.

    Without `doubts` one pixel in a thousand is forgiven, and the row has the largest differences of the others.
    """
    found = differences(a, b)
    apart = np.max(list(found.values()), axis=0)
    if doubts is None:
        left_out = (apart >= TOLERANCE) & np.isfinite(apart)
        share, most = left_out.mean(), MOST_APART
    else:
        left_out, share, most = doubts, doubts.mean(), MOST_DOUBTS
    row = {f"{image}_difference": float(d[~left_out].max(initial=0.0)) for image, d in found.items()}
    passed = share <= most and all(d < TOLERANCE for d in row.values()) and np.isfinite(apart).all()
    return {"bench": "parity", "picture": name, **row, "left_out": float(share), "pass": bool(passed)}


def doubts_of(name: str, hard: dict) -> np.ndarray | None:
    """Pixels of a hard picture at a threshold, (V, H, W), as the twin sees them; None of others."""
    picture, _, how = name.partition("; ")
    way, _, views = how.partition(", ")
    if picture not in hard:
        return None
    g, eyes = hard[picture]
    return reference.render_stereo(g, eyes[: int(views)], antialias=way == "antialiased", radial=way == "radial")[3]


def on_the_cpu(seeds: int) -> dict[str, list[np.ndarray]]:
    """What `draw_all` gives there, in another process: Taichi runs on one kind of device in each."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "pictures.npz")
        command = [sys.executable, "-m", "tests.support.parity", "--seeds", str(seeds), "--draw-on-cpu", str(out)]
        subprocess.run(command, cwd=ROOT, check=True)
        with np.load(out) as data:
            names = dict.fromkeys(key.rpartition("/")[0] for key in data)
            return {name: [data[f"{name}/{image}"] for image in IMAGES] for name in names}


def main(argv: list[str] | None = None) -> int:
    """Draw, compare, print a line for each picture; returns the exit status."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--seeds", type=int, default=4, metavar="N", help="clouds with broken numbers (default 4)")
    p.add_argument("--json", type=Path, metavar="OUT.json", help="write the rows")
    p.add_argument("--draw-on-cpu", type=Path, metavar="OUT.npz", help=argparse.SUPPRESS)
    args = p.parse_args(argv)
    if args.draw_on_cpu:
        start_taichi("cpu")
        pictures = draw_all(args.seeds).items()
        np.savez(args.draw_on_cpu, **{f"{n}/{k}": i for n, v in pictures for k, i in zip(IMAGES, v, strict=True)})
        return 0
    try:
        start_taichi("cuda")
    except BadInput as e:
        print(f"parity: nothing to compare the CPU with: {e}", file=sys.stderr)
        return 2
    cuda, cpu, hard = draw_all(args.seeds), on_the_cpu(args.seeds), hard_pictures()
    rows = [compare(name, cuda[name], cpu[name], doubts_of(name, hard)) for name in cuda]
    print(f"{'picture':66} {'rgb':>9} {'alpha':>9} {'depth':>9} {'left out':>9}")
    for row in rows:
        figures = " ".join(f"{row[f'{image}_difference']:9.1e}" for image in IMAGES)
        print(f"{row['picture']:66} {figures} {row['left_out']:9.5f} {'' if row['pass'] else 'FAILED'}")
    failed = sum(not row["pass"] for row in rows)
    print(f"{len(rows) - failed} of {len(rows)} pictures agree")
    if args.json:
        from display.run_stats import write_stats

        write_stats(args.json, rows)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
