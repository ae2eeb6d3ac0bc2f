"""Five shapes as signed distances [m], in metres: a ball, a mug, a ring on a board, a rabbit and a capsule."""

import numpy as np


def torus(p, centre, axis, major, minor):
    """Signed distance (...) of points (..., 3) to a torus about an axis (0, 1 or 2)."""
    d = p - np.asarray(centre)
    along = d[..., axis]
    across = np.sqrt(np.maximum((d**2).sum(-1) - along**2, 0))
    return np.hypot(across - major, along) - minor


def ellipsoid(p, centre, radii):
    """Not a distance, but zero on the ellipsoid and of slope about one there."""
    q, r = p - np.asarray(centre), np.asarray(radii)
    k0, k1 = np.linalg.norm(q / r, axis=-1), np.linalg.norm(q / r**2, axis=-1)
    return k0 * (k0 - 1) / np.maximum(k1, 1e-9)


def brick(p, centre, half):
    """Signed distance of a box."""
    q = np.abs(p - np.asarray(centre)) - np.asarray(half)
    return np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(-1), 0)


def capsule(p, a, b, radius):
    """Signed distance of a capsule."""
    a, b = np.asarray(a), np.asarray(b)
    t = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(p - a - t[..., None] * (b - a), axis=-1) - radius


def ball(p):
    """Signed distance of a ball of 24 cm."""
    return np.linalg.norm(p, axis=-1) - 0.12


def mug(p):
    """A mug of 12 cm with walls of 1 cm and a handle."""
    r, y = np.hypot(p[..., 0], p[..., 2]), p[..., 1]
    outer = np.maximum(r - 0.045, np.abs(y) - 0.06)
    inner = np.maximum(r - 0.035, -0.048 - y)
    handle = np.maximum(torus(p, (0.052, 0, 0), 2, 0.03, 0.007), 0.04 - r)
    return np.minimum(np.maximum(outer, -inner), handle)


def ring(p):
    """A thin ring that lies on a board of 22 cm."""
    return np.minimum(torus(p, (0, 0.0145, 0), 1, 0.07, 0.005), brick(p, (0, 0, 0), (0.11, 0.01, 0.11)))


def bunny(p):
    """A rabbit of 28 cm with thin ears."""
    body = np.minimum(ellipsoid(p, (0, 0, 0), (0.08, 0.075, 0.07)), ellipsoid(p, (0.05, 0.08, 0), (0.045,) * 3))
    ears = [ellipsoid(p, (0.04, 0.15, side * 0.025), (0.014, 0.055, 0.005)) for side in (-1, 1)]
    return np.minimum(body, np.minimum(*ears))


def slanted_capsule(p):
    """A capsule of 10 cm by 24 cm."""
    return capsule(p, (-0.07, 0, 0), (0.07, 0.03, 0), 0.05)


SHAPES = {  # signed distance, and half the side of a cube about the origin that holds the shape [m]
    "ball": (ball, 0.13),
    "mug": (mug, 0.1),
    "ring": (ring, 0.12),
    "bunny": (bunny, 0.22),
    "capsule": (slanted_capsule, 0.13),
}
