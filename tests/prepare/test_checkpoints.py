"""A stopped preparation resumes; its progress on the screen."""

import io
from dataclasses import asdict

import numpy as np
import pytest

from assets.asset import Asset
from assets.splat_files import write_gaussians
from prepare.pipeline import STEPS, VERSION, Options
from prepare.prepared_files import prepare_file
from prepare.progress import Checkpoints, StepProgress
from tests.support.shells import ball


@pytest.fixture
def source(tmp_path, monkeypatch):
    monkeypatch.setenv("VRGS_CACHE", str(tmp_path / "cache"))
    path = tmp_path / "ball.ply"
    write_gaussians(path, ball(2000))
    return path


def test_a_stopped_run_resumes_after_its_last_finished_step(ti_cpu, source, tmp_path):
    """The asset is that of a run that was not stopped; then the cache is empty."""
    how = {"options": Options(vertices=300, up="+y"), "report": lambda line: None}
    whole = Asset.load(prepare_file(source, tmp_path / "whole.h5", **how))

    def stop(step, done):
        if step == "embed":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        prepare_file(source, tmp_path / "out.h5", progress=stop, **how)
    assert not (tmp_path / "out.h5").exists()
    kept = sorted(p.name for p in (tmp_path / "cache").rglob("*.npz"))
    assert kept == ["cage.npz", "fill.npz", "orient.npz", "surface.npz"]

    damaged = next((tmp_path / "cache").rglob("surface.npz"))
    damaged.write_bytes(damaged.read_bytes()[:-500])  # ignored: made again
    seen, lines = [], []
    how["report"] = lines.append
    out = prepare_file(source, tmp_path / "out.h5", progress=lambda step, done: seen.append(step), **how)
    assert list(dict.fromkeys(seen)) == ["surface", "embed", "contact"]
    assert "resumed after the step cage of an earlier run" in lines
    again = Asset.load(out)
    np.testing.assert_array_equal(again.cage.vertices, whole.cage.vertices)
    np.testing.assert_array_equal(again.embedding.host, whole.embedding.host)
    np.testing.assert_array_equal(again.gaussians.means, whole.gaussians.means)
    assert not list((tmp_path / "cache").rglob("*.npz"))


def test_entries_belong_to_a_file_and_options_and_damaged_ones_are_ignored(source):
    made = []

    def make() -> dict:
        made.append(1)
        return {"x": np.arange(1000)}

    def count(**options) -> int:
        np.testing.assert_array_equal(Checkpoints(source, options, 1).step("fill", make)["x"], np.arange(1000))
        return len(made)

    assert [count(vertices=5), count(vertices=5), count(vertices=6)] == [1, 1, 2]
    path = next(Checkpoints(source, {"vertices": 5}, 1).folder.glob("*.npz"))
    whole = path.read_bytes()
    for k, damaged in enumerate((b"", b"PK", whole[:-30], whole[:400] + b"\xff" * 8 + whole[408:])):
        path.write_bytes(damaged)
        assert count(vertices=5) == 3 + k
    np.savez(path, x=np.array([print], dtype=object), allow_pickle=True)
    assert count(vertices=5) == 7  # nothing is unpickled
    source.write_bytes(source.read_bytes() + b"\n")
    assert count(vertices=5) == 8
    Checkpoints(source, {"vertices": 5}, 1).clear()
    assert count(vertices=5) == 9


def test_kept_arrays_that_make_no_sense_are_made_again(ti_cpu, source, tmp_path):
    options = Options(vertices=300, up="+y")
    Checkpoints(source, asdict(options), VERSION).step("surface", lambda: {"psi": np.zeros(3)})
    assert len(Asset.load(prepare_file(source, tmp_path / "out.h5", options, report=print)).cage.tets) > 100


class Terminal(io.StringIO):
    encoding = "utf-8"

    def isatty(self):
        return True


def test_a_terminal_gets_a_bar_and_a_file_gets_lines():
    screen, file = Terminal(), io.StringIO()
    bar, lines = StepProgress(STEPS, screen), StepProgress(STEPS, file)
    for step in STEPS:
        bar(step, 0.0)
        lines(step, 0.0)
    bar("contact", 1.0)
    lines("contact", 1.0)
    assert "\n" not in screen.getvalue() and screen.getvalue().endswith("\r\x1b[K")  # nothing is left of it
    shown = screen.getvalue().split("\r")[1:]
    assert [next(s for s in STEPS if s in line) for line in shown[: len(STEPS)]] == list(STEPS)
    shares = [line.count("█") for line in shown[:-1]]
    assert shares == sorted(shares) and shares[0] == 0 and shares[-1] == 28
    assert [line.split()[1] for line in file.getvalue().splitlines()] == list(STEPS)
