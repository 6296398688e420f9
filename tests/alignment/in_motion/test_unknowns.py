"""What is known of the sensors beforehand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.alignment.in_motion.unknowns import InertialOptions
from certnav.filters.errors import ConfigError
from certnav.filters.sensors import imu_preset


def test_spreads_come_from_the_sensor_or_from_the_standstill():
    spec = imu_preset("adis16470")
    plain = InertialOptions(imu=spec).error_sigma
    assert plain.shape == (12,)
    np.testing.assert_allclose(
        plain[0::3],
        [
            np.hypot(spec.gyro_bias_initial_sigma, spec.gyro_bias_sigma),
            np.hypot(spec.accel_bias_initial_sigma, spec.accel_bias_sigma),
            1e-6 * spec.gyro_scale_ppm, 1e-6 * spec.accel_scale_ppm,
        ],
    )  # fmt: skip
    known = InertialOptions(imu=spec, gyro_bias_sigma=1e-5).error_sigma
    np.testing.assert_array_equal(known[:3], 1e-5)
    np.testing.assert_array_equal(known[3:], plain[3:])
    perfect = dataclasses.replace(
        spec, gyro_scale_ppm=0.0, accel_scale_ppm=0.0, gyro_bias_turn_on_degph=0.0,
        gyro_bias_instability_degph=0.0, accel_bias_turn_on_mg=0.0, accel_bias_instability_mg=0.0,
    )  # fmt: skip
    assert np.all(InertialOptions(imu=perfect).error_sigma > 0.0)


@pytest.mark.parametrize(
    ("name", "wrong", "right"),
    [
        ("segments", 0, 1), ("rounds", 0, 1), ("interval", -0.1, 0.0), ("cutoff", 0.0, 0.1),
        ("minority", 0.5, 0.49), ("minority", -0.01, 0.0), ("gyro_bias_sigma", 0.0, 1e-9),
        ("gyro_bias_sigma", np.inf, 1e9),
    ],
)  # fmt: skip
def test_options_out_of_range_are_named(name, wrong, right):
    with pytest.raises(ConfigError, match=name):
        InertialOptions(**{name: wrong})
    assert getattr(InertialOptions(**{name: right}), name) == right
