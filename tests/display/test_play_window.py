"""The ring toss in its real window under Xvfb: the mouse takes a ring, lifts it and throws it."""

import json

import numpy as np

from core.camera import look_at, perspective, project
from display.study.study_file import read_study
from scenes import ring_toss
from tests.support.watched import Watched
from tests.support.xvfb import NEEDS_XVFB, XServer

pytestmark = NEEDS_XVFB
WIDTH, HEIGHT = 400, 260
RED, YELLOW = 0, 1


def on_screen(point) -> np.ndarray:
    scene = ring_toss.build()
    camera = perspective(WIDTH, HEIGHT, scene.fov_y, look_at(scene.eye, scene.target))
    return np.array(project(camera, np.asarray(point)))


def centre(frame: dict, ring: int) -> np.ndarray:
    return np.array(frame["bodies"][ring]["centroid"])


def height(frame: dict, ring: int) -> float:
    return centre(frame, ring)[1] - ring_toss.TABLE_TOP


def test_a_ring_is_grabbed_lifted_and_thrown_and_all_is_reset(tmp_path):
    options = ["--scene", "ring_toss", "--arch", "cpu", "--size", f"{WIDTH}x{HEIGHT}", "--stats", "stats.json"]
    options += ["--study", "study.h5", "--participant", "Ida"]
    with XServer(640, 480) as screen:
        play = Watched("watched_play.py", tmp_path, *options, env=screen.env)
        try:
            screen.wait_for_window("VR-GS: ring_toss", seconds=60)
            throw(play, screen)
            reset_and_quit(play, screen)
        finally:
            play.close()
    stats = json.loads((tmp_path / "stats.json").read_text())
    assert stats["finite"] is True and stats["frames"] > 10 and stats["fps"] > 0
    trial = read_study(tmp_path / "study.h5").trials[0]  # until the reset
    assert (trial.participant, trial.task, trial.setting, trial.device) == ("Ida", "ring_toss", "physics", "window")
    assert trial.grips == 1 and 0.05 < trial.body_path < 2.0 and trial.first_grip < trial.seconds


def throw(play, screen) -> None:
    def shows_yellow(at) -> bool:
        """True if most of a patch of the screen around a pixel is the ring's yellow."""
        x, y = np.round(at).astype(int)
        patch = screen.pixels()[y - 1 : y + 2, x - 1 : x + 2].reshape(-1, 3).astype(int)
        return bool((np.minimum(patch[:, 0], patch[:, 1]) > patch[:, 2] + 110).mean() > 0.5)

    play.until(lambda f: f["time"] > 0.3, seconds=240)  # compiled, and settled on the table
    screen.key("F1")  # the panel would lie over the rings in so small a window
    start = play.after()
    assert 0 < height(start, YELLOW) < 0.03 and not any(b["held"] for b in start["bodies"])
    rim = on_screen(centre(start, YELLOW) + [0.0, 0.0, ring_toss.RING_RADIUS + 0.004])
    play.eventually(lambda: shows_yellow(rim))

    screen.drag(rim, rim - [0, 70], seconds=1.5, release=False)
    held = play.until(lambda f: f["bodies"][YELLOW]["held"] and height(f, YELLOW) > 0.06)
    assert not held["bodies"][RED]["held"]
    play.eventually(lambda: not shows_yellow(rim))  # where it lay

    screen.drag(rim - [0, 70], rim - [60, 100], seconds=0.3)
    thrown = play.until(lambda f: not f["bodies"][YELLOW]["held"])
    rest = play.until(lambda f: f["time"] > thrown["time"] + 1.5)
    assert np.linalg.norm(centre(rest, YELLOW) - centre(start, YELLOW)) > 0.05
    assert height(rest, YELLOW) > -ring_toss.TABLE_TOP  # on table, bottle or floor, not below
    assert np.linalg.norm(centre(rest, RED) - centre(start, RED)) < 0.01


def reset_and_quit(play, screen) -> None:
    screen.key("r")
    play.until(lambda f: f["time"] < 0.5 and 0 < height(f, YELLOW) < 0.03)
    screen.key("p")  # the scene plays itself: it takes the red ring first
    play.until(lambda f: f["bodies"][RED]["held"] and height(f, RED) > 0.05)
    screen.key("p")
    play.until(lambda f: not f["bodies"][RED]["held"])
    screen.key("space")
    assert play.until(lambda f: f["paused"])
    screen.key("Escape")
    assert play.process.wait(60) == 0
