"""SOG, versions 1 and 2, zipped or in a folder, against an encoder written from its description."""

import json
import struct
import tracemalloc
import warnings
import zipfile
from dataclasses import replace

import cv2
import numpy as np
import pytest

from assets.formats.ply import chunk_order
from assets.formats.sog import read_sog
from assets.gaussians import Gaussians
from assets.splat_files import read_gaussians, write_gaussians
from core.errors import BadInput
from core.spherical_harmonics import C0
from tests.support.samples import refused, riff, some_gaussians
from tests.support.splat_encoders import BOOK, sog_files, zipped


def with_meta(files: dict[str, bytes], change) -> bytes:
    """The archive after `change` of the meta, in place."""
    meta = json.loads(files["meta.json"])
    change(meta)
    return zipped(files | {"meta.json": json.dumps(meta).encode()})


def assert_within_its_steps(read: Gaussians, g: Gaussians, version: int) -> None:
    logs = np.log1p(np.abs(g.means.astype(np.float64)))
    extent = np.ptp(np.sign(g.means) * logs, axis=0)
    assert (np.abs(read.means - g.means) <= extent / 65535 / 2 * np.exp(logs) * 1.01 + 1e-6).all()
    # Three components to sqrt(2)/2/255 each, and the fourth from them.
    assert np.abs((read.quats * g.quats).sum(1)).min() > 1 - 1e-4
    if version == 2:
        gaps = np.diff(BOOK).max() / 2 + 1e-6
        np.testing.assert_allclose(read.log_scales, np.clip(g.log_scales, *(BOOK[[0, -1]] - 3)), atol=gaps)
        np.testing.assert_allclose(read.sh[:, 0], np.clip(g.sh[:, 0], *BOOK[[0, -1]]), atol=gaps)
        np.testing.assert_allclose(read.opacities, g.opacities, atol=0.5 / 255 + 1e-6)
        np.testing.assert_allclose(read.sh[:, 1:], np.clip(g.sh[:, 1:], *BOOK[[0, -1]]), atol=gaps)
    else:
        assert (np.abs(read.log_scales - g.log_scales) <= np.ptp(g.log_scales, axis=0) / 510 + 1e-6).all()
        assert (np.abs(read.sh[:, 0] - g.sh[:, 0]) <= np.ptp(g.sh[:, 0], axis=0) / 510 + 1e-6).all()
        # The one of least opacity is a step too high: the test's encoder needs an alpha of 1 at least.
        np.testing.assert_allclose(read.logit_opacities, g.logit_opacities, atol=np.ptp(g.logit_opacities) / 255 + 1e-6)
        np.testing.assert_allclose(read.sh[:, 1:], np.clip(g.sh[:, 1:], -1.5, 1.5), atol=3 / 510 + 1e-6)


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("version", [1, 2])
def test_reads_what_a_plain_encoder_wrote(tmp_path, version, degree):
    g = some_gaussians(100, degree)  # more than a row of the palette; the last row of pixels is not full
    (tmp_path / "a.sog").write_bytes(zipped(sog_files(g, version)))
    lines = []
    read = read_sog(tmp_path / "a.sog", report=lines.append)
    assert read.sh_degree == degree and lines == []
    assert_within_its_steps(read, g, version)


def test_deflated_in_a_folder_of_the_archive_and_unzipped(tmp_path):
    g = some_gaussians(100, 1)
    files = sog_files(g)
    (tmp_path / "a.sog").write_bytes(zipped(files, zipfile.ZIP_DEFLATED, folder="scene/"))
    assert_within_its_steps(read_gaussians(tmp_path / "a.sog"), g, 2)
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    assert_within_its_steps(read_gaussians(tmp_path / "meta.json"), g, 2)
    (tmp_path / "quats.webp").unlink()
    with pytest.raises(BadInput, match="no such file"):
        read_gaussians(tmp_path / "meta.json")


def test_gaussians_share_palette_entries_of_16_bits(tmp_path):
    g = some_gaussians(700, 1)
    sh = np.concatenate([g.sh[:, :1], g.sh[np.arange(700) % 300, 1:]], 1)
    shared = Gaussians.of(*g_columns(g), sh)
    (tmp_path / "a.sog").write_bytes(zipped(sog_files(g, palette=300, width=28)))
    assert_within_its_steps(read_gaussians(tmp_path / "a.sog"), shared, 2)


def test_the_lost_first_entry_of_early_codebooks(tmp_path):
    files = sog_files(some_gaussians(100, 0))

    def lose(meta):
        meta["scales"]["codebook"][0] = None

    (tmp_path / "a.sog").write_bytes(with_meta(files, lose))
    assert len(read_gaussians(tmp_path / "a.sog")) == 100


@pytest.mark.parametrize("mark", [{"model": "antialiased"}, {"antialias": True}])
def test_no_rotation_is_dropped_and_antialiasing_kept(tmp_path, mark):
    g = some_gaussians(20, 0)
    files = sog_files(g)
    pixels = cv2.imdecode(np.frombuffer(files["quats.webp"], np.uint8), cv2.IMREAD_UNCHANGED)
    pixels[0, 3, 3] = 251
    files["quats.webp"] = cv2.imencode(".webp", pixels, [cv2.IMWRITE_WEBP_QUALITY, 101])[1].tobytes()
    (tmp_path / "a.sog").write_bytes(with_meta(files, lambda meta: meta.update(mark)))
    lines = []
    read = read_sog(tmp_path / "a.sog", report=lines.append)
    np.testing.assert_allclose(read.means, np.delete(g.means, 3, 0), atol=1e-3)
    assert len(lines) == 1 and "dropped 1 of 20" in lines[0] and read.antialias


@pytest.mark.parametrize("degree", range(4))
def test_what_is_written_comes_back(tmp_path, degree):
    g = replace(some_gaussians(3000, degree), sort="radial", antialias=degree == 1)
    g = replace(g, sh=g.sh[np.arange(3000) % 500])  # few different ones, which a palette can hold
    write_gaussians(tmp_path / "a.sog", g, pytest.fail)
    read, g = read_gaussians(tmp_path / "a.sog", pytest.fail), g.select(chunk_order(g.means))
    np.testing.assert_allclose(read.means, g.means, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(read.log_scales, g.log_scales, atol=np.ptp(g.log_scales) / 40)
    np.testing.assert_allclose(read.opacities, g.opacities, atol=1 / 255)
    np.testing.assert_allclose(read.sh[:, 0], g.sh[:, 0], atol=np.ptp(g.sh[:, 0]) / 40)
    assert np.sqrt(np.mean((read.sh - g.sh) ** 2)) < 0.1 * g.sh.std()
    assert np.abs((read.quats * g.quats).sum(1)).min() > 1 - 1e-4
    assert (read.sort, read.antialias, read.sh_degree) == ("radial", degree == 1, degree)


def test_harmonics_that_few_gaussians_have_are_kept_whatever_the_others(tmp_path):
    """A body with harmonics in a room without, which are all alike: one entry of the palette, not most of them."""
    g = some_gaussians(5000, 2)
    sh = g.sh.copy()
    sh[300:, 1:] = 0.0
    write_gaussians(tmp_path / "a.sog", replace(g, sh=sh), pytest.fail)
    with zipfile.ZipFile(tmp_path / "a.sog") as archive:
        assert json.loads(archive.read("meta.json"))["shN"]["count"] == 301
    read, order = read_gaussians(tmp_path / "a.sog", pytest.fail), chunk_order(g.means)
    np.testing.assert_allclose(read.sh[:, 1:], sh[order, 1:], atol=np.ptp(sh[:, 1:]) / 40)


@pytest.mark.parametrize("count", [1, 2, 70])
def test_few_and_equal_gaussians_are_written_without_a_warning(tmp_path, count):
    g = some_gaussians(1, 3).select(np.zeros(count, int))
    with warnings.catch_warnings(action="error"):
        write_gaussians(tmp_path / "a.sog", g)
    assert (tmp_path / "a.sog").read_bytes() == (
        write_gaussians(tmp_path / "b.sog", g),
        (tmp_path / "b.sog").read_bytes(),
    )[1]
    read = read_gaussians(tmp_path / "a.sog")
    np.testing.assert_allclose(read.means, g.means, rtol=1e-5)
    np.testing.assert_allclose(read.sh, g.sh, atol=np.ptp(g.sh) / 200)


def test_archives_that_cannot_be(tmp_path):
    path = tmp_path / "a.sog"
    files = sog_files(some_gaussians(30, 1))
    good = zipped(files)
    assert "empty" in refused(path, b"")
    assert "not a ZIP" in refused(path, b"spam" * 50)
    assert "not a ZIP" in refused(path, good[: len(good) // 2])
    assert "no meta.json" in refused(path, zipped({"other.json": b"{}"}))
    assert "'sh0.webp'" in refused(path, zipped({k: v for k, v in files.items() if k != "sh0.webp"}))
    assert "method" in refused(path, zipped(files, zipfile.ZIP_LZMA))
    assert "damaged" in refused(path, good.replace(files["quats.webp"], files["quats.webp"][::-1]))
    assert "not JSON" in refused(path, zipped(files | {"meta.json": b"{"}))
    assert "not JSON" in refused(path, zipped(files | {"meta.json": b"[" * 100_000}))
    assert "not JSON" in refused(path, zipped(files | {"meta.json": b"\xff\xfe\xfa"}))
    assert "not an object" in refused(path, zipped(files | {"meta.json": b"[1, 2]"}))
    assert "no splat" in refused(path, zipped(files | {"meta.json": b'{"frames": []}'}))
    assert "more than" in refused(path, zipped(files | {"meta.json": b" " * (2 << 20)}))
    assert "not a WebP" in refused(path, zipped(files | {"sh0.webp": b"\x89PNG" + bytes(60)}))
    assert "damaged" in refused(path, zipped(files | {"sh0.webp": files["sh0.webp"][:60]}))
    assert ".sog" in refused(tmp_path / "a.ply", good)


def test_metas_that_cannot_be(tmp_path):
    path = tmp_path / "a.sog"
    files = sog_files(some_gaussians(30, 1))

    def says(*keys, value) -> str:
        def change(meta):
            for key in keys[:-1]:
                meta = meta[key]
            meta[keys[-1]] = value

        return refused(path, with_meta(files, change))

    assert "version 3" in says("version", value=3)
    assert "version []" in says("version", value=[])
    for count in (None, -1, 1.5, "30", 10**12):
        assert "no count" in says("count", value=count)
    assert "no Gaussians" in says("count", value=0)
    assert "holds 36 of 37" in says("count", value=37)
    assert "scales: it is 7, not an object" in says("scales", value=7)
    assert "finite" in says("means", "mins", value=[0, float("nan"), 0])
    assert "finite" in says("means", "maxs", value=[0, 10**400, 0])
    assert "finite" in says("means", "maxs", value=[1, 2])
    assert "none of its 30" in says("means", "maxs", value=[900, 900, 900])
    assert "codebook" in says("scales", "codebook", value=[])
    assert "codebook" in says("sh0", "codebook", value=["a"] * 256)
    assert "none of its 30" in says("sh0", "codebook", value=[0.5])
    assert "encoding" in says("quats", "encoding", value="euler")
    for name in ("../secret.webp", "/etc/passwd", "a\\b", "..", "", "C:x", "a\nb", "a\0b"):
        assert "not the name of a file beside" in says("quats", "files", value=[name])
    assert "names no image" in says("means", "files", value=["means_l.webp"])
    assert "names no image" in says("quats", "files", value="quats.webp")
    assert "bands" in says("shN", "bands", value=2)
    assert "beyond its SH palette" in says("shN", "count", value=29)
    assert "beyond its SH palette" in says("shN", "count", value=10**9)
    assert "fits no degree" in says("shN", "files", value=["quats.webp", "shN_labels.webp"])


def test_bombs_are_refused_without_unpacking_them(tmp_path):
    """An image of 16,384 x 16,384 in its header, an honest one of a colour all over, megabytes of deflated zeros."""
    path = tmp_path / "a.sog"
    files = sog_files(some_gaussians(30, 0))
    side, size = 16383 | 16383 << 14, (160 << 20) + 12345
    claims = zipped(files | {"means_l.webp": riff(b"VP8L", b"\x2f" + struct.pack("<I", side) + bytes(60))})
    flat = cv2.imencode(".webp", np.full((4200, 4200, 3), 7, np.uint8), [cv2.IMWRITE_WEBP_QUALITY, 101])[1].tobytes()
    deflated = zipped(files | {"means_l.webp": bytes(size)}, zipfile.ZIP_DEFLATED)
    lying = deflated.replace(struct.pack("<I", size), struct.pack("<I", 1 << 20))
    tracemalloc.start()
    assert "pixels" in refused(path, claims)
    assert "pixels" in refused(path, zipped(files | {"means_l.webp": flat}))
    assert f"claims {size} bytes" in refused(path, deflated)
    assert "means_l.webp" in refused(path, lying)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 100 << 20


def test_colours_come_in_their_order(tmp_path):
    """Red stays red: images hold RGB, and the decoder gives BGR."""
    g = some_gaussians(4, 0)
    sh = np.tile(np.array([0.9, 0.0, -0.9], np.float32) / np.float32(C0) / 4, (4, 1, 1))
    (tmp_path / "a.sog").write_bytes(zipped(sog_files(Gaussians.of(*g_columns(g), sh), width=4)))
    np.testing.assert_allclose(read_gaussians(tmp_path / "a.sog").sh, sh, atol=0.03)


def g_columns(g: Gaussians) -> tuple:
    return g.means, g.quats, g.log_scales, g.logit_opacities
