"""Flow of pictures to a page on a simulated connection with a delay and a number of bytes per second."""

import pytest

from display.web.page_server import MAX_UNDER_WAY, QUALITIES, PictureFlow

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
