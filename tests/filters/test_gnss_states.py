"""Errors of GNSS as states: the receiver's clock drift, and what successive positions share."""

import numpy as np
import pytest

from certnav.filters import measurements
from certnav.filters.compiled import rows as layout
from certnav.filters.earth import OMEGA_IE_E, gravity_e
from certnav.filters.ekf import ErrorStateFilter
from certnav.filters.error_model import ATT, POS, VEL, ErrorModel
from certnav.filters.gnss_states import CLOCK_DRIFT_SIGMA, shared_root
from certnav.filters.measurements import Measurement
from certnav.filters.sensors import imu_preset
from certnav.filters.smoother import smooth
from certnav.filters.strapdown import InertialStream, NavState
from oracles import rigs

TAU, SHARED = 10.0, 0.9


@pytest.fixture
def standing(moving_state):
    """A filter over a minute of a car that stands, with all states of GNSS errors."""

    def start(smoothing=False, **states):
        model = ErrorModel(imu_preset("adis16470"), **states)
        C_eb = moving_state.C_eb
        time = np.arange(0.0, 60.0, 0.01)
        gyro = np.tile(C_eb.T @ OMEGA_IE_E, (time.size, 1))
        accel = np.tile(-C_eb.T @ gravity_e(moving_state.pos_e), (time.size, 1))
        stream = InertialStream(time, gyro, accel)
        state = NavState(stream.start, moving_state.pos_e, np.zeros(3), C_eb)
        P = model.initial_covariance(
            np.eye(3) * 4.0, np.eye(3) * 1e-4, np.eye(3) * 1e-4, np.eye(3) * SHARED * 4.0
        )
        return ErrorStateFilter(model, stream, state, P, 1.0, smoothing=smoothing)

    return start


def test_states_are_where_the_model_says():
    spec = imu_preset("adis16470")
    assert ErrorModel(spec).clock is None and ErrorModel(spec).fix_bias is None
    model = ErrorModel(spec, 21, odometer=True, clock_walk=0.1, fix_correlation=TAU)
    assert (model.clock, model.fix_bias, model.size) == (21, slice(22, 25), 26)
    pos_cov = np.diag([1.0, 4.0, 9.0])
    P = model.initial_covariance(pos_cov, np.eye(3), np.eye(3), 0.9 * pos_cov)
    assert P[21, 21] == CLOCK_DRIFT_SIGMA**2
    assert np.linalg.eigvalsh(P[[*range(3), 22, 23, 24]][:, [*range(3), 22, 23, 24]]).min() > 0.0


def test_shared_root_is_the_symmetric_root():
    A = np.random.default_rng(1).standard_normal((3, 3))
    cov = A @ A.T
    B = shared_root(cov)
    np.testing.assert_allclose(B, B.T, atol=1e-14)
    np.testing.assert_allclose(B @ B.T, cov, atol=1e-13)


def test_shared_error_fades_with_its_correlation_time(standing):
    kalman = standing(fix_correlation=TAU, clock_walk=0.1)
    b, c = kalman.model.fix_bias, kalman.model.clock
    before = kalman.P.copy()
    kalman.gnss.fix_bias[:] = [1.0, -2.0, 0.5]
    for until in (1.3, 4.0, 10.0):  # however the time is cut
        kalman.propagate(until)
    dt = 10.0 - kalman.stream.start
    np.testing.assert_allclose(kalman.gnss.fix_bias, np.exp(-dt / TAU) * np.array([1.0, -2.0, 0.5]))
    np.testing.assert_allclose(kalman.P[b, b], np.eye(3), atol=1e-12)  # stationary
    assert kalman.P[c, c] == pytest.approx(before[c, c] + 0.1**2 * dt)
    # Gravity's gradient moves it a little, too.
    np.testing.assert_allclose(
        kalman.P[b, POS], np.exp(-dt / TAU) * before[b, POS], rtol=1e-3, atol=1e-3
    )


def test_many_positions_do_not_average_away_what_they_share(standing):
    def after(count, **states):
        kalman = standing(**states)
        cov = np.eye(3) * 4.0
        for k in range(count):
            kalman.propagate(kalman.stream.start + 0.01 * (k + 1))
            m = measurements.position(
                kalman.state, kalman.model.size, kalman.pos_e, cov, np.zeros(3)
            )
            if kalman.model.fix_bias is not None:
                m = measurements.with_shared_error(
                    m, SHARED * cov, kalman.model.fix_bias, kalman.gnss.fix_bias
                )
            kalman.update(m)
        return float(np.trace(kalman.P[POS, POS]) / 3.0)

    white, shared = after(100), after(100, fix_correlation=1e6)
    assert white < 4.0 / 80.0
    # 90 % of the variance is common to all of them and stays.
    assert shared == pytest.approx(SHARED * 4.0, rel=0.03)


def test_other_satellites_have_other_errors(standing):
    kalman = standing(fix_correlation=TAU)
    b = kalman.model.fix_bias
    kalman.gnss.fix_bias[:] = 1.0
    before = kalman.P[b, POS].copy()
    kalman.reconsider(*kalman.gnss.other_satellites(kalman.P, 1.0))
    np.testing.assert_array_equal(kalman.P[b, POS], before)
    kalman.reconsider(*kalman.gnss.other_satellites(kalman.P, 0.25))
    np.testing.assert_allclose(kalman.gnss.fix_bias, 0.25)
    np.testing.assert_allclose(kalman.P[b, POS], 0.25 * before)
    np.testing.assert_allclose(kalman.P[b, b], np.eye(3), atol=1e-12)


def test_an_unknown_clock_is_the_clock_eliminated(moving_state):
    """With a clock that nothing is known of, both forms of Doppler say the same."""
    rng = np.random.default_rng(4)
    e = rng.standard_normal((5, 3))
    e /= np.linalg.norm(e, axis=1)[:, None]
    z, sigma = rng.standard_normal(5), rng.uniform(0.05, 0.2, 5)
    omega, lever = np.array([0.0, 0.01, 0.1]), np.array([0.5, 0.2, -1.0])
    A = rng.standard_normal((15, 15)) * 0.1
    P = np.zeros((16, 16))
    P[:15, :15] = A @ A.T
    P[15, 15] = 1e4**2
    gone = rigs.range_rates(moving_state, 15, e, z, sigma, lever, omega)
    kept = rigs.range_rates(moving_state, 16, e, z, sigma, lever, omega, 15, 0.0)

    def updated(P, m):
        K = P @ m.H.T @ np.linalg.inv(m.H @ P @ m.H.T + m.R)
        return K @ m.z, P - K @ m.H @ P

    x, cov = updated(P[:15, :15], gone)
    x_kept, cov_kept = updated(P, kept)
    np.testing.assert_allclose(x_kept[:15], x, atol=1e-5)
    np.testing.assert_allclose(cov_kept[:15, :15], cov, atol=1e-6)


def test_a_clock_of_which_nothing_is_known_yet_does_not_drift(moving_state):
    args = (np.eye(3), [3.0, 2.0, 1.0], [0.1, 0.2, 0.5], np.zeros(3), np.zeros(3), 15)
    default = rigs.range_rates(moving_state, 16, *args)
    np.testing.assert_array_equal(default.z, rigs.range_rates(moving_state, 16, *args, 0.0).z)


def test_clock_jacobian(moving_state):
    e, z, sigma = np.eye(3), np.array([3.0, 2.0, 1.0]), np.array([0.1, 0.2, 0.5])
    args = (e, z, sigma, np.zeros(3), np.zeros(3), 15)
    base = rigs.range_rates(moving_state, 16, *args, 0.0)
    more = rigs.range_rates(moving_state, 16, *args, 0.1)
    np.testing.assert_allclose((base.z - more.z) / 0.1, base.H[:, 15])


def test_doubt_enlarges_only_what_the_measurement_sees(standing):
    kalman = standing(clock_walk=0.1)
    kalman.propagate(5.0)
    n = kalman.model.size
    H = np.zeros((3, n))
    H[:, VEL] = np.eye(3)
    m = Measurement(np.array([2.0, -1.0, 0.5]), H, np.eye(3) * 0.01)
    before = kalman.P.copy()
    factor = kalman.doubt(m)
    assert factor > 1.0
    grown = kalman.P - before
    np.testing.assert_allclose(kalman.P[VEL, VEL], factor * before[VEL, VEL], rtol=1e-8)
    assert kalman.test(m, 0.0).nis <= 3.0
    assert np.linalg.matrix_rank(grown, tol=1e-9 * np.trace(grown)) == 3
    assert grown[kalman.model.clock, kalman.model.clock] == pytest.approx(0.0, abs=1e-9)
    assert np.linalg.eigvalsh(kalman.P).min() > -1e-12
    assert np.trace(kalman.P[ATT, ATT]) >= np.trace(before[ATT, ATT])


def test_a_clock_that_jumped_is_unknown_and_nothing_else_is(standing):
    kalman = standing(clock_walk=0.1)
    c = kalman.model.clock
    kalman.P[c, VEL] = kalman.P[VEL, c] = 0.5
    kalman.P[c, c] = 1.0
    rest = np.delete(np.delete(kalman.P, c, 0), c, 1)
    kalman.reconsider(*kalman.gnss.clock_forgotten(kalman.P))
    assert kalman.P[c, c] == CLOCK_DRIFT_SIGMA**2
    assert not kalman.P[c, VEL].any()
    np.testing.assert_array_equal(np.delete(np.delete(kalman.P, c, 0), c, 1), rest)


def test_smoothing_with_gnss_states_is_never_worse(standing):
    kalman = standing(smoothing=True, clock_walk=0.1, fix_correlation=TAU)
    cov = np.eye(3) * 4.0
    rng = np.random.default_rng(2)
    for t in range(1, 50):
        kalman.propagate(float(t))
        pos_e = kalman.pos_e + rng.standard_normal(3) * 0.1
        m = measurements.position(kalman.state, kalman.model.size, pos_e, cov, np.zeros(3))
        m = measurements.with_shared_error(
            m, SHARED * cov, kalman.model.fix_bias, kalman.gnss.fix_bias
        )
        if t == 20:
            kalman.reconsider(*kalman.gnss.other_satellites(kalman.P, 0.5))
            kalman.reconsider(*kalman.gnss.clock_forgotten(kalman.P))
        kalman.update(m)
    filtered = kalman.rows.copy()
    smoothed = smooth(kalman.tape, kalman.P)
    first = layout.ROW_COV
    i, j = np.triu_indices(3)
    for rows_f, rows_s in zip(filtered, smoothed, strict=True):
        gain = np.zeros((3, 3))
        gain[i, j] = gain[j, i] = rows_f[first : first + 6] - rows_s[first : first + 6]
        assert np.linalg.eigvalsh(gain).min() > -1e-7
