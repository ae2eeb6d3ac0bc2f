"""Photographs of `vrgs.py capture`: objects are asked for, or refused, before poses are found."""

import shutil
import sys
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from commands import capture_room, train
from commands.capture_room import (
    CaptureOptions,
    capture_key,
    default_reduction,
    marks_in,
    photographed,
    stages_before,
)
from core.errors import BadInput
from prepare.room_capture.stages import Stages
from prepare.segment.marks import Marks, ViewMarks, write_marks
from prepare.train.capture import Capture, Lens, View
from prepare.train.capture_files import read_capture

NAMES = [f"{k}.png" for k in range(5)]
LOST = "3.png"  # the pose of which is not found
BALL = Marks({"ball": {"1.png": ViewMarks(inside=[np.array([[3.0, 3.0]])])}})


def pictures(folder) -> None:
    """Photographs without poses."""
    folder.mkdir(parents=True)
    for name in NAMES:
        cv2.imwrite(str(folder / name), np.full((48, 64, 3), 90, np.uint8))


def film(path) -> None:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30, (64, 48))
    for k in range(5):
        writer.write(np.full((48, 64, 3), 40 * k, np.uint8))
    writer.release()


def model(folder, names) -> None:
    """A COLMAP model of cameras side by side."""
    folder.mkdir()
    (folder / "cameras.txt").write_text("1 PINHOLE 64 48 60 60 32 24\n")
    (folder / "images.txt").write_text("".join(f"{k + 1} 1 0 0 0 {-k} 0 0 1 {n}\n\n" for k, n in enumerate(names)))
    (folder / "points3D.txt").write_text("1 0 0 20 255 0 0 0.1 1 0\n")


@pytest.fixture
def run(tmp_path, monkeypatch):
    """`photographed` of a path; `run.done` lists what is done: poses are made up, the user has marked the ball."""
    done = []

    def find_poses(images, into, *, names, in_order, progress):
        done.append("poses in order" if in_order else "poses")
        model(into, [name for name in names if name != LOST])

    def mark(capture, sizes, path):
        done.append(f"asked for {path.relative_to(tmp_path)}")
        name = next(iter(sizes))
        marks = Marks({"ball": {name: BALL.objects["ball"]["1.png"]}})
        path.parent.mkdir(exist_ok=True)
        write_marks(path, marks)
        return marks

    monkeypatch.setattr(train, "load_pycolmap", lambda: None)
    monkeypatch.setattr(train, "find_poses", find_poses)
    monkeypatch.setattr(capture_room, "marked_photographs", mark)
    monkeypatch.setattr("display.window.gl_window.has_display", lambda: True)

    def go(path, **options):
        wanted = CaptureOptions(capture=path, out=tmp_path / "room", **options)
        stages = Stages(tmp_path / "room" / "work", (*stages_before(path), "train"))
        capture, marks, masks = photographed(wanted, stages, done.append, None)
        return SimpleNamespace(capture=capture, marks=marks, masks=masks)

    return SimpleNamespace(of=go, done=done)


@pytest.mark.parametrize("where", ["toys", "toys/images"])
def test_objects_are_marked_before_the_poses_are_found(tmp_path, run, where):
    pictures(tmp_path / where)
    found = run.of(tmp_path / "toys")
    assert run.done == ["asked for toys/marks.json", "poses"]
    assert [v.name for v in found.capture.views] == [n for n in NAMES if n != LOST] and found.masks is None
    again = run.of(tmp_path / "toys")
    assert len(run.done) == 2 and list(again.marks.objects) == ["ball"], "neither is done again"


def test_a_training_finds_poses_as_a_capture_does(tmp_path, run):
    pictures(tmp_path / "toys")
    options = train.TrainOptions(capture=tmp_path / "toys", out=tmp_path / "toys.ply")
    for _ in range(2):
        views = train.posed_capture(options).views
        assert [v.name for v in views] == [n for n in NAMES if n != LOST] and run.done == ["poses"]


def test_marks_of_a_video_are_kept_with_its_room(tmp_path, run):
    film(tmp_path / "walk.avi")
    (tmp_path / "marks.json").write_text("of something else beside the video")
    found = run.of(tmp_path / "walk.avi")
    assert run.done[1:] == ["asked for room/marks.json", "poses in order"] and "5 sharp frames" in run.done[0]
    assert all(view.image.is_file() for view in found.capture.views)
    run.of(tmp_path / "walk.avi")
    assert len(run.done) == 3


def test_what_is_wrong_with_the_objects_is_said_before_the_poses_are_found(tmp_path, run, monkeypatch):
    pictures(tmp_path / "toys")
    write_marks(tmp_path / "marks.json", Marks({"ball": {"9.png": BALL.objects["ball"]["1.png"]}}))
    with pytest.raises(BadInput, match=r"in 9\.png: no such photograph"):
        run.of(tmp_path / "toys", marks=tmp_path / "marks.json")
    masks = tmp_path / "toys" / "masks"  # beside the photographs: they are meant
    masks.mkdir()
    (masks / "0.jpg").touch()
    with pytest.raises(BadInput, match=r"no mask in it; a mask is called as its photograph, with the ending \.png"):
        run.of(tmp_path / "toys")
    for name in NAMES:
        cv2.imwrite(str(masks / name), np.zeros((48, 64), np.uint8))
    for given in (None, masks):
        with pytest.raises(BadInput, match="no object in any mask"):
            run.of(tmp_path / "toys", masks=given)
    shutil.rmtree(masks)
    monkeypatch.setattr("display.window.gl_window.has_display", lambda: False)
    with pytest.raises(BadInput, match=r"no display to mark them on: give --marks MARKS\.json"):
        run.of(tmp_path / "toys")
    assert run.done == [] and run.of(tmp_path / "toys", no_objects=True).marks is None


def test_without_pycolmap_nobody_is_asked(tmp_path, run, monkeypatch):
    pictures(tmp_path / "toys")
    monkeypatch.undo()
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(BadInput, match=r"requirements-poses\.txt"):
        run.of(tmp_path / "toys")
    assert not (tmp_path / "room").exists()


def test_marks_of_photographs_without_a_pose_are_left_out():
    mark, said = BALL.objects["ball"]["1.png"], []
    marks = Marks({"ball": {"1.png": mark, LOST: mark}})
    assert list(marks_in(marks, ["0.png", "1.png"], said.append).objects["ball"]) == ["1.png"]
    assert said == ["ball: its marks in 3.png are not used: no pose was found"]
    with pytest.raises(
        BadInput, match=r"'ball' is marked only in 1\.png, 3\.png, whose pose was not found; mark it in"
    ):
        marks_in(marks, ["0.png"], said.append)


def test_a_training_depends_on_photographs_and_poses_not_on_marks_or_rooms_beside_them(tmp_path):
    pictures(tmp_path / "toys" / "images")
    model(tmp_path / "toys" / "sparse", NAMES)

    def key() -> dict:
        return capture_key(read_capture(tmp_path / "toys"))

    before = key()
    (tmp_path / "toys" / "marks.json").write_text("{}")
    (tmp_path / "toys" / "room").mkdir()
    (tmp_path / "toys" / "room" / "room.jpg").write_bytes(b"x")
    assert key() == before
    for name, change in (("sparse/images.txt", b"\n"), ("sparse/points3D.txt", b"2 0 0 30 255 0 0 0.1 1 0\n")):
        path = tmp_path / "toys" / name
        content = path.read_bytes()
        path.write_bytes(content.replace(b" -1 ", b" -2 ") + change)
        assert key() != before
        path.write_bytes(content)
    assert key() == before
    image = tmp_path / "toys" / "images" / NAMES[0]
    image.write_bytes(image.read_bytes() + b"\0")
    assert key() != before


def test_on_a_cpu_photographs_are_reduced(tmp_path, monkeypatch):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((900, 700, 3), np.uint8))
    lens = Lens(1400, 1800, 1000.0, 1000.0, 700.0, 900.0)  # of the original, of which the file is a copy
    capture = Capture(tmp_path, [View(tmp_path / "a.png", lens, np.eye(4))])
    for arch, reduction in (("cpu", 3), ("cuda", 1)):
        monkeypatch.setattr(capture_room, "running_arch", lambda arch=arch: arch)
        assert default_reduction(capture) == reduction
