"""Pictures, timings and statistics of a display, without a window."""

import io
import json
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from assets.file_access import write_json
from core.camera import look_at, perspective
from core.errors import BadInput
from display.panel import frame_lines
from display.picture import fit, pixels_of, save_picture
from display.protocol import Frame
from display.timing import ProgressLine, Timings, run_stats
from tests.support.fake_world import FakeWorld, fake_scene

WIDTH, HEIGHT = 320, 180


# pictures


@pytest.mark.parametrize(
    "picture, frame, expected",
    [
        ((960, 540), (960, 540), (0, 0, 960, 540)),
        ((960, 540), (1920, 1080), (0, 0, 1920, 1080)),
        ((100, 100), (300, 200), (50, 0, 200, 200)),
        ((960, 540), (960, 800), (0, 130, 960, 540)),
    ],
)
def test_fit_keeps_the_aspect_and_centres(picture, frame, expected):
    assert fit(picture, frame) == expected


def test_pixels_are_rgba_with_the_top_row_first(ti_cpu):
    picture = ti_cpu.ndarray(ti_cpu.u32, (2, 3))
    values = np.arange(6, dtype=np.uint32).reshape(2, 3) + np.uint32(0x40302010)
    picture.from_numpy(values)
    pixels = pixels_of(picture)
    assert pixels.shape == (2, 3, 4)
    assert pixels[0, 0].tolist() == [0x10, 0x20, 0x30, 0x40]
    assert pixels[1, 2].tolist() == [0x15, 0x20, 0x30, 0x40]


def test_png_holds_the_same_colours_and_no_transparency(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 255, (7, 5, 4), np.uint8)
    save_picture(tmp_path / "p.png", pixels)
    read = cv2.imread(str(tmp_path / "p.png"), cv2.IMREAD_UNCHANGED)
    assert (read == pixels[..., 2::-1]).all() and read.shape[2] == 3
    assert [path.name for path in tmp_path.iterdir()] == ["p.png"]
    with pytest.raises(BadInput, match=r"nowhere does not exist"):
        save_picture(tmp_path / "nowhere" / "p.png", pixels)


# numbers


def test_timings_tell_the_first_run_apart():
    timings = Timings()
    for seconds in (5.0, 0.002, 0.001, 0.003):
        timings.add("render", seconds)
    timings.add("once", 0.5)
    assert timings.as_dict()["render"] == pytest.approx({"median_ms": 2.0, "worst_ms": 3.0, "first_ms": 5000.0})
    assert timings.as_dict()["once"] == pytest.approx({"median_ms": 500.0, "worst_ms": 500.0, "first_ms": 500.0})
    assert [row[0] for row in timings.recent()] == ["render", "once"]
    assert timings.latest("render", "once", "never") == pytest.approx(timings._samples["render"][-1] + 0.5)


def test_the_recent_frame_rate_is_that_of_the_last_second():
    timings = Timings()
    assert timings.recent_fps() == 0
    timings._frames.extend([0.5] * 20 + [0.01] * 100)
    assert timings.recent_fps() == pytest.approx(100)
    timings._frames.append(2.0)
    assert timings.recent_fps() == pytest.approx(0.5)


def test_a_stage_is_timed_and_frames_are_counted():
    timings = Timings(budget=0.01)
    for pause in (0.0, 0.02, 0.02):
        with timings.stage("nap"):
            time.sleep(pause)
        timings.frame()
    assert timings.as_dict()["nap"]["median_ms"] >= 20
    assert 5 < timings.fps < 50 and timings.missed == 2
    assert 0.02 <= timings.worst_stages["nap"] <= timings.worst
    timings.rest()
    time.sleep(0.05)
    timings.frame()
    assert timings.missed == 2  # the pause is not a missed frame


def test_a_display_that_knows_what_it_missed_is_believed():
    timings = Timings(budget=10.0)
    for missed in (5, 0, 2, 1):  # the first frame compiles
        timings.frame(missed)
    assert timings.missed == 3 and 0.0 < timings.worst < 1.0
    timings.worst, timings.worst_stages = 0.2, {"render": 0.02, "simulate": 0.15}
    assert frame_lines(timings) == ["longest frame 200 ms (simulate 150), 3 missed"]
    for seconds in (0.03, 0.02, 0.5):
        timings.photon.append(seconds)
    timings.frame(dropped=1.25)
    assert frame_lines(timings)[1:] == ["from motion to light 30 ms", "1.2 s left out: too slow for real time"]


def test_exact_timings_wait_for_the_device(ti_cpu, monkeypatch):
    calls = []
    monkeypatch.setattr(ti_cpu, "sync", lambda: calls.append(1))
    timings = Timings()
    with timings.stage("a"):
        pass
    timings.exact = True
    with timings.stage("a"):
        pass
    assert len(calls) == 1


def test_stats_are_written_whole_and_as_strict_json(tmp_path, ti_cpu):
    world = FakeWorld(fake_scene(), width=32, height=16)
    camera = perspective(32, 16, 0.9, look_at((0, 0, 3), (0, 0, 0)))
    for index in range(3):
        world.step(Frame(1 / 60, index / 60, [camera]))
        world.timings.frame()
    path = tmp_path / "stats.json"
    write_json(path, run_stats(world, 3) | {"odd": np.float32("nan"), "many": np.arange(2), "flag": np.bool_(True)})
    stats = json.loads(path.read_text())
    promised = "frames fps stages gaussians vertices tets substeps dt score finite peak_memory_mb"
    promised += " missed_frames worst_frame_ms worst_frame_stages_ms dropped_seconds"
    assert set(promised.split()) <= set(stats)
    assert stats["frames"] == 3 and stats["finite"] is True and stats["fps"] > 0
    assert {"median_ms", "worst_ms"} <= set(stats["stages"]["render"])
    assert stats["odd"] is None and stats["many"] == [0, 1] and stats["flag"] is True
    assert [p.name for p in tmp_path.iterdir()] == ["stats.json"]


@pytest.mark.parametrize(("tty", "count"), [(True, 10), (False, 1)])
def test_a_line_of_progress_is_renewed_on_a_terminal_and_rare_in_a_file(tty, count):
    out = io.StringIO()
    out.isatty = lambda: tty
    line = ProgressLine(out)
    for k in range(11):
        line.show(f"frame {k}", line.begin + 0.55 * k)
    line.end()
    text = out.getvalue()
    assert text.count("frame") == count and text.endswith("\r\033[K" if tty else "frame 10\n")


def test_what_needs_no_screen_imports_nothing_heavy_before_it_opens():
    """`python vrgs.py --headless` must run where there is no OpenGL."""
    heavy = ["glfw", "moderngl", "imgui_bundle", "cv2", "taichi"]
    code = (
        "import sys, display.web.browser, display.headless.video, display.window.gl_window\n"
        f"print([m for m in {heavy} if m in sys.modules])"
    )
    root = Path(__file__).resolve().parents[2]
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root)
    assert out.stdout.strip() == "[]"
