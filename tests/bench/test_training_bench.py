"""`vrgs.py bench train`: rows of quality and speed, the time of stages, and variants."""

import json

import pytest

from bench import training_speed
from core.errors import BadInput
from tests.support.painted_capture import write_capture
from vrgs import main


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A painted capture."""
    path = tmp_path_factory.mktemp("bench") / "painted"
    write_capture(path)
    return path


def test_a_training_is_measured_and_its_stages_are_timed(ti_cpu, folder, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(training_speed, "STAGE_STEPS", 2)
    words = ["bench", "train", str(folder), "--steps", "24", "--at", "12", "--cap", "300", "--arch", "cpu"]
    variants = ["degree=1,coarse=0.5,sparse=1,harmonics_every=2,degree_interval=6,resets=0"]
    assert main([*words, "--variants", *variants, "--json", str(tmp_path / "rows.json")]) == 0
    said = capsys.readouterr().out
    rows = json.loads((tmp_path / "rows.json").read_text())
    assert [row["step"] for row in rows] == [12, 24] and rows[1]["psnr"] > rows[0]["psnr"] > 12.0
    assert all(row["steps_per_second"] > 0 and 0 < row["gaussians"] <= 300 for row in rows)
    assert all(len(row["psnr_of_each"]) == row["test_views"] for row in rows)
    assert sum(rows[1]["psnr_of_each"]) / rows[1]["test_views"] == pytest.approx(rows[1]["psnr"], abs=0.01)
    stages = rows[1]["stages_ms"]
    assert len(stages) == 7 and min(stages.values()) > 0.0 and "backward of blend" in said and variants[0] in said


@pytest.mark.parametrize("text", ["spars=1", "coarse=much", "fastest"])
def test_a_variant_that_is_none_is_named(text):
    with pytest.raises(BadInput, match="--variants"):
        training_speed.variant_of(text)
    assert training_speed.variant_of("fast,coarse=0.5,sort=z").coarse == 0.5
