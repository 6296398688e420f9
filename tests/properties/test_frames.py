"""Every transform of frames, rotations and time comes back to where it started."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from certnav.datasets import gpstime
from certnav.datasets.axes import axes_matrix
from certnav.datasets.formats.inertial_explorer import dms_to_radians
from certnav.datasets.great.writer import _dms
from certnav.filters import earth
from certnav.filters.errors import ConfigError
from certnav.filters.rotation import (
    matrix_from_rotvec,
    matrix_from_rpy,
    orthonormalise,
    rpy_from_matrix,
    skew,
    wrap_angle,
)

latitudes = st.floats(-np.pi / 2, np.pi / 2)
longitudes = st.floats(-np.pi, np.pi)
heights = st.floats(-500.0, 20e3)
components = st.floats(-1e3, 1e3)
vectors = st.tuples(components, components, components).map(np.array)
angles = st.floats(-np.pi, np.pi)
rotvecs = st.tuples(angles, angles, angles).map(np.array)
# the first and the last week that a file may hold, and times between whole seconds
times = st.floats(0.0, 4e9)


@given(latitudes, longitudes, heights)
def test_ecef_to_geodetic_and_back(lat, lon, height):
    pos_e = earth.lla_to_ecef(lat, lon, height)
    again = earth.ecef_to_lla(pos_e)
    np.testing.assert_allclose(earth.lla_to_ecef(*again), pos_e, atol=2e-8)
    assert again[0] == pytest.approx(lat, abs=1e-11)
    assert again[2] == pytest.approx(height, abs=2e-8)
    # longitude as an angle on the ground: near the poles it means nothing
    assert abs(wrap_angle(again[1] - lon)) * np.cos(lat) < 1e-11


@given(latitudes, longitudes, heights, vectors)
def test_local_axes(lat, lon, height, v_n):
    C_en = earth.C_en_at(lat, lon)
    np.testing.assert_allclose(C_en @ C_en.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(C_en) == pytest.approx(1.0)
    np.testing.assert_allclose(C_en.T @ (C_en @ v_n), v_n, atol=1e-12)
    # down is against growing height, whatever the ellipsoid
    up = earth.lla_to_ecef(lat, lon, height + 100.0) - earth.lla_to_ecef(lat, lon, height)
    np.testing.assert_allclose(up / 100.0, -C_en[:, 2], atol=1e-9)
    if np.cos(lat) > 1e-6:
        of_position = earth.C_en_of(earth.lla_to_ecef(lat, lon, height))
        np.testing.assert_allclose(of_position, C_en, atol=1e-8)


@given(rotvecs)
@example(np.zeros(3))
@example(np.array([1e-9, 0.0, 0.0]))
@example(np.array([1e-4, 0.0, 0.0]))
@example(np.array([0.0, np.pi, 0.0]))
def test_rotation_vectors(rotvec):
    C = matrix_from_rotvec(rotvec)
    np.testing.assert_allclose(C, Rotation.from_rotvec(rotvec).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(C @ matrix_from_rotvec(-rotvec), np.eye(3), atol=1e-14)
    half = matrix_from_rotvec(0.5 * rotvec)
    np.testing.assert_allclose(half @ half, C, atol=1e-14)
    back = Rotation.from_matrix(C).as_rotvec()
    np.testing.assert_allclose(matrix_from_rotvec(back), C, atol=1e-13)


@given(rotvecs)
def test_quaternions(rotvec):
    C = matrix_from_rotvec(rotvec)
    quaternion = Rotation.from_matrix(C).as_quat(scalar_first=True)
    assert np.linalg.norm(quaternion) == pytest.approx(1.0)
    for sign in (1.0, -1.0):
        again = Rotation.from_quat(sign * quaternion, scalar_first=True).as_matrix()
        np.testing.assert_allclose(again, C, atol=1e-14)


@given(angles, st.floats(-np.pi / 2, np.pi / 2), angles)
@example(0.3, np.pi / 2, 0.2)
@example(0.3, -np.pi / 2, 0.2)
def test_roll_pitch_heading(roll, pitch, heading):
    C = matrix_from_rpy([roll, pitch, heading])
    found = rpy_from_matrix(C)
    np.testing.assert_allclose(matrix_from_rpy(found), C, atol=3e-8)
    if abs(pitch) < np.radians(89.0):
        np.testing.assert_allclose(
            wrap_angle(found - [roll, pitch, heading]), np.zeros(3), atol=1e-12
        )


@given(rotvecs, vectors)
def test_orthonormalise_and_skew(rotvec, v):
    C = matrix_from_rotvec(rotvec)
    np.testing.assert_allclose(orthonormalise(C), C, atol=1e-14)
    # a rotation times a stretch: the polar decomposition gives the rotation
    stretch = np.eye(3) + 1e-4 * np.outer(v, v) / (1.0 + v @ v)
    np.testing.assert_allclose(orthonormalise(C @ stretch), C, atol=1e-12)
    np.testing.assert_allclose(skew(v) @ C[:, 0], np.cross(v, C[:, 0]), atol=1e-12)


@given(st.floats(-1e4, 1e4))
def test_wrapped_angles(angle):
    wrapped = wrap_angle(angle)
    assert -np.pi <= wrapped < np.pi
    turns = (angle - wrapped) / (2.0 * np.pi)
    assert turns == pytest.approx(round(turns), abs=1e-9)


@given(latitudes)
@example(np.radians(-0.5))
@example(-1e-9)
@example(np.radians(59.999999999))
def test_degrees_minutes_seconds(angle):
    """0.1 mm, the digits that the writer prints."""
    degree, minute, second = _dms(angle).split()
    assert 0 <= int(minute) < 60 and 0.0 <= float(second) < 60.0
    again = dms_to_radians(np.float64(degree), np.float64(minute), np.float64(second))
    assert float(again) == pytest.approx(angle, abs=np.radians(0.5e-6 / 3600.0) * 1.01)


def test_axes_of_all_names():
    """Of 48 ways to name three directions 24 are right-handed; the others are refused."""
    pairs = ("fb", "rl", "du")
    right = 0
    for order in itertools.permutations(pairs):
        for letters in itertools.product(*order):
            name = "".join(letters).upper()
            if np.linalg.det(_by_hand(name)) > 0:
                C = axes_matrix(name, key="axes")
                np.testing.assert_array_equal(C, _by_hand(name))
                right += 1
            else:
                with pytest.raises(ConfigError, match="left-handed"):
                    axes_matrix(name, key="axes")
    assert right == 24


def _by_hand(name):
    place = {"F": (0, 1), "B": (0, -1), "R": (1, 1), "L": (1, -1), "D": (2, 1), "U": (2, -1)}
    C = np.zeros((3, 3))
    for column, letter in enumerate(name):
        row, sign = place[letter]
        C[row, column] = sign
    return C


@given(times)
@example(604800.0)
@example(np.nextafter(604800.0, 0.0))
@example(1024 * 604800.0)
@example(2048 * 604800.0 - 1e-3)
def test_week_and_seconds_of_week(time):
    week, sow = gpstime.to_week_sow(time)
    assert 0.0 <= sow < 604800.0 and week == int(time // 604800.0)
    # exactly, not to a tolerance: a rounding here would be a fault of the clock
    assert gpstime.from_week_sow(week, sow) == time


@given(st.integers(0, 4000), st.integers(0, 604799), st.integers(0, 999_999))
def test_calendar(week, second, microsecond):
    time = float(gpstime.from_week_sow(week, second + microsecond * 1e-6))
    date = gpstime.to_calendar(time)
    again = gpstime.from_calendar(
        date.year, date.month, date.day, date.hour, date.minute,
        date.second + date.microsecond * 1e-6,
    )  # fmt: skip
    assert again == pytest.approx(time, abs=1.5e-6)


@given(st.floats(315964800.0, 4e9))
@example(1483228800.0)  # 2017-01-01, the last leap second
@example(1483228799.9)
def test_unix_time(unix):
    """GPS − UTC is a whole number of seconds that never falls, and undoing it gives UTC again."""
    time = float(gpstime.from_unix(unix))
    leap = time + 315964800.0 - unix
    assert leap == pytest.approx(round(leap), abs=1e-6) and 0 <= round(leap) <= 18
    later = float(gpstime.from_unix(unix + 1.0))
    assert later - time == pytest.approx(1.0, abs=1e-6) or later - time == pytest.approx(
        2.0, abs=1e-6
    )
    assert gpstime.from_unix(time + 315964800.0 - leap) == pytest.approx(time, abs=1e-6)


@pytest.mark.parametrize(
    ("date", "leap"),
    [((1980, 1, 6), 0), ((1981, 7, 1), 1), ((1999, 1, 1), 13), ((2008, 12, 31), 14),
     ((2009, 1, 1), 15), ((2016, 12, 31), 17), ((2017, 1, 1), 18), ((2026, 1, 1), 18)],
)  # fmt: skip
def test_leap_seconds_of_known_days(date, leap):
    """GPS − UTC at the midnight that a day begins with (IERS Bulletin C)."""
    since = gpstime.from_calendar(*date)
    assert float(gpstime.from_unix(since + 315964800.0)) - since == leap
