"""A small room with a floor and a table, as `prepare --static` would make it, in a frame that leans."""

from dataclasses import replace

import numpy as np

from assets.asset import Asset
from assets.environment import Environment
from core.distance_grid import DistanceGrid
from tests.support.samples import discs

FLAT = np.exp([-3.0, -7.0, -3.0])  # [m] standard deviations of level discs


def leaning_room(lean: np.ndarray) -> Asset:
    """A floor of 4 x 4 m with a table, 0.7 m high, as `prepare --static` would have made it of a leaning frame."""
    rng = np.random.default_rng(1)
    floor = rng.uniform([-2, -0.01, -2], [2, 0.01, 2], (4000, 3))
    top = rng.uniform([0.0, 0.69, 0.0], [1.0, 0.71, 0.6], (1000, 3))
    g = discs(np.concatenate([floor, top]), FLAT)
    y = np.linspace(-0.5, 2.5, 31)
    over = np.broadcast_to(y[None, :, None], (31, 31, 31)).astype(np.float32)
    grid = DistanceGrid(over, np.array([-1.5, -0.5, -1.5]), 0.1)
    planes = (("floor", 0.0, -2.0, -2.0, 2.0, 2.0), ("table", 0.7, 0.0, 0.0, 1.0, 0.6))
    level = Asset(g, sdf=grid, environment=Environment(0.0, (-0.5, 0.0, 0.2), (-0.5, 1.6, 1.2), 0.4, planes))
    turned = level.environment.transformed(lean, np.zeros(3))
    return replace(level, gaussians=g.transformed(lean), sdf=grid.transformed(lean), environment=turned)
