"""Cages by TetGen: its process may be missing, hang, crash or return anything. TetGen itself: if it is there."""

import sys
from importlib.util import find_spec

import numpy as np
import pytest
from numpy.testing import assert_allclose

import prepare.cage.tetgen_mesher as tetgen
import vrgs
from assets.splat_files import write_gaussians
from core.distance_grid import DistanceGrid, marching_cubes
from core.errors import BadInput
from core.tetmesh import enclosed_volume, triangle_areas
from prepare.cage.cage_generation import cage_of, fault
from prepare.cage.component_cages import mesh
from prepare.cage.embedding_hosts import fraction_inside
from prepare.cage.level_set import volume_of
from prepare.cage.mesh_quality import non_manifold_vertices
from prepare.cage.tetgen_mesher import MeshFailed, checked_cage, decimated, run_tetgen
from prepare.pipeline import Options, prepare
from tests.support.shells import ball

N, R = 40, 14.0
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)

needs_open3d = pytest.mark.skipif(find_spec("open3d") is None, reason="open3d is not installed (make studio)")


def sphere() -> np.ndarray:
    nodes = np.stack(np.meshgrid(*[np.arange(N)] * 3, indexing="ij"), -1)
    return (np.linalg.norm(nodes - 19.5, axis=-1) - R).astype(np.float32)


def inner_points(n: int = 3000) -> np.ndarray:
    """Points in the ball, to be enclosed."""
    d = np.random.default_rng(0).normal(size=(n, 3))
    return 19.5 + (R - 0.5) * d / np.linalg.norm(d, axis=1, keepdims=True)


@pytest.fixture
def worker(tmp_path, monkeypatch):
    """Puts a script in the place of the one that runs TetGen."""

    def put(body: str) -> None:
        path = tmp_path / "worker.py"
        path.write_text("import sys, os, time\nimport numpy as np\nsource, target = sys.argv[1:]\n" + body)
        monkeypatch.setattr(tetgen, "WORKER", path)
        monkeypatch.setenv(tetgen.PYTHON, sys.executable)

    return put


@pytest.mark.parametrize(
    "body, message",
    [
        ("time.sleep(60)", "more than 1 s"),
        ("os.abort()", "crashed .SIGABRT"),
        ("print('RuntimeError: two facets cross', file=sys.stderr); sys.exit(4)", "gave up .*two facets cross"),
        ("", "gave up .*status 0"),
        ("np.savez(target, vertices=np.zeros((0, 3)), tets=np.zeros((0, 4), int))", "no tets"),
        ("np.savez(target, vertices=np.eye(3), tets=np.array([[0, 1, 2, 3]]))", "out of range"),
        ("np.savez(target, vertices=np.full((4, 3), np.nan), tets=np.array([[0, 1, 2, 3]]))", "out of range"),
        ("np.savez(target, vertices=np.ones((4, 3)), tets=np.array([[0, 1, 2, 3]]))", "without volume"),
    ],
)
def test_whatever_the_process_does_is_a_reason_not_a_crash(worker, body, message):
    worker(body)
    with pytest.raises(MeshFailed, match=message):
        run_tetgen(CORNERS, np.array([[0, 2, 1]]), 1.0, limit=1.0 if "sleep" in body else 30.0)


def test_what_the_process_is_given_and_returns(worker):
    """An inverted tet is turned, vertices that no tet uses are dropped, nodes on edges (order 2) are ignored."""
    worker(
        "d = np.load(source)\n"
        "assert d['maxvolume'] == 0.5 and d['minratio'] > 1 and d['mindihedral'] > 0 and d['faces'].shape == (1, 3)\n"
        "np.savez(target, vertices=np.concatenate([np.full((1, 3), 9.0), d['vertices']]),"
        " tets=np.array([[1, 3, 2, 4, 0, 0, 0, 0, 0, 0]]))"
    )
    cage = run_tetgen(CORNERS, np.array([[0, 2, 1]]), 0.5)
    assert_allclose(cage.vertices, CORNERS)
    assert_allclose(cage.volumes(), [1 / 6])
    assert len(cage.surface) == 4


def test_a_pinched_mesh_is_refused():
    """Two tets that share only a corner."""
    vertices = np.concatenate([CORNERS, -CORNERS[1:]])
    with pytest.raises(ValueError, match="not one closed manifold"):
        checked_cage(vertices, np.array([[0, 1, 2, 3], [0, 4, 5, 6]]))


@needs_open3d
def test_a_surface_is_decimated_and_screened():
    v, f = marching_cubes(DistanceGrid(sphere(), np.zeros(3), 1.0))
    few, faces = decimated(v, f, 600)
    assert abs(len(faces) - 600) < 20 and len(non_manifold_vertices(faces)) == 0
    assert_allclose(enclosed_volume(few, faces), 4 / 3 * np.pi * R**3, rtol=0.03)
    both = np.concatenate([v, v + [R, 0, 0]]), np.concatenate([f, f + len(v)])
    with pytest.raises(MeshFailed, match="intersects itself"):
        decimated(*both, 1200)
    with pytest.raises(MeshFailed, match="closed manifold"):
        decimated(v, f[: len(f) // 2], 600)


@needs_open3d
def test_what_passes_the_gate_is_taken(worker, ti_cpu, tmp_path):
    """A sound mesh in the place of TetGen's: the search ends, the cage is as good as any, and tetgen is its mesher."""
    good = cage_of(sphere(), inner_points(), 700, lambda share: None)
    np.savez(tmp_path / "good.npz", vertices=good.vertices, tets=good.tets)
    worker(f"import shutil; shutil.copy({str(tmp_path / 'good.npz')!r}, target)")
    said, shares = [], []
    cage, used = mesh("tetgen", sphere(), inner_points(), 700, shares.append, say=said.append)
    assert (used, said) == ("tetgen", [])
    assert fault(cage, volume_of(sphere()), fraction_inside(cage.vertices, cage.tets, inner_points()), 700) == ""
    assert shares and all(0 <= s <= 1 for s in shares)


@needs_open3d
def test_where_tetgen_fails_stuffing_makes_the_cage_and_that_is_told(worker, ti_cpu, monkeypatch):
    worker("os.abort()")
    monkeypatch.setattr("prepare.cage.component_cages.check_installed", lambda: None)
    said = []
    asset = prepare(ball(), Options(vertices=300, up="+y", mesher="tetgen"), say=said.append)
    assert asset.provenance["figures"]["mesher"] == "stuffing"
    assert asset.provenance["options"]["mesher"] == "tetgen"
    assert said == ["TetGen: TetGen crashed (SIGABRT); the cage is made by stuffing instead"]


@needs_open3d
def test_without_the_package_one_line_says_how_to_get_it(tmp_path, capfd, monkeypatch):
    write_gaussians(tmp_path / "ball.ply", ball(200))
    asked = ["prepare", str(tmp_path / "ball.ply"), "--out", str(tmp_path / "out.h5"), "--mesher", "tetgen"]
    bare = tmp_path / "python"
    bare.write_text("#!/bin/sh\nexit 1\n")
    bare.chmod(0o755)
    for python, message in ((bare, tetgen.INSTALL), (tmp_path / "none", "not a Python that runs")):
        monkeypatch.setenv(tetgen.PYTHON, str(python))
        assert vrgs.main(asked) == 2
        complaint = [line for line in capfd.readouterr().err.splitlines() if line.startswith("vrgs:")]
        assert len(complaint) == 1 and message in complaint[0]
    assert not (tmp_path / "out.h5").exists()


def test_tetgen_itself(ti_cpu):
    try:
        tetgen.check_installed()
    except BadInput:
        pytest.skip("tetgen is not installed; VRGS_TETGEN_PYTHON names no Python that has it")
    v, f = marching_cubes(DistanceGrid(sphere(), np.zeros(3), 1.0))
    few, faces = decimated(v, f, 800)
    cage = run_tetgen(few, faces, 0.3 * (triangle_areas(few, faces).mean()) ** 1.5)
    assert_allclose(cage.volumes().sum(), enclosed_volume(few, faces), rtol=1e-5)
    cage, used = mesh("tetgen", sphere(), inner_points(), 700, lambda share: None)
    assert used == "tetgen" and fault(cage, volume_of(sphere()), 1.0, 700) == ""
