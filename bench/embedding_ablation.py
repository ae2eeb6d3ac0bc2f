"""`vrgs.py bench embedding`: time to find host tets and to deform Gaussians, and the benefit of the second level.

Speed: Gaussians in a bar of 10,985 vertices. Benefit, the paper's ablation (VR-GS, Sec. 4.3.2): the cages of prepared
bodies are twisted and stretched by formula; each Gaussian is compared with its image under the formula's own gradient.
`--out` draws both as a page of pictures.
"""

from __future__ import annotations

import sys
from statistics import median
from time import perf_counter

import numpy as np
import taichi as ti

from assets.asset import Asset
from assets.file_access import check_writable
from assets.gaussians import Gaussians
from assets.library import SHIPPED_FOLDER
from assets.splat_files import read_gaussians
from bench.sample_meshes import random_gaussians, tet_bar
from bench.synthetic_room import box_surface, turns_to
from core.camera import look_at, perspective
from display.headless.picture_strip import PAPER, write
from display.picture import pixels_of, save_picture
from display.run_stats import write_stats
from prepare.cage.embedding_hosts import embed
from prepare.pipeline import Options, prepare
from render.renderer import Renderer
from render.splats import Splats
from sim.embedding import EmbeddedBody, Embedding

EMBEDDING_BAR = (64, 12, 12), (1.0, 0.2, 0.2)  # cells and size [m]: 10,985 vertices, 55,296 tets
SCHEMES = ("one-level", "two-level")
DEFORMATIONS = {"90 degrees": 0.5 * np.pi, "180 degrees": np.pi, "360 degrees": 2 * np.pi, "stretch 1.5": None}
SPIKE_RATIO = 2.0  # a Gaussian is a spike if its axis ratio exceeds the correct one by this factor
CAGE_VERTICES = 800  # tets of a tenth of the body
KS, FLOORS = (0.0, 1 / 6, 1 / 3, 0.5, 1.0), (0.05, 0.1, 0.15, 0.2, 0.3)
PANEL, LABEL = 300, 30  # [px] sides of a picture on the page, height of a line of text


def run(args) -> None:
    """Run the command: measure, print tables, write --json and --out."""
    for file in filter(None, (args.json, args.out)):
        check_writable(file)
    rows = [measure_hosts(args.count), measure_deform(args.count, args.rounds)]
    names = ["bar", *([args.splats] if args.splats != SHIPPED_FOLDER / "dining_room.h5" else [])]
    pictures = {}
    print(f"\n{'body':14} {'deformation':12} {'scheme':10} {'spikes':>8} {'ratio 99%':>10}", end=" ")
    print(f"{'error 95%':>10} {'jump 95%':>9}", flush=True)
    for source in names:
        name, asset = prepared(source)
        for title in DEFORMATIONS:
            for scheme in SCHEMES:
                row, picture = measure_ablation(name, asset, title, scheme, draw=args.out is not None)
                pictures[f"{name}, {scheme}", title] = picture
                rows.append(row)
                figures = f"{row['spikes']:8.2%} {row['excess']:10.3f} {row['error']:10.4f} {row['jump']:9.4f}"
                print(f"{name:14} {title:12} {scheme:10} {figures}", flush=True)
    rows += measure_parameters()
    if args.out:
        save_picture(args.out, page(pictures))
        print(f"wrote {args.out}", file=sys.stderr)
    if args.json:
        write_stats(args.json, rows)


def arch() -> str:
    """Name of the Taichi backend: "cuda", "x64" ..."""
    return str(ti.cfg.arch).removeprefix("Arch.")


def gaussians_in_bar(count: int) -> Gaussians:
    """Random Gaussians of 3 mm in and around the bar."""
    rng = np.random.default_rng(0)
    return random_gaussians(rng, count, low=(-0.02, -0.02, -0.02), high=(1.02, 0.22, 0.22), sigma=0.003)


def measure_hosts(count: int) -> dict:
    """Time to find all host tets, including the search's tables and transfers, excluding compilation."""
    bar, few, g = tet_bar(*EMBEDDING_BAR), gaussians_in_bar(1000), gaussians_in_bar(count)
    embed(few.means, few.quats, np.exp(few.log_scales), *bar)
    begin = perf_counter()
    embed(g.means, g.quats, np.exp(g.log_scales), *bar)
    seconds = perf_counter() - begin
    print(f"hosts of {count:,} Gaussians, {len(bar[0]):,} vertices: {seconds:.2f} s", flush=True)
    row = {"bench": "embedding", "what": "hosts", "gaussians": count, "vertices": len(bar[0]), "tets": len(bar[1])}
    return row | {"median_ms": 1e3 * seconds, "arch": arch()}


def measure_deform(count: int, rounds: int) -> dict:
    """Time of `Embedding.deform` including the wait for the device, with and without rotations."""
    (vertices, tets), g = tet_bar(*EMBEDDING_BAR), gaussians_in_bar(count)
    g = g.select(np.lexsort(np.floor(g.means / 0.02).T))  # neighbours side by side, as in a loaded body
    e = embed(g.means, g.quats, np.exp(g.log_scales), vertices, tets)
    x, mean = ti.Vector.field(3, ti.f32, len(vertices)), ti.Vector.field(3, ti.f32, count)
    cov, rotation = ti.Vector.field(6, ti.f32, count), ti.Vector.field(4, ti.f32, count)
    row = {"bench": "embedding", "what": "deform", "gaussians": count, "vertices": len(vertices), "arch": arch()}
    for rotated in (True, False):
        embedding = Embedding([EmbeddedBody(e.host, e.weights, g, vertices, tets)], with_rotation=rotated)
        times = []
        for k in range(rounds + 3):
            x.from_numpy(deformed(vertices, 0.3 + 0.01 * k, axis=0)[0].astype(np.float32))
            ti.sync()
            begin = perf_counter()
            embedding.deform(x, mean, cov, rotation)
            ti.sync()
            times.append(perf_counter() - begin)
        took, moved = median(times[3:]), embedding.bytes_moved
        ending = "" if rotated else "_no_rotation"
        row |= {
            f"median_ms{ending}": 1e3 * took,
            f"bytes{ending}": moved / count,
            f"gb_per_s{ending}": moved / took / 1e9,
        }
        what = "with" if rotated else "without"
        rate = f"{moved / count:.0f} bytes each, {moved / took / 1e9:.1f} GB/s"
        print(f"deforming {count:,} Gaussians, {what} rotations: {1e3 * took:.3f} ms, {rate}", flush=True)
        embedding.destroy()
    return row


def prepared(source) -> tuple[str, Asset]:
    """Name and prepared asset: "bar" is built here, 8 x 30 x 8 cm of flat, striped Gaussians; other names are files."""
    if source == "bar":
        rng, count = np.random.default_rng(0), 13_000
        points, normals = box_surface(rng, count, np.array([-0.04, 0.0, -0.04]), np.array([0.08, 0.3, 0.08]))
        scales = 0.003 * np.stack([*rng.uniform(0.4, 0.9, (2, count)), rng.uniform(0.03, 0.2, count)], 1)
        stripes = 0.9 * np.sign(np.sin(2 * np.pi * points[:, 1] / 0.03))[:, None] * [1.0, 0.5, -0.4]
        quats = turns_to(normals, rng.uniform(0, np.pi, count))
        g = Gaussians.of(points, quats, np.log(scales), np.full(count, 4.0), stripes[:, None])
        return "bar", prepare(g, Options(vertices=CAGE_VERTICES, scale=0.3, up="+y"))
    if source.suffix == ".h5":
        return source.stem, Asset.load(source)
    return source.stem, prepare(read_gaussians(source), Options(vertices=CAGE_VERTICES))


def deformed(x: np.ndarray, turn: float | None, axis: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) twisted about an axis by `turn` [rad] from one end to the other, and the gradients F (N, 3, 3).

    None: stretched along the axis progressively to 1.5 times the length.
    """
    x = np.asarray(x, np.float64)
    low, high = x.min(0), x.max(0)
    length, centre = high[axis] - low[axis], (low + high) / 2
    a, b = (k for k in range(3) if k != axis)
    u = (x[:, axis] - low[axis]) / length
    y, F = x.copy(), np.tile(np.eye(3), (len(x), 1, 1))
    if turn is None:
        y[:, axis] = low[axis] + length * (u + 0.5 * u * u)
        F[:, axis, axis] = 1 + u
        return y, F
    c, s = np.cos(turn * u), np.sin(turn * u)
    p, q = x[:, a] - centre[a], x[:, b] - centre[b]
    y[:, a], y[:, b] = centre[a] + c * p - s * q, centre[b] + s * p + c * q
    F[:, a, a], F[:, a, b], F[:, b, a], F[:, b, b] = c, -s, s, c
    F[:, a, axis] = turn / length * (-s * p - c * q)
    F[:, b, axis] = turn / length * (c * p - s * q)
    return y, F


def covariances(six: np.ndarray) -> np.ndarray:
    """(N, 3, 3) of (xx, xy, xz, yy, yz, zz)."""
    return six[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3).astype(np.float64)


def carry(g: Gaussians, embedded, cage, turn, scheme: str, splats: Splats | None = None):
    """Deform the cage (vertices, tets) and its Gaussians, and their splats if given.

    Returns covariances (N, 3, 3) [m^2] and those of the formula.
    """
    (vertices, tets), n = cage, len(g)
    y, F = deformed(np.concatenate([vertices, g.means]), turn)  # the formula depends on the extent of both
    x = ti.Vector.field(3, ti.f32, len(vertices))
    x.from_numpy(y[: len(vertices)].astype(np.float32))
    embedding = Embedding([EmbeddedBody(embedded.host, embedded.weights, g, vertices, tets)], scheme=scheme)
    out = [splats.mean, splats.cov, splats.rotation] if splats else [ti.Vector.field(k, ti.f32, n) for k in (3, 6, 4)]
    embedding.deform(x, *out)
    found = covariances(out[1].to_numpy()[:n])
    embedding.destroy()
    F = F[len(vertices) :]
    return found, F @ covariances(g.covariances) @ np.moveaxis(F, 1, 2)


def error_of(found: np.ndarray, exact: np.ndarray) -> float:
    """95th percentile of |Sigma - exact| / |exact|."""
    return float(np.percentile(np.linalg.norm(found - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2)), 95))


def jump_of(g: Gaussians, embedded, cage, turn, scheme: str) -> float:
    """95th percentile of the error's jump between neighbours, if all had the same covariance at rest."""
    from scipy.spatial import cKDTree

    n = len(g)
    scales = np.log(np.tile([0.01, 0.02, 0.03], (n, 1)))
    same = Gaussians.of(g.means, np.tile([1.0, 0, 0, 0], (n, 1)), scales, np.zeros(n), np.zeros((n, 1, 3)))
    found, exact = carry(same, embedded, cage, turn, scheme)
    near, off = cKDTree(g.means).query(g.means, k=5)[1][:, 1:], found - exact
    jumps = np.linalg.norm(off[:, None] - off[near], axis=(2, 3)) / np.linalg.norm(exact, axis=(1, 2))[:, None]
    return float(np.percentile(jumps, 95))


def measure_ablation(name: str, asset: Asset, title: str, scheme: str, *, draw: bool) -> tuple[dict, np.ndarray | None]:
    """A row of the table, and a picture of the deformed body."""
    g, cage, turn = asset.gaussians, (asset.cage.vertices, asset.cage.tets), DEFORMATIONS[title]
    splats = Splats(g) if draw else None
    found, exact = carry(g, asset.embedding, cage, turn, scheme, splats)
    axes = (np.linalg.eigvalsh(S) for S in (found, exact))
    ratios = [np.sqrt(w[:, 2] / np.maximum(w[:, 0], 1e-6 * w[:, 2])) for w in axes]
    excess = ratios[0] / ratios[1]
    row = {"bench": "embedding", "what": "ablation", "body": name, "deformation": title, "scheme": scheme}
    row |= {"gaussians": len(g), "vertices": len(cage[0]), "error": error_of(found, exact)}
    row |= {"spikes": float((excess > SPIKE_RATIO).mean()), "excess": float(np.percentile(excess, 99))}
    row |= {"jump": jump_of(g, asset.embedding, cage, turn, scheme), "arch": arch()}
    return row, picture(splats, g, turn) if draw else None


def measure_parameters() -> list[dict]:
    """Jumps and errors of a twist by 180 degrees for sizes k and floors of the local tetrahedra."""
    upright, rows = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), []
    vertices, tets = tet_bar((20, 4, 4), (1.0, 0.2, 0.2))
    g = random_gaussians(np.random.default_rng(3), 20_000, sigma=0.006, spread=0.8).transformed(upright)
    bar = vertices @ upright.T, tets
    print("\na bar, 180 degrees, tets of 5 cm, Gaussians of 6 mm")
    print(f"{'k':>6} {'floor':>6} {'jump 95%':>9} {'error 95%':>10}", flush=True)
    for k, floor in [*((k, 0.15) for k in KS), *((1 / 3, f) for f in FLOORS)]:
        e = embed(g.means, g.quats, np.exp(g.log_scales), *bar, k=k, floor=floor)
        row = {"bench": "embedding", "what": "choice", "k": k, "floor": floor, "arch": arch()}
        row |= {
            "error": error_of(*carry(g, e, bar, np.pi, "two-level")),
            "jump": jump_of(g, e, bar, np.pi, "two-level"),
        }
        rows.append(row)
        print(f"{k:6.3f} {floor:6.2f} {row['jump']:9.4f} {row['error']:10.4f}", flush=True)
    return rows


def picture(splats: Splats, g: Gaussians, turn) -> np.ndarray:
    """Picture (PANEL, PANEL, 3) uint8 of a deformed body that stands on y = 0."""
    extent = np.ptp(g.means, axis=0) * ([1, 1.5, 1] if turn is None else [1, 1, 1])
    target, fov = np.array([0.0, 0.5 * extent[1], 0.0]), np.radians(30)
    eye = target + np.linalg.norm(extent) / np.tan(fov / 2) * np.array([0.28, 0.20, 0.56])
    renderer = Renderer(splats, PANEL, PANEL, background=(0.96, 0.96, 0.95))
    renderer.render([perspective(PANEL, PANEL, fov, look_at(eye, target))])
    pixels = pixels_of(renderer.picture)[..., :3].copy()
    renderer.destroy()
    return pixels


def page(pictures: dict[tuple[str, str], np.ndarray]) -> np.ndarray:
    """All pictures by row and column title, in a table."""
    rows, columns = (list(dict.fromkeys(titles)) for titles in zip(*pictures, strict=True))
    paper = np.full((LABEL + len(rows) * (PANEL + LABEL), len(columns) * PANEL, 3), PAPER, np.uint8)
    for (row, column), panel in pictures.items():
        top, left = LABEL + rows.index(row) * (PANEL + LABEL), columns.index(column) * PANEL
        paper[top : top + PANEL, left : left + PANEL] = panel
        write(paper, f"{row}, {column}", (left + 6, top + PANEL + 20), 15)
    write(paper, "One-level and two-level embedding in a coarse cage", (6, 22), 18, weight=600)
    return paper
