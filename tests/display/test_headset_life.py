"""A headset's session in a runtime that is made up: every state, every loss, and what never begins: one line each."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from core.errors import BadInput
from display.adaptive_resolution import DynamicResolution
from display.xr import headset as module
from display.xr.actions import Controller
from display.xr.player import MAX_LEAD_TIME, PoseFilter
from display.xr.session import MAX_LOSSES
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


@pytest.mark.parametrize("what", ["LOSS_PENDING", "INSTANCE_LOSS_PENDING"])
def test_a_runtime_that_goes_away_and_comes_back(wear, capsys, what):
    fake = FakeXr(script={6: [what]})
    _, world = wear(fake, 12)
    assert len(world.frames) == 12 and fake.counts["create_instance"] == fake.counts["destroy_instance"] == 2
    assert fake.counts["create_session"] == fake.counts["destroy_session"] == 2
    said = lines(capsys)
    assert len(said) == 2 and said[0].startswith("lost the headset's runtime") and said[1] == "Fake 1.0.0 is back"
    assert max(f.dt for f in world.frames) == pytest.approx(PERIOD * 1e-9)


CALLS = ["poll_event", "wait_frame", "begin_frame", "sync_actions", "get_action_state_float", "locate_space"]
CALLS += ["locate_views", "acquire_swapchain_image", "wait_swapchain_image", "release_swapchain_image", "end_frame"]
CALLS += ["apply_haptic_feedback", "get_instance_proc_addr", "begin_session"]
ERRORS = ["SessionLostError", "InstanceLostError", "SessionLossPending", "RuntimeFailureError"]


@pytest.mark.parametrize(
    ("call", "error"), [(c, ERRORS[0]) for c in CALLS] + [(c, e) for c in CALLS[1::9] for e in ERRORS[1:]]
)
def test_a_loss_in_any_call_of_a_frame_is_survived(wear, capsys, call, error):
    fake = FakeXr(failures={call: (2 if call == "begin_session" else 5, error, 1)})
    if call == "begin_session":  # of the second session
        fake.script = {4: ["LOSS_PENDING"]}
    fake.squeeze = {"left": 1.0, "right": 1.0}
    _, world = wear(fake, 14)
    assert len(world.frames) == 14
    assert fake.counts["create_session"] == fake.counts["destroy_session"] >= 2
    said = lines(capsys)
    assert error in " ".join(said) and said[-1] == "Fake 1.0.0 is back"
    assert not fake.begun


@pytest.mark.parametrize("call", ["end_session", "destroy_session", "destroy_instance", "destroy_swapchain"])
def test_a_loss_at_the_end_is_no_news(wear, capsys, call):
    _, world = wear(FakeXr(failures={call: (1, "InstanceLostError")}), 5)
    assert len(world.frames) == 5 and lines(capsys) == []


def test_a_runtime_that_does_not_come_back_ends_the_play(wear, capsys):
    fake = FakeXr(script={4: ["LOSS_PENDING"]}, failures={"create_instance": (2, "RuntimeUnavailableError")})
    _, world = wear(fake, 12)
    assert len(world.frames) == 3
    assert lines(capsys)[1:] == ["it did not come back: quitting"]
    assert wear.time.now >= 100 + module.RECONNECT_TIMEOUT


def test_while_it_waits_the_mirror_can_be_closed(wear, capsys):
    fake = FakeXr(script={4: ["LOSS_PENDING"]}, failures={"create_instance": (2, "RuntimeUnavailableError")})

    def show(world):
        wear.mirrors[-1].closing = "create_instance" in fake.calls[20:]
        return []

    _, world = wear(fake, 12, lambda k, headset, world: setattr(wear.mirrors[-1], "show", show))
    assert len(world.frames) == 3 and wear.time.now < 110


def test_a_runtime_that_fails_again_and_again_is_given_up(wear, capsys):
    with pytest.raises(BadInput, match=r"fails again and again .RuntimeFailureError."):
        wear(FakeXr(failures={"wait_frame": (5, "RuntimeFailureError")}), 50)
    assert len([line for line in lines(capsys) if "lost the headset" in line]) == MAX_LOSSES - 1


def test_the_systems_menu_ends_the_play(wear, capsys):
    fake = FakeXr(script={5: [lambda f: f.request_exit_session(None)]})
    _, world = wear(fake, 12)
    assert len(world.frames) == 4 and lines(capsys) == ["the headset's system asks to quit"]


def test_after_another_runtime_without_depth_none_is_sent_and_the_other_way_round(wear):
    both = [e for e in EXTENSIONS if e != DEPTH]
    fake = FakeXr(script={5: ["LOSS_PENDING", lambda f: setattr(f, "extensions", both)]})
    wear(fake, 10)
    assert "depth" in fake.ended[0][1][0][0] and "depth" not in fake.ended[8][1][0][0]
    fake = FakeXr(extensions=both, script={5: ["LOSS_PENDING", lambda f: setattr(f, "extensions", EXTENSIONS)]})
    wear(fake, 10)
    assert all("depth" not in layers[0][0] for _, layers in fake.ended if layers)  # the picture has none


BEGINNINGS = {
    "no OpenXR runtime answers": {"create_instance": (1, "RuntimeUnavailableError")},
    "no OpenXR runtime answers;": {"enumerate_instance_extension_properties": (1, "RuntimeUnavailableError")},
    "the OpenXR runtime does not start .LimitReachedError.": {"create_instance": (1, "LimitReachedError")},
    "the OpenXR runtime does not start .ApiVersion": {"create_instance": (1, "ApiVersionUnsupportedError")},
    "drives no headset": {"get_system": (1, "FormFactorUnsupportedError")},
    "finds no headset": {"get_system": (1, "FormFactorUnavailableError")},
    "fails .InstanceLostError.": {"get_system": (1, "InstanceLostError")},
    "fails .RuntimeFailureError.": {"enumerate_view_configuration_views": (1, "RuntimeFailureError")},
    "begins no session .GraphicsDeviceInvalidError.": {"create_session": (1, "GraphicsDeviceInvalidError")},
    "begins no session .OutOfMemoryError.": {"create_swapchain": (2, "OutOfMemoryError")},
    "begins no session .SessionLostError.": {"attach_session_action_sets": (1, "SessionLostError")},
}


@pytest.mark.parametrize("says", BEGINNINGS)
def test_what_cannot_begin_says_why_in_one_line_and_leaves_nothing(wear, says):
    fake = FakeXr(failures=BEGINNINGS[says])
    with pytest.raises(BadInput, match=f"--xr: .*{says}") as raised:
        wear(fake)
    assert "\n" not in str(raised.value) and len(str(raised.value)) < 200
    for what in ("instance", "session"):
        failed = fake.failures.get(f"create_{what}", (0,))[0]
        assert fake.counts.get(f"destroy_{what}", 0) == fake.counts.get(f"create_{what}", 0) - failed


def test_a_headset_may_be_connected_late(wear, capsys):
    fake = FakeXr(failures={"get_system": (1, "FormFactorUnavailableError", 7)})
    _, world = wear(fake, 2)
    assert len(world.frames) == 2
    assert "waiting 30 s for a headset" in capsys.readouterr().err


def test_textures_and_extensions_that_are_missing(wear):
    with pytest.raises(BadInput, match="neither sRGB nor plain textures"):
        wear(FakeXr(formats=(0x8CAC,)))
    with pytest.raises(BadInput, match=r"cannot take OpenGL pictures .no XR_MNDX_egl_enable"):
        wear(FakeXr(extensions=("XR_KHR_opengl_enable",)))
