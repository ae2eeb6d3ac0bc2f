"""Rigs on bodies: weights carried, cages cut, skeletons fitted, and what is driven moves without tearing."""

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from assets.animation import RAMP, skin, world_of
from assets.asset import Asset, Cage, DistanceGrid
from assets.check import check_cage
from assets.errors import BadInput
from assets.gaussians import Gaussians
from assets.gltf_rig import Rig
from assets.materials import MOVING
from prepare.embed import embed
from prepare.rig_cut import cut, split
from prepare.rig_fit import BONES, PARENTS, fit
from prepare.rig_hang import calmed
from prepare.rig_landmarks import NAMES, Landmarks, read_landmarks, to_segment
from prepare.rig_names import ARM, LEG, TREE, named_joints, words
from prepare.rig_parts import Parts
from prepare.rig_solid import Solid, held_by_hands
from prepare.rig_weights import diffused, least_volumes, strongest
from tests.glb import bar
from tests.meshes import boundary, box


def trousers(gap: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Two legs of 0.1 x 0.8 x 0.1 m under a waist of 0.2 m; without a gap they touch all along."""
    x, tets, _ = box((0.25, 1.0, 0.1), (5, 20, 2))
    middle = x[tets].mean(1)
    if gap:
        tets = tets[~((np.abs(middle[:, 0] - 0.125) < 0.025) & (middle[:, 1] < 0.8))]
    used, tets = np.unique(tets, return_inverse=True)
    return x[used], tets.reshape(-1, 4)


def test_diffused_weights_are_shares_and_differ_little_between_neighbours():
    x, tets = trousers()
    rng = np.random.default_rng(0)
    target = np.eye(3)[rng.integers(0, 3, len(x))]
    weights = diffused(x, tets, np.full(len(x), 1 / 0.05**2), target)
    assert_allclose(weights.sum(1), 1, atol=1e-9)
    assert weights.min() > -1e-12 and weights.max() < 1 + 1e-12
    smooth = diffused(x, tets, np.full(len(x), 1 / 0.5**2), np.eye(2)[(x[:, 1] > 0.5).astype(int)])
    ends = np.concatenate([tets[:, [i, j]] for i in range(4) for j in range(i)])
    assert np.abs(smooth[ends[:, 0]] - smooth[ends[:, 1]]).max() < 0.2  # of targets that jump by 1
    joints, four = strongest(np.random.default_rng(1).dirichlet(np.ones(9), 50))
    assert_allclose(four.sum(1), 1, atol=1e-6)
    assert (four[:, 0] >= four[:, 3]).all() and joints.max() < 9


def grid_of(inside, low, high, spacing: float = 0.025) -> DistanceGrid:
    """A grid of -1 where inside(x) of points (..., 3), else 1."""
    shape = np.ceil((np.subtract(high, low)) / spacing).astype(int) + 1
    x = np.asarray(low) + spacing * np.moveaxis(np.indices(shape), 0, -1)
    return DistanceGrid(np.where(inside(x), -1.0, 1.0).astype(np.float16), np.asarray(low, np.float64), spacing)


def test_weights_do_not_bleed_from_leg_to_leg():
    """5 cm across the gap, but more than a metre through the waist: distance is measured inside the solid."""

    def inside(p):
        x, y = p[..., 0], p[..., 1]
        return (x > 0) & (x < 0.25) & (y > 0) & (y < 1) & ((np.abs(x - 0.125) > 0.025) | (y > 0.8))

    solid = Solid.of(grid_of(inside, (-0.05, -0.05, -0.05), (0.3, 1.05, 0.15)))
    legs = [(np.array([c, 0.05, 0.05]), np.array([c, 0.75, 0.05])) for c in (0.05, 0.2)]
    off = solid.ways(legs)
    p = solid.points
    low, left = p[:, 1] < 0.5, p[:, 0] < 0.125
    assert (off[low & left, 1] > 0.25).all() and (off[low & ~left, 0] > 0.25).all()
    assert off[low & left, 0].max() < 0.2  # its own leg is near
    euclid = np.hypot(p[:, 0] - 0.2, p[:, 2] - 0.05)
    assert euclid[low & left].min() < 0.15  # what a straight line would have taken for near


def test_what_a_hand_holds_is_found_and_covered():
    """A ball, and a stick, at the end of an arm; neither a bump that is too small nor a ball far from all hands is."""
    arm = np.array([0.0, 1.0, 0.0]), np.array([0.5, 1.0, 0.0])
    hands = {"left": (np.array([0.45, 1.0, 0.0]), arm[1])}

    def solid_with(*more) -> tuple[Solid, np.ndarray]:
        def inside(p):
            found = to_segment(p.reshape(-1, 3), *arm).reshape(p.shape[:-1]) < 0.06
            for piece in more:
                found |= piece(p)
            return found

        solid = Solid.of(grid_of(inside, (-0.4, 0.4, -0.4), (1.0, 1.4, 0.4), 0.02))
        return solid, solid.ways([arm])[:, 0] / 0.06

    def ball(c, r):
        return lambda p: np.linalg.norm(p - c, axis=-1) < r

    def stick(p):
        return (np.abs(p[..., 0] - 0.5) < 0.04) & (np.abs(p[..., 2]) < 0.04) & (p[..., 1] > 0.5) & (p[..., 1] < 1.3)

    found = held_by_hands(*solid_with(ball((0.55, 0.85, 0.0), 0.15)), hands, 1.7)
    assert len(found) == 1 and found[0][0] == "left"
    ((center, radius),) = found[0][2]
    assert_allclose(center, (0.55, 0.85, 0.0), atol=0.03)
    assert abs(radius - 0.15) < 0.03
    solid, radii = solid_with(stick)
    found = held_by_hands(solid, radii, hands, 1.7)
    beyond = solid.points[(radii > 1.6) & (solid.points[:, 1] < 0.95)]
    pieces = [balls for _, _, balls in found]
    covered = np.any([np.linalg.norm(beyond - c, axis=1) < r for balls in pieces for c, r in balls], axis=0)
    assert len(pieces[0]) > 1 and covered.mean() > 0.8
    assert held_by_hands(*solid_with(ball((0.0, 0.9, 0.0), 0.12)), hands, 1.7) == []
    assert held_by_hands(*solid_with(ball((0.5, 0.95, 0.0), 0.07)), hands, 1.7) == []


def test_a_gaussian_that_would_be_a_spike_follows_what_is_calm():
    """A bar is drawn out to four times its length over a tenth of it: nothing that follows it grows as much, and what
    is far from there stays as it was."""
    x, tets, _ = box((1.0, 0.1, 0.1), (20, 2, 2))
    cage = Cage(x.astype(np.float32), tets.astype(np.int32), boundary(tets).astype(np.int32))
    n = 400
    rng = np.random.default_rng(0)
    means = rng.uniform((0.02, 0.02, 0.02), (0.98, 0.08, 0.08), (n, 3))
    quats = np.tile([1.0, 0, 0, 0], (n, 1))
    g = Gaussians.of(means, quats, np.full((n, 3), np.log(0.004)), np.zeros(n), np.zeros((n, 1, 3)))
    embedded = embed(g.means, g.quats, np.exp(g.log_scales), x, tets)
    drawn = x.astype(np.float64).copy()
    drawn[:, 0] += 0.3 * np.clip((x[:, 0] - 0.5) / 0.1, 0, 1)
    label = np.zeros(len(tets), int)
    parts = Parts(label, np.zeros(n, int), lambda a, b, c: a == b)
    new, count = calmed(embedded, g, cage, parts, np.stack([x.astype(np.float64), drawn]))

    def growth(e):
        y = [np.einsum("nkj,nkjd->nkd", e.weights.astype(np.float64), p[tets[e.host]]) for p in (x, drawn)]
        F = [np.swapaxes(p[:, 1:] - p[:, :1], 1, 2) for p in y]
        return np.linalg.norm(F[1] @ np.linalg.inv(F[0]), ord=2, axis=(1, 2))

    assert growth(embedded).max() > 3 and growth(new).max() < 1.9  # root mean square of 1.35
    far = np.abs(means[:, 0] - 0.55) > 0.2
    assert 20 < count < n // 2 and (new.host[far] == embedded.host[far]).all()


def test_a_cage_is_cut_where_the_skeleton_is_not_joined():
    """Legs that touch all along part up to the waist, where they hold; not a bit of volume is lost."""
    x, tets = trousers(gap=False)
    cage = Cage(x.astype(np.float32), tets.astype(np.int32), boundary(tets).astype(np.int32))
    label = (x[tets].mean(1)[:, 0] > 0.15).astype(int)
    label[7] = 1  # a tet of the left leg that is told to be the right one's hangs on nothing
    new, label, source = cut(cage, label, lambda a, b, c: c[:, 1] > 0.8)
    check_cage(new, "cut")
    assert_allclose(new.volumes().sum(), cage.volumes().sum(), rtol=1e-6)
    assert_allclose(new.vertices, cage.vertices[source])
    assert len(new.vertices) > len(cage.vertices)
    below = new.vertices[new.tets].mean(1)[:, 1] < 0.7
    left, right = (np.unique(new.tets[below & (label == k)]) for k in (0, 1))
    assert len(np.intersect1d(left, right)) == 0
    assert label[7] == 0


def test_nothing_is_split_where_all_faces_hold():
    x, tets, _ = box((1, 1, 1), (2, 2, 2))
    from prepare.rig_cut import facing

    new, source = split(tets, facing(tets)[0], len(x))
    assert (new == tets).all() and (source == np.arange(len(x))).all()


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
    found = named_joints(rig, {})
    assert {n: BONES[k] for n, k in found.items()} == {n: n for n in found}
    assert set(found) >= {
        "pelvis",
        "chest",
        "head",
        *(f"{s}_{n}" for s in ("left", "right") for n in (*ARM, *LEG)),
    }
    assert words("L_armUpper0001_bind_JNT") == ["l", "arm", "upper", "0001", "bind", "jnt"]
    with pytest.raises(BadInput, match="left shoulder"):
        named_joints(replace(rig, names=["x"] * len(rig.names)), {})


def test_a_fitted_skeleton_keeps_its_bones_and_moves_like_the_rig():
    """On a body turned by 70 degrees, half as large, with thinner bones: lengths hold, directions are the rig's."""
    rig, points = person()
    turn = Rotation.from_rotvec([0, 1.2, 0]).as_matrix()
    body = {n: 0.5 * turn @ p for n, p in points.items()}
    for s in ("left", "right"):  # longer forearms
        way = body[f"{s}_wrist"] - body[f"{s}_elbow"]
        body[f"{s}_wrist"], body[f"{s}_hand"] = body[f"{s}_wrist"] + 0.3 * way, body[f"{s}_hand"] + 0.3 * way
    f = fit(rig, marks_of(body))
    x = world_of(PARENTS, f.frames)[:, :, :3, 3]
    theirs = world_of(rig.parents, rig.frames)[:, :, :3, 3]
    length = np.linalg.norm(x[:, 1:] - x[:, PARENTS[1:]], axis=2)
    assert_allclose(length, np.broadcast_to(length[:1], length.shape), rtol=1e-9)
    for a, b in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle")):
        for s in ("left", "right"):
            i, j = BONES.index(f"{s}_{a}"), BONES.index(f"{s}_{b}")
            ours = (x[:, j] - x[:, i]) / np.linalg.norm(x[:, j] - x[:, i], axis=1, keepdims=True)
            wanted = (theirs[:, j] - theirs[:, i]) @ turn.T
            wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
            assert (ours * wanted).sum(1).min() > np.cos(np.radians(4))  # which way the rig looks is its mean
    assert f.residual["left_elbow"][1] < 1e-9 and f.residual["left_wrist"][0] > 0.005


def test_residuals_tell_what_left_and_right_disagree_in():
    rig, points = person()
    points["left_wrist"] = points["left_elbow"] + 1.2 * (points["left_wrist"] - points["left_elbow"])
    f = fit(rig, marks_of(points))
    forearm = np.linalg.norm(points["right_wrist"] - points["right_elbow"])
    assert_allclose(f.residual["left_wrist"][1], 0.1 * forearm, rtol=1e-6)
    points["left_elbow"] = points["left_shoulder"]
    with pytest.raises(BadInput, match="one place"):
        fit(rig, marks_of(points))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[1]", "not a JSON object"),
        ("{", "not JSON"),
        ('{"nose": [0, 0, 0]}', "no landmark"),
        ('{"neck": [0, 0]}', "three coordinates"),
        ('{"neck": [0, NaN, 0]}', "three coordinates"),
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
    from sim.skinning import Skinning

    rng = np.random.default_rng(0)
    points, joints = rng.normal(size=(40, 3)), rng.integers(0, 5, (40, 4))
    weights, matrices = rng.dirichlet(np.ones(4), 40), rng.normal(size=(5, 4, 4))
    targets = ti_cpu.Vector.field(3, ti_cpu.f32, 100)
    vertices = rng.permutation(60)[:40]
    Skinning(30, vertices, points, joints, weights, 5).pose(matrices, targets)
    expected = skin(points, joints, weights, matrices)
    assert_allclose(targets.to_numpy()[30 + vertices], expected, atol=1e-5)
    untouched = np.setdiff1d(np.arange(100), 30 + vertices)
    assert (targets.to_numpy()[untouched] == 0).all()


@pytest.fixture(scope="module")
def walker(ti_cpu, tmp_path_factory):
    """The bar of tests/glb.py as an asset that bends by itself."""
    from prepare.command import prepare_file

    folder = tmp_path_factory.mktemp("rig")
    b, scene = bar()
    path = b.write(folder / "bar.glb", scene)
    lines = []
    prepare_file(path, folder / "bar.h5", vertices=300, progress=lambda *_: None, report=lines.append)
    return folder / "bar.h5", lines


def test_a_skinned_mesh_becomes_a_body_that_moves(walker):
    path, lines = walker
    asset = Asset.load(path)
    a, rig = asset.animation, asset.provenance["rig"]
    assert asset.material["poisson"] == 0.45 and MOVING == "flesh"
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


def test_a_body_moves_by_itself_in_a_scene(walker):
    """It starts at rest, goes where its skeleton leads it, comes back, and tears nowhere; reset begins anew."""
    from display.frame import Frame
    from display.world import World
    from scenes.scene import Body, Light, Material, Scene

    path, _ = walker
    asset = Asset.load(path)
    a, place = asset.animation, (0.3, 1.0, 0.2)
    body = Body(str(path), Material.named(MOVING), position=place, scale=4.0)
    world = World(Scene([body], Light((0, 3, 1)), (0, 1, 2), (0, 1, 0)), width=32, height=32)
    least, most = 1.0, 1.0
    rest = asset.cage.vertices.astype(np.float64)
    tets = asset.cage.tets
    frames = round(60 * (RAMP + a.duration))
    world.renderer.render = lambda cameras: None  # what is looked at is where things are
    world.shadow.cast = lambda: None
    for k in range(frames):
        world.step(Frame(1 / 60, k / 60, [], []))
        x = (world.solver.x.to_numpy()[: len(rest)] - np.array(place)) / 4.0
        if k == frames // 2:
            led = a.vertices[a.driven]
            wanted = a.skinned(rest[a.vertices], a.matrices((k + 1) / 60))[a.driven]
            assert_allclose(x[led], wanted, atol=1e-5)
            assert np.abs(x[led] - rest[led]).max() > 0.03
        least = min(least, least_volumes(tets, np.stack([rest, x])).min())
        edges = np.stack([np.linalg.norm(y[tets[:, 0]] - y[tets[:, 1]], axis=1) for y in (rest, x)])
        most = max(most, (edges[1] / edges[0]).max())
    assert least > 0.05 and most < 2.5
    assert world.stats()["finite"] and world.bodies()[0].driven
    world.apply({"reset": True})
    assert_allclose(world.solver.x.to_numpy()[: len(rest)], 4 * rest + place, atol=1e-5)
    world.step(Frame(1 / 60, 0, [], []))
    moved = np.abs(world.solver.x.to_numpy()[a.vertices[a.driven]] - (4 * rest[a.vertices[a.driven]] + place)).max()
    assert moved < 2e-3  # the ramp begins slowly


def test_what_belongs_together_is_said(tmp_path):
    from prepare.rig_command import mover

    b, scene = bar()
    path = b.write(tmp_path / "bar.glb", scene)
    with pytest.raises(BadInput, match="has its own rig"):
        mover(path, path, None)
    with pytest.raises(BadInput, match="belongs to --rig"):
        mover(tmp_path / "a.ply", None, path)
    with pytest.raises(BadInput, match="no such file"):
        mover(tmp_path / "a.ply", tmp_path / "none.glb", None)
    assert mover(tmp_path / "a.ply", None, None) is None


def test_tree_is_ordered():
    assert all(TREE[n] is None or BONES.index(TREE[n]) < k for k, n in enumerate(BONES))
