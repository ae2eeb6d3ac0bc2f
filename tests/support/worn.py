"""A headset that is worn in a made-up runtime, with a made-up world, time and OpenGL."""

import ctypes
import itertools
from types import SimpleNamespace as N
from unittest.mock import MagicMock

import numpy as np

from display.protocol import WorldView
from display.timing import Timings
from display.xr import headset as module
from display.xr.wrist_panel import PANEL_WIDTH, PIXELS
from scenes import ring_toss

ATTACH = ctypes.CFUNCTYPE(None, *[ctypes.c_uint] * 4, ctypes.c_int)(lambda *call: None)  # glFramebufferTexture2D
DEPTH32 = 0x8CAC
MAX_SLEEPS = 400  # a test that gets there hangs


class Time:
    """The module time, in which nothing takes time but sleep, and each frame `work` [s]."""

    CLOCK_MONOTONIC = 1

    def __init__(self):
        self.now, self.work, self.slept = 100.0, 0.0, 0

    def monotonic(self):
        return self.now

    perf_counter = monotonic

    def clock_gettime_ns(self, clock):
        return round(self.now * 1e9)

    def sleep(self, seconds):
        self.slept += 1
        assert self.slept < MAX_SLEEPS, "it waits for ever"
        self.now += seconds


class NotedWorld(WorldView):
    """A world that notes its frames; its first hand feels a pull."""

    picture = None

    def __init__(self, size):
        self.timings, self.picture_size, self.sizes = Timings(), size, []
        self.frames, self.cameras = [], []

    def step(self, frame):
        self.frames.append(frame)
        self.cameras.append(frame.cameras() if callable(frame.cameras) else frame.cameras)

    def resize(self, *size):
        self.picture_size = size
        self.sizes.append(size)

    def hand_forces(self):
        return [np.array([0.0, 20.0, 0.0]), np.zeros(3)]


def worn(monkeypatch):
    """A fixture. wear(fake, frames): play that many frames; (headset, world). The clock of all is wear.time."""
    time, mirrors = Time(), []

    def make_mirror(title, size, views, *, shown):
        gl = MagicMock(version_code=450, extra=lambda name: ctypes.cast(ATTACH, ctypes.c_void_p).value)
        mirror = N(gl=gl, egl=None, texture=MagicMock(), closing=False, resolution=None, closed=0)
        mirror.show = lambda world: []
        mirror.close = lambda: setattr(mirror, "closed", mirror.closed + 1)
        mirrors.append(mirror)
        return mirror

    def play(fake, frames=10, each=lambda k, headset, world: None):
        monkeypatch.setattr("display.xr.openxr_runtime.import_xr", lambda: fake)
        headset = module.Headset(ring_toss.build())
        world = NotedWorld(headset.size)
        with headset:
            for k, frame in enumerate(itertools.islice(headset.frames(world), frames)):
                world.step(frame)
                time.now += time.work
                each(k, headset, world)
                headset.present(world)
        assert mirrors[-1].closed == 1
        return headset, world

    for name in ("display.xr.headset.time", "display.xr.openxr_runtime.time", "display.xr.session.clock"):
        monkeypatch.setattr(name, time)
    monkeypatch.setattr(module, "Mirror", make_mirror)
    monkeypatch.setattr(module, "has_display", lambda: False)
    monkeypatch.setattr(module, "graphics_binding", lambda xr, egl: xr.GraphicsBindingEGLMNDX())
    play.time, play.mirrors = time, mirrors
    return play


def lines(capsys) -> list[str]:
    """Lines on stderr after the greeting."""
    return capsys.readouterr().err.splitlines()[1:]


def point_on_panel(panel: np.ndarray, u: float, v: float, distance: float = 0.0) -> np.ndarray:
    """Point (3,) at a distance [m] before a pixel of the panel (4, 4): the inverse of `project_to_panel`."""
    scale = PANEL_WIDTH / PIXELS[0]
    return panel[:3, 3] + panel[:3, :3] @ [(u - 0.5 * PIXELS[0]) * scale, (0.5 * PIXELS[1] - v) * scale, distance]
