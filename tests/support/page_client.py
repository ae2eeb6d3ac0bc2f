"""A page without a browser: a plain websocket client that takes pictures and state, and sends what a test tells it."""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Callable
from urllib.parse import urlsplit

import cv2
import numpy as np

from tests.support.waiting import PATIENCE


def socket_address(url: str) -> str:
    """Address of the socket of a page's address."""
    return url.replace("http:", "ws:", 1).replace("/?", "/socket?", 1)


class PageClient:
    """`state` is all that was told, `pictures` what came: (header, size in bytes, pixels BGR)."""

    def __init__(self, url: str, *, answers: bool = True, origin: str | None = "its own"):
        from websockets.sync.client import connect

        own = f"http://{urlsplit(url).netloc}"
        self.socket = connect(socket_address(url), origin=own if origin == "its own" else origin, compression=None)
        self.answers, self.state, self.pictures = answers, {}, []

    def __enter__(self) -> PageClient:
        return self

    def __exit__(self, *error) -> None:
        self.socket.close()

    def send(self, *message) -> None:
        self.socket.send(json.dumps(message))

    def take(self, seconds: float) -> bool:
        """Take the next message; False if none comes in time."""
        try:
            message = self.socket.recv(timeout=seconds)
        except TimeoutError:
            return False
        if isinstance(message, str):
            news = json.loads(message)
            self.state |= news
            if "ping" in news and self.answers:
                self.send("pong", news["ping"])
            return True
        (length,) = struct.unpack("<I", message[:4])
        header, jpeg = json.loads(message[4 : 4 + length]), message[4 + length :]
        self.pictures.append((header, len(jpeg), cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)))
        if self.answers:
            self.send("shown", header["n"], None if header["stamp"] is None else 1.0)
        return True

    def until(self, condition: Callable[[], object], seconds: float = PATIENCE) -> None:
        """Take messages until a condition holds."""
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, f"not in time; the state is {self.state}"
            self.take(0.05)

    def during(self, seconds: float) -> int:
        """Take messages for some time; the number of pictures among them."""
        before, end = len(self.pictures), time.monotonic() + seconds
        while time.monotonic() < end:
            self.take(end - time.monotonic())
        return len(self.pictures) - before
