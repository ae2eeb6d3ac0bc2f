"""Labels of objects that are learned from masks: convergence, births, checkpoints, photographs without a mask."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from prepare.train.capture import Capture, Lens, View
from prepare.train.densification import AdaptiveDensity
from prepare.train.object_labels import label_colors, nearest_label
from prepare.train.photographs import load_photograph
from prepare.train.seeds import seeds
from prepare.train.trainer import Trainer, TrainOptions, read_checkpoint, write_checkpoint
from tests.support import painted_capture

CAP = 500
TEST = (0, 6)  # photographs that are not learned from
BLIND = 5  # the one without a mask
NAMES = ("left", "right")
LABELS = ("label", "first_label", "second_label")


def test_labels_lie_far_apart_and_the_nearest_is_found():
    for count, least in ((1, 1.7), (7, 1.0), (26, 0.5), (255, 0.15)):
        colors = label_colors(count)
        apart = np.linalg.norm(colors[:, None] - colors, axis=2) + 9 * np.eye(count + 1)
        assert len(colors) == count + 1 and apart.min() >= least and not colors[0].any()
        assert_array_equal(nearest_label(0.9 * colors + 0.05, count), np.arange(count + 1))


@pytest.fixture(scope="module")
def trained(ti_cpu, tmp_path_factory):
    """A trainer after some steps with masks, and the photographs that it has not seen."""
    pictures = painted_capture.photographs()
    pictures = [p._replace(objects=m) for p, m in zip(pictures, painted_capture.masks(), strict=True)]
    pictures[BLIND] = pictures[BLIND]._replace(objects=None)
    folder, lens = tmp_path_factory.mktemp("capture"), Lens(64, 64, 75.0, 75.0, 32.0, 32.0)
    views = [View(folder / f"{k}.png", lens, p.camera.world_to_camera) for k, p in enumerate(pictures)]
    capture = Capture(folder, views, *painted_capture.sparse_points())
    start = seeds(capture, degree=0, count=CAP, rng=np.random.default_rng(0))
    learned = [p for k, p in enumerate(pictures) if k not in TEST]
    trainer = Trainer(learned, start, capture.extent, TrainOptions(steps=1000, cap=CAP, degree=0), NAMES)
    for _ in range(200):
        trainer.step()
    return trainer, [pictures[k] for k in TEST]


def test_objects_of_unseen_photographs_are_met_after_some_hundred_steps(trained):
    trainer, test = trained
    ids = nearest_label(trainer.labels(), 2)
    for k in (1, 2):
        both = [(trainer.seen_objects(p.camera, ids) == k, p.objects == k) for p in test]
        iou = sum((a & b).sum() for a, b in both) / sum((a | b).sum() for a, b in both)
        assert iou > 0.62, k  # of interleaved ellipsoids seen by nine cameras; 0 at the start
    values = trainer.population.labels.value.to_numpy()
    assert_array_equal(values[: trainer.population.count], trainer.labels())  # drawing other ids has left no trace


def test_a_photograph_without_a_mask_teaches_no_labels(trained):
    trainer, _ = trained
    blind = [k for k in range(len(trainer.views)) if trainer.views.at(k, 1.0).mask is None]
    assert len(blind) == 1
    before, means = trainer.labels(), trainer.population.splats.mean.to_numpy()
    trainer._queue.append(blind[0])
    trainer.step()
    assert_array_equal(trainer.labels(), before)
    assert (trainer.population.splats.mean.to_numpy() != means).any()
    trainer._queue.append(0)
    trainer.step()
    assert (trainer.labels() != before).any()


def test_what_is_divided_hands_its_label_down(trained):
    p = trained[0].population
    kept, n = p.read(), p.count
    total, logits = np.zeros(n, np.float32), np.zeros(n, np.float32)
    labels = np.random.default_rng(0).uniform(0.0, 1.0, (n, 3)).astype(np.float32)
    total[[3, 5]], logits[7] = 1.0, -9.0
    rows = {"gradient_sum": total, "gradient_count": np.ones(n, np.float32), "logit": logits, "label": labels}
    p.write(kept | rows | {"first_label": labels})
    AdaptiveDensity(p, cap=CAP).refine()
    after = p.read()
    assert p.count == n + 1
    assert_array_equal(after["label"][n], labels[3])
    assert_array_equal(after["label"][7], labels[5])  # the last row takes the dead one's place
    assert not after["first_label"][[3, n]].any() and after["first_label"][4].any()
    p.write(kept)


def test_a_checkpoint_keeps_labels(trained, tmp_path):
    trainer, options = trained[0], {"degree": 0, "objects": NAMES}
    write_checkpoint(tmp_path / "a.h5", trainer.state(), options)
    state = read_checkpoint(tmp_path / "a.h5", {**options, "objects": list(NAMES)}, trainer.state(), len(trainer.views))
    kept = {name: trainer.state()[name] for name in LABELS}
    trainer.step()
    assert all((trainer.state()[name] != kept[name]).any() for name in LABELS)
    trainer.restore(state)
    for name in LABELS:
        assert_array_equal(trainer.state()[name], kept[name])


def test_masks_go_through_lens_and_reduction_with_the_photograph(tmp_path):
    import cv2

    lens = Lens(80, 60, 70.0, 70.0, 40.0, 30.0, (-0.2,))
    y, x = np.mgrid[:60, :80]
    ids = np.where((x - 20) ** 2 + (y - 18) ** 2 < 150, 1, np.where(x > 50, 2, 0)).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), (ids * 100)[..., None].repeat(3, axis=2))
    photograph = load_photograph(View(tmp_path / "a.png", lens, np.eye(4)), 3, ids)
    assert photograph.objects.shape == (20, 26) and set(np.unique(photograph.objects)) == {0, 1, 2}
    seen = photograph.pixels[..., 0] / 100.0
    plain = photograph.mask & (np.abs(seen - np.rint(seen)) < 0.05)  # no border between objects
    assert plain.mean() > 0.5 and (np.rint(seen) == photograph.objects)[plain].all()
