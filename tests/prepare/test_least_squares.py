"""Robust least squares: a minimum in spite of outliers, and intervals that hold the truth."""

import numpy as np
import pytest

from prepare.fit.least_squares import Prior, derivatives, minimise

FREE = Prior(np.zeros(2), np.full(2, 1e3), np.full(2, -50.0), np.full(2, 50.0), np.full(2, 1e-4))
T = np.linspace(0, 2, 200)


def oscillation(theta):
    """exp(-d t) cos(w t) of rows (log w, d), (C, 200)."""
    return np.exp(-theta[:, 1:] * T) * np.cos(np.exp(theta[:, :1]) * T)


def fitted_by(model, start):
    return minimise(model, np.array(start), FREE, 1.0)


def fitted(seen, start=(1.6, 0.5), noise=0.01):
    return fitted_by(lambda theta: (oscillation(theta) - seen) / noise, start)


def test_an_oscillation_is_found_though_a_tenth_of_the_data_is_wrong():
    rng = np.random.default_rng(0)
    truth = np.array([1.7, 0.8])
    seen = oscillation(truth[None])[0] + 0.01 * rng.normal(size=T.shape)
    wrong = rng.choice(len(T), 20, replace=False)
    seen[wrong] += 1.0
    seen[5] = np.nan
    found = fitted(seen)
    np.testing.assert_allclose(found.theta, truth, atol=0.02)
    np.testing.assert_allclose(found.scale, 1.0, rtol=0.3)


def test_nine_of_ten_intervals_hold_the_truth_where_errors_are_correlated():
    """Errors that change 12 times in 2 s, as those of a smooth model do: independent ones would hold it in a third."""
    truth, held = np.array([1.7, 0.8]), 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        wander = np.interp(T, np.linspace(0, 2, 25), rng.normal(size=25))
        found = fitted(oscillation(truth[None])[0] + 0.01 * wander)
        half = found.half_widths(np.arange(len(T)) * 10 // len(T))
        held += int((np.abs(found.theta - truth) < half).sum())
    assert 0.8 * 120 <= held <= 0.99 * 120


def test_shift_is_the_step_to_first_order():
    truth = np.array([1.7, 0.8])
    found = fitted(oscillation(truth[None])[0])
    moved = found.shift((oscillation(found.theta[None])[0] - oscillation(truth[None] + [[1e-3, -2e-3]])[0]) / 0.01)
    np.testing.assert_allclose(moved, [1e-3, -2e-3], rtol=0.05, atol=2e-5)


def test_a_minimum_that_steps_did_not_reach_is_not_known_better_than_to_the_step_that_is_left():
    """Residuals jump up beside the start, as where an impact comes a frame later; the minimum lies 0.03 further."""
    start = np.array([1.2, 0.8])

    def rough(theta):
        away = np.abs(theta - start).max(1, keepdims=True)
        return (oscillation(theta) - oscillation(start[None] + [[0.03, 0.0]])) / 0.01 + np.where(
            away > 1.5e-4, 1e3, 0.0
        )

    found = fitted_by(rough, start)
    assert found.theta.tolist() == start.tolist()
    assert found.half_widths(np.arange(len(T)) * 10 // len(T))[0] > abs(found.shift(found.residuals)[0]) > 0.02


def test_derivatives_are_those_of_the_model():
    row, J = derivatives(
        lambda theta: theta @ np.array([[1.0, 2.0, 3.0], [4.0, 5.0, np.nan]]), np.ones(2), np.full(2, 0.1)
    )
    assert row[:2].tolist() == [5.0, 7.0]
    np.testing.assert_allclose(J, [[1, 4], [2, 5], [0, 0]], atol=1e-12)


@pytest.mark.parametrize("bound", [1.5, 1.65])
def test_bounds_are_kept(bound):
    prior = Prior(FREE.centre, FREE.spread, FREE.low, np.array([bound, 50.0]), FREE.step)
    seen = oscillation(np.array([[1.7, 0.8]]))[0]
    found = minimise(lambda theta: (oscillation(theta) - seen) / 0.01, np.array([1.45, 0.5]), prior, 1.0)
    assert found.theta[0] <= bound + 1e-12
