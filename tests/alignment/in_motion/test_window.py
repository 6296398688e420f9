"""The unknowns of a window: stationarity, the clock's own values, what is known beforehand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.alignment.in_motion.rows import inertial_rows
from certnav.alignment.in_motion.track import ImuParts
from certnav.alignment.in_motion.unknowns import InertialOptions
from certnav.alignment.in_motion.window import Stretch, settle
from certnav.alignment.problem import ClockModel
from certnav.alignment.solver.refinement import rotation_angle, tangent_basis
from certnav.filters.errors import AlignmentError
from certnav.velocity.range_rate import DopplerNoise

NOISE = DopplerNoise(0.03, 0.02)
CLOCKS = [
    ClockModel("random-walk", 0.05), ClockModel("linear"), ClockModel("per-epoch"), ClockModel(),
    ClockModel("random-walk", 0.0),
]  # fmt: skip


def stretch(drive, options):
    """The rows of a drive, to be linearised."""
    return Stretch(inertial_rows(drive.doppler), ImuParts(drive.stream), drive.lever_b, options)


def settled(drive, clock=CLOCKS[0], **options):
    options = InertialOptions(noise=NOISE, clock=clock, **options)
    return settle(stretch(drive, options).at, np.zeros(6), options, None)


def written_out(solved):
    """All rows over [velocity, errors, clock; x] at the rotation found, and the residuals.

    Row for row and clock for clock, as they are written down, measured ones first; what the
    compiled form never makes.
    """
    stretch, window = solved.window.stretch, solved.window
    rows, keep, clock = stretch.rows, solved.inliers, stretch.options.clock
    n, k, errors = rows.time.size, len(rows), stretch.error_sigma
    e_w = rows.e_e @ solved.C_ew
    sensor = np.einsum("ki,kim->km", e_w, window.response[rows.epoch])
    late = (np.arange(n) <= rows.epoch[:, None]).astype(float)  # each walks on from the one before
    at, held = rows.time[rows.epoch], [1e-6]
    if clock.kind == "linear":
        late, held = np.column_stack([np.ones(k), at - at.mean()]), [1e-6] * 2
    elif clock.kind == "per-epoch":
        late, held = np.eye(n)[rows.epoch], [1e-6] * n
    elif clock.q:
        held += list(1.0 / (clock.q * np.sqrt(np.diff(rows.time))))
    else:
        late = np.ones((k, 1))
    outer = window.vel_w[rows.epoch][:, :, None] * rows.e_e[:, None, :]
    design = np.column_stack([outer.reshape(k, 9), -stretch.z])
    columns = [rows.e_e, sensor, rows.common, -late, design]
    measured = np.hstack(columns) / stretch.sigma[:, None]
    errors = np.concatenate([errors, np.ones(3)])  # of the position, in its own σ
    m = 3 + errors.size + len(held)
    believed = np.zeros((m, m + 10))
    believed[:, :m] = np.diag(np.concatenate([[1e-6] * 3, 1.0 / errors, held]))
    believed[3:9, -1] = (window.biases - stretch.prior) / errors[:6]
    stacked = np.vstack([measured[keep], believed])
    x = np.append(solved.C_ew.T.ravel(), 1.0)
    found = -np.linalg.lstsq(stacked[:, :m], stacked[:, m:] @ x, rcond=None)[0]
    theta = stacked[:, m : m + 9] @ tangent_basis(solved.C_ew)
    return np.hstack([stacked[:, :m], theta]), stacked[:, :m] @ found + stacked[:, m:] @ x, found


@pytest.mark.parametrize("clock", CLOCKS, ids=lambda clock: f"{clock.kind} {clock.q}")
@pytest.mark.parametrize("thinned", [False, True])
def test_the_compiled_window_is_the_least_squares_it_stands_for(noise_free, clock, thinned):
    """Cost, unknowns, covariance and scores, from a matrix with a row for every measurement."""
    rng, doppler = np.random.default_rng(5), noise_free.doppler
    noisy = dataclasses.replace(doppler, z=doppler.z + rng.normal(0.0, doppler.sigma))
    options = InertialOptions(noise=NOISE, clock=clock, rounds=12)
    window = stretch(noise_free._replace(doppler=noisy), options).at
    keep = rng.random(len(doppler)) > 0.3 * thinned
    solved = settle(window, np.zeros(6), options, None, keep)
    jacobian, residual, found = written_out(solved)
    assert solved.cost == pytest.approx(np.sum(residual**2), rel=1e-4, abs=1e-6)
    np.testing.assert_allclose(solved.unknowns[:9], found[:9], rtol=1e-3, atol=1e-4)
    # Of attitude, velocity and biases.
    half = np.linalg.qr(jacobian, mode="r")
    chosen = np.r_[-3:0, 0:9]
    cov = np.linalg.inv(half.T @ half)[np.ix_(chosen, chosen)]
    T = np.eye(12)
    T[:3, :3] = solved.C_ew
    np.testing.assert_allclose(
        np.sqrt(np.diag(solved.covariance)), np.sqrt(np.diag(T @ cov @ T.T)), rtol=1e-5
    )
    basis = np.linalg.qr(jacobian)[0][: keep.sum()]
    left = 1.0 - np.sum(basis * basis, axis=1)
    scores = solved.scores()
    assert np.all(scores[~keep] == 0.0)
    expected = np.where(left > 1e-3, np.abs(residual[: keep.sum()]) / np.sqrt(left), 0.0)
    assert expected.max() > 2.0
    np.testing.assert_allclose(scores[keep], expected, rtol=1e-3, atol=1e-3)


def test_the_clock_found_is_that_of_the_simulation(noise_free):
    """Its drift at the last epoch, and its rate where that is an unknown."""
    solved = settled(noise_free)
    epochs = noise_free.doppler.time
    drift = solved.problem.nuisance_at(solved.C_ew)[0]
    assert drift == pytest.approx(150.0 + 0.02 * (epochs[-1] - epochs[0]), abs=0.02)
    linear = settled(noise_free, ClockModel("linear"))
    mean, rate = linear.problem.nuisance_at(linear.C_ew)[[0, -1]]
    assert rate == pytest.approx(0.02, abs=1e-3)
    middle = epochs[noise_free.doppler.epoch].mean() - epochs[0]
    assert mean == pytest.approx(150.0 + 0.02 * middle, abs=0.02)


def test_velocity_and_attitude_are_those_of_the_simulation(noise_free):
    solved = settled(noise_free)
    truth = noise_free.simulation.trajectory.kinematics(noise_free.doppler.time[-1:])
    velocity = solved.problem.nuisance_at(solved.C_ew)[1:4]
    np.testing.assert_allclose(velocity, truth.vel_e[0], atol=0.01)
    assert rotation_angle(solved.C_ew, truth.C_eb[0]) < np.radians(0.1)


def test_degrees_of_freedom_are_rows_less_what_nothing_holds(noise_free):
    """Velocity and attitude, three each; of the clock all that has no prior."""
    counts = {"constant": 1, "linear": 2, "random-walk": 1}
    for kind, free in counts.items():
        clock = ClockModel(kind, 0.05 if kind == "random-walk" else None)
        solved = settled(noise_free, clock)
        assert solved.problem.dof == len(solved.window) - 6 - free
    solved = settled(noise_free, ClockModel("per-epoch"))
    assert solved.problem.dof == len(solved.window) - 6 - noise_free.doppler.time.size
    some = np.arange(len(solved.window)) % 2 == 0
    options = InertialOptions(noise=NOISE, clock=CLOCKS[0])
    kept = settle(stretch(noise_free, options).at, np.zeros(6), options, None, some).problem
    assert kept.dof == some.sum() - 7
    sigma = noise_free.doppler.sigma
    assert kept.information == pytest.approx(np.sum(sigma[some] ** -2.0))


def test_a_bias_known_beforehand_is_kept_where_the_window_cannot_tell(noise_free):
    """A prior far narrower than the window's own information decides; a wide one does not."""
    wrong = np.array([1e-3, -1e-3, 2e-3, 0.0, 0.0, 0.0])
    spread = []
    for sigma in (1e-8, 1e-1):
        options = InertialOptions(
            noise=NOISE, clock=CLOCKS[0], gyro_bias=wrong[:3], gyro_bias_sigma=sigma, rounds=12
        )
        solved = settle(stretch(noise_free, options).at, wrong, options, None)
        spread.append(np.abs(solved.biases[:3] - wrong[:3]).max())
        assert np.all(np.sqrt(np.diag(solved.covariance)[6:9]) < sigma * (1 + 1e-6))
    assert spread[0] < 1e-7 and spread[1] > 1e-3


def test_gyro_noise_is_one_rate_for_each_part_of_the_window(noise_free):
    options = InertialOptions(noise=NOISE, clock=CLOCKS[0], segments=5)
    window = stretch(noise_free, options).at(np.zeros(6))
    assert window.response.shape[1:] == (3, 12 + 15)
    time = noise_free.doppler.time
    ends = time[np.linspace(0, time.size - 1, 6).round().astype(int)]
    expected = np.repeat(options.imu.gyro_noise_density / np.sqrt(np.diff(ends)), 3)
    np.testing.assert_allclose(window.stretch.error_sigma[12:], expected)
    # All parts of one rate are the response to a bias.
    whole = window.response[:, :, 12:].reshape(len(time), 3, 5, 3).sum(axis=2)
    np.testing.assert_allclose(whole, window.response[:, :, :3], atol=1e-6)


def test_too_few_rows_are_refused_and_just_enough_are_not(noise_free):
    options = InertialOptions(noise=NOISE, clock=ClockModel())
    window = stretch(noise_free, options).at
    few = np.zeros(len(window(np.zeros(6))), dtype=bool)
    few[np.linspace(0, few.size - 1, 5).astype(int)] = True
    with pytest.raises(AlignmentError, match="5 Doppler rows are too few"):
        settle(window, np.zeros(6), options, None, few)
    few[few.size // 3] = True
    assert settle(window, np.zeros(6), options, None, few).rounds >= 1
