"""Intervals cover as often as they say, and two methods that are one differ by nothing."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.nav.compare.intervals import FEWEST, change, rms_interval


def _stretches(values):
    return {k: [v] for k, v in enumerate(values)}


@pytest.mark.parametrize("count", [8, 20])
def test_the_interval_covers_the_rms_of_all_spells_there_could_be(count):
    """Drift in two axes, normal: its RMS is √2 σ. 95 % are asked for."""
    rng = np.random.default_rng(11)
    inside = 0
    for _ in range(200):
        low, high = rms_interval(_stretches(rng.rayleigh(1.0, count)))
        inside += low <= np.sqrt(2.0) <= high
    assert 0.87 * 200 <= inside < 200


def test_a_change_is_covered_although_spells_differ_by_much_more():
    rng = np.random.default_rng(12)
    true = 0.7 * np.exp(0.2**2)  # of RMS, with 20 % that is each spell's own
    inside, width = 0, []
    for _ in range(200):
        before = rng.lognormal(0.0, 0.5, 15)
        after = 0.7 * before * rng.lognormal(0.0, 0.2, 15)
        found, (low, high) = change(_stretches(before), _stretches(after))
        inside += low <= true - 1.0 <= high
        assert low <= found <= high
        width.append(high - low)
    assert 0.85 * 200 <= inside < 200
    assert np.median(width) < 0.3  # paired; unpaired, spells alone differ by a factor of two


def test_a_method_compared_with_itself_differs_by_nothing():
    drift = _stretches(np.random.default_rng(1).rayleigh(1.0, 9))
    assert change(drift, drift) == (0.0, (0.0, 0.0))


def test_draws_in_the_same_stretch_are_no_further_stretches():
    """Ten draws each that say the same leave the interval as wide as one draw does."""
    values = np.random.default_rng(2).rayleigh(1.0, 7)
    once = rms_interval(_stretches(values))
    often = rms_interval({k: [v] * 10 for k, v in enumerate(values)})
    assert often == pytest.approx(once)


def test_few_stretches_have_no_interval():
    few = _stretches(np.arange(1.0, FEWEST))
    assert rms_interval(few) is None
    assert change(few, few) == (0.0, None)
    assert rms_interval(_stretches([])) is None and change(few, {}) is None


def test_spells_that_only_one_of_them_has_are_not_compared():
    one = _stretches(np.full(6, 2.0))
    two = _stretches([1.0] * 6 + [100.0])
    assert change(one, two)[0] == pytest.approx(-0.5)
