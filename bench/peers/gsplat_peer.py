"""The same Gaussians and cameras in gsplat 1.5.3 and in this renderer, alternating, in one process on one NVIDIA GPU.

    pip install -r bench/peers/requirements-gsplat.txt
    python -m bench.peers.gsplat_peer [--gaussians 0.305M 1.313M 2.526M] [--rounds 60] [--json OUT.json]

Both draw two eyes of 1800 x 1920 with SH of degree 3. gsplat runs packed and unpacked; the faster one counts. Pictures
must agree: ours has one colour and one depth order for both eyes, so a few pixels differ by more than rounding.
"""

import argparse
import sys
from pathlib import Path
from statistics import median

import numpy as np

from assets.file_access import write_json
from bench.render_speed import SIZES, eyes, room
from core.runtime import start_taichi

AGREE = 2 / 255  # mean absolute difference of the pictures


def gsplat_renderer(gaussians, packed: bool):
    """A function from cameras to (views, height, width, 3) on the device."""
    import torch
    from gsplat import rasterization

    def tensor(a):
        return torch.tensor(np.ascontiguousarray(a, np.float32), device="cuda")

    means, quats, sh = tensor(gaussians.means), tensor(gaussians.quats), tensor(gaussians.sh)
    scales, opacities = tensor(np.exp(gaussians.log_scales)), tensor(gaussians.opacities)

    @torch.no_grad()
    def draw(cameras):
        views = tensor([c.world_to_camera for c in cameras])
        K = tensor([[[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1]] for c in cameras])
        size = {"width": cameras[0].width, "height": cameras[0].height}
        images, _, info = rasterization(
            means, quats, scales, opacities, sh, views, K, **size, sh_degree=gaussians.sh_degree, packed=packed
        )
        draw.pairs = len(info["flatten_ids"])
        return images

    return draw


def compare(count: int, rounds: int) -> dict:
    """One row: medians [ms] and the mean difference of the pictures."""
    import taichi as ti
    import torch

    from bench.render_speed import times
    from render.renderer import Renderer
    from render.splats import Splats

    gaussians = room(count)
    ours = Renderer(Splats(gaussians), 1800, 1920, views=2)
    theirs = {packed: gsplat_renderer(gaussians, packed) for packed in (True, False)}
    took = {name: [] for name in ("ours", True, False)}
    for _ in range(2):  # alternating, so that clock drift affects all of them
        took["ours"] += times(ours.render, ti.sync, 1800, 1920, rounds // 2)
        for packed, draw in theirs.items():
            took[packed] += times(draw, torch.cuda.synchronize, 1800, 1920, rounds // 2)
    cameras = eyes()
    ours.render(cameras)
    picture = ours.pixels()[..., :3] / 255
    reference = theirs[True](cameras).clamp(0, 1).cpu().numpy()
    best = min((True, False), key=lambda packed: median(took[packed]))
    row = {
        "bench": "peer_gsplat",
        "gaussians": count,
        "ours_ms": 1e3 * median(took["ours"]),
        "gsplat_ms": 1e3 * median(took[best]),
        "gsplat_packed": best,
        "ratio": median(took["ours"]) / median(took[best]),
        "ours_pairs": ours.rasterizer.pairs,
        "gsplat_pairs": theirs[True].pairs,
        "difference": float(np.abs(picture - reference).mean()),
        "device": torch.cuda.get_device_name(),
    }
    ours.destroy()
    return row


def main() -> int:
    """Print a row for each room; exit status 1 if pictures disagree."""
    p = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    p.add_argument("--gaussians", nargs="+", choices=tuple(SIZES), default=list(SIZES))
    p.add_argument("--rounds", type=int, default=60)
    p.add_argument("--json", type=Path)
    args = p.parse_args()
    start_taichi("cuda")
    rows = []
    print(f"{'Gaussians':>10} {'ours ms':>9} {'gsplat ms':>9} {'ratio':>6} {'pairs':>11} {'theirs':>11} {'differ':>8}")
    for name in args.gaussians:
        row = compare(SIZES[name], args.rounds)
        rows.append(row)
        figures = f"{row['ours_ms']:9.3f} {row['gsplat_ms']:9.3f} {row['ratio']:6.2f}"
        print(
            f"{name:>10} {figures} {row['ours_pairs']:11,} {row['gsplat_pairs']:11,} {row['difference']:8.5f}",
            flush=True,
        )
    if args.json:
        write_json(args.json, rows)
    return int(any(row["difference"] > AGREE for row in rows))


if __name__ == "__main__":
    sys.exit(main())
