"""The order of blending that splats were trained for: kept by .ply and .h5, z for files from elsewhere, and played."""

import gzip
from dataclasses import replace
from types import SimpleNamespace

import h5py
import pytest

from assets.asset import Asset
from assets.formats.ply import write_ply
from assets.gaussians import concatenate
from assets.splat_files import read_gaussians, write_gaussians
from core.errors import BadInput
from display.viewer import Viewer
from tests.support.samples import some_gaussians


@pytest.mark.parametrize("name", ["a.compressed.ply", "a.spz"])
def test_the_order_comes_back(tmp_path, name):
    write_gaussians(tmp_path / name, replace(some_gaussians(9, 1), sort="radial"), report=pytest.fail)
    assert read_gaussians(tmp_path / name).sort == "radial"


def test_splats_from_elsewhere_were_trained_by_depth_and_assets_do_not_say(tmp_path):
    g = some_gaussians(9, 1)
    write_ply(tmp_path / "a.ply", g)
    Asset(g).save(tmp_path / "a.h5")
    assert b"sort" not in (tmp_path / "a.ply").read_bytes()
    assert read_gaussians(tmp_path / "a.ply").sort == "z" and read_gaussians(tmp_path / "a.h5").sort == ""


def test_another_format_says_that_the_order_is_lost(tmp_path):
    lines, g = [], some_gaussians(9, 1)
    write_gaussians(tmp_path / "a.splat", replace(g, sort="radial"), lines.append)
    assert len(lines) == 1 and "--sort radial" in lines[0]
    write_gaussians(tmp_path / "a.splat", replace(g, sort="z"), report=pytest.fail)
    assert read_gaussians(tmp_path / "a.splat").sort == "z"


def test_a_comment_in_a_spz_hides_nothing_from_others(tmp_path):
    """Any reader of gzip finds the same bytes; a file of z has no comment."""
    g = some_gaussians(9, 1)
    for name, sort in (("a.spz", "radial"), ("b.spz", "z"), ("c.spz", "")):
        write_gaussians(tmp_path / name, replace(g, sort=sort))
    packed = [(tmp_path / f"{name}.spz").read_bytes() for name in "abc"]
    assert gzip.decompress(packed[0]) == gzip.decompress(packed[1]) and packed[1] == packed[2] != packed[0]


def test_of_several_sets_most_gaussians_decide():
    z, radial, unknown = (replace(some_gaussians(n), sort=s) for n, s in ((5, "z"), (3, "radial"), (4, "")))
    assert concatenate([radial, z]).sort == "z" and concatenate([radial, radial, unknown, z]).sort == "radial"
    assert concatenate([unknown, radial]).sort == ""


def test_an_unknown_order_in_a_file_is_refused(tmp_path):
    Asset(some_gaussians(9)).save(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file.attrs["sort"] = "backwards"
    with pytest.raises(BadInput, match="'backwards' is not an order of blending"):
        Asset.load(tmp_path / "a.h5")


def test_splats_are_shown_in_their_order_unless_the_user_chooses():
    for chosen, trained, shown in ((None, "z", "z"), (None, "", "radial"), ("pixel", "z", "pixel")):
        file = SimpleNamespace(gaussians=replace(some_gaussians(3), sort=trained))
        assert Viewer._order.fget(SimpleNamespace(_sort=chosen, file=file)) == shown
