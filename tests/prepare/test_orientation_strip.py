"""Pictures of the axes that may point up, where a preparation is not sure."""

import json

import cv2
import numpy as np

from assets.formats.ply import write_ply
from prepare.pipeline import Options
from prepare.prepared_files import prepare_file, tell_alternatives
from prepare.report_pictures import STRIP_HEIGHT as HEIGHT
from prepare.report_pictures import STRIP_WIDTH as WIDTH
from prepare.report_pictures import orientation_strip, strip_name
from tests.support.shells import ring, toy

CHANCES = {"-y": 0.5, "+y": 0.3, "+z": 0.19, "-z": 0.01}


def test_each_picture_shows_the_thing_with_its_axis_up(ti_cpu):
    """A drop, bright above and dark below: turned over it is dark above; the first picture is as it stands."""
    strip = orientation_strip(toy().transformed(np.diag([1.0, -1.0, -1.0])), "+y", CHANCES)
    assert strip.shape[1] == 3 * WIDTH
    middle = slice(WIDTH // 3, 2 * WIDTH // 3)
    panels = [strip[:HEIGHT, k * WIDTH : (k + 1) * WIDTH][:, middle].mean((1, 2)) for k in range(2)]
    upper, lower = slice(HEIGHT // 4, HEIGHT // 2), slice(HEIGHT // 2, 3 * HEIGHT // 4)
    assert panels[0][upper].mean() > panels[0][lower].mean() and panels[1][upper].mean() < panels[1][lower].mean()


def test_an_unsure_preparation_writes_the_strip_and_a_sure_one_removes_it(ti_cpu, tmp_path, monkeypatch):
    """A ring lies as well on one side as on the other."""
    monkeypatch.setenv("VRGS_CACHE", str(tmp_path / "cache"))  # an interrupted preparation of it would be resumed
    write_ply(tmp_path / "ring.ply", ring(1500))
    out, lines = tmp_path / "ring.h5", []
    prepare_file(tmp_path / "ring.ply", out, Options(300), report=lines.append, page=True)
    picture = cv2.imread(str(strip_name(out)))
    asked = next(line for line in lines if line.startswith("which way is up is not sure"))
    assert picture.shape[1] == WIDTH * asked.count("--up") and "ring.up.png" in asked
    assert "Which way is up?" in (tmp_path / "ring.report.html").read_text()
    assert json.loads((tmp_path / "ring.report.json").read_text())["notes"] == []
    lines.clear()
    tell_alternatives({"+y": 1.0}, out, None, lines.append)
    assert not strip_name(out).exists() and not lines
