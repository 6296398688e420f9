"""The inertial form against the simulator's truth, which knows nothing of it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.alignment.in_motion.rows import (
    DopplerEpoch,
    antenna_velocity,
    inertial_doppler,
    inertial_rows,
    joined,
)
from certnav.alignment.in_motion.track import ImuParts, inertial_track
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.earth import gravity_e, lla_to_ecef
from certnav.filters.errors import AlignmentError, DataError
from certnav.filters.rotation import matrix_from_rotvec, skew
from certnav.filters.strapdown import InertialStream
from certnav.velocity.range_rate import doppler_rows


def exact_drive(lever):
    """A minute in traffic from cruising speed on, free of every error; antenna at `lever`."""
    config = SimulationConfig(
        seed=3, duration=60.0, noise=False, receiver_clock=False, atmosphere=False,
        moving_start=True, static_start=0.0, density="open", lever_antenna_b=lever,
    )  # fmt: skip
    simulation = simulate(config)
    imu, observations = simulation.imu, simulation.observations
    stream = InertialStream(imu.time, imu.gyro_b, imu.accel_b)
    pos_e = simulation.trajectory.pos_e(observations.time, lever)
    return simulation, stream, inertial_doppler(observations, pos_e)


def between(doppler, first, last):
    """The epochs first … last; gravitation in the axes of the first, 3 mrad off in 45 s."""
    here = (doppler.epoch >= first) & (doppler.epoch <= last)
    turn = 7.2921151467e-5 * (doppler.time[first] - doppler.time[0])
    to_first = matrix_from_rotvec([0.0, 0.0, -turn])
    columns = {
        name: getattr(doppler, name)[here]
        for name in ("source", "sat", "e_e", "z", "sigma", "z_by_pos")
    }
    dv = doppler.gravity_dv[first : last + 1] - doppler.gravity_dv[first]
    return dataclasses.replace(
        doppler, time=doppler.time[first : last + 1], pos_e=doppler.pos_e[first : last + 1],
        gravity_dv=dv @ to_first.T, epoch=doppler.epoch[here] - first, **columns,
    )  # fmt: skip


@pytest.fixture(scope="module")
def drive():
    return exact_drive((0.0, 0.0, 0.0))


def anchored(stream, time):
    """Integrals anchored at the last instant, as windows have them."""
    return ImuParts(stream).track(time, np.zeros(6))


def residuals(simulation, rows, vel_w):
    """Rows less e·(C_eb vel_w + v_e) of the truth at the anchor."""
    C_ew = simulation.trajectory.C_eb(rows.time[-1:])[0]
    vel_e = simulation.trajectory.vel_e(rows.time[-1:])[0]
    return rows.z - np.sum(rows.e_e * (vel_w @ C_ew.T + vel_e)[rows.epoch], axis=1)


@pytest.mark.parametrize(("first", "last"), [(0, 30), (12, 60)])
def test_identity_holds_wherever_the_window_is(drive, first, last):
    """Earth rotation, Coriolis, gravitation, light time: 1e-5 m/s over half a minute of traffic.

    7e-6 m/s of it are the simulator's, whose Doppler is a numerical derivative.
    """
    simulation, stream, doppler = drive
    doppler = between(doppler, first, last)
    vel_w = antenna_velocity(anchored(stream, doppler.time), np.zeros(3))
    assert np.abs(residuals(simulation, inertial_rows(doppler), vel_w)).max() < 1.2e-5
    # Not vacuous: gravity alone is 300 m/s of what cancels.
    assert np.abs(vel_w).max() > 100.0


def test_a_position_that_is_wrong_moves_rows_as_they_say_themselves():
    """By lines of sight and by gravitation, 0.2 m/s; what is left is of the vehicle's own speed."""
    simulation, stream, _ = exact_drive((0.0, 0.0, 0.0))
    off, observations = np.array([1500.0, -2000.0, 1800.0]), simulation.observations
    pos_e = simulation.trajectory.pos_e(observations.time)
    doppler = inertial_doppler(observations, pos_e + off, position_sigma=500.0)
    rows = inertial_rows(doppler)
    vel_w = antenna_velocity(anchored(stream, doppler.time), np.zeros(3))
    left = residuals(simulation, rows, vel_w)
    assert np.abs(left).max() > 0.3
    assert np.abs(left - rows.common @ off / 500.0).max() < 4e-3
    assert inertial_rows(dataclasses.replace(doppler, position_sigma=0.0)).common.shape[1] == 0


def test_epochs_joined_are_the_rows_of_all(drive):
    """One by one, as a receiver gives them, and from the recording."""
    simulation, _, doppler = drive
    observations = simulation.observations
    pos_e = simulation.trajectory.pos_e(observations.time)
    rows = doppler_rows(observations, pos_e)
    epochs = [
        DopplerEpoch(
            time, pos_e[here.start], rows.take((rows.row >= here.start) & (rows.row < here.stop))
        )
        for time, here in observations.epochs()
    ]
    together = joined(epochs)
    for name in ("time", "pos_e", "gravity_dv", "epoch", "source", "sat", "e_e", "z", "sigma"):
        np.testing.assert_array_equal(getattr(together, name), getattr(doppler, name))


def test_lever_arm_and_its_rotation():
    """2 m of lever arm, with gravitation taken at the antenna instead of the IMU.

    Its gradient, 3.1e-6 /s², makes 6e-6 m/s² of that; v_e differs by ω_ie × lever, 1.5e-4 m/s.
    """
    lever = (1.2, -0.7, -1.5)
    simulation, stream, doppler = exact_drive(lever)
    doppler = between(doppler, 30, doppler.time.size - 1)
    track, rows = anchored(stream, doppler.time), inertial_rows(doppler)
    with_lever = residuals(simulation, rows, antenna_velocity(track, np.array(lever)))
    without = residuals(simulation, rows, antenna_velocity(track, np.zeros(3)))
    assert np.abs(with_lever).max() < 30.0 * 6e-6 + 1.5e-4
    assert np.abs(without).max() > 0.1


def test_integrals_against_the_true_motion(drive):
    """Attitude and rate at instants between samples, too."""
    simulation, stream, _ = drive
    time = stream.start + np.array([5.0, 11.2347, 20.005, 33.33333])
    track = inertial_track(stream, time)
    truth = simulation.trajectory.kinematics(time)
    elapsed = time - time[0]
    to_first = matrix_from_rotvec(np.outer(elapsed, [0.0, 0.0, 7.2921151467e-5]))
    C_wb = truth.C_eb[0].T @ to_first @ truth.C_eb
    np.testing.assert_allclose(track.C_wb, C_wb, atol=1e-9)
    np.testing.assert_allclose(track.omega_b, truth.omega_ib_b, atol=1e-5)


def test_bias_and_scale_responses_are_derivatives(drive):
    _, stream, doppler = drive
    time, h = doppler.time[:31], 1e-7
    base = inertial_track(stream, time).part(0, 30)
    for axis in range(3):
        step = h * np.eye(3)[axis]
        plus = inertial_track(stream, time, step, np.zeros(3)).part(0, 30)
        minus = inertial_track(stream, time, -step, np.zeros(3)).part(0, 30)
        change = (plus.dv_w - minus.dv_w) / (2.0 * h)
        np.testing.assert_allclose(base.B[:, :, axis], change, rtol=1e-3, atol=0.5)
        turned = (plus.C_wb - minus.C_wb) / (2.0 * h)
        np.testing.assert_allclose(-skew(base.A[:, :, axis]) @ base.C_wb, turned, atol=2e-3)
        plus = inertial_track(stream, time, np.zeros(3), 1e3 * step).part(0, 30)
        np.testing.assert_allclose(-base.F[:, :, axis], (plus.dv_w - base.dv_w) / (1e3 * h),
                                   atol=2e-3)  # fmt: skip
        scaled = InertialStream(
            stream.edges[1:], stream.gyro * (1.0 - 1e-6 * np.eye(3)[axis]), stream.accel
        )
        scaled.edges[0] = stream.edges[0]
        change = (inertial_track(scaled, time).part(0, 30).dv_w - base.dv_w) / 1e-6
        np.testing.assert_allclose(base.B[:, :, 3 + axis], change, rtol=1e-3, atol=0.5)


@pytest.mark.parametrize("axis", range(3))
def test_integrals_in_closed_form_at_any_instant(axis):
    """Constant force along one axis, constant rate about it, samples of a second: quadratics."""
    f, w, start = 4.0, 0.3, 1000.0
    along = np.eye(3)[axis]
    stream = InertialStream(
        start + np.arange(1.0, 21.0), np.tile(w * along, (20, 1)), np.tile(f * along, (20, 1))
    )
    stream.edges[0] = start
    time = start + np.array([2.0, 2.3, 5.0, 7.9, 12.6])
    track, t = inertial_track(stream, time), time - time[0]
    np.testing.assert_allclose(track.C_wb, matrix_from_rotvec(np.outer(w * t, along)), atol=1e-12)
    np.testing.assert_allclose(track.dv_w, np.outer(f * t, along), atol=1e-12)
    np.testing.assert_allclose(track.omega_b, np.tile(w * along, (5, 1)), atol=1e-12)
    # About its own axis: the time itself for the bias, the angle for the scale factor.
    np.testing.assert_allclose(track.A[:, axis, axis], t, atol=1e-12)
    np.testing.assert_allclose(track.A[:, axis, 3 + axis], w * t, atol=1e-12)
    np.testing.assert_allclose(track.F[:, axis, axis], t, atol=1e-12)
    np.testing.assert_allclose(track.F[:, axis, 3 + axis], f * t, atol=1e-12)
    # Across it, without a rate: ½ f t² of Δv for a bias, anchored at the first instant.
    still = InertialStream(stream.edges[1:], 0.0 * stream.gyro, stream.accel)
    still.edges[0] = start
    B = inertial_track(still, time).B
    expected = 0.5 * t[:, None, None] ** 2 * skew(f * along)
    np.testing.assert_allclose(B[:, :, :3], expected, atol=1e-10)


def test_parts_of_a_bias_add_up_to_the_whole(drive):
    _, stream, doppler = drive
    base = anchored(stream, doppler.time[:31])
    response = base.responses([0, 7, 12, 20, 30])
    assert response.shape == (31, 3, 12 + 4 * 3)
    whole = response[:, :, 12:].reshape(31, 3, 4, 3).sum(axis=2)
    np.testing.assert_allclose(whole, base.B[:, :, :3], atol=1e-7)
    for at, expected in ((0, base.B[:, :, :3]), (3, -base.F[:, :, :3]), (6, base.B[:, :, 3:]),
                         (9, -base.F[:, :, 3:])):  # fmt: skip
        np.testing.assert_array_equal(response[:, :, at : at + 3], expected)


def test_response_to_a_bias_over_part_of_the_window(drive):
    """A rate that is wrong for eight seconds only, against integrating it."""
    _, stream, doppler = drive
    time = doppler.time[:31]
    base = anchored(stream, time)
    delta = np.array([2e-6, -1e-6, 3e-6])
    inside = (stream.edges[1:] > time[9] + 1e-6) & (stream.edges[1:] < time[17] + 1e-6)
    wrong = InertialStream(stream.edges[1:], stream.gyro - np.outer(inside, delta), stream.accel)
    wrong.edges[0] = stream.edges[0]
    off = anchored(wrong, time).dv_w - base.dv_w
    change = base.responses([0, 9, 17, 30])[:, :, 15:18]
    np.testing.assert_allclose(change @ delta, off, atol=2e-3 * np.abs(off).max())
    assert np.abs(off[:9]).max() > 1e-4 and np.abs(change[17:]).max() == 0.0


def test_responses_are_those_of_the_last_instant(drive):
    _, stream, doppler = drive
    with pytest.raises(ValueError, match="the last instant"):
        inertial_track(stream, doppler.time[:5]).responses([0, 4])


def test_standing_on_the_turning_earth():
    """No motion: z is the same for all satellites, and Δv_w is what the Earth's surface makes."""
    pos = lla_to_ecef(0.7, -1.1, 50.0)
    time = 5e8 + np.arange(1, 3001) * 0.01
    rate = np.array([0.0, 0.0, 7.2921151467e-5])  # body axes: ECEF's own
    stream = InertialStream(time, np.tile(rate, (3000, 1)), np.tile(-gravity_e(pos), (3000, 1)))
    track = inertial_track(stream, 5e8 + np.arange(0.0, 31.0, 5.0))
    angle = 7.2921151467e-5 * 30.0
    np.testing.assert_allclose(track.C_wb[-1], matrix_from_rotvec([0.0, 0.0, angle]), atol=1e-13)
    g = -gravity_e(pos)
    closed = np.array([
        (g[0] * np.sin(angle) - g[1] * (1.0 - np.cos(angle))) / rate[2],
        (g[1] * np.sin(angle) + g[0] * (1.0 - np.cos(angle))) / rate[2],
        30.0 * g[2],
    ])  # fmt: skip
    np.testing.assert_allclose(track.dv_w[-1], closed, atol=1e-8)


def test_epochs_too_close_are_left_out(drive):
    simulation, _, doppler = drive
    observations = simulation.observations
    pos_e = simulation.trajectory.pos_e(observations.time)
    thinned = inertial_doppler(observations, pos_e, interval=2.0)
    np.testing.assert_allclose(thinned.time, doppler.time[::2])
    assert np.all(np.isin(thinned.source, doppler.source))
    np.testing.assert_array_equal(observations.time[thinned.source], thinned.time[thinned.epoch])


def test_outside_the_imu_data_is_refused(drive):
    _, stream, _ = drive
    with pytest.raises(AlignmentError, match="do not cover the window"):
        inertial_track(stream, [stream.end - 1.0, stream.end + 1.0])
    with pytest.raises(DataError, match="ascending"):
        inertial_track(stream, [stream.start + 2.0, stream.start + 1.0])
