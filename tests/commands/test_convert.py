"""`vrgs.py convert`: what it writes, what it says was lost, and what it refuses."""

import re
from argparse import ArgumentTypeError
from dataclasses import replace

import numpy as np
import pytest

from assets.asset import Asset
from assets.gaussians import Gaussians
from assets.splat_files import read_gaussians, write_gaussians
from commands.export import ConvertOptions, losses
from commands.export import convert as run_convert
from commands.options import share
from core.errors import BadInput
from core.rotation import multiply_quaternions
from tests.support.samples import FIELDS, some_gaussians
from tests.support.splat_encoders import ksplat_bytes, sog_files, zipped


def convert(source, target, capsys) -> str:
    """Run the command; the lines that it printed."""
    run_convert(ConvertOptions(input=source, output=target))
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


@pytest.mark.parametrize("degrees", [0.0, 3.0, 80.0, 170.0])
def test_the_angle_that_a_conversion_turned_by_is_told_whatever_the_signs_of_quaternions(degrees):
    g, rng, half = some_gaussians(40, 0), np.random.default_rng(0), np.radians(degrees) / 2
    axes = rng.normal(size=(40, 3))
    axes *= np.sin(half) / np.linalg.norm(axes, axis=1, keepdims=True)
    turned = multiply_quaternions(np.column_stack([np.full(40, np.cos(half)), axes]), g.quats)
    after = replace(g, quats=(turned * rng.choice([-1, 1], (40, 1))).astype(np.float32))
    told = losses(g, after)
    if not degrees:
        assert told == []
    else:
        (line,) = told
        assert float(re.fullmatch("rotations up to (.*) degrees", line)[1]) == pytest.approx(degrees, rel=0.06)


def test_asset_to_ply(tmp_path, capsys):
    g = some_gaussians(9, 1)
    Asset(Gaussians.of(g.means, g.quats, g.log_scales, g.logit_opacities, g.sh, np.arange(9))).save(tmp_path / "a.h5")
    said = convert(tmp_path / "a.h5", tmp_path / "a.ply", capsys)
    assert "object ids" not in said and "all of the asset but its Gaussians" in said
    read = read_gaussians(tmp_path / "a.ply")
    np.testing.assert_array_equal(read.means, g.means)
    np.testing.assert_array_equal(read.object_id, np.arange(9))
    said = convert(tmp_path / "a.ply", tmp_path / "a.spz", capsys)
    assert "object ids" in said and said.count("\n") == 1


def test_ply_to_compressed_ply_and_splat(tmp_path, capsys):
    g = some_gaussians(600, 2)
    write_gaussians(tmp_path / "a.ply", g)
    said = convert(tmp_path / "a.ply", tmp_path / "a.compressed.ply", capsys)
    assert "600 Gaussians of SH degree 2" in said and said.count("\n") == 1
    lost = float(re.search(r"positions up to (\S+) m", said)[1])
    extent = np.ptp(g.means, axis=0).max()
    assert 0 < lost < extent / 1023  # half a step of the largest chunk at most: compared in one order
    said = convert(tmp_path / "a.ply", tmp_path / "a.splat", capsys)
    assert "SH of degree 1, 2" in said and "positions" not in said and "opacities up to 0.00" in said
    said = convert(tmp_path / "a.compressed.ply", tmp_path / "b.compressed.ply", capsys)
    assert "positions" not in said  # the ranges are the extremes of what they hold: nothing more is lost


@pytest.mark.parametrize("kind", ["ply", "compressed.ply", "spz", "splat"])
def test_all_that_is_read_converts_to_all_that_is_written(tmp_path, capsys, kind):
    g = some_gaussians(40, 1)
    (tmp_path / "a.sog").write_bytes(zipped(sog_files(g)))
    (tmp_path / "a.ksplat").write_bytes(ksplat_bytes([g], 2))
    write_gaussians(tmp_path / "a.ply", g)
    write_gaussians(tmp_path / "a.compressed.ply", g)
    write_gaussians(tmp_path / "a.spz", g)
    for source in ("a.sog", "a.ksplat", "a.ply", "a.compressed.ply", "a.spz"):
        out = tmp_path / f"{source}.{kind}"
        assert "40 Gaussians" in convert(tmp_path / source, out, capsys)
        read = read_gaussians(out)
        order = np.argsort(read.means[:, 0]), np.argsort(g.means[:, 0])
        np.testing.assert_allclose(read.means[order[0]], g.means[order[1]], atol=0.01)


@pytest.mark.parametrize(("wanted", "left"), [(20.0, 20), (0.25, 15)])
@pytest.mark.parametrize("kind", ["ply", "spz", "glb"])
def test_fewer_gaussians_are_merged_and_said(tmp_path, capsys, ti_cpu, monkeypatch, wanted, left, kind):
    monkeypatch.setattr("core.runtime.start_taichi", lambda: None)  # runs already
    write_gaussians(tmp_path / "a.ply", some_gaussians(60, 1))
    run_convert(ConvertOptions(input=tmp_path / "a.ply", output=tmp_path / f"b.{kind}", decimate=wanted))
    assert f"{left} Gaussians" in (said := capsys.readouterr().out) and "merged from 60" in said
    assert len(read_gaussians(tmp_path / f"b.{kind}")) == left
    for few in (60.0, 61.0):
        with pytest.raises(BadInput, match="holds 60 Gaussians, no more than are wanted"):
            run_convert(ConvertOptions(input=tmp_path / "a.ply", output=tmp_path / "c.ply", decimate=few))
    assert not (tmp_path / "c.ply").exists()


@pytest.mark.parametrize("text", ["0", "-3", "1.5", "0%", "100%", "nan%", "half", "%", "1e9%", ""])
def test_a_share_that_is_none_is_refused_in_one_line(text):
    with pytest.raises(ArgumentTypeError, match="neither a positive whole number nor a percentage"):
        share(text)
    assert (share("7"), share("12.5%")) == (7.0, 0.125)


def test_progress_of_long_work_goes_to_stderr(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("commands.export.PROGRESS_SIZE_MIN", 1)
    write_gaussians(tmp_path / "a.ply", some_gaussians(5))
    run_convert(ConvertOptions(input=tmp_path / "a.ply", output=tmp_path / "a.spz"))
    out, err = capsys.readouterr()
    assert out.count("\n") == 1 and all(word in err for word in ("1/3 reading", "2/3 writing 5", "3/3"))


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
        ("a.ply", "a.ksplat", "cannot write"),
        ("a.ply", "a.h5", "cannot write"),
        ("a.ply", "noname", "cannot write"),
        ("a.xyz", "b.ply", "unknown kind"),
        ("none.ply", "old.spz", "no such file"),
        ("bad.ply", "old.spz", "understand"),
        ("a.ply", "none/b.ply", "does not exist"),
    ):
        with pytest.raises(BadInput, match=reason):
            run_convert(ConvertOptions(input=tmp_path / source, output=tmp_path / target))
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before
    assert capsys.readouterr().out == ""
