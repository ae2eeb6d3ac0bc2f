"""Bare hands and poking fingers in a real OpenXR runtime: a pinch lifts a ring, two stretch it, a touch is felt.

Needs Monado (`tests/support/monado.sh` builds it once) and an X server. Its remote driver makes up 26 joints for each hand.
"""

import time

import numpy as np
import pytest

from display.xr.hand_tracking import HANDOVER
from scenes import ring_toss
from tests.display.test_headset_play import WHY, YELLOW, Play
from tests.support.remote_headset import monado, surroundings
from tests.support.xvfb import NEEDS_XVFB, XServer

pytestmark = [*NEEDS_XVFB, pytest.mark.skipif(monado() is None, reason=WHY)]
OPEN, PINCH = (0.0,) * 5, (0.0, 0.0, 0.0, 1.0, 1.0)  # the driver's order: the little finger first
LEFT_TIP, RIGHT_TIP = np.array([0.02, -0.034, -0.064]), np.array([-0.02, -0.034, -0.064])  # pinched, from the wrist


@pytest.fixture(scope="module")
def play(tmp_path_factory):
    with XServer(1600, 900) as screen, surroundings() as environment:
        session = Play(screen, tmp_path_factory.mktemp("hands"), environment)
        yield session
        if session.process.poll() is None:
            session.process.kill()
        session.process.wait(10)


def ring(play, condition=lambda f: True, **how):
    frame = play.until(condition, **how)
    return np.array(frame["bodies"][YELLOW]["centroid"]), frame


def test_a_touch_with_the_poking_finger_pushes_and_is_felt(play):
    """The trigger half pulled: a finger 9 cm ahead of the hand. Nothing is gripped."""
    at, _ = ring(play, lambda f: f["time"] > 0.3, seconds=300)
    hand = play.player.right
    beside = play.in_play_space(at + [0.0, 0.0, ring_toss.RING_RADIUS + 0.15])
    hand.trigger = 0.3
    play.move(hand, beside, seconds=0.5)
    assert "MONADO_HAPTIC" not in play.errors.read_text()
    play.move(hand, np.add(beside, [0.0, 0.0, -0.12]), seconds=2.0, steps=40)
    frame = play.until(lambda f: f["bodies"][YELLOW]["centroid"][2] < at[2] - 0.02)
    assert not any(b["held"] for b in frame["bodies"])
    assert "MONADO_HAPTIC right" in play.errors.read_text()
    assert "MONADO_HAPTIC left" not in play.errors.read_text()
    hand.trigger = 0.0
    play.move(hand, np.add(beside, [0.0, 0.3, 0.1]), seconds=0.5)


def test_bare_hands_pinch_a_ring_lift_it_and_stretch_it(play):
    left, right = play.player.left, play.player.right
    left.tracked_hand = right.tracked_hand = True
    play.player.send()
    time.sleep(HANDOVER)  # the controller was used; now the hand takes over
    at, frame = ring(play)
    width = max(frame["bodies"][YELLOW]["size"])
    grips = []
    for hand, side, tip in ((right, 1, RIGHT_TIP), (left, -1, LEFT_TIP)):
        rim = play.in_play_space(at + [side * ring_toss.RING_RADIUS, 0.0, 0.0])
        grips.append((hand, side, np.subtract(rim, tip)))
    for hand, side, wrist in grips:
        play.move(hand, wrist + [side * 0.05, 0.1, 0.0], seconds=0.3)
        play.move(hand, wrist, seconds=0.5)
        hand.curl = PINCH
        play.player.send()
        play.until(lambda f, h=int(side > 0): f["hands"][h]["grip"] and f["bodies"][YELLOW]["held"])
    for k in range(1, 31):
        for hand, side, wrist in grips:
            hand.position = tuple(wrist + [side * 0.002 * max(k - 15, 0), 0.01 * min(k, 15), 0.0])
        play.player.send()
        time.sleep(0.07)
    lifted = play.until(lambda f: max(f["bodies"][YELLOW]["size"]) > width + 0.035)
    assert lifted["bodies"][YELLOW]["centroid"][1] > at[1] + 0.1
    assert sum(b["held"] for b in lifted["bodies"]) == 1
    left.curl = right.curl = OPEN
    play.player.send()
    free = play.until(lambda f: not any(b["held"] for b in f["bodies"]))
    rest = play.until(lambda f: f["time"] > free["time"] + 0.7)
    assert all(np.isfinite(b["centroid"]).all() for b in rest["bodies"])
    assert max(rest["bodies"][YELLOW]["size"]) < width + 0.03
