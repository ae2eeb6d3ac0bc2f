"""From a splat to an asset: cleaning, the way up, the cage's figures, and what bad input is told."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assets.asset import Asset
from assets.gaussians import Gaussians, concatenate
from assets.orientation import AXES, guess_up_axis, rotation_to_up
from assets.splat_files import write_gaussians
from commands.prepare import PrepareOptions
from commands.prepare import prepare as run
from core.errors import BadInput
from core.material import MATERIALS
from core.point_location import TetLocator
from core.tetmesh import face_components, tet_volumes
from prepare.cage.mesh_quality import dihedral_angles, euler_characteristic, non_manifold_vertices
from prepare.cleaning import clean
from prepare.pipeline import STEPS, Options, body_size, clean_and_orient, prepare
from prepare.prepared_files import prepare_file
from prepare.progress import gaussians_of, no_progress
from tests.support.shells import ball, ring, shell, toy

SPLATS = {"toy_cat.ply": "-y", "plush_dragon.ply": "+y"}  # and which way is up in them, as pictures show


def some(n: int, seed=0, **changes) -> Gaussians:
    """n small opaque Gaussians all over a unit cube."""
    rng = np.random.default_rng(seed)
    g = Gaussians.of(
        rng.uniform(0, 1, (n, 3)), np.tile([1.0, 0, 0, 0], (n, 1)), np.full((n, 3), -3.0), np.full(n, 3.0),
        np.zeros((n, 1, 3)),
    )  # fmt: skip
    return replace(g, **{name: np.asarray(value, np.float32) for name, value in changes.items()})


def test_cleaning_counts_what_it_leaves_out():
    body = ball()
    clear = replace(body.select(np.arange(7)), logit_opacities=np.full(7, -9, np.float32))
    huge = replace(body.select(np.arange(5)), log_scales=np.full((5, 3), 0.5, np.float32))
    floaters = replace(body.select(np.arange(9)), means=body.means[:9] * np.float32(0.1) + np.float32(1.5))
    far = replace(body.select(np.arange(3)), means=body.means[:3] + np.float32(500))
    kept, counts = clean(concatenate([clear, body, huge, floaters, far]))
    n = len(body)
    assert counts == {"read": n + 24, "transparent": 7, "huge": 5, "apart": 12, "kept": n}
    assert (kept.means == body.means).all()


PLANE = np.c_[np.random.default_rng(1).uniform(0, 1, (500, 2)), np.zeros(500)]
BAD = {
    "none": (some(1).select(np.zeros(1, bool)), "holds no Gaussians"),
    "too few": (some(12), "only 12 of 12"),
    "all transparent": (some(500, logit_opacities=np.full(500, -9)), "transparent"),
    "a plane": (some(500, means=PLANE), "plane"),
    "a line": (some(500, means=PLANE * [1, 0, 0]), "plane or a line"),
    "a point": (some(500, means=np.ones((500, 3))), "extent is 0"),
    "astronomic": (some(500, means=some(500).means * 1e12), "extent is"),
    "all huge": (some(500, log_scales=np.full((500, 3), 3.0)), "only 0 of 500"),
    "all huge but one": (
        some(500, log_scales=np.where(np.arange(500)[:, None] % 500, [[3.0] * 3], -3.0)),
        "only 0 of 500",
    ),
    "mist": (some(500, logit_opacities=np.full(500, -4.0)), "opaque"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_used_is_told_in_one_line(ti_cpu, name):
    gaussians, message = BAD[name]
    with pytest.raises(BadInput, match=message) as caught:
        prepare(gaussians)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"up": "y"}, "up axis"),
        ({"scale": 1e4}, "size"),
        ({"vertices": 10}, "50 to 100000"),
        ({"material": "cheese"}, "is unknown; one of foam, "),
    ],
)
def test_bad_options_are_told_at_once(options, message):
    """Without Taichi running: before any work."""
    with pytest.raises(BadInput, match=message):
        prepare(ball(), Options(**options))


@pytest.mark.parametrize("up", AXES)
def test_up_is_found_by_the_underside(up):
    assert guess_up_axis(toy().transformed(rotation_to_up(up).T))[0] == up


def test_a_plausible_size_is_kept():
    assert body_size(0.3, None) == 0.3
    assert body_size(1.8, None) == body_size(1e-3, None) == 0.25
    assert body_size(1.8, 0.4) == 0.4


def assert_sound(asset: Asset, vertices: int) -> None:
    """The acceptance figures, measured anew."""
    cage, g = asset.cage, asset.gaussians
    assert abs(len(cage.vertices) - vertices) <= 0.15 * vertices
    assert (tet_volumes(cage.vertices, cage.tets) > 0).all()
    assert dihedral_angles(cage.vertices, cage.tets).min() >= 10
    assert len(non_manifold_vertices(cage.surface)) == 0
    assert face_components(cage.tets).max() == 0
    opaque = g.means[g.opacities > 0.5].astype(np.float64)
    outside = (TetLocator(cage.vertices, cage.tets).find(opaque) < 0).sum() - asset.provenance["counts"]["flap"]
    assert outside <= 0.01 * len(opaque)
    low, high = cage.vertices.min(0), cage.vertices.max(0)
    assert_allclose([low[0] + high[0], low[1], low[2] + high[2]], 0, atol=1e-6)
    assert len(asset.embedding.host) == len(g)


@pytest.fixture(scope="module")
def prepared_ball(ti_cpu):
    """A ball half a metre across without its underside, as a body, and what its progress said."""
    seen = []
    options = Options(vertices=600, scale=0.5, up="+y", material="rubber")
    return prepare(ball(), options, progress=lambda *step: seen.append(step)), seen


def test_a_ball_becomes_a_body(prepared_ball, tmp_path):
    """Its missing underside is closed; the steps come in order; the file can be read back."""
    asset, seen = prepared_ball
    assert_sound(asset, 600)
    assert list(dict.fromkeys(step for step, _ in seen)) == list(STEPS)
    assert all(0 <= done <= 1 for _, done in seen)
    assert asset.material == MATERIALS["rubber"]
    extent = np.ptp(asset.gaussians.means, axis=0)
    assert 0.45 < extent.max() <= 0.5
    # The ball above y = -0.75 is 0.957 of a ball of diameter 0.5; the discs' thickness and the margin come on top.
    true = 0.957 * 4 / 3 * np.pi * 0.25**3
    assert true < asset.cage.volumes().sum() < 1.3 * true
    asset.save(tmp_path / "ball.h5")
    again = Asset.load(tmp_path / "ball.h5")
    assert (again.cage.tets == asset.cage.tets).all()
    assert again.provenance == asset.provenance


def test_the_distance_grid_is_that_of_the_ball(prepared_ball):
    asset, _ = prepared_ball
    grid, g = asset.sdf, asset.gaussians
    assert grid.values.dtype == np.float16
    assert 45 <= max(grid.values.shape) <= 64
    radius = (g.means[:, 0].max() - g.means[:, 0].min()) / 2
    centre = [0, g.means[:, 1].max() - radius, 0]
    nodes = grid.nodes()
    above = nodes[..., 1] > centre[1]  # further down the underside is nearer
    true = np.linalg.norm(nodes - centre, axis=-1) - radius
    error = (grid.values - true)[above & (np.abs(true) < 0.4 * radius)]
    assert np.abs(error).max() < 0.04 * radius + grid.spacing  # discs reach past the ball by about one sigma
    assert (grid.values[[0, -1]] > 0).all() and (grid.values[:, [0, -1]] > 0).all() and (grid.values[..., 0] > 0).all()


@pytest.mark.parametrize("minor", [0.25, 0.08])
def test_a_ring_stays_a_ring(ti_cpu, minor):
    """Also one whose tube is thinner than the lattice's cell: it is made thick enough, not lost."""
    asset = prepare(ring(minor=minor), Options(vertices=400, up="+y"))
    assert_sound(asset, 400)
    assert euler_characteristic(asset.cage.surface) == 0


def test_thin_parts_stay_on_the_body(ti_cpu):
    """A ball with a whisker one twentieth as thick."""
    rng = np.random.default_rng(0)
    y, turn = rng.uniform(0.9, 2.2, 800), rng.uniform(0, 2 * np.pi, 800)
    normals = np.stack([np.cos(turn), 0 * y, np.sin(turn)], 1)
    whisker = shell(0.05 * normals + np.stack([0 * y, y, 0 * y], 1), normals, sigma=0.03)
    asset = prepare(concatenate([ball(), whisker]), Options(vertices=500, up="+y"))
    assert_sound(asset, 500)
    tip = asset.gaussians.means[:, 1].max()
    assert asset.cage.vertices[:, 1].max() > tip


def test_view_dependent_colour_is_rotated_along():
    """A body that is rotated in the file and rotated back by `up` is the same body."""
    rng = np.random.default_rng(0)
    body = ball()
    body = replace(body, sh=rng.normal(0, 0.1, (len(body), 9, 3)).astype(np.float32))
    turned = body.transformed(rotation_to_up("-x").T)
    upright, back = (
        gaussians_of(clean_and_orient(g, Options(up=up), no_progress))[0] for g, up in ((body, "+y"), (turned, "-x"))
    )
    assert_allclose(back.means, upright.means, atol=1e-5)
    assert_allclose(back.sh, upright.sh, atol=1e-5)


def test_a_file_is_prepared_whole_or_not_at_all(ti_cpu, tmp_path):
    lines = []
    write_gaussians(tmp_path / "ball.ply", ball())
    out = prepare_file(tmp_path / "ball.ply", tmp_path / "out.h5", Options(vertices=300, up="+y"), report=lines.append)
    assert out == tmp_path / "out.h5"
    asset = Asset.load(out)
    assert asset.provenance["source"] == "ball.ply"
    assert any("300" in line or str(len(asset.cage.vertices)) in line for line in lines)
    write_gaussians(tmp_path / "mist.ply", BAD["mist"][0])
    before = sorted(tmp_path.iterdir())
    with pytest.raises(BadInput, match=r"mist\.ply: .*opaque"):
        prepare_file(tmp_path / "mist.ply", tmp_path / "mist.h5", report=lines.append)
    with pytest.raises(BadInput, match="asset already"):
        prepare_file(out, tmp_path / "again.h5", report=lines.append)
    assert sorted(tmp_path.iterdir()) == before


def test_the_command_checks_its_names_first(tmp_path):
    write_gaussians(tmp_path / "ball.ply", ball(100))
    (tmp_path / "there.h5").write_text("precious")

    def command(splats, out, force=False, no_report=True):
        run(
            PrepareOptions(splats=tmp_path / splats, out=tmp_path / out, force=force, vertices=300, no_report=no_report)
        )

    with pytest.raises(BadInput, match=r"none\.ply: no such file"):
        command("none.ply", "out.h5")
    with pytest.raises(BadInput, match=r"ends in \.h5"):
        command("ball.ply", "out.ply")
    with pytest.raises(BadInput, match="--force"):
        command("ball.ply", "there.h5")
    with pytest.raises(BadInput, match="does not exist"):
        command("ball.ply", "nowhere/out.h5")
    (tmp_path / "out.report.json").write_text("precious")
    with pytest.raises(BadInput, match=r"out\.report\.json: exists already"):
        command("ball.ply", "out.h5", no_report=False)
    assert (tmp_path / "there.h5").read_text() == (tmp_path / "out.report.json").read_text() == "precious"


@pytest.mark.shared
@pytest.mark.parametrize("name", SPLATS)
def test_captures_become_bodies(ti_cpu, shared, tmp_path, name):
    """The acceptance of this stage at 2,000 vertices: sound cage, upright, 99 % inside, in less than a minute."""
    splats, options = shared / "data" / "splats" / name, Options(up=SPLATS[name])
    out = prepare_file(splats, tmp_path / "body.h5", options, report=lambda line: None)
    asset = Asset.load(out)
    assert_sound(asset, 2000)
    assert asset.provenance["figures"]["seconds"] < 60
    assert_allclose(np.ptp(asset.gaussians.means, axis=0).max(), 0.25, atol=0.015)
