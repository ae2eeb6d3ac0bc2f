"""A scripted player in a real OpenXR runtime: looks round, takes a ring, lifts it, throws it; the runtime goes away.

Needs Monado (`tests/support/monado.sh` builds it once) and an X server; software OpenGL does.
"""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from core.rotation import quaternions_from_matrices
from display.record.replay import Replay
from display.xr.poses import PlaySpace
from display.xr.wrist_panel import BUTTONS, panel_pose, point_on_panel
from scenes import ring_toss
from tests.support.remote_headset import PORT, Player, monado, surroundings
from tests.support.watched import Watched
from tests.support.xvfb import NEEDS_XVFB, XServer

TESTS = Path(__file__).resolve().parents[1]
WHY = "no OpenXR runtime to play in: build it with `sh tests/support/monado.sh`"
pytestmark = [*NEEDS_XVFB, pytest.mark.skipif(monado() is None, reason=WHY)]
RED, YELLOW = 0, 1


class Play(Watched):
    """The program in a headset, its log, and the player who wears it."""

    def __init__(self, screen: XServer, folder: Path, environment: dict, *options: str):
        self.screen, self.errors = screen, folder / "errors.txt"
        with open(self.errors, "w") as errors:
            super().__init__(folder, "--xr", *options, env={**screen.env, **environment}, stderr=errors)
        self.player = Player(int(environment[PORT]))
        self.player.send()
        scene = ring_toss.build()
        self.world_from_play = PlaySpace.of(scene).world_from_play

    def until(self, condition, *, seconds: float = 120.0) -> dict:
        """The first frame from now on that meets the condition: a headset's takes longer."""
        return super().until(condition, seconds=seconds)

    def in_play_space(self, point) -> tuple[float, ...]:
        """Where a point of the world is for the player [m]."""
        return tuple((np.linalg.inv(self.world_from_play) @ [*point, 1.0])[:3].tolist())

    def move(self, controller, to, *, seconds: float = 1.0, steps: int = 20) -> None:
        """Move a controller evenly to a point of the play space."""
        start, to = np.array(controller.position), np.array(to)
        for k in range(1, steps + 1):
            controller.position = tuple((start + (to - start) * k / steps).tolist())
            self.player.send()
            time.sleep(seconds / steps)

    def in_world(self, point) -> np.ndarray:
        """Where a point of the play space is in the world [m]."""
        return (self.world_from_play @ [*point, 1.0])[:3]

    def rest(self, frames: int = 2) -> None:
        """Let some frames pass."""
        after = len(self.frames()) + frames
        self.until(lambda f: len(self.frames()) >= after)


@pytest.fixture(scope="module")
def play(tmp_path_factory):
    with XServer(1600, 900) as screen, surroundings() as environment:
        folder = tmp_path_factory.mktemp("headset")
        session = Play(screen, folder, environment, "--record-input", str(folder / "play.h5"))
        yield session
        if session.process.poll() is None:
            session.process.kill()
        session.process.wait(10)


def test_a_ring_is_taken_lifted_and_thrown(play):
    start = play.until(lambda f: f["time"] > 0.3, seconds=300)  # compiled, and settled on the table
    ring = np.array(start["bodies"][YELLOW]["centroid"])
    assert 0 < ring[1] - ring_toss.TABLE_TOP < 0.03 and not start["bodies"][YELLOW]["held"]
    hand, rim = play.player.right, play.in_play_space(ring + [0.0, 0.0, ring_toss.RING_RADIUS])
    play.move(hand, rim, seconds=0.5)
    at = play.until(lambda f: np.linalg.norm(np.subtract(f["hands"][1]["position"], ring)) < 0.1)
    assert not at["hands"][1]["grip"]
    hand.squeeze = 1.0
    play.player.send()
    play.until(lambda f: f["bodies"][YELLOW]["held"])
    play.move(hand, np.add(rim, [0.0, 0.25, 0.0]))
    play.until(lambda f: f["bodies"][YELLOW]["centroid"][1] > ring[1] + 0.15)
    assert "MONADO_HAPTIC right" in play.errors.read_text()
    assert "MONADO_HAPTIC left" not in play.errors.read_text()

    play.move(hand, np.add(rim, [0.0, 0.3, -0.3]), seconds=2.0)  # slow machines draw few frames: no flick of the wrist
    play.until(lambda f: np.linalg.norm(np.subtract(f["bodies"][YELLOW]["centroid"], ring)) > 0.3)
    hand.squeeze = 0.0
    play.player.send()
    thrown = play.until(lambda f: not f["bodies"][YELLOW]["held"])
    rest = play.until(lambda f: f["time"] > thrown["time"] + 1.0)
    assert np.linalg.norm(np.subtract(rest["bodies"][YELLOW]["centroid"], ring)) > 0.1
    assert all(np.isfinite(b["centroid"]).all() for b in rest["bodies"])


def test_both_eyes_see_the_room_and_turn_with_the_head(play):
    """Monado's window shows the two views side by side in its top left corner, and the ring toss is a bright room."""
    play.player.rotation = (0.0, 0.0, 0.0, 1.0)
    play.player.send()
    time.sleep(2.0)
    ahead = compositor(play.screen)
    assert all(np.ptp(eye.astype(int), axis=(0, 1)).min() > 100 for eye in ahead)
    difference = [np.abs(ahead[0].astype(int) - np.roll(ahead[1], s, 1).astype(int)).mean() for s in (0, 10)]
    assert 0 < min(difference) < 60  # not the same picture, but of the same room
    play.player.rotation = (0.0, np.sin(0.6), 0.0, np.cos(0.6))
    play.player.send()
    play.until(lambda f: f["time"] > 0)
    time.sleep(2.0)
    aside = compositor(play.screen)
    assert np.abs(aside[0].astype(int) - ahead[0]).mean() > 10


def test_buttons_change_the_interaction_and_take_the_throw_back(play):
    play.player.rotation = (0.0, 0.0, 0.0, 1.0)
    press(play, play.player.left, "b_click", lambda f: f["interaction"] == "transform")
    press(play, play.player.left, "b_click", lambda f: f["interaction"] == "physics")
    x, _, z = np.array(ring_toss.build().bodies[2 + YELLOW].position)

    def away(frame):
        return np.hypot(place(frame, YELLOW)[0] - x, place(frame, YELLOW)[2] - z)

    assert away(play.frames()[-1]) > 0.1
    press(play, play.player.right, "b_click", lambda f: away(f) < 0.02)
    press(play, play.player.right, "a_click", lambda f: away(f) > 0.1)


def test_the_panel_over_the_left_hand_is_seen_and_pressed_by_the_ray(play):
    left, right = play.player.left, play.player.right
    left.position, left.rotation = (-0.05, 1.15, -0.45), (0.0, 0.0, 0.0, 1.0)
    right.position, right.rotation, right.trigger = (0.4, 1.1, 0.3), (0.0, 0.0, 0.0, 1.0), 0.0
    play.player.send()
    play.until(lambda f: f["time"] > 0.1, seconds=300)
    play.rest()
    before = orange(play)
    left.pressed = {"a_click"}
    play.player.send()
    play.until(lambda f: orange(play) > before + 100)  # "Physics" is lit
    left.pressed = set()
    play.player.send()
    play.rest()
    assert orange(play) > before + 100
    rim = np.add(place(play.frames()[-1], RED), [0.0, 0.4, ring_toss.RING_RADIUS])
    right.position, right.rotation = play.in_play_space(rim), (-np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))  # straight down
    play.player.send()
    play.rest()
    pull(play, lambda f: "select" in f["commands"])
    point(play, "copy")
    pull(play, lambda f: len(f["bodies"]) == 4)
    copied = play.frames()[-1]["bodies"]
    assert copied[3]["name"] == copied[RED]["name"] and not any(b["held"] for b in copied)
    point(play, "undo")
    pull(play, lambda f: len(f["bodies"]) == 3)

    point(play, "light")
    before = play.frames()[-1]["light"]
    right.trigger = 1.0
    play.player.send()
    play.until(lambda f: f["light"] != before)
    play.move(right, (0.2, 1.5, -0.3), seconds=0.5, steps=5)
    there = play.in_world((0.2, 1.5, -0.3))
    lit = play.until(lambda f: np.linalg.norm(np.subtract(f["light"], there)) < 0.1)
    assert not any(b["held"] for b in lit["bodies"])
    right.trigger = 0.0
    play.player.send()
    play.rest()
    play.move(right, (0.4, 1.1, 0.3), seconds=0.5, steps=5)
    play.rest()
    assert np.linalg.norm(np.subtract(play.frames()[-1]["light"], there)) < 0.1


def test_closing_the_mirror_ends_the_play_and_writes_its_numbers(play):
    play.screen.close_window(play.screen.wait_for_window("VR-GS: ring_toss"))
    assert play.process.wait(60) == 0
    numbers = json.loads(play.stats.read_text())
    assert numbers["frames"] == len(play.frames()) and numbers["finite"] is True
    assert 0 < numbers["motion_to_photon_ms"] < 10_000 and numbers["missed_frames"] >= 0
    assert "SESSION_NOT_RUNNING" not in play.errors.read_text()
    recorded = Replay.load(play.stats.with_name("play.h5"))
    assert len(recorded) == numbers["frames"] and recorded.about["arch"] == "cpu"
    seen = [len(f.cameras) for f in recorded._frames]
    assert set(seen) <= {0, 2} and max(seen) == 2
    assert [[h.grip for h in f.hands] for f in recorded._frames] == [
        [h["grip"] for h in frame["hands"]] for frame in play.frames()
    ]


def place(frame: dict, body: int) -> list[float]:
    """Where a body is [m]."""
    return frame["bodies"][body]["centroid"]


def orange(play) -> int:
    """Pixels of the panel's accent in what the left eye sees."""
    eye = compositor(play.screen)[0].astype(int)
    red, green, blue = (eye[..., k] for k in range(3))
    return int(((abs(red - 250) < 12) & (abs(green - 168) < 16) & (abs(blue - 61) < 25)).sum())


def point(play, name: str) -> None:
    """Let the right hand point at a button of the panel, from before it."""
    left, right = play.player.left, play.player.right
    hand, head = np.eye(4), np.eye(4)
    hand[:3, 3], head[:3, 3] = left.position, play.player.position
    panel = panel_pose(hand, head)
    x, y, w, h = next(b.box for b in BUTTONS if b.name == name)
    right.position = tuple(point_on_panel(panel, x + w / 2, y + h / 2, 0.15).tolist())
    w, x, y, z = quaternions_from_matrices(panel[:3, :3])
    right.rotation = (x, y, z, w)
    play.player.send()
    play.rest()


def pull(play, effect) -> None:
    """Hold the right trigger until a frame shows its effect, then let go."""
    play.player.right.trigger = 1.0
    play.player.send()
    play.until(effect)
    play.player.right.trigger = 0.0
    play.player.send()
    play.rest()


def press(play, controller, button: str, effect) -> None:
    """Hold a button down until a frame shows its effect, then let go for two frames."""
    controller.pressed = {button}
    play.player.send()
    play.until(effect)
    controller.pressed = set()
    play.player.send()
    play.rest()


def compositor(screen) -> list[np.ndarray]:
    """Left and right half of Monado's window, 960x540 at the origin."""
    pixels = screen.pixels()[:540, :960]
    return [pixels[:, :480], pixels[:, 480:]]


def test_without_a_screen_the_headset_still_plays(tmp_path):
    """EGL instead of a window, Monado's compositor without one; nobody's controllers move."""
    with surroundings() as environment:
        environment = {**os.environ, **environment, "XRT_COMPOSITOR_NULL": "1", "LIBGL_ALWAYS_SOFTWARE": "1"}
        environment.pop("DISPLAY", None)
        stats = tmp_path / "stats.json"
        words = [sys.executable, TESTS.parent / "vrgs.py", "--xr", "--arch", "cpu", "--frames", "4", "--stats", stats]
        done = subprocess.run([str(w) for w in words], env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    numbers = json.loads(stats.read_text())
    assert numbers["frames"] == 4 and numbers["finite"] is True and "render" in numbers["stages"]
