"""Datasheet units in SI, against their definitions; the in-run bias stays at what it is said to."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter

from certnav.filters.errors import ConfigError
from certnav.filters.sensors import PRESETS, ImuSpec, imu_preset


def spec(**values):
    nothing = dict.fromkeys((f.name for f in dataclasses.fields(ImuSpec)), 0.0)
    return ImuSpec(
        **{**nothing, "name": "x", "source": "test", "bias_correlation_time_s": 100.0, **values}
    )


def test_random_walks_are_densities():
    """1 deg/√h has wandered by a degree after an hour, 1σ, and 1 m/s/√h by a metre per second."""
    sensor = spec(gyro_arw_deg_sqrth=1.0, accel_vrw_mps_sqrth=1.0)
    hour = np.sqrt(3600.0)
    assert np.degrees(sensor.gyro_noise_density * hour) == pytest.approx(1.0)
    assert sensor.accel_noise_density * hour == pytest.approx(1.0)


def test_biases_are_rates_and_accelerations():
    """15.041 deg/h is the Earth's rate, 1 mg a thousandth of standard gravity."""
    sensor = spec(
        gyro_bias_instability_degph=15.041067, gyro_bias_turn_on_degph=2 * 15.041067,
        accel_bias_instability_mg=1000.0, accel_bias_turn_on_mg=2000.0,
    )  # fmt: skip
    assert sensor.gyro_bias_sigma == pytest.approx(7.2921151e-5, rel=1e-6)
    assert sensor.gyro_bias_initial_sigma == pytest.approx(2 * 7.2921151e-5, rel=1e-6)
    assert sensor.accel_bias_sigma == pytest.approx(9.80665)
    assert sensor.accel_bias_initial_sigma == pytest.approx(2 * 9.80665)


def test_the_driving_noise_keeps_a_bias_at_its_sigma():
    """A Gauss–Markov process simulated with it, for many correlation times."""
    sensor, sigma, dt = spec(bias_correlation_time_s=50.0), 0.3, 1.0
    rng = np.random.default_rng(0)
    driven = sensor.bias_walk_density(sigma) * np.sqrt(dt) * rng.standard_normal(1_000_000)
    bias = lfilter([1.0], [1.0, -np.exp(-dt / 50.0)], driven)[1000:]
    assert np.std(bias) == pytest.approx(sigma, rel=0.04)


def test_without_a_correlation_time_it_is_reached_after_an_hour():
    walk = spec(bias_correlation_time_s=np.inf).bias_walk_density(0.3)
    assert walk * np.sqrt(3600.0) == pytest.approx(0.3)


def test_presets_are_what_their_sources_say():
    adis = imu_preset("adis16470")
    assert "8 deg/h" in adis.source and adis.gyro_bias_instability_degph == 8.0
    assert "0.34 deg/√h" in adis.source and adis.gyro_arw_deg_sqrth == 0.34
    assert "0.037 m/s/√h" in adis.source and adis.accel_vrw_mps_sqrth == 0.037
    assert "500 deg/h" in adis.source and adis.gyro_bias_turn_on_degph == 500.0
    assert "10 mg" in adis.source and adis.accel_bias_turn_on_mg == 10.0
    assert "0.1 mg" in adis.source and adis.accel_bias_instability_mg == 0.1
    tactical = imu_preset("tactical")
    assert "0.5 deg/h" in tactical.source and tactical.gyro_bias_instability_degph == 0.5
    assert "0.01 deg/√h" in tactical.source and tactical.gyro_arw_deg_sqrth == 0.01
    assert "100 mGal" in tactical.source and tactical.accel_bias_instability_mg == 0.1
    assert "0.01 m/s/√h assumed" in tactical.source and tactical.accel_vrw_mps_sqrth == 0.01


def test_grades_are_in_order_and_scale_factors_are_percents_of_a_percent():
    grades = [imu_preset(name) for name in ("tactical", "adis16470", "consumer")]
    for field in dataclasses.fields(ImuSpec):
        values = [getattr(g, field.name) for g in grades]
        if not isinstance(values[0], str) and field.name != "bias_correlation_time_s":
            assert values == sorted(values), field.name
    assert [g.gyro_scale_ppm for g in grades] == [100.0, 3000.0, 10000.0]
    assert [g.accel_scale_ppm for g in grades] == [100.0, 3000.0, 10000.0]
    assert [g.bias_correlation_time_s for g in grades] == [3600.0, 3600.0, 1000.0]
    assert [g.gyro_bias_turn_on_degph for g in grades] == [1.0, 500.0, 1500.0]
    assert [g.gyro_bias_instability_degph for g in grades] == [0.5, 8.0, 40.0]
    assert [g.accel_bias_instability_mg for g in grades] == [0.1, 0.1, 1.0]
    assert [g.gyro_arw_deg_sqrth for g in grades] == [0.01, 0.34, 0.6]
    assert [g.accel_vrw_mps_sqrth for g in grades] == [0.01, 0.037, 0.2]
    assert [g.accel_bias_turn_on_mg for g in grades] == [0.2, 10.0, 30.0]
    assert all(PRESETS[name].name == name for name in PRESETS)


@pytest.mark.parametrize("value", [-1e-9, np.nan])
def test_impossible_sensors_are_refused(value):
    with pytest.raises(ConfigError, match=r"ImuSpec\.accel_scale_ppm: expected a number ≥ 0"):
        spec(accel_scale_ppm=value)
    with pytest.raises(ConfigError, match="expected > 0"):
        spec(bias_correlation_time_s=0.0)
    assert spec().gyro_scale_ppm == 0.0
    with pytest.raises(ConfigError, match="did you mean 'tactical'"):
        imu_preset("tacticl")
