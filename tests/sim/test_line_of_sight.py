"""Sight hidden by static shapes, and the ground below a point, against shapes of which one knows it."""

import numpy as np
import pytest

from core.distance_grid import DistanceGrid
from core.vocabulary import Box, Capsule, Plane
from sim.contact.static_shapes import LineOfSight, StaticGrid

TABLE = Box((0.0, 0.73, 0.0), (0.8, 0.015, 0.5))  # a top of 3 cm
FLOOR = Plane((0.0, 0.0, 0.0), (0.0, 1.0, 0.0))
TOY = np.array([0.1, 0.76, 0.0])


def table_grid(spacing: float = 0.02) -> StaticGrid:
    """The same table as a distance grid, in a frame that is turned by a quarter, moved and half as large."""
    origin = np.array([-1.2, -0.4, -2.0])
    grid = DistanceGrid(np.zeros((60, 40, 100)), origin, 2 * spacing)
    x = grid.nodes() @ np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]).T / 2 + (0.0, 0.73, 0.0)
    beyond = np.abs(x - TABLE.center) - TABLE.half_size
    values = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1) + np.minimum(beyond.max(-1), 0.0)
    quarter = (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)
    return StaticGrid(
        DistanceGrid((2 * values).astype(np.float16), origin, 2 * spacing), quarter, (0.0, 0.73, 0.0), 0.5
    )


def hides(sight: LineOfSight, eye) -> bool:
    return sight.hides(eye, TOY - eye, np.linalg.norm(TOY - eye))


@pytest.mark.parametrize("table", [TABLE, table_grid()], ids=["box", "grid"])
def test_a_table_hides_what_stands_on_it_from_below_and_not_from_above(table):
    sight = LineOfSight([FLOOR, table])
    for eye in ([0.0, 1.5, 1.0], [1.5, 0.77, 0.3], [-1.0, 1.0, -1.0]):
        assert not hides(sight, np.array(eye))
    for eye in ([0.0, 0.2, 0.4], [0.3, 0.5, -0.2]):
        assert hides(sight, np.array(eye))
    eye = np.array([0.0, 0.2, 0.4])
    assert not sight.hides(eye, TOY - eye, 0.3)  # before the table


def test_what_the_eye_is_in_hides_nothing():
    sight = LineOfSight([Box((0.0, 1.0, 1.0), (0.2, 0.2, 0.2))])
    assert not hides(sight, np.array([0.0, 1.0, 1.0]))
    assert hides(sight, np.array([0.0, 1.2, 1.8]))


def test_a_capsule_hides_what_is_behind_it():
    sight = LineOfSight([Capsule((0.1, 0.7, 0.3), (0.1, 1.0, 0.3), 0.04)])
    assert hides(sight, np.array([0.1, 0.8, 1.0])) and not hides(sight, np.array([0.6, 0.8, 1.0]))


@pytest.mark.parametrize("table", [TABLE, table_grid()], ids=["box", "grid"])
def test_the_ground_is_the_table_or_the_floor_and_not_what_stands_there(table):
    bottle = Capsule((0.0, 0.7, 0.0), (0.0, 1.0, 0.0), 0.04)
    sight = LineOfSight([FLOOR, table, bottle])
    assert sight.ground((0.0, 0.9, 0.0)) == pytest.approx(0.745, abs=0.02)
    assert sight.ground((2.0, 0.9, 0.0)) == pytest.approx(0.0, abs=0.02)
    assert LineOfSight([]).ground((0.0, 1.0, 0.0)) is None
    assert LineOfSight([FLOOR]).ground((0.0, 9.0, 0.0)) is None
