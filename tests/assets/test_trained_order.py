"""The order of blending that splats were trained for: kept by .ply and .h5, z for files from elsewhere, and played."""

from dataclasses import replace
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from assets.asset import Asset
from assets.formats.ply import write_ply
from assets.gaussians import concatenate
from assets.splat_files import read_gaussians, write_gaussians
from core.errors import BadInput
from display.viewer import Viewer
from tests.support.samples import some_gaussians


@pytest.mark.parametrize("name", ["a.ply", "a.h5", "quantised.h5"])
def test_the_order_comes_back(tmp_path, name):
    g = replace(some_gaussians(9, 1), sort="radial")
    if name.endswith(".h5"):
        Asset(g).save(tmp_path / name, quantised=name.startswith("q"))
    else:
        write_gaussians(tmp_path / name, g, report=pytest.fail)
    read = read_gaussians(tmp_path / name)
    assert read.sort == "radial" == read.transformed(np.eye(3)).sort == read.select(np.arange(3)).sort


def test_splats_from_elsewhere_were_trained_by_depth_and_assets_do_not_say(tmp_path):
    g = some_gaussians(9, 1)
    write_ply(tmp_path / "a.ply", g)
    Asset(g).save(tmp_path / "a.h5")
    assert b"sort" not in (tmp_path / "a.ply").read_bytes()
    assert read_gaussians(tmp_path / "a.ply").sort == "z" and read_gaussians(tmp_path / "a.h5").sort == ""


@pytest.mark.parametrize("suffix", [".spz", ".splat", ".compressed.ply"])
def test_other_formats_say_that_the_order_is_lost(tmp_path, suffix):
    lines, g = [], some_gaussians(9, 1)
    write_gaussians(tmp_path / f"a{suffix}", replace(g, sort="radial"), lines.append)
    assert len(lines) == 1 and "--sort radial" in lines[0]
    write_gaussians(tmp_path / f"a{suffix}", replace(g, sort="z"), report=pytest.fail)
    assert read_gaussians(tmp_path / f"a{suffix}").sort == "z"


def test_of_several_sets_most_gaussians_decide():
    z, radial, unknown = (replace(some_gaussians(n), sort=s) for n, s in ((5, "z"), (3, "radial"), (4, "")))
    assert concatenate([radial, z]).sort == "z" and concatenate([radial, radial, unknown, z]).sort == "radial"
    assert concatenate([unknown, radial]).sort == ""


def test_an_unknown_order_in_a_file_is_refused(tmp_path):
    Asset(some_gaussians(9)).save(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file.attrs["sort"] = "backwards"
    with pytest.raises(BadInput, match="'backwards' is no order of blending"):
        Asset.load(tmp_path / "a.h5")


def test_splats_are_shown_in_their_order_unless_the_user_chooses():
    for chosen, trained, shown in ((None, "z", "z"), (None, "", "radial"), ("pixel", "z", "pixel")):
        file = SimpleNamespace(gaussians=replace(some_gaussians(3), sort=trained))
        assert Viewer._order(SimpleNamespace(_sort=chosen, file=file)) == shown
