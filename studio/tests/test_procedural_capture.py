"""The procedural capture: what its files say agrees with each other and with the models."""

import json
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from core.errors import BadInput
from prepare.segment.marks import drawn_strokes, read_marks
from prepare.segment.mask_files import read_masks
from prepare.train.capture_files import read_capture
from prepare.train.photographs import load_photograph
from studio.ball import RADIUS
from studio.procedural_capture import OBJECTS, CaptureOptions, write_procedural_capture

pytest.importorskip("open3d")
SIZE, VIEWS, SCALE = (96, 72), 5, 3.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A tiny capture of a world with +z up and three units in a metre."""
    path = tmp_path_factory.mktemp("capture") / "toys"
    options = CaptureOptions(VIEWS, SIZE, 1, "+z", SCALE)
    write_procedural_capture(path, options, lambda line: None)
    return path


@cache
def truth(folder):
    return json.loads((folder / "truth.json").read_text())


def points_of(folder, k):
    """World points (H, W, 3) of a depth picture, and the view."""
    view = read_capture(folder).views[k]
    camera = view.camera()
    depth = cv2.imread(str(folder / "depth" / view.name), cv2.IMREAD_UNCHANGED) * (0.001 * SCALE)
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    local = np.stack([(x - camera.cx) / camera.fx * depth, (y - camera.cy) / camera.fy * depth, depth], -1)
    pose = np.linalg.inv(camera.world_to_camera)
    return local @ pose[:3, :3].T + pose[:3, 3], view


def test_a_capture_is_read_as_any_other(folder):
    capture = read_capture(folder)
    assert len(capture.views) == VIEWS and len(capture.points) > 1000 and np.ptp(capture.colors) > 150
    assert capture.views[0].camera().width == SIZE[0] and load_photograph(capture.views[0]).pixels.std() > 20
    assert capture.up @ truth(folder)["up"] > 0.8 and truth(folder)["up"] == [0.0, 0.0, 1.0]
    masks = read_masks(folder / "masks", capture.views)
    assert sorted(masks.names) == sorted(OBJECTS) and all(masks.pixels(n) > 50 * VIEWS for n in ("teddy", "parcel"))


def test_toys_on_transparent_ground_are_a_blender_dataset(tmp_path):
    write_procedural_capture(tmp_path / "toys", CaptureOptions(4, (48, 48), cut_out=True), lambda line: None)
    capture = read_capture(tmp_path / "toys")
    assert (len(capture.views), len(capture.test)) == (4, 1)
    p = load_photograph(capture.views[0])
    assert 0.03 < (p.alpha == 255).mean() < 0.6 < (p.alpha == 0).mean() + 0.5 and p.pixels[p.alpha == 255].mean() > 40
    assert np.linalg.norm(capture.looked_at() - capture.views[0].position) == pytest.approx(1.3, abs=1e-3)


def test_its_marks_are_two_strokes_inside_of_each_object(folder):
    views = read_capture(folder).views
    masks = read_masks(folder / "masks", views)
    marks = read_marks(folder / "marks.json", {v.name: SIZE for v in views})
    assert sorted(marks.objects) == sorted(OBJECTS)
    for name, own in marks.objects.items():
        assert len(own) == 2
        for view, strokes in own.items():
            ids = masks.ids[[v.name for v in views].index(view)]
            line = drawn_strokes(strokes.inside, ids.shape, 1)
            assert (ids[line] == masks.names.index(name) + 1).mean() > 0.8


def test_masks_and_depths_agree_with_the_objects_places(folder):
    masks = read_masks(folder / "masks", read_capture(folder).views)
    for k in range(VIEWS):
        points, _ = points_of(folder, k)
        for name, place in truth(folder)["objects"].items():
            own = points[masks.ids[k] == masks.names.index(name) + 1]
            if len(own):
                assert (own > np.array(place["low"]) - 0.01).all() and (own < np.array(place["high"]) + 0.01).all()
        ball = points[masks.ids[k] == masks.names.index("ball") + 1]
        pose = np.array(truth(folder)["objects"]["ball"]["world_from_object"])
        centre = pose[:3, 3] + SCALE * RADIUS * pose[:3, 1]
        assert_allclose(np.linalg.norm(ball - centre, axis=1), SCALE * RADIUS, atol=0.02 * SCALE * RADIUS)


def test_sparse_points_lie_on_what_the_depths_show(folder):
    points, view = points_of(folder, 2)
    capture, camera = read_capture(folder), view.camera()
    local = capture.points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    x = (camera.fx * local[:, 0] / local[:, 2] + camera.cx).astype(int)
    y = (camera.fy * local[:, 1] / local[:, 2] + camera.cy).astype(int)
    seen = (local[:, 2] > 0) & (x >= 0) & (x < SIZE[0]) & (y >= 0) & (y < SIZE[1])
    gap = np.linalg.norm(points[y[seen], x[seen]] - capture.points[seen], axis=1) / SCALE
    assert (gap < 0.03).mean() > 0.25 and seen.sum() > 500  # the others are hidden in this view


def test_behind_an_object_is_what_other_pictures_show_around_it(folder):
    """An object's pixels change where it stood; far from it and its shadow nothing does."""
    capture = read_capture(folder)
    masks = read_masks(folder / "masks", capture.views)
    for name in OBJECTS:
        own = masks.ids[1] == masks.names.index(name) + 1
        shown = cv2.imread(str(capture.views[1].image)).astype(int)
        behind = cv2.imread(str(folder / "behind" / name / capture.views[1].name)).astype(int)
        change = np.abs(shown - behind).max(axis=2)
        far = ~cv2.dilate(own.astype(np.uint8), np.ones((41, 41))).astype(bool)
        assert change[own].mean() > 20 and np.percentile(change[far], 98) <= 3


def test_the_other_sides_of_an_object_are_seen_where_it_stood(folder):
    """The ball is a disc about its centre, whichever way it is turned, photographed but for its underside."""
    pose = np.array(truth(folder)["objects"]["ball"]["world_from_object"])
    centre, shares = pose[:3, 3] + SCALE * RADIUS * pose[:3, 1], []
    for view in read_capture(folder / "turned" / "ball").views:
        p, camera = load_photograph(replace(view, mask=None)), view.camera()
        x, y, z = camera.projected(centre[None])
        radius = camera.fx * SCALE * RADIUS / np.sqrt(z[0] ** 2 - (SCALE * RADIUS) ** 2)
        v, u = np.nonzero(p.alpha > 127)
        assert_allclose([u.mean() + 0.5, v.mean() + 0.5], [x[0], y[0]], atol=0.3)
        assert_allclose(len(u), np.pi * radius**2, rtol=0.1)
        assert_allclose(np.linalg.norm(view.position - centre), SCALE * 1.15, rtol=1e-6)
        seen = cv2.imread(str(view.mask), cv2.IMREAD_GRAYSCALE) > 0
        assert not (seen & (p.alpha == 0)).any() and p.pixels[p.alpha == 255].mean() > 40
        shares.append(seen.sum() / len(u))
    assert min(shares) < 0.3 and max(shares) > 0.6  # from below, and from above


def test_the_table_bears_the_objects(folder):
    corners = np.array(truth(folder)["table_top"])
    assert np.ptp(corners[:, 2]) < 1e-9
    for place in truth(folder)["objects"].values():
        assert abs(place["low"][2] - corners[0, 2]) < 0.01 * SCALE
        assert (np.array(place["low"])[:2] > corners.min(0)[:2]).all()
        assert (np.array(place["high"])[:2] < corners.max(0)[:2]).all()


def test_nothing_that_is_there_is_overwritten(folder):
    with pytest.raises(BadInput, match="exists already"):
        write_procedural_capture(folder, CaptureOptions(), lambda line: None)
    assert sorted(p.name for p in folder.parent.iterdir()) == ["toys"]
