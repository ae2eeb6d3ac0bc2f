"""Figures of `vrgs.py figures` on a striped bar: the ablation of the embedding, and a twist beside theory.

Embedding (VR-GS, Sec. 4.3.2), one level against two: the bar's cage is twisted and stretched by formula; each Gaussian
is compared with its image under the formula's own gradient. Twist: the bar is simulated, twisted, held and let go.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import median
from time import perf_counter

import numpy as np
import taichi as ti
from scipy.spatial import cKDTree

from assets.asset import Asset
from assets.gaussians import Gaussians, symmetric_matrices
from assets.orientation import turned_about_up
from bench.render_speed import box_surface
from core.camera import look_at, perspective
from core.material import Material
from core.rotation import turns_to
from core.spherical_harmonics import C0
from core.tetmesh import tet_volumes
from display.picture import pixels_of
from prepare.pipeline import Options, prepare
from render.renderer import Renderer
from render.splats import Splats
from sim.bodies import SoftBody
from sim.embedding import EmbeddedBody, Embedding
from sim.solver import Solver

SCHEMES = ("one-level", "two-level")
DEFORMATIONS = {"90 degrees": 0.5 * np.pi, "180 degrees": np.pi, "360 degrees": 2 * np.pi, "stretch 1.5": None}
CAGE_VERTICES = 800  # tets of a tenth of the body
PANEL = 340  # [px] sides of a picture on the page
WORST_SHOWN = 0.3  # error that has the full colour
PALE, RED = np.array([0.93, 0.92, 0.88]), np.array([0.78, 0.08, 0.08])


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


class CarriedGaussians:
    """Gaussians that an asset's cage carries by a scheme, and their splats if given."""

    def __init__(self, g: Gaussians, asset: Asset, scheme: str, splats: Splats | None = None) -> None:
        self.g, self.vertices, n = g, asset.cage.vertices, len(g)
        self.x = ti.Vector.field(3, ti.f32, len(self.vertices))
        body = EmbeddedBody(asset.embedding.host, asset.embedding.weights, g, self.vertices, asset.cage.tets)
        self.embedding = Embedding([body], scheme=scheme)
        fields = [splats.mean, splats.cov, splats.rotation] if splats else None
        self.out = fields or [ti.Vector.field(k, ti.f32, n) for k in (3, 6, 4)]

    def deform(self, turn: float | None) -> tuple[np.ndarray, np.ndarray]:
        """Covariances (N, 3, 3) [m^2] after the cage was deformed, and those of the formula."""
        n = len(self.vertices)
        y, F = deformed(np.concatenate([self.vertices, self.g.means]), turn)  # depends on the extent of both
        self.x.from_numpy(y[:n].astype(np.float32))
        self.embedding.deform(self.x, *self.out)
        F = F[n:]
        exact = F @ symmetric_matrices(self.g.covariances) @ np.moveaxis(F, 1, 2)
        return symmetric_matrices(self.out[1].to_numpy()[: len(self.g)].astype(np.float64)), exact


def all_alike(g: Gaussians) -> Gaussians:
    """Gaussians at the same places, all with the same covariance."""
    n, scales = len(g), np.log(np.tile([0.01, 0.02, 0.03], (len(g), 1)))
    return Gaussians.of(g.means, np.tile([1.0, 0, 0, 0], (n, 1)), scales, np.zeros(n), np.zeros((n, 1, 3)))


def jump_of(means: np.ndarray, found: np.ndarray, exact: np.ndarray) -> float:
    """95th percentile of the error's jump between neighbours, of Gaussians that are `all_alike`."""
    near, off = cKDTree(means).query(means, k=5)[1][:, 1:], found - exact
    jumps = np.linalg.norm(off[:, None] - off[near], axis=(2, 3)) / np.linalg.norm(exact, axis=(1, 2))[:, None]
    return float(np.percentile(jumps, 95))


def measure_ablation(asset: Asset, titles: Sequence[str]) -> Iterator[tuple[dict, np.ndarray, np.ndarray]]:
    """Each of DEFORMATIONS that is named, by each scheme: numbers, and two pictures of the deformed body.

    The second one is coloured by the error of each Gaussian's covariance, from none, pale, to WORST_SHOWN, red.
    """
    g, pictures = asset.gaussians, BodyPictures(asset.gaussians)
    carried = {scheme: CarriedGaussians(g, asset, scheme, pictures.splats) for scheme in SCHEMES}
    alike = {scheme: CarriedGaussians(all_alike(g), asset, scheme) for scheme in SCHEMES}
    for title in titles:
        turn = DEFORMATIONS[title]
        for scheme in SCHEMES:
            found, exact = carried[scheme].deform(turn)
            errors = np.linalg.norm(found - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))
            row = {
                "deformation": title,
                "scheme": scheme,
                "error": float(np.percentile(errors, 95)),
                "jump": jump_of(g.means, *alike[scheme].deform(turn)),
            }
            part = (errors / WORST_SHOWN).clip(0.0, 1.0)[:, None]
            colors = (1 - part) * PALE + part * RED
            yield row, *(pictures.draw(c, stretched=turn is None) for c in (None, colors))
    for each in (*carried.values(), *alike.values()):
        each.embedding.destroy()
    pictures.destroy()


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

    def draw_carried(self, asset: Asset, solver: Solver) -> np.ndarray:
        """Picture of the body as the solver of its cage has it now."""
        e, c, s = asset.embedding, asset.cage, self.splats
        embedding = Embedding([EmbeddedBody(e.host, e.weights, self.g, c.vertices, c.tets)])
        embedding.deform(solver.x, s.mean, s.cov, s.rotation)
        embedding.destroy()
        return self.draw()

    def destroy(self) -> None:
        """Free the device memory."""
        self.renderer.destroy()
        self.splats.destroy()


FRAME = 1 / 60  # [s]
CLAMP = 0.06  # of the bar's height, at either end
SLAB = 0.06  # of it: vertices this near count as at a height
HEIGHTS = (0.25, 0.5, 0.75)  # of the height between the clamps, at which the angle is measured
SQUARE = 6 * 0.1406  # torsion constant over polar moment of area
MATERIAL = Material.named("silicone", damping=0.5)


@dataclass(frozen=True)
class Twist:
    """Result of one twist.

    pictures   title to picture (H, W, 3) uint8
    angles     of HEIGHTS while held, over the whole angle
    error      largest distance of these from the straight line
    volume     of the bar while held, over that at rest
    frequency  of the swing after it was let go, and that of the theory [Hz]; NaN if it did not swing long enough
    left       angle at the end of that, over the whole angle
    frame_ms, substeps, dt, iterations   of the solver, while it swings
    """

    pictures: dict[str, np.ndarray]
    angles: list[float]
    error: float
    volume: float
    frequency: tuple[float, float]
    left: float
    frame_ms: float
    substeps: int
    dt: float
    iterations: int


class TwistedBar:
    """A prepared bar that stands upright, with its lower end clamped."""

    def __init__(self, asset: Asset):
        self.asset, self.rest = asset, asset.cage.vertices.astype(np.float64)
        y = self.rest[:, 1]
        low, high = y.min(), y.max()
        self.bottom = np.flatnonzero(y < low + CLAMP * (high - low))
        self.top = np.flatnonzero(y > high - CLAMP * (high - low))
        self.foot, self.head = float(y[self.bottom].max()), float(y[self.top].min())

    def solver(self, *, clamped: bool, integrator: str) -> Solver:
        """A solver of the bar without gravity, its upper end clamped too or not."""
        pinned = np.concatenate([self.bottom, self.top]) if clamped else self.bottom
        c = self.asset.cage
        bar = SoftBody("bar", c.vertices, c.tets, c.surface, MATERIAL, pinned=pinned)
        return Solver([bar], gravity=(0.0, 0.0, 0.0), contacts=False, integrator=integrator, sleep=False)

    def angle(self, x: np.ndarray, height: float) -> float:
        """Mean angle [rad] about y of the vertices at a height between the clamps, 0 to 1."""
        y = self.foot + height * (self.head - self.foot)
        near = np.abs(self.rest[:, 1] - y) < SLAB * (self.head - self.foot)
        a, b = self.rest[near][:, [0, 2]], x[near][:, [0, 2]]
        a, b = a - a.mean(0), b - b.mean(0)
        return float(np.arctan2((a[:, 1] * b[:, 0] - a[:, 0] * b[:, 1]).sum(), (a * b).sum()))

    def twist(self, turn: float, seconds: tuple[float, float, float], integrator: str, *, draw: bool) -> Twist:
        """Twist the upper end by `turn` [rad], hold it, and let it go, for so many seconds each."""
        solver, pictures = self.solver(clamped=True, integrator=integrator), {}
        body = BodyPictures(self.asset.gaussians) if draw else None
        if body:
            pictures["at rest"] = body.draw_carried(self.asset, solver)
        ramp, hold, swing = (max(round(s / FRAME), 1) for s in seconds)
        head, middle = self.rest[self.top], self.rest[self.top].mean(0)
        for k in range(ramp + hold):
            u = min((k + 1) / ramp, 1.0)
            turned = (head - middle) @ turned_about_up(turn * u * u * (3 - 2 * u)).T + middle
            solver.kinematic.drive_vertices(0, self.top, turned)
            solver.step(FRAME)
        x = solver.snapshot()["x"].astype(np.float64)
        angles = [self.angle(x, h) / turn for h in HEIGHTS]
        volume = tet_volumes(x, self.asset.cage.tets).sum() / tet_volumes(self.rest, self.asset.cage.tets).sum()
        if body:
            pictures[f"twisted by {np.degrees(turn):.0f}° and held"] = body.draw_carried(self.asset, solver)
        motion = solver.snapshot()
        solver.destroy()

        solver = self.solver(clamped=False, integrator=integrator)
        solver.restore({"x": motion["x"], "v": np.zeros_like(motion["v"])})
        series, times = [], []
        for k in range(swing):
            begin = perf_counter()
            solver.step(FRAME)
            ti.sync()
            times.append(perf_counter() - begin)
            series.append(self.angle(solver.snapshot()["x"].astype(np.float64), 1.0 - SLAB))
            if body and k == round(0.5 * quarter_period(self) / FRAME):
                pictures["let go, a moment later"] = body.draw_carried(self.asset, solver)
        if body:
            pictures[f"after {swing * FRAME:.1f} s"] = body.draw_carried(self.asset, solver)
            body.destroy()
        stats = solver.stats
        solver.destroy()
        return Twist(
            pictures,
            [float(a) for a in angles],
            float(np.abs(np.subtract(angles, HEIGHTS)).max()),
            float(volume),
            (crossing_frequency(np.array(series)), 1 / (4 * quarter_period(self))),
            float(np.abs(series[-1]) / turn),
            1e3 * median(times),
            int(stats["substeps"]),
            float(stats["dt"]),
            int(stats["iterations"]),
        )


def quarter_period(bar: TwistedBar) -> float:
    """A quarter of the period of torsion [s], by theory: the time in which a wave of torsion runs along the bar."""
    shear, _ = MATERIAL.lame_parameters
    top = bar.rest[:, 1].max()
    return (top - bar.foot) / float(np.sqrt(SQUARE * shear / MATERIAL.density))


def crossing_frequency(angle: np.ndarray) -> float:
    """Frequency [Hz] of a swing sampled each FRAME, from its zero crossings; NaN with fewer than three."""
    k = np.flatnonzero(np.diff(np.sign(angle)) != 0)
    if len(k) < 3:
        return float("nan")
    at = k + angle[k] / (angle[k] - angle[k + 1])
    return float((len(at) - 1) / (2 * (at[-1] - at[0]) * FRAME))
