"""Local velocity against the truth of a simulated car."""

import numpy as np
import pytest

from certnav.alignment.local_velocity import inertial_track, planar_track, rate_at_rest
from certnav.datasets.gpstime import from_week_sow
from certnav.datasets.simulation.streets import RouteConfig, drive
from certnav.datasets.simulation.trajectory import Trajectory
from certnav.filters.errors import AlignmentError
from certnav.filters.rotation import matrix_from_rpy
from certnav.filters.strapdown import InertialStream

MOUNT = matrix_from_rpy(np.radians([3.0, -2.0, 40.0])).T
LEVER_V = np.array([1.1, 0.2, -1.3])


@pytest.fixture(scope="module")
def car():
    points = drive(RouteConfig(duration=280.0, static_start=10.0), np.random.default_rng(8))
    return Trajectory(
        from_week_sow(2200, 500.0), points.time, points.pos_t, points.rpy, (0.8, 0.2, 100.0),
        C_bv=MOUNT,
    )  # fmt: skip


def truth(car, time, start):
    """Velocity of the point at LEVER_V, in the vehicle's axes at `start`."""
    lever_b = car.lever_vehicle_b + MOUNT @ LEVER_V
    C_ev = car.kinematics(np.array([start])).C_eb[0] @ MOUNT
    return car.kinematics(time, lever_b).vel_e @ C_ev


def odometer(car, time):
    """Speed of the rear axle along the nose, and yaw rate about the vehicle's down axis."""
    k = car.kinematics(time, car.lever_vehicle_b)
    C_ev = k.C_eb @ MOUNT
    return np.einsum("ni,ni->n", k.vel_e, C_ev[:, :, 0]), (k.omega_eb_b @ MOUNT)[:, 2]


def windows(car):
    """Windows that hold a turn and ones that do not."""
    begin = car.span[0] + 20.0
    return [(begin + s, begin + s + 15.0) for s in np.arange(0.0, 225.0, 15.0)]


def test_gyros_and_odometer_give_the_velocity_on_hills(car):
    time = car.span[0] + np.arange(5.0, 270.0, 0.01)
    stream = InertialStream(time, *car.imu_means(time))
    speed, _ = odometer(car, time)
    turned = 0.0
    for start, end in windows(car):
        track = inertial_track(stream, time, speed, start, end, MOUNT, lever_v=LEVER_V)
        at = np.linspace(start, end, 40)
        error = track.velocity_at(at) - truth(car, at, start)
        # What is left out is the Earth's rate: 7.3e-5 rad/s · 15 s · 15 m/s = 16 mm/s.
        assert np.abs(error).max() < 0.03
        turned = max(turned, np.abs(track.C_wv[-1] - np.eye(3)).max())
    assert turned > 0.5


def test_planar_track_is_right_on_the_level_part_of_the_motion(car):
    time = car.span[0] + np.arange(5.0, 270.0, 0.02)
    speed, yaw_rate = odometer(car, time)
    for start, end in windows(car):
        track = planar_track(time, speed, yaw_rate, start, end, LEVER_V)
        at = np.linspace(start, end, 40)
        error = track.velocity_at(at) - truth(car, at, start)
        # Grade and body roll are what a plane cannot know: a few degrees of 15 m/s.
        assert np.abs(error[:, :2]).max() < 0.35
        assert np.abs(error[:, 2]).max() < 1.5
        np.testing.assert_allclose(track.vel_w[:, 2], 0.0, atol=1e-12)


def test_a_circle_in_closed_form():
    """5 m/s at 0.5 rad/s to the right: the velocity turns with the heading."""
    time = np.arange(0.0, 20.0, 0.01)
    track = planar_track(time, np.full_like(time, 5.0), np.full_like(time, 0.5), 2.0, 10.0)
    angle = 0.5 * (track.time - 2.0)
    expected = 5.0 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    np.testing.assert_allclose(track.vel_w, expected, atol=1e-9)
    np.testing.assert_allclose(track.C_wv[0], np.eye(3))
    assert np.isnan(track.velocity_at([1.9, 10.1])).all()


def test_windows_that_are_not_covered_are_refused():
    time = np.arange(0.0, 10.0, 0.1)
    with pytest.raises(AlignmentError, match="odometer does not cover the window"):
        planar_track(time, time, time, 5.0, 20.0)
    with pytest.raises(AlignmentError, match="is not before"):
        planar_track(time, time, time, 5.0, 5.0)
    stream = InertialStream(np.arange(0.0, 3.0, 0.1), np.zeros((30, 3)), np.zeros((30, 3)))
    with pytest.raises(AlignmentError, match="IMU does not cover"):
        inertial_track(stream, time, time, 1.0, 9.0, np.eye(3))


def test_gyros_show_their_bias_while_the_wheels_stand():
    """The last standstill that is long enough and over by then; without one nothing is known."""
    edges = np.arange(0.0, 60.0, 0.01)
    still = ((edges > 5.0) & (edges < 10.0)) | ((edges > 30.0) & (edges < 36.0))
    short = (edges > 45.0) & (edges < 46.0)
    bias = np.where(edges[:, None] < 20.0, [0.01, 0.0, -0.02], [0.03, 0.0, 0.02])
    gyro = bias + np.where((still | short)[:, None], 0.0, [0.0, 0.0, 0.4])
    stream = InertialStream(edges, gyro, np.zeros_like(gyro))
    time = np.arange(0.0, 60.0, 0.1)
    stands = ((time > 5.0) & (time < 10.0)) | ((time > 30.0) & (time < 36.0))
    speed = np.where(stands | ((time > 45.0) & (time < 46.0)), 0.0, 9.0)
    for until, expected in ((60.0, bias[-1]), (25.0, bias[0]), (4.0, np.zeros(3))):
        np.testing.assert_allclose(rate_at_rest(stream, time, speed, until), expected, atol=1e-12)
    np.testing.assert_array_equal(rate_at_rest(stream, time, speed + 1.0, 60.0), np.zeros(3))


def test_the_way_is_the_integral_of_the_velocity(car):
    """From the truth's positions; unknown outside the window."""
    start = car.span[0] + 120.0
    time = start + np.arange(0.0, 20.0, 0.02)
    speed, yaw_rate = odometer(car, time)
    track = planar_track(time, speed, yaw_rate, start, time[-1], LEVER_V)
    moved = track.moved_at(time[[0, -1]])
    np.testing.assert_array_equal(moved[0], np.zeros(3))
    lever_b = car.lever_vehicle_b + MOUNT @ LEVER_V
    ends = car.pos_e(time[[0, -1]], lever_b)
    assert np.linalg.norm(moved[1]) == pytest.approx(np.linalg.norm(ends[1] - ends[0]), rel=5e-3)
    assert np.isnan(track.moved_at([start - 1.0])).all()
