"""Acts of `bench scene`: bodies dropped, thrown, squeezed by two hands, and piled on one another in a scanned room.

An act is played from its beginning, `frames` long, and then again: something moves in all of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bench.measured_bodies import brick
from core.distance_grid import DistanceGrid
from core.material import Material
from core.vocabulary import Hand, Plane
from sim.bodies import SoftBody
from sim.contact.contact_samples import points_of, spacing_for
from sim.contact.static_shapes import Shape, StaticGrid
from sim.model import BodyModel, RestShape

WALL, STEP_HEIGHT = 0.6, 0.03  # [m] x of the wall, and height of the step in the floor, at x < 0
SPACING, ROOM = 0.02, ((-1.2, -0.2, -1.0), (0.8, 1.6, 1.0))  # [m] of the room's distance grid, and its corners
THROW_SPEED = 10.0  # [m/s]
DROP_HEIGHT = 0.5  # [m] that a dropped body falls
CLEARANCE = 0.02  # [m] to floor, wall and each other at the beginning
PRESS, STRETCH, LIFT = 0.6, 1.3, 0.15  # length under the hands, of that at first; [m] that they raise the body
REACH = 0.04  # [m] of a hand
LAYER = (2, 2)  # bodies side by side in a layer of the pile


def room() -> list[Shape]:
    """Floor with a step, and a wall, as a distance grid; the floor goes on beyond it, as in a scanned room."""
    low, high = np.array(ROOM)
    nodes = np.round((high - low) / SPACING).astype(int) + 1
    p = low + SPACING * np.moveaxis(np.indices(nodes), 0, -1)
    step = brick(p, (-1.0, STEP_HEIGHT / 2, 0.0), (1.0, STEP_HEIGHT / 2, 10.0))
    values = np.minimum(np.minimum(p[..., 1], WALL - p[..., 0]), step)
    grid = DistanceGrid(values.astype(np.float32), low, SPACING)
    return [StaticGrid(grid), Plane((0.0, 0.0, 0.0), (0.0, 1.0, 0.0))]


@dataclass(frozen=True)
class Act:
    """Placement of bodies that are `extent` (3,) [m] large, centred above the origin, lowest point at y = 0.

    frames    after which it begins anew
    positions (B, 3) of the bodies [m], given their extent and number
    velocity  [m/s] of all of them
    hands     of a frame, given the ends of the (one) body along x at the beginning, (2, 3) [m]
    """

    frames: int
    positions: Callable[[np.ndarray, int], np.ndarray]
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    hands: Callable[[int, np.ndarray], list[Hand]] = lambda frame, ends: []


def dropped(extent: np.ndarray, count: int) -> np.ndarray:
    """Above the edge of the step."""
    return np.array([[0.0, STEP_HEIGHT + DROP_HEIGHT, 0.0]])


def thrown(extent: np.ndarray, count: int) -> np.ndarray:
    """Close to the wall, above the floor."""
    return np.array([[WALL - extent[0] / 2 - 10 * CLEARANCE, 0.3, 0.0]])


def lying(extent: np.ndarray, count: int) -> np.ndarray:
    """On the step."""
    return np.array([[-0.6, STEP_HEIGHT + CLEARANCE, 0.0]])


def piled(extent: np.ndarray, count: int) -> np.ndarray:
    """Two on one another, or more of them in layers; all a little askew, so that they do not balance."""
    nx, nz = LAYER if count > 2 else (1, 1)
    k = np.arange(count)
    cell = np.stack([k % nx - (nx - 1) / 2, k // (nx * nz), k // nx % nz - (nz - 1) / 2], 1)
    layer = cell[:, 1:2]
    askew = 0.15 * extent * np.concatenate([np.sin(2.4 * layer), 0 * layer, np.cos(2.4 * layer)], 1)
    return cell * (extent + CLEARANCE) + askew + [0.0, STEP_HEIGHT + CLEARANCE, 0.0]


def squeezing(frame: int, ends: np.ndarray) -> list[Hand]:
    """Two hands that grip the ends, lift and press, pull apart, press again, and let go."""
    times, lengths = (5, 40, 75, 100), (1.0, PRESS, STRETCH, PRESS)
    length, up = np.interp(frame, times, lengths), np.interp(frame, times[:2], (0.0, LIFT))
    middle = ends.mean(0)
    places = middle + length * (ends - middle) + [0.0, up, 0.0]
    return [Hand(tuple(p.tolist()), grip=1 <= frame < times[-1], reach=REACH) for p in places]


ACTS = {
    "drop": Act(75, dropped),
    "throw": Act(45, thrown, velocity=(THROW_SPEED, 0.0, 0.0)),
    "squeeze": Act(120, lying, hands=squeezing),
    "stack": Act(90, piled),
}


class Cast:
    """Bodies of one shape and material, and their motions at the beginning of each act.

    models  of `count` bodies for a solver
    """

    def __init__(self, name: str, shape: RestShape, material: Material, count: int):
        self.shape, self.count = shape, count
        body = SoftBody(name, shape.vertices, shape.solid, shape.surface, material, sdf=shape.sdf)
        body.check()
        self.models = [BodyModel(replace(body, name=f"{name} {k}"), shape) for k in range(count)]

    def start(self, act: Act) -> dict[str, np.ndarray]:
        """Motion at the beginning of an act, for `Solver.restore`."""
        x = self.shape.vertices
        low, high = x.min(0), x.max(0)
        x = x - [(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2]
        positions = np.concatenate([x + p for p in act.positions(high - low, self.count)])
        return {"x": positions, "v": np.tile(np.array(act.velocity), (len(positions), 1))}

    def ends(self, act: Act) -> np.ndarray:
        """The surface's ends along x at the beginning of an act, (2, 3) [m]."""
        x = self.start(act)["x"][np.unique(self.shape.surface)]
        return x[[np.argmin(x[:, 0]), np.argmax(x[:, 0])]]

    @property
    def samples(self) -> int:
        """Number of contact samples of all bodies in the room."""
        return self.count * len(self.shape.once(points_of, spacing_for(room())).ids)
