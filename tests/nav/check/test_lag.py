"""Time offset by regression of increments: recovered exactly, honest when nothing tells."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.nav.check.lag import find_lag, fit_increments


def signal(t: np.ndarray) -> np.ndarray:
    """Two velocities with closed form and no period within the search."""
    return np.column_stack(
        [
            8 * np.sin(0.11 * t) + 3 * np.cos(0.043 * t**1.2) + 0.002 * (t - 100) ** 2,
            5 * np.cos(0.17 * t) + 2 * np.sin(0.021 * t**1.3),
        ]
    )


@pytest.mark.parametrize("lag", [0.0, 0.1, -0.37, 18.0, -18.0, 36.0])
def test_recovers_lag_whatever_axes_signs_and_units(lag):
    t = np.arange(0.0, 200.0, 0.01)
    mixed = signal(t) @ np.array([[0.0, -57.3], [9.8, 0.0]])
    start = np.arange(1.0, 195.0, 0.5)
    y = (signal(start + 1.0) - signal(start))[:, :1]
    found = find_lag(t + lag, mixed, start, start + 1.0, y)
    assert found is not None and found.conclusive
    assert found.lag == pytest.approx(lag, abs=2e-3)
    assert found.explained > 0.999


def test_sigma_covers_the_error_of_noisy_increments():
    t = np.arange(0.0, 200.0, 0.01)
    start = np.arange(1.0, 195.0, 0.5)
    clean = (signal(start + 1.0) - signal(start))[:, :1]
    errors, sigmas = [], []
    for seed in range(12):
        noise = np.random.default_rng(seed).normal(0.0, 0.05, clean.shape)
        found = find_lag(t, signal(t), start, start + 1.0, clean + noise)
        errors.append(found.lag)
        sigmas.append(found.sigma)
    normalised = np.sqrt(np.mean((np.array(errors) / np.array(sigmas)) ** 2))
    assert 0.5 < normalised < 2.0
    assert max(sigmas) < 0.1


def round_the_block(t: np.ndarray, period: float) -> np.ndarray:
    """Return a course that turns by 90° within 3 s, once a period, and a speed that sinks then."""
    phase = np.mod(t, period)
    course = np.pi / 2 * (np.floor(t / period) + np.clip((phase - 8.0) / 3.0, 0.0, 1.0))
    return np.column_stack([course, 2.0 * np.cos(2.0 * np.pi * t / period)])


@pytest.mark.parametrize("rate", [1.0, 5.0, 10.0])
@pytest.mark.parametrize("begin", [24.0, 38.0, 57.0, 73.0])
def test_equal_turns_are_no_offset_though_one_of_them_is_missing(rate, begin):
    """For 10 s the receiver repeats itself: no shift explains that turn, a whole round leaves it.

    Wherever in the drive; the sensors' stamps are right.
    """
    period = 17.0
    t = np.arange(0.0, 120.0, 0.02)
    start = np.arange(1.0, 117.0, 1.0 / rate)
    held = np.where((start > begin) & (start < begin + 10.0), begin, start)
    then = np.where((start + 1.0 > begin) & (start + 1.0 < begin + 10.0), begin, start + 1.0)
    y = round_the_block(then, period) - round_the_block(held, period)
    found = find_lag(t, round_the_block(t, period), start, start + 1.0, y[:, :1])
    assert found is None or not found.conclusive or abs(found.lag) < 0.2


def test_a_lag_in_a_drive_with_equal_turns_is_not_guessed():
    """True or a round later: both explain everything."""
    t = np.arange(0.0, 120.0, 0.02)
    start = np.arange(1.0, 90.0, 0.5)
    y = round_the_block(start + 1.0, 17.0) - round_the_block(start, 17.0)
    found = find_lag(t + 18.0, round_the_block(t, 17.0), start, start + 1.0, y[:, :1])
    assert found is None or abs(found.lag) < 1.5 or not found.conclusive


def test_an_expected_lag_need_only_beat_none():
    """Two equal turns, GNSS at the first alone: 18 s or 33 s, but not none."""
    t = np.arange(0.0, 100.0, 0.02)
    start = np.arange(1.0, 32.0, 0.25)
    turns = np.exp(-(((t[:, None] - [25.0, 40.0]) / 1.5) ** 2)).sum(axis=1)[:, None]
    y = np.interp(start + 1.0, t, turns[:, 0]) - np.interp(start, t, turns[:, 0])
    guessed = find_lag(t + 18.0, turns, start, start + 1.0, y[:, None])
    told = find_lag(t + 18.0, turns, start, start + 1.0, y[:, None], expected=(18.0, 36.0))
    assert told.lag == pytest.approx(18.0, abs=0.1)
    assert guessed is None or abs(guessed.lag) < 1.5


def test_unrelated_signals_are_not_conclusive():
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 200.0, 0.01)
    start = np.arange(1.0, 195.0, 0.5)
    walk = np.cumsum(rng.normal(size=(t.size, 2)), axis=0)
    found = find_lag(t, walk, start, start + 1.0, rng.normal(size=(start.size, 1)))
    assert found is None or not found.conclusive


def test_too_few_intervals_tell_nothing():
    t = np.arange(0.0, 20.0, 0.01)
    start = np.arange(1.0, 10.0)
    assert find_lag(t, signal(t), start, start + 1.0, start[:, None]) is None
    assert fit_increments(t, signal(t), start, start + 1.0, start).explained == 0.0


def test_fit_returns_coefficients_of_an_exact_combination():
    t = np.arange(0.0, 200.0, 0.02)
    start = 0.02 * np.arange(50, 9000, 25)
    end = start + 1.0
    y = (signal(end) - signal(start)) @ [0.7, -0.3] + 0.25
    fit = fit_increments(t, signal(t), start, end, y)
    np.testing.assert_allclose(fit.coefficients, [0.7, -0.3], atol=1e-6)
    assert fit.explained == pytest.approx(1.0, abs=1e-9)
    assert (fit.sigma < 1e-5).all()
