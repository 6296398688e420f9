"""The vectorised pairs against a double loop, and what is counted of them in several ways."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.velocity.ddia import ddia_pair, ddia_velocity
from certnav.velocity.range_rate import DopplerRows
from certnav.velocity.screening import Screening, reason_counts, screen, usable_pairs
from certnav.velocity.study.pairs import (
    all_pairs,
    epoch_speeds,
    pair_indices,
    projected,
    velocity_errors,
)
from certnav.velocity.study.statistics import binned_rms, heat_map, rejection
from certnav.velocity.vehicle_motion import ForwardMotion


def unit(rng, n):
    e = rng.standard_normal((n, 3))
    return e / np.linalg.norm(e, axis=1)[:, None]


def drive(rng, counts, noise=0.05):
    """Rows of epochs with the given satellite counts, motion and true velocities."""
    counts = np.asarray(counts)
    epoch = np.repeat(np.arange(counts.size), counts)
    n = epoch.size
    motion = ForwardMotion(
        unit(rng, counts.size), 0.3 * rng.standard_normal((counts.size, 3)), np.zeros((3, 3))
    )
    speed = rng.uniform(-5, 25, counts.size)
    vel_e = speed[:, None] * motion.u_e + motion.swing_e
    e_e, sigma = unit(rng, n), rng.uniform(0.03, 0.3, n)
    z = np.sum(e_e * vel_e[epoch], axis=1) - rng.uniform(-300, 300, counts.size)[epoch]
    rows = DopplerRows(
        np.arange(n), np.full(n, "G01"), e_e, z + noise * sigma * rng.standard_normal(n), sigma
    )
    return rows, epoch, motion, vel_e, speed, rng.uniform(25, 52, n), rng.uniform(0, 1.5, n)


def test_indices_are_all_pairs_of_each_epoch_in_order():
    counts = [3, 0, 1, 2, 4, 3]
    epoch, a, b = pair_indices(counts)
    first = np.concatenate([[0], np.cumsum(counts)[:-1]])
    expected = [
        (e, first[e] + i, first[e] + j)
        for e, n in enumerate(counts)
        for i in range(n)
        for j in range(i + 1, n)
    ]
    assert list(zip(epoch, a, b, strict=True)) == expected


def test_columns_equal_the_single_pair_solution():
    rng = np.random.default_rng(1)
    rows, epoch, motion, _, _, cn0, elevation = drive(rng, [2, 5, 1, 3])
    pairs = all_pairs(rows, epoch, motion, cn0, elevation)
    assert len(pairs) == 1 + 10 + 3
    for m in range(len(pairs)):
        ij = np.array([pairs.a[m], pairs.b[m]])
        one = ddia_pair(rows.take(ij), motion.take(int(pairs.epoch[m])), 0.0, min_k=0.0)
        sdv = rows.e_e[ij[0]] - rows.e_e[ij[1]]
        assert pairs.speed[m] == pytest.approx(one.speed, abs=1e-9)
        assert pairs.sigma[m] == pytest.approx(one.sigma_doppler, rel=1e-12)
        assert pairs.k[m] == pytest.approx(one.k, rel=1e-12)
        assert pairs.cosine[m] == pytest.approx(one.k / np.linalg.norm(sdv), rel=1e-9)
        assert pairs.cn0_mean[m] == pytest.approx(cn0[ij].mean())
        assert pairs.cn0_min[m] == cn0[ij].min()
        assert pairs.elevation_min[m] == elevation[ij].min()


def test_epoch_speeds_equal_the_single_epoch_solution():
    rng = np.random.default_rng(2)
    rows, epoch, motion, *_ = drive(rng, [2, 6, 1, 4])
    h, y = projected(rows, epoch, motion)
    found = epoch_speeds(h, y, rows.sigma, epoch, 4)
    assert np.isnan(found.speed[2])
    assert found.k[2] == 0.0
    for number in (0, 1, 3):
        one = ddia_velocity(
            rows.take(epoch == number), motion.take(number), 0.0, min_k=0.0, significance=1e-300
        )
        assert found.speed[number] == pytest.approx(one.speed, abs=1e-9)
        assert found.clock_drift[number] == pytest.approx(one.clock_drift, abs=1e-9)
        assert found.k[number] == pytest.approx(one.k, rel=1e-9)
        scale = np.sqrt(one.variance_factor)
        assert found.sigma[number] * scale == pytest.approx(one.sigma_doppler, rel=1e-9)


def test_exact_rows_have_no_error_and_residuals_find_the_odd_one():
    rng = np.random.default_rng(3)
    rows, epoch, motion, vel_e, speed, cn0, elevation = drive(rng, [2, 6], noise=0.0)
    pairs = all_pairs(rows, epoch, motion, cn0, elevation)
    usable = pairs.k > 0.05
    np.testing.assert_allclose(pairs.speed[usable], speed[pairs.epoch[usable]], atol=1e-9)
    assert velocity_errors(pairs.speed, pairs.epoch, motion, vel_e)[usable].max() < 1e-9
    assert np.isnan(pairs.residual[pairs.epoch == 0]).all()
    assert np.abs(pairs.residual[pairs.epoch == 1]).max() < 1e-8


def test_error_is_the_length_of_the_velocity_difference():
    rng = np.random.default_rng(4)
    rows, epoch, motion, _, _, cn0, elevation = drive(rng, [4, 4])
    pairs = all_pairs(rows, epoch, motion, cn0, elevation)
    truth = rng.standard_normal((2, 3)) * 10.0
    found = pairs.speed[:, None] * motion.u_e[pairs.epoch] + motion.swing_e[pairs.epoch]
    expected = np.linalg.norm(found - truth[pairs.epoch], axis=1)
    np.testing.assert_allclose(
        velocity_errors(pairs.speed, pairs.epoch, motion, truth), expected, rtol=1e-10
    )


def test_marks_reasons_bins_and_grid_count_the_same_pairs():
    rng = np.random.default_rng(5)
    rows, epoch, motion, vel_e, _, cn0, elevation = drive(rng, np.full(300, 12))
    pairs = all_pairs(rows, epoch, motion, cn0, elevation)
    marks = screen(pairs, Screening())
    counts, left = reason_counts(marks), usable_pairs(pairs, marks)
    error = velocity_errors(pairs.speed, pairs.epoch, motion, vel_e)
    rule, bins = rejection(pairs.k, error), binned_rms(pairs.k, error)
    grid = heat_map(pairs.cn0_mean, pairs.k, error, np.arange(30, 51.0), np.arange(0.05, 1, 0.05))
    assert len(pairs) == 300 * 66
    assert left.sum() == (marks == 0).sum() == grid.count[10, 3]
    assert bins.count.sum() == rule.offered
    assert counts["weak signal"] > 0
