"""The controller of a headset's resolution, on machines that are made up."""

import itertools

import numpy as np
import pytest

from display.xr.dynamic_resolution import GRAIN, HIGH, LEAST, LOW, PATIENT, SETTLE, UP, DynamicResolution

BUDGET = 1 / 90
FULL = (1800, 1920)


def play(machine, frames, resolution=None):
    """The shares of a side over `frames` frames, each of which takes machine(frame, share of the pixels) budgets."""
    resolution = resolution or DynamicResolution(FULL)
    shares = []
    for frame in range(frames):
        width, height = resolution.size
        resolution.note(BUDGET * machine(frame, width * height / (FULL[0] * FULL[1])), BUDGET)
        shares.append(resolution.share)
    return np.array(shares), resolution


@pytest.mark.parametrize("pixels", [0.2, 0.6, 0.89, 1.0, 1.5, 2.5])
@pytest.mark.parametrize("fixed", [0.0, 0.2, 0.4])
def test_it_finds_the_most_pixels_that_hold_the_rate_and_stays_there(pixels, fixed):
    shares, resolution = play(lambda frame, area: fixed + pixels * area, 2000)
    settled = shares[1000:]
    assert np.ptp(settled) == 0.0, "it swings"
    share = settled[-1]
    load = fixed + pixels * resolution.size[0] * resolution.size[1] / (FULL[0] * FULL[1])
    assert load <= HIGH or share == LEAST
    assert share == 1.0 or load >= LOW  # no pixel is left out without need
    assert resolution.size[0] % GRAIN == 0 and resolution.size <= FULL


def test_noise_does_not_make_it_restless():
    rng = np.random.default_rng(3)
    shares, _ = play(lambda frame, area: (0.3 + 0.9 * area) * rng.uniform(0.93, 1.07), 4000)
    assert len(np.flatnonzero(np.diff(shares[500:]))) <= 4
    assert 0.55 < shares[-1] < 0.85


def test_a_hitch_changes_nothing_but_a_burden_does_and_its_end_is_seen():
    def machine(frame, area):
        if frame in (100, 101, 130, 131):
            return 9.0
        return (1.6 if 300 <= frame < 600 else 0.6) * area

    shares, resolution = play(machine, 2000)
    assert np.all(shares[:300] == 1.0)
    assert shares[330] < 0.8 and shares[590] >= LEAST  # a third of a second later it holds
    assert 1.6 * shares[340] ** 2 <= HIGH
    assert shares[-1] == 1.0 and np.all(np.diff(shares[600:]) >= 0.0)
    assert np.diff(shares).max() <= UP and resolution.size == FULL
    assert np.flatnonzero(shares[600:] == 1.0)[0] < 10 * (PATIENT + SETTLE)


def test_where_pixels_are_not_the_burden_it_stops_at_the_least():
    shares, resolution = play(lambda frame, area: 3.0, 500)
    assert shares[-1] == LEAST and resolution.size == (896, 960)
    assert np.all(np.diff(shares) <= 0.0)


def test_what_is_slow_for_other_reasons_does_not_cost_pixels():
    resolution = DynamicResolution(FULL)
    for _ in range(300):
        resolution.note(3.0 * BUDGET, BUDGET, 0.5 * BUDGET)
    assert resolution.share == 1.0
    for _ in range(300):
        resolution.note(3.0 * BUDGET, BUDGET, 1.5 * BUDGET)
    assert resolution.share == LEAST


def test_a_small_picture_is_never_drawn_larger_than_it_is():
    resolution = DynamicResolution((17, 9))
    assert resolution.size == (17, 9)
    assert resolution.hold(0.99) and resolution.size == (16, 8)
    assert resolution.hold(0.5) and resolution.size == (8, 8)
    resolution = DynamicResolution(FULL)
    assert resolution.hold(0.75) and resolution.size == (1352, 1440) and not resolution.hold(0.75)
    assert resolution.hold(0.1) and resolution.share == LEAST


def test_growing_never_makes_a_frame_too_slow():
    assert LOW * (1 + UP) ** 2 < HIGH
    for full, share in itertools.product((FULL, (633, 712)), np.linspace(LEAST, 1 / (1 + UP), 50)):
        small, large = DynamicResolution(full), DynamicResolution(full)
        small.share, large.share = share, share * (1 + UP)
        assert LOW * np.prod(large.size) / np.prod(small.size) < HIGH  # rounded sides included
