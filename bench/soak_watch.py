"""Invariants of the soak test: finite state, bodies above the floor and within the walls, no spurious energy."""

from __future__ import annotations

import numpy as np

from bench.soak_acts import ARENA

FRAME = 1 / 60  # [s] between two calls of `stepped`
MAX_SURFACE_DEPTH = 0.03  # [m] of a surface vertex behind floor or wall, where a hand may press it
EXTRA_INNER_DEPTH = 0.1  # [m] for inner vertices: where a body strikes, it can be as coarse as one vertex
MAX_GAIN = 0.02  # of kinetic and elastic energy between two checks, by rounding and contacts
MAX_LIFT = 0.01  # [m] by which contacts that began slightly deep may raise all bodies
MIN_RETURN_SPEED = 0.5  # [m/s] of vertices that an edit put behind floor or wall: half the recovery speed
SEPARATION_SPEED = 1.0  # [m/s] of bodies that an edit made overlap each other or the floor


class Failure(AssertionError):
    """A violated invariant."""


class Watch:
    """Periodic checks of a solver.

    `hands` adds the work of hands [J], `changed` records an edit. Work that bodies have not received yet is in the
    springs that hold them, and is lost with the last grip.
    """

    def __init__(self, solver):
        self.solver, self.budget, self.edited = solver, 0.0, []
        self.led: set[int] = set()
        self.put, self.frames = 0.0, 0  # [m] behind floor or wall after the last edit; frames since
        self.recovered = solver.stats["recovered"]
        self.moving, self.potential, self.weight = energies(solver)

    def hands(self, joules: float) -> None:
        self.budget += joules

    def stepped(self) -> None:
        """Record a frame. A body that is untangled (sim/elastic/untangling.py) may be lifted by its own height."""
        self.frames += 1
        limp = self.solver.untangling.active
        self.led |= {k for k, soft in enumerate(limp) if soft}

    def hands_off(self) -> None:
        self.budget = 0.0

    def changed(self, what: str) -> None:
        """Record an edit, made just after a check: restart the energy balance, and let overlapping bodies separate."""
        self.moving, self.potential, self.weight = energies(self.solver)
        self.budget += self.weight / 9.81 * SEPARATION_SPEED**2 / 2
        self.led.clear()
        self.put, self.frames = max(behind(self.solver, self.solver.snapshot()), 0.0), 0
        self.edited.append(what)

    def look(self, time: float) -> None:
        """Check all invariants. Raises Failure."""
        q = self.solver.snapshot()
        if not (np.isfinite(q["x"]).all() and np.isfinite(q["v"]).all()):
            raise Failure(f"not finite; edits so far: {', '.join(self.edited) or 'none'}")
        if recovered := self.solver.stats["recovered"] - self.recovered:
            self.recovered += recovered
            raise Failure(f"{recovered} bodies were not finite; edits so far: {', '.join(self.edited) or 'none'}")
        out = behind(self.solver, q)
        if out > MAX_SURFACE_DEPTH + max(self.put - MIN_RETURN_SPEED * self.frames * FRAME, 0.0):
            raise Failure(f"{1000 * out:.0f} mm behind floor or wall; edits so far: {', '.join(self.edited) or 'none'}")
        for part in (q["bodies"][k] for k in self.led):
            height = np.ptp(part.shape.vertices, axis=0).max()
            self.budget += part.mass.sum() * -self.solver.gravity[1] * height
        self.led.clear()
        moving, potential, weight = energies(self.solver)
        gained = moving + potential - self.moving - self.potential
        allowed = self.budget + MAX_GAIN * max(self.moving, moving) + MAX_LIFT * weight
        if gained > allowed:
            raise Failure(f"gained {gained:.3g} J of {moving:.3g} J, {allowed:.3g} J explained; edits: {self.edited}")
        self.moving, self.potential, self.weight = moving, potential, weight
        self.budget = max(self.budget - gained, 0.0)


def behind(solver, snapshot: dict) -> float:
    """Largest depth behind floor or wall [m]: of surface vertices, and of inner ones less EXTRA_INNER_DEPTH."""
    x, skin = snapshot["x"][: solver.vertex_offset[len(snapshot["bodies"])]], surface(solver, snapshot)
    beyond = np.maximum(-x[:, 1], np.abs(x[:, [0, 2]]).max(1) - ARENA)
    return float(max(beyond[skin].max(), beyond.max() - EXTRA_INNER_DEPTH))


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
    """Indices of bodies with an inverted tet."""
    x, at, found = snapshot["x"].astype(np.float64), 0, []
    for k, part in enumerate(snapshot["bodies"]):
        corners = x[at : at + len(part.shape.vertices)][part.shape.tets]
        if (np.linalg.det(corners[:, 1:] - corners[:, :1]) <= 0).any():
            found.append(k)
        at += len(part.shape.vertices)
    return found
