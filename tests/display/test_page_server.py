"""The server of the page in this process: who gets in, who plays, what it bears, and the flow of its pictures."""

import contextlib
import http.client
import json
import socket
from urllib.parse import urlsplit

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from core.errors import BadInput
from display.web import page_server
from display.web.browser import encode
from display.web.page_server import MAX_UNDER_WAY, QUALITIES, PageServer, PictureFlow, listen
from tests.support.page_client import PageClient, socket_address
from tests.support.waiting import until

GREY = np.full((90, 160, 4), 128, np.uint8)
SHAPE = (48, 35)  # that of the page, not of the pixels


@pytest.fixture
def server():
    server = PageServer("127.0.0.1", 0, {"title": "<Ball>"}, encode)
    yield server
    server.close()


def answer(server, path: str, **headers) -> tuple[int, bytes]:
    """Status and body of a GET."""
    connection = http.client.HTTPConnection(urlsplit(server.address).netloc, timeout=20)
    with contextlib.closing(connection):
        connection.request("GET", path, headers=headers)
        response = connection.getresponse()
        return response.status, response.read()


def test_the_page_is_whole_and_asks_nothing_of_the_network(server):
    token = urlsplit(server.address).query
    status, body = answer(server, f"/?{token}")
    text = body.decode()
    assert status == 200 and "<title>&lt;Ball&gt;</title>" in text and "function connect()" in text
    assert "$" + "title" not in text and 'src="' not in text and 'rel="stylesheet"' not in text
    assert "http" not in text.replace("http://www.w3.org/2000/svg", "").replace('"https:"', "")


@pytest.mark.parametrize("path", ["/", "/?token=", "/?token=wrong", "/socket", "/page.js", "//", "/%00", "/?token=%ff"])
def test_without_the_token_there_is_nothing(server, path):
    assert answer(server, path) == (403, b"Open the whole address that the program prints.\n")


def test_a_socket_takes_the_token_and_a_page_of_this_server(server):
    address = socket_address(server.address)
    for wrong in (address[:-1], address.partition("?")[0]):
        with pytest.raises(InvalidStatus, match="403"):
            connect(wrong)
    for origin in ("http://evil.example", "null", "http://127.0.0.1:1", "http://["):
        with pytest.raises(InvalidStatus, match="403"):
            PageClient(server.address, origin=origin)
    with PageClient(server.address) as page, PageClient(server.address, origin=None) as other:
        page.until(lambda: page.state.get("pages") == 2)
        other.until(lambda: other.state.get("role") == "watch")
    assert answer(server, f"/other?{urlsplit(address).query}")[0] == 404


def test_a_name_that_is_not_of_this_machine_gets_nothing(server):
    """As of a page of another site, whose name was pointed here after it was loaded: its origin is that of the host."""
    path, own = f"/?{urlsplit(server.address).query}", socket.gethostname()
    refusal = 403, b"Open the whole address that the program prints.\n"
    for host in ("evil.example:8090", "localhost.evil.example", "127.0.0.1.evil.example", "", "[::1", "a b"):
        assert answer(server, path, Host=host, Origin=f"http://{host}") == refusal
    for host in ("localhost:9000", "127.0.0.1", "[::1]:8090", own, f"{own.upper()}.local:8090"):
        assert answer(server, path, Host=host, Origin=f"http://{host}")[0] == 200


def test_the_first_page_plays_another_may_take_over_and_the_next_one_follows(server):
    with PageClient(server.address) as first, PageClient(server.address) as second:
        first.until(lambda: first.state.get("role") == "play")
        second.until(lambda: second.state.get("role") == "watch")
        second.send("wheel", 1, 5)  # of a watcher: nothing
        first.send("wheel", 2, 5)
        first.send("move", 0.1, 0.2, 6)
        first.send("move", 0.3, 0.4, 7)  # of moves the last one counts
        until(lambda: len(server._events) == 2 and server._events[-1][1] == 0.3)
        assert server.take() == [("wheel", 2.0), ("move", 0.3, 0.4)]

        first.send("wheel", 3, 8)  # sent before, and not to be carried out after
        until(lambda: server._events)
        second.send("take")
        first.until(lambda: first.state["role"] == "watch")
        second.until(lambda: second.state["role"] == "play")
        assert server.take() == [("left",)]
        second.socket.close()
        first.until(lambda: first.state["role"] == "play" and first.state["pages"] == 1)
        assert server.take() == [("left",)]
    until(lambda: server.player is None and not server.watched)


@pytest.mark.parametrize("message", ["nonsense", '["shown", 99, null]', b"\x00", "x" * 5000])
def test_a_malformed_message_closes_its_own_connection_alone(server, message, capfd):
    with PageClient(server.address) as good, PageClient(server.address) as bad:
        good.until(lambda: good.state.get("pages") == 2)
        bad.socket.send(message)
        with pytest.raises(ConnectionClosed):
            bad.during(20.0)
        assert bad.socket.close_code in (1008, 1009)
        good.until(lambda: good.state["pages"] == 1)
    assert capfd.readouterr() == ("", "")


def test_a_flood_closes_its_connection(server):
    with PageClient(server.address) as page, pytest.raises(ConnectionClosed):
        for _ in range(100):
            page.socket.send(json.dumps(["blur"]))
        page.until(lambda: page.state)
        for _ in range(5000):
            page.socket.send(json.dumps(["blur"]))
        page.during(20.0)


def test_there_is_room_for_some_pages_and_no_more(server, monkeypatch):
    monkeypatch.setattr(page_server, "MAX_PAGES", 2)
    with PageClient(server.address), PageClient(server.address):
        until(lambda: len(server.flows) == 2)
        with pytest.raises(InvalidStatus, match="503"):
            PageClient(server.address)


def test_garbage_on_the_port_does_no_harm(server, capfd):
    for garbage in (b"\x00" * 100, b"POST / HTTP/1.1\r\n\r\n", b"GET " + b"a" * 20_000 + b"\r\n\r\n", b""):
        with socket.create_connection(server._socket.getsockname(), timeout=20) as raw:
            raw.sendall(garbage)
            if garbage:
                raw.shutdown(socket.SHUT_WR)
                while raw.recv(4096):
                    pass
    assert answer(server, "/") == (403, b"Open the whole address that the program prints.\n")
    assert capfd.readouterr() == ("", "")


def test_a_picture_goes_out_once_then_in_full_quality_and_only_as_answers_come(server):
    with PageClient(server.address, answers=False) as page:
        page.until(lambda: page.state.get("role"))
        for number in (1, 1, 2, 3):
            server.show(number, [], lambda: GREY, still=False, shape=SHAPE)
        page.until(lambda: page.pictures)
        assert page.during(0.2) == 0  # the first one is not answered yet
        page.answers = True
        page.send("shown", page.pictures[0][0]["n"], 20.0)
        until(lambda: server.player.flow.ready)
        server.show(3, [], lambda: GREY, still=False, shape=SHAPE)
        page.until(lambda: len(page.pictures) == 2)
        until(lambda: server.player.flow.ready)
        server.show(3, [], lambda: GREY, still=False, shape=SHAPE)  # it has that
        server.show(3, [[0.5, 0.5]], lambda: GREY, still=True, shape=SHAPE)
        page.until(lambda: len(page.pictures) == 3)
        until(lambda: server.player.flow.ready)
        server.show(3, [], lambda: GREY, still=True, shape=SHAPE)  # other strokes alone: no picture
        page.until(lambda: page.state.get("overlay") == [])
        assert len(page.pictures) == 3
        (_, moving, pixels), (header, still, _) = page.pictures[1:]
        assert (
            (header["overlay"], header["shape"]) == ([[0.5, 0.5]], list(SHAPE))
            and still >= moving
            and np.abs(pixels.astype(int) - 128).max() < 3
        )
        assert list(server.flows[0].latencies) == [0.02] and server.flows[0].frames == 3


def test_a_port_that_is_taken_is_told_and_the_default_one_has_followers(server):
    with pytest.raises(BadInput, match="is taken"):
        listen("127.0.0.1", server._socket.getsockname()[1])
    with contextlib.closing(listen("127.0.0.1", 0)) as one, contextlib.closing(listen("127.0.0.1", 0)) as other:
        assert one.getsockname()[1] < other.getsockname()[1]
    with pytest.raises(BadInput, match="cannot listen on"):
        listen("no.such.host.invalid", 0)


def test_pages_are_told_when_the_play_ends():
    server = PageServer("127.0.0.1", 0, {"title": "Ball"}, encode)
    with PageClient(server.address) as page:
        page.until(lambda: page.state.get("role"))
        server.close()
        server.close()
        with pytest.raises(ConnectionClosed):
            page.during(20.0)
        assert page.socket.close_code == 1001


# the flow of pictures on a simulated connection with a delay and a number of bytes per second

BYTES = {35: 20_000, 50: 30_000, 65: 40_000, 80: 60_000}  # of a picture of 960x540


def run(delay: float, bytes_per_second: float, *, seconds: float = 20.0, rate: float = 60.0):
    """The flow after some time, and [s] from the sending of each picture of the last half to its answer."""
    flow, now, free = PictureFlow(), 0.0, 0.0
    flow.delays.append(delay)
    answers: list[tuple[float, int, float]] = []  # when, which, sent when
    ways = []
    while now < seconds:
        now += 1 / rate
        while answers and answers[0][0] <= now:
            when, number, sent = answers.pop(0)
            assert flow.shown(number, when, None)
            if now > seconds / 2:
                ways.append(when - sent)
        if flow.ready:
            quality = flow.quality
            free = max(free, now) + BYTES[quality] / bytes_per_second
            answers.append((free + delay, flow.send(now, int(1000 * now), quality), now))
    return flow, ways


def test_a_fast_connection_gets_every_picture_in_the_best_quality():
    flow, ways = run(0.001, 1e9)
    assert flow.quality == QUALITIES[-1] and max(ways) < 0.02 and len(ways) > 500


def test_a_far_but_fast_connection_gets_as_many_pictures_as_a_near_one():
    flow, ways = run(0.1, 1e8)
    assert flow.window == 4 and flow.quality == QUALITIES[-1]
    assert len(ways) / 10 > 28 and max(ways) < 0.15


@pytest.mark.parametrize("delay", [0.002, 0.1])
def test_a_narrow_connection_gets_coarser_pictures_and_none_waits_for_long(delay):
    flow, ways = run(delay, 1e6)
    assert flow.quality < QUALITIES[-1]
    assert max(ways) < delay + 0.25  # a few pictures, not seconds


def test_a_page_that_never_answers_gets_a_bounded_number_of_pictures():
    flow = PictureFlow()
    flow.delays.append(10.0)
    while flow.ready:
        flow.send(0.0, 1, 80)
    assert len(flow.under_way) == MAX_UNDER_WAY
    assert not flow.shown(99, 1.0, None)  # an answer to what was never sent


def test_intervals_are_those_of_pictures_that_follow_one_another():
    flow = PictureFlow()
    for now in (0.0, 0.1, 5.0, 5.1):
        flow.shown(flow.send(now, int(10 * now), 80), now, 0.03)
    assert list(flow.intervals) == pytest.approx([0.1, 0.1]) and len(flow.latencies) == 4
