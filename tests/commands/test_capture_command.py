"""`vrgs.py capture`: a modelled capture becomes a room that can be played, and goes on where it was cut."""

import json

import numpy as np
import pytest

from assets.asset import Asset
from commands.parser import parse
from core.errors import BadInput
from studio.procedural_capture import CaptureOptions, write_procedural_capture

ROOM = "--reduce 1 --steps 400 --vertices 60"


def run(words: str) -> None:
    args = parse(words.split(), "", print)
    args.run(args)


@pytest.mark.long
def test_a_modelled_capture_becomes_a_room(tmp_path, ti_cpu, capsys):
    toys, out = tmp_path / "toys", tmp_path / "room"
    write_procedural_capture(toys, CaptureOptions(views=10, size=(160, 120)), lambda line: None)
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


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("nowhere --out {0}/room --no-objects", "no such file or folder"),
        ("{0} --out {0}/file --no-objects", "is a file"),
        ("{0} --out {0}/room --material cheese", "no material named"),
        ("{0} --out {0}/room --marks {0}/none.json", "no such file or folder"),
        ("{0} --out {0}/room --no-objects --scale-points 1,2 1,2,3 1", "neither PHOTOGRAPH"),
        ("{0} --out {0}/room --no-objects --scale-points 1,2,3 1,2,4 -1", "no length"),
    ],
)
def test_what_is_wrong_is_said_before_anything_is_made(tmp_path, words, why):
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match=why):
        run("capture " + words.format(tmp_path))
    assert not (tmp_path / "room").exists()
