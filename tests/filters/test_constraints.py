"""Vehicle constraints: Jacobians by central differences, and truth on a simulated drive."""

import numpy as np
import pytest

from certnav.filters import constraints
from certnav.filters.earth import OMEGA_IE_E, gravity_e
from certnav.filters.error_model import ACCEL_BIAS, GYRO_BIAS, ErrorModel
from certnav.filters.levers import VehiclePoint, VehiclePrior, VehicleStates
from certnav.filters.rotation import matrix_from_rotvec, matrix_from_rpy
from certnav.filters.sensors import imu_preset
from certnav.nav.config import VehicleConfig
from certnav.nav.engine.vehicle import VehicleConstraints
from oracles import rigs
from oracles.derivatives import central_differences, moved

OMEGA = np.array([0.02, -0.05, 0.35])
LEVER = np.array([-1.2, 0.1, 0.7])
C_BV = matrix_from_rpy(np.radians([2.0, -3.0, 5.0]))
POINT = VehiclePoint(C_BV, LEVER)


def test_vehicle_velocity_jacobians(moving_state):
    def velocity(x):
        state = moved(moving_state, x)
        return constraints.vehicle_velocity(state, OMEGA - x[9:12], POINT)

    nhc = constraints.non_holonomic(moving_state, 15, OMEGA, POINT, (0.1, 0.2))
    np.testing.assert_allclose(nhc.H, central_differences(velocity, 15)[1:], atol=1e-6)
    np.testing.assert_allclose(nhc.z, -velocity(np.zeros(15))[1:])
    np.testing.assert_allclose(nhc.R, np.diag([0.01, 0.04]))

    scale = 0.013
    odo = constraints.odometer(moving_state, 16, OMEGA, POINT, 14.0, 0.05, scale)
    expected = central_differences(lambda x: (1 + scale + x[15]) * velocity(x)[:1], 16)
    np.testing.assert_allclose(odo.H, expected, atol=1e-6)
    np.testing.assert_allclose(odo.z, 14.0 - (1 + scale) * velocity(np.zeros(16))[0])


def test_mounting_and_wheel_point_are_seen_as_their_errors_say(moving_state):
    """The state moved by an error vector, fed back as the filter does it, by differences."""
    model = ErrorModel(
        imu_preset("adis16470"), clock_walk=0.1, odometer=True, vehicle=VehiclePrior(0.1, 2.0)
    )
    before = np.zeros(model.size)
    before[model.mounting], before[model.wheel] = [0.05, -0.12], [-1.4, 0.6]

    def estimated(x=None):
        states = VehicleStates(model)
        states.feed_back(before)
        if x is not None:
            states.feed_back(x)
        return states.point(C_BV, LEVER)

    def velocity(x):
        state = moved(moving_state, x)
        return constraints.vehicle_velocity(state, OMEGA - x[9:12], estimated(x))

    n = model.size
    expected = central_differences(velocity, n)
    nhc = constraints.non_holonomic(moving_state, n, OMEGA, estimated(), (0.1, 0.2))
    np.testing.assert_allclose(nhc.H, expected[1:], atol=1e-6)
    assert np.linalg.norm(nhc.H[:, model.mounting]) > 5.0
    assert np.linalg.norm(nhc.H[:, model.wheel]) > 0.3
    odo = constraints.odometer(moving_state, n, OMEGA, estimated(), 14.0, 0.05, 0.0)
    np.testing.assert_allclose(odo.H[:, : n - 1], expected[:1, : n - 1], atol=1e-6)


def test_what_was_declared_is_corrected_about_the_vehicles_own_axes():
    model = ErrorModel(imu_preset("adis16470"), vehicle=VehiclePrior(0.1, 2.0))
    states = VehicleStates(model)
    x = np.zeros(model.size)
    x[model.mounting], x[model.wheel] = [0.02, -0.3], [-1.5, 0.4]
    states.feed_back(x)
    point = states.point(C_BV, LEVER)
    np.testing.assert_allclose(point.C_bv, C_BV @ matrix_from_rotvec(np.array([0.0, 0.02, -0.3])))
    np.testing.assert_allclose(point.lever_b, LEVER + C_BV @ [-1.5, 0.0, 0.4])


def test_a_mounting_that_is_forgotten_is_as_unknown_as_before():
    model = ErrorModel(imu_preset("adis16470"), vehicle=VehiclePrior(0.1, 2.0))
    root = np.random.default_rng(3).normal(size=(model.size, model.size))
    P, phi = VehicleStates(model).forgotten(root @ root.T)
    np.testing.assert_array_equal(P[:15, :15], (root @ root.T)[:15, :15])
    np.testing.assert_allclose(P[15:, 15:], np.diag([0.01, 0.01, 4.0, 4.0]))
    assert not P[:15, 15:].any() and not phi[15:].any()


def test_standstill_jacobians(moving_state):
    zupt = constraints.zero_velocity(moving_state, 15, 0.02)
    np.testing.assert_allclose(
        zupt.H, central_differences(lambda x: moved(moving_state, x).vel_e, 15), atol=1e-9
    )

    bias = np.array([1e-3, -2e-3, 5e-4])

    def rate(x):
        from certnav.filters.earth import OMEGA_IE_E

        return bias + x[GYRO_BIAS] + moved(moving_state, x).C_eb.T @ OMEGA_IE_E

    zaru = constraints.zero_rate(moving_state, 15, OMEGA, bias, 1e-4)
    np.testing.assert_allclose(zaru.H, central_differences(rate, 15), atol=1e-9)
    np.testing.assert_allclose(zaru.z, OMEGA - rate(np.zeros(15)))


def test_zero_acceleration_jacobian(moving_state):
    force_b, bias = np.array([0.7, -0.4, -9.6]), np.array([0.05, -0.02, 0.1])

    def acceleration(x):
        state = moved(moving_state, x)
        return state.C_eb @ (force_b - bias - x[ACCEL_BIAS]) + gravity_e(moving_state.pos_e)

    still = constraints.zero_acceleration(moving_state, 15, force_b, bias, 0.1)
    np.testing.assert_allclose(still.H, central_differences(acceleration, 15), atol=1e-6)
    np.testing.assert_allclose(still.z, -acceleration(np.zeros(15)))


def test_constraints_hold_on_the_simulated_car(city_drive):
    """At the rear axle nothing moves sideways or up, also in turns; at the IMU it does."""
    from certnav.filters.strapdown import NavState

    time = city_drive.span[0] + np.arange(60.0, 300.0, 0.5)
    k = city_drive.kinematics(time)
    sideways, at_imu = [], []
    for i, t in enumerate(time):
        state = NavState(t, k.pos_e[i], k.vel_e[i], k.C_eb[i])
        omega = k.omega_ib_b[i]
        for lever, out in ((city_drive.lever_vehicle_b, sideways), (np.zeros(3), at_imu)):
            out.append(
                constraints.vehicle_velocity(state, omega, VehiclePoint(np.eye(3), lever))[1:]
            )
    assert np.abs(sideways).max() < 1e-6
    assert np.abs(at_imu).max() > 0.2


def test_standing_still_is_consistent_with_zero_rate(city_drive):
    from certnav.filters.strapdown import NavState

    t = city_drive.span[0] + 5.0  # parked
    k = city_drive.kinematics(np.array([t]))
    state = NavState(t, k.pos_e[0], k.vel_e[0], k.C_eb[0])
    zaru = constraints.zero_rate(state, 15, k.omega_ib_b[0], np.zeros(3), 1e-5)
    assert np.abs(zaru.z).max() == pytest.approx(0.0, abs=1e-9)
    assert np.abs(constraints.zero_velocity(state, 15, 0.01).z).max() < 1e-9
    still = constraints.zero_acceleration(state, 15, k.specific_force_b[0], np.zeros(3), 0.1)
    assert np.abs(still.z).max() == pytest.approx(0.0, abs=1e-9)


def estimated(rng, interval, seconds=160.0):
    """Normalised errors of mounting and wheel point after a drive whose tyres and springs give way.

    Attitude and velocity are known. What the car does sideways and upwards all the same is a
    Gauss-Markov process: 0.04 m/s for 20 s, 0.13 m/s for 10 s.
    """
    prior = VehiclePrior(0.1, 2.0)
    kalman = rigs.filter_at_rest(1.0, vehicle=prior)
    model = kalman.model
    kalman.P[:15] = kalman.P[:, :15] = 0.0
    kalman.P[:15, :15] = 1e-12 * np.eye(15)
    truth, slip = VehicleStates(model), np.zeros(2)
    x = np.zeros(model.size)
    x[model.mounting], x[model.wheel] = rng.normal(0.0, 0.1, 2), rng.normal(0.0, 2.0, 2)
    truth.feed_back(x)
    true = truth.point(C_BV, LEVER)
    sigma, tau = np.array([0.04, 0.13]), np.array([20.0, 10.0])
    nhc = VehicleConstraints(rigs.calibration(), VehicleConfig(interval_s=interval)).sigma_nhc
    phi, slip = np.exp(-interval / tau), sigma * rng.standard_normal(2)
    for t in np.arange(0.0, seconds, interval):
        slip = phi * slip + np.sqrt(1.0 - phi**2) * sigma * rng.standard_normal(2)
        # A turn of 10 s every 40 s, over bumps.
        rate_b = C_BV @ [0.0, 0.05 * np.sin(2.0 * t), 0.3 * (t % 40.0 < 10.0)]
        vel_b = true.C_bv @ np.r_[12.0, slip] - np.cross(rate_b, true.lever_b)
        kalman.vel_e = kalman.C_eb @ vel_b
        kalman.omega_b = rate_b + kalman.C_eb.T @ OMEGA_IE_E
        point = kalman.vehicle.point(C_BV, LEVER)
        state, n = kalman.state, model.size
        kalman.update(constraints.non_holonomic(state, n, kalman.omega_b, point, nhc))
    found = kalman.vehicle.point(C_BV, LEVER)
    turn = found.C_bv.T @ true.C_bv
    error = np.r_[turn[0, 2], turn[1, 0], (found.C_bv.T @ (true.lever_b - found.lever_b))[[0, 2]]]
    return error, kalman.P[15:, 15:].copy()


@pytest.mark.parametrize("interval", [0.3, 1.0])
def test_what_lasts_is_no_news_however_often_it_is_asked(interval):
    """NEES of mounting and wheel point as of chance; many constraints a second know no more."""
    rng = np.random.default_rng(11)
    runs = [estimated(rng, interval) for _ in range(12)]
    nees = np.array([e @ np.linalg.solve(P, e) for e, P in runs])
    assert 2.0 < nees.mean() < 5.0  # of 4; χ² of 48 lies within 2.6 … 5.7
    sigma = np.sqrt(np.diag(runs[0][1]))
    np.testing.assert_allclose(sigma[:3], [0.0035, 0.0018, 0.2], rtol=0.5)
