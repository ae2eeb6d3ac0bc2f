"""Procedural colours: noise, wood, cloth, paint. All colours are linear RGB albedos in 0..1."""

from __future__ import annotations

import numpy as np

from studio.shapes import Colour

# Light and dark tones of the woods in the room, linear RGB.
OAK = ((0.56, 0.36, 0.19), (0.30, 0.165, 0.072))
HONEY = ((0.47, 0.245, 0.098), (0.215, 0.088, 0.031))
WALNUT = ((0.235, 0.125, 0.062), (0.085, 0.040, 0.020))
BEECH = ((0.60, 0.40, 0.225), (0.42, 0.25, 0.125))

LATTICE_PRIMES = (73856093, 19349663, 83492791)  # Teschner et al. 2003
# The twelve edge directions of a cube, four of them twice (Perlin 2002), (3, 16).
GRADIENTS = np.array(
    [(1, 1, 0), (-1, 1, 0), (1, -1, 0), (-1, -1, 0), (1, 0, 1), (-1, 0, 1), (1, 0, -1), (-1, 0, -1)]
    + [(0, 1, 1), (0, -1, 1), (0, 1, -1), (0, -1, -1), (1, 1, 0), (-1, 1, 0), (0, -1, 1), (0, -1, -1)],
    float,
).T.copy()


def srgb(code: str) -> np.ndarray:
    """Linear RGB of a display colour such as "c86432"."""
    c = np.array([int(code[i : i + 2], 16) for i in (0, 2, 4)]) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def mix(a, b, t) -> np.ndarray:
    """Blend of colours a and b by t (N,)."""
    t = np.asarray(t)[..., None]
    return np.asarray(a) * (1 - t) + np.asarray(b) * t


def smoothstep(low: float, high: float, t) -> np.ndarray:
    """Smooth step from 0 at `low` to 1 at `high`."""
    t = np.clip((t - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def noise(points: np.ndarray, seed: int = 0) -> np.ndarray:
    """Gradient noise (Perlin 2002) with hashed gradients, about -0.7..0.7, at points (N, 3)."""
    cell = np.floor(points)
    f = points - cell
    cell = cell.astype(np.int64)
    u = f * f * f * (f * (f * 6 - 15) + 10)
    keys = [[(cell[:, k] + d) * LATTICE_PRIMES[k] for d in (0, 1)] for k in range(3)]
    weights = [(1 - u[:, k], u[:, k]) for k in range(3)]
    total = np.zeros(len(points))
    for corner in range(8):
        i, j, k = corner & 1, corner >> 1 & 1, corner >> 2 & 1
        g = GRADIENTS[:, _hash(keys[0][i] ^ keys[1][j] ^ keys[2][k], seed) & 15]
        weight = weights[0][i] * weights[1][j] * weights[2][k]
        total += weight * (g[0] * (f[:, 0] - i) + g[1] * (f[:, 1] - j) + g[2] * (f[:, 2] - k))
    return total


def fbm(points: np.ndarray, octaves: int = 4, seed: int = 0) -> np.ndarray:
    """Fractional Brownian motion: a sum of noise octaves, each of half the amplitude and twice the frequency."""
    total, amplitude = np.zeros(len(points)), 1.0
    for k in range(octaves):
        total += amplitude * noise(points * 2.0**k, seed + k)
        amplitude *= 0.5
    return total


def hash_uniform(index: np.ndarray, seed: int = 0) -> np.ndarray:
    """Uniform pseudo-random numbers in 0..1, a function of integers (a hash)."""
    return (_hash(np.asarray(index, np.int64), seed) & 0xFFFFFF) / float(0x1000000)


def plain(colour, variation: float = 0.03, size: float = 0.25, seed: int = 0) -> Colour:
    """One colour with faint blotches of `size` [m], like paint or glaze."""
    colour = srgb(colour) if isinstance(colour, str) else np.asarray(colour)

    def colour_at(p, n):
        return colour * (1 + variation * 2 * fbm(p / size, 3, seed))[:, None]

    return colour_at


def wood(tones, axis: int = 0, board: float = 0.0, across: int = 2, seed: int = 0, ring: float = 0.011) -> Colour:
    """Sawn timber with the grain along `axis`; boards `board` [m] wide lie side by side along `across`.

    Annual rings follow the distance from a bent pith: early wood is light, late wood dark; pores are fine streaks.
    """
    light, dark = (np.asarray(t) for t in tones)
    other = 3 - axis - across

    def colour_at(p, n):
        index = np.floor(p[:, across] / board).astype(int) if board else np.zeros(len(p), int)
        shift = [hash_uniform(index, seed + k) for k in range(4)]
        along = p[:, axis] + 7 * shift[0]
        y = p[:, across] - (index + 0.5) * board + 0.06 * (shift[1] - 0.5)
        z = p[:, other] + 0.03 + 0.05 * shift[2]
        q = np.stack([along, y, z], 1)
        wobble = 0.020 * fbm(q * (1.1, 5, 5), 3, seed) + 0.004 * noise(q * (4, 40, 40), seed + 9)
        t = np.hypot(y, z) / ring + wobble / ring
        t = t - np.floor(t)
        late = smoothstep(0.15, 0.8, t) * (1 - smoothstep(0.86, 1.0, t))
        pores = smoothstep(0.02, 0.45, noise(q * (9, 170, 170), seed + 3))
        streak = fbm(q * (2.2, 60, 60), 3, seed + 5)
        tone = 0.14 + 0.58 * late + 0.24 * pores + 0.30 * streak + 0.30 * (shift[3] - 0.5)
        hue = 1 + 0.05 * (shift[1] - 0.5)[:, None] * (1, 0, -1)
        c = mix(light, dark, np.clip(tone, 0, 1)) * hue
        if board:  # dark line along a glued joint
            edge = 0.5 * board - np.abs(p[:, across] - (index + 0.5) * board)
            c = c * (1 - 0.35 * (1 - smoothstep(0.0, 0.0022, edge)))[:, None]
        return c

    return colour_at


def cloth(colour, thread: float = 0.004, depth: float = 0.22, blotch: float = 0.08, seed: int = 0) -> Colour:
    """Woven cloth: threads of irregular brightness in two directions, and faint large blotches."""
    colour = srgb(colour) if isinstance(colour, str) else np.asarray(colour)

    def colour_at(p, n):
        q = p / thread
        weave = 0.5 * (noise(q * (1, 0.15, 0.15), seed) + noise(q * (0.15, 0.15, 1), seed + 1))
        weave += 0.5 * noise(q * (0.15, 1, 0.15), seed + 2)
        return colour * np.clip(1 + depth * 1.6 * weave + blotch * 2 * fbm(p * 5, 3, seed + 3), 0.2, 2)[:, None]

    return colour_at


def speckled(colour, spots, amount: float = 0.2, size: float = 0.003, seed: int = 0) -> Colour:
    """Stoneware: a plain glaze with spots of `size` [m]."""
    base, spots = plain(colour, 0.05, 0.05, seed), srgb(spots)

    def colour_at(p, n):
        return mix(base(p, n), spots, 0.8 * smoothstep(0.55 - amount, 0.75 - amount, noise(p / size, seed + 1)))

    return colour_at


def _hash(values: np.ndarray, seed: int) -> np.ndarray:
    with np.errstate(over="ignore"):
        h = values.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(
            (seed + 1) * 0xD1B54A32D192ED03 % 2**64
        )
        h = (h ^ (h >> np.uint64(31))) * np.uint64(0xBF58476D1CE4E5B9)
        h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return (h ^ (h >> np.uint64(32))).astype(np.int64)
