"""The material whose motion is nearest to markers': a scan of Young's moduli, least squares, and honest intervals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from core.errors import BadInput
from core.material import RAYLEIGH_FREQUENCY, Material
from prepare.fit.least_squares import BLOCK_QUANTILE, BLOCKS, Fitted, Prior, loss_of, minimise
from prepare.fit.linear_elasticity import ElasticShape, subdivided
from prepare.fit.marker_tracks import (
    MarkerTracks,
    marker_weights,
    noise_of,
    posed,
    rigid_pose,
    rigid_pose_seen,
    start_of,
)
from prepare.progress import Progress

# The simulator: cage vertices and tets, held vertices, and for each candidate its material and its positions and
# velocities at the start (V, 3); the places of the cage's vertices become those of the markers by weights (M, V).
# Out: places (F, C, M, 3) [m].
Roll = Callable[["CageOfMarkers", list[tuple[Material, np.ndarray, np.ndarray]]], np.ndarray]

STEPS = ("scan", "fit", "interval")  # of the progress
YOUNG_RANGE, DAMPING_RANGE, FRICTION_RANGE = (1e2, 3e8), (0.02, 100.0), (0.0, 1.5)
YIELD_RANGE = (1e-3, 2.0)  # at its end a material is elastic: nothing is strained so far
SCAN_FACTOR = 1.35  # from one Young's modulus of the scan to the next: 16% in frequency
SCAN_RANGE = (5e1, 3e7)  # [Pa] at 100 kg/m^3 and a size of 10 cm, and with size^2 and density
FINE_FACTORS = 1.1 ** np.arange(-3, 4)
FINE_DAMPINGS = (0.5, 4.0)  # [1/s]
YIELD_YOUNGS = (1.4, 2.0)  # times Young's modulus: what stays bent is stiffer than what bends as far and springs back
YIELD_SCAN = np.geomspace(0.004, 0.3, 16)
BETTER = 1 + BLOCK_QUANTILE**2 / (BLOCKS - 1)  # ratio of losses at which one parameter more is one: F of 1 and 9, 10%
FIRST_FRICTION = 0.25  # slides on most slopes: what sticks says nothing of how much less would let it slide
UNITS = {"young": "Pa", "damping": "1/s", "friction": "", "yield_strain": ""}
LONGEST_LAG = 1 / 1260  # [s] of inner friction in the simulator: its substep; other integrators take less
FLOW_SPREAD = 0.07  # of a yield strain: by so much two integrators differ in how far they let a bar flow
MODES = 2  # whose amplitude and speed at the start are fitted
NOT_VISIBLE = np.log(2.5)  # half width of an interval of a logarithm: the number could be 2.5 times as large, or small
FRICTION_NOT_VISIBLE = 0.25
STILL = 4.0  # deviations of the noise by which markers must move against each other
UNEXPLAINED = 0.5  # of the variance of markers against each other: with more left, what presses a thing is not known
UNLIKE = 0.35  # of how markers move against the thing's own way: what is left unexplained of another thing's motion
MOST_REFINED = 2_500  # vertices of a cage that is refined to see what its size costs
REFINED_FACTORS = (0.87, 0.93, 1.0, 1.07, 1.15)  # of Young's modulus from where the slowest mode is as fast
CHORD_STEPS, SMALL_CHORD = 3, 0.01  # steps with the coarse cage's derivatives, and the gain that is worth another
BORDER, BORDERS = 3.0, 3  # [px] by which a box of what is held is made wider and narrower, so many times
AS_LIKELY = 1.1  # of the least mean distance: what is left is the models', not noise, and bears no better test
FAR_OFF = 1e3  # [m]
OFFSET = 0.5  # [px] by which a point of the surface is usually taken for another, where a clip begins


@dataclass(frozen=True, eq=False)
class CageOfMarkers:
    """A cage as the simulator takes it: held vertices (H,), and the markers' weights (M, V). Equal to itself alone."""

    vertices: np.ndarray
    tets: np.ndarray
    held: np.ndarray
    weights: sp.csr_matrix

    def markers(self, x: np.ndarray) -> np.ndarray:
        """Places of the markers (..., M, 3) where the vertices are at x (..., V, 3)."""
        return np.stack([self.weights @ one for one in x])


@dataclass(frozen=True)
class Number:
    """A fitted number and its 90% interval; `seen` False: it does not show. `played`: what suits the given cage."""

    name: str
    unit: str
    value: float
    low: float
    high: float
    played: float
    seen: bool


@dataclass(frozen=True)
class MaterialFit:
    """The result: the asset's material with the numbers that are seen, all numbers, and what the report draws.

    scan      Young's moduli [Pa] and mean distances [m], (n, 2)
    modelled  what is observed of the markers [m], (F, M, D);   by_factor  with E halved and doubled, by the factor
    played    the candidates of those three: material, positions and velocities at the start
    error, moved  root mean squares [m]: what is left, and how far markers moved against the whole
    """

    material: Material
    numbers: tuple[Number, ...]
    scan: np.ndarray
    modelled: np.ndarray
    by_factor: dict[float, np.ndarray]
    played: list[tuple[Material, np.ndarray, np.ndarray]]
    error: float
    moved: float
    noise: float
    steps: int
    mass_known: bool


class MaterialProblem:
    """Markers on a cage, and how parameters become candidates: log E, log damping, friction if planes are there, else
    log yield strain if there is no camera, and corrections of the start (of the velocity of a free body, and of the
    amplitude and speed of its slowest modes).

    rubs, flows   whether friction, or a yield strain, is looked for
    """

    def __init__(self, tracks: MarkerTracks, vertices, tets, material: Material, roll: Roll, where: str):
        self.tracks, self.base, self.roll, self.where = tracks, material, roll, where
        x, tets = np.asarray(vertices, np.float64), np.asarray(tets, np.int64)
        held = np.zeros(0, np.int64)
        if tracks.held is not None:
            held = np.flatnonzero(tracks.is_held(x, tracks.start))
            if len(held) < 3:
                raise BadInput(
                    f"{where}: the held box contains {len(held)} vertices of the cage; at least 3 are needed"
                )
        self.cage = CageOfMarkers(x, tets, held, marker_weights(x, tets, tracks.rest, where))
        self.noise = noise_of(tracks)
        self.check_motion()
        self.size = float(np.ptp(x, axis=0).max())
        self.shape = ElasticShape(x, tets, held, material.poisson, MODES)
        self._set_start()
        self.rubs, log = len(tracks.planes) > 0, np.log
        self.flows = not self.rubs and tracks.camera is None  # films do not show it well (bench/NOTES.md)
        rows = {  # centre, spread, bounds and step of a parameter
            "young": (log(material.young), 6.0, *log(YOUNG_RANGE), 0.02),
            "damping": (log(1.5), 2.0, *log(DAMPING_RANGE), 0.1),
            "friction": (0.4, 1.0, *FRICTION_RANGE, 0.02),
            "yield_strain": (log(YIELD_RANGE[1]), 6.0, *log(YIELD_RANGE), 0.05),
        }
        self.names = ["young", "damping", *["friction"] * self.rubs, *["yield_strain"] * self.flows]
        self.main = len(self.names)
        of_start = [(0.0, 20.0, -200.0, 200.0, 1.0)] * len(self.fields)
        self.prior = Prior(*np.array([*(rows[name] for name in self.names), *of_start]).T)

    def explained(self, error: float, moved: float) -> bool:
        """True if the error [m] is so small a part of a motion [m] that this is the material's doing."""
        return error <= UNLIKE * moved + 3 * self.noise

    def check_motion(self) -> None:
        """Raise BadInput if the markers do not move against each other."""
        self.inner = inner_motion(self.tracks)
        if self.inner < STILL * self.noise and not len(self.tracks.planes):
            raise BadInput(
                f"{self.where}: nothing deforms: markers move by {1e3 * self.inner:.2g} mm against each other,"
                f" their noise is {1e3 * self.noise:.2g} mm"
            )

    def _set_start(self) -> None:
        t, c = self.tracks, self.cage
        place, velocity, known = start_of(t)
        free = not len(c.held)
        pose = rigid_pose(t.rest[known], place[known]) if free and t.pose is None else t.pose
        pose = np.eye(4) if pose is None else pose
        R = pose[:3, :3]
        W = c.weights[known]
        if t.start is None:
            turned = posed(pose, t.rest[known])
            self.x0 = posed(
                pose, c.vertices + self.shape.through(W, t.slopes(turned, known) @ R, place[known] - turned)
            )
        else:
            self.x0 = t.start
        seen = t.slopes(W @ self.x0, known)
        speed = max(0.02 * float(np.sqrt((velocity[known] ** 2).mean())), 2e-3 * self.size / 0.1)
        fields = []
        v = np.zeros_like(self.x0)
        if free:
            r = self.x0 - self.x0.mean(0)
            rigid = [np.tile(axis, (len(r), 1)) for axis in np.eye(3)]
            rigid += [np.cross(axis, r) / (self.size / 2) for axis in np.eye(3)]
            A = np.stack([np.einsum("mij,mj->mi", seen, W @ field).ravel() for field in rigid], 1)
            amount = np.linalg.lstsq(A, velocity[known].ravel(), rcond=None)[0]
            v = np.tensordot(amount, np.stack(rigid), 1)
            fields += [(0 * r, speed * field) for field in rigid]
        v += self.shape.through(W, seen @ R, velocity[known] - np.einsum("mij,mj->mi", seen, W @ v)) @ R.T
        self.v0 = v
        for mode in self.shape.modes @ R.T:
            fields += [(2e-3 * self.size * mode, 0 * mode), (0 * mode, speed * mode)]
        self.fields = fields

    def material(self, theta: np.ndarray) -> Material:
        """The material of parameters (P,)."""
        friction, strain = float(theta[2]) if self.rubs else self.base.friction, self.base.yield_strain
        if self.flows:
            strain = float(np.exp(theta[2])) if self.yields(theta) else None
        return replace(
            self.base,
            young=float(np.exp(theta[0])),
            damping=float(np.exp(theta[1])),
            friction=friction,
            kinetic_friction=None if self.rubs else self.base.kinetic_friction,
            yield_strain=strain,
        )

    def yields(self, theta: np.ndarray) -> bool:
        """True if parameters (P,) have a yield strain that is to be found."""
        return self.flows and bool(theta[2] < self.prior.high[2])

    def candidate(self, theta: np.ndarray) -> tuple[Material, np.ndarray, np.ndarray]:
        """Material, positions and velocities at the start, (V, 3)."""
        x, v = self.x0.copy(), self.v0.copy()
        for amount, (dx, dv) in zip(theta[self.main :], self.fields, strict=True):
            x += amount * dx
            v += amount * dv
        return self.material(theta), x, v

    def places(self, thetas: np.ndarray) -> np.ndarray:
        """Places of the markers [m], (C, F, M, 3)."""
        return np.moveaxis(self.roll(self.cage, [self.candidate(t) for t in thetas]), 1, 0)

    def residuals(self, thetas: np.ndarray) -> np.ndarray:
        """Places less those seen, (C, N) in units of the noise; NaN where a marker is not seen."""
        return self.compared(self.places(thetas))

    def compared(self, places: np.ndarray) -> np.ndarray:
        """Residuals (C, N) of places of the markers (C, F, M, 3)."""
        return self.off(places).reshape(len(places), -1) / self.noise

    def off(self, places: np.ndarray) -> np.ndarray:
        """Residuals (C, F, M, D) [m]: the observation of places (C, F, M, 3) [m] less that of the clip.

        In pictures it is not known exactly which point of the surface a marker is. With offsets of a spread p in noise
        s, r - m + m s / sqrt(s^2 + n p^2), of mean m over n pictures, has independent entries again.
        """
        t = self.tracks
        seen = np.nan_to_num(t.observed(places), nan=FAR_OFF)  # of what exploded: NaN would count as not seen
        off = seen - t.points
        if t.camera is not None:
            n = np.maximum(t.seen.sum(0), 1)[:, None]
            mean = np.nansum(off, axis=1, keepdims=True) / n
            off -= mean * (1 - self.noise / np.sqrt(self.noise**2 + n * (OFFSET * t.metres) ** 2))
        return off

    def blocks(self) -> np.ndarray:
        """The stretch of time of each residual, (N,)."""
        frames, *each = self.tracks.points.shape
        return np.repeat(np.arange(frames) * BLOCKS // frames, np.prod(each))


def inner_motion(tracks: MarkerTracks) -> float:
    """Root mean square [m] of how markers move against the held part, or the nearest rigid motion in each frame."""
    squares, held, pose = [], tracks.held is not None and not np.isfinite(tracks.release), tracks.pose
    for points, seen in zip(tracks.points, tracks.seen, strict=True):
        if held:
            squares.append(((points - np.nanmean(tracks.points, 0)) ** 2)[seen].sum(1).mean())
        elif seen.sum() >= 4:
            if tracks.camera is None:
                pose = rigid_pose(tracks.rest[seen], points[seen])
            else:
                pose = rigid_pose_seen(tracks.camera.part(seen), tracks.rest[seen], points[seen] / tracks.metres, pose)
            off = points[seen] - tracks.observed(posed(pose, tracks.rest[seen]), seen)
            squares.append((off**2).sum(1).mean())
    return float(np.sqrt(np.mean(squares))) if squares else 0.0


def windowed(residuals: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Mean distance from points (F, M, D) in the first quarter, the first half and all of the frames, (C, 3); a short
    time has few minima."""
    frames = len(points)
    off = np.sqrt(np.nansum(residuals.reshape(-1, *points.shape) ** 2, axis=3))
    off = np.where(np.isfinite(off), off, 1e6)
    return np.stack([off[:, : -(-frames // part)].mean((1, 2)) for part in (4, 2, 1)], 1)


def scan_youngs(problem: MaterialProblem) -> np.ndarray:
    """Young's moduli [Pa] that are tried first: those of one time scale for each size and density."""
    unit = problem.base.density / 100 * (problem.size / 0.1) ** 2
    low, high = np.clip(np.array(SCAN_RANGE) * unit, *YOUNG_RANGE)
    return np.geomspace(low, high, 1 + int(np.ceil(np.log(high / low) / np.log(SCAN_FACTOR))))


def first_guess(problem: MaterialProblem, start: np.ndarray, thetas: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """Parameters (P,) of the best of a finer scan about the lowest minima of the first one: thetas, scores (n, ...)."""
    total = np.log(scores).sum(1)
    ends = np.r_[np.inf, total, np.inf]
    minima = np.flatnonzero((ends[1:-1] <= ends[:-2]) & (ends[1:-1] <= ends[2:]))
    minima = minima[np.argsort(total[minima])][:2]
    fine = [start]
    for k in minima:
        for factor in FINE_FACTORS:
            for damping in FINE_DAMPINGS:
                theta = thetas[k].copy()
                theta[:2] = theta[0] + np.log(factor), np.log(damping)
                fine.append(theta)
    fine = np.clip(fine, problem.prior.low, problem.prior.high)
    scores = np.log(windowed(problem.residuals(fine), problem.tracks.points)).sum(1)
    return fine[int(scores.argmin())]


def fit_material(problem: MaterialProblem, progress: Progress, keep, *, mass_known: bool) -> MaterialFit:
    """Fit, and say how sure it is; `keep(name, make)` returns arrays that were kept, or makes and keeps them.

    Raises BadInput where the motion is that of another thing.
    """
    tracks, youngs = problem.tracks, scan_youngs(problem)

    def scan() -> dict[str, np.ndarray]:
        start = problem.prior.centre.copy()
        if problem.rubs:  # what slides hides what it is made of: its way is fitted first, as the asset's material
            start[2] = FIRST_FRICTION
            start = minimise(problem.residuals, start, problem.prior, 1.0).theta
        progress("scan", 0.3)
        thetas = np.tile(start, (len(youngs), 1))
        thetas[:, 0] = np.log(youngs)
        scores = windowed(problem.residuals(thetas), tracks.points)
        progress("scan", 0.6)
        return {"scores": scores, "guess": first_guess(problem, start, thetas, scores)}

    progress("scan", 0.0)
    scanned = keep("scan", scan)
    progress("scan", 1.0)

    def least() -> dict[str, np.ndarray]:
        elastic = minimise(problem.residuals, scanned["guess"], problem.prior, 1.0, lambda d: progress("fit", d / 2))
        found = with_yield(problem, elastic, lambda d: progress("fit", (1 + d) / 2))
        return {name: np.asarray(value) for name, value in vars(found).items()}

    kept = keep("fit", least)
    progress("fit", 1.0)
    fitted = Fitted(**{**kept, "scale": float(kept["scale"]), "steps": int(kept["steps"])})
    theta = fitted.theta
    played = [theta, theta - np.log(2) * np.eye(len(theta))[0], theta + np.log(2) * np.eye(len(theta))[0]]
    places = problem.places(np.stack(played))
    modelled, halved, doubled = tracks.observed(places)
    error = float(np.sqrt(np.nanmean((problem.off(places)[0] ** 2).sum(2))))
    travel = float(np.sqrt(np.nanmean(((tracks.points - np.nanmean(tracks.points, 0)) ** 2).sum(2))))
    moved = max(problem.inner, 0.25 * travel)
    if not problem.explained(error, moved):
        raise BadInput(
            f"{problem.where}: no material moves like this: {1e3 * error:.2g} mm are left of {1e3 * moved:.2g} mm;"
            " are rest, held, planes and the units right?"
        )
    progress("interval", 0.2)
    limit = keep("cage", lambda: limit_of(problem, fitted, lambda done: progress("interval", 0.2 + 0.8 * done)))
    progress("interval", 1.0)
    left = np.sqrt(max(error**2 - tracks.points.shape[2] * problem.noise**2, 0.0))
    numbers = numbers_of(problem, fitted, limit, mass_known, left)
    seen = {n.name: n.played for n in numbers if n.seen and n.name in problem.names}
    own = problem.base.yield_strain
    if own is not None and problem.flows and "young" in seen and "yield_strain" not in seen:
        thetas = np.stack([theta, theta])
        thetas[1, 2] = np.log(own)
        elastic, flows = loss_of(problem.residuals(thetas), fitted.scale)
        seen |= {} if flows < BETTER * elastic else {"yield_strain": None}
    return MaterialFit(
        material=replace(problem.base, **seen, **({"kinetic_friction": None} if "friction" in seen else {})),
        numbers=numbers,
        scan=np.column_stack([youngs, scanned["scores"][:, 2] * problem.noise]),
        modelled=modelled,
        by_factor={0.5: halved, 2.0: doubled},
        played=[problem.candidate(t) for t in played],
        error=error,
        moved=moved,
        noise=problem.noise,
        steps=fitted.steps,
        mass_known=mass_known,
    )


def with_yield(problem: MaterialProblem, elastic: Fitted, progress: Callable[[float], None]) -> Fitted:
    """The minimum with a yield strain where that explains more than chance would, else the elastic one.

    No steps lead there from the elastic one, where nothing flows. Stiffness, damping and yield strain are scanned
    together, near the elastic stiffness: of what is far stiffer and yields far earlier the motion is almost the same,
    and steps end there.
    """
    if not problem.flows:
        return elastic
    tried = [(e, d, strain) for e in YIELD_YOUNGS for d in FINE_DAMPINGS for strain in YIELD_SCAN]
    thetas = np.zeros((len(tried), len(elastic.theta)))
    thetas[:, : problem.main] = np.log(tried)
    thetas[:, 0] += elastic.theta[0]
    thetas = thetas.clip(problem.prior.low, problem.prior.high)
    scores = np.log(windowed(problem.residuals(thetas), problem.tracks.points)).sum(1)
    progress(0.3)
    start = thetas[int(scores.argmin())]
    found = minimise(problem.residuals, start, problem.prior, 1.0, lambda done: progress(0.3 + 0.7 * done))
    before, after = loss_of(np.stack([elastic.residuals, found.residuals]), min(elastic.scale, found.scale))
    return found if before > BETTER * after else elastic


def limit_of(problem: MaterialProblem, fitted: Fitted, progress: Callable[[float], None]) -> dict[str, np.ndarray]:
    """The shift (P,) of the parameters to a cage so fine that its size does not matter, and their spread (P,) to both
    sides, as what is held is not known exactly.

    The motion is fitted once more with the cage cut in eight, a large one as it is, by steps with the derivatives of
    the first fit, from the Young's modulus at which the slowest mode is as fast. Errors of linear tets fall with the
    square of their edges: a third of what this cut changes is left. A box in a picture does not show exactly where the
    held part ends: it is made wider and narrower as long as the motion fits almost as well, and what lies between is
    as likely.
    """
    cage, tracks, theta = problem.cage, problem.tracks, fitted.theta
    large, boxed = len(cage.vertices) > MOST_REFINED, tracks.camera is not None and len(cage.held) > 0
    if large and not boxed:
        return {"shift": np.zeros_like(theta), "spread": np.zeros_like(theta)}
    as_it_is = cage.vertices, cage.tets, sp.identity(len(cage.vertices), format="csr")
    x, tets, W = as_it_is if large else subdivided(cage.vertices, cage.tets)
    fine = CageOfMarkers(x, tets, cage.held, marker_weights(x, tets, tracks.rest, problem.where))

    def stiffness(held: np.ndarray) -> float:
        """Logarithm of the slowest mode's; NaN of what turns about the held vertices."""
        found = ElasticShape(x, tets, held, problem.base.poisson, 1).stiffness[0]
        return np.log(found) if found > 0 else np.nan

    def residuals(cage: CageOfMarkers, thetas: np.ndarray) -> np.ndarray:
        made = [(m, W @ a, W @ b) for m, a, b in map(problem.candidate, thetas)]
        return problem.compared(np.moveaxis(problem.roll(cage, made), 1, 0))

    def fitted_again(held: np.ndarray, trials: np.ndarray) -> tuple[np.ndarray, float]:
        cage, theta, least = replace(fine, held=held), trials[0], np.inf
        for _ in range(CHORD_STEPS + 1):
            rows = residuals(cage, trials)
            losses = np.nanmean(np.abs(rows), axis=1)
            best = int(losses.argmin())
            if not losses[best] < (1 - SMALL_CHORD) * least:
                break
            theta, least = trials[best], float(losses[best])
            step = np.outer((1.0, 0.4), fitted.shift(rows[best]))
            trials = np.clip(theta + step, problem.prior.low, problem.prior.high)
        return theta, least

    same = np.flatnonzero(np.asarray((W[:, cage.held] if len(cage.held) else W[:, :0]).sum(1)).ravel() > 0.999)
    held, begin = [same], 0
    if boxed:
        begin = BORDERS
        held = [np.flatnonzero(tracks.is_held(x, W @ problem.x0, BORDER * k)) for k in range(-BORDERS, BORDERS + 1)]
    slowest, level, first = stiffness(same), np.log(problem.shape.stiffness[0]), np.eye(len(theta))[0]
    stiff = [stiffness(h) if len(h) >= 3 or begin == 0 else np.nan for h in held]
    starts = theta + (level - stiff[begin] + np.log(REFINED_FACTORS))[:, None] * first
    found = {begin: fitted_again(held[begin], starts)}
    if problem.yields(theta):  # a coarse cage flows too unlike a fine one for its derivatives
        own = replace(fine, held=held[begin])
        fitted = minimise(lambda t: residuals(own, t), found[begin][0], problem.prior, fitted.scale, steps=1)
        found = {begin: fitted_again(held[begin], fitted.theta[None])}
    least = found[begin][1]
    for side in (-1, 1):
        k = begin + side
        while 0 <= k < len(held) and np.isfinite(stiff[k]) and found[k - side][1] <= AS_LIKELY * least:
            found[k] = fitted_again(held[k], found[k - side][0] + (stiff[k - side] - stiff[k]) * first[None])
            least = min(least, found[k][1])
            k += side
            progress(len(found) / len(held))
    kept = sorted(k for k in found if found[k][1] <= AS_LIKELY * least)
    ends = [found[k][0] for k in kept]
    for k, beyond in ((kept[0], kept[0] - 1), (kept[-1], kept[-1] + 1)):
        if 0 <= beyond < len(held) and np.isfinite(stiff[beyond]):
            ends.append(found[k][0] + 0.5 * (stiff[k] - stiff[beyond]) * first)
    low, high = np.min(ends, 0), np.max(ends, 0)
    return {"shift": (low + high) / 2 - theta - (slowest - level) / 3 * first, "spread": (high - low) / 2}


def numbers_of(
    problem: MaterialProblem, fitted: Fitted, limit: dict[str, np.ndarray], mass_known: bool, left: float
) -> tuple[Number, ...]:
    """The numbers with their intervals: by the residuals, half of what the cage's size changes, and what is held.

    No number is known better than to what would move markers by `left` [m], which noise does not explain. Where that is
    much of their motion against each other, neither stiffness nor damping is seen, nor the friction of a thing that
    deforms, as at impacts. Solvers take less inner friction than a material has, down to none: as much of the damping
    as this may be is in its interval.
    """
    shift, spread = limit["shift"], limit["spread"]
    half = np.sqrt(fitted.half_widths(problem.blocks()) ** 2 + (0.5 * shift) ** 2 + spread**2)
    slowest = problem.shape.stiffness[0] * np.exp(fitted.theta[0]) / problem.base.density  # squared frequency [1/s^2]
    lag = min(1 / RAYLEIGH_FREQUENCY**2, LONGEST_LAG / np.exp(fitted.theta[1]))  # [s^2] of inner friction / damping
    half[1] = np.hypot(half[1], slowest * lag)
    if problem.flows:
        half[2] = np.hypot(half[2], FLOW_SPREAD)
    per_unit = problem.noise * np.sqrt(problem.tracks.points.shape[2] * (fitted.jacobian**2).mean(0))  # [m]
    half = np.minimum(np.hypot(half, left / np.maximum(per_unit, 1e-9)), 99.0)  # of which exp() is still finite
    pressed = left**2 < UNEXPLAINED * problem.inner**2 or problem.inner < STILL * problem.noise
    found = []
    for k, name in enumerate(problem.names):
        middle = float(np.clip(fitted.theta[k] + shift[k], problem.prior.low[k], problem.prior.high[k]))
        ends = [middle, middle - half[k], middle + half[k], float(fitted.theta[k])]
        if name == "friction":
            seen, ends[1] = bool(pressed and half[k] < FRICTION_NOT_VISIBLE), max(ends[1], 0.0)
        else:
            within = ends[1] > problem.prior.low[k] and ends[2] < problem.prior.high[k]
            seen = bool(problem.explained(left, problem.inner) and within and half[k] < NOT_VISIBLE)
            ends = np.exp(ends).tolist()
        found.append(Number(name, UNITS[name], *ends, seen))
    if not mass_known:  # gravity and what stands still do not show the mass: only E / rho is seen
        young, rho = found[0], problem.base.density
        ratio = [q / rho for q in (young.value, young.low, young.high, young.played)]
        found.insert(0, Number("young / density", "m^2/s^2", *ratio, young.seen))
    return tuple(found)
