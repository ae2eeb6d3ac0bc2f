"""A headset that goes away, or was never there, in a runtime that is made up: every failure is one line."""

import pytest

from core.errors import BadInput
from display.xr import headset as module
from display.xr.session import MAX_LOSSES
from tests.support.fake_xr import DEPTH, EXTENSIONS, PERIOD, FakeXr
from tests.support.worn import lines, worn

wear = pytest.fixture(worn)


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
