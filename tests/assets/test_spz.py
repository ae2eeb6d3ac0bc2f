"""The compact format .spz, versions 1 to 4: quantisation, axes, damage, bombs."""

import gzip
import struct
import tracemalloc
import warnings
import zlib
from dataclasses import replace

import numpy as np
import pytest
import zstandard

from assets.formats.spz import read_spz, write_spz
from assets.splat_files import read_gaussians, write_gaussians
from core.errors import BadInput
from core.spherical_harmonics import sh_basis
from tests.support.samples import FIELDS, assert_is_image, refused, some_gaussians
from tests.support.splat_encoders import spz_4_bytes, spz_bytes

HALF_TURN = np.diag([1.0, -1.0, -1.0])  # right-up-back to right-down-front


@pytest.mark.parametrize("degree", range(4))
def test_spz_round_trip_within_its_quantisation(tmp_path, degree):
    g = some_gaussians(400, degree)
    write_gaussians(tmp_path / "a.spz", g)
    read = read_gaussians(tmp_path / "a.spz")
    assert read.sh_degree == degree
    np.testing.assert_allclose(read.means, g.means, atol=2**-17 + 1e-6)
    np.testing.assert_allclose(read.log_scales, g.log_scales, atol=1 / 32 + 1e-6)
    np.testing.assert_allclose(read.opacities, g.opacities, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(read.sh[:, 0], g.sh[:, 0], atol=0.5 / 255 / 0.15 + 1e-6)
    np.testing.assert_allclose(read.sh[:, 1:], np.clip(g.sh[:, 1:], -1, 1), atol=1 / 128)
    # Three components to 0.7/511 each, and the fourth from them.
    assert np.abs((read.quats * g.quats).sum(1)).min() > 1 - 1e-5


def test_spz_is_turned_as_a_whole(tmp_path):
    """The stored Gaussians are those of the .ply turned by half a turn about x, view-dependent colour included."""
    g = some_gaussians(60, 3)
    write_spz(tmp_path / "a.spz", g)
    raw = gzip.decompress((tmp_path / "a.spz").read_bytes())
    n = len(g)
    turned = g.transformed(HALF_TURN)
    stored = np.frombuffer(raw, np.uint8, 9 * n, 16).reshape(n, 3, 3).astype(np.int32)
    stored = (stored[..., 0] | stored[..., 1] << 8 | stored[..., 2] << 16) << 8 >> 8
    np.testing.assert_allclose(stored / 2**16, turned.means, atol=2**-16)
    sh = (np.frombuffer(raw, np.uint8, 45 * n, 16 + 20 * n).reshape(n, 15, 3) - 128.0) / 128
    view = np.array([[0.6, 0.0, 0.8]])
    basis = sh_basis(view, 16)[:, 1:]
    expected = np.einsum("mk,nkc->nmc", basis, turned.sh[:, 1:].clip(-1, 127 / 128))
    np.testing.assert_allclose(np.einsum("mk,nkc->nmc", basis, sh), expected, atol=0.03)
    read = read_spz(tmp_path / "a.spz")
    np.testing.assert_allclose(read.covariances, g.covariances, rtol=0.15, atol=2e-3)


def test_spz_version_1_has_float16_positions(tmp_path):
    position = np.array([1.5, -0.25, 3.0], "<f2").tobytes()
    (tmp_path / "a.spz").write_bytes(spz_bytes(1, position, rotation=b"\x80" * 3))
    g = read_gaussians(tmp_path / "a.spz")
    np.testing.assert_array_equal(g.means, [[1.5, 0.25, -3.0]])
    np.testing.assert_allclose(g.log_scales, -4.0)
    np.testing.assert_allclose(g.opacities, 128 / 255, atol=1e-6)


def test_spz_version_1_with_signalling_nans_is_refused_in_one_line(tmp_path):
    (tmp_path / "a.spz").write_bytes(spz_bytes(1, bytes([1, 0x7C] * 3), rotation=b"\x80" * 3))
    with pytest.raises(BadInput, match="is finite"), warnings.catch_warnings(action="error"):
        read_gaussians(tmp_path / "a.spz")


def test_spz_version_2_derives_w(tmp_path):
    xyz = bytes([255, 128, 128])  # a half turn about x
    (tmp_path / "a.spz").write_bytes(spz_bytes(2, b"\0" * 9, rotation=xyz))
    np.testing.assert_allclose(read_gaussians(tmp_path / "a.spz").quats, [[0, 1, 0, 0]], atol=0.01)


@pytest.mark.parametrize("largest", range(4))
def test_spz_version_3_smallest_three(tmp_path, largest):
    """Each component can be the one left out; the expected rotation is spelled out by hand."""
    small = [0.1, -0.2, 0.3]
    code = largest
    for value in small:
        code = code << 10 | (512 if value < 0 else 0) | round(511 * abs(value) * 2**0.5)
    xyzw = [*small[:largest], (1 - 0.14) ** 0.5, *small[largest:]]
    (tmp_path / "a.spz").write_bytes(spz_bytes(3, b"\0" * 9, rotation=struct.pack("<I", code)))
    x, y, z, w = xyzw
    np.testing.assert_allclose(read_gaussians(tmp_path / "a.spz").quats, [[w, x, -y, -z]], atol=2e-3)


def test_spz_degree_4_and_extensions_are_ignored_aloud_and_antialiasing_is_kept(tmp_path):
    sh = bytes([192] * 72)
    lines = []
    data = spz_bytes(3, b"\0" * 9, 4, flags=3, rotation=b"\0\0\0\xc0", sh=sh, tail=b"\1\0\0\0\2\0\0\0\7\7")
    (tmp_path / "a.spz").write_bytes(data)
    g = read_gaussians(tmp_path / "a.spz", report=lines.append)
    assert g.sh_degree == 3 and np.abs(g.sh[:, 1:]).max() == 0.5
    assert len(lines) == 1 and all(word in lines[0] for word in ("degree 4", "extension 0x1")) and g.antialias


@pytest.mark.parametrize("degree", range(4))
def test_spz_version_4_holds_what_version_3_holds(tmp_path, degree):
    g = some_gaussians(50, degree)
    write_spz(tmp_path / "3.spz", g)
    extension = b"\1\0\0\0\0\0\0\0" if degree == 1 else b""
    (tmp_path / "4.spz").write_bytes(spz_4_bytes((tmp_path / "3.spz").read_bytes(), extension=extension))
    read, expected = read_spz(tmp_path / "4.spz", report=str), read_spz(tmp_path / "3.spz")
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(read, name), getattr(expected, name))


LETTERS = {"R": [1, 0, 0], "L": [-1, 0, 0], "D": [0, 1, 0], "U": [0, -1, 0], "F": [0, 0, 1], "B": [0, 0, -1]}
SYSTEMS = {"LDB": 1, "RUB": 4, "RDF": 6, "LUF": 7, "RUF": 8, "LFD": 9, "RFU": 12, "LBU": 15, "RBU": 16}


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("system", SYSTEMS)
def test_an_extension_names_the_axes(tmp_path, system, version):
    """A file whose axes point elsewhere, mirrored or not, is turned to right, down, front, and so are its colours."""
    g = some_gaussians(40, 3)
    write_spz(tmp_path / "a.spz", g)
    as_rub = read_spz(tmp_path / "a.spz")
    raw = bytearray(gzip.decompress((tmp_path / "a.spz").read_bytes()))
    record = struct.pack("<III", 0xADBE0003, 4, SYSTEMS[system])
    raw[14] |= 2
    data = gzip.compress(bytes(raw) + record)
    (tmp_path / "b.spz").write_bytes(data if version == 3 else spz_4_bytes(data, extension=record))
    read = read_spz(tmp_path / "b.spz", report=pytest.fail)
    M = np.array([LETTERS[c] for c in system]).T @ np.diag([1, -1, -1])
    assert_is_image(read, as_rub, M, M)


def test_a_coordinate_system_that_is_not_known_is_ignored_aloud(tmp_path):
    lines, tail = [], struct.pack("<III", 0xADBE0003, 4, 17)
    (tmp_path / "a.spz").write_bytes(spz_bytes(3, b"\0" * 9, flags=2, rotation=b"\0\0\0\xc0", tail=tail))
    read_spz(tmp_path / "a.spz", report=lines.append)
    assert len(lines) == 1 and "coordinate system 17" in lines[0]


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("sort", ["", "radial"])
def test_version_4_is_written_with_the_same_content(tmp_path, degree, sort):
    g = replace(some_gaussians(50, degree), sort=sort, antialias=degree == 1)
    for version in (3, 4):
        write_gaussians(tmp_path / f"{version}.spz", g, version=version)
    assert (tmp_path / "4.spz").read_bytes()[:8] == b"NGSP\4\0\0\0"
    read, expected = (read_gaussians(tmp_path / f"{version}.spz", pytest.fail) for version in (4, 3))
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(read, name), getattr(expected, name))
    assert (read.sort, read.antialias) == (sort or "z", g.antialias)


def test_spz_that_cannot_be(tmp_path):
    path = tmp_path / "a.spz"
    assert "empty" in refused(path, b"")
    assert "not a .spz" in refused(path, b"spam" * 30)
    assert "not a .spz" in refused(path, gzip.compress(b"spam" * 30))
    assert "version 9" in refused(path, spz_bytes(9, b"\0" * 9))
    assert "degree 5" in refused(path, spz_bytes(3, b"\0" * 9, 5))
    assert "24 fractional" in refused(path, spz_bytes(3, b"\0" * 9, bits=24))
    assert "no Gaussians" in refused(path, spz_bytes(3, b"\0" * 9, count=0))
    assert "truncated" in refused(path, spz_bytes(3, b"\0" * 9))
    whole = spz_bytes(3, b"\0" * 9, rotation=b"\0\0\0\xc0")
    assert "truncated" in refused(path, whole[:-4])  # only the checksum is cut
    assert "damaged" in refused(path, whole[:-8] + b"\0\0\0\0" + whole[-4:])
    with pytest.raises(BadInput, match="do not fit"):
        write_spz(tmp_path / "b.spz", some_gaussians(3, 0).transformed(np.eye(3), scale=1e8))


def test_bombs_are_refused_without_unpacking_them(tmp_path):
    """A header that claims what only a bomb could hold, and a bomb behind an honest header."""
    path = tmp_path / "a.spz"
    packer = zlib.compressobj(1, zlib.DEFLATED, 31)
    honest = struct.pack("<IIIBBBB", 0x5053474E, 3, 1, 0, 12, 0, 0) + b"\0" * 20
    bomb = packer.compress(honest) + b"".join(packer.compress(bytes(1 << 20)) for _ in range(100)) + packer.flush()
    frame = zstandard.compress(bytes(200 << 20))
    table = struct.pack("<QQ", len(frame), 9) + struct.pack("<QQ", len(frame), 200 << 20) * 4
    v4 = struct.pack("<IIIBBBBI12x", 0x5053474E, 4, 1, 0, 12, 0, 5, 32) + table + frame * 5
    v4_huge = struct.pack("<IIIBBBBI12x", 0x5053474E, 4, 2**31, 0, 12, 0, 5, 32) + table + frame * 5
    tracemalloc.start()
    try:
        for count in (2**31, 2**32 - 1, 10**8):
            assert str(count) in refused(path, spz_bytes(3, b"\0" * 9, count=count, rotation=b"\0" * 4))
        assert "2147483648" in refused(path, v4_huge)
        assert "stream 1" in refused(path, v4)
        path.write_bytes(bomb)
        assert len(read_spz(path, report=str)) == 1  # what follows the Gaussians stays packed
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 20 << 20
