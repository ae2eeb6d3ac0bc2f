"""The paper's ablation of the embedding (VR-GS, Sec. 4.3.2), a figure of `vrgs.py figures`: one level against two.

The cage of a bar is twisted and stretched by formula; each Gaussian is compared with its image under the formula's own
gradient.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import taichi as ti

from assets.asset import Asset
from assets.gaussians import Gaussians
from bench.synthetic_room import box_surface, turns_to
from core.camera import look_at, perspective
from core.spherical_harmonics import C0
from display.picture import pixels_of
from prepare.pipeline import Options, prepare
from render.renderer import Renderer
from render.splats import Splats
from sim.embedding import EmbeddedBody, Embedding

SCHEMES = ("one-level", "two-level")
DEFORMATIONS = {"90 degrees": 0.5 * np.pi, "180 degrees": np.pi, "360 degrees": 2 * np.pi, "stretch 1.5": None}
SPIKE_RATIO = 2.0  # a Gaussian is a spike if its axis ratio exceeds the correct one by this factor
CAGE_VERTICES = 800  # tets of a tenth of the body
PANEL = 340  # [px] sides of a picture on the page
WORST_SHOWN = 0.3  # error that has the full colour
PALE, RED = np.array([0.93, 0.92, 0.88]), np.array([0.78, 0.08, 0.08])


def arch() -> str:
    """Name of the Taichi backend: "cuda", "x64" ..."""
    return str(ti.cfg.arch).removeprefix("Arch.")


def striped_bar() -> Asset:
    """A bar of 8 x 30 x 8 cm with flat, striped Gaussians, in a cage of CAGE_VERTICES."""
    rng, count = np.random.default_rng(0), 13_000
    points, normals = box_surface(rng, count, np.array([-0.04, 0.0, -0.04]), np.array([0.08, 0.3, 0.08]))
    scales = 0.003 * np.stack([*rng.uniform(0.4, 0.9, (2, count)), rng.uniform(0.03, 0.2, count)], 1)
    stripes = 0.9 * np.sign(np.sin(2 * np.pi * points[:, 1] / 0.03))[:, None] * [1.0, 0.5, -0.4]
    quats = turns_to(normals, rng.uniform(0, np.pi, count))
    g = Gaussians.of(points, quats, np.log(scales), np.full(count, 4.0), stripes[:, None])
    return prepare(g, Options(vertices=CAGE_VERTICES, scale=0.3, up="+y"))


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


class CarriedGaussians:
    """Gaussians that a cage (vertices, tets) carries by a scheme, and their splats if given."""

    def __init__(self, g: Gaussians, embedded, cage, scheme: str, splats: Splats | None = None) -> None:
        (self.vertices, tets), self.g, n = cage, g, len(g)
        self.x = ti.Vector.field(3, ti.f32, len(self.vertices))
        bodies = [EmbeddedBody(embedded.host, embedded.weights, g, self.vertices, tets)]
        self.embedding = Embedding(bodies, scheme=scheme)
        fields = [splats.mean, splats.cov, splats.rotation] if splats else None
        self.out = fields or [ti.Vector.field(k, ti.f32, n) for k in (3, 6, 4)]

    def deform(self, turn: float | None) -> tuple[np.ndarray, np.ndarray]:
        """Covariances (N, 3, 3) [m^2] after the cage was deformed, and those of the formula."""
        n = len(self.vertices)
        y, F = deformed(np.concatenate([self.vertices, self.g.means]), turn)  # depends on the extent of both
        self.x.from_numpy(y[:n].astype(np.float32))
        self.embedding.deform(self.x, *self.out)
        F = F[n:]
        exact = F @ covariances(self.g.covariances) @ np.moveaxis(F, 1, 2)
        return covariances(self.out[1].to_numpy()[: len(self.g)]), exact

    def destroy(self) -> None:
        """Free the device memory of the embedding."""
        self.embedding.destroy()


def errors_of(found: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """|Sigma - exact| / |exact| of each Gaussian."""
    return np.linalg.norm(found - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))


def all_alike(g: Gaussians) -> Gaussians:
    """Gaussians at the same places, all with the same covariance."""
    n, scales = len(g), np.log(np.tile([0.01, 0.02, 0.03], (len(g), 1)))
    return Gaussians.of(g.means, np.tile([1.0, 0, 0, 0], (n, 1)), scales, np.zeros(n), np.zeros((n, 1, 3)))


def jump_of(means: np.ndarray, found: np.ndarray, exact: np.ndarray) -> float:
    """95th percentile of the error's jump between neighbours, of Gaussians that are `all_alike`."""
    from scipy.spatial import cKDTree

    near, off = cKDTree(means).query(means, k=5)[1][:, 1:], found - exact
    jumps = np.linalg.norm(off[:, None] - off[near], axis=(2, 3)) / np.linalg.norm(exact, axis=(1, 2))[:, None]
    return float(np.percentile(jumps, 95))


class Ablation:
    """A prepared body whose cage is deformed by formula and carries the Gaussians by one scheme."""

    def __init__(self, name: str, asset: Asset, scheme: str, pictures: BodyPictures | None = None) -> None:
        g, e, cage = asset.gaussians, asset.embedding, (asset.cage.vertices, asset.cage.tets)
        self.name, self.scheme, self.g, self.vertices = name, scheme, g, len(cage[0])
        self.pictures = pictures
        self.carried = CarriedGaussians(g, e, cage, scheme, pictures.splats if pictures else None)
        self.alike = CarriedGaussians(all_alike(g), e, cage, scheme)

    def measure(self, title: str) -> tuple[dict, list[np.ndarray]]:
        """A row of the table, and if there are to be pictures: the deformed body, and the same coloured by the error of
        each Gaussian's covariance, from none, pale, to WORST_SHOWN, red."""
        turn = DEFORMATIONS[title]
        found, exact = self.carried.deform(turn)
        axes = (np.linalg.eigvalsh(S) for S in (found, exact))
        ratios = [np.sqrt(w[:, 2] / np.maximum(w[:, 0], 1e-6 * w[:, 2])) for w in axes]
        excess = ratios[0] / ratios[1]
        row = {"bench": "embedding", "what": "ablation", "body": self.name, "deformation": title}
        row |= {"scheme": self.scheme, "gaussians": len(self.g), "vertices": self.vertices}
        errors = errors_of(found, exact)
        row |= {"error": float(np.percentile(errors, 95)), "spikes": float((excess > SPIKE_RATIO).mean())}
        row |= {"excess": float(np.percentile(excess, 99))}
        row |= {"jump": jump_of(self.g.means, *self.alike.deform(turn)), "arch": arch()}
        if self.pictures is None:
            return row, []
        part = (errors / WORST_SHOWN).clip(0.0, 1.0)[:, None]
        return row, [self.pictures.draw(c, stretched=turn is None) for c in (None, (1 - part) * PALE + part * RED)]

    def destroy(self) -> None:
        """Free the device memory of the embeddings."""
        self.carried.destroy()
        self.alike.destroy()


def measure_ablations(name: str, asset: Asset, titles, *, draw: bool) -> Iterator[tuple[dict, list[np.ndarray]]]:
    """Row and pictures of each deformation by each scheme."""
    pictures = BodyPictures(asset.gaussians) if draw else None
    ablations = [Ablation(name, asset, scheme, pictures) for scheme in SCHEMES]
    for title in titles:
        for ablation in ablations:
            yield ablation.measure(title)
    for part in filter(None, (*ablations, pictures)):
        part.destroy()


class BodyPictures:
    """Pictures of a body that stands on y = 0, as its `splats` have it."""

    def __init__(self, g: Gaussians) -> None:
        self.g, self.splats, self.extent = g, Splats(g), np.ptp(g.means, axis=0)
        self.renderer = Renderer(self.splats, PANEL, PANEL, background=(0.96, 0.96, 0.95))

    def draw(self, colors: np.ndarray | None = None, *, stretched: bool = False) -> np.ndarray:
        """Picture (PANEL, PANEL, 3) uint8; with other colours (N, 3) than its own; `stretched`: there is room for one
        and a half of the height."""
        sh = self.g.sh
        if colors is not None:
            sh = np.concatenate([((colors - 0.5) / C0)[:, None], np.zeros_like(sh[:, 1:])], axis=1)
        self.splats.sh.from_numpy(self.splats.padded(sh))
        extent = self.extent * ([1, 1.5, 1] if stretched else [1, 1, 1])
        target, fov = np.array([0.0, 0.5 * extent[1], 0.0]), np.radians(30)
        eye = target + np.linalg.norm(extent) / np.tan(fov / 2) * np.array([0.28, 0.20, 0.56])
        self.renderer.render([perspective(PANEL, PANEL, fov, look_at(eye, target))])
        return pixels_of(self.renderer.picture)[..., :3].copy()

    def destroy(self) -> None:
        """Free the device memory."""
        self.renderer.destroy()
        self.splats.destroy()
