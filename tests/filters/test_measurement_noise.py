"""R of every measurement model against the scatter of what the model itself makes of noisy data.

The state is the truth, so that z is the noise that reached it; noise is drawn as the sensor makes
it, in axes of its own, and never through the model's formula for R.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.filters import constraints, measurements
from certnav.filters.earth import OMEGA_IE_E, gravity_e
from certnav.filters.gnss_states import shared_root
from certnav.filters.levers import VehiclePoint
from certnav.filters.rotation import matrix_from_rpy
from oracles import rigs

DRAWS = 4000
LEVER, OMEGA = np.array([-0.65, 0.3, -1.2]), np.array([0.02, -0.05, 0.35])
C_BV = matrix_from_rpy(np.radians([2.0, -3.0, 5.0]))
POINT = VehiclePoint(C_BV, LEVER)
#: Axes and 1σ of an ellipsoid that no Cartesian axis is an axis of.
AXES = matrix_from_rpy([0.5, -0.4, 1.1])


def ellipsoid(rng, sigma):
    """An error with 1σ along `AXES`."""
    return AXES @ (np.asarray(sigma) * rng.standard_normal(3))


def covariance_of(sigma):
    """The covariance of such errors, summed axis by axis."""
    return sum(s**2 * np.outer(axis, axis) for s, axis in zip(sigma, AXES.T, strict=True))


def assert_scatter(measure, seed=0):
    """Hold R against the sample covariance of z, and z against a mean of zero.

    In units of R's own σ, each entry of a sample covariance scatters by √2/√n at most.
    """
    rng = np.random.default_rng(seed)
    found = [measure(rng) for _ in range(DRAWS)]
    R = found[0].R
    for m in found[:10]:
        np.testing.assert_array_equal(m.R, R)
    white = np.linalg.solve(np.linalg.cholesky(R), np.array([m.z for m in found]).T)
    np.testing.assert_allclose(white.mean(axis=1), 0.0, atol=5.0 / np.sqrt(DRAWS))
    np.testing.assert_allclose(
        np.cov(white).reshape(R.shape), np.eye(len(R)), atol=5.0 * np.sqrt(2.0 / DRAWS)
    )


def test_position(moving_state):
    sigma = (0.4, 2.0, 5.0)
    antenna = measurements.antenna_position(moving_state, LEVER)
    cov_e = covariance_of(sigma)
    assert_scatter(
        lambda rng: measurements.position(
            moving_state, 15, antenna + ellipsoid(rng, sigma), cov_e, LEVER
        )
    )


def test_velocity(moving_state):
    sigma = (0.03, 0.2, 0.5)
    antenna = measurements.antenna_velocity(moving_state, OMEGA, LEVER)
    cov_e = covariance_of(sigma)
    assert_scatter(
        lambda rng: measurements.velocity(
            moving_state, 15, antenna + ellipsoid(rng, sigma), cov_e, LEVER, OMEGA
        )
    )


SIGMA, MORE = (0.4, 2.0, 5.0), 0.3  # of a fix, and of the lever arm on top, per axis [m]


def position_with_shared(state, error, estimate):
    antenna = measurements.antenna_position(state, LEVER)
    cov_e = covariance_of(SIGMA)
    m = measurements.position(state, 18, antenna + error, cov_e + MORE**2 * np.eye(3), LEVER)
    return measurements.with_shared_error(m, 0.9 * cov_e, slice(15, 18), estimate)


def test_a_position_whose_shared_error_is_known_has_its_own_share_left(moving_state):
    """A tenth of the fix's variance is its own; what the lever arm adds is all its own."""
    own = np.sqrt(0.1)
    shared = np.array([0.7, -1.5, 0.2])  # in units of its 1σ, known
    root = shared_root(0.9 * covariance_of(SIGMA))

    def measure(rng):
        error = root @ shared + own * ellipsoid(rng, SIGMA) + MORE * rng.standard_normal(3)
        return position_with_shared(moving_state, error, shared)

    assert_scatter(measure)


def test_a_position_whose_shared_error_is_unknown_has_all_of_it(moving_state):
    """However the variance is split: state of unit variance and R together are the fix's."""
    m = position_with_shared(moving_state, np.zeros(3), np.zeros(3))
    B = m.H[:, 15:18]
    whole = covariance_of(SIGMA) + MORE**2 * np.eye(3)
    np.testing.assert_allclose(B @ B.T + m.R, whole, rtol=1e-12, atol=1e-12)
    # Two fixes have that much in common.
    np.testing.assert_allclose(B @ B.T, 0.9 * covariance_of(SIGMA), rtol=1e-12, atol=1e-12)
    assert np.linalg.eigvalsh(m.R).min() > 0.0


def test_the_mean_of_many_positions_keeps_what_they_share(moving_state):
    """Variance of a mean of n fixes of one reflection: 0.9 σ² + 0.1 σ²/n, not σ²/n."""
    rng = np.random.default_rng(2)
    n, draws = 25, 3000
    common = np.sqrt(0.9) * np.array([ellipsoid(rng, SIGMA) for _ in range(draws)])
    own = np.sqrt(0.1) * (AXES @ (np.array(SIGMA)[:, None] * rng.standard_normal((draws, 3, n))))
    scatter = np.cov((common + own.mean(axis=2)).T)
    m = position_with_shared(moving_state, np.zeros(3), np.zeros(3))
    B = m.H[:, 15:18]
    predicted = B @ B.T + (m.R - MORE**2 * np.eye(3)) / n
    white = np.linalg.inv(np.linalg.cholesky(predicted))
    np.testing.assert_allclose(
        white @ scatter @ white.T, np.eye(3), atol=5.0 * np.sqrt(2.0 / draws)
    )


def sky(n, seed=3):
    rng = np.random.default_rng(seed)
    e = rng.normal(size=(n, 3))
    return e / np.linalg.norm(e, axis=1, keepdims=True), rng.uniform(0.03, 0.3, n)


@pytest.mark.parametrize("n", [2, 5])
@pytest.mark.parametrize("clock", [None, 15])
def test_range_rates(moving_state, n, clock):
    """Whitened: of unit variance whatever the satellites' σ, and not correlated."""
    e_e, sigma = sky(n)
    drift = 37.0
    exact = e_e @ measurements.antenna_velocity(moving_state, OMEGA, LEVER) - drift

    def measure(rng):
        z = exact + sigma * rng.standard_normal(n)
        return rigs.range_rates(
            moving_state, 16, e_e, z, sigma, LEVER, OMEGA, clock, drift
        )  # fmt: skip

    assert measure(np.random.default_rng(0)).R.shape == (n if clock else n - 1,) * 2
    assert_scatter(measure)


def test_non_holonomic(moving_state):
    """A car that slides and bounces by so much is measured not to, at the point of the wheels."""
    sigma = np.array([0.05, 0.3])
    omega_eb = OMEGA - moving_state.C_eb.T @ OMEGA_IE_E

    def measure(rng):
        vel_v = np.concatenate([[12.0], sigma * rng.standard_normal(2)])
        vel_b = C_BV @ vel_v - np.cross(omega_eb, LEVER)  # of the IMU
        state = dataclasses.replace(moving_state, vel_e=moving_state.C_eb @ vel_b)
        return constraints.non_holonomic(state, 15, OMEGA, POINT, sigma)

    assert_scatter(measure)
    one = constraints.non_holonomic(moving_state, 15, OMEGA, POINT, 0.05)
    np.testing.assert_allclose(one.R, np.diag([0.0025, 0.0025]))


def test_odometer(moving_state):
    sigma, scale = 0.08, 0.013
    omega_eb = OMEGA - moving_state.C_eb.T @ OMEGA_IE_E
    vel_b = C_BV @ [12.0, 0.0, 0.0] - np.cross(omega_eb, LEVER)
    state = dataclasses.replace(moving_state, vel_e=moving_state.C_eb @ vel_b)

    def measure(rng):
        speed = (1.0 + scale) * 12.0 + sigma * rng.standard_normal()
        return constraints.odometer(state, 16, OMEGA, POINT, speed, sigma, scale)

    assert_scatter(measure)


def test_zero_velocity(moving_state):
    """A car that stands and rocks."""
    sigma = 0.02

    def measure(rng):
        state = dataclasses.replace(moving_state, vel_e=sigma * rng.standard_normal(3))
        return constraints.zero_velocity(state, 15, sigma)

    assert_scatter(measure)


def test_zero_rate(moving_state):
    sigma, bias = 3e-4, np.array([1e-3, -2e-3, 5e-4])
    still = moving_state.C_eb.T @ OMEGA_IE_E + bias

    def measure(rng):
        gyro_b = still + sigma * rng.standard_normal(3)
        return constraints.zero_rate(moving_state, 15, gyro_b, bias, sigma)

    assert_scatter(measure)


def test_zero_acceleration(moving_state):
    """A car that stands and sways."""
    sigma, bias = 0.1, np.array([0.05, -0.02, 0.1])
    still = bias - moving_state.C_eb.T @ gravity_e(moving_state.pos_e)

    def measure(rng):
        force_b = still + sigma * rng.standard_normal(3)
        return constraints.zero_acceleration(moving_state, 15, force_b, bias, sigma)

    assert_scatter(measure)
