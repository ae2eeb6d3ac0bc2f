"""The ring toss in Chromium: a user takes a ring, lifts it and throws it, and opens another scene."""

import json
import os
import subprocess

import numpy as np
import pytest

from core.camera import look_at, perspective, project
from scenes import ring_toss
from tests.support.chromium import NEEDS_CHROMIUM, Chromium
from tests.support.watched import Watched

WIDTH, HEIGHT = 480, 270
YELLOW = 1


@pytest.mark.long
@NEEDS_CHROMIUM
def test_a_ring_is_thrown_and_another_scene_opened(tmp_path):
    env = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    options = ["--web", "--arch", "cpu", "--stats", "stats.json", "--record", "play.mp4"]
    play = Watched("watched_play.py", tmp_path, *options, env=env, patience=300, stdout=subprocess.PIPE, text=True)
    try:
        url = next(line for line in iter(play.process.stdout.readline, "") if line.startswith("Open ")).split()[1]
        with Chromium() as browser:
            page = browser.open(url, WIDTH, HEIGHT)
            start = play.until(lambda f: f["time"] > 0.3)
            page.until(f"state.editable && picture.width === {WIDTH}", 120)
            scene = ring_toss.build()
            camera = perspective(WIDTH, HEIGHT, scene.fov_y, look_at(scene.eye, scene.target))
            centre = np.array(start["bodies"][YELLOW]["centroid"])
            rim = np.array(project(camera, centre + [0.0, 0.0, ring_toss.RING_RADIUS + 0.004]))
            page.drag(rim, rim - [0, 60], seconds=1.5, release=False)
            play.until(lambda f: f["bodies"][YELLOW]["held"] and f["bodies"][YELLOW]["centroid"][1] > centre[1] + 0.05)
            reduced = page.screenshot(tmp_path / "reduced.png").astype(int)
            assert abs(reduced[:, 0] - reduced[:, 10]).mean() < 20  # no bar at the edge
            page.drag(rim - [0, 60], rim + [50, -90], seconds=0.4, press=False)
            play.until(lambda f: not f["bodies"][YELLOW]["held"])
            page.until("state.fps === null", 300)
            assert page.value("state['section Body'].label") == "ring yellow"
            page.value("send('open', 'sandbox', {})")
            play.until(lambda f: "toy_duck" in [b["name"] for b in f["bodies"]])
            page.until("hello.playing === 'sandbox' && !state.loading")
        play.process.terminate()
        assert play.process.wait(60) == 0
    finally:
        play.close()
    stats = json.loads((tmp_path / "stats.json").read_text())
    assert stats["finite"] and stats["web"]["frames_sent"] > 10 and stats["web"]["latency_ms"] > 0
    assert (tmp_path / "play.mp4").stat().st_size > 10_000
