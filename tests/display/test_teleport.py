"""Going with bare hands: the left one pinches at nothing and points at the floor."""

from types import SimpleNamespace as N

import numpy as np
import pytest
from numpy.testing import assert_allclose

from display.xr import hand_joints as J
from display.xr.actions import Controller
from display.xr.hand_joints import HandInput
from display.xr.hand_skeleton import RELAXED, about, posed
from display.xr.player import Player
from display.xr.teleport import on_the_floor
from scenes import ring_toss

PINCH = (0.7, 0.6, 0.2, 0.2, 0.2)
HEAD = J.pose_of(np.array([0.0, 1.6, 0.0]), np.eye(3))
PLACE = np.array([-0.15, 1.1, -0.35])


def hand(pose, pitch=-0.5, place=PLACE):
    """A left hand that points down by `pitch` [rad], or None."""
    return None if pose is None else posed(pose, left=True, frame=J.pose_of(np.array(place), about((1, 0, 0), pitch)))


class Play:
    def __init__(self, bodies=()):
        self.player, self.input = Player(ring_toss.build()), HandInput()
        self.world = N(interaction="physics", bodies=lambda: list(bodies))

    def frame(self, joints):
        """Whether the left hand grips, and where the spot is, (3,) [m] or None."""
        left = self.input.read(joints)
        hands, _ = self.player.advance([left, Controller()], HEAD, self.world)
        return hands[0].grip, None if self.player.pointing is None else self.player.pointing[1]

    def feet(self):
        return (self.player.standpoint.matrix @ HEAD)[[0, 2], 3]


def test_a_pinch_at_nothing_shows_a_spot_on_the_floor_and_opened_goes_there():
    play = Play()
    start = play.feet()
    assert play.frame(hand(RELAXED)) == (False, None)
    grip, spot = play.frame(hand(PINCH))
    assert not grip and spot is not None and spot[1] == pytest.approx(0.0)
    _, other = play.frame(hand(PINCH, pitch=-0.7))
    assert np.linalg.norm(other[[0, 2]] - start) < np.linalg.norm(spot[[0, 2]] - start)  # farther down is nearer
    assert_allclose(play.feet(), start)
    assert play.frame(hand(RELAXED, pitch=-0.7)) == (False, None)
    assert_allclose(play.feet(), other[[0, 2]], atol=1e-9)
    assert play.frame(hand(RELAXED)) == (False, None)


def test_pointed_elsewhere_or_lost_nobody_goes():
    for last in (hand(PINCH, pitch=0.4), None):
        play = Play()
        start = play.feet()
        assert play.frame(hand(PINCH))[1] is not None
        assert play.frame(last)[1] is None
        play.frame(None if last is None else hand(RELAXED, pitch=0.4))
        play.frame(hand(RELAXED))
        assert_allclose(play.feet(), start)


def test_a_pinch_that_was_begun_ahead_or_at_a_body_is_no_step():
    play = Play()
    assert play.frame(hand(PINCH, pitch=0.2)) == (True, None)
    assert play.frame(hand(PINCH)) == (True, None)  # it goes on as what it was
    joints = hand(PINCH)
    tip = (play.player.standpoint.matrix @ [*joints.position[[J.THUMB_TIP, J.INDEX_TIP]].mean(0), 1.0])[:3]
    body = N(low=tip + [0.0, -0.2, 0.0], high=tip + [0.2, -0.02, 0.2])
    near = Play([body])
    assert near.frame(joints) == (True, None)
    far = Play([N(low=body.low + 0.5, high=body.high + 0.5)])
    assert far.frame(joints)[1] is not None


def test_the_right_hand_and_controllers_do_not_stride():
    play = Play()
    right = HandInput().read(posed(PINCH, frame=J.pose_of(PLACE, about((1, 0, 0), -0.5))))
    hands, _ = play.player.advance([Controller(), right], HEAD, play.world)
    assert hands[1].grip and play.player.pointing is None
    held = Controller(grip=np.eye(4), aim=J.pose_of(PLACE, about((1, 0, 0), -0.5)), pinch=1.0)
    hands, _ = play.player.advance([held, Controller()], HEAD, play.world)
    assert hands[0].grip and play.player.pointing is None


def test_the_spot_is_where_the_hand_points():
    aim = J.pose_of(np.array([0.0, 1.0, 0.0]), about((1, 0, 0), -np.pi / 4))
    assert_allclose(on_the_floor(aim), [0.0, 0.0, -1.0], atol=1e-12)
