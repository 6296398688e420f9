"""Rotations, Earth model and time: identities, closed forms and independent libraries."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from certnav.datasets import gpstime
from certnav.filters import earth
from certnav.filters.rotation import (
    matrix_from_rotvec,
    matrix_from_rpy,
    orthonormalise,
    rpy_from_matrix,
    skew,
    wrap_angle,
)


def test_skew_is_the_cross_product():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 50, 3))
    np.testing.assert_allclose(np.einsum("kij,kj->ki", skew(a), b), np.cross(a, b), atol=1e-15)


@pytest.mark.parametrize("scale", [1e-9, 1e-5, 1e-3, 1.0, 3.0])
def test_rotvec_matrix_agrees_with_scipy(scale):
    rotvec = np.random.default_rng(2).normal(size=(100, 3)) * scale
    expected = Rotation.from_rotvec(rotvec).as_matrix()
    np.testing.assert_allclose(matrix_from_rotvec(rotvec), expected, atol=2e-15 * (1 + scale))


def test_rpy_round_trip_and_axes():
    rng = np.random.default_rng(3)
    rpy = rng.uniform([-np.pi, -1.5, -np.pi], [np.pi, 1.5, np.pi], size=(200, 3))
    C = matrix_from_rpy(rpy)
    np.testing.assert_allclose(rpy_from_matrix(C), rpy, atol=1e-12)
    np.testing.assert_allclose(Rotation.from_euler("ZYX", rpy[:, ::-1]).as_matrix(), C, atol=1e-14)
    # Heading 90° points the nose east, pitch up lifts it, roll right lowers the right side.
    np.testing.assert_allclose(matrix_from_rpy([0, 0, np.pi / 2])[:, 0], [0, 1, 0], atol=1e-15)
    assert matrix_from_rpy([0, 0.1, 0])[2, 0] < 0 < matrix_from_rpy([0.1, 0, 0])[2, 1]


def test_orthonormalise_returns_nearest_rotation():
    rng = np.random.default_rng(4)
    C = Rotation.random(20, random_state=4).as_matrix()
    noisy = orthonormalise(C + 1e-3 * rng.normal(size=C.shape))
    np.testing.assert_allclose(
        noisy @ noisy.transpose(0, 2, 1), np.tile(np.eye(3), (20, 1, 1)), atol=1e-14
    )
    np.testing.assert_allclose(np.linalg.det(noisy), 1.0)
    mirrored = orthonormalise(np.diag([1.0, 1.0, -1.0]))
    assert np.linalg.det(mirrored) == pytest.approx(1.0)


def test_wrap_angle_interval():
    np.testing.assert_allclose(
        wrap_angle([np.pi, -np.pi, 3 * np.pi, 0.1]), [-np.pi, -np.pi, -np.pi, 0.1]
    )


def test_ecef_lla_round_trip():
    rng = np.random.default_rng(5)
    lla = rng.uniform([-1.55, -np.pi, -100.0], [1.55, np.pi, 5000.0], size=(500, 3))
    pos_e = earth.lla_to_ecef(*lla.T)
    back = earth.ecef_to_lla(pos_e)
    np.testing.assert_allclose(earth.lla_to_ecef(*back.T), pos_e, atol=2e-8)
    np.testing.assert_allclose(back[:, :2], lla[:, :2], atol=1e-14)


def test_C_en_axes_point_north_east_down():
    lat, lon, h = 0.53, 2.0, 80.0
    C_en = earth.C_en_at(lat, lon)
    step = 1e-6
    pos = earth.lla_to_ecef(lat, lon, h)
    for axis, moved in enumerate([(lat + step, lon, h), (lat, lon + step, h), (lat, lon, h - 1.0)]):
        direction = earth.lla_to_ecef(*moved) - pos
        np.testing.assert_allclose(direction / np.linalg.norm(direction), C_en[:, axis], atol=1e-6)
    np.testing.assert_allclose(earth.C_en_of(pos), C_en, atol=1e-12)


@pytest.mark.parametrize("lat_deg", [-80.0, -45.0, 0.0, 30.5, 60.0, 89.0])
def test_gravity_agrees_with_normal_gravity(lat_deg):
    """Somigliana's closed form on the ellipsoid (WGS 84), to the neglected J4."""
    lat = np.radians(lat_deg)
    s2 = np.sin(lat) ** 2
    somigliana = (
        9.7803253359 * (1 + 0.00193185265241 * s2) / np.sqrt(1 - earth.ECCENTRICITY_SQUARED * s2)
    )
    gravity = earth.gravity_e(earth.lla_to_ecef(lat, 0.7, 0.0))
    assert np.linalg.norm(gravity) == pytest.approx(somigliana, abs=1.3e-4)
    down = earth.C_en_at(lat, 0.7)[:, 2]
    assert gravity @ down / np.linalg.norm(gravity) == pytest.approx(1.0, abs=1e-9)


def test_gravity_gradient_against_central_differences():
    pos = earth.lla_to_ecef(0.6, -1.3, 300.0)
    step = 100.0
    numeric = np.stack(
        [
            (earth.gravity_e(pos + d) - earth.gravity_e(pos - d)) / (2 * step)
            for d in np.eye(3) * step
        ],
        axis=1,
    )
    # What is missing is J2's own gradient, 0.3 % of the whole.
    assert np.abs(earth.gravity_gradient_e(pos) - numeric).max() < 6e-3 * np.abs(numeric).max()


def test_gps_time():
    assert gpstime.from_calendar(1980, 1, 6) == 0.0
    # 2022-10-23 was a Sunday, the first day of week 2233 (GREAT urban-02).
    assert gpstime.from_calendar(2022, 10, 23) == 2233 * 604800
    week, sow = gpstime.to_week_sow(gpstime.from_week_sow(2129, 367140.5))
    assert (week, sow) == (2129, 367140.5)
    # Unix 1603864800 is 2020-10-28 06:00:00 UTC; GPS leads UTC by 18 s since 2017.
    assert gpstime.from_unix(1603864800.0) == gpstime.from_calendar(2020, 10, 28, 6, 0, 18.0)
    # On either side of the leap second at the end of 2016: 17 s before, 18 s after.
    assert gpstime.from_unix(1483228799.0) == gpstime.from_calendar(2017, 1, 1, 0, 0, 16.0)
    assert gpstime.from_unix(1483228800.0) == gpstime.from_calendar(2017, 1, 1, 0, 0, 18.0)
    assert gpstime.to_calendar(gpstime.from_calendar(2021, 4, 29, 12, 30, 1.25)).isoformat() == (
        "2021-04-29T12:30:01.250000"
    )
