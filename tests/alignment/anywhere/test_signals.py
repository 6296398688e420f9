"""Derivatives of rows against differences, bounds of derivatives against samples."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.alignment.anywhere.ball import FOURTH, THIRD
from certnav.alignment.anywhere.signals import Signals
from certnav.alignment.reference.earth_windows import earth_window
from certnav.filters.errors import DataError


@pytest.fixture(scope="module")
def window():
    return earth_window(np.random.default_rng(5), 7, 12.0, noise=False)


def test_derivatives_are_those_of_the_rows(window):
    """Slope, curvature, turn of the lines of sight and time; some v/c of each are left out."""
    signals, pos_e, h = window.signals, window.pos_e, 500.0
    sight = signals.at(pos_e)
    steps = h * np.eye(3)
    ends = [(signals.at(pos_e + d), signals.at(pos_e - d)) for d in steps]
    slope = np.stack([(a.z - b.z) / (2.0 * h) for a, b in ends], axis=1)
    np.testing.assert_allclose(sight.by_pos, slope, atol=1e-4 * np.abs(slope).max())
    curve = np.stack([(a.by_pos - b.by_pos) / (2.0 * h) for a, b in ends], axis=2)
    np.testing.assert_allclose(sight.curvature(), curve, atol=1e-4 * np.abs(curve).max())
    vector = np.random.default_rng(1).normal(size=(len(signals), 3))
    turn = np.stack([np.sum((a.e - b.e) * vector, axis=1) / (2.0 * h) for a, b in ends], axis=1)
    np.testing.assert_allclose(sight.across(vector), turn, atol=1e-4 * np.abs(turn).max())
    later = (signals.later(0.5).at(pos_e).z - signals.later(-0.5).at(pos_e).z) / 1.0
    np.testing.assert_allclose(sight.by_time, later, atol=1e-4 * np.abs(later).max())


def test_satellites_of_another_time_are_where_they_then_are(window):
    """A minute on, and there and back again over ten."""
    signals = window.signals
    last = signals.time == signals.time[-1]
    first = signals.time == signals.time[0]
    moved = signals.take(first).later(float(np.ptp(signals.time)))
    np.testing.assert_allclose(moved.sat_pos_e, signals.sat_pos_e[last], atol=1e-3)
    np.testing.assert_allclose(moved.sat_vel_e, signals.sat_vel_e[last], atol=1e-6)
    back = signals.later(600.0).later(-600.0)
    np.testing.assert_allclose(back.sat_pos_e, signals.sat_pos_e, atol=1e-2)


def test_derivatives_of_a_length_are_no_larger_than_the_bounds():
    """Third and fourth order along 10,000 directions; the bounds are reached."""
    c = np.linspace(-1.0, 1.0, 10_001)
    third, fourth = np.abs(3.0 * c * (1.0 - c**2)), np.abs(3.0 * (1.0 - c**2) * (5.0 * c**2 - 1.0))
    # √(1 + 2cε + ε²) along c, by differences of fourth order.
    eps = 1e-2 * np.arange(-2, 3)[:, None]
    f = np.sqrt(1.0 + 2.0 * c * eps + eps**2)
    found = (f[4] - 2.0 * f[3] + 2.0 * f[1] - f[0]) / (2.0 * 1e-6)
    np.testing.assert_allclose(np.abs(found), third, atol=3e-3)
    found = (f[4] - 4.0 * f[3] + 6.0 * f[2] - 4.0 * f[1] + f[0]) / 1e-8
    np.testing.assert_allclose(np.abs(found), fourth, atol=3e-2)
    assert third.max() == pytest.approx(THIRD, rel=1e-6)
    assert fourth.max() == pytest.approx(FOURTH, rel=1e-6)


@pytest.mark.parametrize(
    ("field", "value", "match"),
    [
        ("time", np.array([1.0, 0.0]), "ascending"),
        ("sigma", np.array([0.1, 0.0]), "positive"),
        ("sat_pos_e", np.zeros((2, 3)), "orbit"),
        ("range_rate", np.array([1.0, np.nan]), "not finite at index 1"),
        ("sat_vel_e", np.zeros((2, 2)), "shape"),
    ],
)
def test_signals_say_what_is_wrong_with_them(window, field, value, match):
    sound = {name: getattr(window.signals, name)[:2] for name in Signals.__dataclass_fields__}
    Signals(**sound)
    with pytest.raises(DataError, match=match):
        Signals(**{**sound, field: value})
