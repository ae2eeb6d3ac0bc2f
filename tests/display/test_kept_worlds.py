"""Worlds that are kept: what another program reads of an export is what is drawn, and a saved state goes on exactly."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import h5py
import meshio
import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal

from assets.splat_files import kind_of, read_gaussians
from core.camera import look_at, perspective
from core.errors import BadInput
from core.material import Material
from core.rotation import matrices_from_quaternions
from core.tetmesh import tet_volumes
from core.vocabulary import Body, Hand, Light, Plane
from display import user_commands as cmd
from display.keep.scene_export import exporter, von_mises
from display.keep.scene_state import game_state, game_values, located, put_state, state_of
from display.keep.shown_scene import moving_bodies, shown_gaussians
from display.keep.state_file import read_state, write_state
from display.picture import pixels_of
from display.protocol import Frame
from render import MOVING_SORT
from scenes import registry
from scenes.scene import Scene
from sim.state import MOTION
from sim.time_step import lame

SIZE = (240, 136)
ABOUT = {"scene": "rings"}
SOFT = Material(young=2e4, poisson=0.4, density=1000.0)


@pytest.fixture(scope="module")
def world(ti_cpu):
    """Two soft rings, the upper one in the shade of nothing, turned, scaled, and bent by a hand that lifts it."""
    from display.world import World

    rings = [Body("ring_red", SOFT, (0.0, 0.02, 0.0)), Body("ring_blue", SOFT, (0.06, 0.06, 0.0))]
    light = Light((0.1, 2.0, 0.1), strength=0.8)
    scene = Scene(
        rings, light, (0.0, 0.45, 0.5), (0.05, 0.08, 0.0), [Plane((0, 0, 0), (0, 1, 0))], background=(0.2, 0.3, 0.4)
    )
    world = World(scene, width=SIZE[0], height=SIZE[1])
    camera = perspective(*SIZE, scene.fov_y, look_at(scene.eye, scene.target))
    edits = [cmd.Rotate(1, cmd.rotation_step((0.3, 1.0, 0.1))), cmd.Rescale(1, 1.3)]
    for k in range(20):
        hand = Hand((0.14, 0.06 + 0.006 * k, 0.0), (np.cos(0.04 * k), 0.0, 0.0, np.sin(0.04 * k)), True, 0.05)
        world.step(Frame(1 / 60, k / 60, [camera], [hand], edits if k == 0 else []))
    assert np.linalg.norm(world.bodies()[1].centroid - [0.06, 0.06, 0.0]) > 0.01, "the hand has it"
    return world


@pytest.fixture(scope="module")
def drawn(world):
    """Pixels of other Gaussians, as many as the world's, in its view: one renderer, whose kernels compile once."""
    from render.renderer import Renderer
    from render.splats import Splats

    splats = Splats(shown_gaussians(world, None, shadows=False)())
    renderer = Renderer(splats, *SIZE, background=world.scene.background, sort=MOVING_SORT)

    def draw(g) -> np.ndarray:
        fields = {splats.mean: g.means, splats.cov: g.covariances, splats.opacity: g.opacities, splats.sh: g.sh}
        for field, values in fields.items():
            field.from_numpy(splats.padded(values))
        renderer.render(world.cameras)
        return renderer.pixels()[0][..., :3].astype(float)

    return draw


def shown(world) -> np.ndarray:
    return pixels_of(world.picture)[..., :3].astype(float)


@pytest.mark.parametrize(("name", "least"), [("scene.ply", 70.0), ("scene.spz", 50.0), ("scene.compressed.ply", 50.0)])
def test_the_exported_splat_looks_like_the_running_scene(world, drawn, tmp_path, name, least):
    exporter(world, tmp_path / name)()
    gaussians = read_gaussians(tmp_path / name)
    assert len(gaussians) == world.stats()["gaussians"] and gaussians.sh_degree == 2
    assert gaussians.sort == MOVING_SORT, "of the files that are read, others are drawn by z"
    quality = cv2.PSNR(drawn(gaussians), shown(world))
    print(f"{name}: {quality:.1f} dB")
    assert quality > least


def test_shadows_are_left_out_on_request_and_one_body_stands_alone(world, drawn, tmp_path):
    for name, options in {"lit.ply": {"shadows": False}, "body.ply": {"body": 1}}.items():
        exporter(world, tmp_path / name, **options)()
    lit = drawn(read_gaussians(tmp_path / "lit.ply"))
    assert cv2.PSNR(lit, shown(world)) < 40 and lit.mean() > shown(world).mean() + 0.2, "the shadow was there before"
    alone = read_gaussians(tmp_path / "body.ply")
    body = world.bodies()[1]
    assert len(alone) == world.device.gaussian_counts[1]
    assert np.all(alone.means > body.low - 0.02) and np.all(alone.means < body.high + 0.02)


def test_the_cage_is_read_by_others_with_its_fields(world, tmp_path):
    exporter(world, tmp_path / "cage.vtu")()
    mesh = meshio.read(tmp_path / "cage.vtu")
    bodies = moving_bodies(world, None)
    assert_allclose(mesh.points, np.concatenate([b.x for b in bodies]))
    assert_allclose(mesh.point_data["velocity"], np.concatenate([b.v for b in bodies]))
    tets = mesh.cells_dict["tetra"]
    assert (tet_volumes(mesh.points, tets) > 0).all()
    owner, ratio = mesh.cell_data["body"][0], mesh.cell_data["volume_ratio"][0]
    for k, b in enumerate(bodies):
        volume = tet_volumes(mesh.points, tets[owner == k]).sum()
        rest = b.model.shape.volumes.sum()
        assert_allclose(np.average(ratio[owner == k], weights=b.model.shape.volumes), volume / rest, rtol=1e-6)
    bent = np.linalg.norm(mesh.point_data["displacement"], axis=1)
    assert bent[len(bodies[0].x) :].max() > 2e-3 and (mesh.cell_data["von_mises_stress"][0] >= 0).all()


def test_the_surface_is_read_by_others(world, tmp_path):
    exporter(world, tmp_path / "cage.obj", body=1)()
    mesh = trimesh.load(tmp_path / "cage.obj", process=False)
    (body,) = moving_bodies(world, 1)
    assert mesh.is_watertight and len(mesh.faces) == len(body.model.shape.surface)
    assert mesh.volume == pytest.approx(tet_volumes(body.x, body.model.shape.solid).sum(), rel=1e-5)


def test_stress_is_that_of_linear_elasticity_for_small_strains_and_does_not_turn():
    """Uniaxial stretch s: sigma_1 - sigma_2 = 2 mu s, which is the von Mises stress."""
    mu, lam = lame(SOFT)
    F = np.eye(3)[None] + 1e-5 * np.diag([1.0, 0.0, 0.0])
    assert_allclose(von_mises(F, mu, lam), 2e-5 * mu, rtol=1e-3)
    R = matrices_from_quaternions([0.5, 0.5, -0.5, 0.5])
    assert_allclose(von_mises(R @ F, mu, lam), 2e-5 * mu, rtol=1e-3)
    assert_allclose(von_mises(R[None], mu, lam), 0.0, atol=1e-6 * mu)


def test_what_cannot_be_written_is_said_in_a_line(world, tmp_path):
    with pytest.raises(BadInput, match=r"cannot write '\.stl'; written are"):
        exporter(world, tmp_path / "x.stl")
    with pytest.raises(BadInput, match="does not exist"):
        exporter(world, tmp_path / "none" / "x.ply")()


# states: the same world goes on from a file, after it was led astray


def frames(world, count: int, *commands, time: float = 0.0) -> None:
    """Frames in which a hand lifts the first ring; the commands come in the first."""
    for k in range(count):
        hand = Hand((-0.07, 0.03 + 0.008 * k, 0.01 * k), grip=True, reach=0.05)
        world.step(Frame(1 / 60, time + k / 60, world.cameras, [hand], list(commands) if k == 0 else []))


def astray(world) -> None:
    frames(world, 3, cmd.Reset(), cmd.SetGravity((0.0, -3.0, 0.0)), cmd.SetLight(Light((0.5, 1.0, 0.5))), cmd.Remove(0))
    frames(world, 3, cmd.SetTimeScale(0.5), cmd.SetInteraction("transform"))


def everything(world) -> dict:
    solver = world.device.solver.snapshot()
    told = {name: getattr(world, name) for name in ("time", "gravity", "time_scale", "light", "interaction")}
    return {name: solver[name] for name in (*MOTION, "asleep", "untangling", "rest_inverse")} | told


@pytest.fixture(scope="module")
def saved(world, tmp_path_factory):
    """A state with a copy, sizes and materials, while a hand holds a ring; and how the world went on from there."""
    path = tmp_path_factory.mktemp("state") / "rings.h5"
    edits = [cmd.Reset(), cmd.SetInteraction("physics"), cmd.SetGravity((0.0, -9.0, 0.0))]
    edits += [cmd.SetLight(Light((0.2, 2.0, 0.0)))]
    world.step(Frame(1 / 60, 0.0, world.cameras, [Hand()], edits))
    clay = replace(SOFT, young=3e4, yield_strain=0.01)
    frames(world, 1, cmd.Duplicate(0), cmd.Rescale(0, 0.9), cmd.SetMaterial(1, clay))
    frames(world, 8, cmd.SetTimeScale(0.9))
    frames(world, 1, cmd.SaveState())
    write_state(path, state_of(world, ABOUT))
    assert any(body.held for body in world.bodies())
    made, now = world.device.solver.body_models[1].shape.inverse, world.device.solver.rest_inverses()[1]
    assert np.abs(now - made).max() > 0.01 * np.abs(made).max(), "it has flowed"
    frames(world, 6)
    return path, everything(world)


def test_a_world_goes_on_from_a_file_bit_for_bit(world, saved):
    path, expected = saved
    assert kind_of(path) == "state", "as the window takes it if it is dropped there"
    astray(world)
    frames(world, 6, cmd.LoadState(str(path)))
    there = everything(world)
    for name in MOTION:
        assert_array_equal(there[name], expected[name], err_msg=name)
    for name in expected.keys() - set(MOTION):
        np.testing.assert_equal(there[name], expected[name], err_msg=name)
    assert len(world.bodies()) == 3 and world.wanted_view is not None and str(path) in world.notice
    world.apply([cmd.Undo()])
    assert len(world.bodies()) == 1


def test_a_state_of_version_1_is_read(saved, tmp_path):
    """Its materials have no yield strain, and its bodies are as they were made."""
    old = tmp_path / "old.h5"
    shutil.copy(saved[0], old)
    with h5py.File(old, "r+") as file:
        file.attrs["version"] = 1
        put(file, "bodies/material", file["bodies/material"][:, :-1])
        del file["rest_inverse"]
    new, state = read_state(saved[0]), read_state(old)
    assert state.rest_inverse is None and new.bodies[1].material.yield_strain == 0.01
    assert [b.material for b in state.bodies] == [replace(b.material, yield_strain=None) for b in new.bodies]


def test_files_of_the_user_are_found_from_any_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cat.ply").touch()
    about = {"scene": "sandbox", "body": ["cat.ply", "fox"], "stage": "cat.ply", "up": None}
    there = str(tmp_path / "cat.ply")
    assert located(about) == about | {"body": [there, "fox"], "stage": there} and located(ABOUT) == ABOUT


def damaged(path, tmp_path, change) -> str:
    """The message about a copy of a file that was changed."""
    other = tmp_path / "other.h5"
    shutil.copy(path, other)
    with h5py.File(other, "r+") as file:
        change(file)
    with pytest.raises(BadInput) as error:
        read_state(other)
    assert str(other) in str(error.value) and "\n" not in str(error.value)
    return str(error.value)


def put(file, name: str, values) -> None:
    del file[name]
    file[name] = values


def set_settings(file, **changes) -> None:
    settings = json.loads(bytes(file["settings"][()])) | changes
    put(file, "settings", np.frombuffer(json.dumps(settings).encode(), np.uint8))


DAMAGE = {
    "no state": lambda f: f.attrs.__setitem__("format", "vrgs-asset"),
    "of version 7": lambda f: f.attrs.__setitem__("version", 7),
    "about: scene is missing": lambda f: f.attrs.__setitem__("about", "{}"),
    "assets: [0] is ['a'], not a list of 2": lambda f: f.attrs.__setitem__("assets", '[["a"]]'),
    "settings: time is -1.0": lambda f: set_settings(f, time=-1.0),
    "the eye is at its target": lambda f: set_settings(f, eye=[0, 0, 0], target=[0, 0, 0]),
    "room is not a rotation": lambda f: set_settings(f, room=np.diag([2, 1, 1, 1]).tolist()),
    "gravity[1] is 1e+30": lambda f: set_settings(f, gravity=[0.0, 1e30, 0.0]),
    "motion/x holds": lambda f: put(f, "motion/x", np.full(f["motion/x"].shape, np.nan, np.float32)),
    "motion/v has shape": lambda f: put(f, "motion/v", np.zeros((3, 3), np.float32)),
    "young": lambda f: put(f, "bodies/material", np.full(f["bodies/material"].shape, np.nan)),
    "bodies/size": lambda f: put(f, "bodies/size", np.zeros(len(f["bodies/size"]))),
    "claims 200 bodies": lambda f: put(f, "bodies/source", np.zeros(200, np.int32)),
    "hands/held": lambda f: put(f, "hands/held", np.full(2, 9, np.int32)),
    "beyond the body's vertices": lambda f: put(f, "hands/vertex", np.full(f["hands/vertex"].shape, 1 << 20, np.int32)),
    "untangling": lambda f: put(f, "bodies/untangling", np.full(f["bodies/untangling"].shape, 9.0)),
}


@pytest.mark.parametrize("says", DAMAGE)
def test_a_damaged_state_is_refused_in_a_line(saved, tmp_path, says):
    assert says.replace("no state", "not a saved state") in damaged(saved[0], tmp_path, DAMAGE[says])


def test_a_state_of_another_scene_or_other_files_changes_nothing(world, saved, tmp_path):
    frames(world, 2, cmd.Reset())
    before = everything(world)
    state = read_state(saved[0])
    for other, says in (
        (replace(state, assets=(("cat", "0"), *state.assets[1:])), "other bodies"),
        (replace(state, assets=(state.assets[0], ("ring_blue", "0"))), "another ring_blue"),
        (replace(state, settings=replace(state.settings, light=None)), "another scene"),
        (replace(state, bodies=(replace(state.bodies[0], vertices=4), *state.bodies[1:])), "vertices"),
        (replace(state, rest_inverse=1.1 * state.rest_inverse), "rest_inverse"),
        (replace(state, bodies=(replace(state.bodies[0], source=40), *state.bodies[1:])), "names body 40"),
    ):
        with pytest.raises(BadInput, match=says):
            put_state(world, other, "other.h5")
    for name, value in everything(world).items():
        np.testing.assert_equal(value, before[name], err_msg=name)
    world.apply([cmd.LoadState("")])
    assert "No state" in world.notice


class FragileGame:
    """A game that fails in one of its methods, after it has changed."""

    def __init__(self):
        self.reset()

    def reset(self):
        self.fails, self.count, self.seen = "", 0, []

    def _act(self, method: str, result):
        self.count += 1
        self.seen.append(method)
        if self.fails == method:
            raise KeyError(method)
        return result

    def update(self, time, bodies):
        self._act("update", None)

    def hands(self, time, bodies):
        return self._act("hands", [])

    score = property(lambda self: self._act("score", 0))
    message = property(lambda self: self._act("message", ""))


@pytest.mark.parametrize("fails", ["update", "hands", "score", "message"])
def test_a_load_that_fails_in_the_game_changes_neither_the_game_nor_the_world(world, saved, tmp_path, fails):
    world.scene = replace(world.scene, game=FragileGame())
    game = world.scene.game
    try:
        frames(world, 2, cmd.Reset())
        write_state(tmp_path / "play.h5", state_of(world, ABOUT))
        state = read_state(tmp_path / "play.h5")
        broken = replace(state.settings.game, state=state.settings.game.state | {"fails": fails, "count": 99})
        frames(world, 3, cmd.SetGravity((0.0, -2.0, 0.0)), cmd.Rescale(0, 1.1))
        before, attributes = everything(world), json.dumps(vars(game))
        with pytest.raises(BadInput, match="its game cannot go on"):
            put_state(world, replace(state, settings=replace(state.settings, time=5.0, game=broken)), "play.h5")
        assert json.dumps(vars(game)) == attributes
        np.testing.assert_equal(everything(world), before)
    finally:
        world.scene = replace(world.scene, game=None)


ROOT = Path(__file__).resolve().parents[2]
DT = 1 / 60
SECOND_HALF = 20  # frames
FIRST_HALVES = {  # frames after which a hand holds something, or a body dances, or bricks are falling
    "ring_toss": 70,
    "table_brick_game": 100,
    "just_dance": 90,
    "animal_crossing": 40,
}


@pytest.mark.long
@pytest.mark.parametrize("name", FIRST_HALVES)
def test_a_demo_goes_on_in_another_program_bit_for_bit(ti_cpu, tmp_path, name):
    from display.world import World

    world, first = World(registry.load(name), width=32, height=18), FIRST_HALVES[name]
    for k in range(1, first + SECOND_HALF + 1):
        commands = [cmd.SaveState()] if k == first else []
        world.step(Frame(DT, k * DT, [], world.scripted_hands(k * DT), commands))
        if k == first:
            write_state(tmp_path / "state.h5", state_of(world, {"scene": name}))
    words = ["--headless", "--state", "state.h5", "--frames", str(SECOND_HALF), "--save-state", "end.h5"]
    command = [sys.executable, str(ROOT / "vrgs.py"), *words, "--arch", "cpu", "--size", "32x18"]
    subprocess.run(command, cwd=tmp_path, check=True)
    expected, there = state_of(world, {"scene": name}), read_state(tmp_path / "end.h5")
    np.testing.assert_array_equal(there.motion, expected.motion)
    assert [b.asleep for b in there.bodies] == [b.asleep for b in expected.bodies]
    assert there.settings.time == expected.settings.time and there.settings.game == expected.settings.game


def test_a_state_of_an_older_game_may_hold_more_than_the_game_has_now():
    """Such as the dancer's height; one that holds less is of another game."""
    game = registry.load("just_dance").game
    saved = game_state(game)
    assert game_values(game, replace(saved, state=saved.state | {"height": 0.87})).keys() == vars(game).keys()
    with pytest.raises(BadInput, match="another one"):
        game_values(game, replace(saved, state={"height": 0.87}))
