"""`vrgs.py capture`: a modelled capture becomes a room that can be played, and goes on where it was cut."""

import json
import os
from types import SimpleNamespace

import numpy as np
import pytest

from assets.asset import Asset
from assets.environment import Environment
from assets.file_access import FOLDER_LOCK, locked_folder
from assets.gaussians import Gaussians
from commands.capture_room import STAGES, RoomMaking, played, spent, stages_before
from commands.parser import parse
from core.errors import BadInput
from core.report import html_page
from prepare.room_capture.stages import Stages
from prepare.segment.marks import read_marks
from prepare.train.capture_files import read_capture
from studio.procedural_capture import CaptureOptions, write_procedural_capture

ROOM = "--reduce 1 --steps 400 --vertices 200"


def run(words: str) -> None:
    command, options = parse(words.split())
    command(options)


@pytest.mark.long
def test_a_modelled_capture_becomes_a_room(tmp_path, ti_cpu, capsys):
    toys, out = tmp_path / "toys", tmp_path / "room"
    write_procedural_capture(toys, CaptureOptions(views=16, size=(200, 150)), lambda line: None)
    run(f"capture {toys} --out {out} {ROOM}")
    said = capsys.readouterr().err
    room = json.loads((out / "room.json").read_text())
    names = {thing["name"] for thing in room["objects"]}
    left = {name for name in ("teddy", "duck", "parcel", "ring", "ball") if f"{name} stays in the background" in said}
    assert {"teddy", "parcel"} <= names and not names & left and len(names | left) == 5
    assert {path.stem for path in (out / "objects").iterdir()} == names
    background = Asset.load(out / "room.h5")
    for thing in room["objects"]:  # nothing solid is where an object stands
        body = Asset.load(out / thing["asset"])
        inside = body.cage.vertices.mean(axis=0) + thing["position"]
        assert background.sdf.sample(inside[None])[0] > 0
    assert np.isfinite(background.gaussians.means).all() and (out / "report.html").stat().st_size > 10_000
    run(f"capture {toys} --out {out} {ROOM}")
    assert capsys.readouterr().err.count("kept from an earlier run") == 6


def test_marks_tell_the_object_of_each_gaussian(tmp_path, ti_cpu):
    toys = tmp_path / "toys"
    write_procedural_capture(toys, CaptureOptions(views=8, size=(96, 72)), lambda line: None)
    args = parse(f"capture {toys} --out {tmp_path / 'room'}".split())[1]
    making = RoomMaking(args, Stages(tmp_path / "work", STAGES))
    making.capture, making.reduce = read_capture(toys), 1
    sizes = {view.name: (96, 72) for view in making.capture.views}
    making.masks, making.marks = None, read_marks(toys / "marks.json", sizes)
    points = making.capture.points
    still, log_scales = np.tile([1.0, 0.0, 0.0, 0.0], (len(points), 1)), np.full((len(points), 3), np.log(0.01))
    making.gaussians = Gaussians.of(points, still, log_scales, np.full(len(points), 4.0), np.zeros((len(points), 1, 3)))
    making.segment()
    assert making.gaussians.objects == tuple(making.marks.objects)
    counts = np.bincount(making.gaussians.object_id, minlength=6)
    assert counts[0] > counts[1:].sum() and (counts[1:] > 10).sum() >= 4, counts  # the pictures are tiny


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("nowhere --out {0}/room --no-objects", "no such file or folder"),
        ("{0} --out {0}/file --no-objects", "is a file"),
        ("{0} --out {0}/room --material cheese", "no material named"),
        ("{0} --out {0}/room --marks {0}/none.json", "no such file or folder"),
        ("{0} --out {0}/room --lama {0}/file", "a network is an .onnx file"),
        ("{0} --out {0}/room --no-objects --scale-points 1,2 1,2,3 1", "neither PHOTOGRAPH"),
        ("{0} --out {0}/room --no-objects --scale-points 1,2,3 1,2,4 -1", "not a length"),
    ],
)
def test_what_is_wrong_is_said_before_anything_is_made(tmp_path, words, why):
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match=why):
        run("capture " + words.format(tmp_path))
    assert not (tmp_path / "room").exists()


def test_a_room_that_another_run_writes_is_left_alone(tmp_path, monkeypatch):
    """So is a folder to which `segment` writes the objects of a splat."""
    write_procedural_capture(tmp_path / "toys", CaptureOptions(views=3, size=(48, 36)), lambda line: None)
    room = tmp_path / "room"
    splat = f"segment {tmp_path}/toys.ply --marks {tmp_path}/marks.json --out {room}"
    told = rf"room is being written by another run of vrgs \(process {os.getpid()}\)"
    with locked_folder(room):
        for words in (f"capture {tmp_path / 'toys'} --no-objects --out {room}", splat):
            with pytest.raises(BadInput, match=told):
                run(words)
        assert [path.name for path in room.iterdir()] == [FOLDER_LOCK]
    with pytest.raises(BadInput, match="no such file"):
        run(splat)
    assert not room.exists()

    def held(making) -> None:
        with pytest.raises(BadInput, match="another run"), locked_folder(making.options.out):
            pass
        (making.options.out / "made.txt").touch()

    monkeypatch.setattr(RoomMaking, "make", held)
    monkeypatch.setattr("commands.capture_room.start_taichi", lambda arch, seed: None)
    run(f"capture {tmp_path / 'toys'} --no-objects --out {room}")
    assert [path.name for path in room.iterdir()] == ["made.txt"]


def test_the_report_tells_how_to_play_what_is_free_and_what_each_stage_took(tmp_path):
    def told(on: str) -> str:
        place = Environment(-0.1, (0.0, 0.5, 0.0), (0.0, 1.5, 0.0), 0.18)
        room = SimpleNamespace(environment=place, provenance={"drop_on": on})
        return played(tmp_path / "attic", room, (0.0, 1.5, 0.0)).text

    assert told("table").startswith(
        "A body of yours falls 1.0 m from the eye, onto the table at a height of 60 cm, with"
    )
    assert "onto the floor, with 18 cm" in told("floor") and "no level place was captured" in told("nothing")
    (tmp_path / "walk.mp4").touch()
    stages = (*stages_before(tmp_path / "walk.mp4"), *STAGES)
    page = html_page("attic", "", [spent(dict.fromkeys(stages, 2.0))])
    assert all(f"<td>{name}</td>" in page for name in stages) and "<td>16.0</td>" in page
