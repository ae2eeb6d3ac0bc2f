"""The headset's display: the world in stereo around the player, both hands in it, and a mirror on the desktop.

The mirror is a window that shows what the left eye sees, or, without a screen, only an OpenGL context.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator

import numpy as np

from core.camera import Camera
from core.errors import BadInput, Cancelled
from display.adaptive_resolution import DynamicResolution
from display.clock import Clock
from display.edit.selection_marker import marked
from display.panel import Panel
from display.protocol import Display, Frame, WorldView
from display.user_commands import Command
from display.window.gl_context import EglContext, PictureTexture
from display.window.gl_window import GLWindow, has_display
from display.xr import avatar
from display.xr.openxr_runtime import HEADSET_TIMEOUT, WINDOW_INSTEAD, OpenXrRuntime, graphics_binding
from display.xr.player import TAP_SECONDS, TAP_STRENGTH, Player, PoseFilter
from display.xr.poses import eye_camera
from display.xr.session import SessionLost, StatusMessages, XrSession
from display.xr.wrist_panel import PanelContent, WristPanel
from render.skinned_props import Skin
from scenes.scene import Scene

RECONNECT_TIMEOUT = 60.0  # [s] for a runtime that went away to come back
LEAVE_TIMEOUT = 3.0  # [s] for a runtime to end the session
MIRROR_SIZE = (1280, 720)  # [px]
MIN_SIDE, MAX_SIDE = 16, 8192  # [px] of an eye's picture


class Mirror:
    """A window that shows what the left eye sees, and the panel; or, not `shown`, only an OpenGL context for `views`.

    gl   its context (moderngl)
    egl  the context of EGL where there is no window
    """

    def __init__(self, title: str, size: tuple[int, int], views: int, *, shown: bool):
        self._surface = GLWindow(title, *size, vsync=False) if shown else None  # the headset sets the rate
        self.egl = None if shown else EglContext()
        self.gl = (self._surface or self.egl).gl
        self.texture = PictureTexture(self.gl, views=views)
        self._panel = None
        if shown:
            from display.window.panel_drawer import PanelDrawer  # ImGui needs libraries that servers may lack

            self._panel = PanelDrawer(title, self._surface.scale, Panel())

    @property
    def closing(self) -> bool:
        """True once the user has asked to close the window."""
        return self._surface is not None and self._surface.closing

    @property
    def resolution(self) -> float | None:
        """Scale of a side of the headset's pictures that the user has chosen; None: what holds the rate."""
        return None if self._panel is None else self._panel.panel.scale

    def show_title(self, title: str) -> None:
        """Give window and panel another title."""
        if self._surface is not None:
            self._surface.set_title(title)
            self._panel.title = title

    def show(self, world: WorldView) -> list[Command]:
        """Draw the picture that was last uploaded, and the panel; the panel's commands."""
        if self._surface is None:
            return []
        self._surface.begin()
        self.texture.draw(self._surface.frame_size)
        commands = self._panel.draw(world, visible=True)
        self._surface.end()
        self._surface.swap()
        return commands

    def close(self) -> None:
        """Close the window or context. Further calls do nothing."""
        (self._surface or self.egl).close()


class Headset(Display):
    """The headset as a display.

    `size` is that of one eye's picture [px]: the runtime's recommendation times `scale`; where the rate does not hold,
    smaller ones are drawn (display/adaptive_resolution.py). `depth`: the runtime takes the pictures' depth. With
    `marks` the selected body is marked in the picture. Raises BadInput, with one clear line, where there is no runtime,
    no headset or no OpenGL.
    """

    views = 2

    def __init__(self, scene: Scene, *, title: str = "VR-GS", scale: float = 1.0, marks: bool = True):
        self._session = self._mirror = None
        self._marks, self._windowed = marks, has_display()
        self._runtime = OpenXrRuntime(windowed=self._windowed, timeout=HEADSET_TIMEOUT)
        try:
            self._mirror = Mirror(title, MIRROR_SIZE, self.views, shown=self._windowed)
            self._runtime.check_opengl(self._mirror.gl)
            recommended = np.max(self._runtime.view_sizes, axis=0)
            self.size = tuple(int(np.clip(round(side * scale), MIN_SIDE, MAX_SIDE)) for side in recommended)
            self._session = self._begin_session()
        except BaseException:
            self.close()
            raise
        self.depth = self._session.has_depth
        self._resolution = DynamicResolution(self.size)
        self._player = Player(scene)
        self._clock, self._filter, self._messages, self._panel = Clock(), PoseFilter(), StatusMessages(), WristPanel()
        self._commands: list[Command] = []  # from the mirror's panel, for the next frame
        self._frame_state = None  # XrFrameState of the frame that has begun
        self._frame_begin = 0.0  # [s] of perf_counter()
        self._tick = None
        print(f"{self._runtime.name}: {self.size[0]}x{self.size[1]} an eye", file=sys.stderr, flush=True)

    def close(self) -> None:
        """Leave the headset and close the mirror. Further calls do nothing."""
        if self._session is not None:
            self._session.leave(LEAVE_TIMEOUT)
            self._session.close()
            self._session = None
        self._runtime.close()
        if self._mirror is not None:
            self._mirror.close()

    @staticmethod
    def props() -> list[Skin]:
        """Props for World to draw besides the scene: the player's avatar."""
        return avatar.skins()

    def _begin_session(self) -> XrSession:
        """A new session; the runtime then says when to play. BadInput if it does not let us."""
        runtime, mirror = self._runtime, self._mirror
        try:
            runtime.lowest_opengl()  # the specification wants it asked before each session
            return XrSession(runtime, mirror.gl, graphics_binding(runtime.xr, mirror.egl), self.size)
        except runtime.xr.exception.ResultException as e:
            raise BadInput(f"--xr: {runtime.name} begins no session ({type(e).__name__}); {WINDOW_INSTEAD}") from e

    def loading(self, text: str, picture=None) -> None:
        """Do nothing: the runtime has its own waiting room until the next frame. Raises Cancelled if the mirror was
        closed."""
        if self._mirror.closing:
            raise Cancelled(quits=True)

    def show_scene(self, scene: Scene, title: str, name: str) -> None:
        """Show this scene from now on, from where it begins; `frames` is then called again, with its world."""
        self._player = Player(scene)
        self._clock.rest()
        self._mirror.show_title(title)
        self._commands = []

    def frames(self, world: WorldView) -> Iterator[Frame]:
        """Frames at the headset's rate until the user quits here or there."""
        while not self._mirror.closing:
            session = self._session
            try:
                session.poll()
                if session.over == "exit":
                    self._messages.tell("the headset's system asks to quit")
                    return
                if session.over == "lost":
                    raise SessionLost(session.why)
                if not session.running:  # the headset is not worn: the world is paused
                    self._clock.rest()
                    self._messages.rest()
                    self._idle(world)
                    continue
                yield self._begin_frame(session, world)
                if self._frame_state is not None:  # it was not presented
                    session.end_frame(self._frame_state.predicted_display_time, [])
            except SessionLost as e:
                self._clock.rest()
                if not self._reconnect(str(e), world):
                    return

    def _begin_frame(self, session: XrSession, world: WorldView) -> Frame:
        """Wait for the next frame and read its input."""
        self._player.stand(on_floor=session.has_floor)
        state = session.wait_frame()
        self._frame_begin = time.perf_counter()
        display_time = state.predicted_display_time
        tick = self._clock.advance(display_time, state.predicted_display_period, world.simulation_cost)
        controllers = session.inputs(display_time)
        controllers = self._filter.apply(controllers, tick.dt)
        head = session.locate_views(display_time)[0][0]
        world_from_play = self._player.play_space.world_from_play
        controllers[1], panel_commands = self._panel.advance(controllers, head, world_from_play, world)
        hands, commands = self._player.advance(controllers, head, world)
        self._tick, self._frame_state = tick, state
        commands, self._commands = [*self._commands, *commands, *panel_commands], []
        self._messages.frame(session)
        poses = self._player.prop_poses(controllers)
        body = marked(world, near=self._panel.pose is not None) if self._marks else None
        if body is not None:
            avatar.show_corners(poses, body)
        cameras = (lambda: self._cameras(world)) if state.should_render else []
        return Frame(tick.dt, self._clock.time, cameras, hands, commands, max_step=tick.max_step, prop_poses=poses)

    def _cameras(self, world: WorldView) -> list[Camera]:
        """The eyes' cameras, located after the world has moved: the later, the better the prediction of the head."""
        display_time, session = self._frame_state.predicted_display_time, self._session
        try:
            now = session.guarded(self._runtime.now)
            located = session.locate_views(display_time)
        except SessionLost:  # `frames` sees it, too; until then nothing is drawn
            return []
        if now is not None:
            world.timings.photon.append((display_time - now) * 1e-9)
        world_from_play = self._player.play_space.world_from_play
        return [eye_camera(*world.picture_size, fov, world_from_play @ eye) for eye, fov in located]

    def present(self, world: WorldView) -> None:
        """Show the world's picture in the headset and on the desktop, and let the hands feel what they hold."""
        state, self._frame_state = self._frame_state, None
        with world.timings.stage("present"):
            try:
                self._session.end_frame(state.predicted_display_time, self._layers(world, state))
                self._session.guarded(lambda: self._feel(world))
            except SessionLost:
                pass  # `frames` sees it, too
        with world.timings.stage("mirror"):
            self._commands += self._mirror.show(world)
        world.timings.frame(self._tick.missed, budget=self._tick.period, dropped=self._clock.dropped)
        if state.should_render:
            self._choose_resolution(world)

    def _layers(self, world: WorldView, state) -> list:
        """Composition layers of the frame: the picture, and over it the panel."""
        session, texture = self._session, self._mirror.texture
        if not state.should_render or session.over == "lost":
            return []
        texture.upload(world.picture)
        layers = [session.projection_layer(texture.texture, world.picture_size)]
        if self._panel.pose is not None:
            layers.append(session.panel_layer(PanelContent.of(world, self._panel), self._panel.pose))
        return layers

    def _feel(self, world: WorldView) -> None:
        self._player.feel(world, self._session.actions)
        if self._panel.clicked:
            self._session.actions.pulse(1, TAP_STRENGTH, TAP_SECONDS)

    def _choose_resolution(self, world: WorldView) -> None:
        """Set the picture's size to what holds the headset's rate, or to what the user chose."""
        scale = self._mirror.resolution
        if scale is None:
            drawing = world.timings.latest("render", "present")
            self._resolution.note(time.perf_counter() - self._frame_begin, self._tick.period, drawing)
        else:
            self._resolution.hold(scale)
        if world.picture_size != self._resolution.size:
            world.resize(*self._resolution.size)

    def _idle(self, world: WorldView) -> None:
        world.timings.rest()
        self._commands += self._mirror.show(world)
        time.sleep(0.05)

    def _reconnect(self, why: str, world: WorldView) -> bool:
        """Wait for the lost runtime or another one; True if one is back. Raises BadInput after too many losses."""
        self._messages.lost(self._runtime.name, why)
        self._session.close()
        self._runtime.close()
        end = time.monotonic() + RECONNECT_TIMEOUT
        while time.monotonic() < end and not self._mirror.closing:
            try:
                # A world that was made without depth has none in its pictures.
                self._runtime = OpenXrRuntime(windowed=self._windowed, timeout=0.0, depth=self.depth)
                self._session = self._begin_session()
            except BadInput:
                self._runtime.close()
                self._idle(world)
                time.sleep(0.5)
                continue
            self._messages.tell(f"{self._runtime.name} is back")
            return True
        self._messages.tell("it did not come back: quitting")
        return False
