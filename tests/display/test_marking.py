"""Marking objects: strokes with undo, and the window that makes them."""

import json
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from assets.splat_files import read_gaussians, write_gaussians
from commands.marking import PhotographSubject, edit_of, marks_of_state, state_of
from display.mark.mark_edit import MarkEdit
from display.mark.mark_window import PlacedPicture
from tests.prepare.test_splat_segmentation import balls_on_a_floor
from tests.support.painted_capture import write_capture
from tests.support.waiting import until
from tests.support.xvfb import NEEDS_XVFB, XServer

PROGRAM = Path(__file__).resolve().parents[2] / "vrgs.py"


def test_steps_are_undone_and_redone():
    edit = MarkEdit()
    edit.add("view_1", "inside", [(1, 2), (3, 4)])
    edit.new_object()
    edit.add("view_1", "boxes", [(0, 0), (9, 9)])
    edit.grow(1)
    assert edit.name == "object_2" and edit.state.grow == {"object_2": 1}
    for _ in range(3):
        edit.undo()
    assert edit.name == "object_1" and len(edit.state.marks) == 1
    edit.redo()
    assert edit.state.objects == ("object_1", "object_2")
    edit.undo()
    edit.add("view_1", "outside", [(5, 5)])
    edit.redo()  # what was undone is gone
    assert edit.state.objects == ("object_1",) and len(edit.state.marks) == 2


def test_a_name_is_given_to_one_object_alone():
    edit = MarkEdit()
    edit.add("view_1", "inside", [(1, 2)])
    assert edit.rename("bear") and edit.state.marks[0].object == "bear"
    edit.new_object()
    assert not edit.rename("bear") and not edit.rename("")


def test_numbered_points_are_put_replaced_and_undone():
    edit = MarkEdit()
    edit.put_point("a.png", 0, (1, 2))
    edit.put_point("a.png", 2, (5, 6))
    assert edit.missing_point("a.png") == 1 and edit.missing_point("b.png") == 0 and edit.state.views == ["a.png"]
    edit.put_point("a.png", 2, (7, 8))
    edit.new_object()
    edit.delete()
    marks = marks_of_state(edit.state)
    assert marks.points == {"a.png": [(1.0, 2.0), None, (7.0, 8.0)]} and state_of(marks, {}).points == edit.state.points
    for _ in range(3):
        edit.undo()
    assert edit.state.points["a.png"][2] == (5.0, 6.0)


def test_a_deleted_object_comes_back_with_its_marks():
    edit = MarkEdit()
    edit.add("view_1", "inside", [(1, 2)])
    edit.delete()
    assert edit.state.objects == ("object_1",) and not edit.state.marks  # there is always one
    edit.undo()
    edit.new_object()
    edit.delete()
    assert edit.name == "object_1" and len(edit.state.marks) == 1


def test_an_enlarged_picture_keeps_what_is_under_the_cursor():
    placed = PlacedPicture()
    placed.size, placed.area = (400, 200), (100, 0, 800, 600)
    assert placed.place == (100, 100, 800, 400) and placed.to_picture(500, 300) == (200, 100)
    at = placed.to_picture(300, 200)
    placed.zoom(3, 300, 200)
    np.testing.assert_allclose(placed.to_window(at), (300, 200))
    placed.move(40, -30)
    np.testing.assert_allclose(placed.to_window(at), (340, 170))
    placed.zoom(-9, 300, 200)
    assert placed.place == (100, 100, 800, 400)


def test_marks_of_a_file_come_back_from_the_window():
    edit = MarkEdit()
    edit.add("a.jpg", "inside", [(1, 2), (3, 4)])
    edit.add("b.jpg", "boxes", [(1, 1), (20, 30)])
    edit.grow(-2)
    marks = marks_of_state(edit.state)
    np.testing.assert_array_equal(marks.objects["object_1"]["b.jpg"].boxes[0], [1, 1, 20, 30])
    assert state_of(marks, {"object_1": -2}) == edit.state
    assert not edit_of(marks, {}).changed


def test_the_photograph_shows_at_once_what_a_stroke_selects(tmp_path, monkeypatch):
    from threading import Event
    from types import SimpleNamespace

    import cv2

    from commands import marking

    seen, first_cut = Event(), marking.first_cut
    monkeypatch.setattr(marking, "first_cut", lambda *cut: seen.wait(30) and first_cut(*cut))

    picture = np.full((80, 100, 3), (60, 140, 60), np.uint8)
    picture[20:60, 30:70] = (40, 60, 220)
    cv2.imwrite(str(tmp_path / "a.png"), picture)
    subject = PhotographSubject([SimpleNamespace(name="a.png", image=tmp_path / "a.png")])
    before, edit = subject.picture().astype(int), MarkEdit()
    edit.add("a.png", "inside", [(40, 30), (60, 50)])
    edit.add("a.png", "outside", [(15, 70), (85, 70)])
    assert "one more photograph" in subject.select(edit.state)
    np.testing.assert_array_equal(subject.picture(), before)  # as it was, until the cut is made
    seen.set()
    until(lambda: subject.version)
    changed = np.abs(subject.picture() - 0.75 * before).max(-1) > 5  # the rest is darker
    assert changed[25:55, 35:65].mean() > 0.9 and changed[:15].mean() == 0.0


def test_a_window_that_is_left_leaves_no_folder(tmp_path, monkeypatch):
    from commands import segment
    from core.errors import Cancelled

    def left(*_):
        raise Cancelled(quits=True)

    monkeypatch.setattr("commands.marking.check_window", lambda: None)
    monkeypatch.setattr("commands.marking.SplatSubject", lambda *_: None)
    monkeypatch.setattr("display.mark.mark_window.marked_in_window", left)
    for name in ("read_gaussians", "start_taichi"):
        monkeypatch.setattr(segment, name, lambda *_: [])
    (tmp_path / "kept").mkdir()
    for out in ("new", "kept"):
        with pytest.raises(Cancelled):
            segment.take_objects(segment.SegmentOptions(capture=tmp_path / "a.ply", out=tmp_path / out, arch="cpu"))
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]


@contextmanager
def opened(path: Path, out: Path, words=None):
    """The window on a capture or splat, of `segment` or other words: (screen, its id, process)."""
    with XServer(1210, 690) as screen:
        words = [sys.executable, *(words or [PROGRAM, "segment", path, "--out", out])]
        how = {"env": screen.env, "cwd": PROGRAM.parent, "text": True}
        process = subprocess.Popen(words, stderr=subprocess.PIPE, stdout=subprocess.PIPE, **how)
        try:
            window = screen.wait_for_window(f"Mark {path.name}", seconds=120)
            until(lambda: (screen.pixels()[100:, 400:] > 60).mean() > 0.02)  # the picture is there, not only a pointer
            yield screen, window, process
        finally:
            process.kill()
            process.wait()


def is_red(pixel) -> bool:
    return int(pixel[0]) > 2 * int(pixel[1])


@pytest.mark.long
@pytest.mark.window
@NEEDS_XVFB[1]
def test_strokes_in_the_window_take_a_ball_out(tmp_path):
    """A stroke shows at once what it selects; undone it does not; Enter writes marks and splats."""
    write_gaussians(tmp_path / "balls.ply", balls_on_a_floor()[0])
    out = tmp_path / "out"
    with opened(tmp_path / "balls.ply", out) as (screen, _, process):
        plain = screen.pixels()[320, 694].copy()
        screen.drag((674, 300), (684, 335))
        until(lambda: is_red(screen.pixels()[320, 699]))
        screen.drag((605, 379), (684, 379), button=3)
        until(lambda: screen.pixels()[379, 645].max() < 40)  # a dark stroke
        until(lambda: not is_red(screen.pixels()[320, 762]))
        screen.do("key", "ctrl+z", "key", "ctrl+z")
        until(lambda: np.abs(screen.pixels()[320, 699].astype(int) - plain).max() < 12)
        screen.do("key", "ctrl+y", "key", "ctrl+y")
        until(lambda: is_red(screen.pixels()[320, 699]))
        screen.key("Return")
        text, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    marks = json.loads((out / "marks.json").read_text())
    assert set(marks["objects"]["object_1"]["view_1"]) == {"inside", "outside"}
    assert abs(len(read_gaussians(out / "object_1.ply")) - 1500) < 60
    assert (out / "view_1.png").is_file() and "object_1.ply" in text


@pytest.mark.long
@pytest.mark.window
@NEEDS_XVFB[1]
def test_two_objects_are_marked_on_photographs(tmp_path):
    """Strokes, a name, a box, the next photograph, a cross clicked too early, and Enter."""
    write_capture(tmp_path / "painted")
    kept = tmp_path / "painted" / "marks.json"
    with opened(tmp_path / "painted", tmp_path / "masks") as (screen, window, process):
        screen.drag((680, 320), (740, 340), seconds=0.2)
        until(lambda: is_red(screen.pixels()[330, 710]))
        screen.click(150, 39)
        screen.do("sleep", "0.2", "type", "--delay", "60", "clump")
        screen.key("Return")
        screen.do("sleep", "0.1", "key", "Tab", "sleep", "0.1", "key", "n", "sleep", "0.1", "key", "b", "sleep", "0.2")
        screen.drag((620, 240), (820, 440), seconds=0.2)
        until(lambda: (screen.pixels()[425:445, 720].astype(int) @ (-1, 0, 1)).max() > 120)  # a blue line
        screen.close_window(window)
        screen.do("sleep", "0.3")
        assert process.poll() is None and not kept.exists()
        screen.key("Return")
        until(kept.exists)
    objects = json.loads(kept.read_text())["objects"]
    assert list(objects["clump"]) == ["00.png"] and list(objects["object_2"]) == ["01.png"]
    x, y = np.array(objects["clump"]["00.png"]["inside"][0]).T
    assert 25 < x.min() < x.max() < 40 and 28 < y.min() < y.max() < 36
    assert len(objects["object_2"]["01.png"]["boxes"]) == 1


@pytest.mark.long
@pytest.mark.window
@NEEDS_XVFB[1]
def test_numbered_points_are_marked_in_a_clip_and_in_photographs(tmp_path):
    """A stroke, two points, the second again by its digit; in the next picture the second alone, after N."""
    path, file = tmp_path / "painted", tmp_path / "marks.json"
    write_capture(path)
    code = (
        "import sys; from pathlib import Path; from commands.segment import marked_photographs\n"
        "from prepare.train.capture_files import read_capture\n"
        "c = read_capture(sys.argv[1]); marked_photographs(c, {}, Path(sys.argv[2]), numbered=True)"
    )
    with opened(path, tmp_path, ["-c", code, path, file]) as (screen, _, process):
        screen.drag((680, 320), (740, 340), seconds=0.2)
        screen.do("key", "p", "sleep", "0.2")
        for x, y in ((600, 200), (800, 200), (800, 300)):
            screen.click(x, y)
            screen.do("sleep", "0.2", "key", "2", "sleep", "0.2")
        screen.do("key", "Tab", "sleep", "0.2", "key", "n", "sleep", "0.2")
        screen.click(700, 400)
        screen.do("sleep", "0.2", "key", "Return")
        process.communicate(timeout=60)
    points = json.loads(file.read_text())["points"]
    (first, second), (none, other) = points["00.png"], points["01.png"]
    assert none is None and first[0] < other[0] < second[0] and first[1] < second[1] < other[1]
