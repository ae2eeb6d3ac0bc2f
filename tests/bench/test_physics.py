"""The physics table in its quick form, and the command that prints it."""

import json

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import vrgs
from bench import check, physics

HERE = [m for m in check.MEASUREMENTS if m.__module__ == physics.__name__]  # tests/sim measures contact


@pytest.mark.usefixtures("ti_cpu")
@pytest.mark.parametrize("measurement", HERE, ids=lambda m: m.__name__)
def test_the_table_holds(measurement):
    rows = list(check.show(check.measured([measurement], quick=True)))
    assert rows
    assert not [r for r in rows if r["pass"] is False]
    if all(r["pass"] is None for r in rows):
        pytest.skip(rows[0]["note"])


def test_another_process_finds_the_same_positions_on_the_cpu(ti_cpu):
    """So that what differs between CUDA and CPU comes from CUDA."""
    if ti_cpu.cfg.arch == ti_cpu.cuda:
        pytest.skip("this is the CPU's half")
    x = physics.agreement_positions(contacts=False)
    assert np.isfinite(x).all()
    assert_array_equal(physics.positions_of_another_process(contacts=False), x)


def measures_with(monkeypatch, *verdicts) -> None:
    """Let the command measure a row for each of these verdicts, in its full form two."""
    given = {"relation": "=", "reference": 1.0, "measured": np.float64(2), "tolerance": 3}
    rows = [{"check": str(v), **given, "pass": v} for v in verdicts]
    measurements = [lambda count=2, row=row: [row] * count for row in rows]
    monkeypatch.setattr(check, "MEASUREMENTS", measurements)
    monkeypatch.setattr(check, "QUICK", {measure: {"count": 1} for measure in measurements})


@pytest.mark.parametrize(
    ("verdicts", "status", "summary"),
    [
        ((True, True), 0, "2 of 2 rows pass;"),
        ((False, True), 1, "1 of 2"),
        ((None, True), 0, "1 of 2 rows pass, 1 without verdict"),
    ],
)
def test_the_command_prints_writes_and_returns_its_verdict(monkeypatch, tmp_path, capsys, verdicts, status, summary):
    measures_with(monkeypatch, *verdicts)
    assert vrgs.main(["--arch", "cpu", "check", "--quick", "--json", str(tmp_path / "t.json")]) == status
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == list(check.HEAD) and lines[-1].startswith(summary)
    assert [line.split()[-1] for line in lines[1:-1]] == [check.VERDICTS[v] for v in verdicts]
    rows = json.loads((tmp_path / "t.json").read_text())
    assert [r["pass"] for r in rows] == list(verdicts)
    assert rows[0] == {
        "check": str(verdicts[0]),
        "relation": "=",
        "reference": 1.0,
        "measured": 2.0,
        "tolerance": 3,
        "pass": verdicts[0],
    }


def test_the_full_form_is_the_default(monkeypatch, capsys):
    measures_with(monkeypatch, True)
    assert vrgs.main(["check"]) == 0
    assert "2 of 2 rows pass" in capsys.readouterr().out


def test_a_place_that_cannot_be_written_is_refused_before_measuring(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(check, "MEASUREMENTS", [])
    assert vrgs.main(["check", "--json", str(tmp_path / "no" / "t.json")]) == 2
    assert "cannot write" in capsys.readouterr().err


def test_a_row_out_of_tolerance_or_not_a_number_fails():
    assert physics.row("", 2.0, 2.01, 0.01)["pass"]
    assert not physics.row("", 2.0, 2.03, 0.01)["pass"]
    assert not physics.row("", 2.0, np.nan, 0.01)["pass"]


def test_a_bound_is_shown_as_a_bound_and_fails_beyond(capsys):
    rows = [physics.at_most("most", 2.0, x) for x in (-9.0, 2.0, 2.1, np.nan)]
    rows += [physics.at_least("least", 2.0, x) for x in (9.0, 2.0, 1.9, np.nan)]
    assert [r["pass"] for r in check.show(rows)] == 2 * [True, True, False, False]
    lines = capsys.readouterr().out.splitlines()[1:]
    assert all("<= 2" in line for line in lines[:4]) and all(">= 2" in line for line in lines[4:])
