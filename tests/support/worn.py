"""A headset that is worn in a made-up runtime, with a made-up world, time and OpenGL."""

import ctypes
import itertools
from types import SimpleNamespace as N
from unittest.mock import MagicMock

import numpy as np

from display.timing import Timings
from display.xr import headset as module
from scenes import ring_toss

ATTACH = ctypes.CFUNCTYPE(None, *[ctypes.c_uint] * 4, ctypes.c_int)(lambda *call: None)  # glFramebufferTexture2D
DEPTH32 = 0x8CAC
MOST = 400  # frames, and calls of sleep: a test that gets there hangs


class Time:
    """The module time, in which nothing takes time but sleep, and each frame `work` [s]."""

    CLOCK_MONOTONIC = 1

    def __init__(self):
        self.now, self.work, self.slept = 100.0, 0.0, 0

    def monotonic(self):
        return self.now

    def perf_counter(self):
        return self.now

    def clock_gettime_ns(self, clock):
        return round(self.now * 1e9)

    def sleep(self, seconds):
        self.slept += 1
        assert self.slept < MOST, "it waits for ever"
        self.now += seconds


class World:
    """What a headset needs of a world: it notes its frames."""

    demo, paused, interaction, light, selected, editable = False, False, "physics", None, None, False
    score, message, notice = 0, "", ""

    def __init__(self, size):
        self.timings, self.simulation_cost, self.picture_size, self.sizes = Timings(), None, size, []
        self.frames, self.cameras, self.picture = [], [], None

    def step(self, frame):
        self.frames.append(frame)
        self.cameras.append(frame.cameras() if callable(frame.cameras) else frame.cameras)

    def resize(self, *size):
        self.picture_size = size
        self.sizes.append(size)

    def bodies(self):
        return []

    def pick(self, origin, direction):
        return None

    def hand_forces(self):
        return [np.array([0.0, 20.0, 0.0]), np.zeros(3)]

    def touch_forces(self):
        return [np.zeros(3), np.zeros(3)]


def worn(monkeypatch):
    """A fixture. wear(fake, frames): play so many frames; (headset, world). The clock of all is wear.time."""
    time, mirrors = Time(), []

    def mirror(scene, title, window, views):
        gl = MagicMock(version_code=450, extra=lambda name: ctypes.cast(ATTACH, ctypes.c_void_p).value)
        texture = MagicMock()
        mirrors.append(N(gl=gl, egl=None, texture=texture, closing=False, share=None, closed=0))
        mirrors[-1].show = lambda world: []
        mirrors[-1].close = lambda m=mirrors[-1]: setattr(m, "closed", m.closed + 1)
        return mirrors[-1]

    def play(fake, frames=10, each=lambda k, headset, world: None):
        monkeypatch.setattr("display.xr.openxr_runtime.import_xr", lambda: fake)
        headset = module.Headset(ring_toss.build())
        world = World(headset.size)
        with headset:
            for k, frame in enumerate(itertools.islice(headset.frames(world), frames)):
                world.step(frame)
                time.now += time.work
                each(k, headset, world)
                headset.present(world)
        assert mirrors[-1].closed == 1
        return headset, world

    for name in ("display.xr.headset", "display.xr.openxr_runtime", "display.xr.status_log"):
        monkeypatch.setattr(f"{name}.time", time)
    monkeypatch.setattr(module, "mirror", mirror)
    monkeypatch.setattr(module, "has_display", lambda: False)
    monkeypatch.setattr("display.xr.graphics_binding.binding", lambda xr, egl: xr.GraphicsBindingEGLMNDX())
    play.time, play.mirrors = time, mirrors
    return play


def lines(capsys) -> list[str]:
    """What was said after the greeting."""
    return capsys.readouterr().err.splitlines()[1:]
