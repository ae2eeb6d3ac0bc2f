"""A browser without a screen: Chromium, led by the DevTools protocol.

with Chromium() as browser:
    tab = browser.open("http://...", 960, 540)
    tab.drag((400, 300), (500, 250))
    tab.screenshot(path)
"""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from urllib.request import Request, urlopen

import numpy as np
import pytest

from tests.support.waiting import PATIENCE, until

PROGRAM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
NEEDS_CHROMIUM = pytest.mark.skipif(PROGRAM is None, reason="needs Chromium")


class Chromium:
    """A running browser with a profile of its own."""

    def __enter__(self) -> Chromium:
        self._profile = tempfile.TemporaryDirectory(prefix="chromium-", ignore_cleanup_errors=True)
        options = ["--headless=new", "--remote-debugging-port=0", f"--user-data-dir={self._profile.name}"]
        options += ["--no-first-run", "--disable-gpu", "--disable-extensions", "--disable-background-networking"]
        options += ["--disable-background-timer-throttling", "--disable-renderer-backgrounding", "--hide-scrollbars"]
        options += ["--enable-unsafe-swiftshader"]  # WebGL without a GPU
        options += ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
        self._process = subprocess.Popen([PROGRAM, *options], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        port = Path(self._profile.name) / "DevToolsActivePort"
        until(lambda: port.exists() and port.read_text().strip())
        self._port = int(port.read_text().split()[0])
        self._tabs: list[Tab] = []
        return self

    def __exit__(self, *error) -> None:
        for tab in self._tabs:
            tab.disconnect()
        self._process.terminate()
        self._process.wait(20)
        self._profile.cleanup()

    def open(self, url: str, width: int, height: int, *, scale: float = 1.0, touch: bool = False) -> Tab:
        """A new tab with a page of `width` x `height` CSS pixels, `scale` device pixels each."""
        with urlopen(Request(f"http://127.0.0.1:{self._port}/json/new?about:blank", method="PUT")) as answer:
            tab = Tab(json.load(answer)["webSocketDebuggerUrl"])
        self._tabs.append(tab)
        metrics = {"width": width, "height": height, "deviceScaleFactor": scale, "mobile": touch}
        tab.do("Emulation.setDeviceMetricsOverride", **metrics)
        if touch:
            tab.do("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=5)
        tab.do("Page.enable")
        tab.do("Page.navigate", url=url)
        tab.until("document.readyState === 'complete' && location.href !== 'about:blank'")
        return tab


class Tab:
    """A page; positions in CSS pixels from its top left."""

    def __init__(self, address: str):
        from websockets.sync.client import connect

        self._socket = connect(address, max_size=None, compression=None, ping_interval=None)
        self._count = 0

    def do(self, method: str, **parameters) -> dict:
        """A command of the DevTools protocol and its result."""
        self._count += 1
        self._socket.send(json.dumps({"id": self._count, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=PATIENCE))
            if answer.get("id") == self._count:
                assert "error" not in answer, answer["error"]
                return answer["result"]

    def disconnect(self) -> None:
        self._socket.close()

    def close(self) -> None:
        """Close the page, as its user does."""
        self.do("Page.close")

    def value(self, script: str):
        """Value of an expression of JavaScript in the page."""
        result = self.do("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def until(self, script: str, seconds: float = PATIENCE) -> None:
        """Wait until an expression is true."""
        until(lambda: self.value(script), seconds, script)

    def screenshot(self, path: str | Path | None = None) -> np.ndarray:
        """Pixels of the page, (H, W, 3) uint8 RGB, also as a PNG file."""
        import cv2

        data = base64.b64decode(self.do("Page.captureScreenshot", format="png")["data"])
        if path is not None:
            Path(path).write_bytes(data)
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]

    def mouse(self, kind: str, at, button: str = "none", **more) -> None:
        """An event of the mouse: "Moved", "Pressed", "Released", "Wheel"."""
        x, y = map(float, at)
        held = {"left": 1, "right": 2, "middle": 4}.get(button, 0) if kind != "Released" else 0
        count = {"clickCount": 1} if kind in ("Pressed", "Released") else {}
        event = {"type": f"mouse{kind}", "x": x, "y": y, "button": button, "buttons": held, **count, **more}
        self.do("Input.dispatchMouseEvent", **event)

    def click(self, script: str) -> None:
        """A click on the middle of an element, given by an expression."""
        at = self.value(f"(r => [r.x + r.width / 2, r.y + r.height / 2])(({script}).getBoundingClientRect())")
        for kind in ("Moved", "Pressed", "Released"):
            self.mouse(kind, at, "none" if kind == "Moved" else "left")

    def drag(self, begin, end, *, button="left", seconds=0.5, steps=12, press=True, release=True) -> None:
        """Press at `begin`, move to `end` at an even speed, let go while still moving."""
        self.mouse("Moved", begin, "none" if press else button)
        if press:
            self.mouse("Pressed", begin, button)
        for k in range(1, steps + 1):
            self.mouse("Moved", [b + (e - b) * k / steps for b, e in zip(begin, end, strict=True)], button)
            time.sleep(seconds / steps)
        if release:
            self.mouse("Released", end, button)

    def touch(self, kind: str, *points) -> None:
        """An event of fingers: "Start", "Move", "End"."""
        where = [{"x": float(x), "y": float(y), "id": k} for k, (x, y) in enumerate(points)]
        self.do("Input.dispatchTouchEvent", type=f"touch{kind}", touchPoints=where)

    def key(self, key: str, code: str, *, ctrl: bool = False) -> None:
        """Press and release a key, by KeyboardEvent's key and code."""
        for kind in ("rawKeyDown", "keyUp"):
            self.do("Input.dispatchKeyEvent", type=kind, key=key, code=code, modifiers=2 if ctrl else 0)
