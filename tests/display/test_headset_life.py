"""A headset's session from beginning to end, in a runtime that is made up: every state, and what is not seen."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from display.adaptive_resolution import DynamicResolution
from display.xr.actions import Controller
from display.xr.player import MAX_LEAD_TIME, PoseFilter
from display.xr.wrist_panel import PIXELS
from render.renderer import DEPTH_FAR, DEPTH_NEAR
from tests.support.fake_xr import CLOCK, DEPTH, EXTENSIONS, PERIOD, FakeXr
from tests.support.worn import DEPTH32, lines, worn

wear = pytest.fixture(worn)


def test_an_ordinary_play_from_the_first_frame_to_the_last(wear, capsys):
    fake = FakeXr()
    _, world = wear(fake, 10)
    assert len(world.frames) == 10 and lines(capsys) == []
    assert world.frames[-1].time == pytest.approx(10 * PERIOD * 1e-9)
    assert world.cameras[-1][0].width == 64 and len(world.cameras[-1]) == 2
    calls = [c for c in fake.calls if c in ("begin_session", "request_exit_session", "end_session", "destroy_session")]
    assert calls == ["begin_session", "request_exit_session", "end_session", "destroy_session"]
    assert fake.calls[-1] == "destroy_instance" and not fake.begun
    shown = [layers for frame, layers in fake.ended if frame <= 10]
    assert all(len(layers[0]) == 2 for layers in shown)
    assert shown[0][0][0] == {
        "rectangle": (0, 0, 64, 48),
        "depth": (0, 0, 64, 48),
        "near": pytest.approx(DEPTH_NEAR),
        "far": DEPTH_FAR,
    }
    assert world.timings.to_light == pytest.approx(PERIOD * 1e-9 + 0.005)


def test_without_the_extensions_nothing_of_them_is_asked_for(wear):
    fake = FakeXr(extensions=[e for e in EXTENSIONS if e not in (DEPTH, CLOCK)])
    _, world = wear(fake, 3)
    assert fake.ended[0][1][0][0] == {"rectangle": (0, 0, 64, 48)}
    assert world.timings.to_light is None and DEPTH32 not in fake.formats_made()
    fake = FakeXr(formats=(0x8058,))  # depth, but no format for it; and only linear textures
    wear(fake, 2)
    assert "depth" not in fake.ended[0][1][0][0] and set(fake.formats_made()) == {0x8058}


def test_missed_frames_are_the_runtimes_and_the_world_does_not_slow_down(wear):
    fake = FakeXr(missed={4: 2, 8: 1})
    _, world = wear(fake, 10, lambda k, headset, world: setattr(world, "simulation_cost", 0.1))
    assert world.timings.missed == 3 and world.timings.budget == pytest.approx(PERIOD * 1e-9)
    assert world.frames[-1].time == pytest.approx(13 * PERIOD * 1e-9) and world.timings.dropped == 0.0
    assert [round(f.dt / f.max_step) for f in world.frames] == [1, 1, 1, 3, 1, 1, 1, 2, 1, 1]


def test_where_the_rate_does_not_hold_a_part_of_the_textures_is_drawn(wear):
    fake = FakeXr()
    fake.size = (640, 480)
    wear.time.work = 0.02
    _, world = wear(fake, 60, lambda k, headset, world: world.timings.add("render", 0.015))
    assert world.sizes[-1] == (320, 240) and world.cameras[-1][0].width == 320
    view = fake.ended[58][1][0][1]
    assert view["rectangle"] == view["depth"] == (0, 0, 320, 240)
    made = fake.calls.index("begin_session")
    assert "create_swapchain" in fake.calls[:made] and fake.formats_made().count(DEPTH32) == 2
    sizes = {chain.size for chain in fake.swapchains.values()}
    assert sizes == {(640, 480), PIXELS}, "a swapchain is made anew"
    wear.time.work = 0.02
    fake = FakeXr()

    def choose(k, headset, world):
        wear.mirrors[-1].resolution = None if k < 5 else 1.0 if k < 10 else 0.75

    fake.size = (640, 480)
    _, world = wear(fake, 5 + DynamicResolution.SKIPPED_FRAMES + 20, choose)
    assert world.picture_size == (480, 360) and world.sizes == [(480, 360)]  # the user's choice


def test_off_and_on_again(wear, capsys):
    off = ["VISIBLE", "SYNCHRONIZED", "STOPPING"]
    fake = FakeXr(script={6: off, 9: off})

    def poll(instance, ask=FakeXr.poll_event):
        if fake.state == "IDLE" and "end_session" in fake.calls and wear.time.slept > 40 * fake.counts["end_session"]:
            fake.time += 10**12
            fake.enter("READY")
        return ask(fake, instance)

    fake.poll_event = poll
    _, world = wear(fake, 12)
    paused = ["headset taken off: paused", "headset put on: playing again"]
    assert lines(capsys) == paused * 2
    assert max(f.dt for f in world.frames) == pytest.approx(PERIOD * 1e-9), "the world stood still meanwhile"
    assert world.timings.missed == 0 and fake.counts["begin_session"] == 3


def test_a_headset_that_nobody_wears_is_asked_for(wear, capsys):
    fake = FakeXr()
    fake.poll_event = lambda instance, ask=fake.poll_event: ask(instance) if wear.time.slept > 60 else nothing(fake)
    _, world = wear(fake, 2)
    assert lines(capsys) == ["put the headset on to begin"] and len(world.frames) == 2


def nothing(fake):
    raise fake.EventUnavailable


def test_while_something_else_has_the_input_the_world_goes_on_and_hands_hold_on(wear, capsys):
    fake = FakeXr(script={5: ["VISIBLE"], 9: ["FOCUSED"]})
    fake.squeeze = {"left": 1.0, "right": 1.0}

    def each(k, headset, world):
        if k == 4:
            fake.squeeze["right"], fake.hands["right"] = 0.0, ((0.0, 0.0, 0.0, 1.0), (0.2, 1.2, -0.2))
            fake.pressed = {("upper", "right")}
        if k == 7:
            fake.pressed, fake.squeeze["right"] = set(), 1.0

    _, world = wear(fake, 70, each)
    hands = [f.hands[1] for f in world.frames]
    assert [h.grip for h in hands] == [True] * 70
    assert all(f.dt > 0 for f in world.frames) and all(f.commands == [] for f in world.frames)
    assert hands[5].position == hands[3].position == hands[7].position
    ways = np.linalg.norm(np.diff([h.position for h in hands], axis=0), axis=1)
    assert ways.max() < 2.1 * PERIOD * 1e-9 and ways.sum() == pytest.approx(0.1)  # led there, not flung
    assert lines(capsys) == ["another program has the input: your hands wait", "the input is back"]


def test_a_hand_that_jumps_is_led_there_evenly():
    """Tracking takes something else for the hand: what it holds is not flung there, nor back."""
    here, away = np.eye(4), np.eye(4)
    away[:3, 3] = 0.0, 5.0, -3.0
    lead, dt = PoseFilter(), 1 / 90
    shown = [lead.apply([Controller(grip=pose)], dt)[0].grip[:3, 3] for pose in [here] * 3 + [away] * 90 + [here] * 90]
    ways = np.linalg.norm(np.diff(shown, axis=0), axis=1)
    assert_allclose([shown[2], shown[92], shown[-1]], [here[:3, 3], away[:3, 3], here[:3, 3]], atol=1e-9)
    assert ways.max() < 1.1 * np.linalg.norm(away[:3, 3]) * dt / MAX_LEAD_TIME


def test_a_hand_and_a_head_that_are_lost_stay_where_they_were(wear, capsys):
    fake = FakeXr()
    fake.squeeze["left"] = 1.0
    seen = []

    def each(k, headset, world):
        seen.append(world.cameras[-1][0])
        if k == 3:
            fake.valid = {"right"}
        if k == 6:
            fake.valid, fake.kinds = {"head", "left", "right"}, {"orientation"}
            fake.head = ((0.0, np.sin(0.2), 0.0, np.cos(0.2)), (5.0, 9.0, 5.0))
        if k == 9:
            fake.kinds = {"orientation", "position"}

    _, world = wear(fake, 12, each)
    eyes = [c.position for c in seen]
    np.testing.assert_array_equal(eyes[2], eyes[5])
    np.testing.assert_allclose(eyes[8], eyes[2], atol=1e-6)  # turned, but not moved
    assert not np.allclose(seen[8].world_to_camera[:3, :3], seen[2].world_to_camera[:3, :3])
    assert np.linalg.norm(eyes[11] - eyes[2]) > 5
    assert all(f.hands[0].grip for f in world.frames)
    assert world.frames[5].hands[0] == world.frames[2].hands[0]
    assert lines(capsys) == ["head tracking lost: the view stays where it was", "head tracking is back"]


def test_a_head_that_nobody_has_seen_yet_looks_ahead(wear):
    fake = FakeXr()
    fake.valid = set()
    _, world = wear(fake, 2)
    assert world.cameras[0][0].position[1] == pytest.approx(1.6) and np.isfinite(world.cameras[0][0].position).all()
    assert [h.grip for h in world.frames[0].hands] == [False, False]


def test_a_frame_that_is_not_presented_is_ended_all_the_same(wear):
    fake = FakeXr()

    def skip(k, headset, world):
        headset.present = (lambda world: None) if k == 3 else type(headset).present.__get__(headset)

    wear(fake, 8, skip)
    assert [frame for frame, _ in fake.ended][:8] == [1, 2, 3, 4, 5, 6, 7, 8] and fake.ended[3][1] == []


def test_frames_that_are_not_seen_are_simulated_but_not_drawn(wear):
    fake = FakeXr()
    fake.should_render = False
    _, world = wear(fake, 4)
    assert world.cameras == [[]] * 4 and all(layers == [] for _, layers in fake.ended) and world.frames[-1].dt > 0
