"""The filter: honest covariance, the gate, and noise-free recovery."""

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2

from certnav.datasets.series import ImuData
from certnav.datasets.simulation.sensors import fixes_from_truth, imu_measurements
from certnav.filters import measurements
from certnav.filters.compiled import rows as layout
from certnav.filters.earth import C_en_of
from certnav.filters.ekf import ErrorStateFilter
from certnav.filters.error_model import ErrorModel
from certnav.filters.errors import DataError
from certnav.filters.measurement_update import gate_limit
from certnav.filters.rotation import matrix_from_rotvec
from certnav.filters.sensors import imu_preset
from certnav.filters.strapdown import InertialStream, NavState

LEVER = np.array([-0.65, -0.05, -0.15])
RATE = 50.0


def run(trajectory, model, imu, fixes, state, P, gate=0.0):
    """Filter a drive with positions and velocities; return the filter and all NIS."""
    stream = InertialStream(imu.time, imu.gyro_b, imu.accel_b)
    kalman = ErrorStateFilter(model, stream, state, P, output_interval=1.0)
    nis = []
    for t, pos, pos_cov, vel, vel_cov in zip(
        fixes.time, fixes.pos_e, fixes.pos_cov_e, fixes.vel_e, fixes.vel_cov_e, strict=True
    ):
        kalman.propagate(t)
        m = measurements.position(kalman.state, model.states, pos, pos_cov, LEVER)
        nis.append(kalman.update(m, gate).nis)
        m = measurements.velocity(kalman.state, model.states, vel, vel_cov, LEVER, kalman.omega_b)
        nis.append(kalman.update(m, gate).nis)
    kalman.propagate(stream.end)
    return kalman, np.array(nis)


def errors_and_nees(rows, trajectory):
    """NEES (m, 3) of position, velocity and attitude: true − estimated, attitude in body axes."""
    truth = trajectory.kinematics(rows[:, 0])
    delta_C = np.swapaxes(rows[:, 7:16].reshape(-1, 3, 3), 1, 2) @ truth.C_eb
    phi = 0.5 * np.stack(
        [
            delta_C[:, 2, 1] - delta_C[:, 1, 2],
            delta_C[:, 0, 2] - delta_C[:, 2, 0],
            delta_C[:, 1, 0] - delta_C[:, 0, 1],
        ],
        axis=-1,
    )
    errors = [truth.pos_e - rows[:, 1:4], truth.vel_e - rows[:, 4:7], phi]
    nees = []
    for block, error in enumerate(errors):
        cov = np.empty((len(rows), 3, 3))
        i, j = np.triu_indices(3)
        start = layout.ROW_COV + 6 * block
        cov[:, i, j] = cov[:, j, i] = rows[:, start : start + 6]
        nees.append(np.einsum("ki,ki->k", error, np.linalg.solve(cov, error[..., None])[..., 0]))
    return errors, np.stack(nees, axis=-1)


def drawn_start(trajectory, time, model, rng):
    """A start whose error is drawn from the covariance it is handed over with."""
    k = trajectory.kinematics(np.array([time]))
    C_bn = k.C_eb[0].T @ C_en_of(k.pos_e[0])
    tilt = C_bn @ np.diag(np.radians([1.0, 1.0, 4.0]) ** 2) @ C_bn.T
    P = model.initial_covariance(np.eye(3) * 2.0**2, np.eye(3) * 0.2**2, tilt)
    error = np.linalg.cholesky(P[:9, :9]) @ rng.standard_normal(9)
    return NavState(
        time, k.pos_e[0] - error[0:3], k.vel_e[0] - error[3:6],
        k.C_eb[0] @ matrix_from_rotvec(error[6:9]).T,
    ), P  # fmt: skip


@pytest.mark.parametrize("preset", ["adis16470", "tactical"])
def test_nees_over_fifty_seeds(city_drive, preset):
    """Mean NEES over 50 runs stays inside the 95 % bounds of χ² for 95 % of the time."""
    spec, runs, duration = imu_preset(preset), 50, 150.0
    model = ErrorModel(spec)
    start = city_drive.span[0] + 30.0
    time = start + np.arange(1, int(duration * RATE) + 1) / RATE
    exact, _, _ = imu_measurements(city_drive, time, spec, np.random.default_rng(0), noise=False)
    epochs = start + np.arange(1.0, duration) + 0.0137
    nees, nis = [], []
    for seed in range(runs):
        rng = np.random.default_rng([7, seed])
        imu = with_errors(exact, spec, rng)
        fixes = fixes_from_truth(city_drive, epochs, LEVER, (1.0, 1.0, 2.0), 0.1, rng)
        state, P = drawn_start(city_drive, start, model, rng)
        kalman, run_nis = run(city_drive, model, imu, fixes, state, P)
        nees.append(errors_and_nees(kalman.rows, city_drive)[1])
        nis.append(run_nis)
    mean = np.mean(nees, axis=0)
    low, high = chi2.ppf([0.025, 0.975], 3 * runs) / runs
    inside = ((mean > low) & (mean < high)).mean(axis=0)
    overall = mean.mean(axis=0)
    assert np.all((overall > low) & (overall < high)), overall
    # Epochs of one run are correlated, so the share is itself noisy: 85 % for a nominal 95 %.
    assert np.all(inside > 0.85), inside
    assert np.mean(nis) == pytest.approx(3.0, abs=0.05)


def with_errors(exact, spec, rng):
    """Add a fresh draw of this sensor's errors to exact means: one quadrature for all runs.

    Bias: a turn-on constant, plus a Gauss–Markov part that begins in its steady state.
    """
    dt, n = exact.interval, len(exact)

    def errors(turn_on, in_run, density):
        decay = np.exp(-dt / spec.bias_correlation_time_s)
        driven = in_run * np.sqrt(1 - decay**2) * rng.standard_normal((n, 3))
        driven[0] = in_run * rng.standard_normal(3)
        wander = lfilter([1.0], [1.0, -decay], driven, axis=0)
        white = density / np.sqrt(dt) * rng.standard_normal((n, 3))
        return turn_on * rng.standard_normal(3) + wander + white

    gyro = errors(spec.gyro_bias_initial_sigma, spec.gyro_bias_sigma, spec.gyro_noise_density)
    accel = errors(spec.accel_bias_initial_sigma, spec.accel_bias_sigma, spec.accel_noise_density)
    return ImuData(exact.time, exact.gyro_b + gyro, exact.accel_b + accel)


@pytest.mark.parametrize("states", [15, 21])
def test_exact_data_are_recovered(city_drive, states):
    """Without noise, a wrong start (degrees, metres) converges to the truth, biases to zero."""
    model = ErrorModel(imu_preset("adis16470"), states)
    rng = np.random.default_rng(5)
    start = city_drive.span[0] + 30.0
    time = start + np.arange(1, 500 * 50) / RATE
    imu, _, _ = imu_measurements(city_drive, time, model.imu, rng, noise=False)
    fixes = fixes_from_truth(city_drive, start + np.arange(1.0, 499.0), LEVER, 0.0, 0.0, rng)
    # Exact values, believed to a centimetre: believed to 1 µm they would freeze in what the
    # linearisation of the first seconds leaves.
    centimetre = np.tile(np.eye(3) * 0.01**2, (len(fixes), 1, 1))
    fixes = dataclasses.replace(fixes, pos_cov_e=centimetre, vel_cov_e=centimetre)
    state, P = drawn_start(city_drive, start, model, rng)
    kalman, _ = run(city_drive, model, imu, fixes, state, P)
    errors, _ = errors_and_nees(kalman.rows[-20:], city_drive)
    position, velocity, attitude = (np.abs(e).max() for e in errors)
    assert position < 2e-4
    assert velocity < 2e-4
    assert np.degrees(attitude) < 3e-4
    assert np.abs(kalman.bias[:3]).max() < np.radians(0.1) / 3600
    assert np.abs(kalman.bias[3:6]).max() < 2e-4


def test_covariance_stays_symmetric_positive_definite(city_drive):
    model = ErrorModel(imu_preset("adis16470"), 21)
    rng = np.random.default_rng(6)
    start = city_drive.span[0] + 30.0
    time = start + np.arange(1, 1001) / RATE
    imu, _, _ = imu_measurements(city_drive, time, model.imu, rng)
    fixes = fixes_from_truth(city_drive, start + np.arange(1.0, 19.0), LEVER, 0.01, 0.01, rng)
    state, P = drawn_start(city_drive, start, model, rng)
    kalman, _ = run(city_drive, model, imu, fixes, state, P)
    scale = np.sqrt(np.diag(kalman.P))
    assert np.linalg.eigvalsh(kalman.P / np.outer(scale, scale)).min() > 1e-9
    np.testing.assert_array_equal(kalman.P, kalman.P.T)


def test_gate_refuses_a_jump_and_leaves_the_state_alone(city_drive):
    model = ErrorModel(imu_preset("adis16470"))
    rng = np.random.default_rng(8)
    start = city_drive.span[0] + 30.0
    time = start + np.arange(1, 501) / RATE
    imu, _, _ = imu_measurements(city_drive, time, model.imu, rng, noise=False)
    k = city_drive.kinematics(np.array([start]))
    stream = InertialStream(imu.time, imu.gyro_b, imu.accel_b)
    P = model.initial_covariance(np.eye(3), np.eye(3) * 0.01, np.eye(3) * 1e-4)
    kalman = ErrorStateFilter(model, stream, NavState(start, k.pos_e[0], k.vel_e[0], k.C_eb[0]), P)
    kalman.propagate(start + 1.0)
    antenna = city_drive.pos_e(np.array([start + 1.0]), LEVER)[0]
    before = kalman.pos_e.copy(), kalman.P.copy()
    shifted = antenna + np.array([40.0, 0.0, 0.0])
    jump = measurements.position(kalman.state, 15, shifted, np.eye(3), LEVER)
    outcome = kalman.update(jump, gate_probability=1e-4)
    assert not outcome.accepted and outcome.nis > outcome.limit
    np.testing.assert_array_equal(kalman.pos_e, before[0])
    np.testing.assert_array_equal(kalman.P, before[1])
    assert kalman.update(jump, gate_probability=0.0).accepted  # the gate can be switched off
    np.testing.assert_allclose(outcome.whitened @ outcome.whitened, outcome.nis)


def test_gate_limit_is_the_chi_square_quantile():
    assert gate_limit(3, 1e-4) == pytest.approx(chi2.isf(1e-4, 3), rel=1e-12)
    assert gate_limit(3, 0.0) == float("inf")


def test_rows_hold_the_updated_state_and_the_requested_rate(city_drive):
    model = ErrorModel(imu_preset("adis16470"))
    start = city_drive.span[0] + 30.0
    time = start + np.arange(1, 501) / RATE
    imu, _, _ = imu_measurements(city_drive, time, model.imu, np.random.default_rng(9))
    stream = InertialStream(imu.time, imu.gyro_b, imu.accel_b)
    k = city_drive.kinematics(np.array([start]))
    state = NavState(start, k.pos_e[0], k.vel_e[0], k.C_eb[0])
    kalman = ErrorStateFilter(model, stream, state, np.eye(15) * 1e-2, output_interval=0.1)
    kalman.propagate(start + 5.0)
    shifted = city_drive.pos_e(np.array([start + 5.0]), LEVER)[0] + [0.5, 0, 0]
    kalman.update(measurements.position(kalman.state, 15, shifted, np.eye(3) * 1e-4, LEVER))
    np.testing.assert_allclose(kalman.rows[-1, 1:4], kalman.pos_e)
    np.testing.assert_allclose(np.diff(kalman.rows[:, 0]), 0.1, atol=1e-6)
    assert kalman.rows[0, 0] == start


# --- what becomes of an update ---------------------------------------------------------------


def standing(model, P):
    """A filter that stands on the equator, with a second of samples."""
    stream = InertialStream(np.arange(1.0, 9.0), np.zeros((8, 3)), np.zeros((8, 3)))
    state = NavState(1.0, np.array([6378137.0, 0.0, 0.0]), np.zeros(3), np.eye(3))
    return ErrorStateFilter(model, stream, state, P)


def test_every_state_is_fed_back_where_it_belongs():
    """A measurement of one error state alone moves that quantity by as much, and no other."""
    model = ErrorModel(
        imu_preset("adis16470"), 21, odometer=True, clock_walk=0.1, fix_correlation=10.0
    )
    assert model.size == 26
    quantities = {
        "pos_e": range(3), "vel_e": range(3, 6), "bias": range(9, 21),
        "clock_drift": [21], "fix_bias": range(22, 25), "odometer_scale": [25],
    }  # fmt: skip

    def read(kalman):
        parts = {name: getattr(kalman, name) for name in ("pos_e", "vel_e", "bias")}
        parts |= {name: getattr(kalman.gnss, name) for name in ("clock_drift", "fix_bias")}
        parts["odometer_scale"] = kalman.odometer_scale
        return {name: np.atleast_1d(np.array(value)) for name, value in parts.items()}

    for k in range(26):
        kalman = standing(model, np.eye(26))
        before, attitude = read(kalman), kalman.C_eb.copy()
        H = np.eye(26)[k : k + 1]
        kalman.update(measurements.Measurement(np.array([1e-3]), H, np.array([[1e-12]])))
        for name, states in quantities.items():
            expected = [1e-3 if j == k else 0.0 for j in states]
            np.testing.assert_allclose(
                read(kalman)[name] - before[name], expected, atol=2e-9, err_msg=f"{k} {name}"
            )
        turn = 1e-3 * np.eye(26)[k, 6:9]
        np.testing.assert_allclose(
            kalman.C_eb, attitude @ matrix_from_rotvec(turn), atol=1e-9, err_msg=str(k)
        )


def position_off_by(kalman, metres, sigma=1.0):
    """A position that many metres east of where the filter is."""
    pos_e = kalman.pos_e + np.array([0.0, metres, 0.0])
    return measurements.position(kalman.state, 15, pos_e, np.eye(3) * sigma**2, np.zeros(3))


def test_enlarging_stops_where_the_innovation_is_what_is_expected_of_it():
    """In steps of a fifth, all of P alike, so that correlations stay."""
    P = 0.01 * (np.eye(15) + 0.3)
    kalman = standing(ErrorModel(imu_preset("adis16470")), P)
    m = position_off_by(kalman, 0.4, sigma=0.05)
    factor = kalman.enlarge(m)
    np.testing.assert_allclose(kalman.P, factor * P, rtol=1e-12)

    def nis(f):
        return m.z @ np.linalg.solve(f * m.H @ P @ m.H.T + m.R, m.z)

    assert 1.2 < factor < 10.0
    assert nis(factor) <= 3.0 < nis(factor / 1.2)


def test_enlarging_has_its_limits():
    P = 0.01 * np.eye(15)
    model = ErrorModel(imu_preset("adis16470"))
    kalman = standing(model, P)
    assert kalman.enlarge(position_off_by(kalman, 1e4)) == 10.0  # of one run of bad ones
    kalman = standing(model, P)
    assert kalman.enlarge(position_off_by(kalman, 1e4), limit=3.0) == 3.0
    # A kilometre, 30 m/s or a radian is lost, and then there is nothing more to enlarge.
    for lost in ([500.0, 0.1, 0.01], [1.0, 15.0, 0.01], [1.0, 0.1, 0.5]):
        sigma = np.concatenate([np.repeat(lost, 3), np.full(6, 1e-4)])
        kalman = standing(model, np.diag(sigma**2))
        assert kalman.enlarge(position_off_by(kalman, 1e6)) == pytest.approx(4.0)
        assert kalman.enlarge(position_off_by(kalman, 1e6)) == 1.0
    calm = standing(model, P)
    assert calm.enlarge(position_off_by(calm, 0.1)) == 1.0
    np.testing.assert_array_equal(calm.P, P)


@pytest.mark.parametrize("way", ["enlarge", "doubt"])
def test_a_doubted_filter_knows_the_errors_of_fixes_as_before(way):
    """Or they take in what the solution is off by. They stay correlated as they were."""
    model = ErrorModel(imu_preset("adis16470"), fix_correlation=1000.0)
    root = np.random.default_rng(5).normal(size=(model.size, model.size))
    P = 1e-3 * root @ root.T / model.size
    kalman = standing(model, P)
    m = position_off_by(kalman, 60.0)
    wider = np.hstack([m.H, np.zeros((3, model.size - m.H.shape[1]))])
    getattr(kalman, way)(dataclasses.replace(m, H=wider))
    bias, sigma = model.fix_bias, np.sqrt(np.diag(kalman.P))
    assert (np.diag(kalman.P)[bias] <= np.diag(P)[bias] * (1.0 + 1e-12)).all()
    assert kalman.P[0, 0] > 2.0 * P[0, 0]
    np.linalg.cholesky(kalman.P)
    if way == "enlarge":
        was = np.sqrt(np.diag(P))
        np.testing.assert_allclose(kalman.P / np.outer(sigma, sigma), P / np.outer(was, was))


def test_doubting_stops_where_the_innovation_is_what_is_expected_of_it():
    """What H sees grows by the factor, what is correlated with it along, and nothing else."""
    P = np.eye(15) + 0.3
    kalman = standing(ErrorModel(imu_preset("adis16470")), P)
    m = position_off_by(kalman, 60.0)
    factor = kalman.doubt(m)
    seen = m.H @ P @ m.H.T

    def nis(f):
        return m.z @ np.linalg.solve(f * seen + m.R, m.z)

    assert nis(factor) <= 3.0 < nis(factor / 1.2) and factor > 10.0
    np.testing.assert_allclose(m.H @ kalman.P @ m.H.T, factor * seen, rtol=1e-9)
    # Of what H does not see, given what it sees, nothing has changed.
    rest = np.arange(3, 15)

    def given(P):
        across = P[np.ix_(rest, range(3))]
        return P[np.ix_(rest, rest)] - across @ np.linalg.solve(P[:3, :3], across.T)

    np.testing.assert_allclose(given(kalman.P), given(P), atol=1e-9)
    assert kalman.doubt(position_off_by(kalman, 1e6), limit=50.0) == 50.0
    assert kalman.doubt(position_off_by(kalman, 0.01)) == 1.0


def test_impossible_calls_are_refused(city_drive):
    model = ErrorModel(imu_preset("adis16470"))
    stream = InertialStream(np.arange(1.0, 9.0), np.zeros((8, 3)), np.zeros((8, 3)))
    state = NavState(1.0, np.array([6378137.0, 0, 0]), np.zeros(3), np.eye(3))
    with pytest.raises(DataError, match="covariance of shape"):
        ErrorStateFilter(model, stream, state, np.eye(9))
    with pytest.raises(DataError, match="outside the IMU data"):
        ErrorStateFilter(model, stream, NavState(99.0, *vars_of(state)), np.eye(15))
    kalman = ErrorStateFilter(model, stream, state, np.eye(15))
    kalman.propagate(4.0)
    with pytest.raises(DataError, match="cannot go back"):
        kalman.propagate(3.0)


def vars_of(state):
    return state.pos_e, state.vel_e, state.C_eb
