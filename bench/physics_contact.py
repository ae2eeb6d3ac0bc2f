"""Rows of the physics table for bodies in contact, in the form of bench/physics.py.

Functions on rigid bodies take a `playground()` or create one. Taichi must be initialised.
"""

import numpy as np

from bench.physics import at_most, row
from bench.setups import DROP, FRAME, RESTITUTIONS, SIDE, G, linked_throws, playground, resting_pile, run

TIP_HEIGHT = 0.07  # [m] of an octahedron's centre over its lowest vertex
MOST_GAINED = 1e-5  # [J]; it lifts a cube of the pile by 2 um


def rigid_bodies() -> list[dict]:
    """Rebounds, stacks and a slope, all in one solver."""
    place = playground()
    return [*rigid_bounce(place), *rigid_stack(place), *slope(place)]


def ring_throws(count: int = 120, **options) -> list[dict]:
    """Rings thrown on their pegs at up to 5 m/s, none of which may come off, not even at twice their size."""
    rows = []
    for peg, stretch in ((0.02, 1.0), (0.04, 2.0), (0.08, 2.0)):
        name = f"rings{' of twice their size' * (stretch > 1)} that stay on a {100 * peg:g} cm peg, of {count}"
        rows.append(row(name, count, linked_throws(count, 5.0, peg=peg, stretch=stretch, **options), 0.0))
    return rows


def pile_at_rest(seconds: float = 60.0) -> list[dict]:
    """A pile at rest gains no energy."""
    return [at_most(f"pile at rest, energy gained in {seconds:g} s [J]", MOST_GAINED, resting_pile(seconds)["gained"])]


def started(place):
    """The playground, reset to its start."""
    solver, where = place or playground()
    solver.gravity = (0.0, -G, 0.0)
    solver.reset()
    return solver, where


def rigid_bounce(place=None) -> list[dict]:
    """Height of the first rebound, from position and velocity in the frame after the impact: h1 = e^2 h0."""
    solver, where = started(place)
    y, v = [], []
    for _ in range(30):
        solver.step(FRAME)
        states = solver.bodies()[where["bouncing"]]
        y.append([s.centroid[1] for s in states])
        v.append([s.velocity[1] for s in states])
    y, v, rows = np.array(y), np.array(v), []
    for k, e in enumerate(RESTITUTIONS):
        for j, name, resting in ((2 * k, "box", SIDE / 2), (2 * k + 1, "octahedron", TIP_HEIGHT)):
            fallen = np.flatnonzero(v[:, j] < -1.0)[-1] + 1
            height = y[fallen, j] - resting + max(v[fallen, j], 0.0) ** 2 / (2 * G)
            error = abs(height / DROP - e**2) / max(e**2, 0.25)
            rows.append(row(f"{name} bounces, e = {e}, h1/h0", e**2, height / DROP, 0.03, error=error))
    return rows


def rigid_stack(place=None, seconds: float = 10.0) -> list[dict]:
    """Drift and speed of a stack of five boxes and of a brick wall at rest."""
    solver, where = started(place)
    run(solver, 0.5)
    before = np.array([s.centroid for s in solver.bodies()])
    run(solver, seconds)
    states = solver.bodies()
    moved = np.linalg.norm(np.array([s.centroid for s in states]) - before, axis=1)
    speed = np.array([np.linalg.norm(s.velocity) for s in states])
    rows = []
    for scene, name in (("stack", "stack of five"), ("wall", "brick wall")):
        drift, fastest = moved[where[scene]].max(), speed[where[scene]].max()
        rows.append(at_most(f"{name}, drift in {seconds:g} s [m]", 1e-3, drift))
        rows.append(at_most(f"{name}, fastest at the end [m/s]", 1e-3, fastest))
    return rows


def slope(place=None) -> list[dict]:
    """Acceleration of a box on a slope: 0 below the friction angle, g (sin a - mu cos a) above it."""
    solver, where = started(place)
    box, mu, rows = where["sliding"].start, np.sqrt(0.5 * 0.6), []
    for away in (-1.0, 1.0):
        a = np.arctan(mu) + np.radians(away)
        solver.reset()
        solver.gravity = (0.0, -G * np.cos(a), G * np.sin(a))
        run(solver, 0.3)
        before = solver.bodies()[box].velocity[2]
        run(solver, 0.5)
        gained = (solver.bodies()[box].velocity[2] - before) / 0.5
        expected = max(G * (np.sin(a) - mu * np.cos(a)), 0.0)
        name = f"slope, {away:+g} deg of the friction angle [m/s^2]"
        rows.append(row(name, expected, gained, 0.02, error=abs(gained - expected)))
    return rows
