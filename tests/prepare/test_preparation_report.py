"""The report of a preparation: numbers that agree with the asset, pictures that show it, a page that stands alone; and
pictures of the axes that may point up, where that is not sure."""

import json
import xml.etree.ElementTree as ET
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from assets.formats.ply import write_ply
from prepare.pipeline import Options, prepare
from prepare.preparation_report import examine, histogram, page_of, report_names, report_texts
from prepare.prepared_files import prepare_file, tell_alternatives
from prepare.report_pictures import HEIGHT, PAPER, STRIP_HEIGHT, STRIP_WIDTH, WIDTH, orientation_strip, strip_name
from tests.support.shells import ball, ring, toy


@pytest.fixture(scope="module")
def made(ti_cpu):
    found = []
    asset = prepare(ball(), Options(vertices=300, scale=0.5, up="+y"), look=found.append)
    return asset, found, *examine(asset, found)


def test_the_numbers_are_those_of_the_ball(made):
    """A ball half a metre across whose lowest part is missing; the cage lies close around the Gaussians."""
    asset, _, numbers, _ = made
    assert numbers["cage"]["vertices"] == len(asset.cage.vertices)
    assert numbers["cage"]["pieces"] == 1 and numbers["cage"]["euler_characteristic"] == 2
    assert_allclose(numbers["cage"]["volume"], asset.cage.volumes().sum())
    assert_allclose(numbers["surface"]["volume"], asset.provenance["figures"]["filled"], rtol=0.02)
    assert_allclose(numbers["dihedral"]["min"], asset.provenance["figures"]["min_dihedral"], atol=0.01)
    assert sum(numbers["dihedral"]["histogram"]) == 6 * len(asset.cage.tets)
    assert_allclose(numbers["enclosure"]["inside"], asset.provenance["figures"]["inside"], atol=1e-3)
    both = numbers["distance"]
    for way in ("gaussians_to_cage", "cage_to_gaussians"):
        assert 0 < both[way]["mean"] < both[way]["p95"] < both[way]["max"] <= both["hausdorff"]
    assert both["gaussians_to_cage"]["max"] < 0.05
    assert 0.1 < both["cage_to_gaussians"]["max"] < 0.25  # the middle of the missing underside is far from all


def test_each_picture_shows_the_body_in_the_middle(made):
    *_, pictures = made
    assert set(pictures) == {"splat", "cells", "surface", "cage", "enclosure"}
    for name, picture in pictures.items():
        assert picture.shape == (HEIGHT, WIDTH, 3) and picture.dtype == np.uint8
        drawn = (np.abs(picture.astype(int) - PAPER) > 4).any(-1)
        assert 0.1 < drawn.mean() < 0.8, name
        assert drawn[HEIGHT // 2, WIDTH // 2], name
        assert not drawn[[0, -1]].any() and not drawn[:, [0, -1]].any(), name
    cells = pictures["cells"].reshape(-1, 3).astype(int)
    assert (cells[:, 2] - cells[:, 0] > 30).sum() > 3000  # what is enclosed shows where it is cut open
    assert (cells[:, 0] - cells[:, 2] > 30).sum() > 1000


class Page(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags, self.sources, self.text = [], [], ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.sources += [value for key, value in attrs if key in ("src", "href")]

    def handle_data(self, data):
        self.text += data


def test_the_page_stands_alone_and_escapes_what_a_file_says(made):
    _, _, numbers, pictures = made
    evil = "<script>alert(1)</script>"
    numbers = numbers | {"asset": numbers["asset"] | {"source": evil}, "notes": [evil]}
    page = Page(page_of(evil, numbers, pictures))
    assert "script" not in page.tags and page.text.count(evil) == 4  # title, heading, source, note
    assert page.tags.count("img") == 5 and page.tags.count("svg") == 1
    assert all(s.startswith("data:image/png;base64,") for s in page.sources)


def test_the_histogram_is_an_svg_with_a_bar_for_each_full_bin(made):
    dihedral = made[2]["dihedral"]
    root = ET.fromstring(histogram(dihedral))
    bars = [r for r in root if r.tag == "rect"]
    assert len(bars) == sum(c > 0 for c in dihedral["histogram"])
    heights = np.array([float(r.get("height")) for r in bars])
    counts = np.array([c for c in dihedral["histogram"] if c])
    assert_allclose((heights / heights.max()) ** 2, counts / counts.max(), atol=2e-3)


def test_both_texts_say_the_same(made):
    *_, numbers, pictures = made
    page, data = report_texts("ball.h5", numbers, pictures, ("said",))
    numbers = json.loads(data)
    assert numbers["notes"] == ["said"] and numbers["cage"]["mesher"] == "stuffing"
    assert numbers["cage"]["cells"] == "adaptive" and "adaptive cells" in page
    assert f"{numbers['cage']['vertices']:,}" in page
    assert [p.name for p in report_names(Path("ball.h5"))] == ["ball.report.html", "ball.report.json"]


CHANCES = {"-y": 0.5, "+y": 0.3, "+z": 0.19, "-z": 0.01}


def test_each_picture_shows_the_thing_with_its_axis_up(ti_cpu):
    """A drop, bright above and dark below: turned over it is dark above; the first picture is as it stands."""
    strip = orientation_strip(toy().transformed(np.diag([1.0, -1.0, -1.0])), "+y", CHANCES)
    assert strip.shape[1] == 3 * STRIP_WIDTH
    middle = slice(STRIP_WIDTH // 3, 2 * STRIP_WIDTH // 3)
    panels = [strip[:STRIP_HEIGHT, k * STRIP_WIDTH : (k + 1) * STRIP_WIDTH][:, middle].mean((1, 2)) for k in range(2)]
    upper, lower = slice(STRIP_HEIGHT // 4, STRIP_HEIGHT // 2), slice(STRIP_HEIGHT // 2, 3 * STRIP_HEIGHT // 4)
    assert panels[0][upper].mean() > panels[0][lower].mean() and panels[1][upper].mean() < panels[1][lower].mean()


def test_an_unsure_preparation_writes_the_strip_and_a_sure_one_removes_it(ti_cpu, tmp_path, monkeypatch):
    """A ring lies as well on one side as on the other."""
    monkeypatch.setenv("VRGS_CACHE", str(tmp_path / "cache"))  # an interrupted preparation of it would be resumed
    write_ply(tmp_path / "ring.ply", ring(1500))
    out, lines = tmp_path / "ring.h5", []
    prepare_file(tmp_path / "ring.ply", out, Options(300), report=lines.append, page=True)
    picture = cv2.imread(str(strip_name(out)))
    asked = next(line for line in lines if line.startswith("which way is up is not sure"))
    assert picture.shape[1] == STRIP_WIDTH * asked.count("--up") and "ring.up.png" in asked
    assert "Which way is up?" in (tmp_path / "ring.report.html").read_text()
    assert json.loads((tmp_path / "ring.report.json").read_text())["notes"] == []
    lines.clear()
    tell_alternatives({"+y": 1.0}, out, None, lines.append)
    assert not strip_name(out).exists() and not lines
