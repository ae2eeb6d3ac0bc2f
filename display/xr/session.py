"""The XrSession: its states, its frames, head and eye poses, and messages to the user when something about it changes.

IDLE -> READY (begin) -> SYNCHRONIZED -> VISIBLE -> FOCUSED, and back -> STOPPING (end) -> IDLE -> EXITING, LOSS_PENDING
"""

from __future__ import annotations

import contextlib
import ctypes
import sys
import time as clock

import numpy as np

from core.errors import BadInput
from display.xr.actions import ActionSet, Controller
from display.xr.hand_tracking import HandTrackers, InputSelector
from display.xr.poses import matrix_of
from display.xr.swapchains import EyeSwapchains
from display.xr.wrist_panel import PanelContent, PanelLayer

DEFAULT_HEAD_HEIGHT = 1.6  # [m] over the floor, until the head is tracked
UNWORN_DELAY = 2.0  # [s] before the user is asked to put on a headset that has not been worn yet
TAKEN_OFF_DELAY = 0.2  # [s] without a frame until a headset counts as taken off
MAX_LOSSES, LOSS_WINDOW = 5, 60.0  # losses of the runtime within this time [s] until it is given up


class SessionLost(Exception):
    """The session or the runtime is gone; another one may come."""


class XrSession:
    """One session with its reference space, eye swapchains, actions, hand trackers and panel layer.

    `running`: the runtime wants frames. `focused`: the user's input is ours. `tracked`: the head's pose is known.
    `has_floor`: y = 0 of the reference space is the floor (STAGE), not where the head was (LOCAL). `over` is "exit"
    when the user or the system ended the session, "lost" (`why`) when it broke. Raises SessionLost where the runtime
    goes away, or fails in a frame: another session may do better.
    """

    def __init__(self, runtime, gl, binding, size: tuple[int, int]):
        self.runtime, self.xr = runtime, runtime.xr
        xr = self.xr
        self.running = self.focused = False
        self.tracked = True
        self.over: str | None = None
        self.why = "it ends the session"
        self._views = None  # of the frame that is drawn now
        pointer = ctypes.cast(ctypes.pointer(binding), ctypes.c_void_p)
        self.handle = xr.create_session(runtime.instance, xr.SessionCreateInfo(system_id=runtime.system, next=pointer))
        try:
            kinds = [xr.ReferenceSpaceType(k) for k in xr.enumerate_reference_spaces(self.handle)]
            self.has_floor = xr.ReferenceSpaceType.STAGE in kinds
            kind = xr.ReferenceSpaceType.STAGE if self.has_floor else xr.ReferenceSpaceType.LOCAL
            self.space = xr.create_reference_space(self.handle, xr.ReferenceSpaceCreateInfo(reference_space_type=kind))
            self.actions = ActionSet(runtime, self.handle)
            self._eyes = EyeSwapchains(runtime, self.handle, gl, size, len(runtime.view_sizes))
            self._trackers, self._selector = HandTrackers(runtime, self.handle), InputSelector()
            self._panel = PanelLayer(runtime, self.handle, gl)
        except BaseException:
            with contextlib.suppress(xr.exception.ResultException):
                xr.destroy_session(self.handle)
            raise

    @property
    def has_depth(self) -> bool:
        """True if the runtime takes the pictures' depth."""
        return self._eyes.has_depth

    def guarded(self, call):
        """Result of `call()`; SessionLost if the runtime reports a loss, or fails."""
        try:
            return call()
        except self.xr.exception.ResultException as e:
            self.over, self.running, self.why = "lost", False, type(e).__name__
            raise SessionLost(self.why) from e

    def poll(self) -> None:
        """Follow the runtime's events."""
        xr = self.xr
        for event in self.guarded(lambda: list(self.runtime.events())):
            if isinstance(event, xr.EventDataInstanceLossPending):
                self.over = "lost"
            elif isinstance(event, xr.EventDataSessionStateChanged):
                self._enter(xr.SessionState(event.state))

    def _enter(self, state) -> None:
        xr, State = self.xr, self.xr.SessionState
        self.focused = state == State.FOCUSED
        if state == State.READY:
            info = xr.SessionBeginInfo(xr.ViewConfigurationType.PRIMARY_STEREO)
            self.guarded(lambda: xr.begin_session(self.handle, info))
            self.running = True
        elif state == State.STOPPING:
            self.running = False
            self.guarded(lambda: xr.end_session(self.handle))
        elif state == State.EXITING:
            self.over = "exit"
        elif state == State.LOSS_PENDING:
            self.over, self.running = "lost", False

    def wait_frame(self):
        """Wait until the runtime wants the next frame, and begin it; its XrFrameState."""
        xr = self.xr
        state = self.guarded(lambda: xr.wait_frame(self.handle))

        def begin():
            with contextlib.suppress(xr.FrameDiscarded):  # the last one was never ended; this one counts
                xr.begin_frame(self.handle)

        self.guarded(begin)
        return state

    def inputs(self, time: int) -> list[Controller]:
        """Input of each side at `time` [XrTime]: a controller or a bare hand."""

        def read():
            controllers, hands = self.actions.read(self.space, time), self._trackers.read(self.space, time)
            return self._selector.choose(controllers, hands, time * 1e-9)

        return self.guarded(read)

    def locate_views(self, time: int) -> list[tuple[np.ndarray, object]]:
        """Pose in the reference space (4, 4) and XrFovf of each eye at `time`, as well as the runtime knows now."""
        xr = self.xr
        info = xr.ViewLocateInfo(
            view_configuration_type=xr.ViewConfigurationType.PRIMARY_STEREO, display_time=time, space=self.space
        )
        state, views = self.guarded(lambda: xr.locate_views(self.handle, info))
        orientation, position = xr.ViewStateFlags.ORIENTATION_VALID_BIT, xr.ViewStateFlags.POSITION_VALID_BIT
        valid = state.view_state_flags & (orientation | position)
        self.tracked = valid == orientation | position
        if self._views is None and not self.tracked:  # the head has not been tracked yet: it looks ahead
            for view in views:
                view.pose = xr.Posef()
                view.pose.position.y = DEFAULT_HEAD_HEIGHT if self.has_floor else 0.0
            self._views = views
        elif self.tracked:
            self._views = views
        elif valid == orientation:  # else the head stays where it was tracked last
            for view, found in zip(self._views, views, strict=True):
                view.pose.orientation, view.fov = found.pose.orientation, found.fov
        return [(matrix_of(v.pose), v.fov) for v in self._views]

    def projection_layer(self, texture, size: tuple[int, int]):
        """The layer of a picture in which the eyes' views, of `size` [px], lie one below the other."""
        self.guarded(lambda: self._eyes.draw(texture, size))
        return self._eyes.layer(self.space, self._views)

    def panel_layer(self, content: PanelContent, pose: np.ndarray):
        """The layer of the panel over the left hand, at `pose` (4, 4)."""
        self.guarded(lambda: self._panel.show(content))
        return self._panel.layer(self.space, pose)

    def end_frame(self, time: int, layers: list) -> None:
        """End the frame that `wait_frame` began, with or without layers to show."""
        xr = self.xr
        info = xr.FrameEndInfo(
            display_time=time,
            environment_blend_mode=self.runtime.blend_mode,
            layers=[ctypes.byref(layer) for layer in layers],
        )
        self.guarded(lambda: xr.end_frame(self.handle, info))

    def leave(self, timeout: float) -> None:
        """End a running session as the specification wants it: ask, then follow the states, for `timeout` [s]."""
        end = clock.monotonic() + timeout
        if not self.running or self.over == "lost":
            return
        try:
            self.xr.request_exit_session(self.handle)
        except self.xr.exception.ResultException:
            return
        with contextlib.suppress(SessionLost):
            while self.over is None and clock.monotonic() < end:
                self.poll()
                if self.running:
                    self.end_frame(self.wait_frame().predicted_display_time, [])
                else:
                    clock.sleep(0.01)

    def close(self) -> None:
        """Give everything back. Further calls do nothing."""
        if self.handle is None:
            return
        self._eyes.close()
        self._trackers.close()
        self._panel.close()
        handle, self.handle = self.handle, None
        with contextlib.suppress(self.xr.exception.ResultException):  # it may be gone already
            self.xr.destroy_session(handle)


class StatusMessages:
    """Lines on stderr when something about the headset changes: one line each, once."""

    def __init__(self):
        self._resting_since: float | None = None
        self._has_played = self._told = False
        self._focused: bool | None = None
        self._tracked = True
        self._losses: list[float] = []

    def tell(self, line: str) -> None:
        """Print one line."""
        print(line, file=sys.stderr, flush=True)

    def rest(self) -> None:
        """Note that the runtime wants no frames."""
        now = clock.monotonic()
        if self._resting_since is None:
            self._resting_since, self._told, self._focused = now, False, None
        if not self._told and now - self._resting_since > (TAKEN_OFF_DELAY if self._has_played else UNWORN_DELAY):
            self._told = True
            self.tell("headset taken off: paused" if self._has_played else "put the headset on to begin")

    def frame(self, session: XrSession) -> None:
        """Note the beginning of a frame."""
        if self._told and self._has_played:
            self.tell("headset put on: playing again")
        self._resting_since, self._has_played, self._told = None, True, False
        if session.focused != self._focused and self._focused is not None:
            waits = "another program has the input: your hands wait"
            self.tell("the input is back" if session.focused else waits)
        if session.focused or self._focused is not None:  # at the start it takes a few frames
            self._focused = session.focused
        if session.tracked != self._tracked:
            self._tracked = session.tracked
            self.tell("head tracking is back" if self._tracked else "head tracking lost: the view stays where it was")

    def lost(self, name: str, why: str) -> None:
        """Note the loss of the runtime. Raises BadInput if it happens again and again."""
        now = clock.monotonic()
        self._losses = [at for at in self._losses if now - at < LOSS_WINDOW] + [now]
        if len(self._losses) >= MAX_LOSSES:
            raise BadInput(f"--xr: {name} fails again and again ({why}); restart it, or play without --xr")
        self._focused = None
        self.tell(f"lost the headset's runtime ({why}); waiting for it to come back")
