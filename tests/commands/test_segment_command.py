"""`vrgs.py segment`: from a folder and marks to a folder of masks, and what is refused before anything long."""

import json

import cv2
import pytest

from commands.parser import parse
from core.errors import BadInput
from prepare.segment.mask_files import read_masks
from prepare.train.capture_files import read_capture
from tests.support.painted_capture import write_capture


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A capture of 12 small pictures, with marks."""
    path = tmp_path_factory.mktemp("capture")
    write_capture(path)
    clump = {"00.png": {"inside": [[[28, 30], [36, 32]]]}, "03.png": {"inside": [[[28, 30], [36, 32]]]}}
    (path / "marks.json").write_text(json.dumps({"objects": {"clump": clump}}))
    return path


def run(words: str) -> None:
    command, options = parse(words.split())
    command(options)


def test_masks_and_a_sheet_are_written(tmp_path, folder, capsys):
    out = tmp_path / "masks"
    run(f"segment {folder} --marks {folder}/marks.json --out {out} --overlay {tmp_path}/sheet.png")
    views = read_capture(folder).views
    masks = read_masks(out, views)
    assert masks.names == ["clump"] and all(i is not None for i in masks.ids) and masks.pixels("clump") > 100
    assert cv2.imread(str(tmp_path / "sheet.png")).shape[1] == 5 * 320
    run(f"segment {folder} --marks {folder}/marks.json --out {out} --compare {out} --overlay {tmp_path}/sheet.html")
    said = capsys.readouterr()
    assert "clump: IoU 1.000" in said.out and "12 masks" in said.out and "5/6 masks" in said.err
    assert (tmp_path / "sheet.html").read_text().count("<figure") == 12
    assert sorted(p.name for p in tmp_path.iterdir()) == ["masks", "sheet.html", "sheet.png"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--marks {c}/none.json --out {t}/m", "no such file"),
        ("--marks {c}/marks.json --out {c}/images/00.png", "is a file, not a folder"),
        ("--marks {c}/marks.json --out {c}", "which is no mask; choose an empty"),
        ("--marks {c}/marks.json --out {t}/m --overlay {t}/sheet.gif", "must end in .png or .html"),
        ("--marks {c}/marks.json --out {t}/m --model {c}/marks.json", "is an .onnx file"),
        ("--marks {c}/marks.json --out {t}/m --splats {c}/none.ply", "no such file"),
        ("--marks {c}/marks.json --out {t}/m --compare {c}/images", "4096 colours|is not in|colours, at most"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path, folder, words, said):
    with pytest.raises(BadInput, match=said) as e:
        run(f"segment {folder} " + words.format(c=folder, t=tmp_path))
    assert "\n" not in str(e.value) and not list(tmp_path.iterdir())
