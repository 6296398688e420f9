"""A car that stands is seen to stand; one that moves, turns or sets off is not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.filters import standstill
from certnav.filters.sensors import imu_preset
from certnav.filters.standstill import is_quiet, own_spread
from certnav.filters.strapdown import InertialStream

RATE = 100.0
SPEC = imu_preset("adis16470")
#: A sensor without noise of its own: what is left are the limits of a standing car.
SILENT = dataclasses.replace(SPEC, gyro_arw_deg_sqrth=0.0, accel_vrw_mps_sqrth=0.0)
GRAVITY = np.array([0.1, -0.2, -9.8])


def stream(seconds=5.0, gyro=0.0, accel=0.0, seed=0, spec=SPEC):
    """Samples of a standing car with white noise of the sensor and more on top."""
    rng = np.random.default_rng(seed)
    n = int(seconds * RATE)
    time = 100.0 + np.arange(1, n + 1) / RATE
    own = np.array([spec.gyro_noise_density, spec.accel_noise_density]) * np.sqrt(RATE)
    gyro_b, accel_b = (s * rng.standard_normal((n, 3)) for s in np.hypot(own, [gyro, accel]))
    return InertialStream(time, gyro_b, GRAVITY + accel_b)


def at_rest(s, time=105.0, bias=(0.0, 0.0, 0.0), sigma=(0.0, 0.0, 0.0), spec=SPEC):
    rest = standstill.at_rest(s, time, spec, bias, sigma)
    return None if rest is None else rest.rate_b


def test_own_spread_is_what_averages_to_the_datasheet():
    """A mean over a second has the density as its 1σ, whatever the rate."""
    rng = np.random.default_rng(1)
    gyro, accel = own_spread(SPEC, 1.0 / RATE)
    means = gyro * rng.standard_normal((4000, int(RATE))).mean(axis=1)
    assert np.std(means) == pytest.approx(SPEC.gyro_noise_density, rel=0.05)
    assert accel / gyro == pytest.approx(SPEC.accel_noise_density / SPEC.gyro_noise_density)
    assert own_spread(SPEC, 0.04)[0] == pytest.approx(0.5 * own_spread(SPEC, 0.01)[0])


def test_a_standing_car_is_at_rest_at_the_mean_rate_of_the_last_second():
    s = stream()
    np.testing.assert_allclose(at_rest(s), s.gyro[-100:].mean(axis=0), rtol=1e-12)
    # Of the second before the time asked for: what comes later is not known yet.
    np.testing.assert_allclose(at_rest(s, 103.5), s.gyro[250:350].mean(axis=0), rtol=1e-12)
    found = standstill.at_rest(s, 103.5, SPEC, np.zeros(3), np.zeros(3))
    np.testing.assert_allclose(found.force_b, s.accel[250:350].mean(axis=0), rtol=1e-12)


def waves(size):
    """A stretch of three axes with that spread, exactly."""
    wave = np.sqrt(2.0) * np.sin(2.0 * np.pi * np.arange(100) / 10.0)
    return np.asarray(size) * wave[:, None]


@pytest.mark.parametrize("axis", range(3))
def test_an_idling_engine_is_quiet_and_a_rolling_car_is_not(axis):
    """0.3 °/s and 0.15 m/s² of spread on any axis tell them apart."""
    small, large = np.radians([0.25, 0.35])
    one = np.eye(3)[axis]

    def quiet(gyro, accel):
        return is_quiet(waves(gyro * one), GRAVITY + waves(accel * one), SILENT, 0.01, 2.0)

    assert quiet(small, 0.13)
    assert not quiet(large, 0.13)
    assert not quiet(small, 0.17)
    assert is_quiet(waves(small * one), None, SILENT, 0.01, 2.0)
    assert not is_quiet(waves(large * one), None, SILENT, 0.01, 2.0)


def test_noise_of_the_sensor_itself_is_allowed_for():
    """Twice its own σ: a coarse sensor may spread more than the engine does."""
    coarse = dataclasses.replace(SPEC, gyro_arw_deg_sqrth=6.0, accel_vrw_mps_sqrth=3.0)
    gyro, accel = own_spread(coarse, 0.01)
    level = GRAVITY + waves([accel, accel, accel])
    assert is_quiet(waves(1.5 * np.array([gyro] * 3)), level, coarse, 0.01, 2.0)
    assert not is_quiet(waves(1.5 * np.array([gyro] * 3)), level, coarse, 0.01, 1.0)
    assert not is_quiet(waves([0.0] * 3), GRAVITY + waves([2.0 * accel] * 3), coarse, 0.01, 1.0)


def test_many_stretches_at_once_are_the_stretches_one_by_one():
    gyro = np.array([waves([s, 0.0, 0.0]) for s in np.radians([0.1, 0.5, 0.2])])
    accel = GRAVITY + np.array([waves([0.0, s, 0.0]) for s in (0.1, 0.1, 0.3)])
    assert is_quiet(gyro, accel, SILENT, 0.01, 2.0).tolist() == [True, False, False]


def turning(rate, **known):
    s = stream(spec=SILENT)
    return at_rest(InertialStream(s.edges[1:], s.gyro + rate, s.accel), spec=SILENT, **known)


def test_a_car_on_a_long_bend_is_quiet_and_does_not_stand():
    """0.3 °/s beyond what the bias may be, in either direction and about any axis."""
    for axis in np.eye(3):
        for sign in (1.0, -1.0):
            assert turning(sign * np.radians(0.25) * axis) is not None
            assert turning(sign * np.radians(0.35) * axis) is None


def test_a_bias_is_no_turn():
    bias = np.radians([0.0, 2.0, -1.0])
    assert turning(bias) is None
    np.testing.assert_allclose(turning(bias, bias=bias), bias, rtol=1e-12)
    # Three of its 1σ may be the bias that nobody knows yet.
    unknown = np.full(3, np.radians(0.7))
    assert turning(bias, sigma=unknown) is not None
    assert turning(1.3 * bias, sigma=unknown) is None
    assert turning(-bias, bias=bias) is None


@pytest.mark.parametrize(("change", "stands"), [(0.08, True), (0.15, False), (-0.15, False)])
def test_a_car_that_sets_off_is_quiet_until_now(change, stands):
    s = stream(spec=SILENT)
    accel = s.accel.copy()
    accel[-20:, 0] += change  # in the last fifth of the second
    found = at_rest(InertialStream(s.edges[1:], s.gyro, accel), spec=SILENT)
    assert (found is not None) == stands


def test_too_few_samples_say_nothing():
    """Ten samples, of the last second."""
    time = 100.0 + np.arange(1, 30) / 10.0
    zero, level = np.zeros((29, 3)), np.tile(GRAVITY, (29, 1))
    assert at_rest(InertialStream(time, zero, level), 102.9, spec=SILENT) is not None
    slow = InertialStream(100.0 + np.arange(1, 30) / 8.0, zero, level)
    assert at_rest(slow, 102.9, spec=SILENT) is None
    assert at_rest(stream(), 100.05) is None  # five samples after it began
