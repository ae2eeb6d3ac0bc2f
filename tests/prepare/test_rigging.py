"""Rigs on bodies: weights carried, cages cut, skeletons fitted, and what is driven moves without tearing."""

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from assets.animation import linear_blend_skinning, world_matrices
from assets.asset import Asset
from assets.formats.gltf import Rig
from core.errors import BadInput
from core.material import ANIMATED_MATERIAL
from prepare.pipeline import Options
from prepare.prepared_files import prepare_file
from prepare.rig.landmarks import ARM, LEG, NAMES, Landmarks, match_joints, name_parts, read_landmarks
from prepare.rig.retargeting import BONES, PARENTS, retarget
from prepare.rig.rig_source import rig_source
from prepare.rig.skin_weights import least_volumes
from tests.support.animated_shapes import animated_shapes
from tests.support.glb import bar


def person(seed: int = 0, frames: int = 20) -> tuple[Rig, dict[str, np.ndarray]]:
    """A rig of BONES with names as tools give them, its random motion, and its landmarks where it is at rest."""
    at = {"pelvis": (0, 1.0, 0), "spine": (0, 1.1, 0), "chest": (0, 1.2, 0), "neck": (0, 1.5, 0), "head": (0, 1.6, 0)}
    for s, sign in (("left", 1), ("right", -1)):
        at |= {f"{s}_clavicle": (0.05 * sign, 1.45, 0), f"{s}_shoulder": (0.2 * sign, 1.45, 0)}
        at |= {f"{s}_elbow": (0.35 * sign, 1.2, 0.0), f"{s}_wrist": (0.4 * sign, 1.0, 0.12)}
        at |= {f"{s}_hip": (0.1 * sign, 0.95, 0), f"{s}_knee": (0.12 * sign, 0.5, 0.06)}
        at |= {f"{s}_ankle": (0.12 * sign, 0.08, 0.0)}
    x = np.array([at[n] for n in BONES])
    marks = {n: np.array(at[n]) for n in NAMES if n in at}
    marks["head_top"] = np.array([0, 1.75, 0])
    for s in ("left", "right"):
        marks[f"{s}_hand"] = marks[f"{s}_wrist"] + [0, -0.05, 0.1]
        marks[f"{s}_foot"] = marks[f"{s}_ankle"] + [0, -0.05, 0.15]
    rng = np.random.default_rng(seed)
    steps = np.where((PARENTS >= 0)[:, None], x - x[PARENTS], x)
    bends = {n: 0.25 for n in BONES} | {"spine": 0.0, "neck": 0.0}
    turns = rng.normal(size=(frames + 1, len(BONES), 3)) * [[[bends[n]] for n in BONES]]
    for s in ("left", "right"):  # a hinge bends about one axis
        for joint in ("elbow", "knee"):
            a, b, c = (at[f"{s}_{n}"] for n in (ARM if joint == "elbow" else LEG))
            axis = np.cross(np.subtract(b, a), np.subtract(c, b))
            axis /= np.linalg.norm(axis)
            turns[:, BONES.index(f"{s}_{joint}")] = rng.uniform(0, 1.2, (frames + 1, 1)) * axis
    turns[-1] = turns[0]
    q = Rotation.from_rotvec(turns.reshape(-1, 3)).as_quat()[:, [3, 0, 1, 2]].reshape(frames + 1, -1, 4)
    common = {"elbow": "ForeArm", "shoulder": "Arm", "clavicle": "Shoulder", "wrist": "Hand"}
    common |= {"hip": "UpLeg", "knee": "Leg", "ankle": "Foot", "pelvis": "Hips", "chest": "Spine2"}

    def tool(n: str) -> str:
        side, _, limb = n.rpartition("_")
        return f"rig:{side.capitalize()}{common.get(limb, limb.capitalize())}"

    moving = (np.tile(steps, (frames + 1, 1, 1)), q, np.ones((frames + 1, len(BONES), 3)))
    still = (steps, np.tile([1.0, 0, 0, 0], (len(BONES), 1)), np.ones((len(BONES), 3)))
    inverse = np.tile(np.eye(4), (len(BONES), 1, 1))
    inverse[:, :3, 3] = -x
    rig = Rig([tool(n) for n in BONES], PARENTS, np.arange(len(BONES)), inverse, still, moving, 30.0, "random")
    return rig, marks


def marks_of(points) -> Landmarks:
    return Landmarks(points, dict.fromkeys(points, "given"), None, {})


def test_joints_are_told_by_their_names_and_place():
    rig, _ = person()
    found = match_joints(rig, {})
    assert {n: BONES[k] for n, k in found.items()} == {n: n for n in found}
    assert set(found) >= {"pelvis", "chest", "head", *(f"{s}_{n}" for s in ("left", "right") for n in (*ARM, *LEG))}
    assert name_parts("L_armUpper0001_bind_JNT") == ["l", "arm", "upper", "0001", "bind", "jnt"]
    with pytest.raises(BadInput, match="left shoulder"):
        match_joints(replace(rig, names=["x"] * len(rig.names)), {})


def test_a_fitted_skeleton_keeps_its_bones_and_moves_like_the_rig():
    """On a body turned by 70 degrees, half as large, with thinner bones: lengths hold, directions are the rig's."""
    rig, points = person()
    turn = Rotation.from_rotvec([0, 1.2, 0]).as_matrix()
    body = {n: 0.5 * turn @ p for n, p in points.items()}
    for s in ("left", "right"):  # longer forearms
        way = body[f"{s}_wrist"] - body[f"{s}_elbow"]
        body[f"{s}_wrist"], body[f"{s}_hand"] = body[f"{s}_wrist"] + 0.3 * way, body[f"{s}_hand"] + 0.3 * way
    f = retarget(rig, marks_of(body))
    x = world_matrices(PARENTS, f.frames)[:, :, :3, 3]
    theirs = world_matrices(rig.parents, rig.frames)[:, :, :3, 3]
    length = np.linalg.norm(x[:, 1:] - x[:, PARENTS[1:]], axis=2)
    assert_allclose(length, np.broadcast_to(length[:1], length.shape), rtol=1e-9)
    for a, b in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle")):
        for s in ("left", "right"):
            i, j = BONES.index(f"{s}_{a}"), BONES.index(f"{s}_{b}")
            ours = (x[:, j] - x[:, i]) / np.linalg.norm(x[:, j] - x[:, i], axis=1, keepdims=True)
            wanted = (theirs[:, j] - theirs[:, i]) @ turn.T
            wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
            assert (ours * wanted).sum(1).min() > np.cos(np.radians(4))  # which way the rig looks is its mean
    assert f.residual["left_elbow"] < 1e-9


def test_residuals_tell_what_left_and_right_disagree_in():
    rig, points = person()
    points["left_wrist"] = points["left_elbow"] + 1.2 * (points["left_wrist"] - points["left_elbow"])
    f = retarget(rig, marks_of(points))
    forearm = np.linalg.norm(points["right_wrist"] - points["right_elbow"])
    assert_allclose(f.residual["left_wrist"], 0.1 * forearm, rtol=1e-6)
    points["left_elbow"] = points["left_shoulder"]
    with pytest.raises(BadInput, match="one place"):
        retarget(rig, marks_of(points))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[1]", "not an object"),
        ("{", "not a JSON"),
        ('{"nose": [0, 0, 0]}', "not a landmark"),
        ('{"neck": [0, 0]}', "not 3 finite numbers"),
        ('{"neck": [0, NaN, 0]}', "not 3 finite numbers"),
        ('{"held": [{"by": "tail", "center": [0, 0, 0], "radius": 1}]}', "held"),
        ('{"held": [{"by": "left_hand", "center": [0, 0, 0], "radius": -1}]}', "held"),
    ],
)
def test_landmark_files_are_checked(tmp_path, text, says):
    path = tmp_path / "l.json"
    path.write_text(text)
    with pytest.raises(BadInput, match=says):
        read_landmarks(path)


def test_a_landmark_file_is_read(tmp_path):
    path = tmp_path / "l.json"
    held = [{"by": "right_hand", "center": [0, 1, 0], "radius": 0.1}]
    path.write_text(json.dumps({"neck": [0, 1.5, 0], "held": held, "joints": {"head": "Skull"}}))
    found = read_landmarks(path)
    assert found["neck"].tolist() == [0, 1.5, 0] and found["held"][0].by == "right_hand"
    assert found["joints"] == {"head": "Skull"}


def test_the_skinning_kernel_is_its_twin(ti_cpu):
    from sim.kinematic_targets import Skinning

    rng = np.random.default_rng(0)
    points, joints = rng.normal(size=(40, 3)), rng.integers(0, 5, (40, 4))
    weights, matrices = rng.dirichlet(np.ones(4), 40), rng.normal(size=(5, 4, 4))
    targets = ti_cpu.Vector.field(3, ti_cpu.f32, 100)
    vertices = rng.permutation(60)[:40]
    Skinning(vertices, points, joints, weights, 5).pose(matrices, targets, 30)
    expected = linear_blend_skinning(points, joints, weights, matrices)
    assert_allclose(targets.to_numpy()[30 + vertices], expected, atol=1e-5)
    untouched = np.setdiff1d(np.arange(100), 30 + vertices)
    assert (targets.to_numpy()[untouched] == 0).all()


@pytest.fixture(scope="module")
def walker(ti_cpu, tmp_path_factory):
    """The bar of tests/support/glb.py as an asset that bends by itself."""
    folder = tmp_path_factory.mktemp("rig")
    b, scene = bar()
    path = b.write(folder / "bar.glb", scene)
    lines = []
    prepare_file(path, folder / "bar.h5", Options(vertices=300), progress=lambda *_: None, report=lines.append)
    return folder / "bar.h5", lines


def test_a_skinned_mesh_becomes_a_body_that_moves(walker):
    path, lines = walker
    asset = Asset.load(path)
    a, rig = asset.animation, asset.provenance["rig"]
    assert asset.material.poisson == 0.45 and ANIMATED_MATERIAL == "flesh"
    assert any("driven" in line for line in lines)
    assert len(asset.gaussians) == 60_000
    red = asset.gaussians.sh[:, 0, 0] > 0  # the texture's right half: x > 0
    assert (red == (asset.gaussians.means[:, 0] > 0)).mean() > 0.97
    size = asset.provenance["size"]
    y = asset.cage.vertices[a.vertices][:, 1] / size
    upper = (a.weights * (a.joints == a.names.index("upper"))).sum(1)
    assert upper[y > 0.65].min() > 0.9 and upper[y < 0.35].max() < 0.1
    assert a.driven[(y > 0.8) | (y < 0.2)].all() and not a.driven[np.abs(y - 0.5) < 0.02].any()
    assert rig["least_volume_driven"] > 0.6


def test_a_body_moves_by_itself(walker):
    """It starts at rest, goes where its skeleton leads it, comes back, and tears nowhere."""
    asset = Asset.load(walker[0])
    a, rest, tets = asset.animation, asset.cage.vertices.astype(np.float64), asset.cage.tets
    led = a.vertices[a.driven]
    place, shapes = (0.3, 1.0, 0.2), [rest]
    for k, x in enumerate(animated_shapes(asset, position=place, scale=4.0)):
        shapes.append((x - np.array(place)) / 4.0)
        wanted = a.skinned(rest[a.vertices], a.matrices((k + 1) / 60))[a.driven]
        assert_allclose(shapes[-1][led], wanted, atol=1e-5)
    moved = [np.abs(x[led] - rest[led]).max() for x in shapes]
    assert moved[1] < 1e-3 and moved[len(moved) // 2] > 0.03  # the ramp begins slowly
    assert least_volumes(tets, np.array(shapes)).min() > 0.05
    length = [np.linalg.norm(x[tets[:, 0]] - x[tets[:, 1]], axis=1) for x in shapes]
    assert (np.max(length, axis=0) / length[0]).max() < 2.5


def test_what_belongs_together_is_said(tmp_path):
    b, scene = bar()
    path = b.write(tmp_path / "bar.glb", scene)
    with pytest.raises(BadInput, match="has its own rig"):
        rig_source(path, path, None)
    with pytest.raises(BadInput, match="belongs to --rig"):
        rig_source(tmp_path / "a.ply", None, path)
    with pytest.raises(BadInput, match="no such file"):
        rig_source(tmp_path / "a.ply", tmp_path / "none.glb", None)
    assert rig_source(tmp_path / "a.ply", None, None) is None
