"""The display in a browser: pictures go to a page as JPEG, its mouse, keys and fingers come back."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from time import perf_counter, sleep

import numpy as np

from core.errors import Cancelled
from display.adaptive_resolution import WindowResolution
from display.clock import caught_up
from display.panel import Panel, commands_of
from display.picture import fit, pixels_of
from display.preferences import Preferences
from display.protocol import Display, Frame, WorldView
from display.user_commands import Command
from display.web.page_messages import WINDOW_ONLY, first_words, overlay, scene_request, world_state
from display.web.page_server import LOOPBACK, STILL_QUALITY, PageServer
from display.window.controls import Controls
from display.window.key_bindings import BY_CHORD, PLACES, chord_name
from scenes.scene import Scene

PERIOD = 1 / 60  # [s] of a frame at least
REST_PERIOD = 1 / 20  # [s] of a frame in which nothing moves, and the longest wait for a page to take a picture
ONE_INTERRUPT = 0.5  # [s] in which one Ctrl-C may come twice: from the terminal, and from a process that passes it on
MAX_STEP = 1 / 20  # [s] of simulation at once
SIZE = (960, 540)  # [px] before a page tells its own
MAX_PIXELS = 1920 * 1080  # of a picture
CODES = {"ShiftLeft": "shift", "ShiftRight": "shift", "NumpadAdd": "plus", "NumpadSubtract": "minus"}
TOLD_INTERVAL = 0.1  # [s] between two states of the panel


class Browser(Display):
    """A display: `for frame in browser.frames(world): world.step(frame); browser.present(world)`.

    host, port   to listen on; port 0: the default one, or the next free one
    size         largest (width, height) [px] of the picture; None: the page's, up to MAX_PIXELS
    preferences  keep the views of the scene of that `name` from one start to the next

    Prints the address to open. Frames end with Ctrl-C or a signal to terminate; a page cannot end them. Raises BadInput
    if it cannot listen. Close it, or use it in a `with`.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        title: str = "VR-GS",
        host: str | None = None,
        port: int = 0,
        size: tuple[int, int] | None = None,
        preferences: Preferences | None = None,
        name: str = "",
    ):
        self._largest = size
        self._server = PageServer(host or LOOPBACK, port, first_words(title, name, scene), encode)
        self._controls = Controls(scene, preferences, name)
        self._resolution, self._panel = WindowResolution(), Panel()
        self._controls.update_camera(self._full)
        self._pointing = False  # the pointer is over the picture
        self._near = False  # the pointer is among the edits
        self._dropped = 0.0  # [s] that have passed and were never simulated
        self._waited = 0.0  # [s] in this frame for a page to take a picture
        self._busy = True  # something moves, or may
        self._started = False
        self._handlers: dict = {}  # of signals, before ours
        self._asked: float | None = None  # [s] when a signal asked for the end; None: not yet
        self._time = 0.0  # [s] of all frames
        self._picture, self._shown = 0, None  # number of the picture, and which one of which world it is
        self._start: np.ndarray | None = None  # pixels of the first picture, while the world is made
        self._told = -TOLD_INTERVAL  # [s] when the pages were told what their panels show
        print(f"Open {self._server.address}", flush=True)
        if host not in (None, LOOPBACK, "localhost", "::1"):
            print("Anyone who has this address can play; the connection is not encrypted.", file=sys.stderr, flush=True)

    def close(self) -> None:
        """Say goodbye to the pages. Further calls do nothing.

        Waits for a second interrupt that may still come: it would kill the program while it ends.
        """
        self._server.close()
        if self._handlers and self._asked is not None:
            sleep(max(0.0, self._asked + ONE_INTERRUPT - perf_counter()))
        for kind, handler in self._handlers.items():
            signal.signal(kind, handler)
        self._handlers.clear()

    @property
    def _full(self) -> tuple[int, int]:
        """(width, height) [px] of the picture at full size: that of the player's page, within the limits."""
        player = self._server.player
        wanted = player.size if player is not None and player.size is not None else self._largest or SIZE
        if self._largest is not None and (wanted[0] > self._largest[0] or wanted[1] > self._largest[1]):
            wanted = fit(wanted, self._largest)[2:]
        scale = min(1.0, (MAX_PIXELS / (wanted[0] * wanted[1])) ** 0.5)
        return tuple(max(1, int(side * scale)) for side in wanted)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) [px] of the picture that suits the page now."""
        return self._resolution.size(self._full, self._panel.scale)

    def loading(self, text: str, picture=None) -> None:
        """Show a line of text during a long operation, over a picture or the last one.

        Raises Cancelled if the program is to end, or if Esc is pressed while another scene is opened.
        """
        if picture is not None:
            self._start = pixels_of(picture).copy()
            self._picture += 1
        if self._start is not None:
            height, width = self._start.shape[:2]
            self._server.show(self._picture, [], lambda: self._start, still=True, shape=(width, height))
        self._server.tell({"loading": text})
        escapes = [event for event in self._server.take() if event[:2] == ("key", "Escape") and event[3]]
        if self._asked is not None or (self._started and escapes):
            raise Cancelled(quits=self._asked is not None)

    def show_scene(self, scene: Scene, title: str, name: str) -> None:
        """Show this scene from now on, from where it begins; `frames` is then called again, with its world."""
        self._server.tell({"loading": f"Loading {title}"})
        self._server.greet(first_words(title, name, scene))
        self._controls.show_scene(scene, name)

    def frames(self, world: WorldView) -> Iterator[Frame]:
        """Frames in real time until the program is to end; slower where that cannot be kept up (display/clock.py).

        No frames while no page is visible, few while nothing moves.
        """
        last, self._start, self._started = perf_counter(), None, True
        self._listen_to_signals()
        while self._asked is None:
            if not self._server.watched:
                self._controls.let_go()
                world.timings.rest()
                self._server.wait(REST_PERIOD)
                last = perf_counter()
                continue
            self._pace(last, world)
            now = perf_counter()
            seconds, last = now - last, now
            dt, dropped = caught_up(seconds, world.simulation_cost)
            self._dropped += dropped
            commands = self._handle(self._server.take(), world)
            hands = self._controls.hands(dt, commands, world)
            self._time += dt
            moving = self._controls.update_camera(self._full) or world.moving
            self._busy = moving or bool(commands or hands)
            drawing = world.timings.latest("shadow", "render", "present") + self._waited  # which fewer pixels shorten
            self._resolution.note(now, seconds, drawing, moving=moving)
            if world.picture_size != self.size:
                world.resize(*self.size)
            camera = self._controls.camera.resized(*world.picture_size)
            yield Frame(dt, self._time, [camera], hands, commands, max_step=MAX_STEP)

    def _pace(self, last: float, world: WorldView) -> None:
        """Wait until the next frame is due, `last` [s] being the time of the one before."""
        if not self._busy:
            world.timings.rest()
            self._server.wait(last + REST_PERIOD - perf_counter())
        self._server.catch_up()
        begin = perf_counter()
        self._server.wait(last + REST_PERIOD - begin, for_picture=True)
        self._waited = perf_counter() - begin
        sleep(max(0.0, last + PERIOD - perf_counter()))

    def _listen_to_signals(self) -> None:
        """End the frames on Ctrl-C or SIGTERM, so that all files are finished; a second one ends at once."""
        if self._handlers:
            return

        def end(*_) -> None:
            self._asked = self._asked or perf_counter()
            if perf_counter() - self._asked > ONE_INTERRUPT:
                raise KeyboardInterrupt

        self._handlers = {kind: signal.signal(kind, end) for kind in (signal.SIGINT, signal.SIGTERM)}

    def present(self, world: WorldView) -> None:
        """Send the world's picture to the pages that are ready for one, and the panel's state."""
        with world.timings.stage("present"):
            shown, self._shown = self._shown, (id(world), world.pictures)
            self._picture += shown != self._shown
            hand = self._controls.hand.position if self._controls.drag == "grab" else None
            under = self._controls.hovered(world, over=self._pointing, moving=self._busy)
            strokes = overlay(world, self._controls.camera, hand, under, near=self._near)
            still = self._resolution.still and world.picture_size == self.size
            self._server.show(self._picture, strokes, lambda: pixels_of(world.picture), still=still, shape=self._full)
            self._tell(world)
        world.timings.exact = self._server.details
        world.timings.frame(dropped=self._dropped)

    def _tell(self, world: WorldView) -> None:
        """Send the panel's state to the pages, no more often than it can be read."""
        now = perf_counter()
        if now - self._told >= TOLD_INTERVAL:
            self._told = now
            if self._busy or self._server.details:  # at rest nothing is sent that nobody looks at
                self._panel.read(world)
            own = {"grabbing": self._controls.drag == "grab", "fps": round(self._panel.fps) if self._busy else None}
            self._server.tell(world_state(world, self._panel) | own)

    def _handle(self, events: list[tuple], world: WorldView) -> list[Command]:
        controls, commands = self._controls, []
        for kind, *what in events:
            if kind == "move":
                self._move(*what)
            elif kind == "button":
                name, down, *position = what
                self._move(*position)
                if down:
                    controls.press(name, world)
                else:
                    controls.release(name)
            elif kind == "wheel":
                controls.wheel(*what)
            elif kind == "pinch":
                self._pinch(*what)
            elif kind == "key":
                commands += self._key(*what, world)
            elif kind in ("blur", "left"):
                controls.let_go()
                self._pointing = False
            elif kind == "leave":
                self._pointing = False
            elif kind == "edits":
                (self._near,) = what
            elif kind == "panel":
                commands += commands_of(self._panel.sections(world), *what)
            elif kind == "open":
                commands += filter(None, [scene_request(*what)])
        controls.note(commands)
        return controls.completed(commands, self._full, world)

    def _move(self, u: float, v: float) -> None:
        """Move the cursor to (u, v), in fractions of the picture."""
        self._pointing, camera = True, self._controls.camera
        self._controls.move(u * camera.width, v * camera.height)

    def _pinch(self, notches: float, du: float, dv: float) -> None:
        """Two fingers: push or pull what is held; otherwise zoom and shift the camera."""
        controls = self._controls
        if controls.drag != "grab":
            controls.release("left")  # the first finger began to turn the view
            controls.pan(du * controls.camera.width, dv * controls.camera.height)
        controls.wheel(notches)

    def _key(self, code: str, printed: str, down: bool, ctrl: bool, world: WorldView) -> list[Command]:
        name = pressed_key(code, printed, down=down, ctrl=ctrl)
        binding = BY_CHORD.get(name)
        if name is None or (binding is not None and binding.action in WINDOW_ONLY and name != "escape"):
            return []
        commands = self._controls.key(name, down, world)
        self._controls.quit = False  # a page does not end the program
        return commands

    def stats(self) -> dict:
        """Counts for `--stats`. Latency is measured from the oldest input that a picture is the first to show."""
        flows = self._server.flows
        latencies = 1e3 * np.concatenate([[], *(flow.latencies for flow in flows)])
        intervals = np.concatenate([[], *(flow.intervals for flow in flows)])
        return {
            "pages": len(flows),
            "frames_sent": sum(flow.frames for flow in flows),
            "bytes_sent": sum(flow.bytes for flow in flows),
            "fps": len(intervals) / float(intervals.sum()) if len(intervals) else 0.0,
            "latency_ms": float(np.median(latencies)) if len(latencies) else None,
            "latency_95_ms": float(np.percentile(latencies, 95)) if len(latencies) else None,
            "latency_samples": len(latencies),
        }


def pressed_key(code: str, key: str, *, down: bool, ctrl: bool) -> str | None:
    """Name of a key for the controls, from `code` and `key` of a KeyboardEvent; None for other keys."""
    place = CODES.get(code) or code.removeprefix("Key").removeprefix("Digit").lower()
    place = place if place in PLACES or place in CODES.values() else None
    return chord_name(place, key.lower() if len(key) == 1 else "", down=down, ctrl=ctrl)


def encode(pixels: np.ndarray, quality: int) -> bytes:
    """JPEG of RGBA pixels (H, W, 4) uint8; in full colour resolution if the quality is that of still pictures."""
    import cv2

    full, half = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420
    sampling = full if quality >= STILL_QUALITY else half
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling]
    return cv2.imencode(".jpg", cv2.cvtColor(pixels, cv2.COLOR_RGBA2BGR), options)[1].tobytes()
