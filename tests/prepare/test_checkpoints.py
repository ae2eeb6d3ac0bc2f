"""A stopped preparation resumes; its progress on the screen; the thumbnail in the asset."""

import io
import zlib
from dataclasses import asdict

import cv2
import h5py
import numpy as np
import pytest

from assets.asset import Asset
from assets.images import THUMBNAIL_SIDE, check_thumbnail, thumbnail_of
from assets.splat_files import write_gaussians
from core.errors import BadInput
from prepare.checkpoints import Checkpoints
from prepare.pipeline import STEPS, VERSION, Options
from prepare.prepared_files import prepare_file
from prepare.progress import ProgressBar, ProgressLines, progress_on
from tests.support.shells import ball


@pytest.fixture
def source(tmp_path, monkeypatch):
    monkeypatch.setenv("VRGS_CACHE", str(tmp_path / "cache"))
    path = tmp_path / "ball.ply"
    write_gaussians(path, ball(2000))
    return path


def test_a_stopped_run_resumes_after_its_last_finished_step(ti_cpu, source, tmp_path):
    """The asset is that of a run that was not stopped; then the cache is empty."""
    how = {"options": Options(vertices=300, up="+y"), "report": lambda line: None}
    whole = Asset.load(prepare_file(source, tmp_path / "whole.h5", **how))

    def stop(step, done):
        if step == "embed":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        prepare_file(source, tmp_path / "out.h5", progress=stop, **how)
    assert not (tmp_path / "out.h5").exists()
    kept = sorted(p.name for p in (tmp_path / "cache").rglob("*.npz"))
    assert kept == ["cage.npz", "fill.npz", "orient.npz", "surface.npz"]

    damaged = next((tmp_path / "cache").rglob("surface.npz"))
    damaged.write_bytes(damaged.read_bytes()[:-500])  # ignored: made again
    seen, lines = [], []
    how["report"] = lines.append
    out = prepare_file(source, tmp_path / "out.h5", progress=lambda step, done: seen.append(step), **how)
    assert list(dict.fromkeys(seen)) == ["surface", "embed", "contact"]
    assert "resumed after the step cage of an earlier run" in lines
    again = Asset.load(out)
    np.testing.assert_array_equal(again.cage.vertices, whole.cage.vertices)
    np.testing.assert_array_equal(again.embedding.host, whole.embedding.host)
    np.testing.assert_array_equal(again.gaussians.means, whole.gaussians.means)
    assert not list((tmp_path / "cache").rglob("*.npz"))


def test_entries_belong_to_a_file_and_options_and_damaged_ones_are_ignored(source):
    made = []

    def make() -> dict:
        made.append(1)
        return {"x": np.arange(1000)}

    def count(**options) -> int:
        np.testing.assert_array_equal(Checkpoints(source, options, 1).step("fill", make)["x"], np.arange(1000))
        return len(made)

    assert [count(vertices=5), count(vertices=5), count(vertices=6)] == [1, 1, 2]
    path = next(Checkpoints(source, {"vertices": 5}, 1).folder.glob("*.npz"))
    whole = path.read_bytes()
    for k, damaged in enumerate((b"", b"PK", whole[:-30], whole[:400] + b"\xff" * 8 + whole[408:])):
        path.write_bytes(damaged)
        assert count(vertices=5) == 3 + k
    np.savez(path, x=np.array([print], dtype=object), allow_pickle=True)
    assert count(vertices=5) == 7  # nothing is unpickled
    source.write_bytes(source.read_bytes() + b"\n")
    assert count(vertices=5) == 8
    Checkpoints(source, {"vertices": 5}, 1).clear()
    assert count(vertices=5) == 9


def test_kept_arrays_that_make_no_sense_are_made_again(ti_cpu, source, tmp_path):
    options = Options(vertices=300, up="+y")
    Checkpoints(source, asdict(options), VERSION).step("surface", lambda: {"psi": np.zeros(3)})
    assert len(Asset.load(prepare_file(source, tmp_path / "out.h5", options, report=print)).cage.tets) > 100


class Terminal(io.StringIO):
    encoding = "utf-8"

    def isatty(self):
        return True


def test_a_terminal_gets_a_bar_and_a_file_gets_lines():
    screen, file = Terminal(), io.StringIO()
    bar, lines = progress_on(screen, STEPS), progress_on(file, STEPS)
    assert isinstance(bar, ProgressBar) and isinstance(lines, ProgressLines)
    for step in STEPS:
        bar(step, 0.0)
        lines(step, 0.0)
    bar("contact", 1.0)
    lines("contact", 1.0)
    assert "\n" not in screen.getvalue() and screen.getvalue().endswith("\r\x1b[K")  # nothing is left of it
    shown = screen.getvalue().split("\r")[1:]
    assert [next(s for s in STEPS if s in line) for line in shown[: len(STEPS)]] == list(STEPS)
    shares = [line.count("█") for line in shown[:-1]]
    assert shares == sorted(shares) and shares[0] == 0 and shares[-1] == 28
    assert [line.split()[1] for line in file.getvalue().splitlines()] == list(STEPS)


def small_asset(**changes) -> Asset:
    return Asset(ball(50), **changes)


def picture() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 255, (48, 56, 3), dtype=np.uint8)


def test_a_thumbnail_is_kept_and_old_files_need_none(tmp_path):
    small_asset(thumbnail=thumbnail_of(picture())).save(tmp_path / "a.h5")
    again = cv2.imdecode(Asset.load(tmp_path / "a.h5").thumbnail, cv2.IMREAD_COLOR)
    assert again.shape == (THUMBNAIL_SIDE, THUMBNAIL_SIDE, 3)
    small_asset().save(tmp_path / "b.h5")
    assert Asset.load(tmp_path / "b.h5").thumbnail is None


def png(width: int, height: int, pixels: bytes) -> bytes:
    """A grey PNG that claims its size."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return len(data).to_bytes(4, "big") + name + data + zlib.crc32(name + data).to_bytes(4, "big")

    header = width.to_bytes(4, "big") + height.to_bytes(4, "big") + bytes([8, 0, 0, 0, 0])
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(pixels)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


def test_a_thumbnail_that_is_no_small_png_is_refused(tmp_path):
    good = thumbnail_of(picture()).tobytes()
    check_thumbnail(np.frombuffer(png(4, 3, bytes(15)), np.uint8), "here")
    bad = {
        "no PNG": b"GIF89a" + good[6:],
        "damaged": good[:-3],
        "is damaged": good[:300] + bytes([good[300] ^ 1]) + good[301:],
        "no whole": good[:33],
        "100000x3": png(100_000, 3, bytes(15)),
        "not 15 bytes": png(4, 3, bytes(10_000_000)),
        "not 15": png(4, 3, bytes(14)),
    }
    for message, content in bad.items():
        with pytest.raises(BadInput, match=f"here: .*{message}"):
            check_thumbnail(np.frombuffer(content, np.uint8), "here")
    small_asset(thumbnail=np.frombuffer(good, np.uint8)).save(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file["thumbnail"][300] ^= 1
    with pytest.raises(BadInput, match=r"a\.h5: the thumbnail is damaged"):
        Asset.load(tmp_path / "a.h5")
