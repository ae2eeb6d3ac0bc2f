"""The shipped study and attic: their measures, what is solid in them, room for the play, and what the boxes hide."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assets.asset import Asset
from assets.library import SHIPPED_FOLDER
from scenes import box_moving, table_brick_game
from studio.attic import mouse_parlour
from studio.catalogue import BOXES, BRICKS
from studio.study import study_shell, writing_table

LIMITS = {  # [bytes] of all files of a demo together
    ("study", "rubber_ball", "jelly_bear", *BRICKS): 2.8e6,
    ("attic", "pallet", *BOXES): 2.8e6,
}


@pytest.fixture(scope="module")
def rooms() -> dict[str, Asset]:
    return {name: Asset.load(SHIPPED_FOLDER / f"{name}.h5") for name in ("study", "attic")}


def within(points, low, high) -> np.ndarray:
    """Mask (N,) of points in a box."""
    return ((points > np.asarray(low)) & (points < np.asarray(high))).all(1)


@pytest.mark.parametrize("names", LIMITS, ids=lambda names: names[0])
def test_a_demos_files_stay_small(names):
    assert sum(Path(SHIPPED_FOLDER / f"{name}.h5").stat().st_size for name in names) < LIMITS[names]


@pytest.mark.parametrize("name", ["study", "attic"])
def test_a_room_is_opaque_and_of_a_playable_size(name, rooms):
    g = rooms[name].gaussians
    assert 60_000 <= len(g) <= 125_000 and g.sh_degree == 0 and (g.opacities > 0.9).all()
    colours = 0.5 + 0.2820948 * g.sh[:, 0]
    assert 0.05 < np.median(colours) < 0.8 and (colours.max(1) < 0.02).mean() < 0.12  # under and behind things


def test_the_study_has_the_measures_of_its_scene(rooms):
    room = rooms["study"]
    x = room.gaussians.means
    inside = within(x, np.array(table_brick_game.ROOM_LOW) - 0.01, np.array(table_brick_game.ROOM_HIGH) + 0.01)
    assert inside.mean() > 0.9  # the rest is the window and the trees
    top = x[(room.gaussians.object_id == 1) & (np.abs(x[:, 1] - table_brick_game.TABLE_TOP) < 2e-3)]
    assert len(top) > 3_000
    assert_allclose(np.abs(top[:, [0, 2]]).max(0), table_brick_game.TABLE_HALF, atol=0.01)


def test_neither_wall_nor_rail_crosses_the_door(rooms):
    """Both end at the casing: Gaussians just behind the leaf would show between those of the leaf."""
    (x0, x1, y0, y1), z = study_shell.DOOR, study_shell.Z1
    x = rooms["study"].gaussians.means
    assert within(x, (x0, y0, z - 0.03), (x1, y1, z - 0.02)).sum() > 500  # the leaf
    assert not within(x, (x0 + 0.02, y0 + 0.02, z - 0.006), (x1 - 0.02, y1 - 0.02, z + 0.01)).any()
    rail = within(x, (x0 + 0.02, study_shell.DADO - 0.03, z - 0.1), (x1 - 0.02, study_shell.DADO + 0.015, z - 0.023))
    assert x[rail, 0].max(initial=x0) < x0 + 0.08  # the knob


def test_the_tower_and_the_ball_have_room_on_the_table(rooms):
    """Nothing static stands where bricks, bear and ball start, nor does its distance grid reach there."""
    room, x = rooms["study"], rooms["study"].gaussians.means
    for body in (*table_brick_game.tower(), *table_brick_game.toys()):
        at = np.array(body.position)
        half = np.array([0.08, 0.014, 0.08]) if body.asset.startswith("brick") else np.array([0.03, 0.02, 0.03])
        assert not within(x, at - half, at + half).any(), body.asset
        assert room.sdf.sample(at[None])[0] > 0.03
    things = np.array([writing_table.LAMP_AT, writing_table.BOOKS_AT]) + [[0.0, 0.01, 0.0], [0.0, 0.05, 0.0]]
    assert (room.sdf.sample(things) < 0).all()


def test_a_mouse_lives_behind_the_boxes(rooms):
    """Behind the far wall there is a furnished parlour; its door is open to the room, and the boxes' place is free."""
    x = rooms["attic"].gaussians.means
    low, high = (mouse_parlour.X0 - 0.01, -0.01, mouse_parlour.BACK - 0.01), (mouse_parlour.X1 + 0.01, 0.31, -1.105)
    assert within(x, low, high).sum() > 5_000
    x0, x1, top = box_moving.HOLE
    assert not within(x, (x0 + 0.03, 0.01, box_moving.FAR - 0.02), (x1 - 0.03, 0.6 * top, box_moving.FAR + 0.3)).any()
    for body in box_moving.boxes():
        half = 0.5 * np.array(box_moving.SIZES[body.asset])
        assert not within(x, body.position - half + 0.005, body.position + half - 0.005).any(), body.asset


def test_the_attic_has_the_measures_of_its_scene(rooms):
    x = rooms["attic"].gaussians.means
    inside = x[(x[:, 2] > box_moving.FAR - 0.01) & (x[:, 2] < box_moving.NEAR + 0.01)]
    parlour = within(x, (-0.25, -0.05, -1.35), (0.25, 0.35, box_moving.FAR))
    assert len(inside) > 0.9 * (~parlour).sum()  # the rest is the window and the sky
    slope = box_moving.RIDGE - (box_moving.RIDGE - box_moving.KNEE[1]) * np.abs(inside[:, 0]) / box_moving.KNEE[0]
    assert (inside[:, 1] > slope + 0.05).sum() < 60  # a cord, a ridge beam; what stood out would be sunlit
    assert (np.abs(inside[:, 0]) < box_moving.KNEE[0] + 0.01).all() and inside[:, 1].min() > -0.02
