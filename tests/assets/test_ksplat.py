"""The format .ksplat, levels 0 to 2, against an encoder written from its description; damage is refused."""

import struct

import numpy as np
import pytest

from assets.formats.ksplat import read_ksplat
from assets.gaussians import SH_COUNTS, Gaussians
from assets.splat_files import read_gaussians
from core.spherical_harmonics import C0
from tests.assets.test_splat_formats import refused
from tests.support.samples import damaged, read_or_refuse, some_gaussians

BLOCK, BUCKET, RANGE = 2.0, 8, 32767  # few Gaussians a bucket, so that some are full


def section_bytes(g: Gaussians, level: int, sh_range=(-1.5, 1.5), room=0, bucket_bytes=12) -> tuple[bytes, bytes]:
    """Header and content of one section, Gaussian by Gaussian; it stores them bucket by bucket (see `stored`)."""
    full, partial = buckets(g)
    sizes = [len(members) for _, members in partial]
    content = b""
    if level:
        content += struct.pack(f"<{len(sizes)}I", *sizes)
        content += b"".join(struct.pack("<3f", *c) + bytes(bucket_bytes - 12) for c, _ in full + partial)
    for center, members in full + partial:
        for i in members:
            rgb = np.clip(np.round((0.5 + C0 * g.sh[i, 0]) * 255), 0, 255)
            color = bytes(int(v) for v in [*rgb, round(float(g.opacities[i]) * 255)])
            numbers = [*np.exp(g.log_scales[i]), *g.quats[i]]
            if level == 0:
                content += struct.pack("<10f", *g.means[i], *numbers) + color
            else:
                offset = np.round((g.means[i] - center) * (RANGE / (BLOCK / 2))) + RANGE
                content += struct.pack("<3H7e", *(int(v) for v in offset), *numbers) + color
            for first, last in ((1, 4), (4, 9))[: g.sh_degree]:
                values = g.sh[i, first:last].T.ravel()  # red, green, blue
                low, high = sh_range
                as_bytes = np.clip(np.round((values - low) / (high - low) * 255), 0, 255).astype(np.uint8).tobytes()
                content += [
                    struct.pack(f"<{len(values)}f", *values),
                    struct.pack(f"<{len(values)}e", *values),
                    as_bytes,
                ][level]
    content += bytes(room * row_size(level, g.sh_degree))
    about = (BUCKET, len(full + partial), BLOCK, bucket_bytes, RANGE) if level else (0, 0, 0.0, 0, 0)
    counts = (len(full), len(partial)) if level else (0, 0)
    fields = (len(g), len(g) + room, *about, len(content), *counts, g.sh_degree)
    return struct.pack("<IIIIfHxxIIIIH", *fields).ljust(1024, b"\0"), content


def row_size(level: int, degree: int) -> int:
    return (44, 24, 24)[level] + 3 * (SH_COUNTS[degree] - 1) * (4, 2, 1)[level]


def buckets(g: Gaussians) -> tuple[list, list]:
    """(centre, members) of the cubes of side BLOCK that hold BUCKET Gaussians, and of those that hold fewer."""
    full, open_ones = [], {}
    for i, cell in enumerate(map(tuple, np.floor(g.means / BLOCK).astype(int))):
        members = open_ones.setdefault(cell, [])
        members.append(i)
        if len(members) == BUCKET:
            full.append(((np.array(cell) + 0.5) * BLOCK, open_ones.pop(cell)))
    return full, [((np.array(cell) + 0.5) * BLOCK, members) for cell, members in open_ones.items()]


def stored(g: Gaussians) -> Gaussians:
    """In the order of the file."""
    full, partial = buckets(g)
    return g.select(np.concatenate([members for _, members in full + partial]))


def ksplat_bytes(parts: list[Gaussians], level: int, sh_range=(-1.5, 1.5), spare=0, **options) -> bytes:
    """A whole file of one section a part, and `spare` empty section headers."""
    sections = [section_bytes(g, level, sh_range, **options) for g in parts]
    n = sum(map(len, parts))
    places = len(parts) + spare
    fields = (0, 1, places, len(parts), n, n, level, 0.0, 0.0, 0.0, *sh_range)
    head = struct.pack("<BBxxIIIIHxxfffff", *fields).ljust(4096, b"\0")
    return head + b"".join(h for h, _ in sections) + bytes(1024 * spare) + b"".join(c for _, c in sections)


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
        np.testing.assert_allclose(read.means, g.means, atol=BLOCK / 4 / RANGE + 1e-6)  # half a step
        half = 1.5 / 255 if level == 2 else 2.0**-11  # a byte of -1.5..1.5; float16 of numbers below 2
        np.testing.assert_allclose(read.sh[:, 1:], g.sh[:, 1:], atol=half + 1e-6)
    np.testing.assert_allclose(read.log_scales, g.log_scales, atol=1e-6 if level == 0 else 6e-4)  # float16: 2^-11
    np.testing.assert_allclose(read.opacities, g.opacities, atol=0.5 / 255 + 1e-6)
    expected = np.clip(C0 * g.sh[:, 0] + 0.5, 0, 1)
    np.testing.assert_allclose(C0 * read.sh[:, 0] + 0.5, expected, atol=0.5 / 255 + 1e-6)
    assert np.abs((read.quats * g.quats).sum(1)).min() > 1 - 1e-6


@pytest.mark.parametrize("level", range(3))
def test_sections_of_their_own_degree_and_with_spare_room(tmp_path, level):
    a, b = some_gaussians(30, 1), some_gaussians(50, 2, seed=1)
    (tmp_path / "a.ksplat").write_bytes(ksplat_bytes([a, b], level, spare=2, room=3, bucket_bytes=16 if level else 12))
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


@pytest.mark.parametrize("level", range(3))
def test_damaged_files_load_finite_or_are_refused(tmp_path, level):
    """The 5 KB of the headers are mostly empty: they are damaged apart from the rest."""
    good = ksplat_bytes([some_gaussians(200, 1)], level)
    used = [*range(44), *range(4096, 4096 + 42)]
    rng = np.random.default_rng(0)

    def copies():
        yield from damaged(good, 200)
        for _ in range(300):
            data = bytearray(good)
            data[rng.choice(used)] ^= 1 << rng.integers(0, 8)
            yield bytes(data)

    outcomes = read_or_refuse(lambda path: read_ksplat(path, report=str), tmp_path / "a.ksplat", copies())
    assert min(outcomes.values()) > 50


@pytest.mark.shared
def test_the_same_scene_as_splat(shared):
    """Four Gaussians, written by others as .splat and .ksplat."""
    folder = shared / "data" / "splats" / "formats"
    a, b = (read_gaussians(folder / f"minimal.{kind}") for kind in ("splat", "ksplat"))
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=1e-6)
