"""The filter under any sequence of measurements: a covariance, and no favourite time or place."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from certnav.filters import constraints, earth, measurements
from certnav.filters.ekf import ErrorStateFilter
from certnav.filters.error_model import ErrorModel
from certnav.filters.levers import VehiclePoint
from certnav.filters.measurements import Measurement
from certnav.filters.rotation import matrix_from_rotvec, matrix_from_rpy
from certnav.filters.sensors import imu_preset
from certnav.filters.strapdown import InertialStream, NavState
from oracles import rigs

LEVER = np.array([-0.65, -0.05, -0.15])
RATE = 50.0
SECONDS = 6.0
# Times are multiples of 2⁻⁷ s, so that shifting them by whole weeks is exact.
STEP = 1.0 / 128.0
seeds = st.integers(0, 2**32 - 1)


@dataclasses.dataclass(frozen=True)
class Step:
    """Propagate so far, then offer a measurement whose innovation has so many of its σ."""

    ticks: int
    kind: str
    sigma: float
    size: float


steps = st.lists(
    st.builds(
        Step,
        st.integers(0, 64),
        st.sampled_from(["position", "velocity", "doppler", "nhc", "zupt", "zaru", "enlarge"]),
        # from a millimetre to a kilometre (mm/s to km/s): as good and as bad as they come
        st.floats(-3.0, 3.0).map(lambda e: 10.0**e),
        st.floats(-3.0, 3.0),
    ),
    min_size=1,
    max_size=12,
)
starts = st.tuples(st.floats(-1.5, 1.5), st.floats(-3.1, 3.1), seeds)
models = st.builds(
    ErrorModel,
    st.sampled_from(["adis16470", "tactical", "consumer"]).map(imu_preset),
    st.sampled_from([15, 21]),
    st.sampled_from(["random-walk", "gauss-markov"]),
)


def make_filter(model, start, shift=0.0, turn=0.0, smoothing=False):
    """Return a filter on seconds of random driving; all times shifted, all axes turned."""
    lat, lon, seed = start
    rng = np.random.default_rng(seed)
    rpy = rng.uniform([-0.3, -0.3, -3.0], [0.3, 0.3, 3.0])
    C_en = earth.C_en_at(lat, lon)
    C_eb = C_en @ matrix_from_rpy(rpy)
    n = int(SECONDS * 128)
    time = shift + 1000.0 + STEP * np.arange(1, n + 1)
    gyro = rng.normal(0.0, 0.2, (n, 3))
    gravity_e = earth.gravity_e(earth.lla_to_ecef(lat, lon, 0.0))
    accel = rng.normal(0.0, 2.0, (n, 3)) - C_eb.T @ gravity_e
    R = matrix_from_rotvec([0.0, 0.0, turn])
    state = NavState(
        shift + 1000.0,
        R @ earth.lla_to_ecef(lat, lon, 30.0),
        R @ C_en @ [10.0, 5.0, 0.3],
        R @ C_eb,
    )
    tilt = np.diag(np.radians([0.5, 0.5, 3.0]) ** 2)
    P = model.initial_covariance(R @ np.diag([1.0, 2.0, 4.0]) @ R.T, 0.04 * np.eye(3), tilt)
    stream = InertialStream(time, gyro, accel)
    return ErrorStateFilter(model, stream, state, P, 0.25, smoothing=smoothing), rng


def offered(kalman, step, rng, turn):
    """Return the measurement of a step: predicted, off by `size` of its σ."""
    n = kalman.model.size
    R = matrix_from_rotvec([0.0, 0.0, turn])
    direction = R @ np.array([0.6, -0.48, 0.64])
    off = step.size * step.sigma * direction
    cov = step.sigma**2 * (R @ np.diag([1.0, 0.5, 2.0]) @ R.T)
    if step.kind == "position":
        antenna = measurements.antenna_position(kalman.state, LEVER)
        return measurements.position(kalman.state, n, antenna + off, cov, LEVER)
    antenna = measurements.antenna_velocity(kalman.state, kalman.omega_b, LEVER)
    if step.kind == "velocity":
        return measurements.velocity(kalman.state, n, antenna + off, cov, LEVER, kalman.omega_b)
    if step.kind == "doppler":
        e_e = rng.normal(size=(4, 3))
        e_e = (e_e / np.linalg.norm(e_e, axis=1)[:, None]) @ R.T
        z = e_e @ antenna + 300.0 + step.size * step.sigma * np.array([1.0, -0.5, 0.2, 0.0])
        sigma = np.full(4, step.sigma)
        return rigs.range_rates(kalman.state, n, e_e, z, sigma, LEVER, kalman.omega_b)
    if step.kind == "nhc":
        return constraints.non_holonomic(
            kalman.state, n, kalman.omega_b, VehiclePoint(np.eye(3), LEVER), (step.sigma,) * 2
        )
    if step.kind == "zupt":
        return constraints.zero_velocity(kalman.state, n, step.sigma)
    gyro_b = kalman.omega_b + kalman.bias[:3]
    return constraints.zero_rate(kalman.state, n, gyro_b, kalman.bias[:3], 1e-2 * step.sigma)


def run(kalman, plan, rng, turn=0.0, each=lambda kalman: None):
    for step in plan:
        kalman.propagate(kalman.time + STEP * step.ticks)
        each(kalman)
        if step.kind == "enlarge":
            m = offered(kalman, dataclasses.replace(step, kind="position"), rng, turn)
            kalman.enlarge(m)
        else:
            kalman.update(offered(kalman, step, rng, turn))
        each(kalman)
    return kalman


def check_covariance(kalman):
    P = kalman.P
    assert np.isfinite(P).all()
    np.testing.assert_array_equal(P, P.T)
    sigma = np.sqrt(np.diag(P))
    assert (sigma > 0.0).all()
    # in units of each state's own σ, which span ten decades
    assert np.linalg.eigvalsh(P / np.outer(sigma, sigma))[0] > -1e-12
    np.testing.assert_allclose(kalman.C_eb @ kalman.C_eb.T, np.eye(3), atol=1e-9)


@given(models, starts, steps)
def test_the_covariance_stays_symmetric_and_positive_definite(model, start, plan):
    kalman, rng = make_filter(model, start)
    run(kalman, plan, rng, each=check_covariance)


@given(models, starts, steps, st.integers(-2000, 3000))
def test_time_has_no_origin(model, start, plan, weeks):
    one, rng = make_filter(model, start)
    run(one, plan, rng)
    other, rng = make_filter(model, start, shift=604800.0 * weeks)
    run(other, plan, rng)
    sigma = np.sqrt(np.diag(one.P))
    np.testing.assert_allclose((other.P - one.P) / np.outer(sigma, sigma), 0.0, atol=1e-7)
    np.testing.assert_allclose(other.pos_e, one.pos_e, atol=1e-6)
    np.testing.assert_allclose(other.vel_e, one.vel_e, atol=1e-7)
    np.testing.assert_allclose(other.C_eb, one.C_eb, atol=1e-9)
    np.testing.assert_allclose(other.rows[:, 0] - 604800.0 * weeks, one.rows[:, 0], atol=1e-6)


@given(models, starts, steps, st.floats(-np.pi, np.pi))
def test_the_earth_has_no_first_meridian(model, start, plan, turn):
    """Everything turned about the Earth's axis comes out turned: the field is one of revolution."""
    one, rng = make_filter(model, start)
    run(one, plan, rng)
    other, rng = make_filter(model, start, turn=turn)
    run(other, plan, rng, turn)
    R = matrix_from_rotvec([0.0, 0.0, turn])
    T = np.eye(model.size)
    T[0:3, 0:3] = T[3:6, 3:6] = R
    expected = T @ one.P @ T.T
    sigma = np.sqrt(np.diag(expected))
    np.testing.assert_allclose((other.P - expected) / np.outer(sigma, sigma), 0.0, atol=1e-6)
    np.testing.assert_allclose(other.pos_e, R @ one.pos_e, atol=1e-5)
    np.testing.assert_allclose(other.vel_e, R @ one.vel_e, atol=1e-6)
    np.testing.assert_allclose(other.C_eb, R @ one.C_eb, atol=1e-8)
    np.testing.assert_allclose(other.bias, one.bias, atol=1e-8)


@given(starts, st.floats(-3.0, 3.0).map(lambda e: 10.0**e), st.floats(-3.0, 3.0))
def test_information_adds(start, sigma, size):
    """P⁻¹ grows by HᵀR⁻¹H: the update in information form, computed another way."""
    model = ErrorModel(imu_preset("adis16470"))
    kalman, rng = make_filter(model, start)
    kalman.propagate(kalman.time + 1.0)
    before = kalman.P.copy()
    m: Measurement = offered(kalman, Step(0, "position", sigma, size), rng, 0.0)
    kalman.update(m)
    scale = np.sqrt(np.diag(before))
    H = m.H * scale
    information = np.linalg.inv(before / np.outer(scale, scale)) + H.T @ np.linalg.solve(m.R, H)
    expected = np.linalg.inv(information)
    found = kalman.P / np.outer(scale, scale)
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert np.linalg.eigvalsh(before / np.outer(scale, scale) - found)[0] > -1e-9


def test_the_plan_is_what_it_says():
    """Guards the tests above: measurements are applied, and they change the state."""
    model = ErrorModel(imu_preset("adis16470"))
    kalman, rng = make_filter(model, (0.5, 1.0, 1))
    before = kalman.pos_e.copy()
    run(kalman, [Step(0, "position", 0.1, 3.0)], rng)
    assert np.linalg.norm(kalman.pos_e - before) == pytest.approx(0.3, rel=0.05)
