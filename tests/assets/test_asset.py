"""The asset file: round trip, every check, and writing in one step."""

import functools
from dataclasses import replace

import h5py
import numpy as np
import pytest

from assets.asset import Asset, Cage, CageEmbedding, split_components
from assets.gaussians import ROWS
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.material import Material
from core.tetmesh import boundary_surface
from tests.fuzz.hdf5_mutations import put as replace_dataset
from tests.support import samples
from tests.support.samples import some_gaussians

MATERIAL = Material(young=5e4, poisson=0.4, density=1100.0, friction=0.5)


def some_asset(n: int = 20) -> Asset:
    """Two tets that share a face, random Gaussians in them, and all optional parts."""
    rng = np.random.default_rng(0)
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], np.float32)
    tets = np.array([[0, 1, 2, 3], [1, 4, 2, 3]], np.int32)
    faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 4], [1, 4, 3], [2, 3, 4]]
    weights = rng.dirichlet(np.ones(4), size=(n, 4)).astype(np.float32)
    return Asset(
        some_gaussians(n, 1),
        Cage(vertices, tets, np.array(faces, np.int32)),
        CageEmbedding(rng.integers(0, 2, (n, 4)).astype(np.int32), weights),
        DistanceGrid(rng.normal(size=(3, 4, 5)).astype(np.float16), np.array([0.1, 0.2, 0.3]), 0.05),
        MATERIAL,
        {"source": "test", "steps": [1, 2]},
    )


refused = functools.partial(samples.refused, read=Asset.load)


def edited(tmp_path, edit, asset: Asset | None = None, **options):
    """Path of a sound asset file on which `edit(h5py.File)` was let loose."""
    path = tmp_path / "edited.h5"
    (asset or some_asset()).save(path, **options)
    with h5py.File(path, "r+") as file:
        edit(file)
    return path


def put(name: str, values, **options):
    """An edit that replaces a dataset."""

    return lambda file: replace_dataset(file, name, values, **options)


def test_round_trip(tmp_path):
    asset = some_asset()
    asset.save(tmp_path / "a.h5")
    read = Asset.load(str(tmp_path / "a.h5"))
    parts = {"gaussians": ROWS, "cage": ("vertices", "tets", "surface"), "embedding": ("host", "weights")}
    for part, names in (parts | {"sdf": ("values", "origin")}).items():
        for name in names:
            got, expected = getattr(getattr(read, part), name), getattr(getattr(asset, part), name)
            np.testing.assert_array_equal(got, expected)
            assert got.dtype == expected.dtype
    assert (read.sdf.spacing, read.material, read.provenance) == (0.05, MATERIAL, asset.provenance)
    assert [p.name for p in tmp_path.iterdir()] == ["a.h5"]  # nothing is left beside it


def test_optional_parts_stay_absent(tmp_path):
    Asset(some_gaussians(3)).save(tmp_path / "a.h5")
    read = Asset.load(tmp_path / "a.h5")
    assert (read.cage, read.embedding, read.sdf, read.material, read.provenance) == (None, None, None, None, {})


def test_the_file_describes_itself(tmp_path):
    """The layout of docs/formats.md, seen with plain h5py."""
    some_asset().save(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5") as file:
        assert (file.attrs["format"], file.attrs["version"]) == (b"vrgs-asset", 1)
        assert b'"source"' in file.attrs["provenance"]
        assert file["gaussians/sh"].shape == (20, 4, 3) and file["gaussians/object_id"].dtype == np.uint16
        assert file["sdf/values"].dtype == np.float16 and file["sdf/values"].attrs["spacing"] == 0.05
        assert file["cage/tets"].compression == "gzip" and file["cage/tets"].shuffle
        assert dict(file["material"].attrs) == {"young": 5e4, "poisson": 0.4, "density": 1100.0, "friction": 0.5}


@pytest.mark.parametrize(
    "changes", [{}, {"kinetic_friction": 0.3}, {"damping": 7.0}, {"kinetic_friction": 0.0, "damping": 0.0}]
)
def test_a_material_keeps_all_its_properties(tmp_path, changes):
    material = replace(MATERIAL, **changes)
    Asset(some_gaussians(3), material=material).save(tmp_path / "a.h5")
    assert Asset.load(tmp_path / "a.h5").material == material


ONE = np.ones(20, np.float32)
DEFECTS = {
    "not a vrgs-asset": lambda f: f.attrs.update(format="other"),
    "newer program": lambda f: f.attrs.update(version=3),
    "missing attribute 'version'": lambda f: f.attrs.pop("version"),
    "'version' of the file is not a number": lambda f: f.attrs.update(version="one"),
    "not JSON": lambda f: f.attrs.update(provenance="{"),
    "provenance: not JSON": lambda f: f.attrs.update(provenance="[" * 100_000),
    "provenance: it is [], not an object": lambda f: f.attrs.update(provenance="[]"),
    "missing dataset 'gaussians/means'": lambda f: f.pop("gaussians/means"),
    "Gaussians are not finite": put("gaussians/means", np.full((20, 3), np.nan, np.float32)),
    "are not finite or have no rotation": put("gaussians/quats", np.zeros((20, 4), np.float32)),
    "not normalised": put("gaussians/quats", np.full((20, 4), 2.0, np.float32)),
    "20 Gaussians are not finite": put("gaussians/log_scales", np.full((20, 3), 99.0)),
    "gaussians/means has shape (20, 2)": put("gaussians/means", np.zeros((20, 2), np.float32)),
    "sh has shape (20, 5, 3)": put("gaussians/sh", np.zeros((20, 5, 3), np.float32)),
    "gaussians/object_id holds an index out of range": put("gaussians/object_id", np.full(20, 70_000)),
    "gaussians/object_id holds float64": put("gaussians/object_id", np.zeros(20)),
    "gaussians/means holds int64": put("gaussians/means", np.zeros((20, 3), np.int64)),
    "vertex is not finite": put("cage/vertices", np.full((5, 3), np.inf, np.float32)),
    "2 cage tets have no positive volume": put("cage/tets", np.array([[1, 0, 2, 3], [4, 1, 2, 3]], np.int32)),
    "outside 0..4": put("cage/tets", np.array([[0, 1, 2, 3], [1, 5, 2, 3]], np.int32)),
    "cage/tets holds an index": put("cage/tets", np.array([[0, 1, 2, 3], [1, -1, 2, 3]], np.int32)),
    "tets holds an index": put("cage/tets", np.array([[0, 1, 2, 3], [1, 2**40, 2, 3]])),
    "belong to no tet": put("cage/tets", np.array([[0, 1, 2, 3]], np.int32)),
    "cage tets has shape (0, 4)": put("cage/tets", np.zeros((0, 4), np.int32)),
    "surface encloses": put("cage/surface", some_asset().cage.surface[:, ::-1].copy()),
    "missing dataset 'cage/vertices'": lambda f: f.pop("cage/vertices"),
    "embedding but no cage": lambda f: f.pop("cage"),
    "outside 0..1": put("embedding/host", np.full((20, 4), 2, np.int32)),
    "has 3 rows for 20": lambda f: (
        [put("embedding/host", np.zeros((3, 4), np.int32))(f)] + [put("embedding/weights", np.full((3, 4, 4), 0.25))(f)]
    ),
    "do not sum to 1": put("embedding/weights", np.full((20, 4, 4), 0.3, np.float32)),
    "weight is not finite": put("embedding/weights", np.full((20, 4, 4), np.nan, np.float32)),
    "signed distance is not finite": put("sdf/values", np.full((3, 4, 5), np.nan, np.float16)),
    "at least 2 nodes": put("sdf/values", np.zeros((3, 1, 5), np.float16)),
    "spacing is not positive": lambda f: f["sdf/values"].attrs.update(spacing=0.0),
    "'spacing' of sdf/values is not a number": lambda f: f["sdf/values"].attrs.update(spacing=[1.0, 1.0, 1.0]),
    "is not three numbers": lambda f: f["sdf/values"].attrs.update(origin=np.zeros(2)),
    "origin is not three finite": lambda f: f["sdf/values"].attrs.update(origin=np.full(3, np.inf)),
    "missing attribute 'origin'": lambda f: f["sdf/values"].attrs.pop("origin"),
    "poisson must lie": lambda f: f["material"].attrs.update(poisson=0.5),
}


def test_a_dataset_that_nothing_reads_does_no_harm(tmp_path):
    """Files of before have a thumbnail."""
    path = edited(tmp_path, lambda file: file.create_dataset("thumbnail", data=np.zeros(9, np.uint8)))
    assert len(Asset.load(path).gaussians) == 20


@pytest.mark.parametrize("defect", DEFECTS)
def test_each_defect_is_named(tmp_path, defect):
    assert defect in refused(edited(tmp_path, DEFECTS[defect]))


def test_what_cannot_be_loaded_is_not_saved(tmp_path):
    asset = some_asset()
    flat = replace(asset.cage, vertices=asset.cage.vertices * 0)
    with pytest.raises(BadInput, match="no positive volume"):
        replace(asset, cage=flat).save(tmp_path / "a.h5")
    with pytest.raises(BadInput, match="poisson"):
        replace(asset, material=replace(MATERIAL, poisson=0.5)).save(tmp_path / "a.h5")
    with pytest.raises(BadInput, match="does not exist"):
        asset.save(tmp_path / "none" / "a.h5")
    assert list(tmp_path.iterdir()) == []


def test_files_that_are_no_assets(tmp_path):
    assert "no such file" in refused(tmp_path / "none.h5")
    assert "folder" in refused(tmp_path)
    (tmp_path / "a.h5").write_bytes(b"")
    assert "empty" in refused(tmp_path / "a.h5")
    (tmp_path / "a.h5").write_bytes(b"garbage" * 100)
    assert "not a readable HDF5" in refused(tmp_path / "a.h5")


def test_a_corner_in_another_component_comes_home():
    """Two tets far apart; a Gaussian with one corner in the other one keeps its shape."""
    tet = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    tets = np.arange(8, dtype=np.int32).reshape(2, 4)
    cage = Cage(np.concatenate([tet, tet + [5, 0, 0]]).astype(np.float32), tets, boundary_surface(tets))
    corners = np.array([[0.1, 0.1, 0.1], [0.4, 0.1, 0.1], [0.1, 0.4, 0.1], [0.1, 0.1, 0.4]])
    host = np.array([[0, 0, 1, 0]], np.int32)
    last = corners - 5.0 * host.T * [1, 0, 0]
    weights = np.concatenate([1 - last.sum(1, keepdims=True), last], 1)[None].astype(np.float32)
    first, second = split_components(Asset(some_gaussians(1), cage, CageEmbedding(host, weights)))
    assert len(first.gaussians) == 1 and len(second.gaussians) == 0
    first.check("first")
    again = np.einsum("kj,kjc->kc", first.embedding.weights[0], first.cage.vertices[first.cage.tets[[0] * 4]])
    np.testing.assert_allclose(again, corners, atol=1e-5)
    assert split_components(first)[0] is first
