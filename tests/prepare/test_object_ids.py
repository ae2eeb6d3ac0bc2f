"""Object ids after training: the vote, files of parts, which masks are taken, and the command from masks to splats."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace as N

import cv2
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from assets.splat_files import read_gaussians
from core.errors import BadInput
from prepare.segment.object_ids import check_learned, learned_objects, masks_of, object_ious, part_file, split, voted
from prepare.train.capture import Capture, Lens, View
from prepare.train.capture_files import read_capture
from tests.support import painted_capture
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


def test_a_trained_splat_learns_its_objects_from_masks(ti_cpu):
    g, truth = painted_capture.painted_gaussians(), painted_capture.painted_objects()
    seen = [p._replace(objects=m) for p, m in zip(painted_capture.photographs(), painted_capture.masks(), strict=True)]
    views = [View(Path("none.png"), Lens(64, 64, 75.0, 75.0, 32.0, 32.0), p.camera.world_to_camera) for p in seen]
    told = []
    found = learned_objects(
        g, Capture(Path("none"), views), seen, ("left", "right"), lambda what, done: told.append(done)
    )
    assert len(found) == len(g) and found.objects == ("left", "right") and told[-1] == 1.0
    assert (found.object_id == truth).mean() > 0.9


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
