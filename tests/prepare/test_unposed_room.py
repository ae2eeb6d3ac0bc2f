"""Splats without their photographs: likely cameras, and a room to play in where no floor is seen."""

from dataclasses import replace

import numpy as np
import pytest

from assets.asset import Asset
from assets.environment import Environment
from assets.gaussians import Gaussians, concatenate
from assets.reoriented import turned_environment
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from prepare.environment.environment_pipeline import EnvironmentOptions, prepare_environment
from prepare.environment.support_planes import NoFloor
from prepare.prepared_files import prepare_environment_file
from prepare.room_capture.likely_cameras import geometric_median
from scenes import sandbox
from scenes.roles import in_room

FRONT = np.array([0.6, 0.0, 0.8])  # the side from which the trophy was photographed
HIDDEN = 60  # Gaussians that nobody sees


def discs(points, normal, sigma: float, opacity: float = 3.0) -> Gaussians:
    """Gaussians of a standard deviation at points (N, 3), flat along a normal (3,)."""
    n, half = len(points), np.array([1.0 + normal[2], -normal[1], normal[0], 0.0])
    scales = np.log(np.tile([sigma, sigma, 0.2 * sigma], (n, 1)))
    colour = np.tile(np.random.default_rng(0).normal(0.0, 0.5, (n, 1, 1)), (1, 1, 3))
    return Gaussians.of(points, np.tile(half / np.linalg.norm(half), (n, 1)), scales, np.full(n, opacity), colour)


def trophy() -> Gaussians:
    """A head on a wall, no floor: fine Gaussians where it faces FRONT, a coarse wall around it, fog elsewhere."""
    rng, side = np.random.default_rng(1), np.array([FRONT[2], 0.0, -FRONT[0]])
    up = np.array([0.0, 1.0, 0.0])
    u, v = rng.uniform(-2.0, 2.0, (2, 2500))
    wall = u[:, None] * side + v[:, None] * up
    a, b = rng.uniform(-1.0, 1.0, (2, 1800))
    r2 = (a**2 + b**2).clip(0, 1)
    head = 0.7 * (a[:, None] * side + b[:, None] * up) + 0.9 * np.sqrt(1 - r2)[:, None] * FRONT
    fog = rng.uniform(-3.0, 3.0, (900, 3))
    fog = fog[(fog @ FRONT < -0.3) | (np.abs(fog @ side) > 2.2)]
    hidden = discs(rng.uniform(-0.2, 0.2, (HIDDEN, 3)) - 0.4 * FRONT, FRONT, 0.01)
    return concatenate([discs(wall, FRONT, 0.05), discs(head, FRONT, 0.025), discs(fog, FRONT, 0.6, 0.0), hidden])


@pytest.fixture(scope="module")
def played(ti_cpu, tmp_path_factory):
    """The trophy's file, that of its room, what was said, and the asset."""
    from assets.splat_files import write_gaussians

    folder, said = tmp_path_factory.mktemp("unposed"), []
    write_gaussians(folder / "trophy.ply", trophy())
    options = EnvironmentOptions(up="+y", cell=0.1)
    prepare_environment_file(folder / "trophy.ply", folder / "room.h5", options, report=said.append)
    return folder / "room.h5", said, Asset.load(folder / "room.h5")


def test_what_most_cameras_looked_at_is_the_geometric_median():
    """A few far Gaussians move it no more than near ones."""
    far = discs(np.random.default_rng(2).normal((40.0, 0.0, 0.0), 1.0, (300, 3)), FRONT, 0.05)
    found = geometric_median(concatenate([trophy(), far]))
    assert np.linalg.norm(found - 0.4 * FRONT) < 0.4


def test_without_a_floor_the_room_is_played_on_an_unseen_level(played):
    """The first way says why it fails; the other's eye sees the front, with the level below what it looks at."""
    _, said, asset = played
    with pytest.raises(NoFloor):
        prepare_environment(trophy(), EnvironmentOptions(up="+y", cell=0.1))
    environment = asset.environment
    assert any("searching for where cameras may have been" in line for line in said)
    assert any("unseen level" in line for line in said) and any("clear" in line for line in said)
    eye, target, drop = map(np.array, (environment.eye_position, environment.target, environment.drop_point))
    assert (eye - target) @ FRONT > 0.8 * np.linalg.norm(eye - target)
    assert environment.planes[-1][0] == "unseen" and environment.planes[-1][1] == pytest.approx(drop[1])
    assert drop[1] < target[1] and (drop - target) @ FRONT > 0.0
    assert asset.provenance["not_needed"] >= HIDDEN // 2


def test_the_player_stands_where_the_view_was_found(played):
    """A scene in that room looks from its eye at its target, and its bodies are carried by a level at their foot."""
    path, _, asset = played
    plain = sandbox.build()
    scene = in_room(plain, str(path))
    room, environment = scene.bodies[0], asset.environment
    length = np.linalg.norm(np.subtract(environment.eye_position, environment.target))
    assert np.linalg.norm(np.subtract(scene.eye, scene.target)) == pytest.approx(length)
    heights = [c.point[1] for c in scene.colliders if hasattr(c, "point")]
    assert plain.room.spot[1] in heights and scene.floor in heights and scene.floor < plain.room.spot[1]
    assert room.position[1] + environment.drop_point[1] == pytest.approx(plain.room.spot[1])


def test_a_target_is_kept_in_the_file_and_turned_with_the_room(tmp_path):
    grid = DistanceGrid(np.ones((3, 3, 3), np.float32), np.zeros(3), 0.5)
    environment = Environment(0.0, (0, 0, 0), (0, 1, 2), 0.3, (("unseen", 0.0, -1.0, -1.0, 1.0, 1.0),), (), (0, 1, 0))
    Asset(trophy(), sdf=grid, environment=environment).save(tmp_path / "a.h5")
    assert Environment.load(tmp_path / "a.h5").target == (0.0, 1.0, 0.0)
    turned = turned_environment(environment, np.diag([-1.0, -1.0, 1.0]), 2.0, np.array([0.0, 0.0, 1.0]))
    assert turned.target == pytest.approx((0.0, -2.0, 1.0))
    broken = replace(environment, target=(0.0, float("nan"), 0.0))
    Asset(trophy(), sdf=grid, environment=broken).save(tmp_path / "b.h5")
    with pytest.raises(BadInput, match="finite"):
        Environment.load(tmp_path / "b.h5")
