"""What must hold throughout a soak: finite, above the floor, within the walls, no energy from nowhere."""

from __future__ import annotations

import numpy as np

from bench.soak_acts import ARENA

FRAME = 1 / 60  # [s] between two calls of `stepped`
DEEPEST = 0.03  # [m] that a vertex may be behind floor or wall: a hand presses it there
INSIDE = 0.1  # [m] that what is inside a body may be further there: where it strikes, it can be as coarse as one vertex
GAIN = 0.02  # of the energy of motion and deformation, by rounding and by contacts, between two looks
LIFT = 0.01  # [m] of all weight: what contacts that began a little deep may raise it
OUT = 0.5  # [m/s] at least with which what an edit put behind floor or wall comes back: half of RECOVERY_SPEED
PUSH = 1.0  # [m/s] with which bodies that an edit put into each other, or into the floor, may part


class Failure(AssertionError):
    """What did not hold."""


class Watch:
    """Looks at a solver now and then. `hands` says what hands may have done [J], `changed` that a body was edited.

    What hands did and the bodies do not have yet is in the springs that hold them; it is gone with the last grip.
    """

    def __init__(self, solver):
        self.solver, self.budget, self.edited = solver, 0.0, []
        self.led: set[int] = set()
        self.put, self.frames = 0.0, 0  # [m] behind floor or wall by the last edit; frames since
        self.recovered = solver.stats["recovered"]
        self.moving, self.potential, self.weight = energies(solver)

    def hands(self, joules: float) -> None:
        self.budget += joules

    def stepped(self) -> None:
        """A frame has passed: what is led to its shape, lying, may be lifted by its own height (sim/elastic/untangling.py)."""
        self.frames += 1
        limp = self.solver.untangling.active
        self.led |= {k for k, soft in enumerate(limp) if soft}

    def hands_off(self) -> None:
        self.budget = 0.0

    def changed(self, what: str) -> None:
        """An edit was just made, after a look: energy is counted anew, and what overlaps now may part."""
        self.moving, self.potential, self.weight = energies(self.solver)
        self.budget += self.weight / 9.81 * PUSH**2 / 2
        self.led.clear()
        self.put, self.frames = max(behind(self.solver, self.solver.snapshot()), 0.0), 0
        self.edited.append(what)

    def look(self, time: float) -> None:
        """Raises Failure."""
        q = self.solver.snapshot()
        if not (np.isfinite(q["x"]).all() and np.isfinite(q["v"]).all()):
            raise Failure(f"not finite; edits so far: {', '.join(self.edited) or 'none'}")
        if recovered := self.solver.stats["recovered"] - self.recovered:
            self.recovered += recovered
            raise Failure(f"{recovered} bodies were not finite; edits so far: {', '.join(self.edited) or 'none'}")
        out = behind(self.solver, q)
        if out > DEEPEST + max(self.put - OUT * self.frames * FRAME, 0.0):
            raise Failure(f"{1000 * out:.0f} mm behind floor or wall; edits so far: {', '.join(self.edited) or 'none'}")
        for part in (q["bodies"][k] for k in self.led):
            height = np.ptp(part.shape.vertices, axis=0).max()
            self.budget += part.mass.sum() * -self.solver.gravity[1] * height
        self.led.clear()
        moving, potential, weight = energies(self.solver)
        gained = moving + potential - self.moving - self.potential
        allowed = self.budget + GAIN * max(self.moving, moving) + LIFT * weight
        if gained > allowed:
            raise Failure(f"gained {gained:.3g} J of {moving:.3g} J, {allowed:.3g} J explained; edits: {self.edited}")
        self.moving, self.potential, self.weight = moving, potential, weight
        self.budget = max(self.budget - gained, 0.0)


def behind(solver, snapshot: dict) -> float:
    """How far any surface is behind floor or wall [m], and what is inside, less INSIDE."""
    x, skin = snapshot["x"][: solver.vertex_offset[len(snapshot["bodies"])]], surface(solver, snapshot)
    beyond = np.maximum(-x[:, 1], np.abs(x[:, [0, 2]]).max(1) - ARENA)
    return float(max(beyond[skin].max(), beyond.max() - INSIDE))


def surface(solver, snapshot: dict) -> np.ndarray:
    """Indices of all vertices on bodies' surfaces."""
    return np.concatenate(
        [np.unique(p.shape.surface) + o for p, o in zip(snapshot["bodies"], solver.vertex_offset, strict=False)]
    )


def energies(solver) -> tuple[float, float, float]:
    """Kinetic and elastic energy [J], energy of position [J], weight [N] of all bodies."""
    q, offset = solver.snapshot(), solver.vertex_offset
    x, v = q["x"].astype(np.float64) + q["x_lo"], q["v"].astype(np.float64)
    moving = potential = weight = 0.0
    g = -solver.gravity[1]
    for k, part in enumerate(q["bodies"]):
        rows = slice(offset[k], offset[k + 1])
        moving += 0.5 * part.mass @ (v[rows] ** 2).sum(1) + elastic(part, x[rows])
        potential += g * (part.mass @ x[rows, 1])
        weight += g * part.mass.sum()
    return moving, potential, weight


def elastic(part, x: np.ndarray) -> float:
    """Strain energy [J] of a body: V (mu/2 (tr F^T F - 3) - mu (J - 1) + lam/2 (J - 1)^2), summed over its tets."""
    m = part.material
    mu = m.young / (2 * (1 + m.poisson))
    lam = m.young * m.poisson / ((1 + m.poisson) * (1 - 2 * m.poisson)) + mu
    corners = x[part.shape.tets]
    F = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2) @ part.shape.inverse
    J = np.linalg.det(F)
    density = mu / 2 * ((F**2).sum((1, 2)) - 3) - mu * (J - 1) + lam / 2 * (J - 1) ** 2
    return float(part.shape.volumes @ density)


def inverted(snapshot: dict) -> list[int]:
    """Bodies that have a tet turned inside out."""
    x, at, found = snapshot["x"].astype(np.float64), 0, []
    for k, part in enumerate(snapshot["bodies"]):
        corners = x[at : at + len(part.shape.vertices)][part.shape.tets]
        if (np.linalg.det(corners[:, 1:] - corners[:, :1]) <= 0).any():
            found.append(k)
        at += len(part.shape.vertices)
    return found
