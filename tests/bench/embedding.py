"""`vrgs.py bench embedding`: how long hosts take to find and Gaussians to carry, and what the second level is good for.

Speed: Gaussians in a bar of 10,985 vertices. What it is good for, the paper's ablation (VR-GS, Sec. 4.3.2): the cages
of prepared bodies are twisted and stretched by formula; each Gaussian is compared with what the formula's own gradient
makes of it. `--out` draws both as a strip of pictures.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from statistics import median
from time import perf_counter

import numpy as np
import taichi as ti

from assets.asset import Asset
from assets.files import read_gaussians
from assets.gaussians import Gaussians
from assets.library import SHIPPED
from display.picture import pixels_of, save_png
from display.stats import write_stats
from display.strip import FAINT, FOOT, GAP, HEAD, INK, MARGIN, PANEL, PAPER, write
from display.studio import framing
from display.video import claim
from prepare.embed import embed
from prepare.hosts import embed_on_device
from prepare.pipeline import prepare
from render.renderer import Renderer
from render.splats import Splats
from sim.embedding import EmbeddedPart, Embedding, rest_covariances
from tests.bars import random_gaussians, tet_bar
from tests.stages import brick

BAR = (64, 12, 12), (1.0, 0.2, 0.2)  # cells and size [m]: 10,985 vertices, 55,296 tets
SCHEMES = ("one-level", "two-level")
DEFORMATIONS = {"90 degrees": 0.5 * np.pi, "180 degrees": np.pi, "360 degrees": 2 * np.pi, "stretch 1.5": None}
SPIKE = 2.0  # a Gaussian is a spike if its axis ratio is so many times the one that it should have
VERTICES = 800  # of the ablation's cages: tets of a tenth of the body
KS, FLOORS = (0.0, 1 / 6, 1 / 3, 0.5, 1.0), (0.05, 0.1, 0.15, 0.2, 0.3)
WHITE = (0.96, 0.96, 0.95)
ROOM = 1.25  # of the body, what a picture shows


def run(args) -> None:
    """The command: measure, print tables, write --json and --out."""
    for file in filter(None, (args.json, args.out)):
        claim(file, file.with_name(f".{file.name}.part"))
    rows = [hosts(args.count), deform(args.count, args.rounds)]
    names = ["bar", *([args.splats] if args.splats != SHIPPED / "dining_room.h5" else [])]
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


def arch() -> str:
    return str(ti.cfg.arch).removeprefix("Arch.")


def some(count: int) -> Gaussians:
    """Gaussians of 3 mm in and round the bar."""
    rng = np.random.default_rng(0)
    return random_gaussians(rng, count, low=(-0.02, -0.02, -0.02), high=(1.02, 0.22, 0.22), sigma=0.003)


def hosts(count: int) -> dict:
    """Time to find all hosts, the search's tables and the transfers included, compiling not."""
    bar, few = tet_bar(*BAR), some(1000)
    embed_on_device(few.means, few.quats, np.exp(few.log_scales), *bar)
    g = some(count)
    scales = np.exp(g.log_scales)
    seconds = {}
    for name, function in (("kernel", embed_on_device), ("numpy", embed)):
        begin = perf_counter()
        function(g.means, g.quats, scales, *bar)
        seconds[name] = perf_counter() - begin
        print(f"hosts of {count:,} Gaussians, {len(bar[0]):,} vertices, {name}: {seconds[name]:.2f} s", flush=True)
    return {
        "bench": "embedding",
        "what": "hosts",
        "gaussians": count,
        "vertices": len(bar[0]),
        "tets": len(bar[1]),
        "median_ms": 1e3 * seconds["kernel"],
        "numpy_ms": 1e3 * seconds["numpy"],
        "arch": arch(),
    }


def deform(count: int, rounds: int) -> dict:
    """Time to carry all Gaussians, a call of `Embedding.deform` and waiting for it, with and without rotations."""
    (vertices, tets), g = tet_bar(*BAR), some(count)
    order = np.lexsort(np.floor(g.means / 0.02).T)  # neighbours beside one another, as in a loaded body
    g = g.select(order)
    e = embed_on_device(g.means, g.quats, np.exp(g.log_scales), vertices, tets)
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


def body(source) -> tuple[str, Asset]:
    """Name and prepared asset: "bar" is made here, 8 x 30 x 8 cm of flat Gaussians with stripes; or a file's."""
    if source == "bar":
        g = brick(np.random.default_rng(0), (-0.04, 0, -0.04), (0.04, 0.3, 0.04), 0.003, 0.0003)
        stripes = 0.9 * np.sign(np.sin(2 * np.pi * g.means[:, 1] / 0.03))[:, None] * [1.0, 0.5, -0.4]
        g = Gaussians.of(g.means, g.quats, g.log_scales, np.full(len(g), 4.0), stripes[:, None])
        return "bar", prepare(g, vertices=VERTICES, scale=0.3, up="+y")
    if source.suffix == ".h5":
        return source.stem, Asset.load(source)
    return source.stem, prepare(read_gaussians(source), vertices=VERTICES)


def moved(x: np.ndarray, turn: float | None, axis: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) of a body twisted about an axis by `turn` [rad] from its one end to the other, or for None ever
    more stretched along it, to 1.5 of its length; and the gradients F (N, 3, 3)."""
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


@dataclass(frozen=True)
class Carried:
    """What became of the Gaussians: covariances (N, 3, 3) and those that the formula asks for [m^2]."""

    cov: np.ndarray
    truth: np.ndarray
    means: np.ndarray  # at rest [m]

    def excess(self) -> np.ndarray:
        """Each Gaussian's axis ratio over the one that it should have, (N,)."""
        found, wanted = (np.linalg.eigvalsh(S) for S in (self.cov, self.truth))
        found, wanted = (np.sqrt(w[:, 2] / np.maximum(w[:, 0], 1e-6 * w[:, 2])) for w in (found, wanted))
        return found / wanted

    def error(self) -> float:
        """95th percentile of |Sigma - truth| / |truth|."""
        return float(np.percentile(self._norm(self.cov - self.truth) / self._norm(self.truth), 95))

    def _norm(self, S) -> np.ndarray:
        return np.linalg.norm(S, axis=(-2, -1))


def full(six: np.ndarray) -> np.ndarray:
    """(N, 3, 3) of (xx, xy, xz, yy, yz, zz)."""
    return six[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3).astype(np.float64)


def carried(g: Gaussians, embedded, cage, turn, scheme: str, splats=None) -> Carried:
    """Deform the cage (vertices, tets) and let it carry the Gaussians; their splats too, if given."""
    n = len(g)
    vertices, tets = cage
    both = np.concatenate([vertices, g.means]).astype(np.float64)  # the formula goes by the extent of all
    y, F = moved(both, turn)
    x = ti.Vector.field(3, ti.f32, len(vertices))
    x.from_numpy(y[: len(vertices)].astype(np.float32))
    stage = Embedding([EmbeddedPart(embedded.host, embedded.weights, g, vertices, tets)], scheme=scheme)
    out = [splats.mean, splats.cov, splats.rotation] if splats else [ti.Vector.field(k, ti.f32, n) for k in (3, 6, 4)]
    stage.deform(x, *out)
    cov = full(out[1].to_numpy()[:n])
    stage.destroy()
    F = F[len(vertices) :]
    return Carried(cov, F @ full(rest_covariances(g)) @ np.moveaxis(F, 1, 2), g.means.astype(np.float64))


def ablation(name: str, asset: Asset, title: str, turn, scheme: str, *, draw: bool) -> tuple[dict, np.ndarray | None]:
    """A row of the table, and the picture."""
    g, cage = asset.gaussians, (asset.cage.vertices, asset.cage.tets)
    splats = Splats(g) if draw else None
    found = carried(g, asset.embedded, cage, turn, scheme, splats)
    row = {"bench": "embedding", "what": "ablation", "body": name, "deformation": title, "scheme": scheme}
    row |= {"gaussians": len(g), "vertices": len(cage[0]), "error": found.error()}
    excess = found.excess()
    row |= {"spikes": float((excess > SPIKE).mean()), "excess": float(np.percentile(excess, 99))}
    row |= {"jump": jump(g, asset.embedded, cage, turn, scheme), "arch": arch()}
    return row, picture(splats, g, turn) if draw else None


def jump(g: Gaussians, embedded, cage, turn, scheme: str) -> float:
    """95th percentile of how much neighbours differ beyond the formula, if all had the same shape at rest."""
    from scipy.spatial import cKDTree

    n = len(g)
    scales = np.log(np.tile([0.01, 0.02, 0.03], (n, 1)))
    same = Gaussians.of(g.means, np.tile([1.0, 0, 0, 0], (n, 1)), scales, np.zeros(n), np.zeros((n, 1, 3)))
    found = carried(same, embedded, cage, turn, scheme)
    near = cKDTree(g.means).query(g.means, k=5)[1][:, 1:]
    off = found.cov - found.truth
    jumps = np.linalg.norm(off[:, None] - off[near], axis=(2, 3)) / np.linalg.norm(found.truth, axis=(1, 2))[:, None]
    return float(np.percentile(jumps, 95))


def picture(splats: Splats, g: Gaussians, turn) -> np.ndarray:
    """Picture (PANEL, PANEL, 3) uint8 of a deformed body."""
    extent = ROOM * np.ptp(g.means, axis=0) * ([1, 1.5, 1] if turn is None else [1, 1, 1])
    camera = framing(np.array([0.0, 0.0, 0.0]), extent, PANEL, PANEL)
    renderer = Renderer(splats, PANEL, PANEL, background=WHITE)
    renderer.render([camera])
    pixels = pixels_of(renderer.picture)[..., :3].copy()
    renderer.destroy()
    return pixels


def page(pages: list) -> np.ndarray:
    """All pictures: for each body two rows, one scheme each, and a column for each deformation."""
    width = 2 * MARGIN + len(DEFORMATIONS) * (PANEL + GAP)
    paper = np.full((HEAD + 2 * len(pages) * (PANEL + FOOT) + MARGIN, width, 3), PAPER, np.uint8)
    write(paper, "One level and two: Gaussians carried by a coarse cage", (MARGIN, 34), 22, weight=600)
    for c, title in enumerate(DEFORMATIONS):
        write(paper, title, (MARGIN + c * (PANEL + GAP), HEAD - 12), 20, INK, weight=600)
    for r, (name, pictures) in enumerate(pages):
        for (title, scheme), panel in pictures.items():
            c, k = list(DEFORMATIONS).index(title), 2 * r + SCHEMES.index(scheme)
            left, top = MARGIN + c * (PANEL + GAP), HEAD + k * (PANEL + FOOT)
            paper[top : top + PANEL, left : left + PANEL] = panel
            write(paper, f"{name}, {scheme}", (left, top + PANEL + 20), 15, FAINT)
    return paper


def choice() -> list[dict]:
    """How k and the floor of the local tetrahedra were chosen: jumps and errors of a twist by 180 degrees."""
    rng, rows = np.random.default_rng(3), []
    bar = tet_bar((20, 4, 4), (1.0, 0.2, 0.2))
    g = random_gaussians(rng, 20_000, sigma=0.006, spread=0.8)
    turned = np.moveaxis(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]) @ bar[0].T, 0, 1), bar[1]  # upright
    g = g.transformed(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]))
    print("\na bar, 180 degrees, tets of 5 cm, Gaussians of 6 mm")
    print(f"{'k':>6} {'floor':>6} {'jump 95%':>9} {'error 95%':>10}", flush=True)
    for k, floor in [*((k, 0.15) for k in KS), *((1 / 3, f) for f in FLOORS)]:
        e = embed_on_device(g.means, g.quats, np.exp(g.log_scales), *turned, k=k, floor=floor)
        found = carried(g, e, turned, np.pi, "two-level")
        row = {"bench": "embedding", "what": "choice", "k": k, "floor": floor, "error": found.error(), "arch": arch()}
        row["jump"] = jump(g, e, turned, np.pi, "two-level")
        rows.append(row)
        print(f"{k:6.3f} {floor:6.2f} {row['jump']:9.4f} {row['error']:10.4f}", flush=True)
    return rows
