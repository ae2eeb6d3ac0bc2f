"""`vrgs.py bench`: rows that are read back, tables and plots, and the smallest run of a measurement."""

import json
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import vrgs
from assets.asset import Asset, Cage
from assets.gaussians import Gaussians
from bench import embedding_ablation, render_speed, scaling
from bench import synthetic_room as rooms
from bench.plot import Panel, svg
from bench.sample_meshes import random_gaussians, tet_bar
from core.tetmesh import boundary_surface


def rows(device: str, factor: float) -> list[dict]:
    """Rows as --json writes them; the time is proportional to what it is measured by."""
    made = []
    for by, xs in (("gaussians", scaling.MILLIONS), ("pixels", scaling.MEGAPIXELS)):
        for x in xs:
            row = {"bench": "scaling", "device": device, "by": by, "x": x, "pairs": round(1e7 * x)}
            made.append({**row, "median_ms": factor * x})
    return made


def test_rows_of_two_devices_become_one_table_and_one_plot(tmp_path, capsys):
    """The second device was too slow for the largest room."""
    for name, device, factor in (("a", "A & B", 2.0), ("b", "2 CPU cores", 1234.5)):
        found = [r for r in rows(device, factor) if (device, r["x"]) != ("2 CPU cores", 10.0)]
        (tmp_path / f"{name}.json").write_text(json.dumps(found))
    words = ["bench", "scaling", "--from", str(tmp_path / "a.json"), str(tmp_path / "b.json")]
    out = tmp_path / "plot.svg"
    assert vrgs.main([*words, "--plot", str(out), "--json", str(tmp_path / "both.json")]) == 0
    table = capsys.readouterr().out
    assert "| million Gaussians | A & B | 2 CPU cores |" in table
    assert "| 3 | 6.00 (30.0) | 3,700 (30.0) |" in table and "| 10 | 20.0 (100.0) | – |" in table
    assert len(json.loads((tmp_path / "both.json").read_text())) == 21
    picture = ET.fromstring(out.read_text(encoding="utf-8"))
    curves = [e for e in picture.iter() if e.tag.endswith("polyline")]
    assert [len(c.get("points").split()) for c in curves] == [5, 4, 6, 6]
    texts = [e.text for e in picture.iter() if e.tag.endswith("text")]
    assert {"A & B", "2 CPU cores", "megapixels", "0.1", "16"} <= set(texts)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.json", "b.json", "both.json", "plot.svg"]


def test_a_proportional_curve_is_a_straight_line_on_logarithmic_axes():
    panel = Panel("title", "x", "y", {"line": [(x, 3e-3 * x) for x in (1, 10, 100)], "one": [(10, 50.0)]}, (1, 10, 100))
    picture = ET.fromstring(svg([panel]))
    line = next(e for e in picture.iter() if e.tag.endswith("polyline"))
    points = np.array([p.split(",") for p in line.get("points").split()], float)
    assert_allclose(points[1] - points[0], points[2] - points[1], atol=0.11)
    _, _, width, height = map(float, picture.get("viewBox").split())
    places = [(float(e.get("cx")), float(e.get("cy"))) for e in picture.iter() if e.get("cx")]
    assert len(places) == 6 and all(0 < x < width and 0 < y < height for x, y in places)


@pytest.mark.parametrize(
    ("content", "words", "what"),
    [
        (None, [], "rows.json: no such file"),
        ("\xff", [], "rows.json: not a JSON file"),
        ('[{"bench": "render"}]', [], "rows.json: holds no rows of bench scaling"),
        (rows("x", float("nan")), [], "rows.json: holds no rows of bench scaling"),
        (rows("x", 1.0), ["--plot", "plot.png"], "plot.png: the plot's name must end in .svg"),
        (rows("x", 1.0), ["--json", "nowhere/rows.json"], "nowhere/rows.json: cannot write here"),
    ],
)
def test_bad_input_is_refused_in_one_line(tmp_path, monkeypatch, capsys, content, words, what):
    monkeypatch.chdir(tmp_path)
    if content is not None:
        text = content if isinstance(content, str) else json.dumps(content)
        (tmp_path / "rows.json").write_text(text, encoding="latin-1")
    assert vrgs.main(["bench", "scaling", "--from", "rows.json", *words]) == 2
    said = capsys.readouterr()
    assert what in said.err and said.err.count("\n") == 1 and not said.out
    assert {p.name for p in tmp_path.iterdir()} <= {"rows.json"}


def test_a_room_is_the_same_whether_its_harmonics_are_made_in_chunks_or_at_once(monkeypatch):
    whole = rooms.room(3000)
    monkeypatch.setattr(rooms, "SH_CHUNK", 700)
    chunks = rooms.room(3000)
    for name in Gaussians.__dataclass_fields__:
        assert_array_equal(getattr(chunks, name), getattr(whole, name))


def test_a_slow_device_draws_three_pictures_and_no_more():
    drawn = []
    assert len(render_speed.times(drawn.append, lambda: None, 32, 32, 50, warm=2, most=0.0)) == 3 and len(drawn) == 5
    assert len(render_speed.times(drawn.append, lambda: None, 32, 32, 4)) == 4


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("turn", [1.3, None])
def test_the_gradients_of_the_ablation_are_those_of_its_motion(turn, axis):
    """Central differences, the ends of the body held in place."""
    rng, deformed = np.random.default_rng(0), embedding_ablation.deformed
    x = np.concatenate([[[-1.0, -2.0, -3.0], [2.0, 1.0, 3.0]], rng.uniform(-0.9, 0.9, (50, 3))])
    _, F = deformed(x, turn, axis)
    for c in range(3):
        step = np.zeros_like(x)
        step[2:, c] = 1e-5
        slope = (deformed(x + step, turn, axis)[0] - deformed(x - step, turn, axis)[0])[2:] / 2e-5
        assert_allclose(F[2:, :, c], slope, atol=1e-8)


def test_two_levels_are_smoother_than_one_and_the_page_shows_them(ti_cpu):
    """A bar of a few tets twisted by 180 degrees: neighbours differ at most half as much as with one level."""
    from prepare.cage.embedding_hosts import embed

    x, tets = tet_bar((4, 16, 4), (0.1, 0.4, 0.1))
    x = (x - [0.05, 0.0, 0.05]).astype(np.float32)
    low, high = (-0.05, 0, -0.05), (0.05, 0.4, 0.05)
    g = random_gaussians(np.random.default_rng(0), 2000, low=low, high=high, sigma=0.002)
    embedded = embed(g.means, g.quats, np.exp(g.log_scales), x, tets)
    bar = Asset(g, Cage(x, tets, boundary_surface(tets)), embedded)
    measured = embedding_ablation.measure_ablations("bar", bar, ["180 degrees"], draw=True)
    (one, (_, redder)), (two, (picture, errors)) = measured
    assert (picture != errors).any() and redder.mean() < errors.mean() - 0.1
    assert two["jump"] < 0.5 * one["jump"] and two["spikes"] <= one["spikes"] < 0.01
    assert 0.05 < two["error"] < 1.2 * one["error"] < 0.6
    page = embedding_ablation.page({("bar, two-level", "180 degrees"): picture})
    assert min(page.shape[:2]) >= embedding_ablation.PANEL and (picture < 200).mean() > 0.02


def test_the_time_to_deform_is_measured(ti_cpu, monkeypatch):
    monkeypatch.setattr(embedding_ablation, "EMBEDDING_BAR", ((8, 2, 2), (1.0, 0.2, 0.2)))
    row = embedding_ablation.measure_deform(1000, 2)
    assert 150 < row["bytes_no_rotation"] < row["bytes"] - 15.9 < 400
    assert abs(row["gb_per_s"] * row["median_ms"] * 1e6 - row["bytes"] * 1000) < 1


def test_the_time_of_a_picture_is_measured(ti_cpu):
    row = render_speed.measure(500, 64, 48, rounds=2)
    assert row["pairs"] > 100 and 0 < row["median_ms"] <= row["worst_ms"] and row["views"] == 2
