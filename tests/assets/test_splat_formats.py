"""All splat formats together: the choice of the reader, damage, failed writes, files of others; and .splat."""

import struct

import numpy as np
import pytest

from assets.asset import Asset
from assets.splat_files import read_gaussians, write_gaussians
from core.errors import BadInput
from core.spherical_harmonics import C0
from tests.support import splat_encoders as encode
from tests.support.samples import FIELDS, refused, some_gaussians


def test_splat_round_trip(tmp_path):
    """Written rows are those of the plain encoder, and sizes too small for float32 do not vanish."""
    g = some_gaussians(80, 0)
    write_gaussians(tmp_path / "a.splat", g)
    written, expected = (tmp_path / "a.splat").read_bytes(), encode.splat_bytes(g)
    assert len(written) == len(expected)
    differ = (np.frombuffer(written, np.uint8) != np.frombuffer(expected, np.uint8)).reshape(-1, 32)
    assert np.delete(differ, [12, 16, 20], axis=1).mean() < 0.002  # ties of rounding; exp differs in its last bits
    read = read_gaussians(tmp_path / "a.splat")
    np.testing.assert_array_equal(read.means, g.means)
    np.testing.assert_allclose(read.log_scales, g.log_scales, atol=1e-6)
    np.testing.assert_allclose(read.opacities, g.opacities, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(C0 * read.sh, C0 * g.sh, atol=0.5 / 255 + 1e-6)
    assert np.abs((read.quats * g.quats).sum(1)).min() > 1 - 2 * (1 / 128) ** 2
    g.log_scales[3] = -120
    write_gaussians(tmp_path / "a.splat", g)
    assert len(read_gaussians(tmp_path / "a.splat")) == 80


def test_splat_drops_what_has_no_size_or_rotation(tmp_path):
    data = bytearray(encode.splat_bytes(some_gaussians(6, 0)))
    data[12:16] = struct.pack("<f", 0.0)
    data[32 + 12 : 32 + 16] = struct.pack("<f", -1.0)
    data[64 + 28 : 64 + 32] = bytes([128] * 4)
    lines = []
    (tmp_path / "a.splat").write_bytes(data)
    assert len(read_gaussians(tmp_path / "a.splat", report=lines.append)) == 3
    assert len(lines) == 1 and "dropped 3 of 6" in lines[0]


def test_names_and_contents_must_agree(tmp_path):
    g = some_gaussians(5, 0)
    write_gaussians(tmp_path / "a.ply", g)
    write_gaussians(tmp_path / "a.spz", g)
    Asset(g).save(tmp_path / "a.h5")
    np.testing.assert_array_equal(read_gaussians(tmp_path / "a.h5").means, g.means)
    (tmp_path / "B.PLY").write_bytes((tmp_path / "a.ply").read_bytes())
    assert len(read_gaussians(tmp_path / "B.PLY")) == 5
    ply, spz, h5 = ((tmp_path / f"a.{kind}").read_bytes() for kind in ("ply", "spz", "h5"))
    assert ".spz" in refused(tmp_path / "c.ply", spz)
    assert ".ply" in refused(tmp_path / "c.splat", ply)
    assert ".h5" in refused(tmp_path / "c.spz", h5)
    assert ".ply" in refused(tmp_path / "c.h5", ply)
    assert ".sog" in refused(tmp_path / "d.splat", b"PK\3\4" + b"\0" * 60)
    message = refused(tmp_path / "c.xyz", b"0 0 0\n")
    assert all(kind in message for kind in (".ply", ".splat", ".ksplat", ".spz", ".sog", ".h5"))
    (tmp_path / "folder.spz").mkdir()
    assert "folder" in refused(tmp_path / "folder.spz")
    assert "no such file" in refused(tmp_path / "none.splat")
    with pytest.raises(BadInput, match=r"\.ply, \.compressed\.ply, \.spz, \.splat"):
        write_gaussians(tmp_path / "a.ksplat", g)


@pytest.mark.shared
@pytest.mark.parametrize("name", ["minimal-v3.spz", "minimal-v4.spz", "minimal.ksplat"])
def test_the_same_scene_in_each_format(shared, name):
    """Four Gaussians, written by others."""
    folder = shared / "data" / "splats" / "formats"
    a, b = read_gaussians(folder / "minimal.splat"), read_gaussians(folder / name)
    np.testing.assert_array_equal(a.means, b.means)
    np.testing.assert_allclose(a.log_scales, b.log_scales, atol=1 / 32)
    np.testing.assert_allclose(a.opacities, b.opacities, atol=1e-6)
    np.testing.assert_allclose(C0 * a.sh, C0 * b.sh, atol=1 / 255)
    np.testing.assert_allclose(a.covariances, b.covariances, atol=1e-3)


@pytest.mark.shared
def test_unpacked_spz_equals_packed(shared):
    """`raw` is the stream of `v2` without gzip. Both were written without the half turn and the colour's 0.15."""
    folder = shared / "data" / "splats" / "formats"
    packed, raw = (read_gaussians(folder / f"minimal-{name}.spz") for name in ("v2", "raw"))
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(packed, name), getattr(raw, name))
    splat = read_gaussians(folder / "minimal.splat")
    np.testing.assert_array_equal(packed.means, splat.means * [1, -1, -1])
    np.testing.assert_allclose(packed.opacities, splat.opacities, atol=1e-6)
