"""The smallest set of faults is found; what cannot be told is not guessed."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from certnav.filters.fault_exclusion import chi2_limit, consistent_rows


def equations(rng, n, p=3, noise=1.0):
    H = rng.standard_normal((n, p))
    sigma = rng.uniform(0.5, 2.0, n)
    return H, H @ rng.standard_normal(p) * 100.0 + noise * sigma * rng.standard_normal(n), sigma


def chi2_of(H, z, sigma, keep):
    h, y = H[keep] / sigma[keep, None], z[keep] / sigma[keep]
    return float(np.sum((y - h @ np.linalg.lstsq(h, y, rcond=None)[0]) ** 2))


def test_limit_is_the_quantile():
    assert chi2_limit(0.05, 1) == pytest.approx(1.959964**2, rel=1e-6)
    assert chi2_limit(0.05, 0) == np.inf


def test_consistent_rows_all_stay():
    rng = np.random.default_rng(0)
    assert consistent_rows(*equations(rng, 10), 1e-6).all()
    assert consistent_rows(*equations(rng, 3), 1e-6).all()


@pytest.mark.parametrize(("n", "count"), [(6, 1), (9, 2), (12, 3), (14, 4), (18, 5)])
def test_faults_are_found(n, count):
    rng = np.random.default_rng(n)
    right = 0
    for _ in range(50):
        H, z, sigma = equations(rng, n)
        bad = rng.choice(n, count, replace=False)
        z[bad] += rng.uniform(30.0, 200.0, count) * rng.choice([-1, 1], count)
        keep = consistent_rows(H, z, sigma, 1e-3)
        right += keep is not None and set(np.flatnonzero(~keep)) == set(bad)
    assert right >= 46


def test_choice_is_the_best_of_the_smallest_sets():
    """Brute force over every subset, chi-square by lstsq, agrees."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        H, z, sigma = equations(rng, 9)
        z[rng.choice(9, 2, replace=False)] += [15.0, -9.0]
        keep = consistent_rows(H, z, sigma, 1e-2)
        best = None
        for count in (0, 1, 2, 3):
            trials = []
            for out in itertools.combinations(range(9), count):
                mask = ~np.isin(np.arange(9), out)
                trials.append((chi2_of(H, z, sigma, mask), mask))
            chi2, mask = min(trials, key=lambda trial: trial[0])
            if chi2 <= chi2_limit(1e-2, 6 - count):
                best = mask
                break
        np.testing.assert_array_equal(keep, best)


def test_too_little_redundancy_is_not_guessed():
    rng = np.random.default_rng(4)
    H, z, sigma = equations(rng, 4)
    z[0] += 1e3
    assert consistent_rows(H, z, sigma, 1e-3) is None


def test_the_last_word_is_respected():
    rng = np.random.default_rng(5)
    H, z, sigma = equations(rng, 8)
    z[2] += 500.0
    assert not consistent_rows(H, z, sigma, 1e-3)[2]
    assert consistent_rows(H, z, sigma, 1e-3, lambda keep: bool(keep[2])) is None
