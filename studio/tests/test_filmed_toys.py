"""Films of toys: what their files say agrees with each other, and `vrgs.py fit` finds what the toys are made of."""

import json
from dataclasses import replace

import numpy as np
import pytest

from assets.asset import Asset
from assets.camera_file import read_cameras
from assets.library import find_asset
from commands.parser import parse
from core.camera import look_at, perspective
from core.errors import BadInput
from display.drawn_body import DrawnBody
from prepare.fit.clip_masks import clip_masks, read_clip, read_clip_marks
from prepare.fit.clip_tracks import ALIGNED_SIDE, found_pose
from prepare.fit.marker_tracks import posed
from studio import filmed_toys
from studio.filmed_toys import CLIPS, film_toy, shaken

SIZE = (240, 180)


@pytest.fixture(scope="module")
def folder(ti_cpu, tmp_path_factory):
    path = tmp_path_factory.mktemp("films")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(CLIPS, "cat_hung", replace(CLIPS["cat_hung"], seconds=0.5))
        film_toy("cat_hung", path, lambda line: None, size=SIZE)
    return path


def test_a_film_shows_the_toy_where_the_truth_says(folder):
    clip, camera = read_clip(folder / "cat_hung.mp4"), read_cameras(folder / "cat_hung.camera.json")[0]
    truth = json.loads((folder / "cat_hung.truth.json").read_text())
    assert clip.size == SIZE and len(clip.times) == 15 and truth["clip"]["young"] == CLIPS["cat_hung"].young
    marks, held = read_clip_marks(folder / "cat_hung.marks.json", clip, SIZE)
    mask = clip_masks(clip, {0: marks[0]})[0]
    asset, start = Asset.load(find_asset("toy_cat")), np.array(truth["start"])
    u, v, _ = camera.projected(start)
    top = start[:, 1] > np.quantile(start[:, 1], 0.9)
    left, above, right, below = held[0]
    assert ((u >= left) & (u <= right) & (v >= above) & (v <= below))[top].mean() > 0.8
    drawn = DrawnBody(asset, SIZE[0], ALIGNED_SIDE)
    drawn.move(start)
    overlap = drawn.picture(camera)[1] > 0.5
    assert (overlap & mask).sum() > 0.85 * (overlap | mask).sum()
    x = asset.cage.vertices.astype(float)
    drawn.move(x)
    pose = found_pose(drawn.picture, x, camera, clip, mask, lambda done: None)
    drawn.destroy()
    assert np.linalg.norm(posed(pose, x) - start, axis=1).mean() < 0.02


def test_a_hand_turns_the_camera_and_what_is_behind_alike():
    """A spot of the backdrop goes where the turned camera sees the direction that it was in."""
    camera, behind = perspective(240, 180, 0.9, look_at((0, 0.2, 1), (0, 0, 0))), np.zeros((180, 240, 3))
    behind[60:63, 100:103] = 1.0
    far = camera.points_at(np.full((180, 240), 1e3), np.array([101]), np.array([61]))
    assert shaken(camera, behind, 0.0, 0.3)[1] is behind
    turned, seen = shaken(camera, behind, 6.0, 0.3)
    rows, columns = np.indices(seen.shape[:2]) + 0.5
    spot = np.array([(columns * seen[..., 0]).sum(), (rows * seen[..., 0]).sum()]) / seen[..., 0].sum()
    went = np.ravel(turned.projected(far)[:2])
    np.testing.assert_allclose(spot, went, atol=0.05)
    assert np.linalg.norm(went - [101.5, 61.5]) > 4


def test_an_unknown_clip_is_refused(tmp_path):
    with pytest.raises(BadInput, match="no such clip; there are rabbit_hung"):
        film_toy("dog", tmp_path, print)


@pytest.mark.long
@pytest.mark.parametrize("name", ["cat_hung", "parcel_sliding"])
def test_what_a_toy_is_made_of_is_found_from_its_film(ti_cpu, tmp_path, monkeypatch, name):
    """Finds what shows: a stiffness and damping, or a friction; what does not show stays as the asset has it."""
    monkeypatch.setenv("VRGS_CACHE", str(tmp_path / "cache"))
    film_toy(name, tmp_path, lambda line: None)
    truth, toy = json.loads((tmp_path / f"{name}.truth.json").read_text()), filmed_toys.CLIPS[name]
    words = f"fit {toy.asset} {tmp_path}/{name}.mp4 --camera {tmp_path}/{name}.camera.json --out {tmp_path}/o.h5"
    words += f" --marks {tmp_path}/{name}.marks.json"
    for plane in truth["planes"]:
        words += " --plane " + " ".join(map(repr, plane))
    command, options = parse(words.split())
    command(options)
    found, before = Asset.load(tmp_path / "o.h5").material, Asset.load(find_asset(toy.asset)).material
    if toy.tilt is None:
        np.testing.assert_allclose([found.young, found.damping], [toy.young, toy.damping], rtol=0.25)
    else:
        np.testing.assert_allclose(found.friction, toy.friction, atol=0.05)
        assert found.young == before.young
