"""Doppler least squares: recovery, honesty of the covariance, faults, geometry."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.velocity.least_squares import REJECTED, doppler_velocity, mark_rejected, solve
from certnav.velocity.range_rate import DopplerRows

VEL_E, DRIFT = np.array([-4.0, 12.5, 3.0]), -87.0


def sky(rng, n, lowest=10.0):
    """Return n lines of sight spread evenly over the sky, down positive as in NED."""
    down = -rng.uniform(np.sin(np.radians(lowest)), 1.0, n)
    azimuth, flat = rng.uniform(0.0, 2.0 * np.pi, n), np.sqrt(1.0 - down**2)
    return np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), down])


def epoch(rng, n, noise=0.05, sigma=0.05, e_e=None):
    e_e = sky(rng, n) if e_e is None else e_e
    z = e_e @ VEL_E - DRIFT + noise * rng.standard_normal(n)
    names = np.array([f"G{k + 1:02d}" for k in range(n)])
    return DopplerRows(np.arange(n) + 100, names, e_e, z, np.full(n, sigma))


def with_faults(rows, faults):
    z = rows.z.copy()
    for k, size in faults.items():
        z[k] += size
    return DopplerRows(rows.row, rows.sat, rows.e_e, z, rows.sigma)


@pytest.mark.parametrize("n", [4, 5, 12])
def test_noise_free_recovery(n):
    rng = np.random.default_rng(n)
    found = doppler_velocity(epoch(rng, n, noise=0.0), 5.0, max_dop=1e3)
    assert found.ok and found.time == 5.0 and found.dof == n - 4 and len(found.satellites) == n
    np.testing.assert_allclose(found.vel_e, VEL_E, atol=1e-9)
    assert found.clock_drift == pytest.approx(DRIFT, abs=1e-9)
    assert found.variance_factor == 1.0


def test_covariance_and_chi_square_are_honest():
    rng = np.random.default_rng(1)
    nees, chi2 = [], []
    for _ in range(1500):
        found = doppler_velocity(epoch(rng, 10), 0.0, significance=1e-9)
        error = found.vel_e - VEL_E
        prior = found.cov_e / found.variance_factor
        nees.append(error @ np.linalg.solve(prior, error))
        chi2.append(found.chi2)
    # chi-square means: 3 and 6, standard error √(2·dof/1500)
    assert np.mean(nees) == pytest.approx(3.0, abs=4.0 * np.sqrt(6.0 / 1500))
    assert np.mean(chi2) == pytest.approx(6.0, abs=4.0 * np.sqrt(12.0 / 1500))


def test_weights_are_those_of_sigma():
    """Two groups of very different noise: the covariance must still be that of the errors."""
    rng = np.random.default_rng(2)
    sigma = np.where(np.arange(12) < 6, 0.02, 0.5)
    nees = []
    for _ in range(1500):
        e_e = sky(rng, 12)
        z = e_e @ VEL_E - DRIFT + sigma * rng.standard_normal(12)
        found = solve(e_e, z, sigma, 1e3)
        error = found.state - np.r_[VEL_E, DRIFT]
        nees.append(error @ np.linalg.solve(found.cov, error))
    assert np.mean(nees) == pytest.approx(4.0, abs=4.0 * np.sqrt(8.0 / 1500))


def test_residuals_inflate_a_covariance_that_is_too_small():
    rng = np.random.default_rng(3)
    scaled, bare = [], []
    for _ in range(600):
        found = doppler_velocity(epoch(rng, 16, noise=0.10), 0.0, significance=1e-30)
        error = found.vel_e - VEL_E
        scaled.append(error @ np.linalg.solve(found.cov_e, error))
        bare.append(scaled[-1] * found.variance_factor)
    assert np.mean(bare) > 10.0
    assert np.mean(scaled) < 4.5


def test_false_alarms_come_at_the_stated_rate():
    rng = np.random.default_rng(4)
    alarms = [
        bool(doppler_velocity(epoch(rng, 8), 0.0, significance=0.05).rejected) for _ in range(1000)
    ]
    assert np.mean(alarms) == pytest.approx(0.05, abs=4.0 * np.sqrt(0.05 * 0.95 / 1000))


@pytest.mark.parametrize(("n", "count"), [(7, 1), (9, 2), (12, 3), (20, 6)])
def test_faulty_rows_are_named_and_harmless(n, count):
    rng = np.random.default_rng(10 * n + count)
    trials, named = 100, 0
    for _ in range(trials):
        rows = epoch(rng, n)
        bad = rng.choice(n, count, replace=False)
        sizes = rng.uniform(1.5, 8.0, count) * rng.choice([-1.0, 1.0], count)
        faulty = with_faults(rows, dict(zip(bad, sizes, strict=True)))
        found = doppler_velocity(faulty, 0.0, max_dop=1e3)
        named += found.ok and set(found.rejected) == set(rows.row[bad])
    assert named >= 0.95 * trials


def test_result_with_exclusion_is_that_of_the_good_rows():
    rng = np.random.default_rng(6)
    rows = epoch(rng, 10)
    found = doppler_velocity(with_faults(rows, {3: 5.0}), 0.0)
    good = doppler_velocity(rows.take(np.arange(10) != 3), 0.0)
    np.testing.assert_array_equal(found.vel_e, good.vel_e)
    assert found.rejected == (103,) and "G04" not in found.satellites
    assert found.residuals.size == 9 and 103 not in found.row


def test_five_satellites_detect_but_cannot_identify():
    rng = np.random.default_rng(7)
    found = doppler_velocity(with_faults(epoch(rng, 5), {0: 30.0, 1: -30.0}), 0.0, max_dop=1e3)
    assert found.status == "inconsistent"
    assert np.isnan(found.vel_e).all() and np.isnan(found.cov_e).all()


def test_three_satellites_are_too_few():
    """And what there is no velocity of has the shapes of one: epochs are stacked."""
    found = doppler_velocity(epoch(np.random.default_rng(8), 3), 7.0)
    assert found.status == "too few satellites" and not found.ok and found.time == 7.0
    one = doppler_velocity(epoch(np.random.default_rng(8), 8), 7.0)
    for name in ("vel_e", "cov_e"):
        assert getattr(found, name).shape == getattr(one, name).shape
        assert np.isnan(getattr(found, name)).all()
    assert np.isnan([found.clock_drift, found.chi2, found.variance_factor]).all()
    assert found.satellites == found.rejected == () and found.dof == 0
    assert found.row.dtype == one.row.dtype and found.row.size == found.residuals.size == 0


def test_equal_elevations_are_degenerate():
    """On a cone about the vertical, vertical velocity and clock drift are one unknown."""
    azimuth = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    e_e = np.column_stack([0.6 * np.cos(azimuth), 0.6 * np.sin(azimuth), np.full(8, -0.8)])
    rows = epoch(np.random.default_rng(9), 8, e_e=e_e)
    assert doppler_velocity(rows, 0.0, max_dop=1e12).status == "degenerate geometry"


def test_a_street_of_satellites_exceeds_the_dop_limit():
    """Satellites within 2° of one vertical plane leave the cross-street velocity weak."""
    rng = np.random.default_rng(10)
    elevation = np.radians([20.0, 40.0, 60.0, 85.0, 120.0, 150.0])
    across = np.radians(2.0) * rng.uniform(-1.0, 1.0, 6)
    e_e = np.column_stack([np.cos(elevation), across, -np.sin(elevation)])
    e_e /= np.linalg.norm(e_e, axis=1, keepdims=True)
    rows = epoch(rng, 6, e_e=e_e)
    assert doppler_velocity(rows, 0.0, max_dop=20.0).status == "degenerate geometry"
    assert doppler_velocity(rows, 0.0, max_dop=1e4).ok


def test_rejected_rows_are_marked_with_the_reason():
    class Observations:
        def __init__(self):
            self.marked = None

        def __len__(self):
            return 112

        def mark(self, mask, reason):
            self.marked = (np.flatnonzero(mask).tolist(), reason)
            return self

    rows = epoch(np.random.default_rng(11), 10)
    found = doppler_velocity(with_faults(rows, {4: 9.0}), 0.0)
    assert mark_rejected(Observations(), [found]).marked == ([104], REJECTED)
