"""Nose or tail first: turns and changes of speed tell, a straight road does not."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.alignment.direction import course_fit, log_odds
from certnav.alignment.levelling import VelocityTrack, level_and_course
from certnav.filters.earth import OMEGA_IE_E, C_en_of, gravity_e, lla_to_ecef
from certnav.filters.errors import AlignmentError
from certnav.filters.sensors import imu_preset
from certnav.filters.strapdown import InertialStream

SPEC = imu_preset("adis16470")
PLACE = lla_to_ecef(*np.radians([48.0, 11.0]), 500.0)
C_EN = C_en_of(PLACE)


def made(speed, turn, heading_of_nose=0.0, sigma=0.05, seed=0, duration=40.0):
    """A car on level ground with ``speed(t)`` [m/s] along its course, which turns at ``turn(t)``.

    The nose lies `heading_of_nose` [rad] beside the course.
    """
    t = np.arange(0.0, duration, 0.01) + 0.01
    rate = np.array([turn(x) for x in t])
    v = np.array([speed(x) for x in t])
    course = 0.3 + np.cumsum(rate) * 0.01
    vel_n = np.column_stack([v * np.cos(course), v * np.sin(course), np.zeros_like(t)])
    accel_n = np.gradient(vel_n, t, axis=0)
    nose = course + heading_of_nose
    force_n = accel_n - (C_EN.T @ gravity_e(PLACE))
    c, s = np.cos(nose), np.sin(nose)
    accel_b = np.column_stack([
        c * force_n[:, 0] + s * force_n[:, 1], -s * force_n[:, 0] + c * force_n[:, 1], force_n[:, 2]
    ])  # fmt: skip
    earth_n = C_EN.T @ OMEGA_IE_E
    gyro_b = np.column_stack([
        c * earth_n[0] + s * earth_n[1], -s * earth_n[0] + c * earth_n[1], rate + earth_n[2]
    ])  # fmt: skip
    rng = np.random.default_rng(seed)
    accel_b += rng.normal(0.0, SPEC.accel_noise_density * 10.0, accel_b.shape)
    accel_b += np.array([0.03, -0.05, 0.02])  # a bias, or a level that is off by 5 mg
    at = np.arange(99, t.size, 100)
    vel_e = (vel_n[at] + rng.normal(0.0, sigma, (at.size, 3))) @ C_EN.T
    track = VelocityTrack(t[at], vel_e, np.full(at.size, sigma), np.tile(PLACE, (at.size, 1)))
    return InertialStream(t, gyro_b, accel_b), track


def both(stream, track):
    return [level_and_course(stream, track, np.eye(3), SPEC, backwards=b) for b in (False, True)]


def odds(stream, track):
    return log_odds(stream, track, *both(stream, track))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("beside", "sign"), [(0.0, 1.0), (np.pi, -1.0)])
def test_a_turn_tells(seed, beside, sign):
    found = odds(
        *made(lambda t: 5.0, lambda t: 0.15 if 15.0 < t < 25.0 else 0.0, beside, seed=seed)
    )
    assert sign * found > 12.0


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("beside", "sign"), [(0.0, 1.0), (np.pi, -1.0)])
def test_a_change_of_speed_tells(seed, beside, sign):
    found = odds(*made(lambda t: 5.0 + 3.0 * np.sin(0.5 * t), lambda t: 0.0, beside, seed=seed))
    assert sign * found > 12.0


@pytest.mark.parametrize("seed", range(20))
def test_a_straight_road_at_constant_speed_does_not(seed):
    for beside in (0.0, np.pi):
        assert abs(odds(*made(lambda t: 12.0, lambda t: 0.0, beside, seed=seed))) < 6.9


def test_two_velocities_say_nothing():
    stream, track = made(lambda t: 5.0, lambda t: 0.2, duration=12.0)
    few = VelocityTrack(track.time[-2:], track.vel_e[-2:], track.sigma[-2:], track.pos_e[-2:])
    ways = [
        level_and_course(stream, track, np.eye(3), SPEC, backwards=way) for way in (False, True)
    ]
    assert log_odds(stream, few, *ways) == 0.0


def test_one_wild_velocity_among_creeping_ones_makes_no_heading():
    """3.5 m/s once, 1 m/s before and after it: less than 0.6 of the speed asked for."""
    stream, track = made(lambda t: 1.0, lambda t: 0.0)
    vel_e = track.vel_e.copy()
    vel_e[20] *= 3.5 / np.linalg.norm(vel_e[20])
    wild = VelocityTrack(track.time, vel_e, track.sigma, track.pos_e)
    with pytest.raises(AlignmentError, match="never reaches"):
        level_and_course(stream, wild, np.eye(3), SPEC)
    vel_e[21] *= 1.9 / np.linalg.norm(vel_e[21])
    assert level_and_course(stream, wild, np.eye(3), SPEC).time == track.time[20]


def setting_off(seed, wrong_until=0.0, turn_deg=90.0, grows=1.0):
    """15 s at rest, then 2 m/s² for eight seconds; velocities up to a time are of other motion."""
    stream, track = made(lambda t: 2.0 * min(max(t - 15.0, 0.0), 8.0), lambda t: 0.0, seed=seed)
    wrong = track.time < wrong_until
    turn = np.eye(3)
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    turn[:2, :2] = [[c, -s], [s, c]]
    vel_e = np.where(wrong[:, None], grows * (track.vel_e @ C_EN @ turn.T @ C_EN.T), track.vel_e)
    return stream, VelocityTrack(track.time, vel_e, track.sigma, track.pos_e)


def until(track, time):
    k = track.time < time
    return VelocityTrack(track.time[k], track.vel_e[k], track.sigma[k], track.pos_e[k])


@pytest.mark.parametrize("seed", range(5))
def test_a_course_is_borne_out_by_velocities_of_other_seconds(seed):
    stream, track = setting_off(seed)
    early, late = until(track, 19.5), until(track, 30.0)
    for part, borne_out in ((early, False), (late, True)):
        attitude = level_and_course(stream, part, np.eye(3), SPEC)
        fit = course_fit(stream, part, attitude)
        assert attitude.time < 19.0 and not fit.against and fit.borne_out == borne_out


@pytest.mark.parametrize("seed", range(5))
def test_velocities_of_another_motion_bear_each_other_out_and_nothing_else(seed):
    """From rest any velocities have the course that the accelerations have with them."""
    stream, track = setting_off(seed, wrong_until=18.5)
    early, late = until(track, 19.0), until(track, 30.0)
    attitude = level_and_course(stream, early, np.eye(3), SPEC)
    assert not course_fit(stream, early, attitude).borne_out
    assert "beside the course" in course_fit(stream, late, attitude).against


def test_velocities_that_change_by_more_than_is_felt_are_none_to_start_from():
    stream, track = setting_off(1, wrong_until=40.0, turn_deg=0.0, grows=2.5)
    attitude = level_and_course(stream, track, np.eye(3), SPEC)
    assert "2.5 times as much" in course_fit(stream, track, attitude).against
