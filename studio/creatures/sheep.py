"""The sheep: 0.55 m high, in curly cream wool with a dark face and legs."""

from __future__ import annotations

import numpy as np

from studio.creatures.creature import Creature, Part, pair, tissue
from studio.creatures.implicit import ellipsoid, limb
from studio.shapes import rotation_about

WOOL, FACE, MUZZLE, BLACK = "efe6d2", "443a33", "7a6659", "0e0c0a"
YOUNG = 6e4  # [Pa]
LUMPS, LUMP = 36, 0.052  # of the fleece, and their radius [m]


def sheep() -> Creature:
    """The model."""
    trunk, half = np.array([0, 0.315, -0.03]), np.array([0.135, 0.125, 0.2])
    i = np.arange(LUMPS) + 0.5  # Fibonacci sphere
    y, a = 1 - 2 * i / LUMPS, np.pi * (1 + 5**0.5) * i
    lumps = trunk + half * np.stack([np.sqrt(1 - y * y) * np.cos(a), y, np.sqrt(1 - y * y) * np.sin(a)], 1)
    fleece = [Part(ellipsoid(c, LUMP, growth=c - trunk), WOOL, 0.02) for c in lumps]
    crown = [(0, 0.508, 0.19), (0.034, 0.5, 0.195), (-0.034, 0.5, 0.195), (0, 0.49, 0.15), (0, 0.503, 0.222)]
    fore = [(0.078, 0.25, 0.085), (0.08, 0.1, 0.09), (0.08, 0.01, 0.095)]
    hind = [(0.082, 0.25, -0.15), (0.084, 0.1, -0.155), (0.084, 0.01, -0.15)]
    ear = rotation_about("z", -22)
    parts = [
        Part(ellipsoid(trunk, half), WOOL),
        *fleece,
        Part(limb([(0, 0.37, 0.12), (0, 0.44, 0.19)], [0.085, 0.07]), WOOL, 0.03),
        *(Part(ellipsoid(c, 0.04), WOOL, 0.015) for c in crown),
        Part(limb([(0, 0.455, 0.205), (0, 0.42, 0.275), (0, 0.39, 0.305)], [0.062, 0.052, 0.037]), FACE, 0.012, 0.006),
        Part(ellipsoid((0, 0.386, 0.318), (0.036, 0.029, 0.026)), MUZZLE, 0.012, 0.003),
        *pair(Part(ellipsoid((0.098, 0.448, 0.2), (0.047, 0.012, 0.024), ear, (1, -0.3, 0)), FACE, 0.012, 0.006)),
        *(part for path in (fore, hind) for part in pair(Part(limb(path, [0.05, 0.039, 0.042]), FACE, 0.015, 0.006))),
        Part(limb([(0, 0.36, -0.22), (0, 0.3, -0.265)], [0.035, 0.028]), WOOL, 0.02),
        *pair(Part(ellipsoid((0.037, 0.451, 0.272), (0.0135, 0.016, 0.012)), "f2ead8", 0.0)),
        *pair(Part(ellipsoid((0.0385, 0.45, 0.2785), (0.0095, 0.0115, 0.009)), BLACK, 0.0, glint=True)),
        *pair(Part(ellipsoid((0.013, 0.393, 0.343), (0.005, 0.006, 0.003)), BLACK, 0.0)),
        Part(limb([(-0.018, 0.373, 0.339), (0, 0.369, 0.345), (0.018, 0.373, 0.339)], [0.0025] * 3), BLACK, 0.0),
    ]
    low, high = (-0.2, -0.03, -0.34), (0.2, 0.58, 0.38)
    return Creature(parts, low, high, tissue(YOUNG), hair=0.011, lift=0.6, border=0.003, curl=0.9)
