"""Gravity and turns tell units and axes."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets.physics import (
    check_gravity,
    check_gyro,
    course_of,
    decide_gyro_unit,
    gyro_unit_ratio,
)
from certnav.datasets.series import ImuData
from certnav.filters.earth import C_en_of, lla_to_ecef
from certnav.filters.errors import DataError

DEG = np.pi / 180.0


def weaving(n: int = 6000, bias: float = 0.0, noise: float = 0.0):
    """Return IMU time, yaw rate [rad/s] and the exact heading of a car that turns to and fro."""
    t = 100.0 + 0.01 * np.arange(n)
    heading = 3.0 + 2.0 * np.sin(2.0 * np.pi * (t - 100.0) / 20.0)  # crosses ±180°
    rate = np.diff(heading, prepend=heading[0]) / 0.01
    rng = np.random.default_rng(1)
    return t, rate + bias + noise * rng.standard_normal(n), heading


def wrap(angle):
    return np.arctan2(np.sin(angle), np.cos(angle))


@pytest.mark.parametrize("every", [10, 50, 100])  # 10, 2 and 1 Hz
def test_slope_is_one_for_a_perfect_gyro_whatever_its_bias(every):
    t, rate, heading = weaving(bias=0.05)
    found = gyro_unit_ratio(t, rate, t[::every], wrap(heading[::every]))
    assert found.conclusive
    assert abs(found.ratio - 1.0) < 1e-9
    # every sine period turns there and back by 4 rad
    assert found.turned == pytest.approx(3 * 2 * 4.0, rel=0.35)


@pytest.mark.parametrize(("factor", "unit"), [(1.0, "rad/s"), (1.0 / DEG, "deg/s")])
def test_unit_is_told_from_a_noisy_gyro_and_course(factor, unit):
    t, rate, heading = weaving(bias=0.01, noise=0.02)
    rng = np.random.default_rng(2)
    course = wrap(heading[::100] + 0.03 * rng.standard_normal(heading[::100].size))
    found = gyro_unit_ratio(t, factor * rate, t[::100], course)
    decided, evidence = decide_gyro_unit(found, file="imu.txt")
    assert decided == unit
    assert "turning" in evidence


def test_slope_scale_error_beyond_ten_percent_is_inconclusive():
    t, rate, heading = weaving()
    found = gyro_unit_ratio(t, 1.2 * rate, t[::10], wrap(heading[::10]))
    assert found.ratio == pytest.approx(1.2, abs=1e-6)
    with pytest.raises(DataError, match=r"imu\.txt: gyro unit cannot be told.*declare gyro_unit"):
        decide_gyro_unit(found, file="imu.txt")


def test_noise_of_the_course_and_a_lag_are_in_the_sigma_not_in_the_slope():
    """Reflections scatter the course by 9° and make it jump; the antenna leads by 0.2 s."""
    late = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        t, rate, heading = weaving(n=20000, bias=0.01, noise=0.02)
        ahead = np.interp(t[::150] + 0.2, t, heading)
        course = ahead + 0.15 * rng.standard_normal(ahead.size)
        course[rng.integers(0, ahead.size, 6)] += 1.0
        found = gyro_unit_ratio(t, rate, t[::150], wrap(course))
        assert 0.0 < found.sigma < 0.1
        late.append((found.ratio - 1.0) / found.sigma)
    assert np.mean(np.abs(late) < 2.0) >= 0.9
    assert abs(np.mean(late)) < 1.0


def test_straight_road_is_inconclusive():
    t = np.arange(0.0, 60.0, 0.01)
    rng = np.random.default_rng(3)
    course = 0.01 * rng.standard_normal(60)
    found = gyro_unit_ratio(t, 0.001 * rng.standard_normal(t.size), np.arange(60.0), course)
    assert not found.conclusive
    with pytest.raises(DataError, match="cannot be told"):
        decide_gyro_unit(found, file="imu.txt")


def test_wrong_sign_is_named():
    t, rate, heading = weaving()
    found = gyro_unit_ratio(t, -rate / DEG, t[::10], wrap(heading[::10]))
    with pytest.raises(DataError, match="wrong sign"):
        decide_gyro_unit(found, file="imu.txt")


def test_unknown_course_and_a_jump_while_standing_do_not_disturb():
    t, rate, heading = weaving()
    course = wrap(heading[::100]).copy()
    course[20:25] = np.nan
    course[40] += np.pi  # reversing: the course flips, the heading does not
    found = gyro_unit_ratio(t, rate, t[::100], course)
    assert abs(found.ratio - 1.0) < 1e-6


def test_long_straights_do_not_make_outliers_of_the_turns():
    """Ninety quiet straight seconds in a hundred; in turns the antenna's course leads by 0.1 s."""
    t = np.arange(0.0, 600.0, 0.01)
    heading = np.cumsum(np.where(t % 100.0 < 10.0, 0.157, 0.0)) * 0.01
    rate = np.diff(heading, prepend=0.0) / 0.01
    rate += 1e-4 * np.random.default_rng(4).standard_normal(t.size)
    found = gyro_unit_ratio(t, rate, t[:-20:100], wrap(heading[10:-10:100]))
    assert found.is_close_to(1.0)
    assert found.turned == pytest.approx(6 * 1.57, rel=0.3)


def test_course_outside_the_imu_is_not_used():
    t, rate, heading = weaving()
    tc = np.concatenate([t[0] - np.arange(50.0, 0.0, -1.0), t[::100]])
    course = np.concatenate([np.linspace(0.0, 3.0, 50), wrap(heading[::100])])
    assert abs(gyro_unit_ratio(t, rate, tc, course).ratio - 1.0) < 1e-9


def imu_from(t, rate, accel=(0.0, 0.0, -9.8)):
    gyro = np.zeros((t.size, 3))
    gyro[:, 2] = rate
    return ImuData(t, gyro, np.tile(accel, (t.size, 1)))


@pytest.mark.parametrize(
    ("factor", "remedy"),
    [
        (1.0 / DEG, "the file is in deg/s"),
        (DEG, "the file is in rad/s"),
        (-1.0, "upside down"),
        (2.0, "check the gyro's unit"),
    ],
)
def test_check_gyro_names_what_to_declare(factor, remedy):
    t, rate, heading = weaving()
    with pytest.raises(DataError, match=remedy):
        check_gyro(
            imu_from(t, factor * rate), t[::10], wrap(heading[::10]), file="f", declared="rad/s"
        )


def test_check_gyro_verifies_or_says_that_it_cannot():
    t, rate, heading = weaving()
    course = wrap(heading[::10])
    assert "verified" in check_gyro(imu_from(t, rate), t[::10], course, file="f", declared="x")
    still = check_gyro(imu_from(t, 0.0 * t), t[::10], 0.0 * course, file="f", declared="x")
    assert "too little turning" in still


@pytest.mark.parametrize(
    ("mean", "message"),
    [
        ((0.0, 0.0, -1.0), "in g: declare accel_unit='g'"),
        ((0.0, 0.0, -96.0), "in m/s²"),
        ((0.0, 0.0, -0.098), "increments"),
        ((0.0, 0.0, 9.8), r"found \+z"),
        ((9.8, 0.0, 0.0), r"found \+x"),
        ((0.0, -9.8, 0.0), "found −y"),
    ],
)
def test_gravity_refuses_wrong_unit_or_axis(mean, message):
    with pytest.raises(DataError, match=message):
        check_gravity(np.tile(mean, (100, 1)), file="f", declared="x")


def test_gravity_accepts_a_biased_tilted_sensor():
    tilt = 10.0 * DEG
    f = 9.8 * np.array([np.sin(tilt), 0.0, -np.cos(tilt)]) + [0.1, -0.1, 0.2]
    assert "verified" in check_gravity(np.tile(f, (100, 1)), file="f", declared="x")


def test_course_is_clockwise_from_north_and_nan_when_slow():
    pos_e = np.tile(lla_to_ecef(0.5, 2.0, 30.0), (4, 1))
    vel_n = np.array([[5.0, 0, 0], [0, 5.0, 0], [-5.0, -5.0, 1.0], [1.0, 1.0, 0]])
    vel_e = vel_n @ C_en_of(pos_e[0]).T
    course = course_of(pos_e, vel_e)
    np.testing.assert_allclose(course[:3], np.radians([0.0, 90.0, -135.0]), atol=1e-12)
    assert np.isnan(course[3])


@pytest.mark.parametrize("pitch", [-29.0, 20.0, 29.0])
@pytest.mark.parametrize("upside_down", [False, True])
def test_a_gyro_that_lies_askew_turns_about_the_vertical(pitch, upside_down):
    """Its own z measures cos(29°) = 0.87 of the turns, which is no scale factor."""
    t, rate, heading = weaving()
    up_b = np.array([np.sin(pitch * DEG), 0.0, -np.cos(pitch * DEG)])
    gyro = -np.outer(rate, up_b)
    accel = np.tile(9.8 * up_b, (t.size, 1))
    if upside_down:
        gyro, accel = gyro * [1.0, -1.0, -1.0], accel * [1.0, -1.0, -1.0]
    imu = ImuData(t, gyro, accel)
    course = wrap(heading[::10])
    if upside_down:
        with pytest.raises(DataError, match="upside down"):
            check_gyro(imu, t[::10], course, file="f", declared="x")
        return
    said = check_gyro(imu, t[::10], course, file="f", declared="x")
    assert "verified" in said and "= 1 ±" in said
