"""A headset's session from beginning to end, in a runtime that is made up: every state and every failure."""

import ctypes
import itertools
from types import SimpleNamespace as N
from unittest.mock import MagicMock

import numpy as np
import pytest

from assets.errors import BadInput
from display.clock import Cost
from display.headset import headset as module
from display.headset.news import OFTEN
from display.headset.resolution import SETTLE
from display.timing import Timings
from render.renderer import FAR, NEAR
from scenes import ring_toss
from tests.fake_xr import CLOCK, DEPTH, EXTENSIONS, PERIOD, Fake

ATTACH = ctypes.CFUNCTYPE(None, *[ctypes.c_uint] * 4, ctypes.c_int)(lambda *call: None)  # glFramebufferTexture2D
MOST = 400  # frames, and calls of sleep: a test that gets there hangs


class Time:
    """The module time, in which nothing takes time but sleep, and each frame `work` [s]."""

    CLOCK_MONOTONIC = 1

    def __init__(self):
        self.now, self.work, self.slept = 100.0, 0.0, 0

    def monotonic(self):
        return self.now

    def perf_counter(self):
        return self.now

    def clock_gettime_ns(self, clock):
        return round(self.now * 1e9)

    def sleep(self, seconds):
        self.slept += 1
        assert self.slept < MOST, "it waits for ever"
        self.now += seconds


class World:
    """What a headset needs of a world: it notes its frames."""

    demo, paused, interaction = False, False, "physics"

    def __init__(self, size):
        self.timings, self.cost, self.renderer_size, self.sizes = Timings(), Cost(), size, []
        self.frames, self.cameras, self.picture = [], [], None

    def step(self, frame):
        self.frames.append(frame)
        self.cameras.append(frame.cameras() if callable(frame.cameras) else frame.cameras)

    def resize(self, *size):
        self.renderer_size = size
        self.sizes.append(size)

    def hand_forces(self):
        return [np.array([0.0, 20.0, 0.0]), np.zeros(3)]


@pytest.fixture
def wear(monkeypatch):
    """wear(fake, frames=N): play so many frames; (headset, world). The clock of all is wear.time."""
    time, mirrors = Time(), []

    def mirror(scene, title, window, views):
        gl = MagicMock(version_code=450, extra=lambda name: ctypes.cast(ATTACH, ctypes.c_void_p).value)
        texture = MagicMock()
        mirrors.append(N(gl=gl, egl=None, texture=texture, closing=False, share=None, closed=0))
        mirrors[-1].show = lambda world: {}
        mirrors[-1].close = lambda m=mirrors[-1]: setattr(m, "closed", m.closed + 1)
        return mirrors[-1]

    def play(fake, frames=10, each=lambda k, headset, world: None):
        monkeypatch.setattr("display.headset.runtime.import_xr", lambda: fake)
        headset = module.Headset(ring_toss.build())
        world = World(headset.size)
        with headset:
            for k, frame in enumerate(itertools.islice(headset.frames(), frames)):
                world.step(frame)
                time.now += time.work
                each(k, headset, world)
                headset.present(world)
        assert mirrors[-1].closed == 1
        return headset, world

    for name in ("display.headset.headset", "display.headset.runtime", "display.headset.news"):
        monkeypatch.setattr(f"{name}.time", time)
    monkeypatch.setattr(module, "mirror", mirror)
    monkeypatch.setattr(module, "has_display", lambda: False)
    monkeypatch.setattr("display.headset.graphics.binding", lambda xr, egl: xr.GraphicsBindingEGLMNDX())
    play.time, play.mirrors = time, mirrors
    return play


def lines(capsys) -> list[str]:
    """What was said after the greeting."""
    return capsys.readouterr().err.splitlines()[1:]


def test_an_ordinary_play_from_the_first_frame_to_the_last(wear, capsys):
    fake = Fake()
    _, world = wear(fake, 10)
    assert len(world.frames) == 10 and lines(capsys) == []
    assert world.frames[-1].time == pytest.approx(10 * PERIOD * 1e-9)
    assert world.cameras[-1][0].width == 64 and len(world.cameras[-1]) == 2
    calls = [c for c in fake.calls if c in ("begin_session", "request_exit_session", "end_session", "destroy_session")]
    assert calls == ["begin_session", "request_exit_session", "end_session", "destroy_session"]
    assert fake.calls[-1] == "destroy_instance" and not fake.begun
    shown = [layers for frame, layers in fake.ended if frame <= 10]
    assert all(len(layers) == 1 and len(layers[0]) == 2 for layers in shown)
    assert shown[0][0][0] == {
        "rectangle": (0, 0, 64, 48),
        "depth": (0, 0, 64, 48),
        "near": pytest.approx(NEAR),
        "far": FAR,
    }
    assert world.timings.to_light == pytest.approx(PERIOD * 1e-9 + 0.005)


def test_without_the_extensions_nothing_of_them_is_asked_for(wear):
    fake = Fake(extensions=[e for e in EXTENSIONS if e not in (DEPTH, CLOCK)])
    _, world = wear(fake, 3)
    assert fake.ended[0][1][0][0] == {"rectangle": (0, 0, 64, 48)}
    assert world.timings.to_light is None and len(fake.chains) == 2
    fake = Fake(formats=(0x8058,))  # depth, but no format for it; and only linear textures
    wear(fake, 2)
    assert "depth" not in fake.ended[0][1][0][0] and len(fake.chains) == 2


def test_missed_frames_are_the_runtimes_and_the_world_does_not_slow_down(wear):
    fake = Fake(missed={4: 2, 8: 1})
    _, world = wear(fake, 10, lambda k, headset, world: (world.cost.note(0.0, 1.0), world.cost.note(0.1, 1.0)))
    assert world.timings.missed == 3 and world.timings.budget == pytest.approx(PERIOD * 1e-9)
    assert world.frames[-1].time == pytest.approx(13 * PERIOD * 1e-9) and world.timings.dropped == 0.0
    assert [round(f.dt / f.step) for f in world.frames] == [1, 1, 1, 3, 1, 1, 1, 2, 1, 1]


def test_where_the_rate_does_not_hold_a_part_of_the_textures_is_drawn(wear):
    fake = Fake()
    fake.size = (640, 480)
    wear.time.work = 0.02
    _, world = wear(fake, 60)
    assert world.sizes[-1] == (320, 240) and world.cameras[-1][0].width == 320
    view = fake.ended[58][1][0][1]
    assert view["rectangle"] == view["depth"] == (0, 0, 320, 240)
    assert fake.counts["create_swapchain"] == 4, "no swapchain is made anew"
    wear.time.work = 0.02
    fake = Fake()

    def choose(k, headset, world):
        wear.mirrors[-1].share = None if k < 5 else 1.0 if k < 10 else 0.75

    fake.size = (640, 480)
    _, world = wear(fake, 5 + SETTLE + 20, choose)
    assert world.renderer_size == (480, 360) and world.sizes == [(480, 360)]  # the user's choice


def test_off_and_on_again(wear, capsys):
    off = ["VISIBLE", "SYNCHRONIZED", "STOPPING"]
    fake = Fake(script={6: off, 9: off})

    def poll(instance, ask=Fake.poll_event):
        if fake.state == "IDLE" and "end_session" in fake.calls and wear.time.slept > 40 * fake.counts["end_session"]:
            fake.time += 10**12
            fake.enter("READY")
        return ask(fake, instance)

    fake.poll_event = poll
    _, world = wear(fake, 12)
    paused = ["the headset is off: the play is paused", "the headset is on: the play goes on"]
    assert lines(capsys) == paused * 2
    assert max(f.dt for f in world.frames) == pytest.approx(PERIOD * 1e-9), "the world stood still meanwhile"
    assert world.timings.missed == 0 and fake.counts["begin_session"] == 3


def test_a_headset_that_nobody_wears_is_asked_for(wear, capsys):
    fake = Fake()
    fake.poll_event = lambda instance, ask=fake.poll_event: ask(instance) if wear.time.slept > 60 else nothing(fake)
    _, world = wear(fake, 2)
    assert lines(capsys) == ["put the headset on to begin"] and len(world.frames) == 2


def nothing(fake):
    raise fake.EventUnavailable


def test_while_something_else_has_the_input_the_world_goes_on_and_hands_hold_on(wear, capsys):
    fake = Fake(script={5: ["VISIBLE"], 9: ["FOCUSED"]})
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
    assert all(f.dt > 0 for f in world.frames) and all(f.commands == {} for f in world.frames)
    assert hands[5].position == hands[3].position == hands[7].position
    ways = np.linalg.norm(np.diff([h.position for h in hands], axis=0), axis=1)
    assert ways.max() < 2.1 * PERIOD * 1e-9 and ways.sum() == pytest.approx(0.1)  # led there, not flung
    assert lines(capsys) == ["something else has your hands: they rest here", "your hands are here again"]


def test_a_hand_and_a_head_that_are_lost_stay_where_they_were(wear, capsys):
    fake = Fake()
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
    assert lines(capsys) == ["the head is not seen: the view stays where it was", "the head is seen again"]


def test_a_head_that_nobody_has_seen_yet_looks_ahead(wear):
    fake = Fake()
    fake.valid = set()
    _, world = wear(fake, 2)
    assert world.cameras[0][0].position[1] == pytest.approx(1.6) and np.isfinite(world.cameras[0][0].position).all()
    assert [h.grip for h in world.frames[0].hands] == [False, False]


@pytest.mark.parametrize("what", ["LOSS_PENDING", "INSTANCE_LOSS_PENDING"])
def test_a_runtime_that_goes_away_and_comes_back(wear, capsys, what):
    fake = Fake(script={6: [what]})
    _, world = wear(fake, 12)
    assert len(world.frames) == 12 and fake.counts["create_instance"] == fake.counts["destroy_instance"] == 2
    assert fake.counts["create_session"] == fake.counts["destroy_session"] == 2
    said = lines(capsys)
    assert len(said) == 2 and said[0].startswith("the headset's runtime went away") and said[1] == "Fake 1.0.0 is back"
    assert max(f.dt for f in world.frames) == pytest.approx(PERIOD * 1e-9)


CALLS = ["poll_event", "wait_frame", "begin_frame", "sync_actions", "get_action_state_float", "locate_space"]
CALLS += ["locate_views", "acquire_swapchain_image", "wait_swapchain_image", "release_swapchain_image", "end_frame"]
CALLS += ["apply_haptic_feedback", "get_instance_proc_addr", "begin_session"]
ERRORS = ["SessionLostError", "InstanceLostError", "SessionLossPending", "RuntimeFailureError"]


@pytest.mark.parametrize(
    ("call", "error"), [(c, ERRORS[0]) for c in CALLS] + [(c, e) for c in CALLS[1::9] for e in ERRORS[1:]]
)
def test_a_loss_in_any_call_of_a_frame_is_survived(wear, capsys, call, error):
    fake = Fake(failures={call: (2 if call == "begin_session" else 5, error, 1)})
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
    _, world = wear(Fake(failures={call: (1, "InstanceLostError")}), 5)
    assert len(world.frames) == 5 and lines(capsys) == []


def test_a_runtime_that_does_not_come_back_ends_the_play(wear, capsys):
    fake = Fake(script={4: ["LOSS_PENDING"]}, failures={"create_instance": (2, "RuntimeUnavailableError")})
    _, world = wear(fake, 12)
    assert len(world.frames) == 3
    assert lines(capsys)[1:] == ["it did not come back; the play ends"]
    assert wear.time.now >= 100 + module.PATIENCE


def test_while_it_waits_the_mirror_can_be_closed(wear, capsys):
    fake = Fake(script={4: ["LOSS_PENDING"]}, failures={"create_instance": (2, "RuntimeUnavailableError")})

    def show(world):
        wear.mirrors[-1].closing = "create_instance" in fake.calls[20:]
        return {}

    _, world = wear(fake, 12, lambda k, headset, world: setattr(wear.mirrors[-1], "show", show))
    assert len(world.frames) == 3 and wear.time.now < 110


def test_a_runtime_that_fails_again_and_again_is_given_up(wear, capsys):
    with pytest.raises(BadInput, match=r"fails again and again .RuntimeFailureError."):
        wear(Fake(failures={"wait_frame": (5, "RuntimeFailureError")}), 50)
    assert len([line for line in lines(capsys) if "went away" in line]) == OFTEN - 1


def test_the_systems_menu_ends_the_play(wear, capsys):
    fake = Fake(script={5: [lambda f: f.request_exit_session(None)]})
    _, world = wear(fake, 12)
    assert len(world.frames) == 4 and lines(capsys) == ["the headset's system ends the play"]


def test_after_another_runtime_without_depth_none_is_sent_and_the_other_way_round(wear):
    both = [e for e in EXTENSIONS if e != DEPTH]
    fake = Fake(script={5: ["LOSS_PENDING", lambda f: setattr(f, "extensions", both)]})
    wear(fake, 10)
    assert "depth" in fake.ended[0][1][0][0] and "depth" not in fake.ended[8][1][0][0]
    fake = Fake(extensions=both, script={5: ["LOSS_PENDING", lambda f: setattr(f, "extensions", EXTENSIONS)]})
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
    "fails .RuntimeFailureError.": {"enumerate_view_configurations": (1, "RuntimeFailureError")},
    "begins no session .GraphicsDeviceInvalidError.": {"create_session": (1, "GraphicsDeviceInvalidError")},
    "begins no session .OutOfMemoryError.": {"create_swapchain": (2, "OutOfMemoryError")},
    "begins no session .SessionLostError.": {"attach_session_action_sets": (1, "SessionLostError")},
}


@pytest.mark.parametrize("says", BEGINNINGS)
def test_what_cannot_begin_says_why_in_one_line_and_leaves_nothing(wear, says):
    fake = Fake(failures=BEGINNINGS[says])
    with pytest.raises(BadInput, match=f"--xr: .*{says}") as raised:
        wear(fake)
    assert "\n" not in str(raised.value) and len(str(raised.value)) < 200
    assert (
        fake.counts.get("destroy_instance", 0)
        == fake.counts.get("create_instance", 0) - (fake.failures.get("create_instance", (0,))[0])
    )
    assert (
        fake.counts.get("destroy_session", 0)
        == fake.counts.get("create_session", 0) - (fake.failures.get("create_session", (0,))[0])
    )


def test_a_headset_may_be_connected_late(wear, capsys):
    fake = Fake(failures={"get_system": (1, "FormFactorUnavailableError", 7)})
    _, world = wear(fake, 2)
    assert len(world.frames) == 2
    assert "waiting 30 s for a headset" in capsys.readouterr().err


def test_textures_and_extensions_that_are_missing(wear):
    with pytest.raises(BadInput, match="neither sRGB nor plain textures"):
        wear(Fake(formats=(0x8CAC,)))
    with pytest.raises(BadInput, match=r"cannot take OpenGL pictures .no XR_MNDX_egl_enable"):
        wear(Fake(extensions=("XR_KHR_opengl_enable",)))


def test_a_frame_that_is_not_presented_is_ended_all_the_same(wear):
    fake = Fake()

    def skip(k, headset, world):
        headset.present = (lambda world: None) if k == 3 else type(headset).present.__get__(headset)

    wear(fake, 8, skip)
    assert [frame for frame, _ in fake.ended][:8] == [1, 2, 3, 4, 5, 6, 7, 8] and fake.ended[3][1] == []


def test_frames_that_are_not_seen_are_simulated_but_not_drawn(wear):
    fake = Fake()
    fake.should_render = False
    _, world = wear(fake, 4)
    assert world.cameras == [[]] * 4 and all(layers == [] for _, layers in fake.ended) and world.frames[-1].dt > 0
