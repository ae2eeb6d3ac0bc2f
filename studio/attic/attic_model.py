"""Assembly of the attic: its surfaces, its light and where the player stands."""

from __future__ import annotations

import numpy as np

from assets.asset import Asset
from studio.attic.attic_shell import SUN, attic_shell, openings
from studio.attic.boxes import PALLET_AT, pallet_surfaces
from studio.attic.clutter import clutter, lamps
from studio.attic.mouse_parlour import candles, mouse_parlour
from studio.detail import Detail
from studio.light_sources import LightSources
from studio.lit_room import Room, lit_room, room_asset
from studio.shapes import Surface
from studio.surface_sampling import Viewer

VIEWER = Viewer(
    (0.1, 1.35, 1.45), ((-0.9, 0.9, 1.1), (0.9, 0.9, 1.1), (-0.7, 1.6, 2.1), (0.7, 1.6, 2.1), (0.0, 0.5, 0.4))
)
EXPOSURE = 1.7  # an attic is dim


def all_surfaces() -> list[Surface]:
    """All that is seen of the attic."""
    return [*attic_shell(), *clutter(), *mouse_parlour()]


def attic(rng: np.random.Generator, detail: Detail, report) -> Asset:
    """The asset `attic`."""
    sources = LightSources(openings(), [*lamps(), *candles()], SUN)
    pallet = [s.placed(None, PALLET_AT) for s in pallet_surfaces()]  # it shades the floor
    room = Room(all_surfaces(), sources, VIEWER, pallet, exposure=EXPOSURE)
    return room_asset("attic", lit_room(room, rng, detail, report), rng, report)
