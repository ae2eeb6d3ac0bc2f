"""A cage from an OpenUSD file: it is taken as it stands beside the splat, and a stranger's file ends in one line."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import vrgs
from assets.asset import Asset
from assets.splat_files import write_gaussians
from core.errors import BadInput
from core.tetmesh import box_mesh, enclosed_volume
from prepare.cage import cage_file
from prepare.cage.cage_file import read_cage
from tests.support.samples import refused
from tests.support.shells import ball

pytest.importorskip("pxr", reason="usd-core is not installed (pip install -r requirements-usd.txt)")

UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # turns +z to +y


def usda(points: np.ndarray, tets: np.ndarray, *, more: str = "", over: str = "") -> str:
    """The text of a file with one mesh, under a transform that moves it by (0, 0, 0.5)."""
    rows = ", ".join(str(tuple(row)) for row in points.tolist())
    cells = ", ".join(str(tuple(row)) for row in tets.tolist())
    mesh = f"def TetMesh 'Cage'\n{{\npoint3f[] points = [{rows}]\nint4[] tetVertexIndices = [{cells}]\n{over}\n}}"
    move = "double3 xformOp:translate = (0, 0, 0.5)\nuniform token[] xformOpOrder = ['xformOp:translate']"
    return f"#usda 1.0\n(\nmetersPerUnit = 0.01\n)\ndef Xform 'World'\n{{\n{move}\n{mesh}\n}}\n{more}\n"


def cube(cells=(5, 5, 5)) -> tuple[np.ndarray, np.ndarray]:
    """Points and tets of a cube of 2.6 around the origin."""
    points, tets, _ = box_mesh(np.full(3, 2.6), np.array(cells))
    return points - 1.3, tets


def test_a_mesh_is_read_in_the_world_whatever_its_orientation(tmp_path):
    points, tets = cube((1, 1, 1))
    unused = np.concatenate([points, [[9.0, 9.0, 9.0]]])
    (tmp_path / "a.usda").write_text(
        usda(unused, tets[:, [1, 0, 2, 3]], over="uniform token orientation = 'leftHanded'")
    )
    cage = read_cage(tmp_path / "a.usda")
    assert_allclose(cage.vertices, points + [0, 0, 0.5], atol=1e-6)
    assert (cage.volumes() > 0).all() and enclosed_volume(cage.vertices, cage.surface) == pytest.approx(2.6**3)


def test_a_mesh_that_only_has_time_samples_is_read_as_it_begins(tmp_path):
    points, tets = cube((1, 1, 1))
    rows = ", ".join(str(tuple(row)) for row in points.tolist())
    text = usda(points, tets).replace("point3f[] points = [", "point3f[] points.timeSamples = { 3: [")
    (tmp_path / "a.usda").write_text(text.replace(f"[{rows}]", f"[{rows}], 4: [{rows}] }}"))
    assert len(read_cage(tmp_path / "a.usda").vertices) == 8


SECOND = "def TetMesh 'Other' {}"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty"),
        ("#usda 1.0\n", "holds 0 tetrahedral meshes, expected 1"),
        ("#usda 1.0\ndef TetMesh 'A' {", "OpenUSD cannot read it"),
        ("PXR-USDC" + "\0" * 200, "OpenUSD cannot read it"),
        (usda(*cube((1, 1, 1)), more=SECOND), "holds 2 tetrahedral meshes"),
        (usda(cube((1, 1, 1))[0], np.array([[0, 1, 2, 999]])), "out of range"),
        (usda(np.full((4, 3), np.nan), np.arange(4)[None]), "out of range"),
        (usda(np.zeros((4, 3)), np.arange(4)[None]), "without volume"),
        (usda(cube((1, 1, 1))[0], np.zeros((0, 4), int)), "no tets"),
        ("#usda 1.0\ndef TetMesh 'A' {}", "/A has no points or tets"),
    ],
)
def test_what_is_no_cage_is_refused(tmp_path, text, says):
    (tmp_path / "a.usda").write_bytes(text.encode())
    assert says in refused(tmp_path / "a.usda", read=read_cage)


def test_a_file_that_multiplies_itself_is_given_up(tmp_path, monkeypatch):
    """Each prim refers four times to the next: a million prims of 2 kB of text."""
    levels = [f"def 'L{k}' {{ " + " ".join(f"def 'P{i}' (references = </L{k + 1}>) {{}}" for i in range(8)) + " }"
              for k in range(12)]  # fmt: skip
    (tmp_path / "a.usda").write_text("#usda 1.0\n" + "\n".join(levels) + "\ndef 'L12' {}\n")
    monkeypatch.setattr(cage_file, "PATIENCE", 3)
    told = refused(tmp_path / "a.usda", read=read_cage)
    assert "took more than 3 s" in told or "OpenUSD cannot read it" in told  # which limit comes first


def test_other_kinds_of_files_are_refused(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\n")
    assert "a cage is an OpenUSD file" in refused(tmp_path / "a.obj", read=read_cage)


def test_a_body_is_prepared_with_the_cage_that_is_given(ti_cpu, tmp_path, capsys, monkeypatch):
    """The splat lies on its side (+z up), and the cage with it: both are turned, scaled and moved alike."""
    monkeypatch.setenv("VRGS_CACHE", str(tmp_path / "cache"))
    splat = ball(open_below=-2.0).transformed(UP.T)
    write_gaussians(tmp_path / "ball.ply", splat)
    points, tets = cube()
    (tmp_path / "cage.usda").write_text(usda(points - [0, 0, 0.5], tets))
    options = ["prepare", "ball.ply", "--cage", "cage.usda", "--up", "+z", "--scale", "0.2", "--out", "ball.h5"]
    monkeypatch.chdir(tmp_path)
    assert vrgs.main([*options, "--no-report"]) == 0
    said = capsys.readouterr().out
    assert "216 vertices, 750 tets as given" in said and "inside the cage: 100.00%" in said
    asset = Asset.load(tmp_path / "ball.h5")
    assert_allclose(asset.cage.volumes().sum(), (2.6 * asset.provenance["metres_per_unit"]) ** 3, rtol=1e-4)
    assert_allclose(asset.gaussians.means.mean(0), asset.cage.vertices.mean(0), atol=2e-3)
    assert asset.provenance["size"] == 0.2


def test_a_cage_elsewhere_is_refused(ti_cpu, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("VRGS_CACHE", str(tmp_path / "cache"))
    write_gaussians(tmp_path / "ball.ply", ball())
    (tmp_path / "cage.usda").write_text(usda(cube()[0] * 100 + 500, cube()[1]))
    monkeypatch.chdir(tmp_path)
    assert vrgs.main(["prepare", "ball.ply", "--cage", "cage.usda", "--up", "+y", "--out", "ball.h5"]) == 2
    assert "inside the cage: does it have the splat's coordinates?" in capsys.readouterr().err
    assert not (tmp_path / "ball.h5").exists()


def test_a_missing_cage_is_named(tmp_path):
    with pytest.raises(BadInput, match=r"none\.usda: no such file"):
        read_cage(tmp_path / "none.usda")
