"""`vrgs.py bench scene`: time of the `simulate` stage of a headset's frame, for real bodies in rough hands.

Each asset, at each size and of each material, is dropped, thrown, squeezed by two hands and piled up in a scanned room,
in frames of 1/90 s. A size is the number of vertices in all: a pile is two bodies of half of them, or of the largest
size twenty of a twentieth. Times are of Solver.step and Solver.observe with a wait for the device; no body sleeps.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np
import taichi as ti

from assets.asset import Asset
from assets.library import cached_asset, find_asset, is_asset
from assets.splat_files import read_gaussians
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.material import Material
from core.vocabulary import Hand, Plane
from prepare.pipeline import VERSION, Options, prepare
from sim.bodies import SoftBody
from sim.contact.contact_samples import points_of, spacing_for
from sim.contact.static_shapes import Shape, StaticGrid
from sim.model import BodyModel, Capacity, Model, RestShape
from sim.solver import Solver

FRAME = 1 / 90  # [s]
DEFAULT_ASSETS = ("toy_teddy", "toy_elephant", "ring_red")
DEFAULT_SIZES = ("10k", "20k", "46k")
PILED, MANY, MANY_FROM = 2, 20, 40_000  # bodies of a pile; of this many vertices on, there are MANY
WARM_FRAMES = 4  # of each act, before those that are measured: they compile
FRAMES, QUICK_FRAMES = 1000, 240  # of a row; quick: all acts of one body, once
SECONDS, QUICK_SECONDS = 20.0, 2.0  # for a row at most: a slow device plays fewer frames
COLUMNS = ("vertices", "tets", "integrator", "substeps", "most_rows", "frames")
TIMES = ("median", "p99", "worst")

WALL, STEP_HEIGHT = 0.6, 0.03  # [m] x of the wall, and height of the step in the floor, at x < 0
SPACING, ROOM = 0.02, ((-1.2, -0.2, -1.0), (0.8, 1.6, 1.0))  # [m] of the room's distance grid, and its corners
THROW_SPEED = 10.0  # [m/s]
DROP_HEIGHT = 0.5  # [m] that a dropped body falls
CLEARANCE = 0.02  # [m] to floor, wall and each other at the beginning
PRESS, STRETCH, LIFT = 0.6, 1.3, 0.15  # length under the hands, of that at first; [m] that they raise the body
REACH = 0.04  # [m] of a hand
LAYER = (2, 2)  # bodies side by side in a layer of the pile


class Play(NamedTuple):
    """A row: the acts of `count` bodies that are played in turn."""

    acts: tuple[str, ...]
    count: int


def run(
    *,
    asset: list[str] | None,
    sizes: list[str] | None,
    materials: list[str],
    acts: list[str],
    frames: int | None,
    quick: bool,
) -> Iterator[dict]:
    """Measure every row; prints and yields it. Raises BadInput."""
    wanted = [vertices_of(size) for size in sizes or DEFAULT_SIZES]
    frames = frames or (QUICK_FRAMES if quick else FRAMES)
    seconds = QUICK_SECONDS if quick else SECONDS
    print(f"{'asset':14} {'size':>6} {'acts':18} {'material':9}" + "".join(f" {c:>10}" for c in (*COLUMNS, *TIMES)))
    for size in wanted:
        for row in measure_size(asset or DEFAULT_ASSETS, size, plays_of(acts, size, quick), materials, frames, seconds):
            figures = "".join(f" {row[c]:>10}" for c in COLUMNS) + "".join(f" {row[c + '_ms']:>10.2f}" for c in TIMES)
            print(f"{row['asset']:14} {size:>6} {row['acts']:18} {row['material']:9}{figures}", flush=True)
            if not row["sound"]:
                print("vrgs: bench scene: not finite: {asset} {size} {acts} {material}".format(**row), file=sys.stderr)
            yield row


def vertices_of(size: str) -> int:
    """Number of vertices that "10k" or "2300" means. Raises BadInput."""
    try:
        return round(1000 * float(size[:-1])) if size.endswith("k") else int(size)
    except ValueError as e:
        raise BadInput(f"{size!r} is not a number of vertices, like 10k") from e


def plays_of(acts: list[str], size: int, quick: bool) -> list[Play]:
    """The rows of a size: one for each act, or with `quick` one for all acts of one body."""
    single = tuple(a for a in acts if a != "stack")
    plays = [Play(single, 1)] if quick and single else [Play((a,), 1) for a in single]
    return plays + ([Play(("stack",), MANY if size >= MANY_FROM else PILED)] if "stack" in acts else [])


def body_shape(name: str, vertices: int) -> RestShape:
    """An asset's or a splat's cage of about this many vertices, prepared once and kept in the cache. Raises BadInput.

    Taichi must be running.
    """
    source = find_asset(name)
    kept = cached_asset(source, {"bench": VERSION, "vertices": vertices})
    if not kept.is_file():
        gaussians = Asset.load(source).gaussians if is_asset(name) else read_gaussians(source)
        prepare(gaussians, Options(vertices)).save(kept)
    body = Asset.load(kept)
    return RestShape(body.cage.vertices, body.cage.tets, body.cage.surface, body.sdf)


def measure_size(
    assets, size: int, plays: list[Play], materials: list[str], frames: int, seconds: float
) -> Iterator[dict]:
    """All rows of a size, by one solver for all assets and materials, so that kernels compile once."""
    shapes = {(a, play.count): body_shape(a, size // play.count) for a in assets for play in plays}
    casts = [Cast(Path(a).stem, shape, Material.named(materials[0]), count) for (a, count), shape in shapes.items()]
    solver = solver_for(casts)
    solver.reset(casts[0].models)
    solver.warm_up()
    for asset in assets:
        for play in plays:
            for name in materials:
                cast = Cast(Path(asset).stem, shapes[asset, play.count], Material.named(name), play.count)
                row = measure(solver, cast, play, frames, seconds)
                yield {"asset": Path(asset).stem, "size": size, "material": name, **row}
    solver.destroy()


def solver_for(casts: list[Cast]) -> Solver:
    """An empty solver in the room, with room for each of the casts."""
    sizes = [Model(c.models).sizes for c in casts]
    most = {name: max(getattr(s, name) for s in sizes) for name in ("vertices", "tets", "triangles", "bodies")}
    nodes = max(c.shape.sdf.values.size for c in casts)
    capacity = Capacity(**most, samples=max(c.samples for c in casts), nodes=nodes)
    return Solver([], room(), frame_dt=FRAME, capacity=capacity, hands=2, sleep=False)


def measure(solver: Solver, cast: Cast, play: Play, frames: int, seconds: float) -> dict:
    """One row: times [ms] of frames, acts played in turn from their beginnings."""
    solver.reset(cast.models)
    for act in play.acts:
        list(played(solver, cast, act, WARM_FRAMES))
    times, rows, recovered, begin = [], [], solver.stats["recovered"], perf_counter()
    length = sum(ACTS[act].frames for act in play.acts)
    while len(times) < frames and perf_counter() - begin < seconds:
        for act in play.acts:
            share, act_begin = seconds * ACTS[act].frames / length, perf_counter()
            for took, contacts in played(solver, cast, act, min(ACTS[act].frames, frames - len(times))):
                times.append(1e3 * took)
                rows.append(contacts)
                if perf_counter() - act_begin > share:  # so that a slow device comes to the next act
                    break
    stats = solver.stats
    return {
        "bench": "scene",
        "acts": "+".join(play.acts),
        "bodies": play.count,
        **{name: stats[name] for name in ("vertices", "tets", "integrator", "iterations", "substeps")},
        "rows": int(np.median(rows)),
        "most_rows": max(rows),
        "frames": len(times),
        "median_ms": float(np.median(times)),
        "p99_ms": float(np.percentile(times, 99)),
        "worst_ms": max(times),
        "sound": stats["finite"] and stats["recovered"] == recovered,
        "arch": str(ti.cfg.arch).removeprefix("Arch."),
    }


def played(solver: Solver, cast: Cast, act: str, frames: int) -> Iterator[tuple[float, int]]:
    """Play an act from its beginning; yields the time of each frame [s] and the number of contact rows."""
    ends = cast.ends(ACTS[act])
    solver.restore(cast.start(ACTS[act]))
    ti.sync()
    for k in range(frames):
        hands = ACTS[act].hands(k, ends)
        begin = perf_counter()
        solver.step(FRAME, hands)
        solver.observe()
        ti.sync()
        yield perf_counter() - begin, int(solver.contacts.constraints.candidate_count[None])


# what happens to the bodies


def room() -> list[Shape]:
    """Floor with a step, and a wall, as a distance grid; the floor goes on beyond it, as in a scanned room."""
    low, high = np.array(ROOM)
    nodes = np.round((high - low) / SPACING).astype(int) + 1
    p = low + SPACING * np.moveaxis(np.indices(nodes), 0, -1)
    across, above = p[..., 0], p[..., 1] - STEP_HEIGHT  # from the edge of the step
    step = np.where((across > 0) & (above > 0), np.hypot(across, above), np.maximum(across, above))
    values = np.minimum(np.minimum(p[..., 1], WALL - across), step)
    grid = DistanceGrid(values.astype(np.float32), low, SPACING)
    return [StaticGrid(grid), Plane((0.0, 0.0, 0.0), (0.0, 1.0, 0.0))]


@dataclass(frozen=True)
class Act:
    """Placement of bodies that are `extent` (3,) [m] large, centred above the origin, lowest point at y = 0.

    frames    after which it begins anew
    positions (B, 3) of the bodies [m], given their extent and number
    velocity  [m/s] of all of them
    hands     of a frame, given the ends of the (one) body along x at the beginning, (2, 3) [m]
    """

    frames: int
    positions: Callable[[np.ndarray, int], np.ndarray]
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    hands: Callable[[int, np.ndarray], list[Hand]] = lambda frame, ends: []


def piled(extent: np.ndarray, count: int) -> np.ndarray:
    """Two on one another, or more of them in layers; all a little askew, so that they do not balance."""
    nx, nz = LAYER if count > 2 else (1, 1)
    k = np.arange(count)
    cell = np.stack([k % nx - (nx - 1) / 2, k // (nx * nz), k // nx % nz - (nz - 1) / 2], 1)
    layer = cell[:, 1:2]
    askew = 0.15 * extent * np.concatenate([np.sin(2.4 * layer), 0 * layer, np.cos(2.4 * layer)], 1)
    return cell * (extent + CLEARANCE) + askew + [0.0, STEP_HEIGHT + CLEARANCE, 0.0]


def squeezing(frame: int, ends: np.ndarray) -> list[Hand]:
    """Two hands that grip the ends, lift and press, pull apart, press again, and let go."""
    times, lengths = (5, 40, 75, 100), (1.0, PRESS, STRETCH, PRESS)
    length, up = np.interp(frame, times, lengths), np.interp(frame, times[:2], (0.0, LIFT))
    middle = ends.mean(0)
    places = middle + length * (ends - middle) + [0.0, up, 0.0]
    return [Hand(tuple(p.tolist()), grip=1 <= frame < times[-1], reach=REACH) for p in places]


ACTS = {  # above the edge of the step; close to the wall, above the floor; on the step; a pile
    "drop": Act(75, lambda extent, count: np.array([[0.0, STEP_HEIGHT + DROP_HEIGHT, 0.0]])),
    "throw": Act(
        45,
        lambda extent, count: np.array([[WALL - extent[0] / 2 - 10 * CLEARANCE, 0.3, 0.0]]),
        velocity=(THROW_SPEED, 0.0, 0.0),
    ),
    "squeeze": Act(120, lambda extent, count: np.array([[-0.6, STEP_HEIGHT + CLEARANCE, 0.0]]), hands=squeezing),
    "stack": Act(90, piled),
}


class Cast:
    """Bodies of one shape and material, and their motions at the beginning of each act.

    models  of `count` bodies for a solver
    """

    def __init__(self, name: str, shape: RestShape, material: Material, count: int):
        self.shape, self.count = shape, count
        body = SoftBody(name, shape.vertices, shape.solid, shape.surface, material, sdf=shape.sdf)
        body.check()
        self.models = [BodyModel(replace(body, name=f"{name} {k}"), shape) for k in range(count)]

    def start(self, act: Act) -> dict[str, np.ndarray]:
        """Motion at the beginning of an act, for `Solver.restore`."""
        x = self.shape.vertices
        low, high = x.min(0), x.max(0)
        x = x - [(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2]
        positions = np.concatenate([x + p for p in act.positions(high - low, self.count)])
        return {"x": positions, "v": np.tile(np.array(act.velocity), (len(positions), 1))}

    def ends(self, act: Act) -> np.ndarray:
        """The surface's ends along x at the beginning of an act, (2, 3) [m]."""
        x = self.start(act)["x"][np.unique(self.shape.surface)]
        return x[[np.argmin(x[:, 0]), np.argmax(x[:, 0])]]

    @property
    def samples(self) -> int:
        """Number of contact samples of all bodies in the room."""
        return self.count * len(self.shape.once(points_of, spacing_for(room())).ids)
