"""An OpenXR runtime that is made up: the module `xr` with its own structures, but every function answered here.

It holds a program to the specification: the states of a session follow each other as drawn in its chapter "Session
lifecycle", frames are waited for, begun and ended in this order, swapchain images acquired, waited for and released,
handles not used after they are destroyed, and rectangles lie within their textures. What it finds wrong it answers with
the specification's error. A script says what happens when: see Fake.
"""

from __future__ import annotations

import ctypes
import itertools
import types

from tests.support.fake_xr_parts import Input, Swapchains

PERIOD = 11_111_111  # [ns]
EGL, DEPTH, CLOCK = "XR_MNDX_egl_enable", "XR_KHR_composition_layer_depth", "XR_KHR_convert_timespec_time"
EXTENSIONS = ("XR_KHR_opengl_enable", EGL, DEPTH, CLOCK)
FORMATS = (0x8C43, 0x8058, 0x8CAC)
NEXT = {  # of a state: where the specification lets it go
    "UNKNOWN": {"IDLE"},
    "IDLE": {"READY", "EXITING"},
    "READY": {"SYNCHRONIZED"},
    "SYNCHRONIZED": {"VISIBLE", "STOPPING"},
    "VISIBLE": {"FOCUSED", "SYNCHRONIZED"},
    "FOCUSED": {"VISIBLE"},
    "STOPPING": {"IDLE"},
    "EXITING": set(),
    "LOSS_PENDING": set(),
}
START = ("SYNCHRONIZED", "VISIBLE", "FOCUSED")


class Fake(Input, Swapchains):
    """Stands for the module xr.

    script      {frame: [what happens before it]}: a state's name, "INSTANCE_LOSS_PENDING", or a function of the fake.
                Frames count over all sessions, from 1; a frame that is waited for while none is due is not counted.
    failures    {function: (from which call on, name of the exception[, how often])}
    missed      {frame: how many periods it is late}
    pose        of the head and of the hands: (x, y, z, w), (x, y, z); `valid` which are known ("head", "left", "right")
    """

    def __init__(self, *, script=None, failures=None, missed=None, extensions=EXTENSIONS, formats=FORMATS, images=None):
        import xr

        self._real, self.script, self.failures = xr, dict(script or {}), dict(failures or {})
        self.missed, self.extensions, self.formats = dict(missed or {}), extensions, formats
        self.calls: list[str] = []
        self.counts: dict[str, int] = {}
        self.pulses, self.ended = [], []  # (hand, strength), (frame, layers) of each that was ended
        self.valid, self.kinds = {"head", "left", "right"}, {"orientation", "position"}
        self.head, self.hands = ((0.0, 0.0, 0.0, 1.0), (0.0, 1.6, 0.0)), {}
        self.squeeze = {"left": 0.0, "right": 0.0}
        self.pressed: set[tuple[str, str]] = set()  # (action, hand)
        self.frame, self.time, self.size, self.should_render = 0, 10**12, (64, 48), True
        self.alive: set[int] = set()
        self._images = images or (lambda width, height, format: 0)
        self._numbers, self._names = itertools.count(16), {}
        self._begin_again()

    def _begin_again(self) -> None:
        self.state, self.events, self.running, self.waited, self.begun = "UNKNOWN", [], False, False, False
        self.chains, self.exit_asked = {}, False

    def __getattr__(self, name: str):
        return getattr(self._real, name)

    def __getattribute__(self, name: str):
        """Functions of the runtime are written down, and fail where the script wants it."""
        found = object.__getattribute__(self, name)
        if not isinstance(found, types.MethodType) or name.startswith("_") or name in ("enter", "formats_made"):
            return found

        def call(*args, **kwargs):
            self.calls.append(name)
            self.counts[name] = self.counts.get(name, 0) + 1
            first, error, *often = self.failures.get(name, (10**9, ""))
            if first <= self.counts[name] < first + (often[0] if often else 10**9):
                raise getattr(self._real, error)()
            return found(*args, **kwargs)

        return call

    def _handle(self, kind: str):
        number = next(self._numbers)
        self.alive.add(number)
        return ctypes.cast(ctypes.c_void_p(number), getattr(self._real, kind))

    def _number(self, handle) -> int:
        number = ctypes.cast(handle, ctypes.c_void_p).value
        if number not in self.alive:
            raise self._real.HandleInvalidError(f"{handle}")
        return number

    def _destroy(self, handle) -> None:
        self.alive.discard(self._number(handle))

    # What happens.

    def enter(self, *states: str) -> None:
        """The session goes through these states."""
        for state in states:
            if state not in NEXT[self.state] and state != "LOSS_PENDING":
                raise AssertionError(f"the script goes from {self.state} to {state}")
            self.state = state
            event = self._real.EventDataSessionStateChanged(state=self._real.SessionState[state])
            self.events.append(event)

    def _happen(self) -> None:
        for what in self.script.pop(self.frame + 1, []):
            if callable(what):
                what(self)
            elif what == "INSTANCE_LOSS_PENDING":
                self.events.append(self._real.EventDataInstanceLossPending())
            else:
                self.enter(what)

    # The instance.

    def enumerate_instance_extension_properties(self):
        return [types.SimpleNamespace(extension_name=name.encode()) for name in self.extensions]

    def create_instance(self, info):
        self._begin_again()
        return self._handle("Instance")

    def formats_made(self) -> list[int]:
        """The formats of all swapchains there are."""
        return [chain["format"] for chain in self.chains.values()]

    def destroy_instance(self, instance):
        self._destroy(instance)

    def get_instance_properties(self, instance):
        return types.SimpleNamespace(runtime_name=b"Fake", runtime_version=1 << 48)

    def get_system(self, instance, info):
        self._number(instance)
        return 1

    def enumerate_view_configurations(self, instance, system):
        return [self._real.ViewConfigurationType.PRIMARY_STEREO]

    def enumerate_view_configuration_views(self, instance, system, kind):
        width, height = self.size
        return [types.SimpleNamespace(recommended_image_rect_width=width, recommended_image_rect_height=height)] * 2

    def enumerate_environment_blend_modes(self, instance, system, kind):
        return [self._real.EnvironmentBlendMode.OPAQUE]

    def string_to_path(self, instance, text):
        self._names[text] = self._names.get(text, len(self._names) + 1)
        return self._names[text]

    def get_instance_proc_addr(self, instance, name):
        xr = self._real
        if name == "xrGetOpenGLGraphicsRequirementsKHR":
            return xr.PFN_xrGetOpenGLGraphicsRequirementsKHR(lambda instance, system, answer: 0)
        assert name == "xrConvertTimespecTimeToTimeKHR", name

        def convert(instance, present, answer):
            answer[0] = self.time - 5_000_000 - PERIOD
            return 0

        self._kept = xr.PFN_xrConvertTimespecTimeToTimeKHR(convert)
        return self._kept

    def poll_event(self, instance):
        self._number(instance)
        if self.state == "UNKNOWN" and self.chains is not None and "create_session" in self.calls:
            self.enter("IDLE", "READY")
        self._happen()
        if not self.events:
            raise self._real.EventUnavailable
        buffer, event = self._real.EventDataBuffer(), self.events.pop(0)
        ctypes.memmove(ctypes.byref(buffer), ctypes.byref(event), ctypes.sizeof(event))
        return buffer

    # The session.

    def create_session(self, instance, info):
        self._number(instance)
        self._begin_again()
        return self._handle("Session")

    def destroy_session(self, session):
        self._destroy(session)
        self.running = False

    def begin_session(self, session, info):
        if self.running:
            raise self._real.SessionRunningError
        if self.state != "READY":
            raise self._real.SessionNotReadyError
        self.running = True
        self.enter(*START)

    def end_session(self, session):
        if not self.running:
            raise self._real.SessionNotRunningError
        if self.state != "STOPPING":
            raise self._real.SessionNotStoppingError
        self.running = False
        self.enter("IDLE", *(["EXITING"] if self.exit_asked else []))

    def request_exit_session(self, session):
        if not self.running:
            raise self._real.SessionNotRunningError
        self.exit_asked = True
        down = ["FOCUSED", "VISIBLE", "SYNCHRONIZED", "STOPPING"]
        self.enter(*down[down.index(self.state) + 1 :])

    def wait_frame(self, session):
        if not self.running:
            raise self._real.SessionNotRunningError
        self.frame, self.waited = self.frame + 1, True
        self.time += PERIOD * (1 + self.missed.get(self.frame, 0))
        shown = self.should_render and self.state in ("VISIBLE", "FOCUSED")
        return types.SimpleNamespace(
            predicted_display_time=self.time, predicted_display_period=PERIOD, should_render=shown
        )

    def begin_frame(self, session):
        if not self.waited:
            raise self._real.CallOrderInvalidError
        self.waited, discarded, self.begun = False, self.begun, True
        if discarded:
            raise self._real.FrameDiscarded

    def end_frame(self, session, info):
        if not self.begun:
            raise self._real.CallOrderInvalidError
        self.begun = False
        layers = []
        for k in range(info.layer_count):
            layer = ctypes.cast(info.layers[k], ctypes.POINTER(self._real.CompositionLayerProjection)).contents
            if layer.type == self._real.StructureType.COMPOSITION_LAYER_PROJECTION:
                layers.append([self._view(layer.views[v]) for v in range(layer.view_count)])
            else:
                layers.append(layer.type.name)
        if info.display_time != self.time:
            raise self._real.TimeInvalidError
        self.ended.append((self.frame, layers))
