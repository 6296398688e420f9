"""Time, axes, signs and units from motion: an analytic drive, with and without faults."""

from __future__ import annotations

import dataclasses
import re
from types import SimpleNamespace

import numpy as np
import pytest

from certnav.datasets.gpstime import from_calendar
from certnav.filters.earth import lla_to_ecef
from certnav.filters.rotation import matrix_from_rpy
from certnav.nav.check.axes import accelerometer, gyro
from certnav.nav.check.motion import Inertial
from certnav.nav.check.reference import time_offset as reference_offset
from certnav.nav.check.timing import (
    expected_lags,
    leap_remedy,
    leap_second_words,
    offset_findings,
    time_offset,
)
from certnav.velocity.tracks import Track

POSITION = np.radians([48.0, 11.0])


def speed(t):
    return 12.0 + 5.0 * np.sin(0.13 * t) + 2.0 * np.sin(0.031 * t**1.2)


def course(t):
    return 1.5 * np.sin(0.09 * t) + 0.8 * np.cos(0.05 * t + 0.002 * t**1.3)


def track(rate: float = 2.0) -> Track:
    t = np.arange(0.0, 240.0, 1.0 / rate)
    vel_n = np.column_stack([speed(t) * np.cos(course(t)), speed(t) * np.sin(course(t)), 0.0 * t])
    pos_e = np.tile(lla_to_ecef(*POSITION, 500.0), (t.size, 1))
    return Track("GNSS velocity", t, pos_e, vel_n)


def sensors(C: np.ndarray | None = None, gyro_factor: float = 1.0, late: float = 0.0) -> Inertial:
    """Return the integrals of an error-free IMU with axes ``x_file = C @ x_vehicle``."""
    t = np.arange(0.0, 240.0, 0.01)
    C = np.eye(3) if C is None else C
    right = np.cumsum(speed(t) * np.gradient(course(t), t)) * 0.01
    velocity = np.column_stack([speed(t), right, -9.8 * t]) @ C.T
    angle = np.column_stack([0.01 * np.sin(t), 0.01 * np.cos(1.3 * t), course(t)]) @ C.T
    rate = np.gradient(angle, t, axis=0) * gyro_factor
    return Inertial(t + late, angle * gyro_factor, velocity, rate)


def only(findings):
    (found,) = findings
    return found


def test_drive_in_order():
    imu = sensors()
    offset = time_offset(imu, track(), 0.0)
    assert abs(offset.lag) < 0.01 and not offset.significant
    assert only(gyro(imu, track())).severity == "note"
    found = only(accelerometer(imu, track()))
    assert found.severity == "note"
    assert found.numbers["turned_deg"] == pytest.approx(0.0, abs=0.5)
    assert found.numbers["gain"] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(
    ("late", "severity", "words"),
    [
        (0.2, "doubtful", "0.20 ± 0.0. s late"),
        (-0.3, "doubtful", "0.30 ± 0.0. s early"),
        (18.0, "fatal", "18.00 .* late .*leap seconds"),
        (-18.0, "fatal", "18.00 .* early .*leap seconds"),
        (36.0, "fatal", "36.00 .* twice"),
        (3.0, "fatal", r"3.00 .* late \([^)]*\)$"),
    ],
)
def test_time_is_found_whatever_the_axes(late, severity, words):
    C = [[0, 0, 1.0], [-1, 0, 0], [0, 1, 0]]
    found = only(
        offset_findings(
            time_offset(sensors(np.array(C), late=late), track(), 0.0), "GNSS", (18.0, 36.0)
        )
    )
    assert found.severity == severity
    assert re.search(words, found.found), found.found
    assert found.numbers["offset_s"] == pytest.approx(late, abs=0.02)


@pytest.mark.parametrize(
    ("C", "factor", "words"),
    [
        (np.diag([1.0, -1, -1]), 1.0, "sign is reversed"),
        (np.eye(3), 180 / np.pi, "unit is deg/s"),
        (np.eye(3), np.pi / 180, "unit is rad/s"),
        (np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]), 1.0, "on axis x"),
        (np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), 180 / np.pi, "axis y.*reversed.*deg/s"),
    ],
)
def test_gyro_faults_are_told_apart(C, factor, words):
    found = only(gyro(sensors(C, factor), track()))
    assert found.severity == "fatal"
    assert re.search(words, found.found), found.found


def test_gyro_scale_of_one_fifth_is_doubtful():
    found = only(gyro(sensors(gyro_factor=0.8), track()))
    assert found.severity == "doubtful" and "-20 %" in found.found


@pytest.mark.parametrize("turn_deg", [-60.0, -30.0, 30.0, 90.0, 175.0])
def test_mounting_angle_is_recovered(turn_deg):
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    C = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])  # vehicle forward seen in sensor axes
    found = only(accelerometer(sensors(C), track()))
    assert found.severity == ("fatal" if abs(turn_deg) > 45 else "doubtful")
    assert found.numbers["turned_deg"] == pytest.approx(turn_deg, abs=1.0)
    rpy = re.search(r"mounting_rpy_deg = \[(.*)\]", found.remedy)
    assert rpy is not None
    # As it is declared, x_v = R(rpy) x_b: forward in sensor axes comes out as forward.
    R = matrix_from_rpy(np.radians([float(v) for v in rpy[1].split(",")]))
    np.testing.assert_allclose(R @ C[:, 0], [1.0, 0.0, 0.0], atol=0.02)


@pytest.mark.parametrize(
    ("C", "words"),
    [
        (np.diag([1.0, -1, 1]), "right axis is reversed"),
        (np.diag([-1.0, 1, 1]), "forward axis is reversed"),
        (np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]), "forward and right are swapped"),
    ],
)
def test_left_handed_axes_are_named(C, words):
    found = only(accelerometer(sensors(C), track()))
    assert found.severity == "fatal" and "left-handed" in found.found and words in found.found


def test_straight_even_drive_tells_nothing_and_accuses_nobody():
    t = np.arange(0.0, 240.0, 0.5)
    pos_e = np.tile(lla_to_ecef(*POSITION, 0.0), (t.size, 1))
    noise = np.random.default_rng(0).normal(0.0, 0.05, (t.size, 3))
    even = Track("GNSS velocity", t, pos_e, noise + np.array([15.0, 0.0, 0.0]))
    imu = sensors()
    quiet = Inertial(imu.time, 0.0 * imu.angle, 0.0 * imu.velocity, 0.0 * imu.gyro)
    offset = time_offset(quiet, even, 0.0)
    findings = [*offset_findings(offset, "GNSS"), *gyro(quiet, even), *accelerometer(quiet, even)]
    assert {f.severity for f in findings} == {"note"}
    assert all("cannot be told" in f.found for f in findings)


def dated(year: int, scale: str = "gps"):
    """Return what `expected_lags` looks at of a recording in the July of a year."""
    start = from_calendar(year, 7, 2)
    return SimpleNamespace(time_scale=scale, span=(start, start + 240.0))


def test_leap_seconds_are_those_of_the_date():
    """17 s were the leap seconds of 2015 and 2016, and a round of the block before and after."""
    now, then = expected_lags(dated(2021)), expected_lags(dated(2016))
    assert (now, then) == ((18.0, 36.0), (17.0, 34.0))
    assert "18 leap seconds" in leap_second_words(-18.05, now)
    assert "twice" in leap_second_words(36.0, now)
    assert "17 leap seconds" in leap_second_words(17.06, then)
    for lag in (-17.06, 17.0, 13.0, 7.0, 18.5, 0.1):
        assert leap_second_words(lag, now) == ""
    assert expected_lags(dated(2021, "relative")) == ()
    assert leap_second_words(18.0, ()) == ""


def test_remedy_follows_the_sign():
    """UTC is behind: what is early is in UTC."""
    assert "the reference is in UTC" in leap_remedy(-18.0, (18.0, 36.0), "", "the reference")
    assert "the GNSS is in UTC" in leap_remedy(18.0, (18.0, 36.0), "", "the reference")
    assert leap_remedy(17.0, (18.0, 36.0), "otherwise", "the IMU") == "otherwise"


@pytest.mark.parametrize("late", [0.3, -0.4, 18.0, -18.0])
def test_late_means_late_whichever_sensor_it_is_said_of(late):
    """The same shift of the IMU and of the reference has the same sign in every finding."""
    offset = time_offset(sensors(late=late), track(), 0.0)
    assert all(np.sign(lag.lag) == np.sign(late) for _, lag in offset.evidence)
    assert offset.lag == pytest.approx(late, abs=0.05)
    shifted = dataclasses.replace(track(10.0), time=track(10.0).time + late)
    lag, found = reference_offset(shifted, track(), 0.0)
    assert lag == pytest.approx(late, abs=0.05)
    word = "late" if late > 0 else "early"
    assert word in only(found).found
    assert word in only(offset_findings(offset, "GNSS")).found
