"""All splat formats together: the choice of the reader, damage, failed writes, files of others; and .splat."""

import gzip
import struct

import numpy as np
import pytest

from assets.asset import Asset
from assets.gaussians import Gaussians
from assets.splat_files import WRITERS, read_gaussians, write_gaussians
from core.errors import BadInput
from core.spherical_harmonics import C0
from tests.support.samples import FIELDS, damaged, read_or_refuse, refused, some_gaussians
from tests.support.splat_encoders import (
    compressed_bytes,
    ksplat_bytes,
    ply_bytes,
    properties,
    sog_files,
    splat_bytes,
    spz_4_bytes,
    zipped,
)


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


def written(suffix: str, g: Gaussians, folder) -> bytes:
    write_gaussians(folder / f"written{suffix}", g)
    return (folder / f"written{suffix}").read_bytes()


def flipped(good: bytes, places, trials: int):
    """Copies with one flipped bit at one of the places."""
    rng = np.random.default_rng(0)
    for _ in range(trials):
        data = bytearray(good)
        data[rng.choice(places)] ^= 1 << rng.integers(0, 8)
        yield bytes(data)


def damaged_ksplat(level: int):
    """Its headers of 5 KB are mostly empty: they are damaged apart from the rest."""
    good = ksplat_bytes([some_gaussians(60, 1)], level)
    yield from damaged(good, 80)
    yield from flipped(good, [*range(44), *range(4096, 4096 + 42)], 120)


def damaged_images(version: int):
    """Damage behind a ZIP archive's honest checksums."""
    files = sog_files(some_gaussians(60, 1), version)
    for seed, (name, data) in enumerate(files.items()):
        for copy in damaged(data, 20, seed):
            yield zipped(files | {name: copy})


SMALL = some_gaussians(12, 1)
DAMAGE = {  # damaged copies, at least so many of which are read, and refused
    "ply": (".ply", lambda folder: damaged(ply_bytes(properties(SMALL)), 200), 25, 25),
    "compressed": (".ply", lambda folder: damaged(compressed_bytes(some_gaussians(270, 1)), 200), 25, 25),
    "splat": (".splat", lambda folder: damaged(splat_bytes(SMALL), 100), 20, 20),
    "ksplat 0": (".ksplat", lambda folder: damaged_ksplat(0), 25, 25),
    "ksplat 1": (".ksplat", lambda folder: damaged_ksplat(1), 25, 25),
    "ksplat 2": (".ksplat", lambda folder: damaged_ksplat(2), 25, 25),
    "spz 3": (".spz", lambda folder: damaged(written(".spz", SMALL, folder), 100), 0, 50),
    "spz 4": (".spz", lambda folder: damaged(spz_4_bytes(written(".spz", SMALL, folder)), 100), 0, 50),
    "spz, inside": (  # the gzip layer, whose checksum guards the content
        ".spz",
        lambda folder: (gzip.compress(c, 1) for c in damaged(gzip.decompress(written(".spz", SMALL, folder)), 100)),
        10,
        10,
    ),
    "sog": (".sog", lambda folder: damaged(zipped(sog_files(SMALL)), 100), 0, 50),
    "sog 1, inside": (".sog", lambda folder: damaged_images(1), 15, 15),
    "sog 2, inside": (".sog", lambda folder: damaged_images(2), 15, 15),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_damaged_files_load_finite_or_are_refused(tmp_path, capfd, name):
    """Truncations and bit flips: finite Gaussians or BadInput in one line, and nothing said beside it."""
    suffix, copies, read, refusals = DAMAGE[name]
    outcomes = read_or_refuse(lambda p: read_gaussians(p, report=str), tmp_path / f"a{suffix}", copies(tmp_path))
    assert outcomes["read"] >= read and outcomes["refused"] >= refusals
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("suffix", [*WRITERS, ".h5"])
def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch, suffix):
    write = (lambda path, g: Asset(g).save(path)) if suffix == ".h5" else write_gaussians
    path = tmp_path / f"a{suffix}"
    write(path, some_gaussians(3))
    old = path.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as m, pytest.raises(BadInput, match="No space left"):
        m.setattr("os.replace", full)
        write(path, some_gaussians(20))
    assert path.read_bytes() == old and [p.name for p in tmp_path.iterdir()] == [path.name]
    with pytest.raises(BadInput, match="does not exist"):
        write(tmp_path / "none" / path.name, some_gaussians())


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


@pytest.mark.shared
def test_a_captured_splat_through_spz(shared, tmp_path):
    g = read_gaussians(shared / "data" / "splats" / "toy_cat.ply")
    write_gaussians(tmp_path / "a.spz", g)
    read = read_gaussians(tmp_path / "a.spz")
    np.testing.assert_allclose(read.means, g.means, atol=2**-17 + 1e-6)
    assert (tmp_path / "a.spz").stat().st_size < 1e6  # from 5.8 MB
