"""The controllers of the pictures' resolution, in a window and in a headset, on made-up machines."""

import itertools

import numpy as np
import pytest

from display.adaptive_resolution import DynamicResolution as R
from display.adaptive_resolution import WindowResolution

BUDGET = 1 / 90
FULL = (1800, 1920)


# in a window

WINDOW = (960, 540)


def run(resolution, begin, seconds, *, cost, moving):
    """Frames that take cost(scale) [s], all for pixels; returns the end and the scales of a side."""
    now, scales = begin, []
    while now < begin + seconds:
        scales.append(resolution.size(WINDOW)[0] / WINDOW[0])
        took = cost(scales[-1])
        now += took
        resolution.note(now, took, moving=moving)
    return now, scales


def test_a_slow_machine_draws_coarser_while_things_move_and_all_once_they_are_still():
    resolution, slow = WindowResolution(), lambda scale: 0.09 * scale**2
    now, scales = run(resolution, 0.0, 3.0, cost=slow, moving=True)
    assert scales[0] == 1.0 and scales[-1] < 0.75 and slow(scales[-1]) < WindowResolution.FRAME_TIME
    assert sum(itertools.takewhile(lambda t: t > WindowResolution.FRAME_TIME, map(slow, scales))) < 1.0
    now, still = run(resolution, now, 1.0, cost=slow, moving=False)
    assert still[0] == scales[-1] and still[-1] == 1.0
    assert sum(slow(s) for s in still if s < 1.0) <= WindowResolution.STILL_AFTER + 0.09
    _, again = run(resolution, now, 0.5, cost=slow, moving=True)
    assert set(again[1:]) == {scales[-1]}  # it is remembered


def test_another_window_keeps_the_scale_and_it_gets_finer_again_when_there_is_time():
    resolution = WindowResolution()
    now, scales = run(resolution, 0.0, 3.0, cost=lambda scale: 0.2 * scale**2, moving=True)
    assert scales[-1] == R.MIN_SCALE
    assert resolution.size((1920, 1080)) == (960, 544) and resolution.size((33, 32)) == (16, 16)
    now, scales = run(resolution, now, 12.0, cost=lambda scale: 0.01 * scale**2, moving=True)
    assert scales[-1] == 1.0


# in a headset


def worn(machine, frames, resolution=None):
    """The scales of a side over `frames` frames, each of which takes machine(frame, scale of the pixels) budgets."""
    resolution = resolution or R(FULL)
    scales = []
    for frame in range(frames):
        width, height = resolution.size
        resolution.note(BUDGET * machine(frame, width * height / (FULL[0] * FULL[1])), BUDGET)
        scales.append(resolution.scale)
    return np.array(scales), resolution


@pytest.mark.parametrize("pixels", [0.2, 0.6, 0.89, 1.0, 1.5, 2.5])
@pytest.mark.parametrize("fixed", [0.0, 0.2, 0.4])
def test_it_finds_the_most_pixels_that_hold_the_rate_and_stays_there(pixels, fixed):
    scales, resolution = worn(lambda frame, area: fixed + pixels * area, 2000)
    settled = scales[1000:]
    assert np.ptp(settled) == 0.0, "it swings"
    scale = settled[-1]
    load = fixed + pixels * resolution.size[0] * resolution.size[1] / (FULL[0] * FULL[1])
    assert load <= R.HIGH_LOAD or scale == R.MIN_SCALE
    assert scale == 1.0 or load >= R.LOW_LOAD  # no pixel is left out without need
    assert resolution.size[0] % R.ROUNDING == 0 and resolution.size <= FULL


def test_noise_does_not_make_it_restless():
    rng = np.random.default_rng(3)
    scales, _ = worn(lambda frame, area: (0.3 + 0.9 * area) * rng.uniform(0.93, 1.07), 4000)
    assert len(np.flatnonzero(np.diff(scales[500:]))) <= 4
    assert 0.55 < scales[-1] < 0.85


def test_a_hitch_changes_nothing_but_a_burden_does_and_its_end_is_seen():
    def machine(frame, area):
        if frame in (100, 101, 130, 131):
            return 9.0
        return (1.6 if 300 <= frame < 600 else 0.6) * area

    scales, resolution = worn(machine, 2000)
    assert np.all(scales[:300] == 1.0)
    assert scales[330] < 0.8 and scales[590] >= R.MIN_SCALE  # a third of a second later it holds
    assert 1.6 * scales[340] ** 2 <= R.HIGH_LOAD
    assert scales[-1] == 1.0 and np.all(np.diff(scales[600:]) >= 0.0)
    assert np.diff(scales).max() <= R.MAX_GROWTH and resolution.size == FULL
    assert np.flatnonzero(scales[600:] == 1.0)[0] < 10 * (R.GROW_AFTER + R.SKIPPED_FRAMES)


def test_what_is_slow_for_other_reasons_does_not_cost_pixels():
    resolution = R(FULL)
    for _ in range(300):
        resolution.note(3.0 * BUDGET, BUDGET, 0.5 * BUDGET)
    assert resolution.scale == 1.0
    for _ in range(300):
        resolution.note(3.0 * BUDGET, BUDGET, 1.5 * BUDGET)
    assert resolution.scale == R.MIN_SCALE


@pytest.mark.parametrize(
    ("full", "scale", "size"),
    [((17, 9), 1.0, (17, 9)), ((17, 9), 0.99, (16, 8)), ((17, 9), 0.5, (8, 8)), (FULL, 0.75, (1352, 1440))],
)
def test_a_side_is_rounded_and_never_larger_than_it_is(full, scale, size):
    resolution = R(full)
    resolution.hold(scale)
    assert resolution.size == size
    resolution.hold(0.1)
    assert resolution.scale == R.MIN_SCALE
