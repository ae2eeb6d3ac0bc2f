"""The display of a headset: the world in stereo around the player, both hands in it, a mirror on the desktop."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Iterator

import numpy as np

from core.errors import BadInput
from display.clock import Clock
from display.edit.selection_marker import marked
from display.protocol import Command, Frame, WorldView
from display.window.gl_window import has_display
from display.xr import avatar as shown_parts
from display.xr import graphics_binding as graphics
from display.xr.depth_layer import EXTENSION
from display.xr.dynamic_resolution import DynamicResolution
from display.xr.mirror import mirror
from display.xr.openxr_runtime import INSTEAD, Runtime
from display.xr.player import TAP, Player
from display.xr.pose_filter import PoseFilter
from display.xr.poses import eye_camera
from display.xr.session import Lost, Session
from display.xr.status_log import StatusLog
from display.xr.wrist_panel import WristPanel
from scenes.scene import Scene

PATIENCE = 60.0  # [s] for a runtime that went away to come back
STOPPING = 3.0  # [s] at most for a runtime to say goodbye
SMALLEST, LARGEST = 16, 8192  # [px] a side, of an eye's picture


class Headset:
    """A display: `for frame in headset.frames(world): world.step(frame); headset.present(world)`.

    `size` is that of one eye's picture [px]: the runtime's wish times `scale`; where the rate does not hold, smaller
    ones are drawn (display/xr/dynamic_resolution.py). Raises BadInput, with one clear line,
    where there is no runtime, no headset or no OpenGL.
    """

    views = 2
    marks = True  # is the body that edits mean marked in the picture

    def __init__(
        self, scene: Scene, *, title: str = "VR-GS", window: tuple[int, int] = (1280, 720), scale: float = 1.0
    ):
        self._session = self._mirror = self._deep = None
        self._needed = graphics.extensions(has_display())
        self._runtime = Runtime(self._needed)
        try:
            self._mirror = mirror(scene, title, window, self.views)
            graphics.check(self._runtime, self._mirror.gl)
            width, height = np.max(self._runtime.views, axis=0)
            self.size = tuple(int(np.clip(round(side * scale), SMALLEST, LARGEST)) for side in (width, height))
            self._resolution = DynamicResolution(self.size)
            self._open()
        except BaseException:
            self.close()
            raise
        self._player, self._eye_height = Player(scene), float(scene.eye[1])
        self._clock, self._steady, self._news, self._wrist = Clock(), PoseFilter(), StatusLog(), WristPanel()
        self._commands: list[Command] = []
        self._world, self._frame, self._rendered = None, None, False
        print(f"{self._runtime.name}: {self.size[0]}x{self.size[1]} an eye", file=sys.stderr, flush=True)

    def __enter__(self) -> Headset:
        return self

    def __exit__(self, *error) -> None:
        self.close()

    def close(self) -> None:
        """Leave the headset and close the mirror. Further calls do nothing."""
        if self._session is not None:
            self._leave()
            self._session.close()
            self._session = None
        self._runtime.close()
        if self._mirror is not None:
            self._mirror.close()

    @property
    def depth(self) -> bool:
        """Does the runtime take the depth of the picture?"""
        return self._session.eyes.depth is not None

    @staticmethod
    def props() -> list:
        """What World should be able to draw besides the scene: the player's hands and what they hold."""
        return shown_parts.skins()

    def _open(self) -> None:
        """Begin a session; the runtime then says when to play. BadInput if it does not let us."""
        runtime = self._runtime
        if self._deep is False and EXTENSION in runtime.enabled:  # another runtime than the one at the start
            runtime.enabled.remove(EXTENSION)
        try:
            graphics.requirements(runtime)  # the specification wants it asked before each session
            binding = graphics.binding(runtime.xr, self._mirror.egl)
            self._session = Session(runtime, self._mirror.gl, binding, self.size)
        except runtime.xr.exception.ResultException as e:
            raise BadInput(f"--xr: {runtime.name} begins no session ({type(e).__name__}); {INSTEAD}") from e
        self._deep = self._deep or self.depth

    def _leave(self) -> None:
        """End a running session as the specification wants it: ask, then follow the states."""
        session, end = self._session, time.monotonic() + STOPPING
        if not session.running or session.over == "lost":
            return
        session.leave()
        with contextlib.suppress(Lost, self._runtime.xr.exception.ResultException):
            while session.over is None and time.monotonic() < end:
                session.poll()
                if session.running:
                    session.end(session.wait().predicted_display_time, [])
                else:
                    time.sleep(0.01)

    def frames(self, world: WorldView) -> Iterator[Frame]:
        """Frames at the headset's pace until the user quits here or there."""
        self._world = world
        while not self._mirror.closing:
            session = self._session
            try:
                session.poll()
                if session.over == "exit":
                    self._news.tell("the headset's system ends the play")
                    return
                if session.over == "lost":
                    raise Lost(session.why)
                if not session.running:
                    self._rest()
                    continue
                yield self._begin(session)
                if self._frame is not None:  # it was not presented
                    session.end(self._frame.predicted_display_time, [])
            except Lost as e:
                self._clock.rest()
                if not self._return(str(e)):
                    return

    def _begin(self, session) -> Frame:
        """Wait for the next frame, and see what the player does in it."""
        # A runtime without a floor puts y = 0 where the head was: then it stands as high as the scene's eye.
        self._player.standpoint.y = 0.0 if session.standing else self._eye_height
        state = session.wait()
        self._begun = time.perf_counter()
        shown, world = state.predicted_display_time, self._world
        cost = None if world is None else world.simulation_cost
        tick = self._tick = self._clock.advance(shown, state.predicted_display_period, cost)
        controllers = session.inputs(shown)
        self._steady.lead(controllers, tick.dt)
        head = session.locate(shown)[0][0]
        asked = self._wrist.advance(controllers, head, self._player.standpoint.matrix, world)
        hands, commands = self._player.advance(controllers, head, world)
        self._frame, self._rendered = state, bool(state.should_render)
        commands, self._commands = [*self._commands, *commands, *asked], []
        self._news.frame(session)
        cameras = self._cameras if self._rendered else []
        parts = self._player.parts(controllers)
        body = marked(world, near=self._wrist.pose is not None) if world is not None and self.marks else None
        if body is not None:
            shown_parts.corners(parts, body)
        return Frame(tick.dt, self._clock.time, cameras, hands, commands, max_step=tick.max_step, prop_poses=parts)

    def _cameras(self):
        """The eyes' cameras, asked for when the world has moved: the later, the truer to where the head will be."""
        shown, session = self._frame.predicted_display_time, self._session
        try:
            now = session.guarded(self._runtime.now)
            located = session.locate(shown)
        except Lost:  # `frames` sees it, too; until then nothing is drawn
            self._rendered = False
            return []
        if now is not None and self._world is not None:
            self._world.timings.photon.append((shown - now) * 1e-9)
        stage = self._player.standpoint.matrix
        size = self.size if self._world is None else self._world.picture_size
        return [eye_camera(*size, fov, stage @ eye) for eye, fov in located]

    def present(self, world: WorldView) -> None:
        """Show the world's picture in the headset and on the desktop, and let the hands feel what they hold."""
        self._world = world
        frame, self._frame = self._frame, None
        with world.timings.stage("present"):
            try:
                layers = []
                if self._rendered:
                    self._mirror.texture.upload(world.picture)
                    layers = self._session.show(self._mirror.texture.texture, world.picture_size)
                    layers += self._session.show_panel(self._wrist, world)
                self._session.end(frame.predicted_display_time, layers)
                self._session.guarded(lambda: self._feel(world))
            except Lost:
                pass  # `frames` sees it, too
        with world.timings.stage("mirror"):
            self._commands += self._mirror.show(world)
        timings = world.timings
        timings.budget, timings.dropped = self._tick.period, self._clock.dropped
        timings.frame(self._tick.missed)
        if self._rendered:
            self._pace(world)

    def _feel(self, world) -> None:
        self._player.feel(world, self._session.actions)
        if self._wrist.clicked:
            self._session.actions.pulse(1, *TAP)

    def _pace(self, world) -> None:
        """Draw as many pixels from now on as hold the headset's rate, or as the user wants."""
        share = self._mirror.share
        if share is None:
            drawing = world.timings.latest("render", "present")
            self._resolution.note(time.perf_counter() - self._begun, self._tick.period, drawing)
        else:
            self._resolution.hold(share)
        if world.picture_size != self._resolution.size:
            world.resize(*self._resolution.size)

    def _rest(self) -> None:
        """Nobody wears the headset: the world stands still."""
        self._clock.rest()
        self._news.rest()
        self._idle()

    def _idle(self) -> None:
        if self._world is not None:
            self._world.timings.rest()
        self._commands += self._mirror.show(self._world)
        time.sleep(0.05)

    def _return(self, why: str) -> bool:
        """The runtime went away: wait for it, or for another, and go on playing; whether one came. BadInput if it has
        done so too often."""
        self._news.lost(self._runtime.name, why)
        self._session.close()
        self._runtime.close()
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end and not self._mirror.closing:
            try:
                self._runtime = Runtime(self._needed, wait=0.0)
                self._open()
            except BadInput:
                self._runtime.close()
                self._idle()
                time.sleep(0.5)
                continue
            self._news.tell(f"{self._runtime.name} is back")
            return True
        self._news.tell("it did not come back; the play ends")
        return False
