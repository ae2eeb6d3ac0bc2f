"""The stage and the dancer: sizes that scenes repeat, a dance without slips, garments that hang on their joints."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assets.animation import world_matrices
from assets.asset import Asset
from core.tetmesh import vertex_components
from prepare.rig.retargeting import BONES
from scenes import just_dance
from studio.dancer.choreography import ARMS, dance_rig
from studio.dancer.garments import ponytail, skirt
from studio.dancer.skeleton import HEIGHT, joint_positions
from studio.stage import hall_walls, house, prop_tables, stage_lights
from studio.swept_cages import rod_cage, sheet_cage

SHIPPED = Path(__file__).resolve().parents[2] / "assets" / "data"


def test_the_scene_repeats_the_stage():
    edges = house.STAGE_TOP, house.STAGE_FRONT, house.STAGE_BACK, house.STAGE_HALF_WIDTH
    assert edges == (just_dance.STAGE_TOP, just_dance.STAGE_FRONT, just_dance.STAGE_BACK, just_dance.STAGE_HALF_WIDTH)
    assert just_dance.OPENING_HALF_WIDTH == house.OPENING_HALF_WIDTH
    assert (hall_walls.HALL_HIGH[0], hall_walls.HALL_HIGH[2]) == (just_dance.HALL_HALF_WIDTH, just_dance.HALL_BACK)
    x, z = prop_tables.TABLE_X, prop_tables.TABLE_Z
    assert ((-x, prop_tables.TABLE_TOP, z), (x, prop_tables.TABLE_TOP, z)) == just_dance.TABLES
    assert just_dance.TABLE_HALF == prop_tables.TABLE_HALF
    shells = next(c for c in just_dance.room_colliders() if hasattr(c, "half_size") and c.half_size[2] < 0.05)
    assert abs(shells.center[2] - stage_lights.FOOTLIGHT_Z) < 0.03
    assert shells.half_size[0] > stage_lights.FOOTLIGHT_X[-1]
    top = shells.center[1] + shells.half_size[1] - house.STAGE_TOP
    assert_allclose(top, 1.15 * stage_lights.SHELL_RADIUS, atol=0.005)


def test_the_shipped_stage_is_a_place():
    g = Asset.load(SHIPPED / "stage.h5").gaussians
    low, high = np.array([-2.95, -0.05, house.STAGE_BACK - 0.05]), np.array([2.95, 3.75, 5.25])
    assert 100_000 <= len(g) <= 180_000 and ((g.means > low) & (g.means < high)).all()
    boards = (np.abs(g.means[:, 1] - house.STAGE_TOP) < 0.01) & (np.abs(g.means[:, 0]) < 1.2) & (g.means[:, 2] < 0.5)
    brightness = 0.5 + 0.28 * g.sh[:, 0].mean(1)
    pool = boards & (np.hypot(g.means[:, 0], g.means[:, 2]) < 0.6)
    wings = np.abs(g.means[:, 0]) > 1.9
    assert brightness[pool].mean() > 2 * brightness[wings].mean()  # the dancer stands in the light


def test_the_door_of_the_hall_is_modelled_and_not_painted():
    """Its leaves are set into the wall, and its panels into them; there is no wall behind."""
    (x0, x1, _, y1), z = hall_walls.DOOR, hall_walls.HALL_HIGH[2]
    x = Asset.load(SHIPPED / "stage.h5").gaussians.means
    low, high = np.array([x0 + 0.02, 0.02, z - 0.06]), np.array([x1 - 0.02, y1 - 0.02, z + 0.1])
    depth = z - x[((x > low) & (x < high)).all(1), 2]
    assert ((depth > 0.015) & (depth < 0.025)).sum() > 300 and ((depth > 0.004) & (depth < 0.008)).sum() > 300
    assert (depth < 0.004).mean() < 0.06


def test_standing_feet_do_not_slip():
    """While a foot is down in the side steps and the curtsy, it stays where it is, and legs keep their lengths."""
    at = joint_positions()
    rig = dance_rig(at)
    world = world_matrices(rig.parents, rig.frames)[:, :, :3, 3]
    index = {name: k for k, name in enumerate(BONES)}
    for s in ("left", "right"):
        for a, b in (("hip", "knee"), ("knee", "ankle")):
            length = np.linalg.norm(world[:, index[f"{s}_{a}"]] - world[:, index[f"{s}_{b}"]], axis=1)
            assert_allclose(length, np.linalg.norm(at[f"{s}_{a}"] - at[f"{s}_{b}"]), rtol=1e-6)
    left = world[:, index["left_ankle"]]
    rest = left[180:196]  # the curtsy, beats 12 to 13
    assert np.ptp(rest, axis=0).max() < 0.004 * HEIGHT
    assert np.abs(world[0] - world[-1]).max() < 1e-6  # it returns
    pelvis = rig.frames[1][:, 0]
    assert np.abs((pelvis[0] * pelvis[-1]).sum()) > 1 - 1e-6 and np.abs(pelvis[0] @ pelvis[85]) < 0.4  # having turned


@pytest.mark.parametrize("garment", [skirt(384), skirt(2000), ponytail(63), ponytail(600)])
def test_a_garment_hangs_on_one_end(garment):
    cage, driven = garment.cage, garment.driven
    cage.check("garment")
    assert len(driven) == len(cage.vertices) and 0.05 < driven.mean() < 0.5
    assert cage.vertices[driven, 1].mean() > cage.vertices[~driven, 1].max() - 0.1
    assert vertex_components(cage.tets).max() == 0
    inside = garment.solid(cage.vertices[cage.tets].mean(1).astype(np.float64)) < 0
    assert inside.mean() > 0.9


def test_swept_cages_fill_their_volume():
    a = 2 * np.pi * np.arange(64) / 64
    ring = np.stack([np.cos(a), 0 * a, np.sin(a)], 1)
    up = np.linspace(0, 1, 5)[:, None] * [0.0, 1.0, 0.0]
    rod = rod_cage(0.2 * ring[None] + up[:, None], up)
    rod.check("rod")
    assert_allclose(rod.volumes().sum(), np.pi * 0.2**2, rtol=0.01)
    inner, outer = (r * ring[:, None] + up[None] for r in (0.4, 0.5))
    sheet = sheet_cage(inner, outer)
    sheet.check("sheet")
    assert_allclose(sheet.volumes().sum(), np.pi * (0.5**2 - 0.4**2), rtol=0.01)


def test_the_shipped_dancer_stands_on_her_soles_and_her_legs_are_alike():
    asset = Asset.load(SHIPPED / "dancer.h5")
    assert abs(asset.gaussians.means[:, 1].min()) < 0.004 and abs(asset.cage.vertices[:, 1].min()) < 0.004
    motion = asset.animation
    for joint in ("knee", "ankle"):
        below = np.isin(motion.joints[:, 0], [motion.names.index(f"{side}_{joint}") for side in ("left", "right")])
        assert below.sum() > 20 and motion.driven[below].all()


def test_the_dancers_arms_bend_at_the_elbow():
    """By more than 50 degrees where they are lifted."""
    bends = [np.degrees(np.arccos(np.dot(*(np.array(d) / np.linalg.norm(d) for d in ARMS[k])))) for k in ("side", "up")]
    assert min(bends) > 50


def test_the_shipped_dancer_wears_a_skirt_and_a_ponytail():
    asset = Asset.load(SHIPPED / "dancer.h5")
    assert vertex_components(asset.cage.tets).max() == 2
    assert_allclose(np.ptp(asset.gaussians.means[:, 1]), HEIGHT, rtol=0.06)
    driven = np.zeros(len(asset.cage.vertices), bool)
    driven[asset.animation.vertices[asset.animation.driven]] = True
    for k in (1, 2):
        mine = np.unique(asset.cage.tets[vertex_components(asset.cage.tets) == k])
        assert 0.05 < driven[mine].mean() < 0.5
