"""Splats of several pieces: a cage for each in one asset, and each a body of its own in a scene."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import vrgs
from assets.asset import Asset
from assets.file_access import atomic_write_all
from assets.gaussians import Gaussians, concatenate
from assets.splat_files import write_gaussians
from core.errors import BadInput
from core.material import Material
from core.point_location import TetLocator
from core.tetmesh import face_components, vertex_components
from core.vocabulary import Body, Light
from display.edit.body_registry import BodyRegistry
from display.scene_bodies import load_bodies
from prepare.cage.cage_generation import ANGLE_MIN, INSIDE_MIN
from prepare.cage.component_cages import MIN_COMPONENT, Grid, components_of, vertex_counts
from prepare.cage.level_set import level_sets
from prepare.cage.mesh_quality import dihedral_angles, non_manifold_vertices
from prepare.cleaning import clean, clean_components
from prepare.pipeline import Options, fill, prepare
from prepare.prepared_files import prepare_file
from scenes.scene import Scene
from tests.support.shells import ball, ring


def moved(g: Gaussians, *to: float, scale: float = 1.0) -> Gaussians:
    return g.transformed(np.eye(3), to, scale)


def two(gap: float = 1.0) -> Gaussians:
    """A ball of radius 1, and beside it a ring of two thirds its size."""
    return concatenate([ball(), moved(ring(), 2.2 + gap, 0.0, 0.0, scale=0.66)])


def test_vertices_are_shared_out_by_area_and_specks_get_none():
    assert vertex_counts(np.array([3.0, 1.0]), 1000).tolist() == [750, 250]
    assert vertex_counts(np.array([3.0, 0.1, 1.0]), 1000).tolist() == [750, 0, 250]
    assert vertex_counts(np.array([1.0]), 50).tolist() == [50]
    assert vertex_counts(np.ones(3), 100).tolist().count(50) == 2
    many = vertex_counts(np.ones(40), 100_000)
    assert (many > 0).sum() == 32 and abs(many.sum() - 100_000) < 32


def test_cleaning_keeps_pieces_that_are_bodies():
    """Ball and ring stay; a few floaters, a flat sheet and a smear as large as the ring do not."""
    rng = np.random.default_rng(0)
    sheet = ball(900, open_below=-2)
    sheet = replace(sheet, means=(sheet.means * [1.0, 0.0, 1.0] + [-6.0, 0.0, 0.0]).astype(np.float32))
    floaters = moved(ball().select(rng.integers(0, 2000, 20)), 0.0, 7.0, 0.0, scale=0.1)
    smear = replace(ring().select(np.arange(3)), log_scales=np.full((3, 3), 0.0, np.float32))
    both = two()
    kept, number, counts = clean_components(concatenate([both, sheet, floaters, smear]))
    assert len(kept) == len(both) and counts["kept"] == len(both)
    assert np.bincount(number).tolist() == sorted((len(ball()), len(ring())), reverse=True)
    assert counts["specks"] == 1  # the sheet; 20 Gaussians are no piece
    assert counts["huge"] + counts["apart"] == len(sheet) + 23
    alone = ball()
    kept, number, counts = clean_components(alone)
    assert len(kept) == len(clean(alone)[0]) and (number == 0).all()
    with pytest.raises(BadInput, match="on a plane"):
        clean_components(sheet)


@pytest.fixture(scope="module")
def pair(ti_cpu) -> Asset:
    return prepare(two(), Options(vertices=800, up="+y", scale=0.4, pieces=True))


def test_each_piece_keeps_the_promises(pair):
    cage, figures = pair.cage, pair.provenance["figures"]
    pair.check("pair")
    cage.check("pair")
    own = face_components(cage.tets)
    assert own.max() == 1 and figures["pieces"] == 2 and pair.provenance["counts"]["specks"] == 0
    assert abs(len(cage.vertices) - 800) <= 0.15 * 800
    assert dihedral_angles(cage.vertices, cage.tets).min() >= ANGLE_MIN
    assert len(non_manifold_vertices(cage.surface)) == 0
    g = pair.gaussians
    assert len(g) == pair.provenance["counts"]["kept"] > 0.99 * len(two())
    of_tet = own[pair.embedding.host]
    assert (of_tet == of_tet[:, :1]).all()  # no Gaussian hangs between two bodies
    for k in range(2):
        mine = of_tet[:, 0] == k
        tets = cage.tets[own == k]
        inside = TetLocator(cage.vertices, tets).find(g.means[mine & (g.opacities > 0.5)].astype(np.float64)) >= 0
        assert inside.mean() >= INSIDE_MIN
    assert_allclose(np.ptp(g.means[:, 0]), 0.4, rtol=0.05)


def test_the_distance_grid_is_that_of_both(pair):
    grid, x = pair.sdf, pair.cage.vertices.astype(np.float64)
    component = vertex_components(pair.cage.tets)
    for k in range(2):
        mine = x[pair.cage.tets[component == k]].reshape(-1, 3)
        middle = (mine.min(0) + mine.max(0)) / 2
        away = (mine[:, 0].max() - middle[0]) * (0.85 if k else 0.0)  # in the ring's tube, in the ball's middle
        i = np.rint((middle + [away, 0, 0] - grid.origin) / grid.spacing).astype(int)
        assert grid.values[tuple(i)] < 0
    assert (grid.values[[0, -1]] > 0).all() and (grid.values[..., [0, -1]] > 0).all()


def test_two_far_apart_are_as_well_made_as_two_near(ti_cpu):
    """Forty radii between them: each piece has a grid of its own."""
    asset = prepare(two(40.0), Options(vertices=800, up="+y", pieces=True))
    assert asset.provenance["figures"]["pieces"] == 2
    assert asset.provenance["figures"]["inside"] >= INSIDE_MIN


def test_pieces_closer_than_the_search_for_them_are_parted_by_the_level_set(ti_cpu):
    """A gap of 4 % of the extent: the Gaussians count as one cluster; the filled shape falls into two."""
    g = concatenate([ball(6000, open_below=-2), moved(ball(6000, open_below=-2), 2.17, 0.0, 0.0)])
    assert clean_components(g)[1].max() == 0
    every, grid = np.arange(len(g)), Grid.over(g.means.astype(np.float64), 20_000)
    cells = fill(g, grid)
    found = components_of(g, every, grid, cells, level_sets(cells["solid"], MIN_COMPONENT))
    assert [len(c.indices) for c in found] == [6000, 6000]
    assert_allclose(*(c.area() for c in found), rtol=0.05)
    (alone,) = components_of(g, every, grid, cells, level_sets(cells["solid"]))
    assert len(g) - len(alone.indices) > 2000


def test_in_a_scene_each_piece_is_a_body_of_its_own(pair, tmp_path):
    pair.save(tmp_path / "pair.h5")
    body = Body(str(tmp_path / "pair.h5"), Material.named("plush"), position=(0.0, 1.0, 0.0), scale=0.5)
    moving = [(p.body, p.part) for p in load_bodies(Scene([body], Light((0, 2, 0)), (0, 1, 1), (0, 0, 0)))[1]]
    assert len(moving) == 2
    vertices = sum(len(soft.vertices) for soft, _ in moving)
    assert vertices == len(pair.cage.vertices) and sum(len(p.gaussians) for _, p in moving) == len(pair.gaussians)
    assert len(moving[0][0].tets) >= len(moving[1][0].tets)
    for soft, part in moving:
        soft.check()
        assert soft.sdf is None and part.host.max() < len(soft.tets)
        corners = np.einsum("nkj,nkjc->nkc", part.weights, soft.vertices[soft.tets[part.host]])
        # corners of large Gaussians on the surface extrapolate; their mean stays near the centre
        off = np.linalg.norm(corners.mean(1) - part.gaussians.means, axis=1)
        assert np.median(off) < 1e-4 and off.max() < 0.02
    static, _ = load_bodies(Scene([replace(body, material=None)], None, (0, 1, 1), (0, 0, 0)))
    assert len(static) == 1 and len(static[0][1]) == 1  # what does not move stays whole, with the grid of all


def test_a_game_sees_the_largest_piece_of_each_of_the_scenes_bodies(pair, tmp_path):
    pair.save(tmp_path / "pair.h5")
    plush = Material.named("plush")
    scene = Scene([Body(str(tmp_path / "pair.h5"), plush), Body("ring_red", plush)], None, (0, 1, 1), (0, 0, 0))
    names = [piece.body.name for piece in load_bodies(scene)[1]]
    assert names == [str(tmp_path / "pair.h5"), "ring_red", str(tmp_path / "pair.h5")]
    device = SimpleNamespace(scene=scene, animations=[], solver=SimpleNamespace(body_models=names))
    assert BodyRegistry(device).scene_states(names) == names[:2]


def test_the_command_keeps_all_pieces_and_says_how_many(ti_cpu, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("VRGS_CACHE", str(tmp_path / "cache"))
    write_gaussians(tmp_path / "two.ply", two())
    line = ["prepare", str(tmp_path / "two.ply"), "--out", str(tmp_path / "two.h5"), "--vertices", "400", "--up", "+y"]
    assert vrgs.main([*line, "--pieces", "--cells", "uniform", "--no-report"]) == 0
    said = capsys.readouterr().out
    assert "2 pieces, each with a cage" in said and "in uniform cells" in said
    made = Asset.load(tmp_path / "two.h5").provenance
    assert made["figures"]["pieces"] == 2 and made["options"]["pieces"] and made["options"]["cells"] == "uniform"
    lines = []
    prepare_file(tmp_path / "two.ply", tmp_path / "one.h5", Options(vertices=400, up="+y"), report=lines.append)
    assert any("the largest is taken" in line and "--pieces keeps all" in line for line in lines)
    assert Asset.load(tmp_path / "one.h5").provenance["figures"]["cells"] == "adaptive"


@pytest.mark.parametrize(
    "options, message",
    [
        (["prepare", "two.ply", "--out", "o.h5", "--pieces", "--rig", "r.glb"], "--pieces is for"),
        (["prepare", "two.ply", "--out", "o.h5", "--pieces", "--static"], "--pieces belongs to bodies"),
        (["--pieces", "--headless"], "is for a splat file given with --body"),
    ],
)
def test_pieces_where_there_can_be_none_are_refused(ti_cpu, tmp_path, capsys, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    write_gaussians(tmp_path / "two.ply", ball(200))
    assert vrgs.main(options) == 2
    assert message in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["two.ply"]


def test_of_several_files_all_are_written_or_none(tmp_path):
    (tmp_path / "b").write_text("old")
    with (
        pytest.raises(BadInput, match=f"{tmp_path}/b: is full"),
        atomic_write_all(tmp_path / "a", tmp_path / "b") as files,
    ):
        files[0].write_text("new")
        raise BadInput(f"{files[1]}: is full")
    assert [p.name for p in tmp_path.iterdir()] == ["b"] and (tmp_path / "b").read_text() == "old"
    with atomic_write_all(tmp_path / "a", tmp_path / "b") as files:
        for file in files:
            file.write_text("new")
        assert not (tmp_path / "a").exists()
    assert [(tmp_path / n).read_text() for n in "ab"] == ["new", "new"]
