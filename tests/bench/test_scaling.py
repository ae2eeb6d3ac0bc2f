"""`vrgs.py bench scaling`: what it makes of rows, the plot, and what it refuses. No measurement."""

import json
import xml.etree.ElementTree as ET

import numpy as np
import pytest

import vrgs
from assets.gaussians import Gaussians
from bench import scaling
from bench import synthetic_room as rooms
from bench.plot import Panel, svg


def rows(device: str, factor: float) -> list[dict]:
    """Rows as --json writes them; the time is proportional to what it is measured by."""
    made = []
    for by, xs in (("gaussians", scaling.MILLIONS), ("pixels", scaling.MEGAPIXELS)):
        for x in xs:
            row = {"bench": "scaling", "device": device, "by": by, "x": x, "pairs": round(1e7 * x)}
            made.append({**row, "median_ms": factor * x})
    return made


@pytest.fixture
def files(tmp_path):
    """Rows of two devices; the second was too slow for the largest room."""
    for name, device, factor in (("a", "A & B", 2.0), ("b", "2 CPU cores", 1234.5)):
        found = [r for r in rows(device, factor) if (device, r["x"]) != ("2 CPU cores", 10.0)]
        (tmp_path / f"{name}.json").write_text(json.dumps(found))
    return tmp_path


def test_rows_of_two_devices_become_one_table_and_one_picture(files, capsys):
    out = files / "plot.svg"
    words = ["bench", "scaling", "--from", str(files / "a.json"), str(files / "b.json")]
    assert vrgs.main([*words, "--plot", str(out), "--json", str(files / "both.json")]) == 0
    table = capsys.readouterr().out
    assert "| million Gaussians | A & B | 2 CPU cores |" in table
    assert "| 3 | 6.00 (30.0) | 3,700 (30.0) |" in table and "| 10 | 20.0 (100.0) | – |" in table
    assert "| 16 | 32.0 (160.0) | 19,800 (160.0) |" in table
    assert len(json.loads((files / "both.json").read_text())) == 21
    picture = ET.fromstring(out.read_text(encoding="utf-8"))
    curves = [e for e in picture.iter() if e.tag.endswith("polyline")]
    assert [len(c.get("points").split()) for c in curves] == [5, 4, 6, 6]
    texts = [e.text for e in picture.iter() if e.tag.endswith("text")]
    assert {"A & B", "2 CPU cores", "megapixels", "0.1", "16"} <= set(texts)
    assert sorted(p.name for p in files.iterdir()) == ["a.json", "b.json", "both.json", "plot.svg"]


def test_on_logarithmic_axes_what_is_proportional_is_a_straight_line_within_them():
    panel = Panel("title", "x", "y", {"line": [(x, 3e-3 * x) for x in (1, 10, 100)], "one": [(10, 50.0)]}, (1, 10, 100))
    picture = ET.fromstring(svg([panel]))
    line = next(e for e in picture.iter() if e.tag.endswith("polyline"))
    points = np.array([p.split(",") for p in line.get("points").split()], float)
    np.testing.assert_allclose(points[1] - points[0], points[2] - points[1], atol=0.11)
    _, _, width, height = map(float, picture.get("viewBox").split())
    places = [(float(e.get("cx")), float(e.get("cy"))) for e in picture.iter() if e.get("cx")]
    assert len(places) == 6 and all(0 < x < width and 0 < y < height for x, y in places)


@pytest.mark.parametrize(
    ("content", "words", "what"),
    [
        (None, [], "rows.json: cannot be read"),
        ("[1,", [], "rows.json: not JSON"),
        ("\xff", [], "rows.json: not JSON"),
        ("[]", [], "rows.json: holds no rows of bench scaling"),
        ('[{"bench": "render"}]', [], "rows.json: holds no rows of bench scaling"),
        (rows("x", float("nan")), [], "rows.json: holds no rows of bench scaling"),
        (rows("x", -1.0), [], "rows.json: holds no rows of bench scaling"),
        (rows("x", 1.0), ["--plot", "plot.png"], "plot.png: the plot's name must end in .svg"),
        (rows("x", 1.0), ["--plot", "nowhere/plot.svg"], "nowhere/plot.svg: cannot write here"),
        (rows("x", 1.0), ["--json", "nowhere/rows.json"], "nowhere/rows.json: cannot write here"),
    ],
)
def test_what_cannot_be_is_told_in_one_line(tmp_path, monkeypatch, capsys, content, words, what):
    monkeypatch.chdir(tmp_path)
    if content is not None:
        text = content if isinstance(content, str) else json.dumps(content)
        (tmp_path / "rows.json").write_text(text, encoding="latin-1")
    assert vrgs.main(["bench", "scaling", "--from", "rows.json", *words]) == 2
    said = capsys.readouterr()
    assert what in said.err and said.err.count("\n") == 1 and not said.out
    assert {p.name for p in tmp_path.iterdir()} <= {"rows.json"}


def test_pictures_have_the_pixels_that_are_named_and_sides_that_no_tile_divides():
    for megapixels in scaling.MEGAPIXELS:
        width, height = scaling.sides(megapixels)
        assert width * height == pytest.approx(1e6 * megapixels, rel=1e-3) and width / height == pytest.approx(
            4 / 3, rel=2e-3
        )
        assert width % 16 or height % 16


def test_a_room_is_the_same_whether_it_is_made_in_pieces_or_at_once(monkeypatch):
    """Large rooms are made in pieces, for the sake of memory."""
    whole = rooms.room(3000)
    monkeypatch.setattr(rooms, "PIECE", 700)
    pieces = rooms.room(3000)
    for name in Gaussians.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(pieces, name), getattr(whole, name))


def test_a_slow_device_draws_three_pictures_and_no_more():
    from bench.render_speed import times

    drawn = []
    assert len(times(drawn.append, lambda: None, 32, 32, 50, warm=2, most=0.0)) == 3 and len(drawn) == 5
    assert len(times(drawn.append, lambda: None, 32, 32, 4)) == 4
