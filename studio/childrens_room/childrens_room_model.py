"""Assembly of the children's room: its surfaces, its light and where the player is."""

from __future__ import annotations

import numpy as np

from assets.asset import Asset
from studio.childrens_room.bed_and_tent import furniture, tent_solid
from studio.childrens_room.painted_shell import SUN, openings, shell
from studio.childrens_room.play_things import lamps, play_things, solids
from studio.detail import Detail
from studio.light_sources import LightSources
from studio.lit_room import Room, lit_room, room_asset
from studio.surface_sampling import Viewer

VIEWER = Viewer(
    (0.0, 1.3, 1.4), ((-1.2, 0.7, 1.0), (1.2, 0.7, 1.0), (-1.2, 1.8, 1.9), (1.2, 1.8, 1.9), (0.0, 1.0, 0.6))
)
# Bounds and spacing of the signed distance grid [m]: tent, ball and blocks, not bed and shelf.
GRID = ((0.45, -0.03, -1.71), (1.92, 1.11, 0.33), 0.03)


def childrens_room(rng: np.random.Generator, detail: Detail, report) -> Asset:
    """The asset `childrens_room`."""
    room = Room(
        [*shell(), *furniture(), *play_things()],
        LightSources(openings(), lamps(), SUN),
        VIEWER,
        solids=[tent_solid(), *solids()],
        grid=GRID,
        exposure=2.0,
    )
    return room_asset("childrens_room", lit_room(room, rng, detail, report), rng, report)
