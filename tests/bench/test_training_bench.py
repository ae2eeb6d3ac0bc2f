"""`vrgs.py bench train`: rows of quality and speed."""

import json

import pytest

from tests.support.painted_capture import write_capture
from vrgs import main


def test_a_training_is_measured(ti_cpu, tmp_path, capsys):
    write_capture(tmp_path / "painted")
    words = ["bench", "train", str(tmp_path / "painted"), "--steps", "24", "--at", "12", "--cap", "300"]
    assert main([*words, "--variants", "fast", "--arch", "cpu", "--json", str(tmp_path / "rows.json")]) == 0
    said = capsys.readouterr().out
    rows = json.loads((tmp_path / "rows.json").read_text())
    assert [row["step"] for row in rows] == [12, 24] and rows[1]["psnr"] > rows[0]["psnr"] > 12.0
    assert all(row["steps_per_second"] > 0 and 0 < row["gaussians"] <= 300 for row in rows)
    assert all(len(row["psnr_of_each"]) == row["test_views"] for row in rows)
    assert sum(rows[1]["psnr_of_each"]) / rows[1]["test_views"] == pytest.approx(rows[1]["psnr"], abs=0.01)
    assert "painted    fast" in said
