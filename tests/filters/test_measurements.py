"""Measurement Jacobians against central differences of the nonlinear prediction."""

import dataclasses

import numpy as np
import pytest

from certnav.filters import measurements
from certnav.filters.error_model import POS
from certnav.filters.levers import AntennaPoint, rate_over_earth
from oracles import rigs
from oracles.derivatives import central_differences, moved

LEVER = np.array([-0.65, -0.05, -0.15])
OMEGA = np.array([0.02, -0.05, 0.35])


def predict(kind, state, x):
    new = moved(state, x)
    if kind == "position":
        return measurements.antenna_position(new, LEVER)
    return measurements.antenna_velocity(new, OMEGA - x[9:12], LEVER)


@pytest.mark.parametrize("kind", ["position", "velocity"])
def test_jacobian_against_central_differences(moving_state, kind):
    measured = np.array([1.0, 2.0, 3.0])
    if kind == "position":
        m = measurements.position(moving_state, 15, measured, np.eye(3), LEVER)
    else:
        m = measurements.velocity(moving_state, 15, measured, np.eye(3), LEVER, OMEGA)
    numeric = central_differences(lambda x: predict(kind, moving_state, x), 15)
    np.testing.assert_allclose(m.H, numeric, atol=2e-7)
    np.testing.assert_allclose(m.z, measured - predict(kind, moving_state, np.zeros(15)))


ACCEL = np.array([0.8, -1.1, 0.4])
POINT = AntennaPoint(LEVER, slice(15, 18), 18, 0.07, ACCEL)


def late(kind, state, x):
    """Return what an antenna `POINT` measures: place and delay are states."""
    new, delay = moved(state, x), POINT.delay_s + x[18]
    lever, omega = LEVER + x[15:18], OMEGA - x[9:12]
    velocity = measurements.antenna_velocity(new, omega, lever)
    if kind == "velocity":
        return velocity + delay * ACCEL
    return measurements.antenna_position(new, lever) + delay * velocity


@pytest.mark.parametrize("kind", ["position", "velocity"])
def test_jacobian_of_place_and_delay_against_central_differences(moving_state, kind):
    measured = np.array([1.0, 2.0, 3.0])
    rate = rate_over_earth(moving_state.C_eb, OMEGA)
    point = dataclasses.replace(POINT, rate_b=rate)
    make = measurements.position if kind == "position" else measurements.velocity
    m = make(moving_state, 19, measured, np.eye(3), point, OMEGA)
    numeric = central_differences(lambda x: late(kind, moving_state, x), 19)
    np.testing.assert_allclose(m.H, numeric, atol=5e-7)
    np.testing.assert_allclose(m.z, measured - late(kind, moving_state, np.zeros(19)))


def test_range_rates_know_the_antenna_as_a_velocity_does(moving_state):
    (e_e, sigma), z = satellites(5), np.array([4.0, -2.0, 7.0, 0.5, -9.0])
    whole = measurements.velocity(moving_state, 20, np.zeros(3), np.eye(3), POINT, OMEGA)
    rows = rigs.range_rates(moving_state, 20, e_e, z, sigma, POINT, OMEGA, 19, 3.0)
    along = e_e @ whole.H / sigma[:, None]
    along[:, 19] = -1.0 / sigma
    np.testing.assert_allclose(rows.H, along, atol=1e-12)
    expected = (z + e_e @ whole.z + 3.0) / sigma
    np.testing.assert_allclose(rows.z, expected, atol=1e-9)


def test_lever_arm_velocity_on_a_circle(moving_state):
    """A point ahead of the IMU moves sideways at r·ω when the vehicle turns."""
    state = dataclasses.replace(moving_state, vel_e=np.zeros(3))
    vel = measurements.antenna_velocity(state, [0, 0, 0.5], [2.0, 0, 0])
    earth_rate_share = 2.0 * 7.3e-5
    np.testing.assert_allclose(state.C_eb.T @ vel, [0, 1.0, 0], atol=earth_rate_share)


def satellites(n, seed=3):
    rng = np.random.default_rng(seed)
    e = rng.normal(size=(n, 3))
    return e / np.linalg.norm(e, axis=1, keepdims=True), rng.uniform(0.03, 0.3, n)


@pytest.mark.parametrize("n", [2, 3, 6])
def test_range_rate_rows_are_blind_to_the_clock_and_right_in_slope(moving_state, n):
    e, sigma = satellites(n)
    truth = predict("velocity", moving_state, np.zeros(15))
    for drift in (0.0, 4e4):
        m = rigs.range_rates(moving_state, 15, e, e @ truth - drift, sigma, LEVER, OMEGA)
        assert m.z.shape == (n - 1,)
        np.testing.assert_allclose(m.z, 0.0, atol=1e-6)

    def innovation(x):
        z = e @ predict("velocity", moving_state, x) - 12.0
        return rigs.range_rates(moving_state, 15, e, z, sigma, LEVER, OMEGA).z

    np.testing.assert_allclose(m.H, central_differences(innovation, 15), atol=1e-5)


@pytest.mark.parametrize("clock", [None, 19])
def test_range_rates_know_what_the_position_does_to_them(moving_state, clock):
    """z computed at an estimate that is off by δp, of the true one's opposite sign."""
    e, sigma = satellites(4)
    by_pos = np.random.default_rng(4).normal(0.0, 2e-4, (4, 3))
    args = (moving_state, 20, e, np.zeros(4), sigma, LEVER, OMEGA, clock, 0.0)
    exact, known = (rigs.range_rates(*args, g) for g in (None, by_pos))
    step = np.array([400.0, -300.0, 100.0])  # true − estimated
    moved = rigs.range_rates(*args[:3], -by_pos @ step, *args[4:], None)
    np.testing.assert_allclose(known.H[:, POS] @ step, moved.z - exact.z, atol=1e-9)
    rest = np.delete(np.arange(20), POS)
    np.testing.assert_array_equal(known.H[:, rest], exact.H[:, rest])


def test_range_rates_of_two_satellites_are_their_difference(moving_state):
    """NIS of the pair is (Δz − e_AB·v)²/(σ_A² + σ_B²), whatever the weights."""
    e, sigma = satellites(2, seed=9)
    z = np.array([3.0, -7.0])
    m = rigs.range_rates(moving_state, 15, e, z, sigma, LEVER, OMEGA)
    v = predict("velocity", moving_state, np.zeros(15))
    pair = (z[0] - z[1]) - (e[0] - e[1]) @ v
    assert m.z @ m.z == pytest.approx(pair**2 / np.sum(sigma**2))


def test_range_rates_carry_what_least_squares_would(moving_state):
    """The information on velocity equals that of eq. (6) after its clock is eliminated."""
    e, sigma = satellites(7)
    m = rigs.range_rates(moving_state, 15, e, np.zeros(7), sigma, np.zeros(3), OMEGA)
    full = np.column_stack([e, -np.ones(7)]) / sigma[:, None]
    cov = np.linalg.inv(full.T @ full)[:3, :3]
    H = m.H[:, 3:6]
    np.testing.assert_allclose(np.linalg.inv(H.T @ H), cov, rtol=1e-9)
