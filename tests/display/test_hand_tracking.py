"""Bare hands: as controllers, the choice of input, the poking finger, what is felt, teleport; with made-up joints."""

from types import SimpleNamespace as N

import numpy as np
import pytest
from numpy.testing import assert_allclose

from display.xr import hand_joints as J
from display.xr import hand_tracking as tracking
from display.xr.actions import FINGER_LENGTH, FINGER_RADIUS, Controller
from display.xr.hand_joints import BONES, RELAXED, posed, rotation_about
from display.xr.hand_tracking import HandGestures
from display.xr.player import GRAB_RADIUS, PINCH_RADIUS, FingerPoke, Player
from display.xr.poses import pose_matrix
from scenes import registry, ring_toss
from tests.support.fake_view import FakeView

PINCH, FIST, POINT = (0.7, 0.6, 0.2, 0.2, 0.2), (0.8, 1.0, 1.0, 1.0, 1.0), (0.5, 0.0, 1.0, 1.0, 1.0)
HALF = (0.35, 0.3, 0.2, 0.2, 0.2)


def frame(position=(0.0, 1.0, -0.4), yaw=0.3):
    return pose_matrix(position, rotation_about((0, 1, 0), yaw))


def does(*poses, left=False):
    """Gestures of a hand in these poses, one after the other."""
    hand = tracking.HandGestures()
    return [("grab", "pinch", "")[0 if c.grab else 1 if c.pinch else 2] for c in map(hand.read, track(poses, left))]


def track(poses, left=False):
    return [None if p is None else posed(p, left=left).transformed(frame()) for p in poses]


@pytest.mark.parametrize("left", [False, True])
def test_finger_and_thumb_pinch_a_fist_grabs_and_a_hand_that_points_holds_nothing(left):
    poses = (RELAXED, PINCH, RELAXED, FIST, RELAXED, POINT, (0.0,) * 5)
    assert does(*poses, left=left) == ["", "pinch", "", "grab", "", "", ""]


def test_what_is_begun_goes_on_until_it_is_clearly_over():
    apart = [np.linalg.norm(j.position[J.THUMB_TIP] - j.position[J.INDEX_TIP]) for j in track([PINCH, HALF, RELAXED])]
    wide = (0.62, 0.54, 0.2, 0.2, 0.2)
    between = np.linalg.norm(np.subtract(*posed(wide).position[[J.THUMB_TIP, J.INDEX_TIP]]))
    assert apart[0] < tracking.PINCH_BELOW < between < tracking.PINCH_UNTIL < apart[1]
    assert does(wide, PINCH, wide, HALF, wide) == ["", "pinch", "pinch", "", ""]
    loose = (0.5, 0.55, 0.55, 0.55, 0.55)
    assert tracking.FIST_UNTIL < posed(loose).curls()[1] < tracking.FIST_ABOVE
    assert does(loose, FIST, loose, RELAXED, loose) == ["", "grab", "grab", "", ""]


def test_a_fist_on_the_way_back_is_no_pinch():
    """In a fist thumb and index may touch; it grabs all the same, and opens without pinching."""
    assert "pinch" not in does(FIST, (0.8, 0.8, 0.8, 0.8, 0.8), (0.8, 0.7, 0.9, 0.9, 0.9))


def test_a_lost_hand_goes_on_with_what_it_did():
    hand = tracking.HandGestures()
    pinching, lost, back = (hand.read(j) for j in track([PINCH, None, (0.62, 0.54, 0.2, 0.2, 0.2)]))
    assert pinching.pinch == 1.0 and lost.grip is None and back.pinch == 1.0


def test_a_pinch_holds_between_the_fingers_and_a_fist_in_the_palm():
    pinch, fist = (tracking.HandGestures().read(posed(p).transformed(frame())) for p in (PINCH, FIST))
    tips = posed(PINCH).transformed(frame()).position[[J.THUMB_TIP, J.INDEX_TIP]]
    assert_allclose(pinch.grip[:3, 3], tips.mean(0), atol=1e-12)
    assert_allclose(fist.grip[:3, 3], posed(FIST).transformed(frame()).position[J.PALM], atol=1e-12)
    player = Player(registry.load("ring_toss"))
    hands, _ = player.advance([pinch, fist], np.eye(4), FakeView())
    assert [h.grip for h in hands] == [True, True] and [h.reach for h in hands] == [PINCH_RADIUS, GRAB_RADIUS]
    stage = player.play_space.world_from_play
    assert_allclose(hands[0].position, (stage @ [*tips.mean(0), 1.0])[:3])
    assert len(hands[0].touch) == len(BONES)
    a = np.array([t.a for t in hands[0].touch])
    assert_allclose(a, posed(PINCH).transformed(frame()).bones()[:, :3] @ stage[:3, :3].T + stage[:3, 3], atol=1e-12)


def test_bones_are_where_the_joints_are_and_not_too_thick():
    joints = posed()
    wild = J.HandJoints(joints.position, joints.rotation, np.linspace(0.0, 0.3, J.JOINT_COUNT))
    capsules = wild.bones()
    assert capsules.shape == (19, 7)
    assert (capsules[:, 6] >= J.MIN_RADIUS).all() and (capsules[:, 6] <= J.MAX_RADIUS).all()
    for (a, b), row in zip(BONES, capsules, strict=True):
        assert_allclose(row[:6], [*joints.position[a], *joints.position[b]])


def test_bends_add_up_and_do_not_depend_on_where_the_hand_is():
    straight, fist = posed((0.0,) * 5).curls(), posed((1.0,) * 5).curls()
    assert (straight[1:] < np.radians(10)).all() and (fist[1:] > np.radians(200)).all()
    assert_allclose(posed(PINCH).transformed(frame((1, 2, 3), 2.0)).curls(), posed(PINCH).curls(), atol=1e-9)
    assert_allclose(posed(PINCH, left=True).curls(), posed(PINCH).curls(), atol=1e-9)


def test_a_hand_points_along_its_forearm_however_it_pinches():
    aims = [posed(p).transformed(frame()).aim() for p in (RELAXED, PINCH)]
    assert_allclose(aims[0], aims[1], atol=1e-12)
    assert np.linalg.det(aims[0][:3, :3]) == pytest.approx(1.0)
    ahead = frame()[:3, :3] @ [0, 0, -1]
    assert -aims[0][:3, 2] @ ahead > 0.9


def location_table(joints):
    table = np.zeros(J.JOINT_COUNT, tracking.LOCATION)
    table["orientation"][:, 3] = 1.0
    table["position"], table["radius"] = joints.position, joints.radius
    return table


def test_joints_are_read_as_the_runtime_lays_them_out():
    assert tracking.LOCATION.itemsize == 40  # XrSpaceLocationFlags, XrPosef, float; and the end's padding below
    read = tracking.joints_of(location_table(posed()))
    assert_allclose(read.position, posed().position, atol=1e-6)
    assert_allclose(read.rotation, np.tile(np.eye(3), (J.JOINT_COUNT, 1, 1)))
    for field, value in (("position", np.nan), ("radius", np.inf), ("orientation", 0.0)):
        table = location_table(posed())
        table[field][3] = value
        assert tracking.joints_of(table) is None


IDLE, BUSY = Controller(grip=np.eye(4)), Controller(grip=np.eye(4), pinch=0.5)


def plays(sides, time, controller, hand):
    chosen = sides.choose([controller, Controller()], [posed() if hand else None, None], time)[0]
    return "controller" if chosen is controller else "hand" if chosen.joints is not None else "frozen"


def test_a_controller_plays_while_it_is_used_and_a_hand_else():
    sides = tracking.InputSelector()
    assert plays(sides, 0.0, IDLE, True) == "hand"
    assert plays(sides, 0.1, BUSY, True) == "controller"
    assert plays(sides, 0.1 + 0.9 * tracking.HANDOVER, IDLE, True) == "controller"
    assert plays(sides, 0.2 + tracking.HANDOVER, IDLE, True) == "hand"


def test_a_lost_hand_is_not_replaced_at_once():
    sides = tracking.InputSelector()
    assert plays(sides, 0.0, IDLE, True) == "hand"
    assert plays(sides, 0.5 * tracking.LOST_TIMEOUT, IDLE, False) == "frozen"
    assert plays(sides, 0.6 * tracking.LOST_TIMEOUT, IDLE, True) == "hand"
    assert [plays(sides, t, IDLE, False) for t in (2.0 * tracking.LOST_TIMEOUT, 5.0)] == ["controller"] * 2


def test_a_touched_trigger_stretches_out_a_finger_and_a_grip_draws_it_in():
    poke, outs = FingerPoke(), []
    held = Controller(grip=frame(), point=True)
    for c, grips in [(held, False)] * 8 + [(Controller(grip=frame(), grab=1.0, point=True), True)] * 8:
        poke.advance(c, grips)
        outs.append(poke.extension)
    assert outs[0] < 0.3 and outs[7] == 1.0 and outs[-1] == 0.0
    assert (np.diff(outs[:8]) >= 0).all() and np.abs(np.diff(outs)).max() < 0.2
    poke.extension = 1.0
    piece = poke.capsules(held)[0]
    assert_allclose(np.linalg.norm(piece[3:6] - piece[:3]), FINGER_LENGTH)
    assert_allclose((piece[3:6] - piece[:3]) / FINGER_LENGTH, frame()[:3, :3] @ [0, 0, -1], atol=1e-12)
    assert piece[6] == FINGER_RADIUS
    assert len(FingerPoke().capsules(held)) == 0


def test_a_pulled_trigger_pinches_at_the_fingers_tip():
    player = Player(registry.load("ring_toss"))
    half, pulled = Controller(grip=frame(), pinch=0.4), Controller(grip=frame(), pinch=1.0)
    for _ in range(8):
        hands, _ = player.advance([half, Controller()], np.eye(4), FakeView())
    assert not hands[0].grip and len(hands[0].touch) == 1
    tip = np.array(hands[0].touch[0].b)
    hands, _ = player.advance([pulled, Controller()], np.eye(4), FakeView())
    assert hands[0].grip and hands[0].reach == PINCH_RADIUS
    assert_allclose(hands[0].position, tip, atol=1e-9)


def test_hands_feel_a_touch_begin_and_go_on():
    player, felt = Player(registry.load("ring_toss")), []
    actions = N(pulse=lambda h, strength, seconds: felt.append((h, strength)))
    for force in (0.0, 0.0, 2.0, 2.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0):
        push = [np.zeros(3), np.array([0.0, 0.0, force])]
        player.feel(N(hand_forces=list, touch_forces=lambda p=push: p), actions)
    assert {h for h, _ in felt} == {1}
    assert 3 <= len(felt) < 8 and felt[0][1] > 0.5  # a tap, then less and less
    assert all(0.0 < s <= 1.0 for _, s in felt)


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
