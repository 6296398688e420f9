"""The compiled update against filterpy's, and both against what an update has to do."""

import numpy as np
import pytest

from certnav.filters.ekf import ErrorStateFilter
from certnav.filters.error_model import ErrorModel
from certnav.filters.errors import DataError
from certnav.filters.measurement_update import compiled, innovation, turned, with_filterpy
from certnav.filters.measurements import Measurement, position
from certnav.filters.rotation import matrix_from_rotvec
from certnav.filters.sensors import imu_preset
from certnav.filters.strapdown import InertialStream, NavState


def covariance(rng, n):
    """Standard deviations over six decades, with correlations, as in a navigation filter."""
    A = rng.standard_normal((n, 2 * n)) * 10.0 ** rng.uniform(-4.0, 2.0, n)[:, None]
    return A @ A.T


@pytest.mark.parametrize("states", [15, 21, 22])
@pytest.mark.parametrize("rows", [1, 2, 3, 7])
def test_compiled_is_filterpy_to_rounding(states, rows):
    """To 10⁻¹² of each state's own σ."""
    rng = np.random.default_rng([states, rows])
    for _ in range(20):
        P = covariance(rng, states)
        sigma = np.sqrt(np.diag(P))
        H = rng.standard_normal((rows, states)) / sigma
        R = covariance(rng, rows) * 10.0 ** rng.uniform(-4.0, 0.0)
        m = Measurement(rng.standard_normal(rows), H, R)
        (x, after), (x_reference, reference) = compiled(P, m), with_filterpy(P, m)
        np.testing.assert_allclose(x / sigma, x_reference / sigma, rtol=1e-12, atol=1e-12)
        scale = np.outer(sigma, sigma)
        np.testing.assert_allclose(after / scale, reference / scale, rtol=1e-12, atol=1e-12)
        np.testing.assert_array_equal(after, after.T)


def test_information_adds_up():
    """P⁺⁻¹ = P⁻¹ + HᵀR⁻¹H and P⁺⁻¹x = HᵀR⁻¹z."""
    rng = np.random.default_rng(3)
    A = rng.standard_normal((6, 6))
    P, H = A @ A.T + np.eye(6), rng.standard_normal((2, 6))
    m = Measurement(rng.standard_normal(2), H, np.diag([0.5, 2.0]))
    x, after = compiled(P, m)
    information = H.T @ np.linalg.inv(m.R)
    np.testing.assert_allclose(np.linalg.inv(after), np.linalg.inv(P) + information @ H, rtol=1e-9)
    np.testing.assert_allclose(np.linalg.solve(after, x), information @ m.z, rtol=1e-9)


def test_innovation_is_whitened_by_the_cholesky_factor():
    rng = np.random.default_rng(4)
    P = covariance(rng, 15)
    m = Measurement(rng.standard_normal(3), rng.standard_normal((3, 15)), np.eye(3))
    S = m.H @ P @ m.H.T + m.R
    whitened, nis = innovation(P, m)
    np.testing.assert_allclose(np.linalg.cholesky(S) @ whitened, m.z, rtol=1e-9)
    assert nis == pytest.approx(m.z @ np.linalg.solve(S, m.z), rel=1e-9)


@pytest.mark.parametrize("R", [-np.eye(2), np.full((2, 2), np.nan), np.zeros((2, 2))])
def test_an_impossible_covariance_is_refused_in_one_line(R):
    m = Measurement(np.ones(2), np.zeros((2, 15)), R)
    for update in (innovation, compiled):
        with pytest.raises(DataError, match="not positive definite") as caught:
            update(np.eye(15), m)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 0.01, 1.0, 3.0])
def test_turned_is_the_exponential(size):
    rng = np.random.default_rng(5)
    C = matrix_from_rotvec([0.3, -1.0, 2.0])
    rotvec = rng.standard_normal(3)
    rotvec *= size / np.linalg.norm(rotvec)
    np.testing.assert_allclose(turned(C, rotvec), C @ matrix_from_rotvec(rotvec), atol=1e-15)


def test_a_filter_told_to_use_filterpy_ends_at_the_same_state():
    rng = np.random.default_rng(6)
    time = np.arange(1, 501) / 100.0
    stream = InertialStream(
        time, 0.1 * rng.standard_normal((500, 3)), rng.standard_normal((500, 3)) - [0.0, 0.0, 9.8]
    )
    state = NavState(0.005, [6378137.0, 10.0, 20.0], [1.0, 12.0, -3.0], np.eye(3))
    model = ErrorModel(imu_preset("adis16470"), 21)
    P = model.initial_covariance(np.eye(3), 0.01 * np.eye(3), 1e-4 * np.eye(3))
    ends = []
    for filterpy in (False, True):
        kalman = ErrorStateFilter(model, stream, state, P, filterpy=filterpy)
        noise = np.random.default_rng(7)
        for t in np.arange(0.5, 5.0, 0.5):
            kalman.propagate(t)
            at = kalman.pos_e + noise.standard_normal(3)
            kalman.update(position(kalman.state, 21, at, np.eye(3), [0.5, 0.0, -1.0]))
        kalman.propagate(5.0)
        ends.append(kalman)
    ours, theirs = ends
    np.testing.assert_allclose(ours.pos_e, theirs.pos_e, rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(ours.vel_e, theirs.vel_e, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(ours.C_eb, theirs.C_eb, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(ours.bias, theirs.bias, rtol=1e-9, atol=1e-15)
    sigma = np.sqrt(np.diag(theirs.P))
    scale = np.outer(sigma, sigma)
    np.testing.assert_allclose(ours.P / scale, theirs.P / scale, rtol=0.0, atol=1e-11)
