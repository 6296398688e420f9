"""The cost matrix against residuals computed directly, and its nuisances against explicit ones."""

from __future__ import annotations

import dataclasses
import time
import tracemalloc

import numpy as np
import pytest

from certnav.alignment.problem import ClockModel, build_problem, design_matrix
from certnav.alignment.reference.earth_windows import earth_window
from certnav.alignment.reference.simulation import simulate_window
from certnav.alignment.rows import AlignmentRows
from certnav.alignment.solver.constraints import lift
from certnav.alignment.solver.elimination import project_out
from certnav.alignment.solver.refinement import rotation_angle
from certnav.alignment.verdict import align
from certnav.filters.errors import AlignmentError, ConfigError, DataError
from certnav.velocity.range_rate import DopplerRows

MODELS = [
    ClockModel(),
    ClockModel("linear"),
    ClockModel("per-epoch"),
    ClockModel("random-walk", 0.3),
]


def explicit_cost(rows, C_ew, clock, nuisance=None):
    """Weighted least squares over the nuisances at a fixed rotation: the slow, plain way."""
    residual = np.einsum("ki,ij,kj->k", rows.e_e, C_ew, rows.vel_w) - rows.z
    covariance = np.diag(rows.sigma**2)
    columns = -np.ones((len(rows), 1))
    if clock.kind == "linear":
        columns = np.column_stack([columns, -(rows.time - rows.time.mean())])
    if clock.kind == "per-epoch":
        columns = -(rows.epoch[:, None] == np.unique(rows.epoch)).astype(float)
    if clock.kind == "random-walk":
        t = rows.time - rows.time.min()
        covariance = covariance + clock.q**2 * np.minimum(t[:, None], t)
    if nuisance is not None:
        columns = np.column_stack([columns, nuisance])
    weight = np.linalg.inv(covariance)
    normal = columns.T @ weight @ columns
    parameters = -np.linalg.solve(normal, columns.T @ weight @ residual)
    left = residual + columns @ parameters
    return left @ weight @ left, parameters


@pytest.fixture
def rows(rng):
    window = simulate_window(rng, 5, sigma=0.1, clock_walk=0.1)
    spread = rng.uniform(0.03, 1.0, len(window.rows))
    return dataclasses.replace(window.rows, sigma=spread)


def test_design_matrix_is_the_residual_before_the_clock(rows, rotations):
    C = rotations[0]
    expected = [e @ C @ v - z for e, v, z in zip(rows.e_e, rows.vel_w, rows.z, strict=True)]
    np.testing.assert_allclose(design_matrix(rows) @ lift(C), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("clock", MODELS, ids=lambda m: m.kind)
def test_projection_equals_least_squares_over_the_clock(rows, rotations, clock):
    problem = build_problem(rows, clock)
    for C in rotations[:10]:
        cost, parameters = explicit_cost(rows, C, clock)
        assert problem.cost(C) == pytest.approx(cost, rel=1e-9)
        x = lift(C)
        assert x @ problem.Q @ x == pytest.approx(cost, rel=1e-9)
        np.testing.assert_allclose(problem.nuisance_at(C), parameters, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("clock", MODELS, ids=lambda m: m.kind)
def test_further_nuisances_are_projected_out_along_with_the_clock(rows, rotations, clock):
    problem = build_problem(rows, clock, rows.e_e)
    cost, parameters = explicit_cost(rows, rotations[1], clock, rows.e_e)
    assert problem.cost(rotations[1]) == pytest.approx(cost, rel=1e-9)
    np.testing.assert_allclose(problem.nuisance_at(rotations[1]), parameters, rtol=1e-6, atol=1e-6)
    assert problem.dof == build_problem(rows, clock).dof - 3


def test_unknown_start_velocity_costs_nothing_as_a_nuisance(rng):
    window = simulate_window(rng, 6)
    start = np.array([3.0, -7.0, 11.0])
    moved = dataclasses.replace(window.rows, z=window.rows.z + window.rows.e_e @ start)
    problem = build_problem(moved, nuisance=moved.e_e)
    assert problem.cost(window.C_ew) < 1e-18
    np.testing.assert_allclose(problem.nuisance_at(window.C_ew)[1:], start, atol=1e-9)


def test_truth_has_zero_cost_and_the_true_clock(windows):
    for window, problem in windows(20, 3):
        assert problem.cost(window.C_ew) < 1e-18
        assert problem.nuisance_at(window.C_ew)[0] == pytest.approx(190.3, abs=1e-9)


@pytest.mark.parametrize("drift", [1e4, 1e6])
def test_projected_rows_keep_the_digits_a_schur_complement_loses(rng, drift):
    window = simulate_window(rng, 4, clock_drift=drift, assumed_sigma=1.0)
    problem = build_problem(window.rows)
    # z carries the drift: its own rounding, 1e6·eps, is all that may be left.
    assert problem.cost(window.C_ew) < 1e3 * (drift * np.finfo(float).eps) ** 2
    B, ones = design_matrix(window.rows), np.ones(len(window.rows))
    schur = B.T @ B - np.outer(B.T @ ones, ones @ B) / len(ones)
    x = lift(window.C_ew)
    assert abs(x @ schur @ x) > 1e3 * abs(x @ problem.Q @ x)


def test_cost_at_the_truth_is_chi_square(windows):
    drawn = windows(300, 4, sigma=0.2)
    costs = np.array([problem.cost(window.C_ew) for window, problem in drawn])
    dof = drawn[0][1].dof + 3
    assert dof == 39  # 40 rows, one clock
    assert costs.mean() == pytest.approx(dof, abs=4.0 * np.sqrt(2.0 * dof / 300))


def test_random_walk_has_constant_and_per_epoch_clocks_as_limits(rows):
    still = build_problem(rows, ClockModel("random-walk", 0.0))
    np.testing.assert_allclose(still.Q, build_problem(rows).Q, rtol=1e-10, atol=1e-8)
    wild = build_problem(rows, ClockModel("random-walk", 1e4))
    free = build_problem(rows, ClockModel("per-epoch"))
    np.testing.assert_allclose(wild.Q, free.Q, atol=1e-6 * np.trace(free.Q))


def many_rows(rng, k, per_epoch=8):
    """Return k rows, eight an epoch, in an order that is not that of time."""
    order, epoch = rng.permutation(k), np.arange(k) // per_epoch
    e = rng.normal(size=(k, 3))
    e /= np.linalg.norm(e, axis=1, keepdims=True)
    vel = 10.0 * np.stack([np.sin(epoch / 20.0), np.cos(epoch / 17.0), np.sin(epoch / 9.0)], -1)
    walk = np.cumsum(0.1 * np.sqrt(0.2) * rng.normal(size=epoch[-1] + 1))[epoch]
    sigma = rng.uniform(0.03, 0.3, k)
    z = np.einsum("ki,ki->k", e, vel) - 100.0 - walk + sigma * rng.normal(size=k)
    rows = AlignmentRows(e, vel, z, sigma, epoch, 0.2 * epoch)
    return rows.take(order)


@pytest.mark.parametrize("q", [1e-6, 0.1, 10.0])
def test_whitened_rows_have_unit_covariance_in_any_order(rng, q):
    rows = many_rows(rng, 60)
    elapsed = rows.time - rows.time.min()
    covariance = np.diag(rows.sigma**2) + q**2 * np.minimum.outer(elapsed, elapsed)
    root = np.linalg.cholesky(covariance)
    np.testing.assert_allclose(
        (white := ClockModel("random-walk", q).whiten(rows, root)) @ white.T, np.eye(60), atol=1e-9
    )


def test_a_walking_clock_costs_time_and_memory_in_proportion_to_the_rows(rng):
    clock, rows = ClockModel("random-walk", 0.1), many_rows(rng, 100_000)
    build_problem(rows.take(slice(80)), clock)  # compiled
    tracemalloc.start()
    began = time.process_time()
    problem = build_problem(rows, clock, rows.e_e)
    took, (_, peak) = time.process_time() - began, tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert took < 2.0 and peak < 300e6
    assert problem.cost(np.eye(3)) / problem.dof == pytest.approx(1.0, abs=0.02)


def test_linear_clock_absorbs_a_drift_rate_that_the_constant_one_does_not(rng):
    window = simulate_window(rng, 4, clock_rate=0.1)
    assert build_problem(window.rows, ClockModel("linear")).cost(window.C_ew) < 1e-16
    assert build_problem(window.rows).cost(window.C_ew) > 1.0


def test_factor_squares_to_the_cost_matrix(rows):
    problem = build_problem(rows)
    np.testing.assert_allclose(problem.factor.T @ problem.factor, problem.Q, rtol=1e-13)
    np.testing.assert_array_equal(problem.factor, np.triu(problem.factor))


def test_project_out_copes_with_dependent_and_empty_columns(rng):
    matrix, columns = rng.normal(size=(12, 4)), rng.normal(size=(12, 2))
    dependent = np.column_stack([columns, columns @ [[1.0], [2.0]], np.zeros(12)])
    projected, rank = project_out(matrix, dependent)
    assert rank == 2
    assert np.abs(columns.T @ projected).max() < 1e-14
    untouched, rank = project_out(matrix, np.zeros((12, 0)))
    assert rank == 0
    np.testing.assert_array_equal(untouched, matrix)


def test_project_out_leaves_nothing_of_a_huge_column(rng):
    # One pass leaves eps times what it removed.
    columns = rng.uniform(1.0, 2.0, size=(30, 2))
    left, _ = project_out(rng.normal(size=(30, 1)) + 1e8 * columns[:, :1], columns)
    assert np.linalg.norm(columns.T @ left) < 1e-13 * 30


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("z", [np.nan, 0.0], r"z: not finite at index 0"),
        ("vel_w", np.zeros((2, 2)), r"vel_w: expected shape \(2, 3\), found \(2, 2\)"),
        ("e_e", [[1.0, 0, 0], [2.0, 0, 0]], r"e_e: expected a unit vector, found 2 at index 1"),
        ("sigma", [1.0, 0.0], r"sigma: expected a positive 1σ, found 0 at index 1"),
        ("epoch", [0.0, 1.0], r"epoch: expected 2 integers"),
    ],
)
def test_rows_refuse_what_is_wrong_by_name_and_index(field, value, message):
    good = {
        "e_e": np.eye(3)[:2], "vel_w": np.eye(3)[:2], "z": [1.0, 2.0], "sigma": [1.0, 1.0],
        "epoch": [0, 1], "time": [0.0, 1.0],
    }  # fmt: skip
    AlignmentRows(**good)
    with pytest.raises(DataError, match=message):
        AlignmentRows(**{**good, field: value})


def test_windows_without_information_are_refused(rng):
    rows = simulate_window(rng, 4).rows
    with pytest.raises(AlignmentError, match="no rows"):
        build_problem(rows.take(slice(0, 0)))
    with pytest.raises(AlignmentError, match="stands still"):
        build_problem(dataclasses.replace(rows, vel_w=np.zeros_like(rows.vel_w)))
    one_each = rows.take(slice(None, None, 4))
    with pytest.raises(AlignmentError, match="clock model takes up every row"):
        build_problem(one_each, ClockModel("per-epoch"))


def test_clock_models_are_declared_or_refused():
    with pytest.raises(ConfigError, match="did you mean 'per-epoch'"):
        ClockModel("per epoch")
    with pytest.raises(ConfigError, match="expected q ≥ 0"):
        ClockModel("random-walk")
    with pytest.raises(ConfigError, match="has no q"):
        ClockModel("constant", 0.1)


def test_shared_errors_are_unknowns_of_unit_variance(rows, rotations, rng):
    """Their rows written out: cost, estimate, and no degree of freedom lost."""
    common = rng.normal(0.0, 0.3, (len(rows), 2))
    clock = ClockModel("random-walk", 0.3)
    problem = build_problem(dataclasses.replace(rows, common=common), clock)
    C = rotations[3]
    # As noise with that covariance: another way to the same least squares.
    t = rows.time - rows.time.min()
    noise = np.diag(rows.sigma**2) + 0.09 * np.minimum(t[:, None], t) + common @ common.T
    residual = np.einsum("ki,ij,kj->k", rows.e_e, C, rows.vel_w) - rows.z
    weight, ones = np.linalg.inv(noise), np.ones(len(rows))
    left = residual - ones * (ones @ weight @ residual) / (ones @ weight @ ones)
    assert problem.cost(C) == pytest.approx(left @ weight @ left, rel=1e-9)
    assert problem.dof == build_problem(rows, clock).dof
    shared = -common.T @ weight @ left
    np.testing.assert_allclose(problem.nuisance_at(C)[1:], shared, rtol=1e-6, atol=1e-8)


def test_a_wrong_position_and_speed_are_found_among_the_unknowns(rng):
    """5 km and 3 % off, without noise: the rotation is the true one, the errors are named."""
    window = earth_window(rng, 6, 30.0, noise=False)
    off = np.array([3000.0, -2000.0, 3500.0])
    moved_e = window.track.moved_at(window.signals.time) @ window.C_ew.T
    sight = window.signals.at(window.pos_e + off + moved_e)
    doppler = DopplerRows(
        np.arange(len(window.signals)), np.full(len(window.signals), "G01"), sight.e_e, sight.z,
        window.signals.sigma, sight.by_pos,
    )  # fmt: skip
    time, slow = window.signals.time, 1.0 / 1.03
    vel_w = slow * window.track.velocity_at(time)
    known = AlignmentRows.paired(doppler, time, vel_w, position_sigma=1e4, speed_scale_sigma=0.05)
    result = align(known, ClockModel("random-walk", 0.1))
    assert rotation_angle(result.C_ew, window.C_ew) < np.radians(0.2)
    # z is in the measure of the velocities given: all is 3 % smaller.
    np.testing.assert_allclose(1e4 * result.nuisance[1:4], slow * off, atol=30.0)
    assert 0.05 * result.nuisance[4] == pytest.approx(1.0 - slow, abs=1e-3)
    believed = AlignmentRows.paired(doppler, time, vel_w, position_sigma=0.0)
    assert rotation_angle(align(believed).C_ew, window.C_ew) > np.radians(2.0)


@pytest.mark.parametrize("name", ["position_sigma", "speed_scale_sigma"])
def test_a_sigma_that_is_none_is_refused(name, rows):
    doppler = DopplerRows(np.arange(2), ["G01", "G02"], rows.e_e[:2], rows.z[:2], rows.sigma[:2])
    with pytest.raises(ConfigError, match=name):
        AlignmentRows.paired(doppler, rows.time[:2], rows.vel_w[:2], **{name: -1.0})
