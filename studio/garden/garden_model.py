"""Assembly of the garden: its surfaces, sun and sky, and where the player is."""

from __future__ import annotations

import numpy as np

from assets.asset import Asset
from studio.detail import Detail
from studio.garden.garden_furniture import furniture, solids
from studio.garden.ground import ground
from studio.garden.plants import plants
from studio.light_sources import LightSources, Sun
from studio.lit_room import Room, lit_room, room_asset
from studio.surface_sampling import Viewer
from studio.textures import smoothstep

VIEWER = Viewer(
    (0.0, 1.45, 2.1), ((-1.6, 0.6, 1.2), (1.6, 0.6, 1.2), (-1.8, 1.9, 2.6), (1.8, 1.9, 2.6), (0.0, 1.2, -0.5))
)
SUNLIGHT = np.array([0.52, -0.74, -0.42])  # direction of travel; scenes repeat it for their shadows
SUN = Sun(SUNLIGHT / np.linalg.norm(SUNLIGHT), np.array([1.0, 0.90, 0.74]) * 12)
# Bounds and spacing of the signed distance grid [m]: bench and pots; the trunk is a capsule.
GRID = ((-3.2, -0.06, -3.4), (3.3, 1.0, 2.6), 0.05)


def open_sky(direction: np.ndarray) -> np.ndarray:
    """Radiance (N, 3): blue overhead, brighter at the horizon; the meadow's below it."""
    up = direction[:, 1:2]
    sky = np.array([2.1, 2.5, 3.1]) + np.array([1.6, 1.3, 0.7]) * np.clip(1 - up, 0, 1) ** 3
    meadow = np.array([0.5, 0.6, 0.25])
    return meadow + (sky - meadow) * smoothstep(-0.03, 0.05, up)


def garden(rng: np.random.Generator, detail: Detail, report) -> Asset:
    """The asset `garden`."""
    room = Room(
        [*ground(), *plants(), *furniture()],
        LightSources(None, (), SUN, open_sky),
        VIEWER,
        solids=solids(),
        grid=GRID,
        exposure=0.95,
    )
    return room_asset("garden", lit_room(room, rng, detail, report), rng, report)
