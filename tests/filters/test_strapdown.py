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


# --- the samples -----------------------------------------------------------------------------


def samples(n=5, dt=0.01, start=100.0):
    rng = np.random.default_rng(3)
    time = start + dt * np.arange(1, n + 1)
    return time, rng.standard_normal((n, 3)), rng.standard_normal((n, 3))


def test_a_stream_begins_an_interval_before_its_first_sample():
    time, gyro, accel = samples()
    stream = InertialStream(time, gyro, accel)
    assert stream.start == pytest.approx(100.0, abs=1e-9) and stream.end == time[-1]
    assert len(stream) == 5 and stream.interval == pytest.approx(0.01)
    np.testing.assert_allclose(stream.edges, [100.0, *time], atol=1e-9)


def test_a_sample_holds_its_interval_from_the_beginning_on():
    time, gyro, accel = samples()
    stream = InertialStream(time, gyro, accel)
    assert [stream.index(100.0 + s) for s in (0.0, 0.004, 0.0099)] == [0, 0, 0]
    assert [stream.index(t) for t in time] == [1, 2, 3, 4, 5]
    assert stream.index(50.0) == 0 and stream.index(200.0) == 5
    assert stream.index(time[1] - 1e-10) == 2  # rounding is no time


def test_edges_may_be_given_and_leave_gaps_nothing_to_guess():
    time, gyro, accel = samples()
    edges = [99.97, *time]
    stream = InertialStream.of_edges(edges, gyro.tolist(), accel.tolist())
    np.testing.assert_array_equal(stream.edges, edges)
    np.testing.assert_array_equal(stream.gyro, gyro)
    np.testing.assert_array_equal(stream.accel, accel)
    assert stream.start == 99.97 and len(stream) == 5
    assert stream.interval == pytest.approx(0.01)


def test_a_live_stream_becomes_the_recorded_one():
    """Sample by sample, beyond the room it was made with; nothing is in it before."""
    time, gyro, accel = samples(2500)
    live = InertialStream.live(0.01)
    assert len(live) == 0 and live.gyro.shape == live.accel.shape == (0, 3)
    for sample in zip(time, gyro, accel, strict=True):
        live.append(*sample)
    recorded = InertialStream(time, gyro, accel)
    np.testing.assert_allclose(live.edges, recorded.edges, rtol=0.0, atol=1e-9)
    np.testing.assert_array_equal(live.gyro, gyro)
    np.testing.assert_array_equal(live.accel, accel)
    assert len(live) == 2500 and live.end == time[-1] and live.interval == 0.01


def test_a_live_stream_refuses_what_a_recording_would_be_refused_for():
    live = InertialStream.live(0.01)
    live.append(100.0, [0, 0, 0], [0, 0, -9.8])
    for time in (100.0, 99.0):
        with pytest.raises(DataError, match="goes backwards"):
            live.append(time, [0, 0, 0], [0, 0, -9.8])
    with pytest.raises(DataError, match="six finite values"):
        live.append(100.01, [0, np.nan, 0], [0, 0, -9.8])
    with pytest.raises(DataError, match="six finite values"):
        live.append(100.01, [0, 0], [0, 0, -9.8])
    assert len(live) == 1 and live.end == 100.0
    np.testing.assert_array_equal(live.edges, [99.99, 100.0])


def test_free_inertial_rows_are_one_a_sample_and_end_where_told(city_drive):
    stream, state = exact_stream(city_drive, 100.0, 2.0)
    rows = integrate(stream, state)
    np.testing.assert_array_equal(rows[:, 0], stream.edges[1:])
    assert rows.shape == (200, 16)
    half = integrate(stream, state, state.time + 1.0)
    assert half.shape == (100, 16)
    np.testing.assert_array_equal(half, rows[:100])
    late = NavState(stream.edges[50], rows[49, 1:4], rows[49, 4:7], rows[49, 7:].reshape(3, 3))
    assert integrate(stream, late).shape == (150, 16)


def test_samples_are_read_only_whoever_holds_them():
    """Kernels are compiled for that: a live stream that were not would have them compiled again."""
    live = InertialStream.live(0.01)
    live.append(1.0, np.zeros(3), np.zeros(3))
    ready = InertialStream([1.0, 2.0], np.zeros((2, 3)), np.zeros((2, 3)))
    assert not any(a.flags.writeable for s in (live, ready) for a in (s.gyro, s.accel))
    live.append(2.0, np.ones(3), np.ones(3))
    assert live.gyro[1, 0] == 1.0
