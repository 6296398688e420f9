"""Statistics against brute force, scipy, and cases with known answers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import pearsonr, spearmanr

from certnav.velocity.study.statistics import (
    binned_rms,
    heat_map,
    pearson,
    rejection,
    rms,
    spearman,
)


def test_heat_map_is_the_brute_force_count():
    rng = np.random.default_rng(1)
    cn0 = np.round(rng.uniform(25, 55, 3000))  # values on the thresholds themselves
    cn0[:50] = np.nan
    k, error = np.round(rng.uniform(0, 1.2, 3000), 2), rng.exponential(1.0, 3000)
    snr_grid, k_grid = np.arange(30.0, 51.0), np.round(np.arange(0.05, 1.01, 0.05), 10)
    grid = heat_map(cn0, k, error, snr_grid, k_grid)
    for i, snr in enumerate(snr_grid):
        for j, limit in enumerate(k_grid):
            kept = (cn0 > snr) & (k > limit)
            assert grid.count[i, j] == kept.sum()
            assert grid.kept[i, j] == kept.sum() / 3000
            if kept.any():
                assert grid.rms[i, j] == pytest.approx(rms(error[kept]))
    half = heat_map(cn0[:1500], k[:1500], error[:1500], snr_grid, k_grid)
    rest = heat_map(cn0[1500:], k[1500:], error[1500:], snr_grid, k_grid)
    both = half + rest
    assert (both.count == grid.count).all()
    np.testing.assert_allclose((grid - half).rms, rest.rms, rtol=1e-6)


def test_bins_open_at_multiples_of_the_width():
    found = binned_rms([0.0, 0.05, 0.15, 0.1499999, 0.3, 5.0], [3.0, 1.0, 2.0, 4.0, 1.0, 9.0])
    assert list(found.count[:7]) == [1, 1, 1, 1, 0, 0, 1]
    assert found.rms[3] == 2.0
    assert np.isnan(found.rms[4])
    assert found.count.sum() == 5


def test_outlier_rule_is_one_pass_after_the_singularity_rule():
    error = np.array([1.0] * 99 + [20.0, 500.0])
    k = np.array([0.5] * 100 + [0.05])
    found = rejection(k, error)
    assert (found.offered, found.kept_k, found.kept) == (101, 100, 99)
    assert found.rms == pytest.approx(np.sqrt((99 + 400) / 100))
    assert found.limit == 3 * found.rms
    assert found.rms_kept == 1.0
    assert found.discarded_share == pytest.approx(1 / 101)


def test_correlations_equal_scipy_with_and_without_ties():
    rng = np.random.default_rng(2)
    x = rng.standard_normal(500)
    y = x**3 + rng.standard_normal(500)
    for a in (x, np.round(x)):
        assert pearson(a, y) == pytest.approx(pearsonr(a, y)[0])
        assert spearman(a, y) == pytest.approx(spearmanr(a, y)[0])
    n = 500
    d = np.argsort(np.argsort(x)) - np.argsort(np.argsort(y))
    assert spearman(x, y) == pytest.approx(1 - 6 * np.sum(d**2) / (n * (n**2 - 1)))  # (24)


def test_correlation_with_nothing_is_not_a_number():
    assert np.isnan(pearson(np.ones(5), np.arange(5.0)))
    assert np.isnan(spearman([np.nan, 1.0], [1.0, 2.0]))
    assert spearman([1.0, 2.0, np.nan, 3.0], [1.0, 4.0, 0.0, 9.0]) == pytest.approx(1.0)
