"""Soak test: minutes of random handling over the whole range of the interface, checked once a simulated second.

    python -m bench.soak --minutes 30 --seed 1
    python -m bench.soak --seed 1 --episode 7     repeats one episode

An episode: bodies fall; two hands grab, throw, squeeze and twist them, and some are rescaled, copied, removed or given
another material; the hands let go and everything comes to rest; then the bodies float apart without gravity until they
have recovered their shape. `Watch` checks the invariants.
"""

from __future__ import annotations

import argparse
import sys
from datetime import date
from itertools import pairwise
from time import perf_counter

import numpy as np

from bench.soak_acts import ARENA, MOST_BODIES, NODES, SIZES, Hands, Ranges, body, edit, generator, population
from bench.soak_watch import FRAME, Failure, Watch, inverted
from scenes.scene import Hand, Plane
from sim.hands.grasp import FORCE
from sim.model import Capacity
from sim.solver import Solver

HANDLING, SETTLING = 6.0, 3.0  # [s]
EDITS_PER_SECOND = 0.7
RECOVERY_SECONDS = (2.0, 12.0)  # bounds of the time to recover
RECOVERY_CROSSINGS = 12.0  # of a wave through a body, within which it recovers
GRAVITY = (0.0, -9.81, 0.0)
CAPACITY = Capacity(
    vertices=3000, tets=7000, triangles=6000, samples=12000, nodes=2 * MOST_BODIES * NODES**3, bodies=MOST_BODIES
)


def arena() -> list[Plane]:
    """A floor and four walls."""
    walls = [((s * ARENA * a, 0.0, s * ARENA * b), (-s * a, 0.0, -s * b)) for s in (1, -1) for a, b in ((1, 0), (0, 1))]
    return [Plane((0, 0, 0), (0, 1, 0)), *(Plane(point, normal) for point, normal in walls)]


class Soak:
    """Episodes in one solver, which is edited but never rebuilt."""

    def __init__(self, seed: int, ranges: Ranges = Ranges()):
        self.seed, self.ranges = seed, ranges
        first = body(generator(seed, 0), ranges, np.array([0.0, 0.5, 0.0]))
        self.solver = Solver([first], arena(), gravity=GRAVITY, capacity=CAPACITY)

    def episode(self, number: int) -> tuple[float, str]:
        """Play an episode; returns the simulated seconds and a summary line. Raises Failure."""
        rng = generator(self.seed, number)
        self._populate(population(rng, self.ranges))
        self.watch, self.time, begin = Watch(self.solver), 0.0, len(self.solver.bodies())
        try:
            self._handle(rng)
            self._settle()
            away = self._recover()
        except Failure as failure:
            raise Failure(f"seed {self.seed}, episode {number}, at {self.time:.2f} s: {failure}") from None
        stats = self.solver.stats
        line = f"{begin} to {len(self.solver.bodies())} bodies, {stats['integrator']}, dt {stats['dt']:.2g} s"
        return self.time, f"{line}; recovered after {away:.1f} s"

    def _populate(self, bodies) -> None:
        while len(self.solver.bodies()) > 1:
            self.solver.remove(1)
        for b in bodies:
            self.solver.add(b)
        self.solver.remove(0)
        self.solver.gravity = GRAVITY

    def _step(self, hands: list[Hand]) -> None:
        self.solver.step(FRAME, hands)
        self.time += FRAME
        self.watch.stepped()

    def _handle(self, rng: np.random.Generator) -> None:
        hands, before = Hands(rng), [Hand(), Hand()]
        frames = round(HANDLING / FRAME)
        for frame in range(frames):
            if rng.random() < EDITS_PER_SECOND * FRAME:
                self.watch.look(self.time)
                self.watch.changed(edit(rng, self.ranges, self.solver))
            given = hands.at(self.time, self._positions() if None in hands.acts else [])
            self.watch.hands(sum(work(a, b) for a, b in zip(before, given, strict=True)))
            self._step(given)
            before = given
            if frame % 60 == 59:
                self.watch.look(self.time)

    def _settle(self) -> None:
        """Let everything come to rest without hands."""
        self._step([])
        self.watch.look(self.time)
        self.watch.hands_off()
        for _ in range(round(SETTLING)):
            for _ in range(60):
                self._step([])
            self.watch.look(self.time)

    def _recover(self) -> float:
        """Let bodies recover their shape, apart and without gravity; returns the seconds of the slowest."""
        solver, snapshot = self.solver, self.solver.snapshot()
        x, spread = snapshot["x"].astype(np.float64), 0.0
        for part, rows in zip(snapshot["bodies"], self._rows(), strict=True):
            x[rows, 1] += spread + 2.0 - x[rows, 1].min()
            spread += 1.5 * np.ptp(x[rows, 1]) + 2 * np.ptp(part.shape.vertices, axis=0).max()
        solver.gravity = (0.0, 0.0, 0.0)
        solver.restore({"x": x, "v": np.zeros_like(x)})
        slowest = max(crossing(p) for p in snapshot["bodies"])
        longest = float(np.clip(RECOVERY_CROSSINGS * slowest, *RECOVERY_SECONDS))
        taken = 0.0
        while left := inverted(solver.snapshot()):
            if taken >= longest:
                raise Failure(f"inverted tets in bodies {left} after {taken:.1f} s without load")
            for _ in range(30):
                self._step([])
            taken += 0.5
        return taken

    def _rows(self) -> list[slice]:
        o = self.solver.vertex_offset
        return [slice(a, b) for a, b in pairwise(o)]

    def _positions(self) -> list[np.ndarray]:
        x = self.solver.snapshot()["x"].astype(np.float64)
        return [x[rows] for rows in self._rows()]


def crossing(part) -> float:
    """Time [s] that an elastic wave takes through a body."""
    m = part.body.material
    return np.ptp(part.shape.vertices, axis=0).max() / np.sqrt(m.young / m.density)


def work(before: Hand, now: Hand) -> float:
    """Upper bound of a hand's work in a frame [J]: its force times the displacement of the outermost point it holds."""
    if not now.grip:
        return 0.0
    cosine = abs(float(np.dot(before.rotation, now.rotation)))
    angle = 2 * np.arccos(min(cosine, 1.0)) if before.grip else 0.0
    displacement = np.linalg.norm(np.subtract(now.position, before.position)) if before.grip else 0.0
    return FORCE * (displacement + SIZES[1] * angle)


def soak(seed: int, minutes: float, ranges: Ranges = Ranges(), *, first: int = 0) -> list[str]:
    """Play episodes from `first` on for `minutes` simulated minutes, printing a line each; returns the failures."""
    soak, begin, simulated, failures, number = Soak(seed, ranges), perf_counter(), 0.0, [], first
    while simulated < 60 * minutes:
        try:
            seconds, line = soak.episode(number)
        except Failure as failure:
            seconds, line = soak.time, f"FAILED: {failure}"
            failures.append(str(failure))
        simulated += seconds
        print(f"episode {number}, {simulated / 60:.1f} min in {perf_counter() - begin:.0f} s: {line}", flush=True)
        number += 1
    print(f"seed {seed}: {len(failures)} failures in {simulated / 60:.1f} simulated minutes")
    return failures


def main() -> int:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--minutes", type=float, default=2.0, help="simulated (default 2)")
    p.add_argument("--seed", type=int, help="(default: another one each day)")
    p.add_argument("--episode", type=int, help="play this one only")
    p.add_argument("--stiffest", type=float, default=Ranges.young[1], metavar="E", help="[Pa] (default 1e8)")
    p.add_argument("--arch", choices=("cuda", "cpu"))
    args = p.parse_args()
    if args.seed is None:
        args.seed = date.today().toordinal()
    from core.runtime import start_taichi

    start_taichi(args.arch)
    ranges = Ranges(young=(Ranges.young[0], args.stiffest))
    minutes = args.minutes if args.episode is None else 1e-9  # one episode at least
    return 1 if soak(args.seed, minutes, ranges, first=args.episode or 0) else 0


if __name__ == "__main__":
    sys.exit(main())
