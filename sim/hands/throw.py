"""What a body flies on with when a hand lets go of it: the hand's own motion of the last moments (NumPy only).

Fingers slow down as they open, and a soft body swings on its springs, so neither the hand's last velocity nor the
body's is what the user means: the rigid part of the body's motion becomes the straight line through the hand's poses.
"""

from __future__ import annotations

import numpy as np

from core.rotation import matrices_from_quaternions

AIM = 0.08  # [s] before the release that decide
FASTEST = 20.0  # [m/s] an arm throws; faster poses are a fault of the tracking
SPIN = 40.0  # [rad/s] likewise


def hand_motion(trail: tuple[tuple[float, tuple[float, ...]], ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position [m], velocity [m/s] and angular velocity [rad/s] of a hand, by least squares.

    trail: ages [s] of its last poses (position, quaternion wxyz), at least two; the position is the last one.
    """
    t = -np.array([age for age, _ in trail])
    poses = np.array([pose for _, pose in trail], np.float64)
    turns = np.array([rotation_vector(pose[3:], poses[-1, 3:]) for pose in poses])
    t = t - t.mean()
    slopes = t @ np.hstack([poses[:, :3], turns]) / (t @ t)
    return poses[-1, :3], capped(slopes[:3], FASTEST), capped(slopes[3:], SPIN)


def rotation_vector(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The rotation a b^-1, the shorter way, as axis times angle [rad]."""
    R = np.einsum("ij,kj->ik", *matrices_from_quaternions(np.stack([a, b])))
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])  # 2 sin(angle)
    sine, cosine = np.linalg.norm(axis) / 2, (np.trace(R) - 1) / 2
    return axis / 2 * (np.arctan2(sine, cosine) / sine if sine > 1e-9 else 1.0)


def change(trail, x: np.ndarray, v: np.ndarray, mass: np.ndarray, impulse: float) -> np.ndarray:
    """What to add to the velocities v of a body's vertices at x, all (V, 3), so that it moves on with the hand, (V, 3).

    Its root mean square is at most `impulse` [N s] over the mass of the body: what the hand could have given it.
    """
    M = mass.sum()
    c, v_c = mass @ x / M, mass @ v / M
    r = x - c
    square = (r**2).sum(1)[:, None, None] * np.eye(3) - r[:, :, None] * r[:, None, :]
    inertia = np.einsum("i,ijk->jk", mass, square)
    inertia += (1e-6 * np.trace(inertia) + 1e-12) * np.eye(3)
    spin = np.linalg.solve(inertia, mass @ np.cross(r, v))
    position, velocity, omega = hand_motion(trail)
    added = velocity + np.cross(omega, c - position) - v_c + np.cross(omega - spin, r)
    most, size = impulse / M, np.sqrt(mass @ (added**2).sum(1) / M)
    return added * min(1.0, most / max(size, 1e-12))


def capped(vector: np.ndarray, most: float) -> np.ndarray:
    """The vector, no longer than `most`."""
    return vector * min(1.0, most / max(np.linalg.norm(vector), 1e-12))
