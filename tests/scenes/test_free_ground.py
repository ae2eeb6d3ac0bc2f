"""Plays laid out on what a rough room leaves free: stations apart, level, in view; the script reaches its goal."""

import re
from itertools import combinations

import numpy as np
import pytest

from assets.asset import Asset
from assets.environment import Environment
from assets.gaussians import Gaussians
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.rotation import matrices_from_quaternions
from core.vocabulary import Box
from scenes import registry
from scenes.attic_floor import PALLET, STATIONS
from scenes.free_ground import CELL, SIZES, ground_of
from tests.support.scripted_play import play

SPACING = 0.05  # [m]
EYE = (0.0, 1.5, 1.9)
CLEARINGS = (((-0.5, 0.2), 0.45, 0.0), ((0.6, -0.3), 0.35, 0.12))  # x, z; radius; height [m]


def ground_height(x, z, clearings=CLEARINGS):
    """Rough ground of the height field, but for level clearings."""
    height = 0.08 + 0.08 * np.sin(15 * x) * np.sin(15 * z)
    for (at_x, at_z), radius, level in clearings:
        height = np.where(np.hypot(x - at_x, z - at_z) < radius, level, height)
    return height


def rough_room(folder, clearings=CLEARINGS, name="rough.h5") -> str:
    """A room of 4 m, open above, with a post at x = 1.5, z = 1.5."""
    x, y, z = np.meshgrid(*(np.arange(a, b, SPACING) for a, b in ((-2, 2), (-0.3, 2.2), (-2, 2))), indexing="ij")
    values = np.minimum(0.7 * (y - ground_height(x, z, clearings)), np.hypot(x - 1.5, z - 1.5) - 0.1)
    g = Gaussians.of(np.zeros((1, 3)), [[1, 0, 0, 0]], [[0, 0, 0]], [0], np.zeros((1, 1, 3)))
    grid = DistanceGrid(values.astype(np.float16), np.array([-2, -0.3, -2]), SPACING)
    stage = Environment(0.0, (0.0, 0.0, 0.0), EYE, 0.1, (("floor", 0.0, -2, -2, 2, 2),))
    Asset(g, sdf=grid, environment=stage).save(folder / name)
    return str(folder / name)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("rooms")


@pytest.fixture(scope="module")
def stage(folder):
    return rough_room(folder)


def test_the_ground_is_what_is_seen_from_above_and_a_post_is_none(stage):
    ground = ground_of(Asset.load(stage).grids, 0.0)
    x, z = (ground.corner[k] + CELL * (np.arange(ground.height.shape[k]) + 0.5) for k in (0, 1))
    level = np.hypot(x[:, None] + 0.5, z + 0.2 - 0.4) < 0.3
    np.testing.assert_allclose(ground.height[level], 0.0, atol=0.01)
    assert np.isnan(ground.height[tuple(ground.cells(np.array([1.5, 1.5])))])
    assert np.isnan(ground.highest_between((1.2, 1.5), (1.8, 1.5))) and ground.highest_between((-1, 0), (1, 0)) > 0.1


@pytest.mark.parametrize("name", ["box_moving", "animal_crossing"])
def test_each_station_has_level_free_ground_in_view(name, stage):
    own, scene = registry.load(name), registry.load(name, stage=stage)
    around, *bodies = scene.bodies
    size = bodies[0].scale / own.bodies[1].scale
    assert np.abs(np.subtract(SIZES, size)).min() < 1e-9
    assert size < 1 and f"{100 * size:.0f} % as large" in scene.cast[-1][1]
    turn, shift = matrices_from_quaternions(np.array(around.rotation)), np.array(around.position)
    pads = [c for c in scene.colliders if isinstance(c, Box)]
    if name == "box_moving":
        assert pads[0].half_size == pytest.approx([size * w / 2 for w in PALLET[1]])
        assert scene.game.pallet == pytest.approx(pads[0].center - np.array([0, pads[0].half_size[1], 0]))
        radii = [size * r for *_, r in STATIONS]
    else:
        radii = [size * r for *_, r in own.room.stations]
        rings, homes = [b for b in bodies if b.asset.startswith("flower_ring")], list(scene.game.places.values())
        np.testing.assert_allclose([b.position for b in rings], homes, atol=1e-6)
    assert len(pads) == len(radii)
    centres = [np.array(pad.center) for pad in pads]
    for (a, r), (b, s) in combinations(zip(centres, radii, strict=True), 2):
        assert np.hypot(*(a - b)[[0, 2]]) > r + s - CELL
    angles = np.linspace(0, 2 * np.pi, 16)
    for at, r in zip(centres, radii, strict=True):
        x, _, z = (at - shift) @ turn
        heights = ground_height(x + (r - CELL) * np.cos(angles), z + (r - CELL) * np.sin(angles))
        assert np.ptp(heights) < 0.06, "level"
        ahead, to = np.subtract(scene.target, scene.eye), at - scene.eye
        assert ahead @ to > np.cos(0.5 * scene.fov_y) * np.linalg.norm(ahead) * np.linalg.norm(to), "in view"
    for body in bodies:
        x, y, z = (np.array(body.position) - shift) @ turn
        assert y >= ground_height(x, z) - 0.02


@pytest.mark.long
@pytest.mark.parametrize("name", ["box_moving", "animal_crossing"])
def test_the_script_reaches_its_goal_on_rough_ground(name, stage, ti_cpu):
    """Nothing but the pads and the pallet bears what stands there: bumps are in the way of nothing."""
    scene = registry.load(name, stage=stage)
    scene.game.verify(play(scene).bodies())


def test_a_room_without_free_ground_is_told_in_one_line(folder):
    stage = rough_room(folder, (), "wild.h5")
    with pytest.raises(BadInput, match=re.escape(f"{stage}: there is no room for this play: it needs 3 places")) as e:
        registry.load("box_moving", stage=stage)
    assert "\n" not in str(e.value)
