"""A Python program that plays: `import vrgs`, and the programs of docs/python.md."""

import re
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

import vrgs
from core.errors import BadInput
from tests.support.runtime import runtime

ROOT = Path(__file__).resolve().parents[2]
PUSH, DATASET, FILM = "A random policy that pushes a toy", "A dataset of deformations", "A film without a screen"
PAGE = (ROOT / "docs/python.md").read_text(encoding="utf-8")
PROGRAMS = dict(re.findall(r"## ([^\n]*)\n[^#]*?```python\n(.*?)```", PAGE, re.S))
HAND = [vrgs.Hand((-0.05, 0.06, 0.0), grip=True, reach=0.06)]


def toy_scene(**changes) -> vrgs.Scene:
    """The scene of the first program."""
    bodies = [vrgs.Body("toy_duck", vrgs.Material.named("rubber"))]
    floor = vrgs.Plane((0, 0, 0), (0, 1, 0))
    given = {"light": None, "eye": (0.3, 0.35, 0.5), "target": (0, 0.05, 0), "colliders": [floor], "bodies": bodies}
    return vrgs.Scene(**given | changes)


@pytest.fixture(scope="module")
def sim(unwarmed):
    with vrgs.Simulation(toy_scene(), size=(64, 48), arch="cpu") as made:
        yield made


def pulled(sim, frames: int = 3) -> np.ndarray:
    """Vertices after some frames with a hand that holds the toy and lifts it."""
    sim.reset()
    for k in range(frames):
        sim.step([vrgs.Hand((-0.05, 0.06 + 0.01 * k, 0.0), grip=True, reach=0.06)])
    return sim.vertices(0).copy()


@pytest.fixture
def anew(monkeypatch):
    """Taichi started anew, whose first world finds the kernels of another's; none is compiled that is not needed."""
    monkeypatch.setattr("display.world.World.warm_up", lambda world: None)
    with runtime():
        yield


def test_a_random_policy_pushes_the_toy(anew, capsys):
    exec(PROGRAMS[PUSH], {})
    lines = capsys.readouterr().out.splitlines()
    pushed = [float(re.fullmatch(r"episode \d: pushed by (.*) cm", line)[1]) for line in lines]
    assert len(pushed) == 3 and min(pushed) > 2 and len(set(pushed)) > 1


def test_a_dataset_holds_pictures_and_the_cages_that_made_them(anew, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(PROGRAMS[DATASET], {})
    made = np.load(tmp_path / "deformed.npz")
    assert made["pictures"].shape == (4, 128, 128, 3) and made["cages"].shape == (4, *made["rest"].shape)
    for picture, cage, view in zip(made["pictures"], made["cages"], made["views"], strict=True):
        assert np.abs(cage - made["rest"]).max() > 0.01
        local = cage @ view[:3, :3].T + view[:3, 3]
        f = 64 / np.tan(0.45)
        at = (local[:, :2] / local[:, 2:] * f + 64).clip(0, 127).round().astype(int)
        seen = picture[..., 0].astype(int) - picture[..., 2] > 60  # the duck is yellow, all else black
        rows, columns = np.nonzero(seen)
        assert np.hypot(columns.mean() - at[:, 0].mean(), rows.mean() - at[:, 1].mean()) < 10


def test_arrays_are_the_memory_of_the_simulation_itself(sim):
    x, v, means = sim.vertices(0), sim.velocities(0), sim.gaussians(0)["means"]
    sim.reset()
    before, rest = x.copy(), means.copy()
    sim.step(HAND)
    assert np.abs(x - before).max() > 0 and np.abs(means - rest).max() > 0 and np.abs(v).max() > 0
    s = sim._world.device.solver
    np.testing.assert_array_equal(x, s.x.to_numpy()[: len(x)])
    assert not x.flags.owndata and np.shares_memory(x, sim.vertices(0)) and np.from_dlpack(x).base is not None


def test_gaussians_have_the_forms_that_are_said(sim):
    arrays = sim.gaussians(0)
    n, splats = len(arrays["means"]), sim._world.device.splats
    assert {name: a.shape[1:] for name, a in arrays.items()} == {
        "means": (3,), "covariances": (6,), "rotations": (4,), "opacities": (), "visibility": (),
        "sh": (splats.coefficients, 3),
    }  # fmt: skip
    begin, end = sim._world.registry.gaussian_span(0)
    for name, field in (("covariances", splats.cov), ("sh", splats.sh), ("opacities", splats.opacity)):
        np.testing.assert_array_equal(arrays[name], field.to_numpy()[begin:end])
    assert len(sim.gaussians()["means"]) == splats.count >= n == end - begin


def test_a_picture_is_drawn_when_it_is_asked_for(sim):
    sim.reset()
    drawn = sim._world.pictures
    sim.step(HAND)
    assert sim._world.pictures == drawn
    front = sim.picture().copy()
    aside = sim.picture(vrgs.perspective(64, 48, 0.9, vrgs.look_at((0, 0.2, -0.5), (0, 0.05, 0))))
    assert front.shape == (48, 64, 4) and front.dtype == np.uint8 and sim._world.pictures == drawn + 2
    assert front[..., :3].max() > 100 and (front != aside).any()


def test_a_state_is_gone_back_to(sim):
    end = pulled(sim)
    state = sim.snapshot()
    sim.step([])
    assert (sim.vertices(0) != end).any()
    sim.restore(state)
    np.testing.assert_array_equal(sim.vertices(0), end)
    assert sim.time == pytest.approx(3 / 60)


def test_two_simulations_play_at_once_and_alike(sim):
    alone = pulled(sim)
    with vrgs.Simulation(toy_scene(), size=(32, 32)) as other:
        np.testing.assert_array_equal(pulled(other), alone)
        assert sim.bodies[0].name == other.bodies[0].name
    np.testing.assert_array_equal(pulled(sim), alone)
    with pytest.raises(IndexError, match="there is no body 1"):
        sim.vertices(1)


def test_what_cannot_be_used_is_refused(ti_cpu, tmp_path):
    with pytest.raises(BadInput, match="no scene named 'nothing'"):
        vrgs.Simulation("nothing")
    with pytest.raises(BadInput, match=r"a\.ply"):
        vrgs.Simulation(toy_scene(bodies=[vrgs.Body(str(tmp_path / "a.ply"))]))
    with pytest.raises(BadInput, match="a Scene has its own"):
        vrgs.Simulation(toy_scene(), stage="room.ply")
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        getattr(vrgs, "nothing")  # noqa: B009


def test_an_asset_is_loaded_by_its_name():
    cage = vrgs.load_asset("toy_duck").cage
    assert cage.vertices.shape[1] == 3 and len(cage.tets) > 100


def test_each_program_of_the_page_is_run_by_a_test():
    assert list(PROGRAMS) == [PUSH, DATASET, FILM] and PAGE.count("```python") == 3


def test_a_headless_film_of_the_ring_toss(tmp_path):
    """In a process of its own, as the others are run by their users."""
    program, env = PROGRAMS[FILM].replace("FRAMES = 300", "FRAMES = 6"), {"PATH": "", "HOME": str(Path.home())}
    subprocess.run([sys.executable, "-c", program], cwd=tmp_path, env=env | {"PYTHONPATH": str(ROOT)}, check=True)
    film = cv2.VideoCapture(str(tmp_path / "toss.mp4"))
    pictures = [film.read()[1] for _ in range(3)]  # 30 a second
    assert all(picture.shape == (360, 640, 3) and picture.std() > 20 for picture in pictures) and not film.read()[0]
    assert (tmp_path / "rings.vtu").stat().st_size > 10_000
