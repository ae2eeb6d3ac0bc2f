"""The display in a browser as a program with the ball's world: first led by a plain socket, then by Chromium."""

import json
import os
import signal
import subprocess
import time

import numpy as np
import pytest

from tests.support.chromium import NEEDS_CHROMIUM, Chromium
from tests.support.fake_world import RED
from tests.support.page_client import PageClient
from tests.support.watched import Watched

MIDDLE = (0.5, 0.5)  # where the ball hangs


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    """The running program; `url` is the address that it prints."""
    folder = tmp_path_factory.mktemp("web")
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    ball = Watched("fake_world.py", folder, "--web", env=environment, stdout=subprocess.PIPE, text=True)
    lines = iter(ball.process.stdout.readline, "")
    ball.url = next(line for line in lines if line.startswith("Open ")).split()[1]
    yield ball
    ball.close()


def reset(ball, page) -> None:
    page.send("panel", "Play", "Reset", True, False)
    page.until(lambda: page.state.get("message") == "Throw the red ball.")
    ball.until(lambda f: f["ball"] == [0.0, 0.0, 0.0])


def test_there_are_no_frames_without_a_page_and_no_pictures_without_a_change(ball):
    with PageClient(ball.url) as page:
        page.send("size", 320, 180)
        page.until(lambda: page.pictures and page.pictures[-1][2].shape == (180, 320, 3))
        page.until(lambda: page.during(0.4) == 0)  # in full quality by now
        drawn, steps = ball.after(1)["pictures"], ball.frames()[-1]["steps"]
        assert page.during(0.3) == 0 and ball.frames()[-1]["pictures"] == drawn and ball.frames()[-1]["steps"] > steps
        red = page.pictures[-1][2][90, 160, ::-1].astype(int)
        assert red[0] > red[1] + 60 and red[0] > red[2] + 60
        page.send("hidden", True)
        time.sleep(0.3)
        steps = len(ball.frames())
        time.sleep(0.3)
        assert len(ball.frames()) <= steps + 1
        page.send("hidden", False)
        ball.after(2)
    time.sleep(0.3)
    steps = len(ball.frames())
    time.sleep(0.3)
    assert len(ball.frames()) == steps


def test_a_drag_grabs_and_throws_and_keys_act_as_in_the_window(ball):
    with PageClient(ball.url) as page:
        page.send("size", 320, 180)
        page.send("key", "KeyK", "k", True, False, 0)  # a window asks for two points, a page does not
        page.send("button", "left", True, *MIDDLE, 1)
        page.until(lambda: page.state.get("grabbing"))
        held = ball.until(lambda f: f["held"])
        begin = time.monotonic()
        while (past := time.monotonic() - begin) < 0.4:
            page.send("move", 0.5 + 0.4 * past, 0.5, 1 + past)
            page.take(0.02)
        page.send("button", "left", False, 0.66, 0.5, 2)
        thrown = ball.until(lambda f: not f["held"] and f["speed"] > 0.2)
        assert thrown["ball"][0] > 0.1 and held["eye"] == thrown["eye"]
        page.until(lambda: page.state["message"] == "Well thrown!")
        reset(ball, page)
        page.send("key", "Space", " ", True, False, 3)
        ball.until(lambda f: f["paused"])
        page.until(lambda: "Resume" in json.dumps(page.state["section Play"]))
        page.send("key", "Escape", "Escape", True, False, 3)  # a page does not end the program
        page.send("panel", "Play", "Pause", True, False)
        ball.until(lambda f: not f["paused"])
        assert any(header["stamp"] is not None for header, *_ in page.pictures)


def test_the_camera_turns_walks_and_zooms(ball):
    with PageClient(ball.url) as page:
        page.send("size", 320, 180)
        start = ball.after()
        page.send("button", "left", True, 0.1, 0.1, 1)  # beside the ball
        page.send("move", 0.2, 0.1, 2)
        page.send("button", "left", False, 0.2, 0.1, 3)
        turned = ball.until(lambda f: abs(f["eye"][0] - start["eye"][0]) > 0.1)
        assert np.isclose(np.linalg.norm(turned["eye"]), 3.0)
        page.send("pinch", 3, 0, 0, 4)
        ball.until(lambda f: np.isclose(np.linalg.norm(f["eye"]), 3.0 * 0.9**3))
        page.send("key", "KeyW", "w", True, False, 5)
        ball.until(lambda f: np.linalg.norm(f["eye"]) < 1.5)
        page.send("blur")  # its release never comes
        page.send("key", "Home", "Home", True, False, 6)
        ball.until(lambda f: f["eye"] == start["eye"])
        assert ball.after(5)["eye"] == start["eye"]


def test_a_tab_that_closes_lets_go_and_the_next_one_plays(ball):
    with PageClient(ball.url) as first:
        first.until(lambda: first.state.get("role") == "play")
        with PageClient(ball.url) as second:
            second.until(lambda: second.state.get("role") == "watch")
            first.send("button", "left", True, *MIDDLE, 1)
            ball.until(lambda f: f["held"])
            second.send("button", "left", False, *MIDDLE, 1)  # not its to let go
            second.send("panel", "Play", "Pause", True, False)
            assert ball.after(5)["held"] and not ball.frames()[-1]["paused"]
            second.send("take")
            ball.until(lambda f: not f["held"])
            second.until(lambda: second.state["role"] == "play")
            reset(ball, second)
            second.send("button", "left", True, *MIDDLE, 1)
            ball.until(lambda f: f["held"])
        ball.until(lambda f: not f["held"])
        first.until(lambda: first.state["role"] == "play")
        reset(ball, first)


@NEEDS_CHROMIUM
def test_a_user_of_a_browser_plays_and_another_one_watches(ball, tmp_path):
    with Chromium() as browser:
        page = browser.open(ball.url, 960, 540)
        page.until("state.editable && picture.width === 960")
        assert np.abs(page.screenshot(tmp_path / "page.png")[270, 480].astype(int) - RED).max() < 90
        assert (
            not page.value("get('panel').hidden") and page.value("get('message').textContent") == "Throw the red ball."
        )

        page.drag((480, 270), (560, 220), release=False)
        page.until("state.grabbing")
        held = ball.until(lambda f: f["held"] and f["ball"][0] > 0.1)
        page.drag((560, 220), (700, 200), press=False, seconds=0.2)
        ball.until(lambda f: not f["held"] and f["ball"][0] > held["ball"][0])
        page.until("get('message').textContent === 'Well thrown!'")
        page.click("document.querySelector('[data-name=Reset]')")
        ball.until(lambda f: f["ball"] == [0.0, 0.0, 0.0])
        page.click("document.querySelector('[data-name=Transform]')")
        assert ball.until(lambda f: f["interaction"] == "transform")
        page.key("t", "KeyT")
        ball.until(lambda f: f["interaction"] == "physics")
        page.key("F1", "F1")
        page.until("get('panel').hidden")
        page.key("h", "KeyH")
        page.until("!get('panel').hidden && get('keys').open")
        page.key("F2", "F2")
        page.until("get('menu-of-scenes').open && get('scene-list').children.length >= 8")
        page.click("get('close-scenes')")
        page.until("!get('menu-of-scenes').open")

        phone = browser.open(ball.url, 390, 844, scale=2, touch=True)
        phone.until("state.role === 'watch' && picture.width > 100")
        assert phone.value("get('controls').disabled") is True
        phone.click("get('take')")
        page.until("!get('role').hidden")
        ball.until(lambda f: f["size"][0] < f["size"][1])  # the phone's shape
        phone.touch("Start", (195, 422))
        phone.touch("Move", (215, 422))
        phone.until("state.grabbing")
        phone.touch("End")
        ball.until(lambda f: not f["held"])
        phone.touch("Start", (100, 700), (300, 700))
        phone.touch("Move", (50, 700), (350, 700))
        phone.touch("End")
        ball.until(lambda f: f["eye"][2] < 2.9)
        phone.close()
        page.until("state.role === 'play'")


def test_an_interrupt_ends_the_play_with_its_files(ball):
    with PageClient(ball.url) as page:
        page.until(lambda: page.pictures)
        for _ in range(2):  # as from the terminal and from a launcher
            ball.process.send_signal(signal.SIGINT)
            time.sleep(0.01)
        assert ball.process.wait(30) == 0
    stats = json.loads(ball.process.stdout.read())["web"]
    assert stats["frames_sent"] > 20 and stats["bytes_sent"] > 1000 * stats["frames_sent"] and stats["pages"] >= 5
    assert stats["latency_samples"] > 3
