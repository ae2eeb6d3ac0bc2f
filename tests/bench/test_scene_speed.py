"""`vrgs.py bench scene`: what happens to its bodies, and the smallest run."""

import json

import numpy as np
import pytest

import vrgs
from assets.asset import Asset
from assets.library import find_asset
from bench.scene_speed import (
    ACTS,
    FRAME,
    MANY,
    PRESS,
    STEP_HEIGHT,
    STRETCH,
    THROW_SPEED,
    WALL,
    Cast,
    body_shape,
    plays_of,
    solver_for,
    vertices_of,
)
from core.errors import BadInput
from core.material import Material
from sim.model import RestShape
from sim.solver import Solver

VERTICES = 300
pytestmark = pytest.mark.usefixtures("ti_cpu")


@pytest.fixture(scope="module", autouse=True)
def own_cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("VRGS_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def shape():
    """A ball of 14 cm."""
    ball = Asset.load(find_asset("ball"))
    return RestShape(ball.cage.vertices, ball.cage.tets, ball.cage.surface, ball.sdf)


@pytest.fixture(scope="module")
def solver(ti_cpu, shape):
    return solver_for([Cast("pair", shape, Material.named("plush"), 2)])


def positions(solver, cast, act, frames, each=lambda: None):
    """Positions (frames, V, 3) after each frame of an act."""
    solver.reset(cast.models)
    solver.restore(cast.start(ACTS[act]))
    found = []
    for k in range(frames):
        solver.step(FRAME, ACTS[act].hands(k, cast.ends(ACTS[act])))
        found.append(solver.snapshot()["x"])
        each()
    return np.array(found)


def test_a_body_is_prepared_once():
    made = body_shape("ball", VERTICES)
    assert abs(len(made.vertices) - VERTICES) < 0.15 * VERTICES and made.sdf is not None
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bench.scene_speed.prepare", None)
        np.testing.assert_array_equal(body_shape("ball", VERTICES).vertices, made.vertices)
    with pytest.raises(BadInput, match="no such asset"):
        body_shape("nothing", VERTICES)


def test_a_dropped_body_falls_and_lands_on_the_edge_of_the_step(solver, shape):
    x = positions(solver, Cast("ball", shape, Material.named("plush"), 1), "drop", ACTS["drop"].frames)
    low = x[..., 1].min(1)
    assert low[0] > 0.4 and STEP_HEIGHT - 0.01 < low[-1] < 0.2 and low.min() > -0.005


def test_a_thrown_body_hits_the_wall_at_full_speed_and_comes_back(solver, shape):
    cast = Cast("ball", shape, Material.named("rubber"), 1)
    x = positions(solver, cast, "throw", ACTS["throw"].frames)
    front, middle = x[..., 0].max(1), x[..., 0].mean(1)
    assert front[0] < WALL - 0.01 < front.max() < WALL + 0.01
    assert middle[0] - cast.start(ACTS["throw"])["x"][:, 0].mean() == pytest.approx(THROW_SPEED * FRAME, rel=0.01)
    assert (np.diff(middle) / FRAME).min() < -0.3 * THROW_SPEED


def test_squeezed_body_is_held_pressed_and_stretched_by_both_hands(solver, shape):
    held = []
    cast = Cast("ball", shape, Material.named("plush"), 1)
    x = positions(solver, cast, "squeeze", 100, lambda: held.append(solver._grasps().grasps))
    length = np.ptp(x[..., 0], axis=1)
    assert all(g is not None for g in held[50])
    assert length.min() < (1 + PRESS) / 2 * length[0] and length.max() > (1 + STRETCH) / 2 * length[0]


def test_bodies_of_a_pile_begin_apart_and_come_to_touch(solver, shape):
    cast = Cast("ball", shape, Material.named("plush"), 2)
    x = positions(solver, cast, "stack", 60)
    n = len(shape.vertices)
    assert x[0][n:, 1].min() > x[0][:n, 1].max()
    assert solver.contacts.constraints.candidate_count[None] > 0
    many = Cast("ball", shape, Material.named("plush"), MANY).start(ACTS["stack"])["x"].reshape(MANY, n, 3)
    low, high = many.min(1), many.max(1)
    apart = ((low[:, None] > high[None]) | (low[None] > high[:, None])).any(-1)
    assert apart[~np.eye(MANY, dtype=bool)].all()


def test_rows_of_a_size():
    assert [p.acts for p in plays_of(["drop", "squeeze", "stack"], 10_000, True)] == [("drop", "squeeze"), ("stack",)]
    assert [(p.acts, p.count) for p in plays_of(["throw", "stack"], 46_000, False)] == [
        (("throw",), 1),
        (("stack",), 20),
    ]
    assert vertices_of("46k") == 46_000 and vertices_of("2.3k") == 2300 and vertices_of("700") == 700
    with pytest.raises(BadInput, match="not a number of vertices"):
        vertices_of("manyk")


def test_the_command_measures_and_writes_rows(tmp_path, capsys, monkeypatch):
    """Of two bodies as in the tests above: their kernels are in the cache."""
    monkeypatch.setattr(Solver, "warm_up", Solver.reset)  # what play may need is compiled in other tests
    out = tmp_path / "rows.json"
    words = ["bench", "scene", "--asset", "ball", "--sizes", str(2 * VERTICES), "--acts", "stack", "--frames", "3"]
    assert vrgs.main([*words, "--materials", "plush", "--arch", "cpu", "--json", str(out)]) == 0
    (row,) = json.loads(out.read_text())
    assert (row["asset"], row["acts"], row["material"], row["frames"]) == ("ball", "stack", "plush", 3)
    assert row["bodies"] == 2 and abs(row["vertices"] / row["size"] - 1) < 0.15
    assert 0 < row["median_ms"] <= row["p99_ms"] <= row["worst_ms"] and row["integrator"] in ("xpbd", "vbd")
    assert row["sound"] and f"{row['median_ms']:.2f}" in capsys.readouterr().out
