"""`vrgs.py figures` at a tiny size: a page that holds its pictures, and numbers beside theory."""

import base64
import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from bench import paper_figures
from bench.bar_figures import TwistedBar, crossing_frequency
from core.report import Section
from prepare.train.capture import Lens, View
from tests.support import painted_capture
from tests.support import reference_render as reference
from vrgs import main


def pictures(page: str) -> list[np.ndarray]:
    """The pictures that a page holds."""
    found = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    return [cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR) for data in found]


def test_pictures_of_a_figure_lose_the_edges_that_all_of_them_leave_empty():
    one, two = np.full((60, 100, 3), 245, np.uint8), np.full((60, 100, 3), 245, np.uint8)
    one[20:30, 40:45], two[20:30, 50:60] = 0, 9
    pictures = paper_figures.cropped({"one": one, "two": two})
    margin = paper_figures.MARGIN
    assert {p.shape for p in pictures.values()} == {(10 + 2 * margin, 20 + 2 * margin, 3)}
    assert (pictures["one"][margin + 5, margin : margin + 5] == 0).all()
    assert paper_figures.cropped({"empty": np.zeros((4, 8, 3), np.uint8)})["empty"].shape == (4, 8, 3)


def test_a_frequency_is_read_off_its_crossings():
    time = np.arange(120) * paper_figures.FRAME
    assert abs(crossing_frequency(np.cos(2 * np.pi * 2.3 * time)) - 2.3) < 0.01
    assert np.isnan(crossing_frequency(np.ones(10)))


def test_a_twisted_bar_agrees_with_theory(ti_cpu):
    bar = TwistedBar(paper_figures.striped_bar())
    found = bar.twist(0.35, (0.3, 0.2, 0.7), "xpbd", draw=False)
    assert found.error < 0.03 and abs(found.volume - 1) < 0.01
    measured, theory = found.frequency
    assert abs(measured / theory - 1) < 0.12
    assert found.left < 1.0 and not found.pictures


def test_what_is_interrupted_leaves_a_page_of_the_figures_that_are_made(tmp_path, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(paper_figures, "striped_bar", lambda: None)
    monkeypatch.setattr(paper_figures, "running_arch", lambda: "cpu")
    monkeypatch.setattr(paper_figures, "embedding_section", lambda *_: Section("the first", "text", {}))
    monkeypatch.setattr(paper_figures, "shadow_section", interrupted)
    with pytest.raises(KeyboardInterrupt):
        paper_figures.run(out=tmp_path, quick=True, capture=None)
    page = (tmp_path / "figures.html").read_text()
    assert "the first" in page and "Not finished: 1 of 6 figures." in page and (tmp_path / "figures.json").is_file()


@pytest.mark.long
def test_the_quick_page_is_whole(tmp_path):
    out = tmp_path / "figures"
    assert main(["figures", "--out", str(out), "--quick", "--arch", "cpu"]) == 0
    assert sorted(p.name for p in out.iterdir()) == ["figures.html", "figures.json"]
    page, numbers = (out / "figures.html").read_text(), json.loads((out / "figures.json").read_text())
    shown = pictures(page)
    assert len(shown) == 1 + 2 + 4 + 1 and all(p.std() > 4 for p in shown)
    with_shadow, without = shown[1:3]
    assert without.astype(float).mean() > with_shadow.mean() and numbers["shadow"]["pixels"] > 0.001
    one, two = numbers["embedding"]
    assert one["scheme"] == "one-level" and two["jump"] < one["jump"]
    assert numbers["demos"].keys() == {paper_figures.SHADOWED}
    assert "PhysGaussian" in page and "PAC-NeRF" in page


def test_an_object_that_cannot_be_inpainted_is_named(monkeypatch):
    picture = np.zeros((4, 16, 3), np.uint8)
    seen = {"photographed": 28.0, "unseen": 19.0, "holes": 0.01, "outside": 0.02}
    closed = {"psnr": {"before": 20.0, "after": 25.0}, "area": 0.01, "turned": seen}
    closed |= {"picture": picture, "turned_picture": picture}
    rows = {"duck": closed, "ball": {"refused": "ball: no camera sees it"}}
    monkeypatch.setattr(paper_figures, "measured_objects", lambda folder, steps, objects: rows)
    section = paper_figures.inpainting_section(Path(), {}, quick=False)
    assert len(section.pictures) == 2 and section.note.endswith("Not closed: ball: no camera sees it.")
    assert section.table.rows == [("duck", "20.0 dB", "25.0 dB", "100 cm²", "28.0 dB", "19.0 dB", "1.0%", "2.0%")]


def test_a_turned_object_is_compared_with_pictures_of_it_alone(ti_cpu, tmp_path):
    """As it is it agrees; without a third of its Gaussians it has holes, and twice as wide it is drawn outside."""
    painted, views = replace(painted_capture.painted_gaussians(), sort="z"), []
    for k, camera in enumerate(painted_capture.cameras()[:4]):
        color, alpha, _ = reference.render(painted, camera)
        color = color / np.maximum(alpha, 1e-3)[..., None]
        rgba = np.dstack([color[..., ::-1], alpha]).clip(0.0, 1.0)
        seen = np.arange(camera.width) < camera.width // 2
        cv2.imwrite(str(tmp_path / f"{k}.png"), (255 * rgba).round().astype(np.uint8))
        cv2.imwrite(str(tmp_path / f"m{k}.png"), np.tile(255 * seen.astype(np.uint8), (camera.height, 1)))
        lens = Lens(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
        views.append(View(tmp_path / f"{k}.png", lens, camera.world_to_camera, tmp_path / f"m{k}.png", cut_out=True))
    found, picture = paper_figures.turned(painted, views)
    assert found["photographed"] > 40 and found["unseen"] > 40 and found["holes"] == found["outside"] == 0
    assert picture.shape == (2 * painted_capture.SIDE, 4 * painted_capture.SIDE, 3)
    half = replace(painted, sh=painted.sh * (painted.means[:, :1, None] < 0.0))  # grey on one side: both halves suffer
    assert paper_figures.turned(half, views)[0]["photographed"] < 25
    assert paper_figures.turned(painted.select(np.arange(len(painted)) % 3 > 0), views)[0]["holes"] > 0.05
    wide = replace(painted, log_scales=painted.log_scales + np.float32(np.log(2.0)))
    assert paper_figures.turned(wide, views)[0]["outside"] > 0.03


def test_a_file_in_the_way_is_told_in_one_line(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["figures", "--out", str(tmp_path / "file")]) == 2
    error = capsys.readouterr().err
    assert "is a file, not a folder" in error and error.count("\n") == 1
