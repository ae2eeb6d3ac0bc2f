"""The ground of a room where it is level and free, and a play's stations laid out on it, in view of the player.

A play whose own layout finds no room is taken apart into its stations: discs of ground, each with what stands there.
They are put on free ground one by one, all of them smaller where they must be.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from core.distance_grid import DistanceGrid
from scenes.scene import Spot

CELL = 0.05  # [m] of the map
LOOKED_FROM = 1.5  # [m] over the floor: what is above does not hide the ground
STEP = 0.5  # of the finest grid's spacing, in which heights are looked for
UNEVEN = 0.15  # of a station's radius, by which its ground may rise and fall
LEAST_UNEVEN = 0.025  # [m], below which the ground of a capture is noise
SIZES = 1.0, 0.85, 0.7, 0.6, 0.5, 0.42, 0.35, 0.3, 0.25, 0.2  # of a play; smaller things are not seen from the eye
SIGHT_STEP = 0.03  # [m] along a line of sight
CLEAR_OF_GROUND = 0.02  # [m] over the ground where a station must be seen


@dataclass(frozen=True)
class Ground:
    """Height (X, Z) [m] of the ground in cells of CELL from `corner` (x, z) [m]; NaN where there is none."""

    height: np.ndarray
    corner: np.ndarray
    _level: dict[int, np.ndarray] = field(default_factory=dict)  # by radius [cells]

    def cells(self, points: np.ndarray) -> np.ndarray:
        """Index (..., 2) of the cell of each point (..., 2) (x, z) [m]."""
        return np.floor((points - self.corner) / CELL).astype(int).clip(0, np.array(self.height.shape) - 1)

    def disc(self, at: np.ndarray, radius: float) -> np.ndarray:
        """Heights [m] of the cells of a disc around (x, z)."""
        i, k = self.cells(np.asarray(at))
        n = round(radius / CELL)
        around = disc_of(n)
        padded = np.pad(self.height, n, constant_values=np.nan)
        return padded[i : i + 2 * n + 1, k : k + 2 * n + 1][around]

    def level(self, radius: float) -> np.ndarray:
        """Mask (X, Z) of the cells around which a disc of this radius [m] is level."""
        n = round(radius / CELL)
        if n not in self._level:
            ends = []
            for find, none in ((maximum_filter, 1e9), (minimum_filter, -1e9)):
                filled = np.where(np.isnan(self.height), none, self.height)
                ends.append(find(filled, footprint=disc_of(n), mode="constant", cval=none))
            self._level[n] = ends[0] - ends[1] < max(UNEVEN * radius, LEAST_UNEVEN)
        return self._level[n].copy()

    def highest_between(self, a: np.ndarray, b: np.ndarray) -> float:
        """Highest ground [m] on the straight way between two points (x, z); NaN if there is none somewhere."""
        count = max(2, int(np.linalg.norm(np.subtract(b, a)) / (0.5 * CELL)))
        way = np.asarray(a) + np.linspace(0.0, 1.0, count)[:, None] * np.subtract(b, a)
        return float(self.height[tuple(self.cells(way).T)].max())


def disc_of(n: int) -> np.ndarray:
    """Mask (2n + 1, 2n + 1) of the cells within n cells of the middle one."""
    x, z = np.ogrid[-n : n + 1, -n : n + 1]
    return x * x + z * z <= n * n


def solid_distance(grids: Sequence[DistanceGrid], points: np.ndarray) -> np.ndarray:
    """Distance [m] from what is solid in any of a room's grids, at points (..., 3).

    The first holds all of the room, the finer ones what that leaves to them.
    """
    distance = grids[0].sample_extended(points)
    for grid in grids[1:]:
        within = ((points > grid.origin) & (points < grid.upper)).all(axis=-1)
        distance[within] = np.minimum(distance[within], grid.sample(points[within]))
    return distance


def ground_of(grids: Sequence[DistanceGrid], floor: float) -> Ground:
    """The ground of a room: what is solid and seen from above, below LOOKED_FROM over its floor [m]."""
    low, high = np.asarray(grids[0].origin, np.float64), grids[0].upper
    x, z = (np.arange(low[k] + 0.5 * CELL, high[k], CELL) for k in (0, 2))
    height, seen = np.full((len(x), len(z)), np.nan), np.zeros((len(x), len(z)), bool)
    step = STEP * min(grid.spacing for grid in grids)
    above, y = None, min(floor + LOOKED_FROM, float(high[1]))
    while y > low[1]:
        here = solid_distance(grids, np.stack(np.broadcast_arrays(x[:, None], y, z), axis=-1))
        first = (here < 0) & ~seen
        if above is not None:  # else it is in the way
            height[first] = y + step * (-here / np.maximum(above - here, 1e-9))[first]
        seen |= first
        above, y = here, y - step
    return Ground(height, low[[0, 2]])


def laid_out(
    ground: Ground, radii: Sequence[float], focus: np.ndarray, sees: Callable[[np.ndarray], bool]
) -> tuple[list[Spot], float] | None:
    """A spot for each station of a play, and the size of the play, the largest that there is room for; None if none is.

    radii  of the stations at full size [m]
    focus  point (x, z) [m] near which they shall be
    sees   tells if the player sees a point (3,)
    """
    x, z = (ground.corner[k] + CELL * (np.arange(ground.height.shape[k]) + 0.5) for k in (0, 1))
    at = np.stack(np.meshgrid(x, z, indexing="ij"), axis=-1)
    away = np.linalg.norm(at - focus, axis=-1)
    known: dict[tuple[int, int], bool] = {}

    def seen(i: int, k: int) -> bool:
        if (i, k) not in known:
            known[i, k] = sees(np.array([x[i], ground.height[i, k] + CLEAR_OF_GROUND, z[k]]))
        return known[i, k]

    for size in SIZES:
        spots: dict[int, Spot] = {}
        for station in sorted(range(len(radii)), key=lambda k: -radii[k]):
            radius = size * radii[station]
            free = ground.level(radius)
            for other, spot in spots.items():
                free &= np.linalg.norm(at - spot.at, axis=-1) > radius + size * radii[other]
            first = next(iter(spots.values()), None)
            found = np.argwhere(free)
            for i, k in found[np.argsort(away[free])]:
                over = ground.height[i, k] if first is None else ground.highest_between(first.at, at[i, k])
                if np.isfinite(over) and seen(i, k):
                    heights = ground.disc(at[i, k], radius)
                    spots[station] = Spot(tuple(at[i, k]), float(np.median(heights)), float(heights.max()), float(over))
                    break
            else:
                break
        if len(spots) == len(radii):
            return [spots[k] for k in range(len(radii))], size
    return None


def line_of_sight(grids: Sequence[DistanceGrid], eye: np.ndarray, point: np.ndarray) -> bool:
    """True if nothing solid lies between two points (3,) [m]."""
    count = max(2, int(np.linalg.norm(point - eye) / SIGHT_STEP))
    way = eye + np.linspace(0.0, 1.0, count)[:, None] * (point - eye)
    return bool((solid_distance(grids, way) > 0.0).all())
