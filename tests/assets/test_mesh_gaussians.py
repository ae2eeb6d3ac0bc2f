"""Meshes covered with Gaussians: no holes, nothing beyond edges, the colours of vertices, faces and textures."""

import json

import cv2
import h5py
import numpy as np
import pytest
from scipy.spatial import cKDTree

import assets.mesh_gaussians as covering
from assets.formats.ply import write_ply
from assets.library import SHIPPED_FOLDER
from assets.splat_files import is_mesh, kind_of, read_gaussians
from core.errors import BadInput
from core.mesh_sampling import Mesh, clip_to_edges, edges_of, points_along
from core.spherical_harmonics import C0
from tests.support.samples import some_gaussians

CUBE = [(x, y, z) for x in (0, 10) for y in (0, 10) for z in (0, 10)]
QUADS = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]  # outward, from 1


@pytest.fixture(autouse=True)
def few(monkeypatch):
    monkeypatch.setattr(covering, "GAUSSIANS", 4000)


def colours_of(gaussians) -> np.ndarray:
    return 0.5 + C0 * gaussians.sh[:, 0]


def write_textured_cube(folder):
    """A cube whose texture has a red and a blue half, each corner of a face at a corner of the texture."""
    cv2.imwrite(str(folder / "halves.png"), np.repeat([[[0, 0, 255]] * 8 + [[255, 0, 0]] * 8], 16, 0).astype(np.uint8))
    (folder / "cube.mtl").write_text("newmtl m\nKd 0.2 0.2 0.2\nmap_Kd halves.png\n")
    lines = ["mtllib cube.mtl", *(f"v {x} {y} {z}" for x, y, z in CUBE), "vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1"]
    lines += ["usemtl m", *(f"f {a}/1 {b}/2 {c}/3\nf {a}/1 {c}/3 {d}/4" for a, b, c, d in QUADS)]
    (folder / "cube.obj").write_text("\n".join(lines))
    return folder / "cube.obj"


def test_a_textured_cube_is_covered_without_holes_and_nothing_sticks_out(tmp_path):
    g = read_gaussians(write_textured_cube(tmp_path))
    assert 3000 < len(g) < 5000
    x = g.means.astype(np.float64)
    on_face = np.minimum(np.abs(x), np.abs(x - 10)).min(1)
    np.testing.assert_allclose(on_face, 0.0, atol=1e-4)
    rng = np.random.default_rng(1)
    for axis in range(3):  # each point of a face is well inside some Gaussian
        points = rng.uniform(0, 10, (2000, 3))
        points[:, axis] = 10.0
        near = cKDTree(x).query(points, k=40)[1]
        offset, c = points[:, None] - x[near], g.covariances[near].astype(np.float64)
        precision = np.linalg.inv(np.stack([c[..., [0, 1, 2]], c[..., [1, 3, 4]], c[..., [2, 4, 5]]], -2))
        power = np.exp(-0.5 * np.einsum("nki,nkij,nkj->nk", offset, precision, offset))
        transmitted = np.prod(1 - power * g.opacities[near], axis=1)
        assert np.quantile(transmitted, 0.995) < 0.3 and transmitted.mean() < 0.05 and transmitted.max() < 0.7
    sigma = np.sqrt(g.covariances[:, [0, 3, 5]])  # along x, y and z
    assert (x + 2 * sigma).max() < 10.3 and (x - 2 * sigma).min() > -0.3
    red, green, blue = colours_of(g).T
    assert np.abs(green).max() < 0.01 and ((red > 0.9).mean() > 0.4) and ((blue > 0.9).mean() > 0.4)


def test_colours_of_vertices_in_a_ply_with_faces(tmp_path):
    path = tmp_path / "triangle.ply"
    header = "ply\nformat ascii 1.0\nelement vertex 3\n" + "".join(f"property float {a}\n" for a in "xyz")
    header += "".join(f"property uchar {c}\n" for c in ("red", "green", "blue"))
    header += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    path.write_text(header + "0 0 0 255 0 0\n1 0 0 0 255 0\n0 1 0 0 0 255\n3 0 1 2\n")
    g = read_gaussians(path)
    expected = np.column_stack([1 - g.means[:, 0] - g.means[:, 1], g.means[:, 0], g.means[:, 1]])
    np.testing.assert_allclose(colours_of(g), expected, atol=0.02)
    assert is_mesh(path) and kind_of(path) == "body"


def test_a_splat_is_no_mesh(tmp_path):
    write_ply(tmp_path / "splat.ply", some_gaussians(10))
    assert not is_mesh(tmp_path / "splat.ply") and kind_of(tmp_path / "splat.ply") == "either"


@pytest.mark.parametrize(
    "name, content, said",
    [
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 1 0 0\nf 1 2 3\n", "no area"),
        ("a.obj", b"nothing", "holds no triangles|cannot be read"),
        ("a.stl", b"\0" * 100, "triangles|cannot be read"),
        ("a.glb", b"glTF" + b"\0" * 40, "cannot be read"),
        ("a.glb", json.dumps({}).encode(), "cannot be read"),
        ("a.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not finite|cannot be read"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "do not exist|cannot be read|holds no triangles"),
        ("a.obj", b"", "is empty"),
    ],
)
def test_a_mesh_that_cannot_be_used_is_told_in_one_line(name, content, said, tmp_path):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(BadInput, match=said) as error:
        read_gaussians(tmp_path / name)
    assert "\n" not in str(error.value) and name in str(error.value)


def test_an_asset_is_a_body_or_a_room_and_other_files_say_what_they_are(tmp_path):
    for name, kind in {"ring_red": "body", "dining_room": "room"}.items():
        assert kind_of(SHIPPED_FOLDER / f"{name}.h5") == kind
    for kind, says in {"vrgs-recording": "is a recording", "vrgs-study": "study", "other": "is not an asset"}.items():
        with h5py.File(tmp_path / "file.h5", "w") as file:
            file.attrs["format"] = kind
        with pytest.raises(BadInput, match=says):
            kind_of(tmp_path / "file.h5")


@pytest.mark.parametrize("far", [1e5, 1e6])
def test_a_sliver_is_covered_by_about_as_many_gaussians_as_any_mesh(far, tmp_path):
    """Of a triangle that is all edge, edges would take as many as its length holds of its narrowest spacing."""
    (tmp_path / "sliver.obj").write_text(f"v 0 0 0\nv {far} 0 0\nv 0 1 0\nf 1 2 3\n")
    assert 20_000 < len(read_gaussians(tmp_path / "sliver.obj")) < 2 * covering.ROWS_MAX


def test_no_gaussian_reaches_farther_over_an_edge_than_six_tenths_of_its_distance():
    """Towards both sides of a corner; along an edge, and off the face, it stays as wide as it was."""
    square = Mesh(np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    edges, rng = edges_of(square), np.random.default_rng(0)
    along = points_along(edges, np.full(len(edges.a), 0.02))
    points = rng.uniform(0.02, 0.1, (60, 1)) * np.column_stack([np.ones(60), rng.uniform(0.8, 1.25, 60), np.zeros(60)])
    root = rng.normal(0, 0.1, (60, 3, 3))
    wide = root @ root.swapaxes(1, 2) + 0.04 * np.eye(3)
    normals = np.tile([0.0, 0.0, 1.0], (60, 1))
    clipped = clip_to_edges(along, points, normals, wide)
    sigma = np.sqrt(np.einsum("nii->ni", clipped))
    assert (sigma[:, :2] <= 0.6001 * points[:, :2]).all() and (np.linalg.eigvalsh(clipped) > -1e-9).all()
    lone = np.array([[0.5, 0.05, 0.0]])  # beside the middle of one edge
    (alone,) = clip_to_edges(along, lone, normals[:1], np.diag([0.01, 0.01, 0.01])[None])
    np.testing.assert_allclose(alone, np.diag([0.01, 0.03**2, 0.01]), atol=1e-9)
