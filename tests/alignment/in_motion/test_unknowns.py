"""The unknowns of a window: stationarity, the clock's own values, what is known beforehand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.alignment.in_motion.rows import inertial_rows
from certnav.alignment.in_motion.track import inertial_track
from certnav.alignment.in_motion.unknowns import InertialOptions, Window, settle
from certnav.alignment.problem import ClockModel
from certnav.alignment.solver.refinement import rotation_angle
from certnav.filters.errors import AlignmentError, ConfigError
from certnav.filters.sensors import imu_preset
from certnav.velocity.range_rate import DopplerNoise

NOISE = DopplerNoise(0.03, 0.02)
CLOCKS = [ClockModel("random-walk", 0.05), ClockModel("linear"), ClockModel("per-epoch")]


def at(drive, options, prior=(0.0,) * 6):
    """What makes the window of a drive at given biases."""
    prior = np.asarray(prior)

    def window(biases):
        track = inertial_track(drive.stream, drive.doppler.time, biases[:3], biases[3:])
        return Window(inertial_rows(drive.doppler, track, drive.lever_b), biases, prior, options)

    return window


def settled(drive, clock=CLOCKS[0], **options):
    options = InertialOptions(noise=NOISE, clock=clock, **options)
    return settle(at(drive, options), np.zeros(6), options, None)


@pytest.mark.parametrize("clock", CLOCKS, ids=lambda clock: clock.kind)
def test_joint_residuals_are_those_of_the_cost_and_stationary(noise_free, clock):
    """Eliminated or all together: the same residuals, at the bottom, the clock 150 m/s off."""
    solved = settled(noise_free, clock)
    for inliers in (
        np.ones(len(solved.window), dtype=bool),
        np.arange(len(solved.window)) % 5 > 0,
    ):
        again = dataclasses.replace(
            solved, problem=solved.window.problem(solved.C_ew, inliers)
        )  # fmt: skip
        jacobian, residual = again.joint(inliers)
        cost = again.problem.cost(solved.C_ew)
        assert np.sum(residual**2) == pytest.approx(cost, rel=1e-4, abs=1e-6)
        # All but the attitude was eliminated at its best.
        pull = jacobian[:, :-3].T @ residual
        size = np.linalg.norm(jacobian[:, :-3], axis=0)
        assert np.abs(pull / size).max() < 1e-3


def test_the_clock_found_is_that_of_the_simulation(noise_free):
    """At every epoch: its drift at the first of them, and how it went on from there."""
    solved = settled(noise_free)
    epochs = noise_free.doppler.time
    drift = np.cumsum(solved.problem.nuisance_at(solved.C_ew)[: epochs.size])
    np.testing.assert_allclose(drift, 150.0 + 0.02 * (epochs - epochs[0]), atol=0.02)
    linear = settled(noise_free, ClockModel("linear"))
    mean, rate = linear.problem.nuisance_at(linear.C_ew)[:2]
    assert rate == pytest.approx(0.02, abs=1e-3)
    middle = linear.window.rows.rows.time.mean() - epochs[0]
    assert mean == pytest.approx(150.0 + 0.02 * middle, abs=0.02)


def test_velocity_and_attitude_are_those_of_the_simulation(noise_free):
    solved = settled(noise_free)
    truth = noise_free.simulation.trajectory.kinematics(noise_free.doppler.time[-1:])
    velocity = solved.problem.nuisance_at(solved.C_ew)[solved.window.clock.shape[1] :][:3]
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
    kept = settled(noise_free).window.problem(solved.C_ew, some)
    assert kept.dof == some.sum() - 7
    sigma = solved.window.rows.rows.sigma
    assert kept.information == pytest.approx(np.sum(sigma[some] ** -2.0))


def test_a_bias_known_beforehand_is_kept_where_the_window_cannot_tell(noise_free):
    """A prior far narrower than the window's own information decides; a wide one does not."""
    wrong = np.array([1e-3, -1e-3, 2e-3, 0.0, 0.0, 0.0])
    spread = []
    for sigma in (1e-8, 1e-1):
        options = InertialOptions(noise=NOISE, clock=CLOCKS[0], gyro_bias_sigma=sigma, rounds=12)
        solved = settle(at(noise_free, options, wrong), wrong, options, None)
        spread.append(np.abs(solved.biases[:3] - wrong[:3]).max())
        everything = np.ones(len(solved.window), dtype=bool)
        assert np.all(np.sqrt(np.diag(solved.covariance(everything))[6:9]) < sigma * (1 + 1e-6))
    assert spread[0] < 1e-7 and spread[1] > 1e-3


def test_spreads_come_from_the_sensor_or_from_the_standstill():
    spec = imu_preset("adis16470")
    plain = InertialOptions(imu=spec).error_sigma
    assert plain.shape == (12,)
    np.testing.assert_allclose(
        plain[0::3],
        [
            np.hypot(spec.gyro_bias_initial_sigma, spec.gyro_bias_sigma),
            np.hypot(spec.accel_bias_initial_sigma, spec.accel_bias_sigma),
            1e-6 * spec.gyro_scale_ppm, 1e-6 * spec.accel_scale_ppm,
        ],
    )  # fmt: skip
    known = InertialOptions(imu=spec, gyro_bias_sigma=1e-5).error_sigma
    np.testing.assert_array_equal(known[:3], 1e-5)
    np.testing.assert_array_equal(known[3:], plain[3:])
    perfect = dataclasses.replace(
        spec, gyro_scale_ppm=0.0, accel_scale_ppm=0.0, gyro_bias_turn_on_degph=0.0,
        gyro_bias_instability_degph=0.0, accel_bias_turn_on_mg=0.0, accel_bias_instability_mg=0.0,
    )  # fmt: skip
    assert np.all(InertialOptions(imu=perfect).error_sigma > 0.0)


def test_gyro_noise_is_one_rate_for_each_part_of_the_window(noise_free):
    options = InertialOptions(noise=NOISE, clock=CLOCKS[0], segments=5)
    window = at(noise_free, options)(np.zeros(6))
    assert window.response.shape[1:] == (3, 12 + 15)
    time = noise_free.doppler.time
    ends = time[np.linspace(0, time.size - 1, 6).round().astype(int)]
    expected = np.repeat(options.imu.gyro_noise_density / np.sqrt(np.diff(ends)), 3)
    np.testing.assert_allclose(window.turn_sigma, expected)
    # All parts of one rate are the response to a bias.
    whole = window.response[:, :, 12:].reshape(len(time), 3, 5, 3).sum(axis=2)
    np.testing.assert_allclose(whole, window.response[:, :, :3], atol=1e-6)


def test_too_few_rows_are_refused_and_just_enough_are_not(noise_free):
    options = InertialOptions(noise=NOISE, clock=ClockModel())
    window = at(noise_free, options)
    few = np.zeros(len(window(np.zeros(6))), dtype=bool)
    few[np.linspace(0, few.size - 1, 5).astype(int)] = True
    with pytest.raises(AlignmentError, match="5 Doppler rows are too few"):
        settle(window, np.zeros(6), options, None, few)
    few[few.size // 3] = True
    assert settle(window, np.zeros(6), options, None, few).rounds >= 1


@pytest.mark.parametrize(
    ("name", "wrong", "right"),
    [
        ("segments", 0, 1), ("rounds", 0, 1), ("interval", -0.1, 0.0), ("cutoff", 0.0, 0.1),
        ("minority", 0.5, 0.49), ("minority", -0.01, 0.0), ("gyro_bias_sigma", 0.0, 1e-9),
        ("gyro_bias_sigma", np.inf, 1e9),
    ],
)  # fmt: skip
def test_options_out_of_range_are_named(name, wrong, right):
    with pytest.raises(ConfigError, match=name):
        InertialOptions(**{name: wrong})
    assert getattr(InertialOptions(**{name: right}), name) == right
