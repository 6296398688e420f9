"""Truth of the simulator: closed forms, derivatives, exact means, error statistics."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from certnav.datasets.simulation.sensors import fixes_from_truth, imu_measurements
from certnav.datasets.simulation.trajectory import Trajectory
from certnav.filters.earth import EARTH_RATE, OMEGA_IE_E, C_en_of, gravity_e
from certnav.filters.errors import DataError
from certnav.filters.rotation import matrix_from_rpy, skew
from certnav.filters.sensors import imu_preset

ORIGIN = np.array([np.radians(30.53), np.radians(114.36), 30.0])
T0 = 1287800000.0


@pytest.fixture(scope="module")
def circle():
    """Radius 20 m at 6 m/s, level in the fixed axes, rear axle on the circle."""
    t = np.arange(0.0, 60.0, 0.02)
    rate, radius = 0.3, 20.0
    heading = rate * t
    pos = radius * np.stack([np.sin(heading), 1.0 - np.cos(heading), 0.0 * t], axis=-1)
    return Trajectory(T0, t, pos, np.stack([0 * t, 0 * t, heading], -1), ORIGIN), rate, radius


@pytest.fixture(scope="module")
def lively():
    """Motion on all six axes with a lever and a mounting rotation."""
    t = np.arange(0.0, 40.0, 0.05)
    pos = np.stack([3 * t + 2 * np.sin(0.7 * t), 5 * np.cos(0.5 * t), np.sin(0.9 * t)], -1)
    rpy = np.stack([0.2 * np.sin(0.8 * t), 0.1 * np.sin(1.1 * t), 0.4 * t + np.sin(0.6 * t)], -1)
    C_bv = Rotation.from_euler("ZYX", [20.0, -4.0, 3.0], degrees=True).as_matrix()
    return Trajectory(T0, t, pos, rpy, ORIGIN, lever_imu_v=(1.2, 0.3, -0.4), C_bv=C_bv)


def test_circle_rate_and_force_are_the_closed_forms(circle):
    trajectory, rate, radius = circle
    time = T0 + np.linspace(10.0, 50.0, 41)
    k = trajectory.kinematics(time)
    heading = rate * (time - T0)
    C_bt = np.swapaxes(matrix_from_rpy(np.stack([0 * heading, 0 * heading, heading], -1)), -1, -2)
    lat = ORIGIN[0]
    earth_t = EARTH_RATE * np.array([np.cos(lat), 0.0, -np.sin(lat)])
    np.testing.assert_allclose(k.omega_ib_b, [0, 0, rate] + C_bt @ earth_t, atol=1e-9)
    v = rate * radius
    # Centripetal to the right, reaction to gravity, Coriolis: in body axes of the circle.
    coriolis_t = 2.0 * np.cross(
        earth_t, np.stack([np.cos(heading), np.sin(heading), 0 * v * heading], -1) * v
    )
    gravity_t = gravity_e(k.pos_e) @ trajectory.C_et
    expected = np.einsum("nij,nj->ni", C_bt, coriolis_t - gravity_t)
    expected[:, 1] += v * rate
    np.testing.assert_allclose(k.specific_force_b, expected, atol=1e-8)


def test_lever_on_circle_adds_centripetal_acceleration(circle):
    trajectory, rate, _ = circle
    time = T0 + np.linspace(10.0, 50.0, 11)
    difference = trajectory.specific_force_b(time, [1.5, 0, 0]) - trajectory.specific_force_b(time)
    # −ω²·l along the lever; gravity gradient and Coriolis on 1.5 m are below 1e-4 m/s².
    np.testing.assert_allclose(difference, np.tile([-(rate**2) * 1.5, 0, 0], (11, 1)), atol=2e-4)


@pytest.mark.parametrize("lever_b", [(0.0, 0.0, 0.0), (-0.65, -0.05, -0.15)])
def test_velocity_acceleration_and_rate_are_derivatives(lively, lever_b):
    time, h = T0 + np.linspace(5.0, 35.0, 301), 2.0**-8
    k, a, b = (lively.kinematics(time, lever_b, offset=d) for d in (0.0, -h, h))
    aa, bb = (lively.kinematics(time, lever_b, offset=2 * d) for d in (-h, h))

    def derivative(name):
        one = (getattr(b, name) - getattr(a, name)) / (2 * h)
        two = (getattr(bb, name) - getattr(aa, name)) / (4 * h)
        return (4 * one - two) / 3

    np.testing.assert_allclose(k.vel_e, derivative("pos_e"), atol=2e-6)  # 1e-9 m rounding / h
    np.testing.assert_allclose(k.accel_e, derivative("vel_e"), atol=1e-6)
    spin = np.swapaxes(k.C_eb, -1, -2) @ derivative("C_eb")
    np.testing.assert_allclose(spin, skew(k.omega_eb_b), atol=1e-7)
    inertial = k.omega_eb_b + np.einsum("nji,j->ni", k.C_eb, OMEGA_IE_E)
    np.testing.assert_allclose(k.omega_ib_b, inertial, atol=1e-15)


def test_levers_and_mounting_describe_one_rigid_body(lively):
    time = T0 + np.linspace(1.0, 39.0, 20)
    lever_b = np.array([-0.65, -0.05, -0.15])
    moved = lively.pos_e(time) + lively.C_eb(time) @ lever_b
    np.testing.assert_allclose(lively.pos_e(time, lever_b), moved, atol=1e-8)
    rear = lively.pos_e(time, lively.lever_vehicle_b)
    C_ev = lively.C_eb(time) @ lively.C_bv
    np.testing.assert_allclose(lively.pos_e(time) - rear, C_ev @ [1.2, 0.3, -0.4], atol=1e-8)


def test_standing_vehicle_measures_gravity_and_earth_rate():
    t = np.arange(0.0, 10.0, 0.1)
    trajectory = Trajectory(T0, t, np.zeros((t.size, 3)), np.zeros((t.size, 3)), ORIGIN)
    gyro, accel = trajectory.imu_means(T0 + np.arange(1.0, 9.0, 0.01))
    assert np.linalg.norm(gyro, axis=1) == pytest.approx(EARTH_RATE, rel=1e-12)
    g = np.linalg.norm(gravity_e(trajectory.origin_e))
    assert np.linalg.norm(accel, axis=1) == pytest.approx(g, rel=1e-12)
    assert accel[:, 2].max() < -9.78


def test_means_times_interval_are_the_integrals(lively):
    """Refining the quadrature sixteenfold changes the increments by rounding only."""
    time = T0 + np.arange(5.0, 30.0, 0.01)
    gyro, accel = lively.imu_means(time)
    fine = np.linspace(time[:-1], time[1:], 17)[1:].T.ravel()
    fine_step = np.diff(fine, prepend=time[0])[:, None]
    g, f = lively.imu_means(np.concatenate([[time[0]], fine]))
    shape = (time.size - 1, 16, 3)
    np.testing.assert_allclose(
        gyro[1:] * np.diff(time)[:, None], (g[1:] * fine_step).reshape(shape).sum(1), atol=1e-15
    )
    np.testing.assert_allclose(
        accel[1:] * np.diff(time)[:, None], (f[1:] * fine_step).reshape(shape).sum(1), atol=2e-12
    )


def test_instantaneous_rates_integrate_to_the_trajectory(lively):
    """The navigation equations, integrated with an independent solver, reproduce the truth."""
    start = T0 + 5.0
    k = lively.kinematics(start)
    y0 = np.concatenate([k.pos_e[0] - lively.origin_e, k.vel_e[0], k.C_eb[0].ravel()])

    def rhs(t, y):
        C = y[6:].reshape(3, 3)
        truth = lively.kinematics(start, offset=t)
        v = y[3:6]
        f = C @ truth.specific_force_b[0]
        pos = lively.origin_e + y[:3]
        accel = f - 2.0 * np.cross(OMEGA_IE_E, v) + gravity_e(pos)
        rate = skew(truth.omega_ib_b[0] - C.T @ OMEGA_IE_E)
        return np.concatenate([v, accel, (C @ rate).ravel()])

    end = solve_ivp(rhs, (0.0, 10.0), y0, method="DOP853", rtol=1e-10, atol=1e-10).y[:, -1]
    k = lively.kinematics(start, offset=10.0)
    np.testing.assert_allclose(end[:3] + lively.origin_e, k.pos_e[0], atol=1e-6)
    np.testing.assert_allclose(end[3:6], k.vel_e[0], atol=1e-6)
    np.testing.assert_allclose(end[6:].reshape(3, 3), k.C_eb[0], atol=1e-8)


def test_time_outside_the_nodes_is_refused(circle):
    with pytest.raises(DataError, match=r"asked for -1\.000"):
        circle[0].pos_e([T0 - 1.0])


def test_reference_attitude_is_in_the_local_axes(lively):
    time = T0 + np.arange(1.0, 39.0)
    reference = lively.reference(time)
    C_eb = C_en_of(reference.pos_e) @ matrix_from_rpy(reference.rpy)
    np.testing.assert_allclose(C_eb, lively.C_eb(time), atol=1e-12)


@pytest.fixture(scope="module")
def standing():
    t = np.arange(-10.0, 4000.0, 10.0)
    return Trajectory(T0, t, np.zeros((t.size, 3)), np.zeros((t.size, 3)), ORIGIN)


def test_white_noise_has_the_density_of_the_specification(standing):
    spec = dataclasses.replace(imu_preset("adis16470"), bias_correlation_time_s=np.inf)
    time = T0 + np.arange(0.0, 600.0, 0.01)
    imu, gyro_bias, accel_bias = imu_measurements(standing, time, spec, np.random.default_rng(1))
    gyro, accel = standing.imu_means(time)
    gyro_white = imu.gyro_b - gyro - gyro_bias
    accel_white = imu.accel_b - accel - accel_bias
    # 180 000 draws: σ to 0.17 % (1σ); the angle after one hour is then the datasheet's ARW.
    assert gyro_white.std() * 0.1 * 60 * 180 / np.pi == pytest.approx(0.34, rel=0.007)
    assert accel_white.std() * 0.1 * 60 == pytest.approx(0.037, rel=0.007)


@pytest.mark.parametrize("tau", [50.0, np.inf])
def test_bias_history_has_the_variance_of_its_process(standing, tau):
    spec = dataclasses.replace(imu_preset("adis16470"), bias_correlation_time_s=tau)
    time = T0 + np.sort(np.random.default_rng(2).uniform(0.0, 1200.0, 60))
    rng = np.random.default_rng(3)
    runs = [imu_measurements(standing, time, spec, rng)[1] for _ in range(700)]
    bias = np.stack([b - b[0] for b in runs])
    age = time - time[0]
    sigma = spec.gyro_bias_sigma
    variance = sigma**2 * (age / 3600 if np.isinf(tau) else -np.expm1(-2 * age / tau))
    measured = (bias**2).mean((0, 2))
    np.testing.assert_allclose(measured[1:], variance[1:], rtol=0.13)  # 2100 draws: 4 × 3.1 %
    if not np.isinf(tau):  # correlation e^{-Δ/τ} between two late instants
        i, j = 50, 52
        rho = (bias[:, i] * bias[:, j]).mean() / np.sqrt(measured[i] * measured[j])
        assert rho == pytest.approx(np.exp(-(age[j] - age[i]) / tau), abs=0.06)
    turn_on = np.stack([b[0] for b in runs])
    assert turn_on.std() == pytest.approx(spec.gyro_bias_initial_sigma, rel=0.07)


def test_noise_free_measurements_are_the_means(lively):
    time = T0 + np.arange(5.0, 6.0, 0.01)
    spec = imu_preset("consumer")
    imu, gyro_bias, accel_bias = imu_measurements(
        lively, time, spec, np.random.default_rng(0), noise=False
    )
    gyro, accel = lively.imu_means(time)
    assert np.array_equal(imu.gyro_b, gyro) and np.array_equal(imu.accel_b, accel)
    assert not gyro_bias.any() and not accel_bias.any()


def test_fixes_have_the_errors_their_covariance_states(lively):
    time = T0 + np.linspace(1.0, 39.0, 4000)
    lever = np.array([-0.65, -0.05, -0.15])
    fixes = fixes_from_truth(lively, time, lever, (1.0, 2.0, 4.0), 0.05, np.random.default_rng(4))
    for name, cov in (("pos_e", fixes.pos_cov_e), ("vel_e", fixes.vel_cov_e)):
        truth = getattr(lively.kinematics(time, lever), name)
        error = getattr(fixes, name) - truth
        nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(cov), error)
        assert nees.mean() == pytest.approx(3.0, abs=4 * np.sqrt(6 / 4000))
    error_n = np.einsum("nji,nj->ni", C_en_of(fixes.pos_e), fixes.pos_e - lively.pos_e(time, lever))
    np.testing.assert_allclose(error_n.std(0), [1.0, 2.0, 4.0], rtol=0.05)
    assert not fixes_from_truth(
        lively, time, lever, 1.0, None, np.random.default_rng(4)
    ).has_velocity.any()
