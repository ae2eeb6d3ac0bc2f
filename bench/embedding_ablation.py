"""`vrgs.py bench embedding`: time to find host tets and to deform Gaussians, and the benefit of the second level.

Speed: Gaussians in a bar of 10,985 vertices. Benefit, the paper's ablation (VR-GS, Sec. 4.3.2): the cages of prepared
bodies are twisted and stretched by formula; each Gaussian is compared with its image under the formula's own gradient.
`--out` draws both as a strip of pictures.
"""

from __future__ import annotations

import sys
from statistics import median
from time import perf_counter

import numpy as np
import taichi as ti

from assets.gaussians import Gaussians
from assets.library import SHIPPED_FOLDER
from bench.ablation import DEFORMATIONS, SCHEMES, ablation, arch, body, carried, jump, moved, page
from bench.sample_meshes import random_gaussians, tet_bar
from display.headless.video import claim
from display.picture import save_png
from display.run_stats import write_stats
from prepare.cage.embedding_hosts import embed
from sim.embedding import EmbeddedPart, Embedding

BAR = (64, 12, 12), (1.0, 0.2, 0.2)  # cells and size [m]: 10,985 vertices, 55,296 tets
KS, FLOORS = (0.0, 1 / 6, 1 / 3, 0.5, 1.0), (0.05, 0.1, 0.15, 0.2, 0.3)


def run(args) -> None:
    """Run the command: measure, print tables, write --json and --out."""
    for file in filter(None, (args.json, args.out)):
        claim(file, file.with_name(f".{file.name}.part"))
    rows = [hosts(args.count), deform(args.count, args.rounds)]
    names = ["bar", *([args.splats] if args.splats != SHIPPED_FOLDER / "dining_room.h5" else [])]
    pages = []
    print(f"\n{'body':14} {'deformation':12} {'scheme':10} {'spikes':>8} {'ratio 99%':>10}", end=" ")
    print(f"{'error 95%':>10} {'jump 95%':>9}", flush=True)
    for source in names:
        name, asset = body(source)
        pictures = {}
        for title, turn in DEFORMATIONS.items():
            for scheme in SCHEMES:
                row, pictures[title, scheme] = ablation(name, asset, title, turn, scheme, draw=args.out is not None)
                rows.append(row)
                figures = f"{row['spikes']:8.2%} {row['excess']:10.3f} {row['error']:10.4f} {row['jump']:9.4f}"
                print(f"{name:14} {title:12} {scheme:10} {figures}", flush=True)
        pages.append((name, pictures))
    rows += choice()
    if args.out:
        save_png(args.out, page(pages))
        print(f"wrote {args.out}", file=sys.stderr)
    if args.json:
        write_stats(args.json, rows)


def some(count: int) -> Gaussians:
    """Random Gaussians of 3 mm in and around the bar."""
    rng = np.random.default_rng(0)
    return random_gaussians(rng, count, low=(-0.02, -0.02, -0.02), high=(1.02, 0.22, 0.22), sigma=0.003)


def hosts(count: int) -> dict:
    """Time to find all host tets, including the search's tables and transfers, excluding compilation."""
    bar, few = tet_bar(*BAR), some(1000)
    embed(few.means, few.quats, np.exp(few.log_scales), *bar)
    g = some(count)
    scales = np.exp(g.log_scales)
    begin = perf_counter()
    embed(g.means, g.quats, scales, *bar)
    seconds = perf_counter() - begin
    print(f"hosts of {count:,} Gaussians, {len(bar[0]):,} vertices: {seconds:.2f} s", flush=True)
    return {
        "bench": "embedding",
        "what": "hosts",
        "gaussians": count,
        "vertices": len(bar[0]),
        "tets": len(bar[1]),
        "median_ms": 1e3 * seconds,
        "arch": arch(),
    }


def deform(count: int, rounds: int) -> dict:
    """Time to deform all Gaussians: a synchronous call of `Embedding.deform`, with and without rotations."""
    (vertices, tets), g = tet_bar(*BAR), some(count)
    order = np.lexsort(np.floor(g.means / 0.02).T)  # spatially sorted, as in a loaded body
    g = g.select(order)
    e = embed(g.means, g.quats, np.exp(g.log_scales), vertices, tets)
    x, mean = ti.Vector.field(3, ti.f32, len(vertices)), ti.Vector.field(3, ti.f32, count)
    cov, rotation = ti.Vector.field(6, ti.f32, count), ti.Vector.field(4, ti.f32, count)
    row = {"bench": "embedding", "what": "deform", "gaussians": count, "vertices": len(vertices), "arch": arch()}
    for rotated in (True, False):
        stage = Embedding([EmbeddedPart(e.host, e.weights, g, vertices, tets)], with_rotation=rotated)
        times = []
        for k in range(rounds + 3):
            x.from_numpy(moved(vertices, 0.3 + 0.01 * k, axis=0)[0].astype(np.float32))
            ti.sync()
            begin = perf_counter()
            stage.deform(x, mean, cov, rotation)
            ti.sync()
            times.append(perf_counter() - begin)
        took, each = median(times[3:]), stage.bytes / count
        ending = "" if rotated else "_no_rotation"
        row |= {f"median_ms{ending}": 1e3 * took, f"bytes{ending}": each, f"gb_per_s{ending}": stage.bytes / took / 1e9}
        what = "with" if rotated else "without"
        rate = f"{each:.0f} bytes each, {stage.bytes / took / 1e9:.1f} GB/s"
        print(f"carrying {count:,} Gaussians, {what} rotations: {1e3 * took:.3f} ms, {rate}", flush=True)
        stage.destroy()
    return row


def choice() -> list[dict]:
    """Jumps and errors of a twist by 180 degrees against k and the floor of the local tetrahedra."""
    rng, rows = np.random.default_rng(3), []
    bar = tet_bar((20, 4, 4), (1.0, 0.2, 0.2))
    g = random_gaussians(rng, 20_000, sigma=0.006, spread=0.8)
    turned = np.moveaxis(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]) @ bar[0].T, 0, 1), bar[1]  # upright
    g = g.transformed(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]))
    print("\na bar, 180 degrees, tets of 5 cm, Gaussians of 6 mm")
    print(f"{'k':>6} {'floor':>6} {'jump 95%':>9} {'error 95%':>10}", flush=True)
    for k, floor in [*((k, 0.15) for k in KS), *((1 / 3, f) for f in FLOORS)]:
        e = embed(g.means, g.quats, np.exp(g.log_scales), *turned, k=k, floor=floor)
        found = carried(g, e, turned, np.pi, "two-level")
        row = {"bench": "embedding", "what": "choice", "k": k, "floor": floor, "error": found.error(), "arch": arch()}
        row["jump"] = jump(g, e, turned, np.pi, "two-level")
        rows.append(row)
        print(f"{k:6.3f} {floor:6.2f} {row['jump']:9.4f} {row['error']:10.4f}", flush=True)
    return rows
