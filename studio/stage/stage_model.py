"""Assembly of the stage: its surfaces, its light and where the player stands."""

from __future__ import annotations

import numpy as np

from assets.asset import Asset
from studio.detail import Detail
from studio.light_sources import LightSources
from studio.lit_room import Room, lit_room, room_asset
from studio.stage import hall, prop_tables, stage_lights
from studio.stage.house import house
from studio.stage.scenery import scenery
from studio.surface_sampling import Viewer

VIEWER = Viewer(
    (0.0, 1.5, 1.7), ((-1.1, 1.15, 1.2), (1.1, 1.15, 1.2), (-1.1, 1.9, 2.3), (1.1, 1.9, 2.3), (0.0, 1.6, 0.9))
)


def stage(rng: np.random.Generator, detail: Detail, report) -> Asset:
    """The asset `stage`: theatre and hall."""
    surfaces = [*hall.hall(), *house(), *scenery(), *stage_lights.stage_lights(), *prop_tables.prop_tables()]
    sources = LightSources(lamps=[*hall.lamps(), *stage_lights.lamps()])
    return room_asset("stage", lit_room(Room(surfaces, sources, VIEWER), rng, detail, report), rng, report)
