"""PlayCanvas compressed .ply: read what a plain encoder wrote, write within stated bounds, refuse damage."""

import numpy as np
import pytest

from assets.formats.ply import chunk_order, read_ply
from assets.gaussians import Gaussians
from assets.splat_files import read_gaussians, write_gaussians
from core.spherical_harmonics import C0
from tests.support.samples import refused, some_gaussians
from tests.support.splat_encoders import compressed_bytes


def steps(values: np.ndarray, levels) -> np.ndarray:
    """Half a quantisation step of each value, from the extent of its chunk of 256."""
    half = np.empty(values.shape)
    for first in range(0, len(values), 256):
        part = values[first : first + 256].astype(np.float64)
        half[first : first + 256] = np.ptp(part, axis=0) / np.asarray(levels) / 2
    return half


def assert_within_its_steps(read: Gaussians, g: Gaussians) -> None:
    """The bounds that the writer states; 1e-6 is the rounding of float32."""
    levels = (2047, 1023, 2047)
    assert (np.abs(read.means - g.means) <= steps(g.means, levels) + 1e-6).all()
    assert (np.abs(read.log_scales - g.log_scales) <= steps(g.log_scales, levels) + 2e-6).all()
    color = g.sh[:, 0] * C0
    assert (np.abs(read.sh[:, 0] * C0 - color) <= steps(color, (255, 255, 255)) + 1e-6).all()
    np.testing.assert_allclose(read.opacities, g.opacities, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(read.sh[:, 1:], g.sh[:, 1:], atol=1 / 64 + 1e-6)
    # Three components to sqrt(2)/2046 each, and the fourth from them: 1 - |cos| is quadratic in that.
    assert np.abs((read.quats * g.quats).sum(1)).min() > 1 - 6e-6


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("order", ["<", ">"])
def test_reads_what_a_plain_encoder_wrote(tmp_path, degree, order):
    g = some_gaussians(300, degree)  # a whole chunk and a part of one
    (tmp_path / "a.ply").write_bytes(compressed_bytes(g, order=order))
    lines = []
    read = read_ply(tmp_path / "a.ply", report=lines.append)
    assert read.sh_degree == degree and lines == []
    assert_within_its_steps(read, g)


def test_reads_the_form_without_color_ranges(tmp_path):
    g = some_gaussians(40, 0)
    (tmp_path / "a.ply").write_bytes(compressed_bytes(g, colored=False))
    read = read_ply(tmp_path / "a.ply")
    expected = np.clip(g.sh * C0 + 0.5, 0, 1)  # it holds nothing outside 0..1
    np.testing.assert_allclose(read.sh * C0 + 0.5, expected, atol=0.5 / 255 + 1e-6)
    assert (np.abs(read.means - g.means) <= steps(g.means, (2047, 1023, 2047)) + 1e-6).all()


@pytest.mark.parametrize("largest", range(4))
def test_each_component_can_be_the_one_left_out(tmp_path, largest):
    small = [0.1, -0.2, 0.3]
    quat = np.array([*small[:largest], -((1 - 0.14) ** 0.5), *small[largest:]], np.float32)
    g = some_gaussians(1, 0)
    g = Gaussians.of(g.means, quat[None], g.log_scales, g.logit_opacities, g.sh)
    (tmp_path / "a.ply").write_bytes(compressed_bytes(g))
    np.testing.assert_allclose(read_ply(tmp_path / "a.ply").quats, -quat[None], atol=1e-3)


@pytest.mark.parametrize("degree", range(4))
def test_the_writer_agrees_with_the_plain_encoder(tmp_path, degree):
    """But for ties in rounding, in a thousandth of the bytes at most."""
    g = some_gaussians(500, degree)
    write_gaussians(tmp_path / "a.compressed.ply", g)
    written = (tmp_path / "a.compressed.ply").read_bytes()
    expected = compressed_bytes(g.select(chunk_order(g.means)))
    expected = expected.replace(b"comment made by a test\n", b"")
    assert len(written) == len(expected)
    assert (np.frombuffer(written, np.uint8) != np.frombuffer(expected, np.uint8)).mean() < 1e-3


def test_a_far_gaussian_costs_only_its_own_chunk(tmp_path):
    g = some_gaussians(2560, 0)
    g.means[7] = 1e4
    write_gaussians(tmp_path / "a.compressed.ply", g)
    read, expected = read_gaussians(tmp_path / "a.compressed.ply"), g.select(chunk_order(g.means))
    error = np.abs(read.means - expected.means).max(1)
    assert (error > 0.01).sum() <= 256 and np.median(error) < 1e-3


def test_values_that_are_all_the_same_are_exact(tmp_path):
    g = some_gaussians(1, 1)
    write_gaussians(tmp_path / "a.compressed.ply", g)
    read = read_gaussians(tmp_path / "a.compressed.ply")
    np.testing.assert_array_equal(read.means, g.means)
    np.testing.assert_array_equal(read.log_scales, g.log_scales)


def test_what_cannot_be_is_refused(tmp_path):
    path = tmp_path / "a.ply"
    good = compressed_bytes(some_gaussians(300, 1))
    read_ply((path.write_bytes(good), path)[1])
    assert "chunk" in refused(path, good.replace(b"element chunk 2", b"element lump 2"))
    assert "cannot have 3 chunks" in refused(path, good.replace(b"element chunk 2", b"element chunk 3"))
    assert "truncated" in refused(path, good[:-1])
    assert "'max_y'" in refused(path, good.replace(b"float max_y", b"float top"))
    assert "'max_b'" in refused(path, good.replace(b"float max_b", b"float blue"))
    assert "'packed_scale'" in refused(path, good.replace(b"uint packed_scale", b"uint scale"))
    assert "wrong type" in refused(path, good.replace(b"uint packed_scale", b"float packed_scale"))
    listed = good.replace(b"uint packed_color", b"uint packed_color\nproperty list uchar int q")
    assert "list property" in refused(path, listed)
    assert "f_rest" in refused(path, good.replace(b"uchar f_rest_8", b"uchar f_rest_9"))
    assert "f_rest" in refused(path, good.replace(b"uchar f_rest_8", b"float f_rest_8"))
    assert "rows of sh" in refused(path, good.replace(b"element sh 300", b"element sh 299"))
    assert "twice" in refused(path, good.replace(b"float max_y", b"float max_x"))
    assert "text" in refused(path, good.replace(b"binary_little_endian", b"ascii"))
    empty = good.replace(b"vertex 300", b"vertex 0").replace(b"chunk 2", b"chunk 0").replace(b"sh 300", b"sh 0")
    assert "no Gaussians" in refused(path, empty)
    huge = good.replace(b"vertex 300", b"vertex %d" % 10**14).replace(b"chunk 2", b"chunk 390625000000")
    assert "truncated" in refused(path, huge.replace(b"sh 300", b"sh %d" % 10**14))


def test_chunks_that_are_not_finite_are_dropped_or_refused(tmp_path):
    good = compressed_bytes(some_gaussians(300, 0))
    start = good.index(b"end_header\n") + len(b"end_header\n")
    nan = np.array([np.nan], "<f4").tobytes()
    lines = []
    (tmp_path / "a.ply").write_bytes(good[:start] + nan + good[start + 4 :])
    assert len(read_ply(tmp_path / "a.ply", report=lines.append)) == 44
    assert len(lines) == 1 and "dropped 256 of 300" in lines[0]
    small = compressed_bytes(some_gaussians(30, 0))
    assert "none of its 30" in refused(tmp_path / "a.ply", small[: start - 1] + nan + small[start + 3 :])
