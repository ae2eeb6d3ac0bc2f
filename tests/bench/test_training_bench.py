"""`vrgs.py bench train`: rows of quality and speed, the time of stages, variants, and orders of blending."""

import json

import pytest

from bench import training_speed
from bench.training_orders import default_order, is_row, measure_orders, played_psnr, print_orders
from core.errors import BadInput
from display.run_stats import read_rows
from prepare.train.photographs import Photograph
from prepare.train.train_options import TrainOptions
from render import SORTS
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
    assert all(len(row["psnr_of_each"]) == row["test_views"] for row in rows)
    assert sum(rows[1]["psnr_of_each"]) / rows[1]["test_views"] == pytest.approx(rows[1]["psnr"], abs=0.01)
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
    read, rows, kept = training_speed.read_training_capture(folder, 1, 8), [], []
    about = {"keep": lambda rows: kept.append(len(rows)), "size": (32, 24)}
    measure_orders("painted", read, TrainOptions(steps=25, cap=300, degree=1), rows, **about)
    assert [(r["trained"], r["played"]) for r in rows] == [(a, b) for a in SORTS for b in SORTS]
    assert all(15.0 < row["psnr"] < 30.0 and row["popping"] >= 0.0 for row in rows) and kept == [3, 6, 9]
    assert all(map(is_row, rows))


def order_rows(**own) -> list[dict]:
    """Rows of a table; own: (PSNR [dB], popping, ms) of each order trained for and played, 0.3 dB less for others."""
    numbers = {"bench": "train --orders", "capture": "fox", "steps": 25, "cap": 300, "views": 43, "change": 0.1}
    rows = []
    for trained in SORTS:
        for played in SORTS:
            psnr, popping, ms = own[played]
            row = numbers | {"psnr": psnr - 0.3 * (trained != played), "popping": popping, "ms": ms}
            rows.append(row | {"trained": trained, "played": played, "gaussians": 9, "seconds": 1.0})
    return rows


@pytest.mark.parametrize(
    ("own", "chosen"),
    [
        ({"z": (31.0, 0.5, 1.0), "radial": (30.95, 0.1, 1.1), "pixel": (31.2, 0.0, 2.0)}, "radial"),
        ({"z": (31.0, 0.5, 1.0), "radial": (30.8, 0.1, 1.1), "pixel": (31.0, 0.0, 2.0)}, "z"),
        ({"z": (31.0, 0.5, 1.0), "radial": (30.95, 0.1, 1.1), "pixel": (31.0, 0.0, 1.4)}, "pixel"),
        ({"z": (30.5, 0.5, 1.0), "radial": (30.8, 0.1, 1.1), "pixel": (31.0, 0.0, 2.0)}, "radial"),
    ],
)
def test_the_steadiest_order_is_chosen_that_costs_nothing(own, chosen):
    """0.1 dB and half a picture's time may be lost, and not more."""
    assert default_order(order_rows(**own))[0] == chosen


def test_a_table_goes_on_where_it_was_cut(tmp_path, capsys):
    """All is known: nothing is trained, and no device is needed; of another number of steps nothing is known."""
    rows = order_rows(z=(31.0, 0.5, 1.0), radial=(31.05, 0.1, 1.1), pixel=(31.2, 0.0, 2.0))
    (tmp_path / "rows.json").write_text(json.dumps(rows))
    again = read_rows(tmp_path / "rows.json", "train --orders", is_row)
    measure_orders("fox", (None, [None] * 43, []), TrainOptions(steps=25, cap=300), again)
    print_orders(again)
    said = capsys.readouterr().out
    assert again == rows and "order by: radial" in said and "beside z: radial -0.25 dB, pixel -0.10 dB" in said
    with pytest.raises(AttributeError):  # there is no capture to train from
        measure_orders("fox", (None, [None] * 43, []), TrainOptions(steps=26, cap=300), again)
    (tmp_path / "rows.json").write_text(json.dumps([row | {"trained": "y"} for row in rows]))
    with pytest.raises(BadInput, match="no rows of bench train"):
        read_rows(tmp_path / "rows.json", "train --orders", is_row)


@pytest.mark.parametrize("text", ["spars=1", "coarse=much", "fastest"])
def test_a_variant_that_is_none_is_named(text):
    with pytest.raises(BadInput, match="--variants"):
        training_speed.variant_of(text)
    assert training_speed.variant_of("fast,coarse=0.5,sort=z").coarse == 0.5
