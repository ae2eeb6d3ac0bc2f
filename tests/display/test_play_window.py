"""The ring toss in its real window under Xvfb: the mouse takes a ring, lifts it and throws it."""

import json
from pathlib import Path

import numpy as np
import pytest

from core.camera import look_at, perspective
from display.window.window import project
from scenes import ring_toss
from tests.support.watched import Watched
from tests.support.xvfb import NEEDS_XVFB, XServer

pytestmark = NEEDS_XVFB
TESTS = Path(__file__).resolve().parents[1]
WIDTH, HEIGHT = 400, 260
RED, YELLOW = 0, 1


class Play(Watched):
    """The running program and its log."""

    def __init__(self, screen: XServer, folder: Path):
        self.screen = screen
        super().__init__(folder, "--size", f"{WIDTH}x{HEIGHT}", env=screen.env)
        screen.wait_for_window("VR-GS: ring_toss", seconds=60)

    def after(self, count: int = 3) -> dict:
        """The state once a few more frames are on the screen."""
        number = len(self.frames()) + count
        return self.until(lambda _: len(self.frames()) > number)


@pytest.fixture(scope="module")
def play(tmp_path_factory):
    with XServer(640, 480) as screen:
        session = Play(screen, tmp_path_factory.mktemp("play"))
        yield session
        if session.process.poll() is None:
            session.process.kill()
        session.process.wait(10)


def on_screen(point) -> np.ndarray:
    scene = ring_toss.build()
    camera = perspective(WIDTH, HEIGHT, scene.fov_y, look_at(scene.eye, scene.target))
    return np.array(project(camera, np.asarray(point)))


def height(frame: dict, ring: int) -> float:
    return frame["bodies"][ring]["centroid"][1] - ring_toss.TABLE_TOP


def test_a_ring_is_grabbed_lifted_and_thrown(play):
    play.until(lambda f: f["time"] > 0.3, seconds=240)  # compiled, and settled on the table
    play.screen.key("F1")  # the panel would lie over the rings of so small a window
    start = play.after()
    assert 0 < height(start, YELLOW) < 0.03 and not any(b["held"] for b in start["bodies"])
    centre = np.array(start["bodies"][YELLOW]["centroid"])
    rim = on_screen(centre + [0.0, 0.0, ring_toss.RING_RADIUS + 0.004])
    before = play.screen.pixels()[:HEIGHT, :WIDTH].astype(int)
    assert yellow(before, rim), "the ring is not where it should be in the picture"

    play.screen.drag(rim, rim - [0, 70], seconds=1.5, release=False)
    held = play.until(lambda f: f["bodies"][YELLOW]["held"] and height(f, YELLOW) > 0.06)
    assert not held["bodies"][RED]["held"]
    play.after()
    lifted = play.screen.pixels()[:HEIGHT, :WIDTH].astype(int)
    assert not yellow(lifted, rim), "the picture still shows the ring where it lay"

    play.screen.drag(rim - [0, 70], rim - [60, 100], seconds=0.3)
    thrown = play.until(lambda f: not f["bodies"][YELLOW]["held"])
    rest = play.until(lambda f: f["time"] > thrown["time"] + 1.5, seconds=120)
    assert np.linalg.norm(np.subtract(rest["bodies"][YELLOW]["centroid"], centre)) > 0.05
    assert height(rest, YELLOW) > -ring_toss.TABLE_TOP  # on table, bottle or floor, not below
    assert np.linalg.norm(np.subtract(rest["bodies"][RED]["centroid"], start["bodies"][RED]["centroid"])) < 0.01


def test_reset_brings_the_rings_back_and_escape_quits(play):
    play.screen.key("r")
    play.until(lambda f: f["time"] < 0.5 and 0 < height(f, YELLOW) < 0.03)
    play.screen.key("p")  # the scene plays itself: it takes the red ring first
    play.until(lambda f: f["bodies"][RED]["held"] and height(f, RED) > 0.05)
    play.screen.key("p")
    play.until(lambda f: not f["bodies"][RED]["held"])
    play.screen.key("space")
    assert play.until(lambda f: f["paused"])
    play.screen.key("Escape")
    assert play.process.wait(60) == 0
    stats = json.loads(play.stats.read_text())
    assert stats["finite"] is True and stats["frames"] > 10 and stats["fps"] > 0


def yellow(pixels: np.ndarray, at) -> bool:
    """Is most of a patch around the pixel the ring's yellow?"""
    x, y = np.round(at).astype(int)
    patch = pixels[y - 1 : y + 2, x - 1 : x + 2].reshape(-1, 3)
    return (np.minimum(patch[:, 0], patch[:, 1]) > patch[:, 2] + 110).mean() > 0.5
