"""`vrgs.py convert`: what it writes, what it says was lost, and what it refuses."""

from argparse import Namespace

import numpy as np
import pytest

from assets.asset import Asset
from assets.convert import run
from assets.errors import BadInput
from assets.files import read_gaussians, write_gaussians
from assets.gaussians import Gaussians
from tests.samples import FIELDS, some_gaussians


def convert(source, target, capsys) -> str:
    """Run the command; the lines that it printed."""
    run(Namespace(input=str(source), output=str(target)))
    return capsys.readouterr().out


def test_ply_to_ply_loses_nothing(tmp_path, capsys):
    write_gaussians(tmp_path / "a.ply", some_gaussians(50, 2))
    said = convert(tmp_path / "a.ply", tmp_path / "b.ply", capsys)
    assert "50 Gaussians of SH degree 2" in said and "lost: nothing" in said and said.count("\n") == 1
    a, b = (read_gaussians(tmp_path / f"{name}.ply") for name in "ab")
    for name in FIELDS:
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=1e-7)


def test_ply_to_spz_and_back_says_what_was_lost(tmp_path, capsys):
    g = some_gaussians(50, 3)
    write_gaussians(tmp_path / "a.ply", g)
    said = convert(tmp_path / "a.ply", tmp_path / "a.spz", capsys)
    for word in ("positions up to", "log-scales", "opacities", "colours", "SH coefficients", "rotations"):
        assert word in said
    assert "lost: nothing" in convert(tmp_path / "a.spz", tmp_path / "b.ply", capsys)
    np.testing.assert_allclose(read_gaussians(tmp_path / "b.ply").means, g.means, atol=2**-17 + 1e-6)


def test_asset_to_ply(tmp_path, capsys):
    g = some_gaussians(9, 1)
    Asset(Gaussians.of(g.means, g.quats, g.log_scales, g.logit_opacities, g.sh, np.arange(9))).save(tmp_path / "a.h5")
    said = convert(tmp_path / "a.h5", tmp_path / "a.ply", capsys)
    assert "object ids" in said and "all of the asset but its Gaussians" in said
    np.testing.assert_array_equal(read_gaussians(tmp_path / "a.ply").means, g.means)


def test_dropped_gaussians_are_said(tmp_path, capsys):
    rows = np.zeros((3, 32), np.uint8)  # a .splat whose scales are 0, but for the first
    rows[0, 12:24] = np.full(3, 0.1, "<f4").view(np.uint8)
    (tmp_path / "a.splat").write_bytes(rows.tobytes())
    said = convert(tmp_path / "a.splat", tmp_path / "a.ply", capsys)
    assert "dropped 2 of 3" in said and "1 Gaussians" in said


def test_refusals_leave_everything_as_it_was(tmp_path, capsys):
    write_gaussians(tmp_path / "a.ply", some_gaussians(5))
    (tmp_path / "link.ply").symlink_to(tmp_path / "a.ply")
    (tmp_path / "bad.ply").write_bytes(b"ply\nspam")
    (tmp_path / "old.spz").write_bytes(b"precious")
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    for source, target, reason in (
        ("a.ply", "a.ply", "is the input itself"),
        ("a.ply", "link.ply", "is the input itself"),
        ("a.ply", "a.splat", "cannot write"),
        ("a.ply", "a.h5", "cannot write"),
        ("a.obj", "b.ply", "unknown kind"),
        ("none.ply", "old.spz", "no such file"),
        ("bad.ply", "old.spz", "understand"),
        ("a.ply", "none/b.ply", "does not exist"),
    ):
        with pytest.raises(BadInput, match=reason):
            run(Namespace(input=str(tmp_path / source), output=str(tmp_path / target)))
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before
    assert capsys.readouterr().out == ""
