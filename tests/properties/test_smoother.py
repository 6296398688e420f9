"""Smoothing can only add information: P_smoothed ≤ P_filtered, whatever was measured."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from certnav.filters import earth, measurements
from certnav.filters.compiled import rows as layout
from certnav.filters.ekf import ErrorStateFilter
from certnav.filters.error_model import ErrorModel
from certnav.filters.rotation import matrix_from_rpy
from certnav.filters.sensors import imu_preset
from certnav.filters.smoother import smooth
from certnav.filters.strapdown import InertialStream, NavState

LEVER = np.array([-0.65, -0.05, -0.15])
SECONDS, HZ = 5.0, 100

plans = st.lists(
    st.tuples(
        st.floats(0.0, 1.0),
        st.sampled_from(["position", "velocity", "nothing"]),
        st.floats(-2.0, 2.0).map(lambda e: 10.0**e),
        st.floats(-3.0, 3.0),
    ),
    min_size=1,
    max_size=10,
)
models = st.builds(
    ErrorModel,
    st.sampled_from(["adis16470", "consumer"]).map(imu_preset),
    st.sampled_from([15, 21]),
)


def run(model, plan, seed):
    rng = np.random.default_rng(seed)
    lat, lon = rng.uniform(-1.4, 1.4), rng.uniform(-3.0, 3.0)
    C_en = earth.C_en_at(lat, lon)
    C_eb = C_en @ matrix_from_rpy(rng.uniform([-0.1, -0.1, -3.0], [0.1, 0.1, 3.0]))
    pos_e = earth.lla_to_ecef(lat, lon, 30.0)
    n = int(SECONDS * HZ)
    gyro = rng.normal(0.0, 0.1, (n, 3))
    accel = rng.normal(0.0, 1.0, (n, 3)) - C_eb.T @ earth.gravity_e(pos_e)
    stream = InertialStream(1000.0 + np.arange(1, n + 1) / HZ, gyro, accel)
    tilt = np.diag(np.radians([0.5, 0.5, 3.0]) ** 2)
    P = model.initial_covariance(np.diag([1.0, 2.0, 4.0]), 0.04 * np.eye(3), tilt)
    state = NavState(1000.0, pos_e, C_en @ [10.0, 5.0, 0.3], C_eb)
    kalman = ErrorStateFilter(model, stream, state, P, 0.25, smoothing=True)
    for wait, kind, sigma, size in plan:
        kalman.propagate(min(kalman.time + wait, stream.end))
        off, cov = size * sigma * np.array([0.6, -0.48, 0.64]), sigma**2 * np.eye(3)
        if kind == "position":
            at = measurements.antenna_position(kalman.state, LEVER)
            kalman.update(measurements.position(kalman.state, model.size, at + off, cov, LEVER))
        elif kind == "velocity":
            at = measurements.antenna_velocity(kalman.state, kalman.omega_b, LEVER)
            kalman.update(
                measurements.velocity(
                    kalman.state, model.size, at + off, cov, LEVER, kalman.omega_b
                )
            )
    kalman.propagate(stream.end)
    return kalman


def blocks(rows):
    """Return covariances of position, velocity and attitude, shape (3, m, 3, 3)."""
    out = np.empty((3, len(rows), 3, 3))
    i, j = np.triu_indices(3)
    for k in range(3):
        start = layout.ROW_COV + 6 * k
        out[k][:, i, j] = out[k][:, j, i] = rows[:, start : start + 6]
    return out


@given(models, plans, st.integers(0, 2**32 - 1))
def test_never_worse_than_the_filter(model, plan, seed):
    kalman = run(model, plan, seed)
    rows = smooth(kalman.tape, kalman.P)
    np.testing.assert_allclose(rows[:, 0], kalman.rows[:, 0], atol=1e-9)
    for filtered, smoothed in zip(blocks(kalman.rows), blocks(rows), strict=True):
        # in units of the filter's own σ: no direction gets less certain, none becomes impossible
        L = np.linalg.inv(np.linalg.cholesky(filtered))
        share = np.linalg.eigvalsh(L @ smoothed @ np.swapaxes(L, 1, 2))
        assert share.max() <= 1.0 + 1e-6
        assert share.min() > 0.0
    bias = slice(layout.ROW_STD_BIAS, layout.ROW_STD_BIAS + 6)
    assert (rows[:, bias] <= kalman.rows[:, bias] * (1.0 + 1e-6)).all()


@given(models, plans, st.integers(0, 2**32 - 1))
def test_the_last_epoch_is_the_filters(model, plan, seed):
    kalman = run(model, plan, seed)
    rows = smooth(kalman.tape, kalman.P)
    np.testing.assert_allclose(rows[-1, 1:16], kalman.rows[-1, 1:16], atol=1e-6)
    np.testing.assert_allclose(blocks(rows)[:, -1], blocks(kalman.rows)[:, -1], rtol=1e-6)


@given(models, st.integers(0, 2**32 - 1))
def test_without_measurements_there_is_nothing_to_learn(model, seed):
    """Smoothing predictions alone gives them back."""
    kalman = run(model, [(1.0, "nothing", 1.0, 0.0)], seed)
    rows = smooth(kalman.tape, kalman.P)
    np.testing.assert_allclose(rows[:, 1:16], kalman.rows[:, 1:16], atol=1e-6)
    np.testing.assert_allclose(blocks(rows), blocks(kalman.rows), rtol=1e-5, atol=1e-12)
