"""A session's life, by the specification: its states, its frames, where head and eyes are.

IDLE -> READY (begin) -> SYNCHRONIZED -> VISIBLE -> FOCUSED, and back -> STOPPING (end) -> IDLE -> EXITING, LOSS_PENDING
"""

from __future__ import annotations

import contextlib
import ctypes

import numpy as np

from display.headset.actions import Actions
from display.headset.eyes import Eyes
from display.headset.panel_layer import PanelLayer
from display.headset.panel_paint import content_of
from display.headset.poses import matrix_of


class Lost(Exception):
    """The session or the runtime is gone; another one may come."""


class Session:
    """One session with its play space, eyes and actions. Raises Lost where the runtime goes away."""

    def __init__(self, runtime, gl, binding, size: tuple[int, int]):
        self.runtime, self.xr = runtime, runtime.xr
        xr = self.xr
        self.running = False
        self.over: str | None = None  # "exit": the user wants it so; "lost"
        pointer = ctypes.cast(ctypes.pointer(binding), ctypes.c_void_p)
        self.handle = xr.create_session(runtime.instance, xr.SessionCreateInfo(system_id=runtime.system, next=pointer))
        kinds = [xr.ReferenceSpaceType(k) for k in xr.enumerate_reference_spaces(self.handle)]
        self.standing = xr.ReferenceSpaceType.STAGE in kinds  # else y = 0 is where the head was, not the floor
        kind = xr.ReferenceSpaceType.STAGE if self.standing else xr.ReferenceSpaceType.LOCAL
        self.space = xr.create_reference_space(self.handle, xr.ReferenceSpaceCreateInfo(reference_space_type=kind))
        self.actions = Actions(runtime, self.handle)
        self.eyes = Eyes(runtime, self.handle, gl, size, len(runtime.views))
        self.panel = PanelLayer(runtime, self.handle, gl)
        self._views = None  # of the frame that is drawn now

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
        """The call's result; Lost if the runtime says that session or instance are."""
        xr = self.xr
        try:
            return call()
        except (xr.SessionLostError, xr.InstanceLostError, xr.SessionLossPending) as e:
            self.over, self.running = "lost", False
            raise Lost(str(e)) from e

    def wait(self):
        """Wait until the runtime wants the next frame, and begin it; its XrFrameState."""
        xr = self.xr
        state = self.guarded(lambda: xr.wait_frame(self.handle))
        with contextlib.suppress(xr.FrameDiscarded):  # the last one was never ended; this one counts
            self.guarded(lambda: xr.begin_frame(self.handle))
        return state

    def locate(self, time: int) -> list[tuple[np.ndarray, object]]:
        """(eye to play space (4, 4), XrFovf) of each eye at `time`, as well as the runtime knows now."""
        xr = self.xr
        how = xr.ViewLocateInfo(
            view_configuration_type=xr.ViewConfigurationType.PRIMARY_STEREO, display_time=time, space=self.space
        )
        state, views = self.guarded(lambda: xr.locate_views(self.handle, how))
        both = xr.ViewStateFlags.ORIENTATION_VALID_BIT | xr.ViewStateFlags.POSITION_VALID_BIT
        if state.view_state_flags & both == both or self._views is None:
            self._views = views  # else the head stays where it was seen last
        return [(matrix_of(v.pose), v.fov) for v in self._views]

    def show(self, texture) -> list:
        """Draw the picture, in which all eyes lie one below the other; the layers to end the frame with."""
        self.guarded(lambda: self.eyes.draw(texture))
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
            environment_blend_mode=self.runtime.blend_mode,
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
        self.panel.close()
        handle, self.handle = self.handle, None
        with contextlib.suppress(self.xr.exception.ResultException):  # it may be gone already
            self.xr.destroy_session(handle)
