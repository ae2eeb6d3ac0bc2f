"""How fine pictures are drawn while things move."""

import itertools

from display.window.adaptive_resolution import LEVELS, PACE, STILL, AdaptiveResolution


def run(quality, begin, seconds, *, cost, moving):
    """Frames of which each takes cost(share) [s]; returns the end and the shares."""
    now, shares = begin, []
    while now < begin + seconds:
        shares.append(quality.share)
        took = cost(quality.share)
        now += took
        quality.note(now, took, moving=moving)
    return now, shares


def test_a_slow_machine_draws_coarser_while_things_move_and_all_once_they_are_still():
    quality = AdaptiveResolution()
    now, shares = run(quality, 0.0, 3.0, cost=lambda share: 0.09 * share**2, moving=True)
    assert shares[0] == 1.0 and shares[-1] == 0.5  # 0.75 would take 50 ms
    now, shares = run(quality, now, 1.0, cost=lambda share: 0.09 * share**2, moving=False)
    assert shares[0] == 0.5 and shares[-1] == 1.0
    assert sum(0.09 * s**2 for s in shares if s < 1.0) <= STILL + 0.09
    _, shares = run(quality, now, 1.0, cost=lambda share: 0.09 * share**2, moving=True)
    assert set(shares[1:]) == {0.5}  # it is remembered


def test_a_fast_machine_draws_everything():
    assert set(run(AdaptiveResolution(), 0.0, 2.0, cost=lambda share: 0.7 * PACE, moving=True)[1]) == {1.0}


def test_it_gets_finer_again_when_there_is_time_and_does_not_swing():
    quality = AdaptiveResolution()
    now, _ = run(quality, 0.0, 2.0, cost=lambda share: 0.2 * share**2, moving=True)
    now, shares = run(quality, now, 2.0, cost=lambda share: 0.01 * share**2, moving=True)
    assert shares[-1] == 1.0
    _, shares = run(quality, now, 5.0, cost=lambda share: 0.01 + 0.05 * share**2, moving=True)
    changes = sum(a != b for a, b in itertools.pairwise(shares))
    assert changes <= 1 and shares[-1] in LEVELS


def test_what_pixels_do_not_change_ends_at_the_coarsest():
    _, shares = run(AdaptiveResolution(), 0.0, 3.0, cost=lambda share: 0.2, moving=True)
    assert shares[-1] == LEVELS[-1]
