"""Soak test: minutes of random handling over the whole range of the interface, checked once a simulated second.

    python -m tests.soak.soak --minutes 30 --seed 1
    python -m tests.soak.soak --seed 1 --episode 7     repeats one episode of it

An episode: bodies fall; two hands grab, throw, squeeze and twist them, while some are rescaled, copied, removed or
given another material; then all is released and comes to rest; last, the bodies are separated without gravity until
no tetrahedron is inverted. `EnergyAudit` checks what must hold throughout.
"""

import argparse
import math
import sys
from collections import deque
from datetime import date
from itertools import pairwise
from time import perf_counter

import numpy as np

from bench.physics_contact import FRAME, G, energies
from core.vocabulary import Hand, Plane
from sim.hands.grasp import MAX_HAND_FORCE, THROW_WINDOW
from sim.model import Capacity
from sim.solver import Solver
from tests.soak.soak_acts import (
    ARENA,
    BODY_SIZES,
    GRID_NODES,
    MAX_BODIES,
    Hands,
    Ranges,
    body,
    edit,
    generator,
    population,
)

HANDLING, RESTING = 6.0, 3.0  # [s]
EDITS_PER_SECOND = 0.7
RECOVERY = (2.0, 12.0)  # [s] at least, at most
RECOVERY_CROSSINGS = 12.0  # time to recover, in crossings of an elastic wave through the body
CAPACITY = Capacity(
    vertices=3000, tets=7000, triangles=6000, samples=12000, nodes=2 * MAX_BODIES * GRID_NODES**3, bodies=MAX_BODIES
)
# Requirements
MAX_DEPTH = 0.03  # [m] of a surface vertex behind floor or wall: a hand presses it there
INNER_DEPTH = 0.1  # [m] by which inner vertices may be deeper: the surface can be as coarse as one vertex
GAIN = 0.02  # of kinetic and elastic energy, by rounding and by contacts, between two checks
LIFT = 0.01  # [m] by which contacts that began a little deep may raise all weight
EXIT_SPEED = 0.5  # [m/s] at least, of bodies that an edit put behind floor or wall: half of RECOVERY_SPEED
SEPARATION_SPEED = 1.0  # [m/s] with which bodies may part that an edit put into each other or into the floor


class Failure(AssertionError):
    """A condition that did not hold."""


class EnergyAudit:
    """Checks a solver now and then: finite, within floor and walls, no energy of unknown origin.

    known [J]: the energy that the bodies have from known origins. It falls when they lose some: what they have lost
    they must not gain again. budget [J]: what hands and edits may have added and the bodies do not have yet.

    Kinetic and potential energy, and elastic energy but for that of tets far from rest, must not exceed their sum.
    What is stored in tets far from rest counts only once it comes back as motion, see `energies`.
    """

    def __init__(self, solver: Solver):
        self.solver, self.budget, self.edits = solver, 0.0, []
        self.untangled: set[int] = set()  # bodies led back to their shape since the last check
        self.edit_depth, self.frames = 0.0, 0  # [m] behind floor or wall after the last edit; frames since
        self.recovered = solver.stats["recovered"]
        self.energy = energies(solver)
        self.known = total(self.energy)

    def add_work(self, joules: float) -> None:
        """Account for work of the hands."""
        self.budget += joules

    def release(self) -> None:
        """Account for released hands: the energy of the springs that held the bodies is gone."""
        self.budget = 0.0

    def stepped(self) -> None:
        """Account for a frame; a body led to its shape may be lifted by its own height (sim/recovery.py)."""
        self.frames += 1
        self.untangled |= set(np.flatnonzero(self.solver.untangling.active).tolist())

    def edited(self, what: str) -> None:
        """Account for an edit, made after a check: energy is counted anew, and overlapping bodies may part."""
        self.energy = energies(self.solver)
        self.known = total(self.energy)
        self.budget += self.energy["weight"] / G * SEPARATION_SPEED**2 / 2
        self.untangled.clear()
        self.edit_depth, self.frames = max(depth_behind(self.solver, self.solver.snapshot()), 0.0), 0
        self.edits.append(what)

    def check(self) -> None:
        """Raise Failure if a condition does not hold."""
        q, edits = self.solver.snapshot(), f"edits so far: {', '.join(self.edits) or 'none'}"
        if not (np.isfinite(q["x"]).all() and np.isfinite(q["v"]).all()):
            raise Failure(f"not finite; {edits}")
        if recovered := self.solver.stats["recovered"] - self.recovered:
            self.recovered += recovered
            raise Failure(f"{recovered} bodies were not finite; {edits}")
        depth = depth_behind(self.solver, q)
        if depth > MAX_DEPTH + max(self.edit_depth - EXIT_SPEED * self.frames * FRAME, 0.0):
            raise Failure(f"{1000 * depth:.0f} mm behind floor or wall; {edits}")
        for k in self.untangled:
            height = np.ptp(q["bodies"][k].shape.vertices, axis=0).max()
            self.budget += q["bodies"][k].mass.sum() * -self.solver.gravity[1] * height
        self.untangled.clear()
        before, now = self.energy, energies(self.solver)
        known, having = self.known, total(now)
        tolerance = GAIN * max(motion(before), motion(now)) + LIFT * now["weight"]
        unexplained = having - now["far"] - known - self.budget
        if unexplained > tolerance:
            raise Failure(
                f"gained {unexplained:.3g} J of unknown origin, {tolerance:.3g} J tolerated, of {motion(now):.3g} J;"
                f" {self.budget:.3g} J came from hands and edits; {edits}"
            )
        self.energy, self.known = now, min(having, known + self.budget)
        self.budget -= max(self.known - known, 0.0)


def motion(energy: dict[str, float]) -> float:
    """Kinetic and elastic energy [J] but for that of tets far from rest."""
    return energy["kinetic"] + energy["elastic"] - energy["far"]


def total(energy: dict[str, float]) -> float:
    """Kinetic, elastic and potential energy [J]."""
    return energy["kinetic"] + energy["elastic"] + energy["potential"]


def depth_behind(solver: Solver, snapshot: dict) -> float:
    """Largest depth of a surface vertex behind floor or wall [m], or of an inner one less INNER_DEPTH."""
    x = snapshot["x"][: solver.vertex_offset[len(snapshot["bodies"])]]
    bodies = zip(snapshot["bodies"], solver.vertex_offset, strict=False)
    surface = np.concatenate([np.unique(b.shape.surface) + first for b, first in bodies])
    beyond = np.maximum(-x[:, 1], np.abs(x[:, [0, 2]]).max(1) - ARENA)
    return float(max(beyond[surface].max(), beyond.max() - INNER_DEPTH))


def inverted(snapshot: dict) -> list[int]:
    """Bodies that have an inverted tet."""
    x, first, found = snapshot["x"].astype(np.float64), 0, []
    for k, b in enumerate(snapshot["bodies"]):
        corners = x[first : first + len(b.shape.vertices)][b.shape.tets]
        if (np.linalg.det(corners[:, 1:] - corners[:, :1]) <= 0).any():
            found.append(k)
        first += len(b.shape.vertices)
    return found


class Soak:
    """Episodes in one solver, which is edited but never rebuilt."""

    def __init__(self, seed: int, ranges: Ranges = Ranges()):
        self.seed, self.ranges, self.time = seed, ranges, 0.0
        walls = [((s * ARENA * a, 0, s * ARENA * b), (-s * a, 0, -s * b)) for s in (1, -1) for a, b in ((1, 0), (0, 1))]
        arena = [Plane((0, 0, 0), (0, 1, 0)), *(Plane(point, normal) for point, normal in walls)]
        first = body(generator(seed, 0), ranges, np.array([0.0, 0.5, 0.0]))
        self.solver = Solver([first], arena, gravity=(0.0, -G, 0.0), capacity=CAPACITY)
        self.audit = EnergyAudit(self.solver)

    def episode(self, number: int) -> str:
        """Play an episode; returns a line about it. Raises Failure."""
        rng, solver = generator(self.seed, number), self.solver
        self._populate(population(rng, self.ranges))
        self.audit, self.time, begin = EnergyAudit(solver), 0.0, len(solver.bodies())
        try:
            self._handle(rng)
            self._rest()
            recovered = self._recover()
        except Failure as failure:
            raise Failure(f"seed {self.seed}, episode {number}, at {self.time:.2f} s: {failure}") from None
        stats = solver.stats
        counts = f"{begin} to {len(solver.bodies())} bodies, {stats['integrator']}, dt {stats['dt']:.2g} s"
        return f"{counts}; no tet inverted after {recovered:.1f} s"

    def _populate(self, bodies) -> None:
        while len(self.solver.bodies()) > 1:
            self.solver.remove(1)
        for b in bodies:
            self.solver.add(b)
        self.solver.remove(0)
        self.solver.gravity = (0.0, -G, 0.0)

    def _step(self, hands: list[Hand]) -> None:
        self.solver.step(FRAME, hands)
        self.time += FRAME
        self.audit.stepped()

    def _handle(self, rng: np.random.Generator) -> None:
        hands, before, works = Hands(rng), [Hand(), Hand()], [Works(), Works()]
        for frame in range(round(HANDLING / FRAME)):
            if rng.random() < EDITS_PER_SECOND * FRAME:
                self.audit.check()
                self.audit.edited(edit(rng, self.ranges, self.solver))
            now = hands.at(self.time, self._positions() if None in hands.acts else [])
            self.audit.add_work(sum(w.of(a, b) for w, a, b in zip(works, before, now, strict=True)))
            self._step(now)
            before = now
            if frame % 60 == 59:
                self.audit.check()

    def _rest(self) -> None:
        """Simulate without hands."""
        self._step([])
        self.audit.check()
        self.audit.release()
        for _ in range(round(RESTING)):
            for _ in range(60):
                self._step([])
            self.audit.check()

    def _recover(self) -> float:
        """Separate the bodies without gravity; returns the seconds until no tet is inverted. Raises Failure."""
        solver, snapshot = self.solver, self.solver.snapshot()
        x, height = snapshot["x"].astype(np.float64), 0.0
        for b, rows in zip(snapshot["bodies"], self._rows(), strict=True):
            x[rows, 1] += height + 2.0 - x[rows, 1].min()
            height += 1.5 * np.ptp(x[rows, 1]) + 2 * np.ptp(b.shape.vertices, axis=0).max()
        solver.gravity = (0.0, 0.0, 0.0)
        solver.restore({"x": x, "v": np.zeros_like(x)})
        slowest = max(crossing_time(b) for b in snapshot["bodies"])
        longest, taken = float(np.clip(RECOVERY_CROSSINGS * slowest, *RECOVERY)), 0.0
        while left := inverted(solver.snapshot()):
            if taken >= longest:
                raise Failure(f"inverted tets in bodies {left} after {taken:.1f} s without load")
            for _ in range(30):
                self._step([])
            taken += 0.5
        return taken

    def _rows(self) -> list[slice]:
        return [slice(a, b) for a, b in pairwise(self.solver.vertex_offset)]

    def _positions(self) -> list[np.ndarray]:
        x = self.solver.snapshot()["x"].astype(np.float64)
        return [x[rows] for rows in self._rows()]


def crossing_time(model) -> float:
    """Time [s] that an elastic wave takes through a body."""
    m = model.body.material
    return np.ptp(model.shape.vertices, axis=0).max() / np.sqrt(m.young / m.density)


def work(before: Hand, now: Hand) -> float:
    """Upper bound [J] of a hand's work in a frame: its force times the path of the farthest vertex that it can hold."""
    if not (now.grip and before.grip):
        return 0.0
    angle = 2 * np.arccos(min(abs(float(np.dot(before.rotation, now.rotation))), 1.0))
    return MAX_HAND_FORCE * (np.linalg.norm(np.subtract(now.position, before.position)) + BODY_SIZES[1] * angle)


class Works:
    """Upper bounds of the work of one hand, frame by frame: of its springs, and of its throw when it lets go.

    A throw changes the momentum by MAX_HAND_FORCE * THROW_WINDOW at most, towards the motion that the hand had then.
    """

    def __init__(self):
        self.last: deque[float] = deque(maxlen=math.ceil(THROW_WINDOW / FRAME))

    def of(self, before: Hand, now: Hand) -> float:
        """The work [J] of the next frame."""
        if before.grip and not now.grip:
            thrown = max(self.last, default=0.0) * self.last.maxlen
            self.last.clear()
            return thrown
        self.last.append(work(before, now))
        return self.last[-1]


def soak(seed: int, minutes: float, ranges: Ranges = Ranges(), *, first: int = 0) -> list[str]:
    """Play episodes from `first` on for some simulated minutes, one at least, printing a line each; the failures."""
    runner, begin, simulated, failures, number = Soak(seed, ranges), perf_counter(), 0.0, [], first
    while number == first or simulated < 60 * minutes:
        try:
            line = runner.episode(number)
        except Failure as failure:
            line = f"FAILED: {failure}"
            failures.append(str(failure))
        simulated += runner.time
        print(f"episode {number}, {simulated / 60:.1f} min in {perf_counter() - begin:.0f} s: {line}", flush=True)
        number += 1
    print(f"seed {seed}: {len(failures)} failures in {simulated / 60:.1f} simulated minutes")
    return failures


def main() -> int:
    """Run the soak of the command line; exit status 1 if a condition did not hold."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--minutes", type=float, default=2.0, help="simulated (default 2)")
    p.add_argument("--seed", type=int, default=date.today().toordinal(), help="(default: another one each day)")
    p.add_argument("--episode", type=int, help="play this one only")
    p.add_argument("--stiffest", type=float, default=Ranges.young[1], metavar="E", help="[Pa] (default 1e8)")
    p.add_argument("--arch", choices=("cuda", "cpu"))
    args = p.parse_args()
    from core.runtime import start_taichi

    start_taichi(args.arch)
    ranges = Ranges(young=(Ranges.young[0], args.stiffest))
    minutes = args.minutes if args.episode is None else 0.0
    return 1 if soak(args.seed, minutes, ranges, first=args.episode or 0) else 0


if __name__ == "__main__":
    sys.exit(main())
