"""Object ids after training: the vote, files of parts, which masks are taken, and the command from masks to splats."""

import json
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace as N

import cv2
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree

from assets.gaussians import Gaussians, concatenate
from assets.splat_files import read_gaussians
from core.camera import look_at, perspective
from core.errors import BadInput
from prepare.segment.object_ids import (
    CELLS,
    background_around,
    check_learned,
    hidden_sides,
    learned_objects,
    masks_of,
    object_ious,
    objects_alone,
    part_file,
    seen_through,
    split,
    trained_alone,
    voted,
)
from prepare.train.capture import Capture, Lens, View
from prepare.train.capture_files import read_capture
from prepare.train.photographs import Photograph
from tests.support import painted_capture
from tests.support import reference_render as reference
from tests.support.samples import some_gaussians
from vrgs import main

COLORS = np.array([[0, 0, 0], [200, 30, 0], [0, 90, 250]], np.uint8)
TINY = ("--cap", "300", "--degree", "0", "--arch", "cpu", "--checkpoint-every", "0", "--steps", "30")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The painted capture with masks/ of two objects, "left" and "right"."""
    folder = tmp_path_factory.mktemp("masked") / "capture"
    painted_capture.write_capture(folder)
    (folder / "masks").mkdir()
    for k, ids in enumerate(painted_capture.masks()):
        cv2.imwrite(str(folder / "masks" / f"{k:02}.png"), COLORS[ids][..., ::-1])
    names = {"right": COLORS[1].tolist(), "left": COLORS[2].tolist()}
    (folder / "masks" / "objects.json").write_text(json.dumps(names))
    return folder


def test_islands_drown_and_what_was_seen_well_stays():
    rng = np.random.default_rng(0)
    means = np.concatenate([rng.uniform(-1.1, -0.1, (500, 3)), rng.uniform(0.1, 1.1, (500, 3)), [[0.5, 0.5, 0.5]]])
    g = replace(some_gaussians(1001, 0), means=means.astype(np.float32), logit_opacities=np.ones(1001, np.float32))
    truth = np.repeat([1, 2, 0], (500, 500, 1)).astype(np.uint8)
    ids, evidence = truth.copy(), np.ones(1001)
    hidden = rng.choice(1000, 40, replace=False)  # never seen: still background
    ids[hidden], evidence[hidden] = 0, 0.0
    evidence[1000] = 50.0  # a large one among small ones
    assert_array_equal(voted(g, ids, evidence, 2), truth)
    ids[500:505], evidence[500:505] = 1, 9.0  # what shows through, seen well but far from the rest of its object
    assert_array_equal(voted(g, ids, evidence, 2), truth)
    few = g.select(np.array([0, 1, 500, 501, 502]))  # all that there is of them
    assert_array_equal(voted(few, truth[[0, 1, 500, 501, 502]], np.array([1.0, 1, 9, 9, 9]), 2), [1, 1, 2, 2, 2])
    assert_array_equal(voted(g.select(np.array([0, 1, 500])), np.array([1, 1, 2]), np.zeros(3), 2), [1, 1, 1])


def test_the_overlap_of_objects_is_intersection_over_union_of_the_pixels_that_count():
    rng = np.random.default_rng(0)
    truth, seen, counts = rng.integers(0, 4, (2, 9, 7)), rng.integers(0, 4, (2, 9, 7)), rng.random((2, 9, 7)) < 0.8
    truth[truth == 3] = 0  # no mask has the third object
    pictures = [N(camera=k, objects=truth[k], mask=counts[k]) for k in range(2)] + [N(camera=2, objects=None)]
    trainer = N(objects=["a", "b", "c"], seen_objects=lambda camera, ids: seen[camera])
    both, either = (
        [(f(truth == k, seen == k) & counts).sum() for k in (1, 2)] for f in (np.logical_and, np.logical_or)
    )
    assert object_ious(trainer, pictures, None) == pytest.approx({"a": both[0] / either[0], "b": both[1] / either[1]})


def painted_views() -> Capture:
    """The painted capture, without its photographs."""
    lens = Lens(64, 64, 75.0, 75.0, 32.0, 32.0)
    return Capture(Path("none"), [View(Path("none.png"), lens, c.world_to_camera) for c in painted_capture.cameras()])


def test_a_trained_splat_learns_its_objects_from_masks(ti_cpu):
    g, truth = painted_capture.painted_gaussians(), painted_capture.painted_objects()
    seen = [p._replace(objects=m) for p, m in zip(painted_capture.photographs(), painted_capture.masks(), strict=True)]
    told = []
    found = learned_objects(g, painted_views(), seen, ("left", "right"), lambda what, done: told.append(done))
    assert len(found) == len(g) and found.objects == ("left", "right") and told[-1] == 1.0
    assert (found.object_id == truth).mean() > 0.9


def test_what_the_background_hid_of_an_object_goes_once_it_is_trained_alone(ti_cpu):
    """A dark cloud behind an object, in front of what is opaque, is drawn by no photograph: alone it would be."""
    g = painted_capture.painted_gaussians()
    object_id = (painted_capture.painted_objects() == 1).astype(np.uint16)
    rest, own = (replace(g.select(object_id == k), object_id=object_id[object_id == k], objects=("a",)) for k in (0, 1))
    cloud = replace(own.select(slice(1)), log_scales=np.full((1, 3), np.log(0.3), np.float32))
    cloud = replace(cloud, means=np.array([[0.2, 0.7, 0.0]], np.float32), logit_opacities=np.zeros(1, np.float32))
    seen = [
        p._replace(objects=(m == 1).astype(np.uint8))
        for p, m in zip(painted_capture.photographs(), painted_capture.masks(), strict=True)
    ]
    found = trained_alone(concatenate([rest, own, cloud]), painted_views(), seen)
    assert_array_equal(found.object_id, np.repeat([0, 1], [len(rest), len(found) - len(rest)]))
    assert_array_equal(found.means[: len(rest)], rest.means)
    cloudy, others = found.opacities[len(rest) + len(own)], found.opacities[len(rest) : len(rest) + len(own)]
    assert cloudy < 0.1 and np.median(others) > 0.8


def test_the_background_is_learned_around_objects_that_stay_as_they_are(ti_cpu):
    """Objects with narrower edges than those that the background was learned beneath, and green in the photographs, of
    which the background takes nothing."""
    g, photographs = painted_capture.painted_gaussians(), painted_capture.photographs()
    ids, masks = (painted_capture.painted_objects() == 1).astype(np.uint16), painted_capture.masks()
    g = replace(g, log_scales=g.log_scales - 0.5 * ids[:, None].astype(np.float32), object_id=ids, objects=("a",))
    seen = [p._replace(objects=(m == 1).astype(np.uint8)) for p, m in zip(photographs, masks, strict=True)]
    for p in seen:
        p.pixels[p.objects == 1] = 0, 255, 0
    found = background_around(g, painted_views(), seen)
    before, after = g.select(ids == 1), found.select(np.arange(len(g)) >= (ids == 0).sum())
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh", "object_id"):
        assert_array_equal(getattr(after, name), getattr(before, name))

    def error(gaussians: Gaussians) -> float:
        """Mean square error of the pixels within four of the object."""
        squares = []
        for p, m in zip(photographs, masks, strict=True):
            seam = binary_dilation(m == 1, iterations=4) & (m != 1)
            squares.append(
                (reference.render(gaussians, p.camera, linear=True)[0].clip(0, 1) - p.pixels / 255)[seam] ** 2
            )
        return float(np.concatenate(squares).mean())

    assert error(found) < 0.72 * error(g)  # 0.79 if it learns from the green


def test_an_object_alone_is_told_by_the_pixels_that_show_it_or_nothing_before_it(ti_cpu):
    """A ball, a smaller one before its left half, a mask that took a part of the ground, and two unknown rows."""
    ball = Gaussians.of([[0.0, 0.0, 2.0]], [[1.0, 0, 0, 0]], np.full((1, 3), np.log(0.2)), [6.0], np.zeros((1, 1, 3)))
    before = replace(
        ball, means=ball.means + np.float32([-0.2, 0.0, -0.8]), log_scales=ball.log_scales - np.float32(1.0)
    )
    camera, ids = perspective(64, 64, 0.8, np.eye(4)), np.zeros((64, 64), np.uint8)
    y, x = np.mgrid[:64, :64] - 31.5
    ids[(np.hypot(x, y) < 15) & (x > -4)] = 1
    ids[:6, :6], ids[-2:] = 2, 255
    photograph = Photograph(np.full((64, 64, 3), 200, np.uint8), np.ones((64, 64), bool), camera, ids)
    (found,), (depth,) = objects_alone(ball, before, [photograph])
    assert depth[32, 36] == pytest.approx(2.0, abs=0.05) and depth[32, 22] < 1.4 and np.isinf(depth[32, 62])
    assert_array_equal(found.alpha, 255 * (ids > 0))
    assert_array_equal(found.pixels, np.full((64, 64, 3), 200) * (ids[..., None] > 0))
    counts = found.mask
    assert counts[32, 36] and counts[32, 60] and counts[5, 40]  # the object; nothing
    assert not counts[32, 22] and not counts[3, 3] and not counts[-1].any()  # before it; not drawn; unknown
    assert not counts[32, 27:29].any()  # along the border


def balls_photographed(balls: list, framed: bool) -> tuple[list[Photograph], list[np.ndarray]]:
    """Photographs from half a circle around balls (centre, radius) of one object, and their depths; `framed`: through a
    round hole, of what is nearer."""
    photographs, depths = [], []
    for turn, rise in product(np.linspace(-np.pi / 2, np.pi / 2, 7), (-0.4, 0.9)):
        eye = 2.5 * np.array([np.sin(turn) * np.cos(rise), np.sin(rise), np.cos(turn) * np.cos(rise)])
        camera = perspective(96, 96, 0.9, look_at(eye, (0.0, 0.0, 0.0)))
        v, u = np.mgrid[:96, :96] + 0.5
        rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
        rays = rays @ camera.world_to_camera[:3, :3]  # of depth 1
        depth = np.full((96, 96), np.inf)
        for centre, radius in balls:
            a, b = (rays**2).sum(axis=2), rays @ (camera.position - centre)
            root = b**2 - a * (((camera.position - centre) ** 2).sum() - radius**2)
            depth = np.minimum(depth, np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0.0))) / a, np.inf))
        ids = np.isfinite(depth).astype(np.uint8)
        if framed:
            depth[ids == 0] = 0.5
        photographs.append(Photograph(np.zeros((96, 96, 3), np.uint8), ids < 2, camera, ids))
        depths.append(depth)
    return photographs, depths


def test_what_is_seen_through_an_object_is_left_to_the_background():
    """Behind a ball, in the line of sight of each photograph: near, where others see it beside the ball, and so far
    that no other shows it. In half of the photographs a second object stands before the ball's lower half."""
    photographs = balls_photographed([((0.0, 0.0, 0.0), 0.5)], framed=False)[0][::4]
    for p in photographs[::2]:
        p.objects[60:] = 2
    ways = np.random.default_rng(0).normal(size=(400, 3))
    ball = 0.45 * ways / np.linalg.norm(ways, axis=1, keepdims=True)  # outlines are as rough as pixels
    sight = np.array([-p.camera.position / np.linalg.norm(p.camera.position) for p in photographs])
    means = np.concatenate([ball, 1.5 * sight, 30.0 * sight, 30.0 * sight])
    ids = np.repeat([1, 1, 1, 0], (400, 4, 4, 4)).astype(np.uint8)
    found = seen_through(means, ids, [photographs[0]._replace(objects=None), *photographs])
    assert found[400:408].all() and not found[408:].any()  # what is of no object stays so
    assert not found[:400].any()


@pytest.mark.parametrize("framed", [False, True])
@pytest.mark.parametrize("balls", [[((0.0, 0.0, 0.0), 0.5)], [((0.0, 0.0, 0.0), 0.5), ((0.0, 0.8, 0.0), 0.15)]])
def test_the_side_of_a_ball_that_no_photograph_shows_is_closed(balls, framed):
    """It is as round as silhouettes tell, with the colours beside it; of two pieces the smaller one stays as it is."""
    photographs, depths = balls_photographed(balls, framed)
    ways = np.random.default_rng(0).normal(size=(1500, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    points = np.concatenate([centre + radius * ways for centre, radius in balls])
    seen = np.zeros(len(points), bool)
    for p, depth in zip(photographs, depths, strict=True):
        x, y, z = p.camera.projected(points)
        seen |= np.abs(depth[y.astype(int).clip(0, 95), x.astype(int).clip(0, 95)] - z) < 0.02
    means, n = points[seen], int(seen.sum())
    sh = np.where(means[:, :1, None] < 0.0, [[[1.0, 0.0, 0.0]]], [[[0.0, 0.0, 1.0]]])
    object_id = np.ones(n, np.uint16)
    own = Gaussians.of(
        means, np.tile([1.0, 0, 0, 0], (n, 1)), np.full((n, 3), -4.0), np.full(n, 4.0), sh, object_id, ("a",)
    )
    found = hidden_sides(own, photographs, depths)
    assert (found.object_id == 1).all() and found.objects == ("a",) and (found.opacities > 0.8).all()
    away = np.linalg.norm(found.means, axis=1)
    assert away.min() > 0.4 and away.max() < 0.68
    unseen = points[: len(ways)][~seen[: len(ways)]]
    beside = cKDTree(found.means).query(unseen)[0]  # single ones are seen, but along the surface
    assert len(unseen) > 50 and np.quantile(beside, 0.97) < 4 * np.ptp(points, axis=0).max() / CELLS
    assert np.quantile(cKDTree(unseen).query(found.means)[0], 0.9) < 0.2
    left, right = (found.sh[found.means[:, 0] * side > 0.08, 0].mean(axis=0) for side in (-1, 1))
    assert left[0] > 0.8 and right[2] > 0.8


def test_a_split_loses_nothing():
    g = replace(some_gaussians(9), object_id=np.arange(9, dtype=np.uint16) % 4, objects=("a", "b"))
    parts = split(g)
    assert list(parts) == ["a", "b", "background"] and sum(map(len, parts.values())) == 9
    assert set(parts["background"].object_id) == {0, 3} and set(parts["b"].object_id) == {2}
    assert list(split(g.select(g.object_id != 1))) == ["b", "background"]


def test_parts_are_called_after_the_whole(tmp_path):
    for name, part in (
        ("a.ply", "a_cup.ply"),
        ("a.compressed.ply", "a_cup.compressed.ply"),
        ("a.b.spz", "a.b_cup.spz"),
    ):
        assert part_file(tmp_path / name, "cup") == tmp_path / part


def test_masks_beside_the_images_are_taken_unless_they_tell_what_counts(folder, tmp_path):
    capture, lines = read_capture(folder), []
    assert masks_of(capture, None, lines.append)[1].names == ["right", "left"] and lines == []
    counting = replace(
        capture, views=[replace(v, mask=folder / "masks" / f"{v.image.stem}.png") for v in capture.views]
    )
    assert masks_of(counting, None, lines.append) == (counting, None) and "--masks" in lines[0]
    taken, masks = masks_of(counting, folder / "masks", lines.append)
    assert masks is not None and all(v.mask is None for v in taken.views)
    bad = tmp_path / "masks"
    bad.mkdir()
    cv2.imwrite(str(bad / "00.png"), np.zeros((9, 9, 3), np.uint8))
    with pytest.raises(BadInput, match="9x9"):
        masks_of(capture, bad, lines.append)
    assert (
        masks_of(replace(capture, folder=tmp_path), None, lines.append)[1] is None and "masks/ is not used" in lines[1]
    )


def test_an_object_that_one_photograph_shows_is_refused():
    pictures = painted_capture.photographs()[:3]
    pictures = [p._replace(objects=np.zeros((64, 64), np.uint8)) for p in pictures]
    pictures[1].objects[5:9] = 1
    with pytest.raises(BadInput, match="'cup' is seen in 1 of the photographs"):
        check_learned(["cup"], pictures)
    pictures[0].objects[5:9] = 1
    check_learned(["cup"], pictures)


def test_the_command_learns_objects_and_splits(ti_cpu, folder, tmp_path, capsys):
    out = tmp_path / "out.ply"
    assert main(["train", str(folder), "--out", str(out), "--split", "--report", str(tmp_path / "r.json"), *TINY]) == 0
    said = capsys.readouterr().out
    g, numbers = read_gaussians(out), json.loads((tmp_path / "r.json").read_text())
    assert g.objects == ("right", "left") and "right: " in said and "IoU" in said
    for k, name in enumerate(g.objects, 1):
        assert numbers["objects"][name]["gaussians"] == (g.object_id == k).sum()
        assert 0.0 <= numbers["objects"][name]["iou"] <= 1.0
    parts = [p for p in tmp_path.glob("out_*.ply")]
    assert sum(len(read_gaussians(p)) for p in parts) == len(g)
    assert (tmp_path / "r.html").read_text().count("data:image/png") == 8  # two views: photograph, drawn, and masks


def test_masks_that_cannot_be_used_are_refused_before_the_training(folder, tmp_path, capsys):
    out = tmp_path / "out.ply"
    black = tmp_path / "black"
    black.mkdir()
    for k in range(painted_capture.VIEWS):
        cv2.imwrite(str(black / f"{k:02}.png"), np.zeros((64, 64, 3), np.uint8))
    for words, says in (
        (["--masks", str(tmp_path / "none here")], "no such folder"),
        (["--masks", str(black)], "no object in any mask"),
        (["--masks", "none", "--split"], "--split belongs to --masks"),
    ):
        assert main(["train", str(folder), "--out", str(out), *words, *TINY]) == 2
        said = capsys.readouterr().err
        assert says in said and said.count("\n") == 1
    assert not list(tmp_path.glob("out*"))
