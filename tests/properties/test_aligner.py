"""What must not matter to the aligner, and to Doppler least squares, does not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from certnav.alignment.problem import ClockModel, build_problem
from certnav.alignment.reference.simulation import simulate_window
from certnav.alignment.solver.fast_solver import fast_minimum
from certnav.alignment.status import AlignmentStatus
from certnav.velocity.least_squares import doppler_velocity
from certnav.velocity.range_rate import DopplerRows

SIGMA = 0.05
seeds = st.integers(0, 2**32 - 1)
clocks = st.sampled_from(
    [ClockModel(), ClockModel("linear"), ClockModel("per-epoch"), ClockModel("random-walk", 0.1)]
)


@st.composite
def windows(draw):
    """A simulated window of noisy rows, six satellites, over hills."""
    rng = np.random.default_rng(draw(seeds))
    return simulate_window(rng, 6, sigma=SIGMA, speed=10.0)


@st.composite
def rotations(draw):
    return Rotation.random(rng=np.random.default_rng(draw(seeds))).as_matrix()


def solved(rows, clock=None):
    problem = build_problem(rows, clock)
    minimum = fast_minimum(problem.Q)
    assert minimum.status is AlignmentStatus.CERTIFIED
    return minimum, problem


def same(found, expected, factor=1.0):
    """Rotations agree to 1 µrad, costs to 1e-7."""
    np.testing.assert_allclose(found.C, expected.C, atol=1e-6)
    assert found.cost == pytest.approx(factor * expected.cost, rel=1e-7)


@given(windows(), clocks, rotations())
def test_turning_the_earth_turns_the_answer(window, clock, R):
    before, _ = solved(window.rows, clock)
    after, _ = solved(dataclasses.replace(window.rows, e_e=window.rows.e_e @ R.T), clock)
    np.testing.assert_allclose(after.C, R @ before.C, atol=1e-6)
    assert after.cost == pytest.approx(before.cost, rel=1e-7)


@given(windows(), clocks, rotations())
def test_turning_the_local_frame_turns_the_answer(window, clock, R):
    before, _ = solved(window.rows, clock)
    after, _ = solved(dataclasses.replace(window.rows, vel_w=window.rows.vel_w @ R.T), clock)
    np.testing.assert_allclose(after.C, before.C @ R.T, atol=1e-6)
    assert after.cost == pytest.approx(before.cost, rel=1e-7)


@given(windows(), clocks, st.floats(-1e6, 1e6), st.integers(-1000, 1000))
def test_time_has_no_origin(window, clock, shift, epochs):
    before, _ = solved(window.rows, clock)
    rows = dataclasses.replace(
        window.rows, time=window.rows.time + shift, epoch=window.rows.epoch + epochs
    )
    same(solved(rows, clock)[0], before)


@given(windows(), clocks, seeds)
def test_rows_have_no_order(window, clock, seed):
    before, _ = solved(window.rows, clock)
    order = np.random.default_rng(seed).permutation(len(window.rows))
    same(solved(window.rows.take(order), clock)[0], before)


@given(windows(), st.floats(1e-3, 1e3))
def test_scaling_sigma_scales_the_cost_alone(window, factor):
    for kind in ("constant", "linear", "per-epoch", "random-walk"):
        q = 0.1 if kind == "random-walk" else None
        before, _ = solved(window.rows, ClockModel(kind, q))
        rows = dataclasses.replace(window.rows, sigma=factor * window.rows.sigma)
        after, _ = solved(rows, ClockModel(kind, None if q is None else factor * q))
        same(after, before, factor**-2.0)


@given(windows(), st.floats(-1e6, 1e6))
def test_a_common_clock_drift_is_the_nuisance(window, drift):
    before, problem = solved(window.rows)
    rows = dataclasses.replace(window.rows, z=window.rows.z - drift)
    after, moved = solved(rows)
    np.testing.assert_allclose(after.C, before.C, atol=1e-6)
    found = moved.nuisance_at(after.C)[0] - problem.nuisance_at(before.C)[0]
    assert found == pytest.approx(drift, abs=1e-6)


@st.composite
def epochs(draw):
    """Doppler rows of an open sky: satellites around and above."""
    rng = np.random.default_rng(draw(seeds))
    n = draw(st.integers(6, 14))
    up = rng.uniform(0.15, 1.0, n)
    azimuth = 2.0 * np.pi * (np.arange(n) + rng.uniform(0.0, 0.5, n)) / n
    flat = np.sqrt(1.0 - up**2)
    e_e = np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), up])
    e_e = e_e @ Rotation.random(rng=rng).as_matrix()
    sigma = rng.uniform(0.02, 0.5, n)
    z = e_e @ rng.uniform(-40.0, 40.0, 3) + rng.uniform(-1e3, 1e3) + sigma * rng.normal(size=n)
    names = np.array([f"G{k + 1:02d}" for k in range(n)])
    return DopplerRows(np.arange(n), names, e_e, z, sigma)


def velocity(rows):
    found = doppler_velocity(rows, 0.0, significance=1e-12, max_dop=1e3)
    assert found.ok
    return found


@given(epochs(), seeds)
def test_doppler_rows_have_no_order(rows, seed):
    order = np.random.default_rng(seed).permutation(len(rows))
    before, after = velocity(rows), velocity(rows.take(order))
    np.testing.assert_allclose(after.vel_e, before.vel_e, atol=1e-9)
    np.testing.assert_allclose(after.cov_e, before.cov_e, rtol=1e-7, atol=1e-12)
    assert after.chi2 == pytest.approx(before.chi2, rel=1e-6, abs=1e-9)
    assert set(after.satellites) == set(before.satellites)


@given(epochs(), st.floats(-1e5, 1e5))
def test_a_common_clock_drift_leaves_the_velocity_alone(rows, drift):
    before = velocity(rows)
    after = velocity(dataclasses.replace(rows, z=rows.z - drift))
    np.testing.assert_allclose(after.vel_e, before.vel_e, atol=1e-7)
    np.testing.assert_allclose(after.cov_e, before.cov_e, rtol=1e-6)
    assert after.clock_drift - before.clock_drift == pytest.approx(drift, abs=1e-7)


@given(epochs(), rotations())
def test_turning_the_sky_turns_the_velocity(rows, R):
    before, after = velocity(rows), velocity(dataclasses.replace(rows, e_e=rows.e_e @ R.T))
    np.testing.assert_allclose(after.vel_e, R @ before.vel_e, atol=1e-8)
    np.testing.assert_allclose(after.cov_e, R @ before.cov_e @ R.T, rtol=1e-6, atol=1e-10)
