"""Teleport of bare hands: the left one pinches at nothing and points at the floor."""

from types import SimpleNamespace as N

import numpy as np
import pytest
from numpy.testing import assert_allclose

from display.xr.actions import Controller
from display.xr.hand_joints import RELAXED, posed, rotation_about
from display.xr.hand_tracking import HandGestures
from display.xr.player import Player
from display.xr.poses import pose_matrix
from scenes import ring_toss
from tests.support.fake_view import FakeView

PINCH = (0.7, 0.6, 0.2, 0.2, 0.2)
HEAD = pose_matrix((0.0, 1.6, 0.0), np.eye(3))
PLACE = np.array([-0.15, 1.1, -0.35])


def pointing(pitch):
    return pose_matrix(PLACE, rotation_about((1, 0, 0), pitch))


def hand(bends, pitch=-0.5):
    """A left hand that points up by `pitch` [rad]."""
    return posed(bends, left=True).transformed(pointing(pitch))


class Play:
    def __init__(self, bodies=()):
        self.player, self.gestures = Player(ring_toss.build()), HandGestures()
        self.world = FakeView(bodies=lambda: list(bodies))

    def frame(self, joints, right=None):
        """Grip of each hand, and the place that is aimed at, (3,) [m] or None."""
        left = joints if isinstance(joints, Controller) else self.gestures.read(joints)
        hands, _ = self.player.advance([left, right or Controller()], HEAD, self.world)
        target = None if self.player.pointing is None else self.player.pointing[1]
        return [h.grip for h in hands], target

    def feet(self):
        return (self.player.play_space.world_from_play @ HEAD)[[0, 2], 3]


def test_a_pinch_at_nothing_shows_a_place_on_the_floor_and_opened_goes_there():
    play = Play()
    start = play.feet()
    assert play.frame(hand(RELAXED)) == ([False, False], None)
    grips, target = play.frame(hand(PINCH))
    assert not any(grips) and target is not None and target[1] == pytest.approx(0.0)
    _, other = play.frame(hand(PINCH, pitch=-0.7))
    assert np.linalg.norm(other[[0, 2]] - start) < np.linalg.norm(target[[0, 2]] - start)  # farther down is nearer
    assert_allclose(play.feet(), start)
    assert play.frame(hand(RELAXED, pitch=-0.7)) == ([False, False], None)
    assert_allclose(play.feet(), other[[0, 2]], atol=1e-9)
    assert play.frame(hand(RELAXED)) == ([False, False], None)


def test_pointed_elsewhere_or_lost_nobody_goes():
    for last in (hand(PINCH, pitch=0.4), None):
        play = Play()
        start = play.feet()
        assert play.frame(hand(PINCH))[1] is not None
        assert play.frame(last)[1] is None
        play.frame(None if last is None else hand(RELAXED, pitch=0.4))
        play.frame(hand(RELAXED))
        assert_allclose(play.feet(), start)


def test_a_pinch_that_was_begun_ahead_or_at_a_body_is_no_teleport():
    play = Play()
    assert play.frame(hand(PINCH, pitch=0.2)) == ([True, False], None)
    assert play.frame(hand(PINCH)) == ([True, False], None)  # it goes on as what it was
    joints = hand(PINCH)
    tip = (play.player.play_space.world_from_play @ [*joints.pinch_point(), 1.0])[:3]
    low, high = tip + [0.0, -0.2, 0.0], tip + [0.2, -0.02, 0.2]
    assert Play([N(low=low, high=high)]).frame(joints) == ([True, False], None)
    assert Play([N(low=low + 0.5, high=high + 0.5)]).frame(joints)[1] is not None


def test_the_right_hand_and_controllers_do_not_teleport_by_pinching():
    right = HandGestures().read(posed(PINCH).transformed(pointing(-0.5)))
    assert Play().frame(Controller(), right) == ([False, True], None)
    held = Controller(grip=np.eye(4), aim=pointing(-0.5), pinch=1.0)
    assert Play().frame(held) == ([True, False], None)
