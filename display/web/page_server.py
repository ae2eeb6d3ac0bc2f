"""A web server for the page and its sockets, in a thread of its own. Knows nothing of worlds.

Taichi holds the interpreter's lock while a kernel runs, on a CPU for tens of milliseconds, in which this thread waits.
So the display's thread encodes the pictures itself, waits until they are with the system (`show`), and lets this
thread read what has come before it looks (`catch_up`): without that a picture or an input waits for a frame.

Whoever has the token of the address gets the page; anyone else gets status 403 and nothing more. The first page plays,
further ones watch.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextlib
import errno
import hmac
import json
import logging
import math
import secrets
import socket
import struct
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from html import escape
from http import HTTPStatus
from ipaddress import ip_address
from pathlib import Path
from string import Template
from time import perf_counter
from urllib.parse import parse_qs, urlsplit

import numpy as np
from websockets.asyncio.server import broadcast, serve
from websockets.exceptions import ConnectionClosed

from core.errors import BadInput
from display.web.page_messages import MESSAGE_BYTES, STAMPED, read_message

LOOPBACK = "127.0.0.1"
DEFAULT_PORT = 8090
PORTS_TRIED = 20  # from the default one on, if no port is asked for
MAX_PAGES = 16
MESSAGES_PER_SECOND, BURST = 400, 800  # of a page: a mouse, keys and answers take 200
MAX_EVENTS = 4000  # that wait while kernels are compiled
PING_INTERVAL = 2.0  # [s] between measurements of a connection's delay
PING_TIMEOUT = 60.0  # [s]; compilation of a large kernel may keep this thread waiting for some
LOOP_HOPS = 4  # turns of the event loop from data on a socket to the message in `_receive`: three
THREAD_PATIENCE = 0.1  # [s] for the server's thread
SEND_BUFFER = 1 << 20  # [bytes]; a picture fits in, and needs this thread no more
CLOSE_PATIENCE = 2.0  # [s] for the goodbyes at the end
POLICY_VIOLATION = 1008  # RFC 6455, section 7.4.1
SOURCES = "default-src 'none'; script-src 'nonce-{0}'; style-src 'nonce-{0}'; img-src data: blob:; connect-src 'self'"
POLICY = SOURCES + "; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
FOLDER = Path(__file__).parent
PICTURE_PERIOD = 1 / 30  # [s] between pictures for which a far page gets several at once
MAX_UNDER_WAY = 8  # pictures: a delay of a quarter of a second
QUALITIES = (35, 50, 65, 80)  # of JPEG while things move
STILL_QUALITY = 95  # once they are at rest
SLOW, FAST = 1 / 20, 1 / 60  # [s] of the way of a picture beyond that of a small message: worse, better pictures
WORSE_AFTER, BETTER_AFTER = 3, 30  # pictures in a row
DELAYS = 20  # measurements of the connection's delay of which the least counts: larger ones waited for something
MAX_GAP = 0.25  # [s] between pictures that follow one another
HISTORY_LENGTH = 36_000  # latencies and intervals kept: ten minutes at 60 Hz


class PictureFlow:
    """Pictures under way to a page, and those that arrived. Times in seconds.

    A picture is sent only while fewer than `window` are unanswered: one beyond those that the connection's delay keeps
    under way, so that none waits behind another. Its quality falls while pictures take SLOW longer than small
    messages, and rises again.
    """

    def __init__(self):
        self.frames = self.bytes = 0  # sent
        self.latencies: deque[float] = deque(maxlen=HISTORY_LENGTH)  # [s] from input to its picture on view
        self.intervals: deque[float] = deque(maxlen=HISTORY_LENGTH)  # [s] between pictures that follow one another
        self.last: tuple[int, int] = (-1, 0)  # the picture that the page has or will have, and its quality
        self.under_way: deque[tuple[int, float]] = deque()  # number and time of what is unanswered
        self.delays: deque[float] = deque(maxlen=DELAYS)  # [s] of small messages, there and back
        self._level, self._slow, self._fast = len(QUALITIES) - 1, 0, 0
        self._shown: float | None = None  # when the last picture was

    @property
    def quality(self) -> int:
        """Quality of the next picture while things move."""
        return QUALITIES[self._level]

    @property
    def window(self) -> int:
        """Pictures that may be under way."""
        return min(1 + math.ceil(min(self.delays, default=0.0) / PICTURE_PERIOD), MAX_UNDER_WAY)

    @property
    def ready(self) -> bool:
        """True if another picture may be sent."""
        return len(self.under_way) < self.window

    def send(self, now: float, picture: int, quality: int) -> int:
        """Note that a picture goes out; its number."""
        self.frames += 1
        self.under_way.append((self.frames, now))
        self.last = (picture, quality)
        return self.frames

    def shown(self, number: int, now: float, latency: float | None) -> bool:
        """Note that the page shows a picture, `latency` after the last input in it; False if it was not sent."""
        numbers = [n for n, _ in self.under_way]
        if number not in numbers:
            return False
        while self.under_way[0][0] != number:  # older ones were passed over
            self.under_way.popleft()
        _, sent = self.under_way.popleft()
        if latency is not None:
            self.latencies.append(latency)
        if self._shown is not None and now - self._shown <= MAX_GAP:
            self.intervals.append(now - self._shown)
        self._shown = now
        transfer = now - sent - min(self.delays, default=0.0)
        self._slow = self._slow + 1 if transfer > SLOW else 0
        self._fast = self._fast + 1 if transfer < FAST else 0
        if self._slow >= WORSE_AFTER and self._level > 0:
            self._level, self._slow = self._level - 1, 0
        elif self._fast >= BETTER_AFTER and self._level < len(QUALITIES) - 1:
            self._level, self._fast = self._level + 1, 0
        return True


@dataclass(eq=False)
class Page:
    """A page that is open somewhere, and what goes to it. `size` [px] is None before it is known."""

    connection: object
    flow: PictureFlow = field(default_factory=PictureFlow)
    size: tuple[int, int] | None = None
    hidden: bool = False
    details: bool = False
    stamp: float | None = None  # of the oldest input that no picture has shown [ms of the page's clock]
    told: dict = field(default_factory=dict)  # what it knows of the state
    pinged: float | None = None  # [s] when the ping without an answer went out
    allowance: float = BURST  # messages that it may send at once
    heard: float = field(default_factory=perf_counter)  # [s] when the last one came

    def may_speak(self, now: float) -> bool:
        """Count a message; False if the page sends too many."""
        self.allowance = min(BURST, self.allowance + (now - self.heard) * MESSAGES_PER_SECOND) - 1.0
        self.heard = now
        return self.allowance >= 0.0


class PageServer:
    """Serves until `close`. `address` is the URL with the token. Raises BadInput if it cannot listen there.

    hello   first message to a page
    encode  bytes of the pixels (H, W, 4) uint8 RGBA in a quality
    """

    def __init__(self, host: str, port: int, hello: dict, encode: Callable[[np.ndarray, int], bytes]):
        self._hello, self._encode, self._token = hello, encode, secrets.token_urlsafe(24)
        self._changed = threading.Condition()  # guards what follows
        self._pages: list[Page] = []  # the first one plays
        self._events: deque[tuple] = deque()
        self.flows: list[PictureFlow] = []  # of all pages so far
        self._socket, self._host = listen(host, port), host
        self._loop = asyncio.new_event_loop()
        self._ended = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="page server", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """The URL to open, on this machine or through a tunnel."""
        host, port = self._socket.getsockname()[:2]
        host = socket.gethostname() if host in ("0.0.0.0", "::") else f"[{host}]" if ":" in host else host
        return f"http://{host}:{port}/?token={self._token}"

    def close(self) -> None:
        """Say goodbye to the pages and stop. Further calls do nothing."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._ended.set)
            self._thread.join(CLOSE_PATIENCE)

    # for the display, in its thread

    @property
    def player(self) -> Page | None:
        """The page that plays; None if there is none."""
        with self._changed:
            return self._pages[0] if self._pages else None

    @property
    def watched(self) -> bool:
        """True if any page is visible."""
        with self._changed:
            return any(not page.hidden for page in self._pages)

    @property
    def details(self) -> bool:
        """True if any page shows the timings."""
        with self._changed:
            return any(page.details for page in self._pages)

    def catch_up(self) -> None:
        """Let the server's thread read everything that has arrived."""

        async def hops() -> None:
            for _ in range(LOOP_HOPS):
                await asyncio.sleep(0)

        if self._thread.is_alive():
            done = asyncio.run_coroutine_threadsafe(hops(), self._loop)
            with contextlib.suppress(concurrent.futures.TimeoutError, concurrent.futures.CancelledError):
                done.result(THREAD_PATIENCE)

    def wait(self, seconds: float, *, for_picture: bool = False) -> None:
        """Wait for an event of the player, or until the player's page is ready for a picture, at most `seconds`."""

        def due() -> bool:
            if for_picture:
                return any(page.flow.ready for page in self._pages[:1])
            return bool(self._events)

        with self._changed:
            self._changed.wait_for(due, seconds)

    def take(self) -> list[tuple]:
        """The player's messages since the last call, without stamps; ("left",) where another page took over."""
        with self._changed:
            events = list(self._events)
            self._events.clear()
            stamps = [what[-1] for name, *what in events if name in STAMPED]
            if stamps and self._pages and self._pages[0].stamp is None:
                self._pages[0].stamp = stamps[0]
        return [event[:-1] if event[0] in STAMPED else event for event in events]

    def show(
        self, picture: int, overlay: list, pixels: Callable[[], np.ndarray], *, still: bool, shape: tuple[int, int]
    ) -> None:
        """Send a picture to the pages that are ready for one and do not have it yet.

        picture  its number; overlay: strokes over it; pixels: gives (H, W, 4) uint8 RGBA
        still    nothing moves: it goes out in full quality, again if need be
        shape    width and height to which it is stretched, in any unit
        """
        due, others = [], []
        with self._changed:
            now = perf_counter()
            for page in self._pages:
                quality = STILL_QUALITY if still else page.flow.quality
                seen, seen_quality = page.flow.last
                if seen == picture and not (still and seen_quality < quality):
                    others.append(page)
                elif page.flow.ready and not page.hidden:
                    number = page.flow.send(now, picture, quality)
                    due.append((page, quality, {"n": number, "stamp": page.stamp, "shape": shape}))
                    page.stamp, page.told["overlay"] = None, overlay
        for page in others:
            self._tell(page, {"overlay": overlay})
        if due:
            self._deliver(pixels(), overlay, due)

    def _deliver(self, pixels: np.ndarray, overlay: list, due: Sequence[tuple[Page, int, dict]]) -> None:
        """Encode a picture once for each quality, and send it: the length of a JSON header, the header, the JPEG."""
        encoded: dict[int, bytes] = {}
        for page, quality, header in due:
            if quality not in encoded:
                encoded[quality] = self._encode(pixels, quality)
            head = json.dumps({**header, "overlay": overlay}).encode()
            data = struct.pack("<I", len(head)) + head + encoded[quality]
            page.flow.bytes += len(data)
            self._call(send, page, data)
        sent = threading.Event()
        self._call(sent.set)
        sent.wait(THREAD_PATIENCE)

    def greet(self, hello: dict) -> None:
        """Replace the first message to pages, and send it to those that are open."""
        with self._changed:
            self._hello, pages = hello, list(self._pages)
        for page in pages:
            self._call(send, page, json.dumps(hello))

    def tell(self, state: dict) -> None:
        """Send each page the changes of the state that it has not seen yet."""
        with self._changed:
            pages = list(self._pages)
        for page in pages:
            self._tell(page, state)

    def _tell(self, page: Page, state: dict) -> None:
        news = {key: value for key, value in state.items() if key not in page.told or page.told[key] != value}
        if news:
            page.told |= news
            self._call(send, page, json.dumps(news))

    def _call(self, function: Callable, *arguments) -> None:
        """Call a function in the server's thread, if it still runs."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(function, *arguments)

    # in the server's thread

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._loop.run_until_complete(self._serve())
        self._loop.close()

    async def _serve(self) -> None:
        silent = logging.getLogger("vrgs.web")  # strangers' faulty requests are no news
        silent.addHandler(logging.NullHandler())
        silent.propagate = False
        async with serve(
            self._attend,
            sock=self._socket,
            process_request=self._answer,
            compression=None,
            max_size=MESSAGE_BYTES,
            server_header=None,
            logger=silent,
            close_timeout=1,
            ping_timeout=PING_TIMEOUT,
        ):
            await self._ended.wait()

    def _answer(self, connection, request):
        """The answer to a request over HTTP; None: it becomes a socket."""
        try:
            url, origin = urlsplit(request.path), request.headers.get("Origin")
            token = parse_qs(url.query).get("token", [""])[0]
            known = hmac.compare_digest(token.encode(), self._token.encode())
            host = request.headers["Host"]
            here = origin is None or urlsplit(origin).netloc == host  # a page of another site
            here = here and known and names_here(host, self._host)  # or one whose name was pointed to this machine
        except (ValueError, LookupError):
            known = here = False
        if not known or not here:
            return response(connection, HTTPStatus.FORBIDDEN, "Open the whole address that the program prints.\n")
        if url.path == "/":
            return page_response(connection, self._hello["title"])
        if url.path != "/socket":
            return response(connection, HTTPStatus.NOT_FOUND)
        with self._changed:
            full = len(self._pages) >= MAX_PAGES
        return response(connection, HTTPStatus.SERVICE_UNAVAILABLE) if full else None

    async def _attend(self, connection) -> None:
        """Serve a page as long as its socket is open."""
        page = Page(connection)
        send(page, json.dumps(self._hello))
        with self._changed:
            self._pages.append(page)
            self.flows.append(page.flow)
            self._assign_roles()
        pings = asyncio.ensure_future(self._measure_delay(page))
        try:
            async for message in connection:
                self._receive(page, message)
        except BadInput as e:
            await connection.close(POLICY_VIOLATION, str(e))
        except ConnectionClosed:
            pass
        finally:
            pings.cancel()
            with self._changed:
                if page is self._pages[0]:
                    self._change_player()
                self._pages.remove(page)
                self._assign_roles()

    def _change_player(self) -> None:
        """Forget what the player has sent: another page plays from now on."""
        self._events.clear()
        self._events.append(("left",))

    def _assign_roles(self) -> None:
        for k, page in enumerate(self._pages):
            send(page, json.dumps({"role": "watch" if k else "play", "pages": len(self._pages)}))
        self._changed.notify_all()

    async def _measure_delay(self, page: Page) -> None:
        """Send small messages where no picture is in their way."""
        while True:
            with self._changed:
                if not page.flow.under_way and page.pinged is None:
                    page.pinged = perf_counter()
                    send(page, json.dumps({"ping": page.flow.frames}))
            await asyncio.sleep(PING_INTERVAL)

    def _receive(self, page: Page, message: str | bytes) -> None:
        """Handle a message of a page. Raises BadInput if it is malformed, or if there are too many."""
        now = perf_counter()
        if not page.may_speak(now):
            raise BadInput("too many messages")
        name, *values = read_message(message)
        with self._changed:
            if name == "shown":
                number, milliseconds = values
                if not page.flow.shown(number, now, None if milliseconds is None else milliseconds / 1e3):
                    raise BadInput("no such picture")
            elif name == "pong":
                if page.pinged is not None and values[0] == page.flow.frames:  # no picture went between them
                    page.flow.delays.append(now - page.pinged)
                page.pinged = None
            elif name == "size":
                page.size = tuple(values)
            elif name == "hidden":
                (page.hidden,) = values
            elif name == "details":
                (page.details,) = values
            elif name == "take":
                if page is not self._pages[0]:
                    self._change_player()
                    self._pages.remove(page)
                    self._pages.insert(0, page)
                self._assign_roles()
            elif page is self._pages[0]:
                self._queue((name, *values))
            self._changed.notify_all()

    def _queue(self, event: tuple) -> None:
        """Queue an event for the display; of consecutive moves only the last, with the stamp of the first."""
        if event[0] == "move" and self._events and self._events[-1][0] == "move":
            event = (*event[:-1], self._events.pop()[-1])
        if len(self._events) >= MAX_EVENTS:
            raise BadInput("too many messages")
        self._events.append(event)


def send(page: Page, message: str | bytes) -> None:
    """Send a message, unless the socket is closing. Runs in the server's thread."""
    broadcast([page.connection], message)


def listen(host: str, port: int) -> socket.socket:
    """A listening socket; port 0: the default one, or the next free one. Raises BadInput."""
    ports = [port] if port else [*range(DEFAULT_PORT, DEFAULT_PORT + PORTS_TRIED)]
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for one in ports:
        try:
            listening = socket.create_server((host, one), family=family)
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)  # connections inherit it
            return listening
        except OSError as e:
            if e.errno == errno.EADDRINUSE:
                continue
            reason = (e.strerror or str(e)).partition(" (while ")[0]  # the rest repeats the address
            raise BadInput(f"cannot listen on {host}, port {one} ({reason})") from e
    taken = f"port {port} is taken" if port else f"the ports {ports[0]} to {ports[-1]} are taken"
    raise BadInput(f"{taken}: choose another one with --web PORT")


def names_here(host: str, listening: str) -> bool:
    """Tell whether the Host of a request, with or without a port, is an address or a name of this machine.

    `listening`: the name or address that the user gave. Raises ValueError for what is no host.
    """
    name, own = (urlsplit(f"//{host}").hostname or "").rstrip("."), socket.gethostname().lower()
    with contextlib.suppress(ValueError):
        ip_address(name)
        return True
    return name in ("localhost", listening.lower(), own, f"{own}.local") or name == socket.getfqdn().lower()


def response(connection, status: HTTPStatus, body: str = "", kind: str = "text/plain", policy: str = ""):
    """A whole answer over HTTP."""
    answer = connection.respond(status, body)
    del answer.headers["Content-Type"]
    answer.headers["Content-Type"] = f"{kind}; charset=utf-8"
    answer.headers["Cache-Control"] = "no-store"
    answer.headers["X-Content-Type-Options"] = "nosniff"
    answer.headers["Referrer-Policy"] = "no-referrer"
    if policy:
        answer.headers["Content-Security-Policy"] = policy
    return answer


def page_response(connection, title: str):
    """The page with style and script inlined: a single answer holds everything."""
    nonce = secrets.token_urlsafe(12)
    style, script = ((FOLDER / name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    page = Template((FOLDER / "page.html").read_text(encoding="utf-8"))
    body = page.substitute(title=escape(title), style=style, script=script, nonce=nonce)
    return response(connection, HTTPStatus.OK, body, "text/html", POLICY.format(nonce))
