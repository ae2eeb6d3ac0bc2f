"""`vrgs.py tune`: stiffer deforms less, the strip shows it, and what cannot be dropped is refused in a line."""

import json

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

import vrgs
from core.errors import BadInput
from core.material import MATERIALS, Material
from display.headless import stiffness_sweep as tune
from display.headless.stiffness_sweep import FOOT, GAP, HEAD, MARGIN, PANEL

YOUNGS = (1e4, 1e5)


@pytest.fixture(scope="module")
def dropped(ti_cpu, tmp_path_factory):
    """The rows and the strip of a ring, dropped with two stiffnesses."""
    folder = tmp_path_factory.mktemp("tune")
    out, table = folder / "strip.png", folder / "table.json"
    options = ["--young", *map(str, YOUNGS), "--height", "0.3", "--out", str(out), "--json", str(table)]
    assert vrgs.main(["tune", "ring_red", *options]) == 0
    return json.loads(table.read_text()), cv2.imread(str(out))[..., ::-1]


def test_stiffer_deforms_less_and_bounces(dropped):
    soft, stiff = dropped[0]
    assert [soft["young"], stiff["young"]] == list(YOUNGS)
    assert 0.5 > soft["compression"] > 1.5 * stiff["compression"] > 0
    assert 0 < soft["rebound"] < 0.3 and 0 < stiff["rebound"] < 0.3
    assert 0.9 < soft["settled"] < stiff["settled"] + 0.02 < 1.05
    assert soft["finite"] and stiff["finite"]
    assert 2.5 < soft["dt"] / stiff["dt"] < 3.8  # as the square root of ten, but for whole substeps


def test_the_strip_shows_the_body_in_each_panel(dropped):
    page = dropped[1].astype(int)
    assert page.shape == (HEAD + 2 * (PANEL + FOOT) + MARGIN, 2 * MARGIN + 2 * PANEL + GAP, 3)
    for top in (HEAD, HEAD + PANEL + FOOT):
        for left in (MARGIN, MARGIN + PANEL + GAP):
            panel = page[top : top + PANEL, left : left + PANEL]
            red = (panel[..., 0] > panel[..., 1] + 60) & (panel[..., 0] > panel[..., 2] + 60)
            columns = np.nonzero(red)[1]
            assert 0.03 < red.mean() < 0.5
            assert abs(columns.mean() - PANEL / 2) < PANEL / 8
            assert (panel[:20] > 200).all()  # the backdrop


@pytest.mark.parametrize(
    ("name", "why"), [("bottle", "no cage"), ("nothing", "no such asset"), (__file__, "unknown kind of file")]
)
def test_what_cannot_be_dropped_is_refused(name, why, capsys):
    assert vrgs.main(["tune", name]) == 2
    error = capsys.readouterr().err
    assert why in error and error.count("\n") == 1


def test_the_undeformed_height_is_that_of_the_nearest_rotation():
    rest = np.random.default_rng(0).uniform(size=(40, 3)) * [0.4, 0.2, 0.1]
    assert_allclose(tune.undeformed_height(rest, rest + 3.0), np.ptp(rest[:, 1]))
    lying = rest[:, [1, 0, 2]] * [-1, 1, 1]  # a quarter turn about z
    assert_allclose(tune.undeformed_height(rest, 0.7 * lying), np.ptp(rest[:, 0]))


def test_the_materials_are_listed_and_in_range(capsys):
    assert vrgs.main(["materials"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1:]] == list(MATERIALS)
    for name in MATERIALS:
        m = Material.named(name)
        assert 1e2 <= m.young <= 1e8 and 0 <= m.poisson <= 0.49 and 10 <= m.density <= 10_000
        assert Material.named(name, young=1.0).young == 1.0
    with pytest.raises(BadInput, match="foam"):
        Material.named("glass")
