"""The transition matrix and the covariance step, against the mechanisation itself."""

import numpy as np
import pytest

from certnav.filters.compiled import kernels
from certnav.filters.error_model import ATT, GYRO_BIAS, GYRO_SCALE, POS, VEL, ErrorModel
from certnav.filters.errors import ConfigError
from certnav.filters.levers import VehiclePrior
from certnav.filters.rotation import matrix_from_rotvec
from certnav.filters.sensors import imu_preset

OMEGA = np.array([0.05, -0.08, 0.6])
FORCE = np.array([2.0, -3.5, -9.6])
SCALE = np.array([2e-3, -3e-3, 1e-3, -2e-3, 1e-3, 4e-3])


def perturbed_step(state, x, dt):
    """Mechanise one step from the state moved by the error vector x; return the end state.

    The measured rates stay what they are; bias and scale errors change what is made of them.
    """
    pos, vel = state.pos_e + x[0:3], state.vel_e + x[3:6]
    C = state.C_eb @ matrix_from_rotvec(x[6:9])
    measured = np.concatenate([OMEGA, FORCE]) * (1 + SCALE)
    corrected = (measured - x[9:15]) / (1 + SCALE + x[15:21])
    zero, v, R, work = np.zeros(3), np.empty((5, 3)), np.empty((3, 3)), np.empty((3, 3))
    kernels.strapdown_step(pos, vel, C, corrected[:3], corrected[3:], zero, zero, dt, v, R, work)
    return pos, vel, C


def numeric_transition(state, dt):
    """Central differences of the mechanisation in every error direction."""
    steps = np.repeat([100.0, 1.0, 1e-2, 3e-2, 1.0, 3e-2, 3e-2], 3)
    columns = []
    for j, step in enumerate(steps):
        ends = [perturbed_step(state, sign * step * np.eye(21)[j], dt) for sign in (1, -1)]
        (p1, v1, C1), (p0, v0, C0) = ends
        skewed = C0.T @ C1
        phi = np.array(
            [skewed[2, 1] - skewed[1, 2], skewed[0, 2] - skewed[2, 0], skewed[1, 0] - skewed[0, 1]]
        )
        columns.append(np.concatenate([p1 - p0, v1 - v0, phi / 2]) / (2 * step))
    return np.array(columns).T


def transition(state, dt):
    model = ErrorModel(imu_preset("adis16470"), 21)
    return model.transition_matrix(state.pos_e, state.C_eb, OMEGA, FORCE, dt, SCALE)


def test_transition_against_central_differences(moving_state):
    dt = 0.005
    phi, numeric = transition(moving_state, dt), numeric_transition(moving_state, dt)
    # Blocks differ by powers of dt; each is held to 1 % of its own largest entry. Left out of a
    # first-order Φ altogether: gyro errors to velocity and position, of the size dt²·force.
    omitted = np.linalg.norm(FORCE) * dt**2
    for rows in (POS, VEL, ATT):
        for columns in (slice(k, k + 3) for k in range(0, 21, 3)):
            block, expected = phi[rows, columns], numeric[rows, columns]
            error, largest = np.abs(block - expected).max(), np.abs(expected).max()
            if rows != ATT and columns in (GYRO_BIAS, GYRO_SCALE):
                assert np.all(block == 0.0)
                assert largest < omitted
            else:
                # 1e-6: a position of 6e6 m resolves 1e-9 m, divided by the difference step.
                assert error < max(0.01 * largest, 1e-6 if rows == POS else 1e-9), (rows, columns)


def test_transition_error_falls_with_the_square_of_the_step(moving_state):
    errors = [
        np.abs(transition(moving_state, dt)[3:9] - numeric_transition(moving_state, dt)[3:9]).max()
        for dt in (0.04, 0.02)
    ]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.15)


#: 23 states of which none is a scale factor.
MANY = {"clock_walk": 0.1, "fix_correlation": 10.0, "vehicle": VehiclePrior(0.1, 2.0)}


def test_other_states_are_no_scale_factors(moving_state):
    made = ErrorModel(imu_preset("adis16470"), **MANY)
    assert made.size == 23
    at = moving_state.pos_e, moving_state.C_eb, OMEGA, FORCE, 0.01
    phi = made.transition_matrix(*at)
    expected = np.eye(23)
    expected[:15, :15] = ErrorModel(imu_preset("adis16470")).transition_matrix(*at)
    np.testing.assert_array_equal(phi, expected)


@pytest.mark.parametrize("more", [{}, {"states": 21}, MANY])
def test_covariance_step_is_phi_p_phi_t_plus_q(moving_state, more):
    rng = np.random.default_rng(7)
    model = ErrorModel(imu_preset("adis16470"), **more)
    states = model.size
    root = rng.normal(size=(states, states)) * np.logspace(0, -6, states)[:, None]
    P = root @ root.T
    dt = 0.01
    phi = model.transition_matrix(moving_state.pos_e, moving_state.C_eb, OMEGA, FORCE, dt)
    expected = phi @ P @ phi.T
    noise = model.noise()
    diagonal = np.zeros(states)
    diagonal[3:15] = np.repeat([noise[1], noise[0], noise[2], noise[3]], 3) * dt
    expected += np.diag(diagonal)

    G, v, R, work = np.zeros((3, 3)), np.empty((5, 3)), np.empty((3, 3)), np.empty((3, 3))
    kernels._gravity_gradient(moving_state.pos_e, G)
    pos, vel, C = moving_state.pos_e.copy(), moving_state.vel_e.copy(), moving_state.C_eb.copy()
    zero = np.zeros(6)
    kernels.strapdown_step(pos, vel, C, OMEGA, FORCE, zero[:3], zero[:3], dt, v, R, work)
    F = np.zeros((6, 3, 3))
    kernels.linearise(
        F, dt, G, v[0], moving_state.C_eb, R, OMEGA, FORCE, np.ones(6), 1.0, 1.0, noise[6]
    )
    actual = P.copy()
    scratch = np.empty((9, states)), np.zeros((states, 9)), np.empty((9, 9))
    kernels.covariance_step(actual, F, *scratch, noise)
    np.testing.assert_allclose(actual, expected, rtol=1e-12, atol=1e-24)
    np.testing.assert_array_equal(actual, actual.T)


def test_gauss_markov_bias_keeps_its_variance():
    """Decay and driving noise balance: the in-run σ is stationary."""
    spec = imu_preset("adis16470")
    model = ErrorModel(spec, bias_model="gauss-markov")
    sigma = spec.gyro_bias_sigma
    decay = model.transition_matrix(np.array([6378137.0, 0, 0]), np.eye(3), OMEGA, FORCE, 1.0)[9, 9]
    driven = decay**2 * sigma**2 + model.noise()[2] * 1.0
    assert driven == pytest.approx(sigma**2, rel=1e-3)


def test_initial_covariance_blocks_and_state_count():
    spec = imu_preset("tactical")
    P = ErrorModel(spec, 21).initial_covariance(np.eye(3), 2 * np.eye(3), 3 * np.eye(3))
    assert P.shape == (21, 21)
    np.testing.assert_array_equal(P[POS, POS] + P[VEL, VEL] + P[ATT, ATT], 6 * np.eye(3))
    expected = spec.gyro_bias_initial_sigma**2 + spec.gyro_bias_sigma**2
    np.testing.assert_allclose(P[GYRO_BIAS, GYRO_BIAS], np.eye(3) * expected)
    with pytest.raises(ConfigError, match="15 or 21"):
        ErrorModel(spec, 17)
    with pytest.raises(ConfigError, match="random-walk"):
        ErrorModel(spec, bias_model="constant")


def test_random_walk_bias_grows_as_the_in_run_bias_begins_to():
    """Over a time short against τ both models let the same variance in, and nothing decays."""
    spec = imu_preset("adis16470")
    walk, markov = ErrorModel(spec), ErrorModel(spec, bias_model="gauss-markov")
    np.testing.assert_array_equal(walk.noise()[:4], markov.noise()[:4])
    assert walk.noise()[4] == 0.0 < markov.noise()[4]
    phi = walk.transition_matrix(np.array([6378137.0, 0, 0]), np.eye(3), OMEGA, FORCE, 100.0)
    np.testing.assert_array_equal(phi[GYRO_BIAS, GYRO_BIAS], np.eye(3))


def test_scale_factors_of_sensors_and_odometer_begin_as_unknown_as_they_are():
    """Parts per million of the data sheet; two per cent of tyre wear and pressure."""
    spec = imu_preset("adis16470")
    model = ErrorModel(spec, 21, odometer=True)
    P = model.initial_covariance(np.eye(3), np.eye(3), np.eye(3))
    assert P.shape == (22, 22) and P[21, 21] == 0.02**2
    np.testing.assert_allclose(np.sqrt(np.diag(P)[15:18]), 3000e-6)
    np.testing.assert_allclose(np.sqrt(np.diag(P)[18:21]), 3000e-6)
    gyro = np.hypot(spec.gyro_bias_initial_sigma, spec.gyro_bias_sigma)
    accel = np.hypot(spec.accel_bias_initial_sigma, spec.accel_bias_sigma)
    np.testing.assert_allclose(np.sqrt(np.diag(P)[9:15]), np.repeat([gyro, accel], 3))
    assert np.count_nonzero(P - np.diag(np.diag(P))) == 0


def test_the_transition_is_that_of_the_model_it_is_asked_of(moving_state):
    """States beyond the IMU's stay; each bias decays by its own share of time."""
    spec = imu_preset("adis16470")
    model = ErrorModel(spec, 21, "gauss-markov", odometer=True, clock_walk=0.1, fix_correlation=9.0)
    dt = 5.0
    phi = model.transition_matrix(moving_state.pos_e, moving_state.C_eb, OMEGA, FORCE, dt)
    assert phi.shape == (26, 26)
    np.testing.assert_allclose(np.diag(phi)[9:15], np.exp(-dt / spec.bias_correlation_time_s))
    np.testing.assert_array_equal(np.diag(phi)[15:], 1.0)
    below = phi[9:].copy()
    below[np.arange(17), np.arange(9, 26)] = 0.0
    assert not below.any()
