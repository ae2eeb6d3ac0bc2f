"""Assembly of the study: its surfaces, its light and where the player stands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from assets.asset import Asset
from studio.detail import Detail
from studio.light_sources import LightSources
from studio.lit_room import Room, lit_room, room_asset
from studio.shapes import Surface
from studio.study.bookcases import bookcases
from studio.study.study_decor import decor_lamps, study_decor
from studio.study.study_shell import SUN, openings, study_shell
from studio.study.writing_table import lamps, table_solids, writing_table
from studio.surface_sampling import Viewer

VIEWER = Viewer(
    (0.0, 1.45, 1.15), ((-1.1, 1.1, 0.9), (1.1, 1.1, 0.9), (-1.1, 1.9, 1.8), (1.1, 1.9, 1.8), (0.0, 1.5, 0.5))
)
SPACING = 1.3  # factor on all spacings: leaves about a hundred thousand Gaussians that can be seen
GRID = ((-0.80, 0.66, -0.45), (0.80, 1.24, 0.45), 0.012)  # [m] bounds and spacing of the signed distance grid


def all_surfaces() -> list[Surface]:
    """All that is seen of the study."""
    surfaces = [*study_shell(), *bookcases(), *writing_table(), *study_decor()]
    return [replace(s, spacing=SPACING * s.spacing) for s in surfaces]


def study(rng: np.random.Generator, detail: Detail, report) -> Asset:
    """The asset `study`."""
    sources = LightSources(openings(), [*lamps(), *decor_lamps()], SUN)
    room = Room(all_surfaces(), sources, VIEWER, solids=table_solids(), grid=GRID, exposure=1.8)
    return room_asset("study", lit_room(room, rng, detail, report), rng, report)
