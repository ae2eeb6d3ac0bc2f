"""The world's clock in a headset: pure functions, and a world that is stepped by it."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from core.vocabulary import Hand, Touch
from display.clock import (
    CATCH_UP_TIME,
    MAX_STEP,
    MIN_CATCH_UP,
    MIN_PERIOD,
    Clock,
    SimulationCost,
    caught_up,
    frame_steps,
    interpolate_hand,
)
from sim.solver import MAX_FRAME_DT

PERIOD = 11_111_111  # [ns], 90 Hz


def run(gaps, cost=0.0):
    """(clock, its ticks) over frames that follow each other after these gaps [periods]."""
    clock, shown = Clock(), 10**15
    ticks = [clock.advance(shown, PERIOD, cost)]
    for gap in gaps:
        shown += round(gap * PERIOD)
        ticks.append(clock.advance(shown, PERIOD, cost))
    return clock, ticks


def test_the_world_is_as_old_as_what_is_displayed_however_many_frames_were_missed():
    gaps = [1, 1, 3, 1, 2, 1, 1.01, 0.99, 10, 1]
    clock, ticks = run(gaps)
    assert clock.time == pytest.approx((1 + sum(gaps)) * PERIOD * 1e-9) and clock.dropped == pytest.approx(0.0)
    assert [t.missed for t in ticks] == [0, 0, 0, 2, 0, 1, 0, 0, 0, 9, 0]
    assert ticks[0].dt == pytest.approx(PERIOD * 1e-9)  # the first one is like any other


def test_steps_are_equal_end_with_the_frame_and_are_never_longer_than_the_period():
    for gap in (1, 1.001, 2, 2.6, 7):
        dt = gap * PERIOD * 1e-9
        steps = [d for d, _ in frame_steps(dt, PERIOD * 1e-9, [], [])]
        assert sum(steps) == pytest.approx(dt) and len(set(steps)) == 1
        assert steps[0] <= 1.26 * PERIOD * 1e-9 <= MAX_FRAME_DT and len(steps) == max(1, np.ceil(gap - 0.25))
    assert [d for d, _ in frame_steps(0.4, None, [], [])] == [0.4]
    assert run([1])[1][1].max_step == pytest.approx(PERIOD * 1e-9)
    strange = (Clock().advance(5, period, None) for period in (0, 10**12, -3))
    assert [t.max_step for t in strange] == [MIN_PERIOD, MAX_STEP, MIN_PERIOD]


def test_a_pause_is_not_made_up_for():
    clock, shown = Clock(), 0
    for gap in (1, 1):
        shown += gap * PERIOD
        clock.advance(shown, PERIOD, 0.1)
    clock.rest()
    usual = clock.advance(shown + 10**12, PERIOD, 0.1)
    assert usual.dt == pytest.approx(PERIOD * 1e-9) and usual.missed == 0
    assert clock.advance(shown - 10**12, PERIOD, 0.1) == usual  # another runtime's time
    assert clock.time == pytest.approx(4 * PERIOD * 1e-9) and clock.dropped == 0.0


def test_what_passes_while_kernels_are_compiled_is_let_go_of_without_a_word():
    clock = Clock()
    for shown in (0, PERIOD, PERIOD + 5 * 10**9):
        tick = clock.advance(shown, PERIOD, None)
    assert tick.dt == MIN_CATCH_UP and clock.dropped == 0.0


@pytest.mark.parametrize("cost", [0.1, 0.3, 0.6, 0.9])
def test_after_any_gap_a_machine_that_can_keep_up_does_so_in_time(cost):
    """Each frame takes as long as simulating what it makes up for, at least a period."""
    clock, shown, gap, waited = Clock(), 0, 0.4, 0.0
    clock.advance(shown, PERIOD, cost)
    while gap > 1.5 * PERIOD * 1e-9:
        shown += round(gap * 1e9)
        dt = clock.advance(shown, PERIOD, cost).dt
        gap = max(cost * dt, PERIOD * 1e-9)
        waited += gap
    assert waited <= CATCH_UP_TIME + 2 * PERIOD * 1e-9
    assert (clock.dropped == 0.0) == (CATCH_UP_TIME * (1 - cost) >= 0.4)


@pytest.mark.parametrize("cost", [1.0, 1.3, 5.0])
def test_a_machine_that_cannot_keep_up_draws_on_at_a_slower_pace(cost):
    clock, shown, gap, longest = Clock(), 0, 0.3, 0.0
    begin = clock.advance(shown, PERIOD, cost).dt
    for _ in range(100):
        shown += round(gap * 1e9)
        gap = cost * clock.advance(shown, PERIOD, cost).dt + 0.02
        longest = max(longest, gap)
    assert longest <= cost * MIN_CATCH_UP + 0.02 + 1e-9
    assert clock.dropped == pytest.approx(begin + shown * 1e-9 - clock.time) and clock.dropped > 0.1


@pytest.mark.parametrize(("cost", "dt", "dropped"), [(None, 0.05, 0.0), (0.3, 0.1, 0.0), (2.0, 0.05, 0.05)])
def test_time_is_caught_up_with_where_simulation_is_faster_than_it(cost, dt, dropped):
    """Ten pictures a second, in a window too: all time is simulated, or the world slows down and says how much."""
    assert caught_up(0.1, cost) == pytest.approx((dt, dropped))


def test_what_simulating_costs_is_told_by_the_usual_frame_not_by_the_first_nor_by_a_hitch():
    cost = SimulationCost()
    assert cost.value is None
    cost.note(0.0, 0.0)
    cost.note(30.0, 0.01)
    assert cost.value is None
    for seconds in (0.002, 0.002, 0.5, 0.0022, 0.0019):
        cost.note(seconds, 0.01)
    cost.note(1.0, 0.0)
    assert cost.value == pytest.approx(0.2)


def test_a_hand_is_led_evenly_and_grips_only_at_the_end():
    a = Hand((0.0, 1.0, 0.0), (1.0, 0.0, 0.0, 0.0), False, 0.02)
    b = Hand((0.3, 1.0, 0.0), (0.0, 0.0, -1.0, 0.0), True, 0.05)
    steps = frame_steps(0.03, 0.01, [a, b], [b, a])
    hands = [hands[0] for _, hands in steps]
    assert_allclose([h.position[0] for h in hands], [0.1, 0.2, 0.3])
    assert [h.grip for h in hands] == [False, False, True] and hands[-1] == b
    assert_allclose([np.linalg.norm(h.rotation) for h in hands], 1.0)
    assert [other[1].grip for _, other in steps] == [True, True, False]
    assert_allclose(
        interpolate_hand(a, Hand((0.1, 1.0, 0.0), (-1.0, 0.0, 0.0, 0.0)), 0.5).rotation, a.rotation
    )  # the same turn


def test_a_hand_that_was_found_elsewhere_is_there_at_once():
    a, b = Hand((0.0, 1.0, 0.0)), Hand((1.5, 1.0, 0.0), grip=True)
    assert interpolate_hand(a, b, 0.3) == b
    assert interpolate_hand(a, Hand((float("nan"), 1.0, 0.0)), 0.3).position[0] != 0.0
    assert [h for _, (h,) in frame_steps(0.03, 0.01, [], [b])] == [b, b, b]
    assert interpolate_hand(a, None, 0.5) is None and interpolate_hand(None, b, 0.5) is b


def test_finger_capsules_and_reach_are_led_too():
    a = Hand(reach=0.02, touch=(Touch((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 0.1),))
    b = Hand(reach=0.04, touch=(Touch((1.0, 0.0, 0.0), (1.0, 1.0, 2.0), 0.2),))
    half = interpolate_hand(a, b, 0.5)
    assert half.touch == (Touch((0.5, 0.0, 0.0), (0.5, 1.0, 1.0), pytest.approx(0.15)),)
    assert half.reach == pytest.approx(0.03)
    b.touch = ()
    assert interpolate_hand(a, b, 0.5).touch == a.touch
