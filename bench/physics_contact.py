"""The rows of the physics table for rigid bodies in contact, in the form of bench/physics.py.

Each function takes the solver and the places of bench/playground.py, or makes them; Taichi must be initialised.
"""

import numpy as np

from bench.physics import row
from bench.playground import DROP, RESTITUTIONS, playground

FRAME, G = 1 / 60, 9.81
STAND = 0.07  # [m] of an octahedron's centre over its tip


def run(solver, seconds: float) -> None:
    for _ in range(round(seconds / FRAME)):
        solver.step(FRAME)


def started(place):
    """The playground at its start."""
    solver, where = place or playground()
    solver.gravity = (0.0, -G, 0.0)
    solver.reset()
    return solver, where


def rigid_bounce(place=None) -> list[dict]:
    """The height of the first rebound, from place and speed in the frame after the impact: h1 = e^2 h0."""
    solver, where = started(place)
    y, v = [], []
    for _ in range(30):
        solver.step(FRAME)
        states = solver.bodies()[where["bouncing"]]
        y.append([s.centroid[1] for s in states])
        v.append([s.velocity[1] for s in states])
    y, v, rows = np.array(y), np.array(v), []
    for k, e in enumerate(RESTITUTIONS):
        for j, name, stand in ((2 * k, "box", 0.05), (2 * k + 1, "octahedron", STAND)):
            fallen = np.flatnonzero(v[:, j] < -1.0)[-1] + 1
            height = y[fallen, j] - stand + max(v[fallen, j], 0.0) ** 2 / (2 * G)
            error = abs(height / DROP - e**2) / max(e**2, 0.25)
            rows.append(row(f"{name} bounces, e = {e}, h1/h0", e**2, height / DROP, 0.03, error=error))
    return rows


def rigid_stack(place=None, seconds: float = 10.0) -> list[dict]:
    """A stack of five boxes and a brick wall stay where they are."""
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
        rows.append(row(f"{name}, drift in {seconds:g} s [m]", 0.0, drift, 1e-3, error=drift))
        rows.append(row(f"{name}, fastest at the end [m/s]", 0.0, fastest, 1e-3, error=fastest))
    return rows


def slope(place=None) -> list[dict]:
    """A box lies still one degree below the friction angle, and slides one above at g (sin a - mu cos a)."""
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
