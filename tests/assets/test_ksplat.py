"""The format .ksplat, levels 0 to 2, against an encoder written from its description; damage is refused."""

import struct

import numpy as np
import pytest

from assets.formats.splat import read_ksplat
from assets.splat_files import read_gaussians
from core.spherical_harmonics import C0
from tests.support.samples import refused, some_gaussians
from tests.support.splat_encoders import BLOCK, OFFSET_RANGE, ksplat_bytes, stored


@pytest.mark.parametrize("degree", range(3))
@pytest.mark.parametrize("level", range(3))
def test_reads_what_a_plain_encoder_wrote(tmp_path, level, degree):
    g = some_gaussians(120, degree)
    (tmp_path / "a.ksplat").write_bytes(ksplat_bytes([g], level))
    lines = []
    read, g = read_ksplat(tmp_path / "a.ksplat", report=lines.append), stored(g)
    assert read.sh_degree == degree and lines == []
    if level == 0:
        np.testing.assert_array_equal(read.means, g.means)
        np.testing.assert_allclose(read.sh[:, 1:], g.sh[:, 1:])
    else:
        np.testing.assert_allclose(read.means, g.means, atol=BLOCK / 4 / OFFSET_RANGE + 1e-6)  # half a step
        half = 1.5 / 255 if level == 2 else 2.0**-11  # a byte of -1.5..1.5; float16 of numbers below 2
        np.testing.assert_allclose(read.sh[:, 1:], g.sh[:, 1:], atol=half + 1e-6)
    np.testing.assert_allclose(read.log_scales, g.log_scales, atol=1e-6 if level == 0 else 6e-4)  # float16: 2^-11
    np.testing.assert_allclose(read.opacities, g.opacities, atol=0.5 / 255 + 1e-6)
    expected = np.clip(C0 * g.sh[:, 0] + 0.5, 0, 1)
    np.testing.assert_allclose(C0 * read.sh[:, 0] + 0.5, expected, atol=0.5 / 255 + 1e-6)
    assert np.abs((read.quats * g.quats).sum(1)).min() > 1 - 1e-6


@pytest.mark.parametrize("level", range(3))
def test_sections_of_their_own_degree_and_with_spare_space(tmp_path, level):
    a, b = some_gaussians(30, 1), some_gaussians(50, 2, seed=1)
    (tmp_path / "a.ksplat").write_bytes(
        ksplat_bytes([a, b], level, spare=2, capacity=3, bucket_bytes=16 if level else 12)
    )
    read = read_gaussians(tmp_path / "a.ksplat")
    assert len(read) == 80 and read.sh_degree == 2
    np.testing.assert_allclose(read.means[:30], stored(a).means, atol=1e-4)
    np.testing.assert_allclose(read.means[30:], stored(b).means, atol=1e-4)
    assert np.abs(read.sh[:30, 4:]).max() == 0
    np.testing.assert_allclose(read.sh[30:, 1:], stored(b).sh[:, 1:], atol=0.01)


def test_the_range_of_sh_bytes_is_the_header_s(tmp_path):
    g = some_gaussians(40, 2)
    (tmp_path / "a.ksplat").write_bytes(ksplat_bytes([g], 2, sh_range=(-2.0, 1.75)))
    np.testing.assert_allclose(
        read_gaussians(tmp_path / "a.ksplat").sh[:, 1:], stored(g).sh[:, 1:], atol=3.75 / 510 + 1e-6
    )


def test_a_disc_thinner_than_float16_stays(tmp_path):
    """A standard deviation of 1e-8 m becomes 0 in level 1; it is not dropped. A 0 in level 0 is a defect."""
    g = some_gaussians(5, 0)
    g.log_scales[2, 1] = np.log(1e-8)
    path = tmp_path / "a.ksplat"
    path.write_bytes(ksplat_bytes([g], 1))
    read = read_gaussians(path)
    assert len(read) == 5 and read.log_scales.min() == pytest.approx(np.log(2.0**-24))
    g.log_scales[2, 1] = -200
    path.write_bytes(ksplat_bytes([g], 0))
    lines = []
    assert len(read_gaussians(path, report=lines.append)) == 4 and "dropped 1 of 5" in lines[0]


def test_what_cannot_be_is_refused(tmp_path):
    path = tmp_path / "a.ksplat"
    good = ksplat_bytes([some_gaussians(30, 1)], 1)

    def changed(form: str, at: int, value) -> bytes:
        data = bytearray(good)
        struct.pack_into(form, data, at, value)
        return bytes(data)

    assert "empty" in refused(path, b"")
    assert "truncated" in refused(path, good[:5000])
    assert "truncated" in refused(path, good[:-1])
    assert "version 1.1" in refused(path, changed("<B", 0, 1))
    assert "version 0.7" in refused(path, changed("<B", 1, 7))
    assert "level 3" in refused(path, changed("<H", 20, 3))
    for places in (0, 2, 2**32 - 1):
        refused(path, changed("<I", 4, places))
    assert "sections 30" in refused(path, changed("<I", 16, 31))
    assert "no Gaussians" in refused(path, ksplat_bytes([some_gaussians(1, 0).select(np.zeros(0, int))], 0))
    section = 4096
    assert "in the space of" in refused(path, changed("<I", section, 31))
    assert "truncated" in refused(path, changed("<I", section + 4, 2**32 - 1))
    assert "truncated" in refused(path, changed("<I", section + 12, 2**32 - 1))
    assert "truncated" in refused(path, changed("<I", section + 36, 2**32 - 1))
    assert "SH degree 3" in refused(path, changed("<H", section + 40, 3))
    assert "none of its 30" in refused(path, changed("<f", section + 16, np.nan))
    content = section + 1024
    assert "buckets" in refused(path, changed("<I", content, 0))
    assert "buckets" in refused(path, ksplat_bytes([some_gaussians(30, 1)], 1).replace(
        struct.pack("<fH", BLOCK, 12), struct.pack("<fH", BLOCK, 0)))  # fmt: skip
    assert ".ply" in refused(path, b"ply\n" + good[4:])
