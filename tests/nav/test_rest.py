"""The longest rest of a log is found, by turning, shaking and gaps."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets.series import ImuData
from certnav.filters.errors import DataError
from certnav.filters.sensors import STANDARD_GRAVITY, imu_preset
from certnav.nav.rest import longest_rest

RATE = 50.0


def at_rest(seconds, begin=0.0):
    rng, n = np.random.default_rng(3), int(seconds * RATE)
    gyro = [0.001, -0.02, 0.003] + 1e-3 * rng.standard_normal((n, 3))
    accel = [0.0, 0.0, -STANDARD_GRAVITY] + 0.02 * rng.standard_normal((n, 3))
    return ImuData(begin + np.arange(1, n + 1) / RATE, gyro, accel)


def joined(*parts):
    return ImuData(
        np.concatenate([p.time for p in parts]),
        np.concatenate([p.gyro_b for p in parts]),
        np.concatenate([p.accel_b for p in parts]),
    )


def moving(seconds, begin):
    still = at_rest(seconds, begin=begin)
    turned = still.gyro_b + 0.3 * np.sin(still.time)[:, None]
    return ImuData(still.time, turned, still.accel_b)


def test_the_longest_rest_is_taken():
    drive = joined(at_rest(70.0), moving(60.0, 70.0), at_rest(100.0, begin=130.0))
    rest = longest_rest(drive, imu_preset("consumer"))
    assert rest.time[0] >= 129.9
    assert rest.time[-1] - rest.time[0] == pytest.approx(100.0, abs=2.1)
    with pytest.raises(DataError, match=r"longest rest lasts 40 s.*expected 60"):
        longest_rest(joined(at_rest(40.0), moving(60.0, 40.0)), imu_preset("consumer"))


def test_a_gap_ends_a_rest():
    halves = joined(at_rest(50.0), at_rest(50.0, begin=60.0))
    with pytest.raises(DataError, match="longest rest lasts 50 s"):
        longest_rest(halves, imu_preset("consumer"))


def test_a_steady_turn_is_no_rest():
    still = at_rest(100.0)
    turned = still.gyro_b + np.where(still.time > 45.0, 0.02, 0.0)[:, None]
    with pytest.raises(DataError, match="expected 60"):
        longest_rest(ImuData(still.time, turned, still.accel_b), imu_preset("consumer"))
