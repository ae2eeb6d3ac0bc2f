"""Throwing: the motion that a body goes on with when a hand lets go of it, from the hand's last poses (NumPy only).

Fingers slow down as they open, and a soft body swings on its springs, so neither the hand's last velocity nor the
body's is what the user means: the rigid part of the body's motion becomes the straight line through the hand's poses.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

THROW_WINDOW = 0.08  # [s] before the release that decide: longer than fingers take to open


def hand_motion(history: tuple[tuple[float, tuple[float, ...]], ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position [m], velocity [m/s] and angular velocity [rad/s] of a hand, by least squares.

    history: ages [s] of its last poses (position, quaternion wxyz), at least two; the position is the last one.
    """
    t = -np.array([age for age, _ in history])
    poses = np.array([pose for _, pose in history], np.float64)
    attitudes = Rotation.from_quat(poses[:, 3:], scalar_first=True)
    rotations = (attitudes * attitudes[-1].inv()).as_rotvec()
    t = t - t.mean()
    slopes = t @ np.hstack([poses[:, :3], rotations]) / (t @ t)
    return poses[-1, :3], slopes[:3], slopes[3:]


def throw_velocities(history, x: np.ndarray, v: np.ndarray, mass: np.ndarray, max_impulse: float) -> np.ndarray:
    """Change of the velocities v of a body's vertices at x, (V, 3), by which it moves on with the hand [m/s], (V, 3).

    Its root mean square is at most `max_impulse` [N s] over the mass of the body: what the hand could have given it.
    """
    M = mass.sum()
    c, v_c = mass @ x / M, mass @ v / M
    r = x - c
    square = (r**2).sum(1)[:, None, None] * np.eye(3) - r[:, :, None] * r[:, None, :]
    inertia = np.einsum("i,ijk->jk", mass, square)
    inertia += (1e-6 * np.trace(inertia) + 1e-12) * np.eye(3)
    omega_body = np.linalg.solve(inertia, mass @ np.cross(r, v))
    position, velocity, omega = hand_motion(history)
    change = velocity + np.cross(omega, c - position) - v_c + np.cross(omega - omega_body, r)
    size = np.sqrt(mass @ (change**2).sum(1) / M)
    return change * min(1.0, max_impulse / M / max(size, 1e-12))
