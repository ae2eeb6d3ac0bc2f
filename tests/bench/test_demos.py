"""`vrgs.py bench demos`: the smallest demo, measured as all are."""

import json

import pytest

import vrgs
from bench import demos, hitches
from core.material import Material
from core.vocabulary import Body, Hand, Light, Plane
from display.world import World
from scenes import paper_demos, registry
from scenes.paper_demos import PaperDemo
from scenes.scene import Scene

STAGES = ("hands", "simulate", "embed", "shadow", "render")
DEMO = PaperDemo("ring", "ring_toss", 305_000, 28_205, 1, 161)


class Lift:
    """Lifts the ring; begins again after 0.05 s, so that the play does not end with the script."""

    duration = 0.05
    score, message = 0, ""

    def __init__(self):
        self.begun = 0

    def reset(self):
        self.begun += 1

    def update(self, time, bodies):
        assert len(bodies) == 1

    def hands(self, time, bodies):
        return [Hand((0.08, 0.1 + time, 0.0), grip=True, reach=0.1)]

    def verify(self, bodies):
        pass


@pytest.fixture
def game(monkeypatch) -> Lift:
    game = Lift()
    ring = Body("ring_red", Material.named("silicone"), (0.0, 0.1, 0.0))
    light, ground = Light((0.0, 1.0, 0.2)), Plane((0, 0, 0), (0, 1, 0))
    scene = Scene(bodies=[ring], colliders=[ground], light=light, eye=(0, 0.5, 0.6), target=(0, 0.1, 0), game=game)
    monkeypatch.setattr(registry, "load", lambda name, **options: scene)
    monkeypatch.setattr(World, "warm_up", World.reset)  # what play may need is compiled in other tests
    monkeypatch.setattr(paper_demos, "PAPER_DEMOS", (DEMO,))
    return game


@pytest.mark.long
def test_a_demo_is_measured_and_put_beside_the_paper_s(ti_cpu, tmp_path, capsys, game):
    out = tmp_path / "rows.json"
    words = ["bench", "demos", "ring", "--size", "48x40", "--frames", "8", "--quick", "--json", str(out)]
    assert vrgs.main([*words, "--arch", "cpu"]) == 0
    (row,) = json.loads(out.read_text())
    assert (row["demo"], row["gaussians"], row["vertices"], row["tets"]) == ("ring", 2977, 270, 720)
    assert row["frames"] == 8 and row["finite"] and row["detail"] == "shipped" and row["size"] == [48, 40]
    assert set(row["stages"]) == set(STAGES) and all(ms > 0 for ms in row["stages"].values())
    assert 0 < row["median_ms"] <= row["p99_ms"] <= row["worst_ms"] and row["photon_ms"] < row["worst_ms"]
    assert 1000 / row["worst_ms"] <= row["fps"] and row["paper"]["fps"] == 161
    table = capsys.readouterr().out
    assert "0.003M (0.305M)" in table and "(28,205)" in table and "(161)" in table
    assert game.begun >= 4  # two plays, begun again within each


def test_the_first_second_does_not_count_for_the_worst(ti_cpu, monkeypatch, game):
    class Play:
        """Frames of which the first 90 are slow; those of the second play, stage by stage, slower still."""

        size, hand_gaussians = (8, 8), 5

        def __init__(self):
            self.world, self.exact = self, False
            self.timings = self

        def start(self, *, exact):
            self.exact, self.frame_ms, self.photon_ms = exact, [], []

        def play(self, frames, present):
            self.frame_ms += [99.0 if k < demos.FIRST_SECOND else 500.0 if self.exact else 10.0 for k in range(frames)]
            self.photon_ms = list(self.frame_ms)

        def stats(self):
            names = ("gaussians", "vertices", "tets", "integrator", "iterations", "substeps", "finite")
            return dict.fromkeys(names, 9)

        def as_dict(self):
            return {name: {"median_ms": 2.0} for name in STAGES}

    row = demos.measure(DEMO, Play(), 100, demos.FIRST_SECOND)
    assert (row["worst_ms"], row["median_ms"], row["fps"], row["gaussians"]) == (10.0, 10.0, 100.0, 4)


@pytest.mark.long
def test_the_worst_frame_of_each_thing_one_does_is_measured(ti_cpu, tmp_path, capsys, game, monkeypatch):
    monkeypatch.setattr(hitches, "ADDED", "ring_red")
    out = tmp_path / "rows.json"
    words = ["bench", "hitches", "ring", "--size", "48x40", "--json", str(out), "--arch", "cpu"]
    assert vrgs.main(words) == 0
    rows = {row["act"]: row for row in json.loads(out.read_text())}
    acts = "rest touch grasp scale resize material add copy undo save load panel menu light reset"
    assert list(rows) == acts.split()
    assert all(0 < max(row["stages"].values()) < row["worst_ms"] and row["frames"] >= 20 for row in rows.values())
    assert not any(row["kernels"] for row in rows.values())
    assert "commands" in rows["save"]["stages"] and "simulate" in rows["touch"]["stages"]


def test_wrong_names_are_told_in_one_line(ti_cpu, capsys, game):
    assert vrgs.main(["bench", "demos", "rinf", "--arch", "cpu"]) == 2
    assert "rinf: no such demo; there are ring" in capsys.readouterr().err
    assert vrgs.main(["bench", "sim", "ring", "--arch", "cpu"]) == 2
    assert "bench sim takes no names: ring" in capsys.readouterr().err
