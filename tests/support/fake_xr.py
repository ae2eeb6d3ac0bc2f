"""A made-up OpenXR runtime: the module `xr` with its own structures, but every function answered here.

It holds a program to the specification: the states of a session follow each other as drawn in its chapter "Session
lifecycle", frames are waited for, begun and ended in this order, swapchain images acquired, waited for and released,
handles not used after they are destroyed, and rectangles lie within their textures. A violation is answered with the
specification's error. A script says what happens when: see FakeXr.
"""

import ctypes
import itertools
from types import MethodType
from types import SimpleNamespace as N

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
}
IDENTITY = (0.0, 0.0, 0.0, 1.0)


class FakeSwapchain:
    """Three images; who draws must have acquired one and waited for it."""

    def __init__(self, size: tuple[int, int], texture_format: int, images: list[int]):
        self.size, self.format, self.images = size, texture_format, images
        self.held: list[list] = []  # [index, "acquired" or "waited"]
        self.turn = itertools.cycle(range(3))


class FakeXr:
    """Stands for the module xr.

    script      {frame: [what happens before it]}: a state's name, "INSTANCE_LOSS_PENDING", or a function of the fake.
                Frames count over all sessions, from 1; a frame that is waited for while none is due is not counted.
    failures    {function: (from which call on, name of the exception[, how often])}
    missed      {frame: how many periods it is late}
    images      function (width, height, format) that makes an image of a swapchain
    head, hands {side: pose}: (x, y, z, w), (x, y, z); `valid` which are tracked ("head", "left", "right")
    ended       (frame, layers) of each frame that was ended; `pulses` (side, strength)
    """

    def __init__(self, *, script=None, failures=None, missed=None, extensions=EXTENSIONS, formats=FORMATS, images=None):
        import xr

        self._real, self.script, self.failures = xr, dict(script or {}), dict(failures or {})
        self.missed, self.extensions, self.formats = dict(missed or {}), extensions, formats
        self.calls: list[str] = []
        self.counts: dict[str, int] = {}
        self.pulses, self.ended = [], []
        self.valid, self.kinds = {"head", "left", "right"}, {"orientation", "position"}
        self.head, self.hands = (IDENTITY, (0.0, 1.6, 0.0)), {}
        self.squeeze = {"left": 0.0, "right": 0.0}
        self.pressed: set[tuple[str, str]] = set()  # (action, side)
        self.frame, self.time, self.size, self.should_render = 0, 10**12, (64, 48), True
        self.alive: set[int] = set()
        self._images = images or (lambda width, height, texture_format: 0)
        self._numbers, self._names = itertools.count(16), {}
        self._start_session()

    def _start_session(self) -> None:
        self.state, self.events, self.running, self.waited, self.begun = "UNKNOWN", [], False, False, False
        self.swapchains: dict[int, FakeSwapchain] = {}
        self.exit_asked = False

    def __getattr__(self, name: str):
        return getattr(self._real, name)

    def __getattribute__(self, name: str):
        """Functions of the runtime are counted, and fail where `failures` wants it."""
        found = object.__getattribute__(self, name)
        if not isinstance(found, MethodType) or name.startswith("_") or name in ("enter", "formats_made", "view_of"):
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
        self._require(number in self.alive, "HandleInvalidError")
        return number

    def _require(self, condition, error: str) -> None:
        if not condition:
            raise getattr(self._real, error)

    # Events of the play.

    def enter(self, *states: str) -> None:
        """Let the session go through these states."""
        for state in states:
            assert state in NEXT.get(self.state, ()) or state == "LOSS_PENDING", f"from {self.state} to {state}"
            self.state = state
            self.events.append(self._real.EventDataSessionStateChanged(state=self._real.SessionState[state]))

    def poll_event(self, instance):
        self._number(instance)
        if self.state == "UNKNOWN" and "create_session" in self.calls:
            self.enter("IDLE", "READY")
        for what in self.script.pop(self.frame + 1, []):
            if callable(what):
                what(self)
            elif what == "INSTANCE_LOSS_PENDING":
                self.events.append(self._real.EventDataInstanceLossPending())
            else:
                self.enter(what)
        self._require(self.events, "EventUnavailable")
        buffer, event = self._real.EventDataBuffer(), self.events.pop(0)
        ctypes.memmove(ctypes.byref(buffer), ctypes.byref(event), ctypes.sizeof(event))
        return buffer

    # The instance.

    def enumerate_instance_extension_properties(self):
        return [N(extension_name=name.encode()) for name in self.extensions]

    def create_instance(self, info):
        self._start_session()
        return self._handle("Instance")

    def destroy_instance(self, instance):
        self.alive.remove(self._number(instance))

    def get_instance_properties(self, instance):
        return N(runtime_name=b"Fake", runtime_version=1 << 48)

    def get_system(self, instance, info):
        self._number(instance)
        return 1

    def enumerate_view_configuration_views(self, instance, system, kind):
        width, height = self.size
        return [N(recommended_image_rect_width=width, recommended_image_rect_height=height)] * 2

    def enumerate_environment_blend_modes(self, instance, system, kind):
        return [self._real.EnvironmentBlendMode.OPAQUE]

    def string_to_path(self, instance, text):
        return self._names.setdefault(text, len(self._names) + 1)

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

    # The session.

    def create_session(self, instance, info):
        self._number(instance)
        self._start_session()
        return self._handle("Session")

    def destroy_session(self, session):
        self.alive.remove(self._number(session))
        self.running = False

    def begin_session(self, session, info):
        self._require(not self.running, "SessionRunningError")
        self._require(self.state == "READY", "SessionNotReadyError")
        self.running = True
        self.enter("SYNCHRONIZED", "VISIBLE", "FOCUSED")

    def end_session(self, session):
        self._require(self.running, "SessionNotRunningError")
        self._require(self.state == "STOPPING", "SessionNotStoppingError")
        self.running = False
        self.enter("IDLE", *(["EXITING"] if self.exit_asked else []))

    def request_exit_session(self, session):
        self._require(self.running, "SessionNotRunningError")
        self.exit_asked = True
        down = ["FOCUSED", "VISIBLE", "SYNCHRONIZED", "STOPPING"]
        self.enter(*down[down.index(self.state) + 1 :])

    def wait_frame(self, session):
        self._require(self.running, "SessionNotRunningError")
        self.frame, self.waited = self.frame + 1, True
        self.time += PERIOD * (1 + self.missed.get(self.frame, 0))
        shown = self.should_render and self.state in ("VISIBLE", "FOCUSED")
        return N(predicted_display_time=self.time, predicted_display_period=PERIOD, should_render=shown)

    def begin_frame(self, session):
        self._require(self.waited, "CallOrderInvalidError")
        self.waited, discarded, self.begun = False, self.begun, True
        self._require(not discarded, "FrameDiscarded")

    def end_frame(self, session, info):
        self._require(self.begun, "CallOrderInvalidError")
        self.begun, layers = False, []
        for k in range(info.layer_count):
            layer = ctypes.cast(info.layers[k], ctypes.POINTER(self._real.CompositionLayerProjection)).contents
            if layer.type == self._real.StructureType.COMPOSITION_LAYER_PROJECTION:
                layers.append([self.view_of(layer.views[v]) for v in range(layer.view_count)])
            else:
                layers.append(layer.type.name)
        self._require(info.display_time == self.time, "TimeInvalidError")
        self.ended.append((self.frame, layers))

    # Poses and actions.

    def locate_views(self, session, info):
        xr, flags = self._real, self._real.ViewStateFlags
        known, views = flags.NONE, []
        if "head" in self.valid:
            known |= flags.ORIENTATION_VALID_BIT if "orientation" in self.kinds else flags.NONE
            known |= flags.POSITION_VALID_BIT if "position" in self.kinds else flags.NONE
        for _ in range(2):
            view = xr.View()
            view.fov = xr.Fovf(-0.7, 0.7, 0.7, -0.7)
            fill(view.pose, *(self.head if "head" in self.valid else ((0.0,) * 4, (0.0,) * 3)))
            views.append(view)
        return N(view_state_flags=known), views

    def enumerate_reference_spaces(self, session):
        return [self._real.ReferenceSpaceType.LOCAL, self._real.ReferenceSpaceType.STAGE]

    def create_reference_space(self, session, info):
        return self._handle("Space")

    def create_action_set(self, instance, info):
        return self._handle("ActionSet")

    def create_action(self, action_set, info):
        handle = self._handle("Action")
        self._names[self._number(handle)] = info.action_name.decode()
        return handle

    def suggest_interaction_profile_bindings(self, instance, suggestion):
        pass

    def attach_session_action_sets(self, session, info):
        pass

    def create_action_space(self, session, info):
        handle = self._handle("Space")
        self._names[self._number(handle)] = self._side(info)
        return handle

    def sync_actions(self, session, info):
        self._require(self.state == "FOCUSED", "SessionNotFocused")

    def _side(self, info) -> str:
        paths = {self._names.get(f"/user/hand/{side}"): side for side in ("left", "right")}
        return paths[info.subaction_path]

    def _action(self, info) -> tuple[str, str]:
        return self._names[self._number(info.action)], self._side(info)

    def get_action_state_float(self, session, info):
        name, side = self._action(info)
        return N(current_state=self.squeeze[side] if name == "grab" else 0.0)

    def get_action_state_vector2f(self, session, info):
        return N(current_state=N(x=0.0, y=0.0))

    def get_action_state_boolean(self, session, info):
        return N(current_state=self._action(info) in self.pressed, changed_since_last_sync=True)

    def locate_space(self, space, base, time):
        flags, side = self._real.SpaceLocationFlags, self._names[self._number(space)]
        location = N(pose=self._real.Posef(), location_flags=flags.NONE)
        if side in self.valid:
            fill(location.pose, *self.hands.get(side, (IDENTITY, (0.2, 1.2, -0.3))))
            location.location_flags = flags.ORIENTATION_VALID_BIT | flags.POSITION_VALID_BIT
        return location

    def apply_haptic_feedback(self, session, info, vibration):
        self._require(self.state == "FOCUSED", "SessionNotFocused")
        self.pulses.append((self._side(info), vibration.amplitude))

    # Swapchains.

    def enumerate_swapchain_formats(self, session):
        return list(self.formats)

    def formats_made(self) -> list[int]:
        """Formats of all swapchains of the session."""
        return [chain.format for chain in self.swapchains.values()]

    def create_swapchain(self, session, info):
        self._require(info.format in self.formats, "SwapchainFormatUnsupportedError")
        handle = self._handle("Swapchain")
        images = [self._images(info.width, info.height, info.format) for _ in range(3)]
        self.swapchains[self._number(handle)] = FakeSwapchain((info.width, info.height), info.format, images)
        return handle

    def destroy_swapchain(self, chain):
        self.alive.remove(self._number(chain))

    def enumerate_swapchain_images(self, chain, kind):
        return [N(image=image) for image in self.swapchains[self._number(chain)].images]

    def acquire_swapchain_image(self, chain, info):
        c = self.swapchains[self._number(chain)]
        c.held.append([next(c.turn), "acquired"])
        return c.held[-1][0]

    def wait_swapchain_image(self, chain, info):
        c = self.swapchains[self._number(chain)]
        self._require(c.held and c.held[0][1] == "acquired", "CallOrderInvalidError")
        c.held[0][1] = "waited"

    def release_swapchain_image(self, chain, info):
        c = self.swapchains[self._number(chain)]
        self._require(c.held and c.held[0][1] == "waited", "CallOrderInvalidError")
        c.held.pop(0)

    def view_of(self, view) -> dict:
        """A view of the projection layer: its rectangle, and that of its depth with near and far."""
        seen = {"rectangle": self._rectangle(view.sub_image)}
        if view.next:
            kind = ctypes.POINTER(self._real.CompositionLayerDepthInfoKHR)
            info = ctypes.cast(ctypes.c_void_p(view.next), kind).contents
            assert info.type == self._real.StructureType.COMPOSITION_LAYER_DEPTH_INFO_KHR
            seen |= {"depth": self._rectangle(info.sub_image), "near": info.near_z, "far": info.far_z}
        return seen

    def _rectangle(self, image) -> tuple[int, ...]:
        chain = self.swapchains[self._number(image.swapchain)]
        (x, y), (width, height) = tuple(image.image_rect.offset), tuple(image.image_rect.extent)
        inside = x >= 0 and y >= 0 and x + width <= chain.size[0] and y + height <= chain.size[1]
        self._require(inside and not chain.held, "SwapchainRectInvalidError")
        return x, y, width, height


def fill(pose, rotation, position) -> None:
    """Set an XrPosef to (x, y, z, w) and (x, y, z)."""
    pose.orientation[:] = list(rotation)
    pose.position[:] = list(position)
