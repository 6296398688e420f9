"""Axes that measure nothing: found one by one, and not where data are sound but coarse."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets.imu_faults import blind_stretches, polled
from certnav.datasets.series import ImuData

RATE = 100.0


def drive(seed: int = 0, noise: float = 1.0) -> ImuData:
    """Return two minutes of turns, speed changes and vibration that comes and goes."""
    rng = np.random.default_rng(seed)
    t = np.arange(1, 12001) / RATE
    shake = noise * (0.2 + np.sin(0.1 * t)[:, None] ** 2)
    gyro = 0.02 * shake * rng.normal(size=(t.size, 3))
    accel = 0.3 * shake * rng.normal(size=(t.size, 3)) + [0.0, 0.0, -9.8]
    gyro[:, 2] += 0.4 * np.sin(0.3 * t) ** 5
    accel[:, 0] += 3.0 * np.sin(0.2 * t) ** 3
    accel[:, 1] += 4.0 * np.sin(0.3 * t) ** 5
    return ImuData(t, gyro, accel)


def moving(imu: ImuData) -> np.ndarray:
    return np.ones(len(imu), dtype=bool)


def found(imu: ImuData, moves: bool = True):
    return [(s.name, s.why) for s in blind_stretches(imu, moving(imu) & moves)]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("rows", [25, 300])
def test_a_frozen_axis_is_found_where_it_is(seed, axis, rows):
    imu = drive(seed)
    values = np.hstack([imu.gyro_b, imu.accel_b])
    first = 3000 + 500 * seed
    values[first : first + rows, axis] = values[first, axis]
    broken = ImuData(imu.time, values[:, :3], values[:, 3:])
    (only,) = blind_stretches(broken, moving(imu))
    assert (3 * only.sensor + only.axis, only.why) == (axis, "frozen")
    assert (only.first, only.last) == (first, first + rows - 1)
    assert (only.begin, only.end) == (imu.time[first], imu.time[first + rows - 1])
    assert found(broken, moves=False) == []  # at rest values may repeat


@pytest.mark.parametrize("seed", range(5))
def test_clipping_is_found_axis_by_axis_moving_or_not(seed):
    imu = drive(seed)
    accel, gyro = imu.accel_b.copy(), imu.gyro_b.copy()
    accel[:, 0] = np.clip(accel[:, 0], -2.0, 2.0)
    gyro[:, 2] = np.minimum(gyro[:, 2], 0.25)
    broken = ImuData(imu.time, gyro, accel)
    stretches = blind_stretches(broken, ~moving(imu))
    assert {(s.name, s.why) for s in stretches} == {
        ("gyro z", "clipped"), ("accelerometer x", "clipped"),
    }  # fmt: skip
    assert {s.value for s in stretches} == {2.0, -2.0, 0.25}
    # Vibration dips below the limit: most of the time beyond it is covered all the same.
    beyond = 3.0 * np.abs(np.sin(0.2 * imu.time) ** 3) > 2.2
    blind = np.zeros(len(imu), dtype=bool)
    for s in stretches:
        if s.name == "accelerometer x":
            blind[s.first : s.last + 1] = True
    assert blind[beyond].mean() > 0.9 and blind[~beyond].mean() < 0.2


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("gyro", "accel"), [(0.001, 0.01), (0.005, 0.05), (np.radians(1.0), 0.25), (0.05, 1.0)]
)
def test_coarse_converters_repeat_values(seed, gyro, accel):
    """Where the noise is large, one step of it is rare; where it is small, values stay."""
    imu = drive(seed)
    coarse = ImuData(
        imu.time, gyro * np.round(imu.gyro_b / gyro), accel * np.round(imu.accel_b / accel)
    )
    assert found(coarse) == []


@pytest.mark.parametrize("times", [2, 5, 10, 30])
def test_rows_printed_faster_than_the_sensor_reports(times):
    imu = drive()
    hold = np.arange(len(imu)) // times * times
    assert found(ImuData(imu.time, imu.gyro_b[hold], imu.accel_b[hold])) == []


def test_exact_data_at_rest():
    """A simulation without noise that stands, drives and stands."""
    imu = drive(noise=1.0)
    stands = (imu.time < 40.0) | (imu.time > 100.0)
    gyro, accel = imu.gyro_b.copy(), imu.accel_b.copy()
    gyro[stands], accel[stands] = 0.0, [0.0, 0.0, -9.8]
    assert blind_stretches(ImuData(imu.time, gyro, accel), ~stands) == []
    # One that only turns right: zero is its least value, and its usual one.
    gyro = np.where(stands[:, None], 0.0, np.abs(imu.gyro_b))
    assert blind_stretches(ImuData(imu.time, gyro, accel), ~stands) == []


def test_the_outermost_value_of_a_sound_axis_is_no_limit():
    """Coarse or fine, at a plateau of an even turn or without: it is the rarest, not the usual."""
    assert found(drive(), moves=False) == []
    imu = drive()
    gyro = imu.gyro_b.copy()
    gyro[4000:4600, 2] = 0.5 + 0.004 * np.random.default_rng(1).normal(size=600)
    assert found(ImuData(imu.time, gyro, imu.accel_b), moves=False) == []


def test_a_dead_axis_is_frozen_throughout():
    imu = drive()
    gyro = imu.gyro_b.copy()
    gyro[:, 1] = 0.0
    (only,) = blind_stretches(ImuData(imu.time, gyro, imu.accel_b), moving(imu))
    assert (only.name, only.first, only.last) == ("gyro y", 0, len(imu) - 1)


def polled_out_of_step(share, seconds=4000.0, sigma=0.1):
    """A vibrating IMU, and its log in which that share of samples is another one read twice."""
    rng, n = np.random.default_rng(31), int(100 * seconds)
    time = 0.01 * np.arange(n)
    x = sigma * rng.standard_normal((n, 6)) * [1.0, 2.0, 0.5, 3.0, 1.0, 1.0]
    slow = np.sin(0.3 * time)[:, None] * [0.2, 0.0, 0.4, 1.0, 1.0, 0.0]  # what a car does
    true = x + slow
    logged, period = true.copy(), int(1.0 / share)
    twice = np.arange(period, n, period)
    logged[twice] = true[twice - 1]
    return ImuData(time, true[:, :3], true[:, 3:]), ImuData(time, logged[:, :3], logged[:, 3:])


def test_the_noise_of_samples_polled_twice_is_what_their_integral_scatters():
    true, logged = polled_out_of_step(0.02)
    found = polled(logged)
    assert found is not None and found.share == pytest.approx(0.02, rel=0.01)
    for density, name in ((found.gyro_density, "gyro_b"), (found.accel_density, "accel_b")):
        error = (getattr(logged, name) - getattr(true, name)).reshape(400, 1000, 3).sum(axis=1)
        scatter = 0.01 * error.std(axis=0) / np.sqrt(10.0)  # in ten seconds
        # What a car does adds a few per cent to the steps; 400 spans know their spread to 4 %.
        assert density == pytest.approx(np.sqrt((scatter**2).mean()), rel=0.1)


@pytest.mark.parametrize("share", [0.0005, 0.5])
def test_what_hardly_ever_or_always_repeats_is_no_polling(share):
    assert polled(polled_out_of_step(share, 100.0)[1]) is None
    assert polled(polled_out_of_step(share, 100.0)[0]) is None
