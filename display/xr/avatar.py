"""What the player sees of himself: hands or controllers, the finger that pokes, the ray that points.

Everything is drawn where the solver has it, not where it is a moment later: a hand must not slip on what it holds.
"""

from __future__ import annotations

import numpy as np

from display.edit import selection_marker as marking
from display.xr import hand_mesh as hand_model
from display.xr.hand_joints import COUNT
from display.xr.hand_mesh import SPACING, discs
from render.skinned_props import Skin

CONTROLLER, SHAFT, TIP = 2 * COUNT, 2 * COUNT + 2, 2 * COUNT + 4  # first parts, left then right
RAY, SPOT = 2 * COUNT + 6, 2 * COUNT + 7
CORNERS = SPOT + 1
PARTS = CORNERS + 8
HANDLE, ARCH = 0.013, (0.040, 0.0045)  # [m] radius of the handle; of the ring and of its tube
LEAN = -0.75  # [rad] of the ring towards the player
BODY, RING, FINGER = np.array([0.22, 0.23, 0.25]), np.array([0.36, 0.37, 0.40]), np.array([0.86, 0.80, 0.72])
BEAM = np.array([1.0, 0.83, 0.45])
POKE = 0.009  # [m] radius of the poking finger, as in poking.py
SPOT_RADIUS, BEAM_RADIUS = 0.11, 0.0016  # [m]
ABOVE = 0.03  # [m] of the spot over the floor, on which a carpet may lie
STEPS = 40  # Gaussians along the ray
STROKE, THIN = 8, 0.04  # Gaussians along a stroke of a corner; its radius, of its length
FINE = 0.6 * SPACING  # [m] between Gaussians of what is thin


def skins() -> list[Skin]:
    """All that can be shown, in the order of the parts; what casts no shadow first, as World wants it."""
    solid = [*hand_model.skins()]
    for side in (0, 1):
        solid += [one(*controller(), CONTROLLER + side), one(*shaft(), SHAFT + side), one(*tip(), TIP + side)]
    return [ray(), spot(), *(corner(CORNERS + k) for k in range(8)), *solid]


def one(x, n, colour, part: int) -> Skin:
    """A rigid thing of flat Gaussians."""
    gaussians = discs(x, n, 0.8 * SPACING, 0.0005, colour, np.full(len(x), 0.99))
    return whole(gaussians, n, part, solid=True)


def whole(gaussians, n, part: int, *, solid: bool) -> Skin:
    """Gaussians that one part carries."""
    parts, weight = np.full((len(n), 4), part), np.zeros((len(n), 4))
    weight[:, 0] = 1.0
    return Skin(gaussians, n, parts, weight, solid)


def tube(length: float, radius, spacing: float = FINE) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals of a tube from the origin along -z; radius [m] of the share 0..1 of its length."""
    around = max(int(2 * np.pi * radius(0.5) / spacing), 6)
    z = np.linspace(0.0, 1.0, max(int(length / spacing), 2))
    t, a = np.meshgrid(z, 2 * np.pi * np.arange(around) / around, indexing="ij")
    r = np.vectorize(radius)(t)
    n = np.stack([np.cos(a), np.sin(a), 0 * a], -1).reshape(-1, 3)
    return r.reshape(-1, 1) * n + [0, 0, -length] * t.reshape(-1, 1), n


def dome(radius: float, spacing: float = FINE) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals of the half of a ball that looks along -z (a Fibonacci lattice)."""
    count = max(int(2 * np.pi * radius**2 / (0.8 * spacing**2)), 12)
    k = np.arange(count) + 0.5
    z, a = k / count, np.pi * (1 + 5**0.5) * k
    s = np.sqrt(1 - z**2)
    n = np.column_stack([s * np.cos(a), s * np.sin(a), -z])
    return radius * n, n


def controller() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A handle along the axis of the fist, and a ring around its head: in the frame of OpenXR's grip pose."""
    x, n = tube(0.095, lambda t: HANDLE * (1.0 + 0.28 * (2 * t - 1) ** 2))
    x, flip = x + [0, 0, 0.052], np.array([1.0, 1.0, -1.0])
    ends = [dome(HANDLE * 1.28, FINE) for _ in range(2)]
    pieces = [(x, n, BODY), (ends[0][0] + [0, 0, -0.043], ends[0][1], BODY)]
    pieces.append((ends[1][0] * flip + [0, 0, 0.052], ends[1][1] * flip, BODY))
    big, small = ARCH
    a, b = np.meshgrid(np.arange(0, 2 * np.pi, FINE / big), np.arange(0, 2 * np.pi, FINE / small), indexing="ij")
    n = np.stack([np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), np.sin(b)], -1).reshape(-1, 3)
    ring = small * n + big * np.stack([np.cos(a), np.sin(a), 0 * a], -1).reshape(-1, 3)
    tilt = np.array([[1, 0, 0], [0, np.cos(LEAN), -np.sin(LEAN)], [0, np.sin(LEAN), np.cos(LEAN)]])
    pieces.append((ring @ tilt.T + [0, 0.012, -0.055], n @ tilt.T, RING))
    return joined(pieces)


def joined(pieces) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, normals and colours of all pieces (points, normals, colour)."""
    x, n = (np.concatenate([p[k] for p in pieces]) for k in (0, 1))
    return x, n, np.concatenate([np.tile(p[2], (len(p[0]), 1)) for p in pieces])


def shaft() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The poking finger, 9 cm long when its part has scale 1."""
    return joined([(*tube(0.09, lambda _: POKE), FINGER)])


def tip() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Its round end."""
    return joined([(*dome(POKE), FINGER)])


def ray() -> Skin:
    """A thin ray along -z, 1 m long when its part has scale 1, paler to its end."""
    t = (np.arange(STEPS) + 0.5) / STEPS
    x = np.column_stack([0 * t, 0 * t, -t])
    up = np.tile([0.0, 0.0, 1.0], (STEPS, 1))
    g = discs(x, up, BEAM_RADIUS, 0.5 / STEPS, np.tile(BEAM, (STEPS, 1)), 0.75 - 0.45 * t)
    return whole(g, np.zeros((STEPS, 3)), RAY, solid=False)


def spot() -> Skin:
    """A ring on the floor, around +y."""
    a = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    rings = [(SPOT_RADIUS, 0.85), (0.9 * SPOT_RADIUS, 0.6), (0.2 * SPOT_RADIUS, 0.7)]
    x = np.concatenate([r * np.column_stack([np.cos(a), 0 * a, np.sin(a)]) for r, _ in rings])
    opacity = np.repeat([o for _, o in rings], len(a))
    n = np.tile([0.0, 1.0, 0.0], (len(x), 1))
    return whole(discs(x, n, 0.006, 0.002, np.tile(BEAM, (len(x), 1)), opacity), 0 * n, SPOT, solid=False)


def corner(part: int) -> Skin:
    """Three strokes from the origin along the axes, 1 m long when the part has scale 1."""
    t = (np.arange(STROKE) + 0.5) / STROKE
    axes = np.repeat(np.eye(3), STROKE, axis=0)
    x = axes * np.tile(t, 3)[:, None]
    g = discs(x, axes, THIN, 0.5 / STROKE, np.tile(marking.COLOUR, (len(x), 1)), np.full(len(x), 0.95))
    return whole(g, np.zeros_like(x), part, solid=False)


def corners(parts: np.ndarray, body) -> None:
    """Out: the corners around a body (BodyState)."""
    at, length = marking.corners(body)
    sides = np.minimum(length, 0.5 * (at[-1] - at[0]))
    for k, signs in enumerate(marking.SIGNS):
        parts[CORNERS + k] = np.column_stack([np.diag(-signs * sides), at[k]])


def hidden() -> np.ndarray:
    """The parts when nothing is shown, (PARTS, 3, 4)."""
    return np.full((PARTS, 3, 4), np.nan)


def side_of(parts: np.ndarray, h: int, c, stage: np.ndarray, poke: float) -> None:
    """Out: the parts of side h, of what plays there (actions.Controller), whose finger is out by `poke`, 0 to 1."""
    if c.joints is not None:
        parts[COUNT * h : COUNT * (h + 1)] = hand_model.placed(c.joints.moved(stage), left=h == 0)
    elif c.grip is not None:
        grip = stage @ c.grip
        parts[CONTROLLER + h] = grip[:3]
        if poke > 0.0:
            aim = grip.copy()
            aim[:3, :3] = (stage @ (c.grip if c.aim is None else c.aim))[:3, :3]
            parts[SHAFT + h] = (aim @ np.diag([1.0, 1.0, poke, 1.0]))[:3]
            parts[TIP + h] = (aim @ shift(0.0, 0.0, -0.09 * poke))[:3]


def pointing(parts: np.ndarray, start: np.ndarray, end: np.ndarray, *, floor: bool) -> None:
    """Out: the ray from start (3,) to end (3,) [m], and the spot there if that is the floor."""
    way = end - start
    length = max(float(np.linalg.norm(way)), 1e-6)
    back = -way / length
    side = np.cross((0.0, 1.0, 0.0), back)
    side = side / np.linalg.norm(side) if np.linalg.norm(side) > 1e-6 else np.array([1.0, 0.0, 0.0])
    parts[RAY] = np.column_stack([side, np.cross(back, side), length * back, start])
    if floor:
        parts[SPOT] = np.column_stack([np.eye(3), end + [0.0, ABOVE, 0.0]])


def shift(x: float, y: float, z: float) -> np.ndarray:
    """(4, 4) that moves by this [m]."""
    m = np.eye(4)
    m[:3, 3] = x, y, z
    return m
