"""The format .splat, the choice of the reader by name and content, and files that others wrote."""

import struct

import numpy as np
import pytest

from assets.asset import Asset
from assets.gaussians import concatenate
from assets.splat_files import read_gaussians, write_gaussians
from core.errors import BadInput
from core.rotation import matrices_from_quaternions
from core.spherical_harmonics import C0
from tests.support.samples import damaged, read_or_refuse, some_gaussians

HALF_TURN = np.diag([1.0, -1.0, -1.0])  # right-up-back to right-down-front


def refused(path, data: bytes | None = None) -> str:
    """The one line with which the file is refused."""
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(BadInput) as error:
        read_gaussians(path, report=str)
    message = str(error.value)
    assert str(path) in message and "\n" not in message
    return message


def covariances(g) -> np.ndarray:
    axes = matrices_from_quaternions(g.quats) * np.exp(g.log_scales)[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


# --- .splat


def splat_bytes(g) -> bytes:
    """Rows of a .splat written from its description."""
    rows = b""
    for i in range(len(g)):
        rgb = np.clip(np.round((0.5 + C0 * g.sh[i, 0]) * 255), 0, 255)
        quat = np.clip(np.round(g.quats[i] * 128 + 128), 0, 255)
        rows += struct.pack("<6f", *g.means[i], *np.exp(g.log_scales[i]))
        rows += bytes(int(v) for v in [*rgb, round(float(g.opacities[i]) * 255), *quat])
    return rows


def test_splat_is_read_within_its_quantisation(tmp_path):
    g = some_gaussians(50, 0)
    (tmp_path / "a.splat").write_bytes(splat_bytes(g))
    read = read_gaussians(tmp_path / "a.splat")
    np.testing.assert_array_equal(read.means, g.means)
    np.testing.assert_allclose(read.log_scales, g.log_scales, atol=1e-6)
    np.testing.assert_allclose(read.opacities, g.opacities, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(C0 * read.sh, C0 * g.sh, atol=0.5 / 255 + 1e-6)
    assert np.abs((read.quats * g.quats).sum(1)).min() > 1 - 2 * (1 / 128) ** 2


def test_splat_round_trip(tmp_path):
    """Written rows are those of the plain encoder, and sizes too small for float32 do not vanish."""
    g = some_gaussians(80, 0)
    write_gaussians(tmp_path / "a.splat", g)
    written, expected = (tmp_path / "a.splat").read_bytes(), splat_bytes(g)
    assert len(written) == len(expected)
    differ = (np.frombuffer(written, np.uint8) != np.frombuffer(expected, np.uint8)).reshape(-1, 32)
    assert np.delete(differ, [12, 16, 20], axis=1).mean() < 0.002  # ties of rounding; exp differs in its last bits
    g.log_scales[3] = -120
    write_gaussians(tmp_path / "a.splat", g)
    read = read_gaussians(tmp_path / "a.splat")
    assert len(read) == 80
    np.testing.assert_array_equal(read.means, g.means)
    np.testing.assert_allclose(read.opacities, g.opacities, atol=0.5 / 255 + 1e-6)


def test_splat_drops_what_has_no_size_or_rotation(tmp_path):
    data = bytearray(splat_bytes(some_gaussians(6, 0)))
    data[12:16] = struct.pack("<f", 0.0)
    data[32 + 12 : 32 + 16] = struct.pack("<f", -1.0)
    data[64 + 28 : 64 + 32] = bytes([128] * 4)
    lines = []
    (tmp_path / "a.splat").write_bytes(data)
    assert len(read_gaussians(tmp_path / "a.splat", report=lines.append)) == 3
    assert len(lines) == 1 and "dropped 3 of 6" in lines[0]


def test_damaged_splat(tmp_path):
    good = splat_bytes(some_gaussians(10, 0))
    outcomes = read_or_refuse(lambda p: read_gaussians(p, report=str), tmp_path / "a.splat", damaged(good, 200))
    assert min(outcomes.values()) > 40
    assert "multiple of 32" in refused(tmp_path / "a.splat", good[:-1])


# --- the choice of the reader


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
    message = refused(tmp_path / "c.obj", b"v 0 0 0\n")
    assert all(kind in message for kind in (".ply", ".splat", ".ksplat", ".spz", ".sog", ".h5"))
    (tmp_path / "folder.spz").mkdir()
    assert "folder" in refused(tmp_path / "folder.spz")
    assert "no such file" in refused(tmp_path / "none.splat")
    with pytest.raises(BadInput, match=r"\.ply, \.compressed\.ply, \.spz, \.splat"):
        write_gaussians(tmp_path / "a.ksplat", g)


@pytest.mark.shared
@pytest.mark.parametrize("name", ["minimal-v3.spz", "minimal-v4.spz"])
def test_the_same_scene_in_each_format(shared, name):
    """Four Gaussians, written by others as .splat and .spz."""
    folder = shared / "data" / "splats" / "formats"
    a, b = read_gaussians(folder / "minimal.splat"), read_gaussians(folder / name)
    np.testing.assert_array_equal(a.means, b.means)
    np.testing.assert_allclose(a.log_scales, b.log_scales, atol=1 / 32)
    np.testing.assert_allclose(a.opacities, b.opacities, atol=1e-6)
    np.testing.assert_allclose(C0 * a.sh, C0 * b.sh, atol=1 / 255)
    np.testing.assert_allclose(covariances(a), covariances(b), atol=1e-3)


@pytest.mark.shared
def test_unpacked_spz_equals_packed(shared):
    """`raw` is the stream of `v2` without gzip. Both were written without the half turn and the colour's 0.15."""
    folder = shared / "data" / "splats" / "formats"
    packed, raw = (read_gaussians(folder / f"minimal-{name}.spz") for name in ("v2", "raw"))
    both = concatenate([packed, raw])
    np.testing.assert_array_equal(both.means[:4], both.means[4:])
    np.testing.assert_array_equal(both.sh[:4], both.sh[4:])
    splat = read_gaussians(folder / "minimal.splat")
    np.testing.assert_array_equal(packed.means, splat.means @ HALF_TURN)
    np.testing.assert_allclose(packed.opacities, splat.opacities, atol=1e-6)


@pytest.mark.shared
def test_a_captured_splat_through_spz(shared, tmp_path):
    g = read_gaussians(shared / "data" / "splats" / "toy_cat.ply")
    write_gaussians(tmp_path / "a.spz", g)
    read = read_gaussians(tmp_path / "a.spz")
    np.testing.assert_allclose(read.means, g.means, atol=2**-17 + 1e-6)
    assert (tmp_path / "a.spz").stat().st_size < 1e6  # from 5.8 MB
