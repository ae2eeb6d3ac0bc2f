"""Object ids and names of objects: kept by .ply and .h5, through selections and merges; said where they are lost."""

from dataclasses import replace

import numpy as np
import pytest

from assets.asset import Asset
from assets.formats.ply import read_ply, write_ply
from assets.gaussians import Gaussians, concatenate
from assets.splat_files import read_gaussians, write_gaussians
from core.errors import BadInput
from tests.support.samples import some_gaussians
from tests.support.splat_encoders import ply_bytes, properties

NAMES = ("bear", "Büste von links")


def with_objects(names=NAMES, count: int = 9, seed: int = 0) -> Gaussians:
    ids = np.arange(count, dtype=np.uint16) % (len(names) + 1)
    return replace(some_gaussians(count, 1, seed=seed), object_id=ids, objects=tuple(names), sort="radial")


@pytest.mark.parametrize("name", ["a.ply", "a.h5", "quantised.h5"])
def test_ids_names_and_the_order_of_blending_come_back(tmp_path, name):
    g = with_objects()
    if name.endswith(".h5"):
        Asset(g).save(tmp_path / name, quantised=name.startswith("q"))
    else:
        write_gaussians(tmp_path / name, g, report=pytest.fail)
    read = read_gaussians(tmp_path / name, report=pytest.fail)
    np.testing.assert_array_equal(read.object_id, g.object_id)
    assert read.object_id.dtype == np.uint16 and (read.objects, read.sort) == (NAMES, "radial")
    if name == "a.ply":
        np.testing.assert_array_equal(read.sh, g.sh)
        np.testing.assert_array_equal(read.means, g.means)


def test_a_splat_without_objects_is_written_as_ever(tmp_path):
    write_ply(tmp_path / "a.ply", some_gaussians(3))
    assert b"object" not in (tmp_path / "a.ply").read_bytes()
    assert read_ply(tmp_path / "a.ply").objects == ()


@pytest.mark.parametrize("suffix", [".spz", ".splat", ".compressed.ply"])
def test_other_formats_say_that_ids_are_lost(tmp_path, suffix):
    lines = []
    write_gaussians(tmp_path / f"a{suffix}", replace(with_objects(), sort="z"), lines.append)
    assert len(lines) == 1 and "keeps no object ids" in lines[0]
    write_gaussians(tmp_path / f"a{suffix}", some_gaussians(9, 1), report=pytest.fail)


def test_ids_of_any_type_are_read(tmp_path):
    """Other programs write them as float or int; a damaged id is background."""
    g, lines = some_gaussians(6), []
    for dtype, ids, expected in (
        ("i4", [0, 1, 2, 3, 65535, -1], [0, 1, 2, 3, 65535, 0]),
        ("f4", [0, 1, 2.5, np.nan, 1e9, 7], [0, 1, 0, 0, 0, 7]),
        ("u1", [0, 1, 2, 3, 4, 255], [0, 1, 2, 3, 4, 255]),
    ):
        (tmp_path / "a.ply").write_bytes(ply_bytes({"object_id": np.array(ids, dtype), **properties(g)}))
        assert read_ply(tmp_path / "a.ply", lines.append).object_id.tolist() == expected
        np.testing.assert_array_equal(read_ply(tmp_path / "a.ply", lines.append).means, g.means)
    assert len(lines) == 4 and "1 of 6 object ids" in lines[0] and "3 of 6 object ids" in lines[2]


def test_names_of_a_header_that_are_none_are_passed_over(tmp_path):
    write_ply(tmp_path / "a.ply", with_objects())
    whole = (tmp_path / "a.ply").read_bytes()
    for line, names in (
        (b"comment object 2 vase", ("bear", "vase")),
        (b"comment object 4 vase", ("bear", "object_2", "object_3", "vase")),
        (b"comment object 99999 vase", ("bear",)),
        (b"comment object two vase", ("bear",)),
        (b"comment object 2 " + 200 * b"x", ("bear",)),
        (b"comment object 2 a\x07b", ("bear",)),
    ):
        (tmp_path / "b.ply").write_bytes(whole.replace("comment object 2 Büste von links".encode(), line))
        assert read_ply(tmp_path / "b.ply").objects == names


def test_a_selection_keeps_ids_and_names_and_a_merge_gives_each_name_one_id():
    a, b = with_objects(("bear", "cup")), with_objects(("cup", "vase"), seed=1)
    some = a.select(np.array([1, 5])).transformed(np.eye(3), (1.0, 0.0, 0.0), 2.0).with_sh_degree(0)
    assert some.object_id.tolist() == [1, 2] and (some.objects, some.sort) == (("bear", "cup"), "radial")
    both = concatenate([a, b])
    assert both.objects == ("bear", "cup", "vase")
    assert both.object_id[9:12].tolist() == [0, 2, 3] and both.object_id[:3].tolist() == [0, 1, 2]
    unnamed = replace(b, objects=())
    assert concatenate([a, unnamed]).object_id[9:12].tolist() == [0, 1, 2]


def test_names_that_no_header_can_hold_are_refused(tmp_path):
    for names in (("",), ("a\nb",), ("x" * 101,), (" bear",), ("bear",) * 1025):
        with pytest.raises(BadInput, match="names of objects"):
            replace(with_objects(), objects=names).check("a.h5")
