"""The clip of an asset: kept and read again, turned with its world, and refused where it does not fit."""

from dataclasses import replace
from functools import partial

import h5py
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from assets.asset import Asset
from assets.fitted_clip import PICTURES_MAX, FittedClip
from core.camera import look_at, perspective
from tests.assets.test_quantisation import embedded
from tests.fuzz.hdf5_mutations import put
from tests.support import samples

refused = partial(samples.refused, read=Asset.load)


def filmed(asset: Asset, frames: int = 4) -> Asset:
    """The asset with a clip of it, turned and away from its frame's origin, whose pictures become lighter."""
    x = asset.cage.vertices.astype(float)[:, [1, 2, 0]] + [1.0, 2.0, 3.0]
    push = asset.cage.vertices[:, :1] * [0.2, 0.5, 0.1]  # [m/s], more the farther from the held end
    middle = x.mean(0)
    camera = perspective(32, 24, 0.8, look_at(middle + [1.2, 0.5, 0.3], middle))
    pictures = np.broadcast_to(np.linspace(20, 230, frames)[:, None, None, None], (frames, 24, 32, 3)).astype(np.uint8)
    held = np.flatnonzero(asset.cage.vertices[:, 0] < 0.05)
    planes = np.array([[0.0, 0.6, 0.8, 1.0]])
    return replace(asset, clip=FittedClip(pictures, np.arange(frames) / 20, camera, held, x, push, planes))


@pytest.mark.parametrize("quantised", [False, True])
def test_a_clip_is_read_as_it_was_kept(quantised, tmp_path):
    asset = filmed(embedded(n=60, exact=4))
    asset.save(tmp_path / "a.h5", quantised=quantised)
    own, read = asset.clip, Asset.load(tmp_path / "a.h5").clip
    assert_allclose(read.pictures.astype(float), own.pictures, atol=3)  # as JPEG
    for name in ("times", "held", "planes"):
        assert_array_equal(getattr(read, name), getattr(own, name))
    for name in ("positions", "velocities"):
        assert_allclose(getattr(read, name), getattr(own, name), atol=1e-6)
    assert_array_equal(read.camera.world_to_camera, own.camera.world_to_camera)
    assert read.period == pytest.approx(4 / 20)


def test_a_turned_world_shows_the_camera_the_same():
    asset = filmed(embedded(n=60, exact=4))
    own, rest = asset.clip, asset.cage.vertices.astype(float)
    made = own.in_front(rest)
    assert_allclose(made.positions.mean(0), rest.mean(0), atol=1e-6)
    ahead = made.camera.world_to_camera[2, :3]
    assert abs(ahead[0]) < 1e-12 and ahead[2] < 0
    assert_allclose(made.camera.projected(made.positions), own.camera.projected(own.positions), rtol=1e-6)
    steps = [c.positions + 0.01 * c.velocities for c in (made, own)]
    assert_allclose(made.camera.projected(steps[0]), own.camera.projected(steps[1]), rtol=1e-6)
    gaps = [c.positions @ c.planes[0, :3] - c.planes[0, 3] for c in (made, own)]
    assert_allclose(*gaps, atol=1e-6)


def test_an_asset_of_another_size_keeps_no_clip():
    asset = filmed(embedded(n=60, exact=4))
    assert asset.transformed(np.eye(3)).clip is asset.clip
    assert asset.transformed(np.eye(3), 1.5).clip is None


@pytest.mark.parametrize(
    ("name", "values", "why"),
    [
        ("film", np.zeros(50, np.uint8), "is no JPEG of 32 x 96 px"),
        ("times", np.arange(5) / 20, "is no JPEG of 32 x 120 px"),
        ("times", np.arange(PICTURES_MAX + 1) / 20, "121 pictures"),
        ("times", np.array([0.0, 0.1, 0.1, 0.2]), "do not ascend"),
        ("times", np.array([0.0, 0.1, 0.2, np.inf]), "do not ascend"),
        ("held", np.array([0, 5000], np.int32), "holds a vertex outside"),
        ("positions", np.zeros((3, 3), np.float32), "positions of its clip are not those of"),
        ("planes", np.array([[0.0, 2.0, 0.0, 0.0]]), "has no unit normal"),
        ("planes", np.array([[0.0, 1.0, 0.0, np.nan]]), "has no unit normal"),
    ],
)
def test_a_clip_that_cannot_be_played_is_refused(name, values, why, tmp_path):
    path = tmp_path / "a.h5"
    filmed(embedded(n=60, exact=4)).save(path)
    with h5py.File(path, "r+") as file:
        put(file, f"clip/{name}", values)
    assert why in refused(path)


@pytest.mark.parametrize(
    ("edit", "why"),
    [
        (lambda f: f["clip/velocities"].__setitem__((0, 0), np.nan), "velocities of its clip"),
        (lambda f: f["clip"].attrs.__setitem__("camera", np.array(b"{}")), "width is missing"),
        (lambda f: f["clip/film"].__setitem__(slice(250, None), 0), "film of its clip is damaged"),
        (lambda f: f.__delitem__("cage"), "no cage"),
    ],
)
def test_a_damaged_clip_is_refused(edit, why, tmp_path):
    path, rng = tmp_path / "a.h5", np.random.default_rng(0)
    asset = filmed(embedded(n=60, exact=4))
    noise = rng.integers(0, 255, asset.clip.pictures.shape).astype(np.uint8)
    replace(asset, clip=replace(asset.clip, pictures=noise)).save(path)
    with h5py.File(path, "r+") as file:
        edit(file)
    assert why in refused(path)
