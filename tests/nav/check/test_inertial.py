"""The IMU by itself, on made-up data of which every fault is known exactly."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest

from certnav.datasets.series import ImuData
from certnav.filters.sensors import STANDARD_GRAVITY, imu_preset
from certnav.nav.check.inertial import (
    frozen,
    gravity,
    inertial_findings,
    noise,
    sampling,
    saturated,
)
from certnav.velocity.tracks import Track

RATE = 100.0


def imu(accel=(0.0, 0.0, -9.8), seconds: float = 60.0, sigma: float = 0.01, seed: int = 0):
    rng = np.random.default_rng(seed)
    n = int(seconds * RATE)
    return ImuData(
        np.arange(1, n + 1) / RATE,
        rng.normal(0.0, 1e-3, (n, 3)),
        np.asarray(accel) + rng.normal(0.0, sigma, (n, 3)),
    )


def windows(data: ImuData) -> list[slice]:
    return [slice(k, k + 100) for k in range(0, len(data), 100)]


def at_rest(data: ImuData) -> np.ndarray:
    return np.ones(len(windows(data)), dtype=bool)


def judge_gravity(data: ImuData):
    (found,) = gravity(data, windows(data), at_rest(data), None, imu_preset("tactical"))
    return found


@pytest.mark.parametrize(
    ("accel", "words"),
    [
        ((0, 0, -1.0), "in g"),
        ((0, 0, -1000.0), "in mg"),
        ((0, 0, -9.8 * STANDARD_GRAVITY), "multiplied by g"),
        ((0, 0, -0.098), "velocity increments"),
        ((0, 0, -980.0), "cm/s²"),
        ((0.1, 0, 0.3), "taken out"),
        ((0, 0, 9.8), r"up is \+z"),
        ((0, 9.8, 0), r"up is \+y"),
    ],
)
def test_wrong_gravity_is_fatal_and_named(accel, words):
    found = judge_gravity(imu(accel, sigma=0.001))
    assert found.severity == "fatal"
    assert re.search(words, found.found)
    assert found.remedy


def test_gravity_in_order_gives_size_and_tilt():
    tilt = np.radians(5.0)
    found = judge_gravity(imu((9.8 * np.sin(tilt), 0, -9.8 * np.cos(tilt))))
    assert found.severity == "note"
    assert found.numbers["specific_force_mps2"] == pytest.approx(9.8, abs=0.002)
    assert found.numbers["tilt_deg"] == pytest.approx(5.0, abs=0.02)


def test_bias_of_gravity_is_doubtful():
    found = judge_gravity(imu((0, 0, -10.1)))
    assert found.severity == "doubtful" and "mg" in found.found


def test_gaps_are_counted_and_timed():
    data = imu()
    keep = np.ones(len(data), dtype=bool)
    keep[1000:1500] = keep[3000] = False
    data = ImuData(data.time[keep], data.gyro_b[keep], data.accel_b[keep])
    (found,) = sampling(data)
    assert found.severity == "doubtful"
    assert found.numbers["gaps"] == 2
    assert found.numbers["longest_gap_s"] == pytest.approx(5.01)
    assert found.numbers["rate_hz"] == pytest.approx(RATE)


def test_stamps_in_milliseconds_taken_for_seconds_are_fatal():
    data = imu()
    (found,) = sampling(ImuData(1e3 * data.time, data.gyro_b, data.accel_b))
    assert found.severity == "fatal" and 'time_unit = "ms"' in found.remedy


def test_jitter_of_a_logger_is_doubtful():
    data = imu()
    time = data.time + np.random.default_rng(1).uniform(-0.4, 0.4, len(data)) / RATE
    (found,) = sampling(ImuData(time, data.gyro_b, data.accel_b))
    assert found.severity == "doubtful" and "rebuild" in found.remedy


def _with(data: ImuData, rows: slice, axes, value) -> ImuData:
    gyro = data.gyro_b.copy()
    gyro[rows, axes] = value
    return ImuData(data.time, gyro, data.accel_b)


@pytest.mark.parametrize(
    ("rows", "axes", "severity", "words"),
    [
        (slice(1000, 1100), slice(None), "doubtful", "frozen for 1.0 s"),
        (slice(1000, 4000), slice(None), "fatal", "frozen for 30.0 s"),
        (slice(1000, 4000), 1, "fatal", "frozen for 30.0 s"),
        (slice(None), 2, "fatal", "axis z never changes"),
    ],
)
def test_frozen_stretches(rows, axes, severity, words):
    (found,) = frozen(_with(imu(), rows, axes, 0.01), None)
    assert found.subject == "gyro" and found.severity == severity and words in found.found


def test_values_that_repeat_at_rest_are_those_of_a_simulation():
    data = _with(imu(), slice(1000, 4000), slice(None), 0.01)
    n = data.time[::50].size
    vel_n = np.column_stack([np.where(data.time[::50] < 45.0, 0.0, 10.0), np.zeros((n, 2))])
    assert frozen(data, Track("GNSS", data.time[::50], np.zeros((n, 3)), vel_n)) == []


def test_sound_data_are_neither_frozen_nor_saturated():
    assert frozen(imu(), None) == [] and saturated(imu()) == []


def test_repeated_rows_betray_a_slower_sensor():
    data = imu()
    hold = np.arange(len(data)) // 2 * 2
    (found,) = frozen(ImuData(data.time, data.gyro_b[hold], data.accel_b[hold]), None)
    assert found.severity == "doubtful" and "50 % of the rows" in found.found


def test_saturation_names_axis_and_limit():
    t = np.arange(1, 6001) / RATE
    pulse = np.where(np.abs(t % 20 - 10) < 1.0, 30.0, 0.0) * np.sin(np.pi * t)
    data = imu()
    accel = data.accel_b.copy()
    accel[:, 1] = np.clip(accel[:, 1] + pulse, -19.6, 19.6)
    found = saturated(ImuData(data.time, data.gyro_b, accel))
    assert {f.numbers["limit"] for f in found} == {19.6, -19.6}
    assert all("axis y" in f.found and f.severity == "doubtful" for f in found)


def test_noise_is_measured_in_the_datasheet_unit():
    spec = imu_preset("adis16470")
    sigma = spec.accel_noise_density * np.sqrt(RATE)
    data = imu(sigma=sigma)
    found = {f.subject: f for f in noise(data, spec, windows(data), at_rest(data))}
    assert found["accelerometer noise"].numbers["ratio"] == pytest.approx(1.0, abs=0.02)
    assert found["accelerometer noise"].severity == "note"
    data = imu(sigma=20.0 * sigma)
    found = {f.subject: f for f in noise(data, spec, windows(data), at_rest(data))}
    assert found["accelerometer noise"].severity == "doubtful"


@pytest.mark.parametrize(("factor", "says"), [(1.0, False), (1.7, False), (3.0, True), (0.3, True)])
def test_noise_off_by_more_than_two_is_said_and_not_doubted(factor, says):
    rng, spec = np.random.default_rng(7), imu_preset("consumer")
    n, dt = 3000, 0.02
    gyro = factor * spec.gyro_noise_density / np.sqrt(dt) * rng.standard_normal((n, 3))
    accel = spec.accel_noise_density / np.sqrt(dt) * rng.standard_normal((n, 3))
    data = ImuData(dt * np.arange(1, n + 1), gyro, accel - np.array([0.0, 0.0, 9.8]))
    every = [slice(k, k + 50) for k in range(0, n, 50)]
    found = noise(data, spec, every, np.ones(len(every), dtype=bool))
    of_gyro, of_accel = (f for f in found if f.subject.endswith("noise"))
    assert of_gyro.severity == of_accel.severity == "note"
    assert of_gyro.numbers["ratio"] == pytest.approx(factor, rel=0.05)
    assert ("off by a factor " in of_gyro.found) is says
    assert ("certnav allan" in of_gyro.remedy) is says
    assert not of_accel.remedy


def test_less_than_a_second_is_fatal_and_nothing_else_is_said():
    drive = SimpleNamespace(inertial=imu(seconds=0.4))
    (found,) = inertial_findings(drive, None)
    assert found.severity == "fatal" and "40 rows" in found.found
