"""Order and anti-aliasing of a training: formats and programs keep them and draw so; z for files from elsewhere."""

import gzip
from dataclasses import replace
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from assets.asset import Asset
from assets.formats.ply import write_ply
from assets.gaussians import concatenate
from assets.splat_files import read_gaussians, write_gaussians
from commands.viewing import RenderOptions, draw_pictures
from core.errors import BadInput
from display.viewer import Viewer
from prepare.progress import arrays_of, gaussians_of
from tests.support.samples import some_gaussians
from tests.support.splat_encoders import ply_bytes, properties


@pytest.mark.parametrize("name", ["a.ply", "a.compressed.ply", "a.spz"])
@pytest.mark.parametrize("antialias", [False, True])
def test_how_they_were_trained_comes_back(tmp_path, name, antialias):
    g = replace(some_gaussians(9, 1), sort="radial", antialias=antialias)
    write_gaussians(tmp_path / name, g, report=pytest.fail)
    read = read_gaussians(tmp_path / name)
    assert (read.sort, read.antialias) == ("radial", antialias)
    Asset(read.transformed(np.eye(3))).save(tmp_path / "a.h5")
    kept = gaussians_of(arrays_of(read_gaussians(tmp_path / "a.h5")))[0]
    assert (kept.sort, kept.antialias) == ("radial", antialias)


@pytest.mark.parametrize("name", ["a.ply", "a.compressed.ply", "a.spz", "b.spz", "a.sog", "a.glb", "a.h5"])
def test_from_where_they_were_photographed_comes_back(tmp_path, name):
    """Beside the order of blending and without it; numbers that are no view are passed over."""
    for sort in ("radial", ""):
        for view, seen in (((3.0, 1.0, 0.5, 0.0, -2e-3, 0.5, 1.5), True), ((1.0, 2.0, 3.0, 1.0, 2.0, 3.0, 1.5), False)):
            g = replace(some_gaussians(9, 1), sort=sort, view=view)
            if name == "a.h5":
                Asset(g).save(tmp_path / name)
            else:
                options = {"version": 4} if name == "b.spz" else {}
                write_gaussians(tmp_path / name, g, report=pytest.fail, **options)
            read = read_gaussians(tmp_path / name, pytest.fail)
            assert read.view == (pytest.approx(view) if seen else ())
            assert gaussians_of(arrays_of(read))[0].view == read.view
            assert (read.sort == "radial") == (sort == "radial" or name == "a.glb")  # its own default
    view = (1, 2, 3, 0, 0, 0, 1)
    assert concatenate([some_gaussians(3), read, replace(read, view=view)]).view == view


@pytest.mark.parametrize(
    ("comments", "antialias"),
    [
        (["SplatRenderMode: mip"], True),
        (["SplatRenderMode: default"], False),
        (["antialiased 1"], True),
        (["antialiased 1", "antialiased 0"], False),
        (["made by mip"], False),
    ],
)
def test_comments_of_other_programs_tell_how_to_draw(tmp_path, comments, antialias):
    before = "".join(f"comment {line}\n" for line in comments)
    (tmp_path / "a.ply").write_bytes(ply_bytes(properties(some_gaussians(9)), before=before))
    assert read_gaussians(tmp_path / "a.ply").antialias is antialias


def test_anti_aliased_splats_are_drawn_so(tmp_path, ti_cpu):
    """A Gaussian smaller than a pixel is fainter than in a file that does not say it."""
    g, pictures = replace(some_gaussians(1), sort="z"), []
    g = replace(g, means=np.float32([[0, 0, 2]]), log_scales=np.full((1, 3), -7, np.float32))
    (tmp_path / "c.json").write_text(
        '{"width": 16, "height": 16, "fx": 20, "fy": 20, "cx": 8.5, "cy": 8.5, '
        '"world_to_camera": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}'
    )
    for antialias in (False, True):
        write_gaussians(tmp_path / "a.ply", replace(g, antialias=antialias, logit_opacities=np.float32([9])))
        out = tmp_path / "a.npz"
        draw_pictures(RenderOptions(splats=tmp_path / "a.ply", camera=tmp_path / "c.json", out=out))
        pictures.append(np.load(out)["alpha"].max())
    assert pictures[1] < 0.1 * pictures[0] < 0.1


def test_splats_from_elsewhere_were_trained_by_depth_and_assets_do_not_say(tmp_path):
    g = some_gaussians(9, 1)
    write_ply(tmp_path / "a.ply", g)
    Asset(g).save(tmp_path / "a.h5")
    assert b"sort" not in (tmp_path / "a.ply").read_bytes()
    assert read_gaussians(tmp_path / "a.ply").sort == "z" and read_gaussians(tmp_path / "a.h5").sort == ""


def test_another_format_says_that_the_order_is_lost(tmp_path):
    lines, g = [], some_gaussians(9, 1)
    write_gaussians(tmp_path / "a.splat", replace(g, sort="radial", antialias=True), lines.append)
    assert len(lines) == 2 and "--antialias" in lines[0] and "--sort radial" in lines[1]
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
    assert concatenate([replace(z, antialias=True), radial]).antialias
    assert not concatenate([replace(radial, antialias=True), z]).antialias


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
