"""`vrgs.py bench sim`: time of the paper's frame of 400 substeps, without and with contact.

Frames of 40 ms at a forced substep of 1e-4 s and one sweep, and frames of a 90 Hz headset. Medians of synchronous calls
of `Solver.step`; `simulated_per_second` is simulated time over wall time.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from statistics import median
from time import perf_counter

import numpy as np
import taichi as ti

from bench.physics import box
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.material import Material
from sim.bodies import SoftBody
from sim.contact.static_shapes import StaticGrid
from sim.solver import Solver

SUBSTEP, SUBSTEPS, HEADSET_FRAME = 1e-4, 400, 1 / 90
PASSES = 4  # contact searches in a frame of 400 substeps: about as often per second as in a headset
MAX_STIFFNESS = 1.0e6  # [1/s^2] young / (density edge^2) that the stability rule allows at this substep
CELL_SIZE = 0.01  # [m] of a cell
# grid points along each axis of the only body; of each of two; of each of many
SINGLE_POINTS = {"1.7k": (12, 12, 12), "9.3k": (21, 21, 21), "24k": (29, 29, 29), "46k": (36, 36, 36)}
PAIR_POINTS = {"1.7k": (9, 9, 11), "9.3k": (16, 17, 17), "24k": (23, 23, 23), "46k": (28, 29, 29)}
SMALL_POINTS, SMALL_COUNT = (6, 6, 6), 43
TITLES = ("vertices", "tets", "ms / 400", "us / substep", "ms / 90 Hz", "times real")


def run(*, sizes: list[str] | None, rounds: int) -> Iterator[dict]:
    """Measure every scene; prints and yields its row. Raises BadInput."""
    if unknown := [s for s in sizes or () if s not in SINGLE_POINTS]:
        raise BadInput(f"bench sim: no size {unknown[0]}; known: {' '.join(SINGLE_POINTS)}")
    print(f"{'scene':28}" + "".join(f" {title:>12}" for title in TITLES), flush=True)
    for name, bodies, ground, contacts in scenes(sizes or list(SINGLE_POINTS)):
        row = measure(name, bodies, ground, contacts, frames=rounds)
        figures = (row[k] for k in ("median_ms", "us_per_substep", "headset_ms", "simulated_per_second"))
        print(f"{name:28} {row['vertices']:12} {row['tets']:12}" + "".join(f" {f:12.2f}" for f in figures), flush=True)
        if not row["finite"]:
            print(f"vrgs: bench sim: not finite: {name}", file=sys.stderr)
        yield row


def scenes(sizes: list[str]) -> Iterator[tuple[str, list[SoftBody], list, bool]]:
    """Name, bodies, static shapes and whether contact is simulated, from the smallest to the largest."""
    for size in sizes:
        yield f"{size}, no contact", [block("block", SINGLE_POINTS[size])], [], False
    yield (
        f"{SMALL_COUNT} bodies, no contact",
        [block(f"{k}", SMALL_POINTS, at=(0.1 * k, 0, 0)) for k in range(SMALL_COUNT)],
        [],
        False,
    )
    for size in sizes:
        lower = block("lower", PAIR_POINTS[size], velocity=(1.0, 0.0, 0.0))
        height = float(np.max(lower.vertices[:, 1]))
        upper = block("upper", PAIR_POINTS[size], at=(0.0, height, 0.0), velocity=(1.0, 0.0, 0.0))
        yield f"{size}, sliding, two touch", [lower, upper], [ground()], True
    pile = [
        block(f"{k}", SMALL_POINTS, at=(0.06 * (k % 4), 0.06 * (k // 16), 0.06 * (k // 4 % 4)))
        for k in range(SMALL_COUNT)
    ]
    yield f"{SMALL_COUNT} bodies, in a pile", pile, [ground()], True


def block(name: str, points: tuple[int, int, int], *, at=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0)) -> SoftBody:
    """A block of cells of CELL_SIZE, six tets each, about as stiff as the substep allows."""
    cells = np.array(points) - 1
    x, tets, surface = box(cells * CELL_SIZE, cells)
    material = Material(MAX_STIFFNESS * 1000.0 * CELL_SIZE**2, 0.3, 1000.0, friction=0.5, damping=2.0)
    return SoftBody(name, x, tets, surface, material, position=at, velocity=velocity)


def ground() -> StaticGrid:
    """A floor at y = 0 as a signed distance grid, large enough for sliding blocks."""
    spacing, low = 0.02, np.array([-1.0, -0.2, -1.0])
    shape = (150, 25, 120)
    y = low[1] + spacing * np.arange(shape[1])
    values = np.broadcast_to(y[None, :, None], shape).astype(np.float32)
    return StaticGrid(DistanceGrid(np.ascontiguousarray(values), low, spacing), friction=0.02)  # with the blocks: 0.1


def measure(name: str, bodies: list[SoftBody], shapes: list, contacts: bool, *, frames: int) -> dict:
    """One row: medians over frames, after warm-up frames that compile and come to rest."""
    frame = SUBSTEP * SUBSTEPS
    solver = Solver(
        bodies, shapes, substep=SUBSTEP, frame_dt=frame, collision_passes=PASSES, contacts=contacts, sleep=False
    )
    long = times(solver, frame, frames)
    touching = 0 if solver.contacts is None else int(solver.contacts.constraints.active.to_numpy().sum())
    solver.collision_passes = 1
    short = times(solver, HEADSET_FRAME, frames)
    return {
        "bench": "sim",
        "scene": name,
        "bodies": len(bodies),
        "contact_rows": touching,
        "vertices": solver.stats["vertices"],
        "tets": solver.stats["tets"],
        "substeps": SUBSTEPS,
        "finite": solver.stats["finite"],
        "median_ms": 1e3 * median(long),
        "worst_ms": 1e3 * max(long),
        "us_per_substep": 1e6 * median(long) / SUBSTEPS,
        "headset_ms": 1e3 * median(short),
        "simulated_per_second": HEADSET_FRAME / median(short),
        "arch": str(ti.cfg.arch).removeprefix("Arch."),
    }


def times(solver: Solver, dt: float, frames: int) -> list[float]:
    """Wall times [s] of frames of dt, the first three (compiling, first touch) left out."""
    result = []
    for _ in range(frames + 3):
        begin = perf_counter()
        solver.step(dt)
        ti.sync()
        result.append(perf_counter() - begin)
    return result[3:]
