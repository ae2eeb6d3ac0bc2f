"""One-level against two-level embedding under prescribed twists and stretches.

The cages of prepared bodies are deformed; each Gaussian is compared with its image under the formula's own gradient.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import taichi as ti

from assets.asset import Asset
from assets.gaussians import Gaussians
from assets.splat_files import read_gaussians
from display.headless.picture_strip import FAINT, FOOT, GAP, HEAD, INK, MARGIN, PANEL, PAPER, write
from display.headless.test_floor import framing
from display.picture import pixels_of
from prepare.pipeline import Options, prepare
from render.renderer import Renderer
from render.splats import Splats
from sim.embedding import EmbeddedPart, Embedding
from sim.embedding_weights import rest_covariances
from tests.support.sample_scenes import brick

SCHEMES = ("one-level", "two-level")
DEFORMATIONS = {"90 degrees": 0.5 * np.pi, "180 degrees": np.pi, "360 degrees": 2 * np.pi, "stretch 1.5": None}
SPIKE = 2.0  # a Gaussian is a spike if its axis ratio exceeds the correct one by this factor
VERTICES = 800  # of the cages: tets of a tenth of the body
WHITE = (0.96, 0.96, 0.95)
FRAMING = 1.25  # extent of a picture over that of the body


def arch() -> str:
    """Name of the Taichi backend: "cuda", "x64" ..."""
    return str(ti.cfg.arch).removeprefix("Arch.")


def body(source) -> tuple[str, Asset]:
    """Name and prepared asset: "bar" is built here, 8 x 30 x 8 cm of flat, striped Gaussians; other names are files."""
    if source == "bar":
        g = brick(np.random.default_rng(0), (-0.04, 0, -0.04), (0.04, 0.3, 0.04), 0.003, 0.0003)
        stripes = 0.9 * np.sign(np.sin(2 * np.pi * g.means[:, 1] / 0.03))[:, None] * [1.0, 0.5, -0.4]
        g = Gaussians.of(g.means, g.quats, g.log_scales, np.full(len(g), 4.0), stripes[:, None])
        return "bar", prepare(g, Options(vertices=VERTICES, scale=0.3, up="+y"))
    if source.suffix == ".h5":
        return source.stem, Asset.load(source)
    return source.stem, prepare(read_gaussians(source), Options(vertices=VERTICES))


def moved(x: np.ndarray, turn: float | None, axis: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) of a body twisted about an axis by `turn` [rad] from one end to the other, or for None
    stretched along it progressively to 1.5 times its length; and the gradients F (N, 3, 3)."""
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
    """Deformed Gaussians: covariances (N, 3, 3) [m^2] and the exact ones of the formula."""

    cov: np.ndarray
    truth: np.ndarray
    means: np.ndarray  # at rest [m]

    def excess(self) -> np.ndarray:
        """Axis ratio of each Gaussian over the exact one, (N,)."""
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
    """Deform the cage (vertices, tets) and its Gaussians; also their splats, if given."""
    n = len(g)
    vertices, tets = cage
    both = np.concatenate([vertices, g.means]).astype(np.float64)  # the formula depends on the extent of both
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
    """One row of the table, and the picture."""
    g, cage = asset.gaussians, (asset.cage.vertices, asset.cage.tets)
    splats = Splats(g) if draw else None
    found = carried(g, asset.embedding, cage, turn, scheme, splats)
    row = {"bench": "embedding", "what": "ablation", "body": name, "deformation": title, "scheme": scheme}
    row |= {"gaussians": len(g), "vertices": len(cage[0]), "error": found.error()}
    excess = found.excess()
    row |= {"spikes": float((excess > SPIKE).mean()), "excess": float(np.percentile(excess, 99))}
    row |= {"jump": jump(g, asset.embedding, cage, turn, scheme), "arch": arch()}
    return row, picture(splats, g, turn) if draw else None


def jump(g: Gaussians, embedded, cage, turn, scheme: str) -> float:
    """95th percentile of the difference between neighbours beyond the formula, for equal rest shapes."""
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
    extent = FRAMING * np.ptp(g.means, axis=0) * ([1, 1.5, 1] if turn is None else [1, 1, 1])
    camera = framing(np.array([0.0, 0.0, 0.0]), extent, PANEL, PANEL)
    renderer = Renderer(splats, PANEL, PANEL, background=WHITE)
    renderer.render([camera])
    pixels = pixels_of(renderer.picture)[..., :3].copy()
    renderer.destroy()
    return pixels


def page(pages: list) -> np.ndarray:
    """Contact sheet: two rows for each body, one per scheme, and a column for each deformation."""
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
