"""A bar that is twisted, held and let go: its Gaussians, and torsion beside the theory of slender bars.

Held between two clamps, the angle grows linearly from one to the other. A bar of square section that is clamped at one
end swings in torsion at f = sqrt(0.8436 G / rho) / 4 L: the torsion constant of a square of side a is 0.1406 a^4, its
polar moment of area a^4 / 6 (Timoshenko and Goodier, Theory of Elasticity, 1951, ch. 11).
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import median
from time import perf_counter

import numpy as np
import taichi as ti

from assets.asset import Asset
from bench.embedding_ablation import BodyPictures
from core.material import Material
from sim.embedding import EmbeddedBody, Embedding
from sim.model import SoftBody
from sim.solver import Solver

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
        show = _Pictures(self.asset, solver) if draw else None
        if show:
            pictures["at rest"] = show.picture()
        ramp, hold, swing = (max(round(s / FRAME), 1) for s in seconds)
        for k in range(ramp + hold):
            u = min((k + 1) / ramp, 1.0)
            solver.kinematic.drive_vertices(0, self.top, turned(self.rest[self.top], turn * u * u * (3 - 2 * u)))
            solver.step(FRAME)
        x = solver.snapshot()["x"].astype(np.float64)
        angles = [self.angle(x, h) / turn for h in HEIGHTS]
        volume = enclosed(x, self.asset) / enclosed(self.rest, self.asset)
        if show:
            pictures[f"twisted by {np.degrees(turn):.0f}° and held"] = show.picture()
        motion = solver.snapshot()
        solver.destroy()

        solver = self.solver(clamped=False, integrator=integrator)
        solver.restore({"x": motion["x"], "v": np.zeros_like(motion["v"])})
        show = _Pictures(self.asset, solver) if draw else None
        series, times = [], []
        for k in range(swing):
            begin = perf_counter()
            solver.step(FRAME)
            ti.sync()
            times.append(perf_counter() - begin)
            series.append(self.angle(solver.snapshot()["x"].astype(np.float64), 1.0 - SLAB))
            if show and k == round(0.5 * quarter_period(self) / FRAME):
                pictures["let go, a moment later"] = show.picture()
        if show:
            pictures[f"after {swing * FRAME:.1f} s"] = show.picture()
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


class _Pictures:
    """Pictures of a bar as a solver has it."""

    def __init__(self, asset: Asset, solver: Solver):
        g, e, c = asset.gaussians, asset.embedding, asset.cage
        self.solver, self.body = solver, BodyPictures(g)
        self.embedding = Embedding([EmbeddedBody(e.host, e.weights, g, c.vertices, c.tets)])

    def picture(self) -> np.ndarray:
        """Picture (PANEL, PANEL, 3) uint8 of the bar as it is now."""
        s = self.body.splats
        self.embedding.deform(self.solver.x, s.mean, s.cov, s.rotation)
        return self.body.draw()


def quarter_period(bar: TwistedBar) -> float:
    """A quarter of the period of torsion [s], by theory: the time in which a wave of torsion runs along the bar."""
    shear, _ = MATERIAL.lame_parameters
    top = bar.rest[:, 1].max()
    return (top - bar.foot) / float(np.sqrt(SQUARE * shear / MATERIAL.density))


def turned(x: np.ndarray, angle: float) -> np.ndarray:
    """Points (N, 3) after a rotation about the y axis through their middle."""
    c, s = np.cos(angle), np.sin(angle)
    middle = x.mean(0)
    return (x - middle) @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T + middle


def enclosed(x: np.ndarray, asset: Asset) -> float:
    """Volume of the bar's tets at x (V, 3)."""
    corners = x[asset.cage.tets]
    return float(np.linalg.det(corners[:, 1:] - corners[:, :1]).sum() / 6)


def crossing_frequency(angle: np.ndarray) -> float:
    """Frequency [Hz] of a swing sampled each FRAME, from its zero crossings; NaN with fewer than three."""
    k = np.flatnonzero(np.diff(np.sign(angle)) != 0)
    if len(k) < 3:
        return float("nan")
    at = k + angle[k] / (angle[k] - angle[k + 1])
    return float((len(at) - 1) / (2 * (at[-1] - at[0]) * FRAME))
