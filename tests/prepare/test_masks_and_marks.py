"""Masks and marks in files: round trips, and one line for what is wrong."""

import json

import cv2
import numpy as np
import pytest

from core.errors import BadInput
from prepare.segment.marks import Marks, ViewMarks, drawn_boxes, drawn_strokes, read_marks, write_marks
from prepare.segment.mask_files import Masks, object_colors, read_masks, write_masks
from prepare.train.capture import Lens, View

WIDTH, HEIGHT = 24, 16
SIZES = {"a.png": (WIDTH, HEIGHT), "b.png": (WIDTH, HEIGHT), "c.png": (WIDTH, HEIGHT)}


@pytest.fixture
def views(tmp_path):
    """Three photographs."""
    (tmp_path / "images").mkdir()
    for name in SIZES:
        cv2.imwrite(str(tmp_path / "images" / name), np.full((HEIGHT, WIDTH, 3), 90, np.uint8))
    lens = Lens(WIDTH, HEIGHT, 20.0, 20.0, 12.0, 8.0)
    return [View(tmp_path / "images" / name, lens, np.eye(4)) for name in SIZES]


def two_objects() -> Masks:
    ids = np.zeros((HEIGHT, WIDTH), np.uint8)
    ids[2:9, 3:8], ids[4:12, 10:20] = 2, 1
    return Masks(["big bear", "ring"], object_colors(2), [ids, ids[::-1].copy(), None])


def painted(folder, name, pixels):
    folder.mkdir(exist_ok=True)
    cv2.imwrite(str(folder / name), pixels)


def test_masks_survive_their_files(tmp_path, views):
    masks = two_objects()
    for _ in range(2):  # the second time it replaces
        write_masks(tmp_path / "masks", views, masks)
    read = read_masks(tmp_path / "masks", views)
    assert read.names == masks.names and (read.colors == masks.colors).all() and read.ids[2] is None
    assert all((a == b).all() for a, b in zip(read.ids[:2], masks.ids[:2], strict=True))
    assert read.pixels("ring") == 2 * 35
    assert sorted(p.name for p in tmp_path.iterdir()) == ["images", "masks"]


def test_colours_without_names_are_objects_in_their_order(tmp_path, views):
    grey = np.zeros((HEIGHT, WIDTH), np.uint8)
    grey[3:5, 3:5], grey[8:9, 8:9] = 255, 40
    for v in views:
        painted(tmp_path / "masks", v.name, grey)
    masks = read_masks(tmp_path / "masks", views)
    assert masks.names == ["object_1", "object_2"] and masks.colors.tolist() == [[40] * 3, [255] * 3]
    assert (masks.ids[0] == np.where(grey == 255, 2, grey == 40)).all()


def test_colours_of_many_objects_are_distinct():
    colors = object_colors(255)
    assert len({tuple(c) for c in colors.tolist()}) == 255 and colors.max(axis=1).min() > 50


def test_a_folder_with_other_things_is_not_replaced(tmp_path, views):
    folder = tmp_path / "masks"
    folder.mkdir()
    (folder / "thesis.txt").write_text("mine")
    with pytest.raises(BadInput, match=r"thesis\.txt"):
        write_masks(folder, views, two_objects())
    assert (folder / "thesis.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda f: painted(f, "a.png", np.zeros((4, 5), np.uint8)), "5x4, its photograph 24x16"),
        (lambda f: painted(f, "d.png", np.zeros((HEIGHT, WIDTH), np.uint8)), r"d\.png is of no photograph"),
        (lambda f: painted(f, "b.png", np.full((HEIGHT, WIDTH), 77, np.uint8)), r"\(77, 77, 77\) is not in"),
        (lambda f: painted(f, "b.png", np.zeros((HEIGHT, WIDTH), np.uint8)), "'big bear' is seen in 1 of the masks"),
        (lambda f: (f / "a.png").write_text("no picture"), "not an image"),
        (lambda f: [p.unlink() for p in f.glob("*.png")], "no mask in it"),
        (lambda f: [painted(f, n, np.zeros((HEIGHT, WIDTH), np.uint8)) for n in SIZES], "no object in any mask"),
        (lambda f: (f / "objects.json").write_text("{"), "not a JSON file"),
        (lambda f: (f / "objects.json").write_text('{"../x": [1, 2, 3]}'), "cannot be an object's name"),
        (lambda f: (f / "objects.json").write_text('{"x": [0, 0, 0]}'), "is black"),
        (lambda f: (f / "objects.json").write_text('{"x": [1, 2, 3], "y": [1, 2, 3]}'), "two objects"),
    ],
)
def test_wrong_masks_are_named(tmp_path, views, change, text):
    write_masks(tmp_path / "masks", views, two_objects())
    change(tmp_path / "masks")
    with pytest.raises(BadInput, match=text) as e:
        read_masks(tmp_path / "masks", views)
    assert "\n" not in str(e.value)


def test_photographs_of_one_name_cannot_share_a_mask(tmp_path, views):
    twin = View(tmp_path / "other" / "a.jpg", views[0].lens, np.eye(4))
    with pytest.raises(BadInput, match="same mask"):
        write_masks(tmp_path / "masks", [*views, twin], two_objects())


def test_marks_survive_their_file(tmp_path):
    bear = ViewMarks([np.array([[1.0, 2.0], [5.5, 6.0]])], [np.array([[0.0, 0.0]])], [np.array([1.0, 1.0, 9.0, 9.0])])
    marks = Marks({"bear": {"a.png": bear}, "ring": {"b.png": ViewMarks([np.array([[3.0, 3.0]])])}})
    write_marks(tmp_path / "marks.json", marks)
    read = read_marks(tmp_path / "marks.json", SIZES)
    assert read.views == ["a.png", "b.png"] and list(read.in_view("b.png")) == ["ring"]
    for kind in ("inside", "outside", "boxes"):
        one, two = getattr(read.objects["bear"]["a.png"], kind), getattr(bear, kind)
        assert len(one) == len(two) == 1 and (one[0] == two[0]).all()


def test_strokes_and_boxes_are_drawn_where_they_are():
    line = drawn_strokes([np.array([[2.5, 4.5], [9.5, 4.5]]), np.array([[20.5, 10.5]])], (HEIGHT, WIDTH), 1)
    assert line[4, 2:10].all() and line[10, 20] and line.sum() == 9
    assert drawn_boxes([np.array([3.0, 2.0, 7.0, 5.0])], (HEIGHT, WIDTH)).sum() == 12


@pytest.mark.parametrize(
    ("entry", "text"),
    [
        ({"objects": {}}, "0 objects are marked"),
        ([], "no marks; the form is"),
        ({"objects": {"x": {"z.png": {"inside": [[[1, 1]]]}}}}, r"no such photograph; there are a\.png"),
        ({"objects": {"x": {"a.png": {"inside": [[]]}}}}, r"inside\[0\] is \[\], not Nx2"),
        ({"objects": {"x": {"a.png": {"inside": [[[1, True]]]}}}}, r"inside\[0\] is \[\[1, True\]\], not Nx2"),
        ({"objects": {"x": {"a.png": {"inside": [[[1, 99]]]}}}}, "outside of the photograph, 24x16"),
        ({"objects": {"x": {"a.png": {"boxes": [[5, 5, 2, 9]]}}}}, "has no area"),
        ({"objects": {"x": {"a.png": {"strokes": []}}}}, "strokes is unknown"),
        ({"objects": {"x": {"a.png": {}}}}, "0 points"),
        ({"objects": {"x": {"a.png": {"outside": [[[1, 1]]]}}}}, "no stroke inside of it"),
        ({"objects": {"a/b": {"a.png": {"inside": [[[1, 1]]]}}}}, "cannot be an object's name"),
    ],
)
def test_wrong_marks_are_named(tmp_path, entry, text):
    (tmp_path / "marks.json").write_text(json.dumps(entry))
    with pytest.raises(BadInput, match=text) as e:
        read_marks(tmp_path / "marks.json", SIZES)
    assert "\n" not in str(e.value)
