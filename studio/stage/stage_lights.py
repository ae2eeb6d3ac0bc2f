"""The stage's lights: spotlights in cans on booms and a bar, footlights behind shells, strips above."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from studio.light_sources import Lamp
from studio.shapes import Mesh, Surface, box, grid_mesh, join, lathe, superellipsoid, tube
from studio.stage.hall import BULB
from studio.stage.house import HOUSE_TOP, STAGE_FRONT, STAGE_TOP
from studio.textures import plain

CAN_RADIUS, CAN_LENGTH = 0.075, 0.20  # [m]
FOOTLIGHT_X = np.linspace(-1.2, 1.2, 9)  # [m]
FOOTLIGHT_Z = STAGE_FRONT - 0.10  # [m]
SHELL_RADIUS = 0.062  # [m] of the shells behind the footlights
WARM, COOL = np.array([1.0, 0.80, 0.56]), np.array([0.62, 0.74, 1.0])  # linear RGB of gelatine filters


@dataclass(frozen=True)
class Spot:
    """A spotlight: the centre of its opening, the point it aims at [m], its intensity, linear RGB, and half-angle."""

    at: tuple[float, float, float]
    aim: tuple[float, float, float]
    intensity: np.ndarray
    half_angle: float = 0.36  # [rad]


SPOTS = (
    Spot((-2.35, 2.72, 1.05), (-0.15, STAGE_TOP, -0.1), 22 * WARM, 0.26),
    Spot((2.35, 2.72, 1.05), (0.15, STAGE_TOP, -0.1), 22 * WARM, 0.26),
    Spot((-2.35, 2.15, 1.05), (0.6, STAGE_TOP + 0.5, -0.9), 7 * COOL, 0.3),
    Spot((2.35, 2.15, 1.05), (-0.6, STAGE_TOP + 0.5, -0.9), 7 * COOL, 0.3),
    Spot((-0.55, 3.30, 1.35), (0.0, STAGE_TOP, 0.0), 20 * WARM, 0.30),
    Spot((0.55, 3.30, 1.35), (0.0, STAGE_TOP, 0.0), 20 * WARM, 0.30),
    Spot((-0.9, 2.95, -0.72), (-0.1, STAGE_TOP, -0.15), 9 * COOL),
    Spot((0.9, 2.95, -0.72), (0.1, STAGE_TOP, -0.15), 9 * COOL),
)


def stage_lights() -> list[Surface]:
    """Cans, booms and bars, lenses, footlights."""
    cans, lenses, pipes = [], [], []
    for spot in SPOTS:
        rotation = aiming(spot)
        outer = [(CAN_RADIUS - 0.02, -CAN_LENGTH), (CAN_RADIUS - 0.008, -CAN_LENGTH + 0.04), (CAN_RADIUS, 0.0)]
        inner = [(CAN_RADIUS - 0.006, 0.0), (CAN_RADIUS - 0.012, -CAN_LENGTH + 0.03), (0.0, -CAN_LENGTH + 0.02)]
        cans.append(lathe([(0.0, -CAN_LENGTH), *outer, *inner], 24).moved(rotation, spot.at))
        disc = lathe([(CAN_RADIUS - 0.008, -0.02), (0.0, -0.012)], 20).moved(rotation, spot.at)
        lenses.append(disc)
    for s in (-1, 1):
        foot = np.array([s * 2.47, STAGE_TOP, 0.98])
        foot[1] = 0.0
        pipes.append(tube([foot, foot + (0, 1.5, 0), foot + (0, 2.95, 0)], 0.020, 12))
        pipes.append(lathe([(0.20, 0.0), (0.20, 0.02), (0.03, 0.05)], 24).moved(translation=foot))
        for y in (2.15, 2.72):
            pipes.append(tube([foot + (0, y, 0), foot + (-0.10 * s, y, 0.03)], 0.012, 10))
    pipes.append(tube([(-1.3, 3.42, 1.38), (0, 3.42, 1.38), (1.3, 3.42, 1.38)], 0.022, 12))
    pipes += [tube([(x, 3.42, 1.38), (x, 3.7, 1.38)], 0.010, 10) for x in (-1.1, 1.1)]
    pipes += [tube([(x, 3.42, 1.38), (x, 3.31, 1.36)], 0.012, 10) for x in (-0.55, 0.55)]
    glow = {"blocks_light": False}
    return [
        Surface("cans", join(*cans), plain("241f20", 0.05), 0.016, gloss=0.05),
        Surface("pipes", join(*pipes), plain("2c2828", 0.05), 0.034, gloss=0.05),
        Surface("lenses", join(*lenses), plain("fff2d8", 0.0), 0.011, emission=tuple(9.0 * WARM), **glow),
        *footlights(),
    ]


def footlights() -> list[Surface]:
    """Brass shells along the front, each with a bulb that shines onto the stage."""
    shells, bulbs = [], []
    for x in FOOTLIGHT_X:
        at = np.array([x, STAGE_TOP, FOOTLIGHT_Z])
        shells.append(shell(SHELL_RADIUS).moved(translation=at))
        bulbs.append(superellipsoid((0.028, 0.036, 0.028), 1.0, 10).moved(translation=at + (0, 0.026, -0.012)))
    rail = box((-1.32, STAGE_TOP, FOOTLIGHT_Z + 0.012), (1.32, STAGE_TOP + 0.022, FOOTLIGHT_Z + 0.028))
    return [
        Surface("shells", join(*shells), plain("b07f2c", 0.05), 0.0092, gloss=0.30, roughness=0.25, translucency=0.0),
        Surface("footlight rail", rail, plain("8a6428", 0.05), 0.010, gloss=0.2),
        Surface("footlight bulbs", join(*bulbs), plain("ffffff", 0.0), 0.0075, emission=tuple(9.0 * BULB),
                blocks_light=False),
    ]  # fmt: skip


def shell(radius: float) -> Mesh:
    """A scallop shell, open towards -z: a quarter of a sphere with ribs."""
    a = np.linspace(0.0, np.pi, 25)[:, None]  # from left to right
    b = np.linspace(0.06, 0.5 * np.pi, 10)[None]  # from the foot up and forward
    r = radius * (1 + 0.05 * np.cos(12 * a)) * (1 + 0 * b)
    y, out = 1.15 * r * np.sin(b) * np.sin(a) ** 0.6, r * np.sin(b)
    x, z = -out * np.cos(a) * 1.05, 0.75 * r * np.cos(b) * np.sin(a) ** 0.5
    return grid_mesh(np.stack(np.broadcast_arrays(x, y, z), -1))


def aiming(spot: Spot) -> np.ndarray:
    """Rotation (3, 3) that turns +y, along which a can is open, towards what the spot aims at."""
    y = np.subtract(spot.aim, spot.at)
    y /= np.linalg.norm(y)
    x = np.cross(y, (0.0, 0.0, 1.0))
    x /= np.linalg.norm(x)
    return np.stack([x, y, np.cross(x, y)], 1)


def lamps() -> list[Lamp]:
    """Bulbs of the spotlights and footlights, and strips of lamps above that light the scenery."""
    found = [
        Lamp(np.asarray(s.at) + 0.01 * aiming(s)[:, 1], 0.03, s.intensity, aiming(s)[:, 1], s.half_angle) for s in SPOTS
    ]
    found += [Lamp(np.array([x, STAGE_TOP + 0.04, FOOTLIGHT_Z - 0.03]), 0.014, 0.10 * BULB) for x in FOOTLIGHT_X[::2]]
    top = HOUSE_TOP - 0.15
    for x in (-1.2, 0.0, 1.2):
        found.append(Lamp(np.array([x, top, -1.0]), 0.05, 3.0 * np.array([1.0, 0.86, 0.74])))
        found.append(Lamp(np.array([x, top, -0.1]), 0.05, 0.8 * np.array([1.0, 0.84, 0.66])))
    return found
