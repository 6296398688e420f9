"""The sliding window against the problem built from the same rows at once."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from certnav.alignment.problem import ClockModel, build_problem
from certnav.alignment.reference.simulation import simulate_window
from certnav.alignment.window import SlidingWindow
from certnav.filters.errors import AlignmentError, ConfigError, DataError


@pytest.fixture(scope="module")
def rows():
    """Four satellites, 40 epochs, a clock of 10 km/s that drifts."""
    return simulate_window(
        np.random.default_rng(1), 4, "3d", epochs=40, sigma=0.1, clock_drift=1e4, clock_rate=0.05
    ).rows


def feed(window: SlidingWindow, rows, first: int, last: int) -> SlidingWindow:
    for k in range(first, last):
        epoch = rows.take(rows.epoch == k)
        window.push(epoch, epoch.e_e if window.nuisances else None)
    return window


@pytest.mark.parametrize(
    ("clock", "nuisances"),
    [("constant", 0), ("linear", 0), ("per-epoch", 0), ("constant", 3), ("linear", 3)],
)
def test_equals_the_problem_of_its_rows(rows, clock, nuisances):
    window = SlidingWindow(9.0, ClockModel(clock), nuisances=nuisances)
    for first, last in pairwise((0, 5, 10, 11, 23, 40)):
        feed(window, rows, first, last)
        held = rows.take((rows.epoch >= last - 10) & (rows.epoch < last))
        whole = build_problem(held, ClockModel(clock), held.e_e if nuisances else None)
        problem = window.problem()
        assert len(window) == min(10, last)
        assert problem.dof == whole.dof
        assert problem.information == pytest.approx(whole.information)
        scale = np.trace(whole.Q)
        np.testing.assert_allclose(problem.Q, whole.Q, atol=1e-12 * scale)
        np.testing.assert_allclose(problem.factor.T @ problem.factor, whole.Q, atol=1e-12 * scale)
        if clock == "constant":
            np.testing.assert_allclose(
                problem.nuisance_at(np.eye(3)), whole.nuisance_at(np.eye(3)), rtol=1e-6, atol=1e-6
            )


def test_a_start_velocity_takes_up_any_shift_of_the_local_velocity(rows):
    """What lets the window begin at any time: Δv counts from wherever it started."""
    window = feed(SlidingWindow(9.0, nuisances=3), rows, 0, 10)
    shifted, shift = SlidingWindow(9.0, nuisances=3), np.array([30.0, -5.0, 7.0])
    for k in range(10):
        r = rows.take(rows.epoch == k)
        moved = type(r)(r.e_e, r.vel_w + shift, r.z, r.sigma, r.epoch, r.time)
        shifted.push(moved, r.e_e)
    scale = np.trace(window.problem().Q)
    np.testing.assert_allclose(shifted.problem().Q, window.problem().Q, atol=1e-9 * scale)


def test_price_per_epoch_does_not_grow_and_neither_does_the_error():
    """Ten thousand epochs through a window of twenty: sums as at the start."""
    rows = simulate_window(np.random.default_rng(2), 4, "3d", epochs=50, sigma=0.1).rows
    window = SlidingWindow(19.0)
    epochs = [rows.take(rows.epoch == k) for k in range(50)]
    held = 0
    for n in range(3000):
        e = epochs[n % 50]
        window.push(type(e)(e.e_e, e.vel_w, e.z, e.sigma, e.epoch, np.full(len(e), float(n))))
        held = max(held, len(window))
    assert held == 20
    last = rows.take(np.isin(rows.epoch, np.arange(2980, 3000) % 50))
    whole = build_problem(last)
    np.testing.assert_allclose(window.problem().Q, whole.Q, atol=1e-12 * np.trace(whole.Q))


def test_empty_epochs_and_gaps(rows):
    window = feed(SlidingWindow(9.0), rows, 0, 5)
    window.push(rows.take(slice(0, 0)))
    assert len(window) == 5
    late = rows.take(rows.epoch == 30)
    window.push(late)
    assert len(window) == 1


def test_refusals(rows):
    with pytest.raises(ConfigError, match="random-walk"):
        SlidingWindow(10.0, ClockModel("random-walk", 0.1))
    with pytest.raises(ConfigError, match="duration > 0"):
        SlidingWindow(0.0)
    with pytest.raises(AlignmentError, match="empty"):
        SlidingWindow(10.0).problem()
    window = feed(SlidingWindow(10.0), rows, 0, 3)
    with pytest.raises(DataError, match="not later"):
        feed(window, rows, 1, 2)
    with pytest.raises(DataError, match="nuisance: expected shape"):
        window.push(rows.take(rows.epoch == 5), np.ones((4, 2)))
    one = simulate_window(np.random.default_rng(3), 1, "2d", epochs=5).rows
    with pytest.raises(AlignmentError, match="says nothing"):
        feed(SlidingWindow(10.0, ClockModel("per-epoch")), one, 0, 5).problem()
