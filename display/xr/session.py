"""A session's life, by the specification: its states, its frames, where head and eyes are.

IDLE -> READY (begin) -> SYNCHRONIZED -> VISIBLE -> FOCUSED, and back -> STOPPING (end) -> IDLE -> EXITING, LOSS_PENDING
"""

from __future__ import annotations

import contextlib
import ctypes

import numpy as np

from display.xr.actions import Actions
from display.xr.eye_swapchains import Eyes
from display.xr.hand_tracking import HandTracking, Sides
from display.xr.panel_layer import PanelLayer
from display.xr.panel_paint import content_of
from display.xr.poses import matrix_of

HEIGHT = 1.6  # [m] of a head over the floor, until it is seen


class Lost(Exception):
    """The session or the runtime is gone; another one may come."""


class Session:
    """One session with its play space, eyes and actions.

    `running`: frames are wanted. `focused`: the player's input is ours. `tracked`: it is known where the head is.
    Raises Lost where the runtime goes away, or fails in a frame: then another session may do better.
    """

    def __init__(self, runtime, gl, binding, size: tuple[int, int]):
        self.runtime, self.xr = runtime, runtime.xr
        xr = self.xr
        self.running = self.focused = False
        self.tracked = True
        self.over: str | None = None  # "exit": the user wants it so; "lost"
        self.why = "it ends the session"  # if it is lost
        pointer = ctypes.cast(ctypes.pointer(binding), ctypes.c_void_p)
        self.handle = xr.create_session(runtime.instance, xr.SessionCreateInfo(system_id=runtime.system, next=pointer))
        try:
            self._furnish(gl, size)
        except BaseException:
            with contextlib.suppress(xr.exception.ResultException):
                xr.destroy_session(self.handle)
            raise
        self._views = None  # of the frame that is drawn now

    def _furnish(self, gl, size: tuple[int, int]) -> None:
        xr, runtime = self.xr, self.runtime
        kinds = [xr.ReferenceSpaceType(k) for k in xr.enumerate_reference_spaces(self.handle)]
        self.standing = xr.ReferenceSpaceType.STAGE in kinds  # else y = 0 is where the head was, not the floor
        kind = xr.ReferenceSpaceType.STAGE if self.standing else xr.ReferenceSpaceType.LOCAL
        self.space = xr.create_reference_space(self.handle, xr.ReferenceSpaceCreateInfo(reference_space_type=kind))
        self.actions = Actions(runtime, self.handle)
        self.eyes = Eyes(runtime, self.handle, gl, size, len(runtime.views))
        self.hands, self._sides = self._hands(), Sides()
        self.panel = PanelLayer(runtime, self.handle, gl)

    def _hands(self) -> HandTracking | None:
        """The hands' trackers; none where a runtime that promised them does not give them."""
        try:
            return HandTracking(self.runtime, self.handle) if self.runtime.has_hands else None
        except self.xr.exception.ResultException:
            return None

    def inputs(self, time: int) -> list:
        """What plays on each side at `time` [XrTime], a controller or a hand: display/xr/hand_tracking.py."""
        return self.guarded(lambda: self._inputs(time))

    def _inputs(self, time: int) -> list:
        hands = self.hands.read(self.space, time) if self.hands is not None else [None, None]
        return self._sides.choose(self.actions.read(self.space, time), hands, time * 1e-9)

    def poll(self) -> None:
        """Follow what the runtime says has happened."""
        xr = self.xr
        for event in self.guarded(lambda: list(self.runtime.events())):
            if isinstance(event, xr.EventDataInstanceLossPending):
                self.over = "lost"
            elif isinstance(event, xr.EventDataSessionStateChanged):
                self._enter(xr.SessionState(event.state))

    def _enter(self, state) -> None:
        xr = self.xr
        S = xr.SessionState
        self.focused = state == S.FOCUSED
        if state == S.READY:
            how = xr.SessionBeginInfo(xr.ViewConfigurationType.PRIMARY_STEREO)
            self.guarded(lambda: xr.begin_session(self.handle, how))
            self.running = True
        elif state == S.STOPPING:
            self.running = False
            self.guarded(lambda: xr.end_session(self.handle))
        elif state == S.EXITING:
            self.over = "exit"
        elif state == S.LOSS_PENDING:
            self.over, self.running = "lost", False

    def guarded(self, call):
        """The call's result; Lost if the runtime says that session or instance are, or cannot do what it must."""
        try:
            return call()
        except self.xr.exception.ResultException as e:
            self.over, self.running, self.why = "lost", False, type(e).__name__
            raise Lost(self.why) from e

    def wait(self):
        """Wait until the runtime wants the next frame, and begin it; its XrFrameState."""
        xr = self.xr
        state = self.guarded(lambda: xr.wait_frame(self.handle))

        def begin():
            with contextlib.suppress(xr.FrameDiscarded):  # the last one was never ended; this one counts
                xr.begin_frame(self.handle)

        self.guarded(begin)
        return state

    def locate(self, time: int) -> list[tuple[np.ndarray, object]]:
        """(eye to play space (4, 4), XrFovf) of each eye at `time`, as well as the runtime knows now."""
        xr = self.xr
        how = xr.ViewLocateInfo(
            view_configuration_type=xr.ViewConfigurationType.PRIMARY_STEREO, display_time=time, space=self.space
        )
        state, views = self.guarded(lambda: xr.locate_views(self.handle, how))
        turned, placed = xr.ViewStateFlags.ORIENTATION_VALID_BIT, xr.ViewStateFlags.POSITION_VALID_BIT
        known = state.view_state_flags & (turned | placed)
        self.tracked = known == turned | placed
        if self._views is None and not self.tracked:  # nobody has seen the head yet: it looks ahead
            for view in views:
                view.pose = xr.Posef()
                view.pose.position.y = HEIGHT if self.standing else 0.0
            self._views = views
        elif self.tracked:
            self._views = views
        elif known == turned:  # else the head stays where it was seen last
            for view, seen in zip(self._views, views, strict=True):
                view.pose.orientation, view.fov = seen.pose.orientation, seen.fov
        return [(matrix_of(v.pose), v.fov) for v in self._views]

    def show(self, texture, size: tuple[int, int]) -> list:
        """Draw the picture, in which all eyes, of `size` [px], lie one below the other; the layers to end the frame."""
        self.guarded(lambda: self.eyes.draw(texture, size))
        return [self.eyes.layer(self.space, self._views)]

    def show_panel(self, panel, world) -> list:
        """The layer of the panel over the left hand (a WristPanel), if it is to be seen."""
        if panel.pose is None:
            return []
        self.guarded(lambda: self.panel.show(content_of(world, panel)))
        return [self.panel.layer(self.space, panel.pose)]

    def end(self, time: int, layers: list) -> None:
        """End the frame that `wait` began, with or without something to show."""
        xr = self.xr
        how = xr.FrameEndInfo(
            display_time=time,
            environment_blend_mode=self.runtime.blend,
            layers=[ctypes.byref(layer) for layer in layers],
        )
        self.guarded(lambda: xr.end_frame(self.handle, how))

    def leave(self) -> None:
        """Ask the runtime to end the session; it answers with states."""
        try:
            self.xr.request_exit_session(self.handle)
        except self.xr.exception.ResultException:
            self.over = self.over or "exit"

    def close(self) -> None:
        """Give everything back. Further calls do nothing."""
        if self.handle is None:
            return
        self.eyes.close()
        if self.hands is not None:
            self.hands.close()
        self.panel.close()
        handle, self.handle = self.handle, None
        with contextlib.suppress(self.xr.exception.ResultException):  # it may be gone already
            self.xr.destroy_session(handle)
