"""Levelling and course: exact where they must be, honest where they cannot."""

import dataclasses

import numpy as np
import pytest

from certnav.alignment.direction import log_odds
from certnav.alignment.levelling import VelocityTrack, given_attitude, level_and_course
from certnav.datasets.gpstime import from_week_sow
from certnav.datasets.simulation.sensors import imu_measurements
from certnav.datasets.simulation.streets import RouteConfig, drive
from certnav.datasets.simulation.trajectory import Trajectory
from certnav.filters.earth import OMEGA_IE_E, C_en_of, gravity_e, lla_to_ecef
from certnav.filters.errors import AlignmentError
from certnav.filters.rotation import matrix_from_rpy, rpy_from_matrix
from certnav.filters.sensors import imu_preset
from certnav.filters.strapdown import InertialStream

SPEC = imu_preset("adis16470")
ORIGIN = (np.radians(48.0), np.radians(9.0), 300.0)


def make_drive(seed=3, mounting_deg=(0.0, 0.0, 0.0), **route):
    points = drive(RouteConfig(duration=120.0, **route), np.random.default_rng(seed))
    return Trajectory(
        from_week_sow(2300, 1000.0), points.time, points.pos_t, points.rpy, ORIGIN,
        C_bv=matrix_from_rpy(np.radians(mounting_deg)).T,
    )  # fmt: skip


def sensors(trajectory, noise=False, seed=0, sigma=0.05, rate=100.0, duration=100.0):
    """IMU stream and GNSS velocities of a drive."""
    rng = np.random.default_rng(seed)
    start = trajectory.span[0] + 0.5
    time = start + np.arange(1, int(duration * rate)) / rate
    imu, gyro_bias, _ = imu_measurements(trajectory, time, SPEC, rng, noise=noise)
    epochs = start + np.arange(1.0, duration - 1.0)
    k = trajectory.kinematics(epochs)
    error = sigma * rng.standard_normal(k.vel_e.shape) if noise else 0.0
    track = VelocityTrack(epochs, k.vel_e + error, np.full(epochs.size, sigma), k.pos_e)
    return InertialStream(imu.time, imu.gyro_b, imu.accel_b), track, gyro_bias


def attitude_error_deg(result, trajectory):
    """Roll, pitch and heading error of an alignment [deg]."""
    k = trajectory.kinematics(np.array([result.time]))
    C_en = C_en_of(k.pos_e[0])
    found, true = rpy_from_matrix(C_en.T @ result.C_eb), rpy_from_matrix(C_en.T @ k.C_eb[0])
    return np.degrees((found - true + np.pi) % (2 * np.pi) - np.pi)


@pytest.mark.parametrize("mounting", [(0.0, 0.0, 0.0), (2.0, -3.0, 5.0), (1.0, 2.0, -95.0)])
def test_exact_data_give_the_attitude(mounting):
    """Standstill first, no noise: level and heading to the slip of course against nose."""
    trajectory = make_drive(mounting_deg=mounting, static_start=20.0)
    stream, track, _ = sensors(trajectory)
    result = level_and_course(stream, track, trajectory.C_bv, SPEC)
    assert "at rest" in result.message
    # The road may rise or bank at the parking place, and h is levelled there: 0.02°.
    assert np.abs(attitude_error_deg(result, trajectory)).max() < 0.05


def test_gyro_bias_is_taken_from_the_standstill():
    trajectory = make_drive(static_start=25.0)
    stream, track, bias = sensors(trajectory, noise=True, seed=4)
    result = level_and_course(stream, track, trajectory.C_bv, SPEC)
    error = np.abs(result.gyro_bias - bias[0])
    assert result.sigma_gyro_bias is not None
    assert error.max() < 4.0 * result.sigma_gyro_bias
    assert result.sigma_gyro_bias < 0.1 * SPEC.gyro_bias_initial_sigma


def test_moving_start_levels_against_gnss_acceleration():
    trajectory = make_drive(seed=7, moving_start=True, static_start=0.0)
    stream, track, _ = sensors(trajectory)
    result = level_and_course(stream, track, trajectory.C_bv, SPEC)
    assert "in motion" in result.message
    assert result.sigma_gyro_bias is None
    assert np.abs(attitude_error_deg(result, trajectory)).max() < 1.0


def test_errors_agree_with_the_covariance():
    """With sensor and GNSS noise, errors over 40 seeds stay within the σ that is claimed."""
    trajectory = make_drive(static_start=20.0)
    normalised = []
    for seed in range(40):
        stream, track, _ = sensors(trajectory, noise=True, seed=seed, duration=60.0)
        result = level_and_course(stream, track, trajectory.C_bv, SPEC)
        C_en = C_en_of(track.pos_e[0])
        sigma = np.degrees(np.sqrt(np.diag(C_en.T @ result.cov_e @ C_en)))
        normalised.append(attitude_error_deg(result, trajectory) / sigma[[0, 1, 2]])
    rms = np.sqrt(np.mean(np.square(normalised), axis=0))
    assert np.all(rms < 1.3), rms  # claimed σ is not optimistic …
    assert np.all(rms[:2] > 0.4), rms  # … nor, for the tilt, meaningless


def test_reversing_out_is_not_taken_for_driving_forward():
    """A car that backs out of its place: the course points over the boot, the heading does not."""
    forward = make_drive(static_start=20.0)
    stream, track, _ = sensors(forward, duration=40.0)
    # Play the drive with the IMU mounted backwards while the mounting says forwards.
    flip = np.diag([-1.0, -1.0, 1.0])
    turned = InertialStream(stream.edges[1:], stream.gyro @ flip, stream.accel @ flip)
    ways = [
        level_and_course(turned, track, np.eye(3), SPEC, backwards=way) for way in (False, True)
    ]
    assert log_odds(turned, track, *ways) < -10.0
    result = ways[1]
    error = attitude_error_deg(result, forward)
    assert abs(abs(error[2]) - 180.0) < 1.0


def silent_until(track, time):
    keep = track.time > time
    return VelocityTrack(
        track.time[keep], track.vel_e[keep], track.sigma[keep], track.pos_e[keep]
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(4))
def test_a_short_standstill_before_gnss_speaks_counts(seed):
    """5 s, of which no velocity tells: the speed after it is what the accelerometers added."""
    trajectory = make_drive(seed=seed, static_start=5.0)
    stream, track, bias = sensors(trajectory, noise=True, seed=seed, duration=40.0)
    moves = track.time[np.argmax(np.linalg.norm(track.vel_e, axis=1) > 0.5)]
    result = level_and_course(stream, silent_until(track, moves + 2.0), np.eye(3), SPEC)
    assert "at rest" in result.message
    assert np.abs(result.gyro_bias - bias[0]).max() < 4.0 * result.sigma_gyro_bias


def cruise(speed, turn_rate=0.0, duration=40.0, seed=0):
    """IMU of a car at a constant speed on level ground, in a bend of a constant rate [rad/s]."""
    rng, rate = np.random.default_rng(seed), 100.0
    time = from_week_sow(2300, 1000.0) + np.arange(1, int(duration * rate)) / rate
    gyro = np.tile([0.0, 0.0, turn_rate], (time.size, 1))
    accel = np.tile([0.0, speed * turn_rate, -9.81], (time.size, 1))
    gyro += SPEC.gyro_noise_density * np.sqrt(rate) * rng.standard_normal(gyro.shape)
    accel += SPEC.accel_noise_density * np.sqrt(rate) * rng.standard_normal(accel.shape)
    stream = InertialStream(time, gyro, accel)
    epochs = time[0] + np.arange(20.0, duration - 1.0)
    pos_e = lla_to_ecef(0.8, 0.1, 100.0)
    angle = turn_rate * (epochs - time[0])
    vel_n = speed * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(epochs.size)])
    n = epochs.size
    return stream, VelocityTrack(
        epochs, vel_n @ C_en_of(pos_e).T, np.full(n, 0.05), np.tile(pos_e, (n, 1))
    )  # fmt: skip


def pulling_away(acceleration, rest=0.0, speed=0.0, silent=0.0, sigma=0.05, duration=14.0):
    """A car heading north that speeds up steadily on level ground, after a rest if it has one.

    GNSS is silent for so long from the moment it moves off.
    """
    rng, rate, pos_e = np.random.default_rng(1), 100.0, lla_to_ecef(0.8, 0.1, 100.0)
    start = from_week_sow(2300, 1000.0)
    time = start + np.arange(1, int((rest + duration) * rate)) / rate
    moving = time > start + rest + 1e-6
    down = float(np.linalg.norm(gravity_e(pos_e)))
    accel = np.column_stack([acceleration * moving, 0.0 * time, np.full(time.size, -down)])
    gyro = np.tile(C_en_of(pos_e).T @ OMEGA_IE_E, (time.size, 1))
    accel += SPEC.accel_noise_density * np.sqrt(rate) * rng.standard_normal(accel.shape)
    epochs = start + np.arange(np.ceil(rest + silent) + 1.0, rest + duration - 1.0)
    ahead = speed + acceleration * (epochs - start - rest)
    n = epochs.size
    return InertialStream(time, gyro, accel), VelocityTrack(
        epochs, np.outer(ahead, C_en_of(pos_e)[:, 0]), np.full(n, sigma), np.tile(pos_e, (n, 1))
    )  # fmt: skip


@pytest.mark.parametrize("acceleration", [3.0, -3.0])
def test_speeding_up_is_not_taken_for_a_slope(acceleration):
    """3 m/s² look like 17° of pitch to the accelerometers; GNSS says what they are."""
    stream, track = pulling_away(acceleration, speed=50.0)
    result = level_and_course(stream, track, np.eye(3), SPEC)
    assert "in motion" in result.message
    roll, pitch, heading = rpy_from_matrix(C_en_of(track.pos_e[0]).T @ result.C_eb)
    # Gravity lies up to 0.1° off the vertical of the ellipsoid's normal at 100 m; noise is less.
    assert np.abs(np.degrees([roll, pitch])).max() < 0.15
    assert abs(np.degrees(heading)) < 0.01


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sensor", ["gyro", "accel"])
def test_a_standstill_ends_where_any_axis_shows_something_else(sensor, axis):
    """Quiet within every second, and another rate or force from the middle of the rest on."""
    stream, track = pulling_away(2.0, rest=12.0)
    assert "over 12 s at rest" in level_and_course(stream, track, np.eye(3), SPEC).message
    changed = getattr(stream, sensor).copy()
    changed[: len(changed) * 6 // 26, axis] += {"gyro": np.radians(0.6), "accel": 0.4}[sensor]
    measured = {"gyro": stream.gyro, "accel": stream.accel, sensor: changed}
    stream = InertialStream(stream.edges[1:], measured["gyro"], measured["accel"])
    result = level_and_course(stream, track, np.eye(3), SPEC)
    assert "over 6 s at rest" in result.message


@pytest.mark.parametrize(("sigma", "believed"), [(0.05, True), (0.6, True), (1.0, False)])
def test_a_vague_first_velocity_cannot_tell_of_a_standstill(sigma, believed):
    """After 5 s at rest and 3 s at 2 m/s²: 6 m/s ± 3σ are told from nothing, or they are not."""
    stream, track = pulling_away(2.0, rest=5.0, silent=2.0, sigma=sigma)
    result = level_and_course(stream, track, np.eye(3), SPEC)
    assert ("at rest" in result.message) == believed


@pytest.mark.parametrize(("speed", "turn_rate"), [(30.0, 0.0), (30.0, 0.03), (8.0, 0.0)])
def test_steady_driving_is_no_standstill(speed, turn_rate):
    """Twenty quiet seconds on a motorway, or in its bends, before GNSS speaks."""
    stream, track = cruise(speed, turn_rate)
    result = level_and_course(stream, track, np.eye(3), SPEC)
    assert "in motion" in result.message
    assert result.sigma_gyro_bias is None
    np.testing.assert_array_equal(result.gyro_bias, 0.0)


@pytest.mark.parametrize("turn_rate", [0.3, -0.3])
def test_a_bend_is_not_taken_for_a_bank(turn_rate):
    """3 m/s² across look like 17° of roll; over half a circle the gyros tell whose they are."""
    stream, track = cruise(10.0, turn_rate)
    result = level_and_course(stream, track, np.eye(3), SPEC)
    assert "in motion" in result.message
    roll, pitch, heading = rpy_from_matrix(C_en_of(track.pos_e[0]).T @ result.C_eb)
    assert np.abs(np.degrees([roll, pitch])).max() < 0.5
    course = turn_rate * (result.time - stream.edges[1])
    assert abs((heading - course + np.pi) % (2.0 * np.pi) - np.pi) < np.radians(0.1)


def test_a_standstill_that_gnss_sees_counts():
    """The same quiet IMU, and velocities of zero: at rest until it drives off."""
    stream, track = cruise(0.0)
    vel_e = track.vel_e.copy()
    vel_e[-3:] += 5.0 * C_en_of(track.pos_e[0])[:, 0]
    result = level_and_course(
        stream, dataclasses.replace(track, vel_e=vel_e), np.eye(3), SPEC
    )  # fmt: skip
    assert "at rest" in result.message


def test_no_heading_without_motion():
    trajectory = make_drive(static_start=90.0)
    stream, track, _ = sensors(trajectory, duration=60.0)
    with pytest.raises(AlignmentError, match=r"never reaches 3.0 m/s.*alignment.heading_deg"):
        level_and_course(stream, track, trajectory.C_bv, SPEC)


def test_no_overlap_is_said():
    trajectory = make_drive()
    stream, track, _ = sensors(trajectory)
    later = dataclasses.replace(track, time=track.time + 1e4)
    with pytest.raises(AlignmentError, match="no GNSS velocity within the IMU data"):
        level_and_course(stream, later, np.eye(3), SPEC)


def test_given_attitude():
    trajectory = make_drive()
    pos_e = trajectory.pos_e(np.array([trajectory.span[0] + 1.0]))[0]
    rpy = np.array([0.01, -0.02, 2.0])
    result = given_attitude(5.0, pos_e, rpy, 0.01, 0.05)
    C_en = C_en_of(pos_e)
    np.testing.assert_allclose(rpy_from_matrix(C_en.T @ result.C_eb), rpy, atol=1e-12)
    variances = [1e-4, 1e-4, 25e-4]
    np.testing.assert_allclose(C_en.T @ result.cov_e @ C_en, np.diag(variances), atol=1e-12)
