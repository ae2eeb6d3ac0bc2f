"""The display of a headset: the world in stereo around the player, both hands in it, a mirror on the desktop."""

from __future__ import annotations

import contextlib
import sys
import time as clock
from collections.abc import Iterator

import numpy as np

from assets.errors import BadInput
from display.frame import Frame
from display.headset import graphics
from display.headset.mirror import mirror
from display.headset.player import TAP, Player
from display.headset.poses import eye_camera
from display.headset.runtime import Runtime
from display.headset.session import Lost, Session
from display.headset.wrist_panel import WristPanel
from display.surface import has_display
from scenes.scene import Scene

LONGEST_STEP = 0.1  # [s]; after a longer gap the world goes on where it was
PATIENCE = 60.0  # [s] for a runtime that went away to come back
STOPPING = 3.0  # [s] at most for a runtime to say goodbye
SMALLEST, LARGEST = 16, 8192  # [px] a side, of an eye's picture


class Headset:
    """A display: `for frame in headset.frames(): world.step(frame); headset.present(world)`.

    `size` is that of one eye's picture [px]: the runtime's wish times `scale`. Raises BadInput, with one clear line,
    where there is no runtime, no headset or no OpenGL.
    """

    views = 2

    def __init__(
        self, scene: Scene, *, title: str = "VR-GS", window: tuple[int, int] = (1280, 720), scale: float = 1.0
    ):
        self._session = self._mirror = None
        self._needed = graphics.extensions(has_display())
        self._runtime = Runtime(self._needed)
        try:
            self._mirror = mirror(scene, title, window, self.views)
            graphics.check(self._runtime, self._mirror.gl)
            width, height = np.max(self._runtime.views, axis=0)
            self.size = tuple(int(np.clip(round(side * scale), SMALLEST, LARGEST)) for side in (width, height))
            self._open()
        except BaseException:
            self.close()
            raise
        self._player, self._eye_height = Player(scene), float(scene.eye[1])
        self._wrist = WristPanel()
        self._commands: dict = {}
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

    def _open(self) -> None:
        """Begin a session; the runtime then says when to play."""
        runtime = self._runtime
        graphics.requirements(runtime)  # the specification wants it asked before each session
        self._session = Session(runtime, self._mirror.gl, graphics.binding(runtime.xr, self._mirror.egl), self.size)

    def _leave(self) -> None:
        """End a running session as the specification wants it: ask, then follow the states."""
        session, end = self._session, clock.monotonic() + STOPPING
        if not session.running or session.over == "lost":
            return
        session.leave()
        with contextlib.suppress(Lost, self._runtime.xr.exception.ResultException):
            while session.over is None and clock.monotonic() < end:
                session.poll()
                if session.running:
                    session.end(session.wait().predicted_display_time, [])
                else:
                    clock.sleep(0.01)

    def frames(self) -> Iterator[Frame]:
        """Frames at the headset's pace until the user quits here or there."""
        time, last = 0.0, None
        while not self._quit():
            session = self._session
            try:
                session.poll()
                if session.over == "exit":
                    return
                if session.over == "lost":
                    raise Lost("the runtime ends it")
                if not session.running:
                    last = None
                    self._idle()
                    continue
                # A runtime without a floor puts y = 0 where the head was: then it stands as high as the scene's eye.
                self._player.standpoint.y = 0.0 if session.standing else self._eye_height
                state = session.wait()
                shown = state.predicted_display_time
                dt = 0.0 if last is None else min(max((shown - last) * 1e-9, 0.0), LONGEST_STEP)
                last = shown
                controllers = session.guarded(lambda s=session, t=shown: s.actions.read(s.space, t))
                head = session.locate(shown)[0][0]
                asked = self._wrist.advance(controllers, head, self._player.standpoint.matrix, self._world)
                hands, commands = self._player.advance(controllers, head, self._world)
                commands |= asked
                time += dt
                self._frame, self._rendered = state, bool(state.should_render)
                commands, self._commands = {**self._commands, **commands}, {}
                cameras = self._cameras if self._rendered else []
                yield Frame(dt, time, cameras, hands, commands)
                if self._frame is not None:  # it was not presented
                    session.end(shown, [])
            except Lost:
                last = None
                if not self._return():
                    return

    def _cameras(self):
        """The eyes' cameras, asked for when the world has moved: the later, the truer to where the head will be."""
        located = self._session.locate(self._frame.predicted_display_time)
        stage = self._player.standpoint.matrix
        return [eye_camera(*self.size, fov, stage @ eye) for eye, fov in located]

    def present(self, world) -> None:
        """Show the world's picture in the headset and on the desktop, and let the hands feel what they hold."""
        self._world = world
        frame, self._frame = self._frame, None
        with world.timings.stage("present"):
            try:
                layers = []
                if self._rendered:
                    self._mirror.texture.upload(world.picture)
                    layers = self._session.show(self._mirror.texture.texture)
                    layers += self._session.show_panel(self._wrist, world)
                self._session.end(frame.predicted_display_time, layers)
                self._player.feel(world, self._session.actions)
                if self._wrist.clicked:
                    self._session.actions.pulse(1, *TAP)
            except Lost:
                pass  # `frames` sees it, too
        with world.timings.stage("mirror"):
            self._commands |= self._mirror.show(world)
        world.timings.frame()

    def _idle(self) -> None:
        """Nobody wears the headset: the world stands still."""
        if self._world is not None:
            self._world.timings.rest()
        self._commands |= self._mirror.show(self._world)
        clock.sleep(0.05)

    def _quit(self) -> bool:
        return self._mirror.closing

    def _return(self) -> bool:
        """The runtime went away: wait for it, or for another, and go on playing; whether one came."""
        print("the headset's runtime went away; waiting for it to come back", file=sys.stderr, flush=True)
        self._session.close()
        self._runtime.close()
        end = clock.monotonic() + PATIENCE
        while clock.monotonic() < end and not self._quit():
            try:
                self._runtime = Runtime(self._needed, wait=0.0)
                self._open()
            except (BadInput, self._runtime.xr.exception.ResultException):
                self._runtime.close()
                self._idle()
                clock.sleep(0.5)
                continue
            print(f"{self._runtime.name} is back", file=sys.stderr, flush=True)
            return True
        print("it did not come back; the play ends", file=sys.stderr, flush=True)
        return False
