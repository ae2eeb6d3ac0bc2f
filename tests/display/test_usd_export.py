"""A scene in OpenUSD: its own library finds it valid, and reads from it what is drawn and simulated."""

import importlib.util

import numpy as np
import pytest
from numpy.testing import assert_allclose

import vrgs
from core.camera import look_at, perspective
from core.errors import BadInput
from core.material import Material
from core.rotation import matrices_from_quaternions
from core.tetmesh import enclosed_volume, tet_volumes
from core.vocabulary import Body, Box, Capsule, Hand, Light, Plane
from display import user_commands as cmd
from display.keep.scene_export import exporter
from display.keep.shown_scene import gaussians_of, moving_bodies, shown_gaussians
from display.protocol import Frame
from prepare.cage.cage_file import read_cage
from scenes.scene import Scene

pytest.importorskip("pxr", reason="usd-core is not installed (pip install -r requirements-usd.txt)")
from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdShade, UsdValidation

from display.keep.usd_export import SceneStage, same_axes

SIZE = (64, 36)
SOFT = Material(young=2e4, poisson=0.4, density=1000.0, friction=0.7, kinetic_friction=0.3)
RING, CRATE = 0, 1


def stepped(world, frames: range) -> None:
    """A hand lifts and turns the ring."""
    camera = perspective(*SIZE, world.scene.fov_y, look_at(world.scene.eye, world.scene.target))
    for k in frames:
        hand = Hand((0.08, 0.02 + 0.006 * k, 0.0), (np.cos(0.06 * k), 0.0, 0.0, np.sin(0.06 * k)), True, 0.05)
        world.step(Frame(1 / 60, k / 60, [camera], [hand]))


@pytest.fixture(scope="module")
def world(ti_cpu):
    """A soft ring that a hand has bent, a rigid crate, a bottle that stands still, and one collider of each kind."""
    from display.world import World

    bodies = [Body("ring_red", SOFT, (0.0, 0.02, 0.0)), Body("box_crate", SOFT, (0.5, 0.2, 0.0), kind="rigid")]
    colliders = [
        Plane((0, 0, 0), (0, 1, 0)),
        Box((0.0, -0.5, 0.0), (2.0, 0.5, 1.0)),
        Capsule((1.0, 0.0, 0.0), (1.0, 0.3, 0.4), 0.05),
    ]
    scene = Scene(
        [*bodies, Body("bottle", None, (-0.5, 0.0, 0.0))], Light((0.1, 2.0, 0.1)), (0.0, 0.5, 0.5), (0, 0, 0), colliders
    )
    world = World(scene, width=SIZE[0], height=SIZE[1])
    stepped(world, range(12))
    return world


@pytest.fixture(scope="module")
def stage(world, tmp_path_factory):
    path = tmp_path_factory.mktemp("usd") / "scene.usdz"
    SceneStage(world).write(path)
    return Usd.Stage.Open(str(path))


def prims_of(stage, kind: str) -> list:
    return [prim for prim in stage.Traverse() if prim.GetTypeName() == kind]


def world_from(prim, time=Usd.TimeCode.Default()) -> np.ndarray:
    """Matrix (4, 4) for rows of points."""
    return np.array(UsdGeom.XformCache(time).GetLocalToWorldTransform(prim))


def value(prim, name: str, time=Usd.TimeCode.Default()) -> np.ndarray:
    return np.array(prim.GetAttribute(name).Get(time), np.float64)


def test_every_validator_of_openusd_passes(stage):
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) >= 20
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [e.GetMessage() for e in errors] == []
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0 and UsdGeom.GetStageUpAxis(stage) == "Y"


def test_the_gaussians_are_those_that_are_drawn(world, stage):
    room, ring, crate = prims_of(stage, "ParticleField3DGaussianSplat")
    assert room.GetAttribute("sortingModeHint").Get() == "cameraDistance"
    for prim, wanted in (
        (room, gaussians_of(world, [(0, world.device.still)], shadows=True)()),
        (ring, shown_gaussians(world, RING, shadows=True)()),
        (crate, shown_gaussians(world, CRATE, shadows=True)()),
    ):
        m = world_from(prim)
        assert_allclose(value(prim, "positions") @ m[:3, :3] + m[3, :3], wanted.means, atol=1e-5)
        assert_allclose(value(prim, "opacities"), wanted.opacities, atol=1e-6)
        half = prim is ring
        sigma = covariances(prim, half=half)
        turned = np.einsum("ji,njk,kl->nil", m[:3, :3], sigma, m[:3, :3])
        scale = np.exp(2 * wanted.log_scales.max())
        assert_allclose(turned[:, 0, 0] / scale, wanted.covariances[:, 0] / scale, atol=2e-3 if half else 1e-5)
        degree = prim.GetAttribute("radiance:sphericalHarmonicsDegree").Get()
        assert len(value(prim, "radiance:sphericalHarmonicsCoefficients")) == (degree + 1) ** 2 * len(wanted)
        low, high = value(prim, "extent")
        assert (low <= value(prim, "positions").min(0)).all() and (high >= value(prim, "positions").max(0)).all()


def covariances(prim, time=Usd.TimeCode.Default(), *, half: bool) -> np.ndarray:
    """(N, 3, 3) in the prim's frame."""
    quats = prim.GetAttribute("orientationsh" if half else "orientations").Get(time)
    quats = np.array([[q.GetReal(), *q.GetImaginary()] for q in quats], np.float64)
    axes = matrices_from_quaternions(quats) * value(prim, "scalesh" if half else "scales", time)[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


def test_the_cage_has_its_rest_shape_and_its_material(world, stage):
    (cage,) = prims_of(stage, "TetMesh")
    (body,) = moving_bodies(world, RING)
    m, tets = world_from(cage), value(cage, "tetVertexIndices").astype(int)
    assert_allclose(value(cage, "points") @ m[:3, :3] + m[3, :3], body.x, atol=1e-6)
    assert (tet_volumes(value(cage, "points"), tets) > 0).all()
    assert_allclose(value(cage, "physics:restShapePoints"), body.model.shape.vertices, atol=1e-7)
    surface = value(cage, "surfaceFaceVertexIndices").astype(int)
    assert enclosed_volume(value(cage, "points"), surface) > 0
    assert "PhysicsVolumeDeformableSimAPI" in cage.GetPrimTypeInfo().GetAppliedAPISchemas()
    assert "PhysicsDeformableBodyAPI" in cage.GetParent().GetPrimTypeInfo().GetAppliedAPISchemas()
    material = UsdShade.MaterialBindingAPI(cage).ComputeBoundMaterial("physics")[0].GetPrim()
    found = {a.GetName().split(":")[1]: a.Get() for a in material.GetAuthoredAttributes() if "physics:" in a.GetName()}
    wanted = {"youngsModulus": 2e4, "poissonsRatio": 0.4, "density": 1000.0}
    assert found == pytest.approx(wanted | {"staticFriction": 0.7, "dynamicFriction": 0.3})


def test_the_crate_is_a_rigid_body_of_its_mass(world, stage):
    (prim,) = [p for p in stage.Traverse() if p.HasAPI(UsdPhysics.RigidBodyAPI)]
    mass, centre, inertia = moving_bodies(world, CRATE)[0].model.body.inertia
    api = UsdPhysics.MassAPI(prim)
    axes = api.GetPrincipalAxesAttr().Get()
    R = matrices_from_quaternions([axes.GetReal(), *axes.GetImaginary()])
    assert api.GetMassAttr().Get() == pytest.approx(mass, rel=1e-5)
    assert_allclose(np.array(api.GetCenterOfMassAttr().Get()), centre, atol=1e-6)
    assert_allclose(R * np.array(api.GetDiagonalInertiaAttr().Get()) @ R.T, inertia, atol=1e-5 * inertia.max())
    assert value(prim.GetChild("Shape"), "points").shape == (8, 3)


def test_colliders_stand_where_they_are_solid(world, stage):
    plane, box, capsule = (prims_of(stage, kind)[0] for kind in ("Plane", "Cube", "Capsule"))
    assert_allclose([0, 1, 0] @ world_from(plane)[:3, :3], (0, 1, 0), atol=1e-7)
    assert_allclose(np.array([1, 1, 1, 1]) @ world_from(box), (2.0, 0.0, 1.0, 1), atol=1e-7)
    ends = np.array([[0, -0.25, 0, 1], [0, 0.25, 0, 1]]) @ world_from(capsule)
    assert_allclose(ends[:, :3], [(1.0, 0.0, 0.0), (1.0, 0.3, 0.4)], atol=1e-7)
    bottle = stage.GetPrimAtPath("/World/Colliders/StaticGrid_3")
    solid = enclosed_volume(value(bottle, "points"), value(bottle, "faceVertexIndices").astype(int).reshape(-1, 3))
    assert 1e-4 < solid < 3e-3 and value(bottle, "points")[:, 0].mean() == pytest.approx(-0.5, abs=0.02)


def test_the_play_becomes_samples_and_the_embedding_says_the_same(world, tmp_path):
    """The points of the cage move the Gaussians to where the samples have them, as the primvars' text says."""
    written = SceneStage(world, RING, rate=30.0)
    written.take(0.2)
    stepped(world, range(12, 30))
    written.take(0.2 + 1 / 30)
    written.write(tmp_path / "play.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "play.usdc"))
    assert (stage.GetEndTimeCode(), stage.GetTimeCodesPerSecond()) == (1, 30)
    (cage,), (splats,) = prims_of(stage, "TetMesh"), prims_of(stage, "ParticleField3DGaussianSplat")
    m = world_from(cage, 1)
    assert_allclose(value(cage, "points", 1) @ m[:3, :3] + m[3, :3], moving_bodies(world, RING)[0].x, atol=1e-6)

    host, weights = (
        value(splats, "primvars:vrgs:host").astype(int).reshape(-1, 4),
        value(splats, "primvars:vrgs:weights"),
    )
    text = splats.GetAttribute("primvars:vrgs:host").GetDocumentation()
    assert "host[4 i + k]" in text and splats.GetRelationship("vrgs:cage").GetTargets() == [cage.GetPath()]
    corners = value(cage, "tetVertexIndices").astype(int)[host]
    Y, y = (
        np.einsum("nkj,nkjc->nkc", weights.reshape(-1, 4, 4), value(cage, "points", time)[corners])
        for time in (Usd.TimeCode.Default(), 1)
    )
    F = np.swapaxes(y[:, 1:] - y[:, :1], 1, 2) @ np.linalg.inv(np.swapaxes(Y[:, 1:] - Y[:, :1], 1, 2))
    offset = value(splats, "positions") - Y.mean(1)
    mean = y.mean(1) + np.einsum("nij,nj->ni", F, offset)
    assert_allclose(mean, value(splats, "positions", 1), atol=2e-5)
    assert np.abs(value(splats, "positions", 1) - value(splats, "positions")).max() > 1e-3, "it is bent, not only moved"
    sigma = F @ covariances(splats, half=True) @ F.transpose(0, 2, 1)
    assert_allclose(sigma / sigma.max(), covariances(splats, 1, half=True) / sigma.max(), atol=4e-3)


def test_between_samples_axes_do_not_turn_over():
    quats = np.random.default_rng(0).normal(size=(50, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    turns = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])[np.arange(50) % 4]
    turned = np.array([list(flat(Gf.Quatd(*q) * Gf.Quatd(*t))) for q, t in zip(quats, turns.tolist(), strict=True)])
    assert_allclose(same_axes(-turned, quats), quats, atol=1e-12)


def flat(q) -> tuple:
    return (q.GetReal(), *q.GetImaginary())


def test_a_moment_of_a_play_is_exported_as_well(world, tmp_path):
    exporter(world, tmp_path / "now.usdz", body=RING)()
    stage = Usd.Stage.Open(str(tmp_path / "now.usdz"))
    (mesh,) = prims_of(stage, "TetMesh")
    points = value(mesh, "points") @ world_from(mesh)[:3, :3] + world_from(mesh)[3, :3]
    assert_allclose(points, moving_bodies(world, RING)[0].x, atol=1e-5)


def test_another_body_ends_the_samples(world):
    written = SceneStage(world)
    written.take(0.0)
    world.apply([cmd.Duplicate(RING)])
    with pytest.raises(BadInput, match="joined or left"):
        written.take(0.5)
    world.apply([cmd.Undo()])


def test_the_cage_is_read_back_where_the_splat_is(world, tmp_path):
    SceneStage(world, RING).write(tmp_path / "ring.usda")
    cage, (body,) = read_cage(tmp_path / "ring.usda"), moving_bodies(world, RING)
    assert_allclose(cage.vertices, body.x, atol=1e-6)
    assert (np.sort(cage.tets, 1) == np.sort(body.model.shape.solid, 1)).all()


SCENE = """from core.material import Material
from scenes.scene import Body, Plane, Scene


def build():
    ring = Body("ring_red", Material(young=2e4, poisson=0.4, density=1000.0), (0.0, 0.3, 0.0))
    return Scene([ring], None, (0.0, 0.5, 0.5), (0.0, 0.0, 0.0), [Plane((0, 0, 0), (0, 1, 0))])
"""


def test_the_command_writes_every_nth_frame_of_a_play(ti_cpu, tmp_path, capsys):
    (tmp_path / "falling.py").write_text(SCENE)
    words = ["export", "--scene", str(tmp_path / "falling.py"), "--out", str(tmp_path / "falling.usda")]
    assert vrgs.main([*words, "--frames", "7", "--every", "3"]) == 0
    stage = Usd.Stage.Open(str(tmp_path / "falling.usda"))
    (cage,) = prims_of(stage, "TetMesh")
    assert stage.GetTimeCodesPerSecond() == 20 and cage.GetAttribute("points").GetTimeSamples() == [0, 1, 2]
    height = [world_from(cage.GetParent(), k)[3, 1] for k in range(3)]
    assert height[0] - height[2] == pytest.approx(0.5 * 9.81 * ((7 / 60) ** 2 - (1 / 60) ** 2), rel=0.1)  # it falls
    assert "falling.usda: frame 7, " in capsys.readouterr().out


@pytest.mark.skipif(importlib.util.find_spec("newton") is None, reason="newton is not installed (pip install newton)")
def test_newton_simulates_these_bodies(world, tmp_path):
    import newton

    SceneStage(world).write(tmp_path / "scene.usdz")
    builder = newton.ModelBuilder(up_axis=newton.Axis.Y)
    builder.add_usd(str(tmp_path / "scene.usdz"))
    ring, crate = (b.model for b in moving_bodies(world, None))
    assert builder.particle_count == len(ring.shape.vertices) and builder.tet_count == len(ring.shape.solid)
    assert sum(builder.particle_mass) == pytest.approx(ring.mass.sum(), rel=1e-4)
    assert list(builder.body_mass) == pytest.approx([crate.body.inertia[0]], rel=1e-4)
    mu = SOFT.lame_parameters[0]
    assert np.array(builder.tet_materials)[:, 0] == pytest.approx(mu, rel=1e-5)
