"""Assembly of the dining room: its surfaces, its light and where the player stands."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from assets.asset import Asset
from studio.detail import Detail
from studio.dining_room.bottle import bottle_surfaces
from studio.dining_room.decor import decor, lamps
from studio.dining_room.furniture import furniture
from studio.dining_room.shell import SUN, garden, openings, shell
from studio.dining_room.tableware import tableware
from studio.light_sources import LightSources
from studio.lit_room import LitRoom, Room, lit_room, room_asset
from studio.surface_sampling import Viewer

SEED = 7  # of the light, which the room and the bottle share
VIEWER = Viewer(
    (0.0, 1.5, 1.3), ((-1.1, 1.15, 1.0), (1.1, 1.15, 1.0), (-1.1, 1.9, 1.9), (1.1, 1.9, 1.9), (0.0, 1.6, 0.7))
)
# Bounds of the signed distance grid [m]: the objects on the table, not the table itself.
GRID_LOW, GRID_HIGH, GRID_SPACING = (-0.85, 0.65, -0.5), (0.85, 1.15, 0.5), 0.01


@lru_cache(maxsize=1)
def lit_dining_room(detail: Detail, report) -> LitRoom:
    """The dining room with its light solved; the bottle shades the table but is an asset of its own."""
    on_table, solids = tableware()
    room = Room(
        [*shell(), *garden(), *furniture(), *decor(), *on_table],
        LightSources(openings(), lamps(), SUN),
        VIEWER,
        bottle_surfaces(),
        solids,
        (GRID_LOW, GRID_HIGH, GRID_SPACING),
    )
    return lit_room(room, np.random.default_rng(SEED), detail, report)


def dining_room(rng: np.random.Generator, detail: Detail, report) -> Asset:
    """The asset `dining_room`."""
    return room_asset("dining_room", lit_dining_room(detail, report), rng, report)
