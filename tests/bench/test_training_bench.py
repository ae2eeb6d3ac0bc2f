"""`vrgs.py bench train`: rows of quality and speed, the time of stages, variants, and orders of blending."""

import json

import pytest

from bench import training_speed
from bench.training_orders import measure_orders, played_psnr
from core.errors import BadInput
from prepare.train.photographs import Photograph
from prepare.train.train_options import TrainOptions
from tests.support.painted_capture import painted_gaussians, photographs, write_capture
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
    variants = ["degree=1,coarse=0.5,sparse=1,harmonics_every=2,degree_interval=6,resets=0,budgeted=1"]
    assert main([*words, "--variants", *variants, "--json", str(tmp_path / "rows.json")]) == 0
    said = capsys.readouterr().out
    rows = json.loads((tmp_path / "rows.json").read_text())
    assert [row["step"] for row in rows] == [12, 24] and rows[1]["psnr"] > rows[0]["psnr"] > 12.0
    assert all(row["steps_per_second"] > 0 and 0 < row["gaussians"] <= 300 for row in rows)
    stages = rows[1]["stages_ms"]
    assert len(stages) == 7 and min(stages.values()) > 0.0 and "backward of blend" in said and variants[0] in said


def test_known_gaussians_are_played_as_they_were_painted(ti_cpu):
    """The pictures were drawn in z order; by distance a few pixels differ, and a masked error does not count."""
    shown = photographs()[:2]
    worse = [p.pixels.copy() for p in shown]
    mask = shown[0].mask.copy()
    worse[0][:, :20], mask[:, :20] = 255, False
    hidden = [Photograph(worse[0], mask, shown[0].camera), shown[1]]
    by_z, by_distance = (played_psnr(painted_gaussians(), hidden, sort) for sort in ("z", "radial"))
    assert by_z > 50.0 and 25.0 < by_distance < by_z


@pytest.mark.long
def test_each_order_that_is_trained_is_played_in_all(ti_cpu, folder):
    """Few steps: what is drawn in the order of training is near what is drawn in another, and is no worse."""
    read = training_speed.read_training_capture(folder, 1, 8)
    rows = measure_orders("painted", read, TrainOptions(steps=25, cap=300, degree=1), size=(32, 24))
    assert [(r["trained"], r["played"]) for r in rows] == [
        (a, b) for a in ("z", "radial") for b in ("z", "radial", "pixel")
    ]
    assert all(15.0 < row["psnr"] < 30.0 and row["popping"] >= 0.0 for row in rows)


@pytest.mark.parametrize("text", ["spars=1", "coarse=much", "fastest"])
def test_a_variant_that_is_none_is_named(text):
    with pytest.raises(BadInput, match="--variants"):
        training_speed.variant_of(text)
    assert training_speed.variant_of("fast,coarse=0.5,sort=z").coarse == 0.5
