"""A screen without a monitor: Xvfb on a free display number, mouse and keys by xdotool, screenshots.

with XServer(1280, 800) as screen:
    process = subprocess.Popen(command, env=screen.env)
    window = screen.wait_for_window("Ball")
    screen.drag((400, 300), (500, 250))
    screen.pixels()
"""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest

MISSING = [tool for tool in ("Xvfb", "xdotool") if shutil.which(tool) is None]
NEEDS_XVFB = [  # as a module's `pytestmark`, or spread over a test's decorators
    pytest.mark.window,
    pytest.mark.skipif(bool(MISSING), reason=f"needs {' and '.join(MISSING)}"),
]


class ClientMessage(ctypes.Structure):
    """XClientMessageEvent, as long as any XEvent."""

    _fields_ = [
        ("type", ctypes.c_int),
        ("serial", ctypes.c_ulong),
        ("send_event", ctypes.c_int),
        ("display", ctypes.c_void_p),
        ("window", ctypes.c_ulong),
        ("message_type", ctypes.c_ulong),
        ("format", ctypes.c_int),
        ("data", ctypes.c_long * 5),
        ("rest", ctypes.c_long * 12),
    ]


class XServer:
    """An X server with nothing on it, not even a window manager. Positions in pixels from the top left."""

    def __init__(self, width: int = 1280, height: int = 800):
        self.size = (width, height)

    def __enter__(self) -> XServer:
        read, write = os.pipe()
        width, height = self.size
        self._memory = tempfile.TemporaryDirectory(prefix="xvfb-")  # the server keeps its screen in a file there
        command = ["Xvfb", "-displayfd", str(write), "-screen", "0", f"{width}x{height}x24", "-nolisten", "tcp"]
        command += ["-fbdir", self._memory.name, "-noreset"]  # else properties go with the last client
        self._server = subprocess.Popen(command, pass_fds=[write], stderr=subprocess.DEVNULL)
        os.close(write)
        with os.fdopen(read) as answer:
            number = answer.readline().strip()  # written once the server is ready
        if not number:
            raise RuntimeError("Xvfb did not start")
        self.env = {k: v for k, v in os.environ.items() if k != "WAYLAND_DISPLAY"}
        self.env |= {"DISPLAY": f":{number}", "LIBGL_ALWAYS_SOFTWARE": "1"}
        return self

    def __exit__(self, *error) -> None:
        self._server.terminate()
        self._server.wait(10)
        self._memory.cleanup()

    def do(self, *words) -> str:
        """Run an xdotool command, return what it prints."""
        command = ["xdotool", *map(str, words)]
        return subprocess.run(command, env=self.env, check=True, capture_output=True, text=True).stdout.strip()

    def wait_for_window(self, title: str, *, seconds: float = 30.0) -> str:
        """Id of the window with this title, moved to the top left and given the keyboard."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            search = ["xdotool", "search", "--onlyvisible", "--name", f"^{title}$"]
            found = subprocess.run(search, env=self.env, capture_output=True, text=True).stdout.split()
            if found:
                self.do("windowmove", found[0], 0, 0, "windowfocus", found[0])
                return found[0]
            time.sleep(0.1)
        raise TimeoutError(f"no window named {title!r} after {seconds:.0f} s")

    def close_window(self, window: str) -> None:
        """Ask a program to close its window, as a click on its cross does; `xdotool windowclose` tears it away."""
        x = ctypes.CDLL("libX11.so.6")
        x.XOpenDisplay.restype = ctypes.c_void_p
        x.XInternAtom.restype = ctypes.c_ulong
        display = ctypes.c_void_p(x.XOpenDisplay(self.env["DISPLAY"].encode()))
        message = ClientMessage(33, 0, 1, display, int(window), x.XInternAtom(display, b"WM_PROTOCOLS", 0), 32)
        message.data[0] = x.XInternAtom(display, b"WM_DELETE_WINDOW", 0)
        x.XSendEvent(display, ctypes.c_ulong(int(window)), 0, ctypes.c_long(0), ctypes.byref(message))
        x.XCloseDisplay(display)

    def mouse_move(self, x: float, y: float) -> None:
        self.do("mousemove", round(x), round(y))

    def mouse_up(self, button: int = 1) -> None:  # 1 left, 2 middle, 3 right
        self.do("mouseup", button)

    def click(self, x: float, y: float) -> None:
        """A left click slow enough for a program that looks once a frame."""
        self.do("mousemove", round(x), round(y), "sleep", 0.15, "mousedown", 1, "sleep", 0.15, "mouseup", 1)

    def drag(self, begin, end, *, button: int = 1, seconds: float = 0.5, steps: int = 12, release: bool = True) -> None:
        """Press at `begin`, move to `end` at an even speed, let go while still moving. One xdotool, so in time."""
        words = ["mousemove", *map(round, begin), "sleep", 0.15, "mousedown", button, "sleep", 0.15]
        for k in range(1, steps + 1):
            words += ["mousemove", *(round(b + (e - b) * k / steps) for b, e in zip(begin, end, strict=True))]
            words += ["sleep", seconds / steps] if k < steps else []
        self.do(*words, *(["mouseup", button] if release else []))

    def wheel(self, notches: int) -> None:
        """Positive is away from the user."""
        for _ in range(abs(notches)):
            self.do("click", 4 if notches > 0 else 5)

    def key(self, name: str) -> None:
        """Press and release a key by its X name: space, r, F1, Escape, ... Held for two frames or so."""
        self.key_down(name)
        time.sleep(0.05)
        self.key_up(name)

    def key_down(self, name: str) -> None:
        self.do("keydown", name)

    def key_up(self, name: str) -> None:
        self.do("keyup", name)

    def pixels(self, *, seconds: float = 3.0) -> np.ndarray:
        """The whole screen, (H, W, 3) uint8 RGB, once two looks at it agree: one alone can catch half a frame."""
        end, before = time.monotonic() + seconds, None
        while True:
            data = (Path(self._memory.name) / "Xvfb_screen0").read_bytes()  # an XWD file
            if data == before or time.monotonic() > end:
                break
            before = data
            time.sleep(0.03)
        header = np.frombuffer(data[:100], ">u4")
        size, width, height, row, colours = (int(header[k]) for k in (0, 4, 5, 12, 19))
        begin = size + 12 * colours
        rows = np.frombuffer(data[begin : begin + row * height], np.uint8).reshape(height, row)
        return rows[:, : 4 * width].reshape(height, width, 4)[..., 2::-1].copy()  # stored as BGRX
