"""The mechanisation against exact truth, and against motions with closed forms."""

import dataclasses

import numpy as np
import pytest

from certnav.filters import earth
from certnav.filters.errors import DataError
from certnav.filters.rotation import matrix_from_rpy, rpy_from_matrix
from certnav.filters.strapdown import InertialStream, NavState, integrate


def exact_stream(trajectory, rate, duration, start_offset=1.0):
    """Noise-free IMU means at `rate`, and the true state at the start."""
    start = trajectory.span[0] + start_offset
    time = start + np.arange(1, int(duration * rate) + 1) / rate
    k = trajectory.kinematics(np.array([start]))
    state = NavState(start, k.pos_e[0], k.vel_e[0], k.C_eb[0])
    return InertialStream(time, *trajectory.imu_means(time)), state


def rotation_angle(C1, C2):
    """Angle between attitudes [rad], exact for small ones."""
    D = C1 @ np.swapaxes(C2, -1, -2)
    vector = np.stack(
        [D[..., 2, 1] - D[..., 1, 2], D[..., 0, 2] - D[..., 2, 0], D[..., 1, 0] - D[..., 0, 1]]
    )
    return np.linalg.norm(vector, axis=0) / 2


def test_ten_minutes_of_driving_without_noise(city_drive):
    """100 Hz, free inertial: within 1 mm and 1e-6 deg of truth (a few would be 1 cm, 1e-4 deg)."""
    stream, state = exact_stream(city_drive, 100.0, 600.0)
    rows = integrate(stream, state)
    truth = city_drive.kinematics(rows[:, 0])
    position_error = np.linalg.norm(rows[:, 1:4] - truth.pos_e, axis=1)
    velocity_error = np.linalg.norm(rows[:, 4:7] - truth.vel_e, axis=1)
    angle = rotation_angle(rows[:, 7:16].reshape(-1, 3, 3), truth.C_eb)
    assert len(rows) == 60000
    assert position_error.max() < 1e-3
    assert velocity_error.max() < 1e-4
    assert np.degrees(angle.max()) < 1e-6


def test_split_intervals_change_nothing(city_drive):
    """Stopping in the middle of IMU intervals and going on gives the unsplit result."""
    stream, state = exact_stream(city_drive, 100.0, 60.0, start_offset=60.0)
    whole = integrate(stream, state)[-1]
    until, pieces = state, []
    for cut in state.time + np.array([7.0033, 7.0071, 20.0, 33.3349, 60.0]):
        rows = integrate_to(stream, until, cut)
        until = rows
        pieces.append(rows.time)
    assert pieces == sorted(pieces)
    np.testing.assert_allclose(until.pos_e, whole[1:4], atol=2e-6)
    np.testing.assert_allclose(until.vel_e, whole[4:7], atol=2e-6)
    assert rotation_angle(until.C_eb, whole[7:].reshape(3, 3)) < 1e-8


def integrate_to(stream, state, until):
    """State at a time between IMU samples, through the filter that splits there."""
    from certnav.filters.ekf import ErrorStateFilter
    from certnav.filters.error_model import ErrorModel
    from certnav.filters.sensors import imu_preset

    kalman = ErrorStateFilter(ErrorModel(imu_preset("tactical")), stream, state, np.eye(15))
    kalman.propagate(until)
    return kalman.state


def test_standing_still_on_a_turning_earth():
    pos = earth.lla_to_ecef(0.9, 0.2, 100.0)
    C = earth.C_en_of(pos) @ matrix_from_rpy([0.02, -0.03, 1.0])
    n = 20000
    gyro = np.tile(C.T @ earth.OMEGA_IE_E, (n, 1))
    accel = np.tile(-C.T @ earth.gravity_e(pos), (n, 1))
    time = 5e8 + np.arange(1, n + 1) * 0.01
    stream = InertialStream(time, gyro, accel)
    rows = integrate(stream, NavState(stream.start, pos, np.zeros(3), C))
    assert np.linalg.norm(rows[-1, 1:4] - pos) < 1e-4
    assert rotation_angle(rows[-1, 7:].reshape(3, 3), C) < 1e-9


def test_coning_is_compensated():
    """Classic coning, 2 Hz and 0.1 rad half angle, sampled at 100 Hz: against the closed form.

    C(t) = Rz(−Ωt) Ry(a) Rz(Ωt) has body rate Ω(−sin a cos Ωt, sin a sin Ωt, 1 − cos a) in some
    order of signs; increments are taken from the exact rate, so only the algorithm can err.
    """
    big_omega, a, rate, n = 2 * np.pi * 2.0, 0.1, 100.0, 2000
    t = np.arange(n + 1) / rate

    def attitude(time):
        z = np.zeros_like(time)
        inner = matrix_from_rpy(np.stack([z, z, big_omega * time], -1))
        outer = matrix_from_rpy(np.stack([z, z, -big_omega * time], -1))
        return outer @ matrix_from_rpy([0.0, a, 0.0]) @ inner

    # ω from C'C: differentiate numerically far below the test's tolerance, integrate by Gauss.
    node, weight = np.polynomial.legendre.leggauss(5)
    gyro = np.zeros((n, 3))
    for x, w in zip(node, weight / 2, strict=True):
        at = t[:-1] + 0.5 * (x + 1) / rate
        h = 1e-5
        W = np.swapaxes(attitude(at), 1, 2) @ (attitude(at + h) - attitude(at - h)) / (2 * h)
        gyro += w * np.stack([W[:, 2, 1], W[:, 0, 2], W[:, 1, 0]], -1)

    pos = earth.lla_to_ecef(0.5, 2.0, 0.0)
    start = NavState(1e8, pos, np.zeros(3), attitude(t[:1])[0])
    # The Earth's turn is added to the rate, so that the body cones with respect to e.
    mid = np.swapaxes(attitude(t[:-1] + 0.5 / rate), 1, 2)
    stream = InertialStream(1e8 + t[1:], gyro + mid @ earth.OMEGA_IE_E, np.zeros((n, 3)))
    rows = integrate(stream, start)
    drift = rotation_angle(rows[-1, 7:].reshape(3, 3), attitude(t[-1:])[0])
    # Without the coning term the axis would drift by Ω a²/2 · (Ωdt)²/12 per second.
    uncompensated = big_omega * a**2 / 2 * (big_omega / rate) ** 2 / 12 * 20.0
    assert drift < 0.02 * uncompensated


def test_turntable_and_axes():
    """One turn to the right about the vertical in 10 s ends where it began."""
    pos = earth.lla_to_ecef(0.0, 0.0, 0.0)
    C_en = earth.C_en_of(pos)
    n, rate = 1000, 100.0
    time = 1e8 + np.arange(1, n + 1) / rate
    turning = np.tile([0.0, 0.0, 2 * np.pi / 10.0], (n, 1))
    headings = (np.arange(n) + 0.5) / n * 2 * np.pi
    earth_rate = np.stack(
        [matrix_from_rpy([0, 0, h]).T @ C_en.T @ earth.OMEGA_IE_E for h in headings]
    )
    stream = InertialStream(time, turning + earth_rate, np.tile([0, 0, -9.78], (n, 1)))
    rows = integrate(stream, NavState(stream.start, pos, np.zeros(3), C_en))
    quarter = C_en.T @ rows[249, 7:].reshape(3, 3)
    assert np.degrees(rpy_from_matrix(quarter)[2]) == pytest.approx(90.0, abs=1e-3)
    assert np.degrees(rotation_angle(rows[-1, 7:].reshape(3, 3), C_en)) < 1e-3


def test_bad_states_and_times_are_refused():
    pos = earth.lla_to_ecef(0.0, 0.0, 0.0)
    stream = InertialStream(np.arange(1.0, 5.0), np.zeros((4, 3)), np.zeros((4, 3)))
    state = NavState(2.0, pos, np.zeros(3), np.eye(3))
    with pytest.raises(DataError, match="pos_e"):
        NavState(0.0, np.array([np.nan, 0, 0]), np.zeros(3), np.eye(3))
    with pytest.raises(DataError, match="not inside the IMU data"):
        integrate(stream, dataclasses.replace(state, time=-5.0))
    with pytest.raises(DataError, match="not inside the IMU data"):
        integrate(stream, state, until=9.0)
