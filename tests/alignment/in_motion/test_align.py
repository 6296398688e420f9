"""Alignment from IMU and Doppler alone: recovery without noise, honesty with it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.alignment.in_motion.align import align_inertial
from certnav.alignment.in_motion.unknowns import InertialOptions
from certnav.alignment.problem import ClockModel
from certnav.alignment.solver.refinement import rotation_angle
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.errors import AlignmentError, ConfigError
from certnav.filters.sensors import imu_preset
from certnav.filters.strapdown import InertialStream
from certnav.velocity.range_rate import DopplerNoise

#: What the simulator's receiver has.
NOISE, CLOCK = DopplerNoise(0.03, 0.02), ClockModel("random-walk", 0.03)
EXACT = dataclasses.replace(
    imu_preset("adis16470"), gyro_scale_ppm=0.0, accel_scale_ppm=0.0,
    accel_bias_instability_mg=0.0, accel_bias_turn_on_mg=1e-4, gyro_arw_deg_sqrth=1e-4,
)  # fmt: skip


def drive(seed, duration=40.0, **options):
    """Simulation, stream, observations above 10° and antenna positions of a car on the move."""
    simulation = simulate(
        SimulationConfig(
            seed=seed, duration=duration, static_start=0.0, moving_start=True, density="open",
            **options,
        )
    )  # fmt: skip
    imu, observations = simulation.imu, simulation.observations
    observations = observations.mark(observations.elevation < np.radians(10.0), "low")
    lever = simulation.calibration.lever_antenna_b
    pos_e = simulation.trajectory.pos_e(observations.time, lever)
    return simulation, InertialStream(imu.time, imu.gyro_b, imu.accel_b), observations, pos_e


@pytest.fixture(scope="module")
def exact():
    return drive(3, noise=False, receiver_clock=False, atmosphere=False)


@pytest.fixture(scope="module")
def noisy():
    return drive(4)


def aligned(case, options, gyro_bias=(0.0, 0.0, 0.0), satellites=None):
    simulation, stream, observations, pos_e = case
    if satellites is not None:
        keep = np.isin(observations.sat, satellites)
        observations, pos_e = observations.take(keep), pos_e[keep]
    stream = InertialStream(stream.edges[1:], stream.gyro + np.asarray(gyro_bias), stream.accel)
    lever = simulation.calibration.lever_antenna_b
    found = align_inertial(stream, observations, pos_e, lever, options)
    truth = simulation.trajectory.kinematics(np.array([found.time]))
    return found, truth.C_eb[0], truth.vel_e[0]


def test_noise_free_recovery_of_attitude_velocity_and_a_large_gyro_bias(exact):
    """500 deg/h on every axis, found from scratch by re-linearising."""
    bias = np.radians([500.0, -400.0, 300.0]) / 3600.0
    options = InertialOptions(
        imu=dataclasses.replace(EXACT, gyro_bias_turn_on_degph=5e4), noise=NOISE, clock=CLOCK,
        rounds=12, position_sigma=0.0,
    )  # fmt: skip
    found, C_eb, vel_e = aligned(exact, options, bias)
    assert found.passed, found.message
    assert rotation_angle(found.C_eb, C_eb) < np.radians(0.02)
    np.testing.assert_allclose(found.gyro_bias, bias, atol=np.radians(3.0) / 3600.0)
    np.testing.assert_allclose(found.vel_e, vel_e, atol=1e-3)
    assert found.result.cost < 1e-2
    assert found.rounds > 1


def test_one_linearisation_is_not_enough(exact):
    bias = np.radians([500.0, -400.0, 300.0]) / 3600.0
    spec = dataclasses.replace(EXACT, gyro_bias_turn_on_degph=5e4)
    options = InertialOptions(imu=spec, noise=NOISE, clock=CLOCK, rounds=1, robust=False)
    found, C_eb, _ = aligned(exact, options, bias)
    assert rotation_angle(found.C_eb, C_eb) > np.radians(0.05) or found.result.cost > 1.0


def test_noisy_window_is_within_its_bound_and_its_covariance(noisy):
    found, C_eb, vel_e = aligned(noisy, InertialOptions(noise=NOISE, clock=CLOCK))
    assert found.passed, found.message
    angle = rotation_angle(found.C_eb, C_eb)
    assert angle < found.result.bound
    off = C_eb @ found.C_eb.T
    psi = 0.5 * np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]])
    assert psi @ np.linalg.solve(found.cov_e, psi) < 16.3  # 99.9 % of χ²₃
    off = vel_e - found.vel_e
    assert off @ np.linalg.solve(found.cov[3:6, 3:6], off) < 16.3
    attitude = found.initial_attitude()
    assert attitude.time == found.time
    assert attitude.sigma_heading == pytest.approx(found.sigma_heading)
    assert "certified in motion over 40 s" in attitude.message
    for shown in (repr(found), repr(found.track), repr(attitude)):
        assert len(shown) < 300 and "\n" not in shown


def test_covariance_by_nees_over_a_hundred_windows(exact):
    """Fresh noise of every kind, 500 deg/h and 10 mg, over one drive: NEES of χ², 3 and 6 dof."""
    simulation, stream, observations, pos_e = exact
    # Six satellites every other second are enough, and quicker.
    keep = observations.usable & (np.round(observations.time) % 2 == 0)
    keep &= np.isin(observations.sat, np.unique(observations.sat[keep])[:6])
    observations, pos_e = observations.take(keep), pos_e[keep]
    spec = dataclasses.replace(
        imu_preset("adis16470"), gyro_scale_ppm=0.0, accel_scale_ppm=0.0,
        gyro_bias_turn_on_degph=500.0,
    )  # fmt: skip
    options = InertialOptions(imu=spec, noise=NOISE, clock=CLOCK, robust=False)
    sigma = NOISE.sigma(observations.cn0)
    epochs, epoch = np.unique(observations.time, return_inverse=True)
    white = spec.gyro_noise_density * np.sqrt(100.0)
    lever, rng = simulation.calibration.lever_antenna_b, np.random.default_rng(11)
    end = simulation.trajectory.kinematics(epochs[-1:])
    attitude, velocity, joint = [], [], []
    for _ in range(100):
        gyro_bias = rng.normal(0.0, np.radians(500.0) / 3600.0, 3)
        accel_bias = rng.normal(0.0, spec.accel_bias_initial_sigma, 3)
        gyro = stream.gyro + gyro_bias + white * rng.standard_normal(stream.gyro.shape)
        noisy = InertialStream(stream.edges[1:], gyro, stream.accel + accel_bias)
        clock = np.cumsum(0.03 * rng.standard_normal(epochs.size))[epoch]
        rate = observations.range_rate + clock + sigma * rng.standard_normal(sigma.size)
        found = align_inertial(
            noisy, observations.with_columns(range_rate=rate), pos_e, lever, options
        )
        off = end.C_eb[0] @ found.C_eb.T
        psi = 0.5 * np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]])
        error = np.concatenate([psi, end.vel_e[0] - found.vel_e, gyro_bias - found.gyro_bias])
        for nees, part in ((attitude, slice(0, 3)), (velocity, slice(3, 6)), (joint, slice(0, 9))):
            cov = found.cov[part, part]
            nees.append(error[part] @ np.linalg.solve(cov, error[part]))
    # 3σ of the mean of a hundred: √(2·dof/100).
    assert np.mean(attitude) == pytest.approx(3.0, abs=3.0 * np.sqrt(0.06))
    assert np.mean(velocity) == pytest.approx(3.0, abs=3.0 * np.sqrt(0.06))
    assert np.mean(joint) == pytest.approx(9.0, abs=3.0 * np.sqrt(0.18))


def test_attitude_is_carried_to_the_beginning_of_the_window(exact):
    """By the gyros, in axes of the Earth as it was then: 40 s are 0.17° of it."""
    options = InertialOptions(imu=EXACT, noise=NOISE, clock=CLOCK)
    found, *_ = aligned(exact, options)
    last = len(found.track) - 1
    C_eb, cov = found.carried_to(last)
    np.testing.assert_allclose(C_eb, found.C_eb, atol=1e-12)
    spread = cov[:3, :3] - found.cov[:3, :3]
    assert np.abs(spread).max() < 1e-12
    C_eb, cov = found.carried_to(0)
    truth = exact[0].trajectory.C_eb(found.track.time[:1])[0]
    assert rotation_angle(C_eb, truth) < np.radians(0.02)
    # A ninth of the window's information: 3σ where nothing was known before, and never wider
    # than that was.
    _, wide = found.carried_to(0, 1.0 / 9.0)
    ratio = np.diag(wide)[:3] / np.diag(cov)[:3]
    assert np.all((ratio > 1.0) & (ratio < 9.0 + 1e-6))
    before = np.hypot(EXACT.gyro_bias_initial_sigma, EXACT.gyro_bias_sigma)
    assert np.all(np.sqrt(np.diag(wide)[3:6]) <= before * (1.0 + 1e-9))


def test_joint_covariance_agrees_with_the_hessian(noisy):
    """The marginal of the joint least squares is what the eliminated problem's curvature says.

    The Hessian has the curvature of the group times the residuals in it, which joint least squares
    leaves out: equal to a few percent.
    """
    found, C_eb, _ = aligned(noisy, InertialOptions(noise=NOISE, clock=CLOCK))
    hessian = C_eb @ found.result.cov_w @ C_eb.T
    ratio = np.linalg.eigvals(np.linalg.solve(hessian, found.cov_e)).real
    np.testing.assert_allclose(ratio, 1.0, atol=0.1)


def test_two_satellites_with_a_free_clock_do_not_pass(noisy):
    sats = list(np.unique(noisy[2].sat[noisy[2].usable]))
    options = InertialOptions(noise=NOISE, clock=ClockModel("per-epoch"))
    found, _, _ = aligned(noisy, options, satellites=sats[:2])
    assert not found.passed
    assert found.message.startswith("not aligned: ")
    with pytest.raises(AlignmentError, match="not aligned"):
        found.initial_attitude()


def test_a_straight_line_does_not_pass(noisy):
    """The first seconds at constant speed: the vertical is known, the heading is not."""
    simulation, stream, observations, pos_e = drive(3, 40.0)
    early = observations.time < observations.time[0] + 10.0
    lever = simulation.calibration.lever_antenna_b
    options = InertialOptions(noise=NOISE, clock=CLOCK)
    found = align_inertial(stream, observations.take(early), pos_e[early], lever, options)
    assert not found.passed
    assert "needs a turn" in found.message
    down = simulation.trajectory.C_eb(np.array([found.time]))[0][:, 2]
    tilt = np.arccos(np.clip(found.C_eb[:, 2] @ down, -1.0, 1.0))
    assert tilt < np.radians(3.0)  # what it does know


def test_reflections_are_rejected_by_name(noisy):
    simulation, stream, observations, pos_e = noisy
    rate = observations.range_rate.copy()
    sat = str(observations.sat[observations.usable][0])
    hit = (observations.sat == sat) & (observations.time > observations.time[0] + 20.0)
    rate[hit] += 4.0
    spoiled = observations.with_columns(range_rate=rate)
    lever = simulation.calibration.lever_antenna_b
    plain = InertialOptions(noise=NOISE, clock=CLOCK, robust=False)
    assert not align_inertial(stream, spoiled, pos_e, lever, plain).passed
    options = InertialOptions(noise=NOISE, clock=CLOCK)
    found = align_inertial(stream, spoiled, pos_e, lever, options)
    assert found.outlier_sats == (sat,) or sat in found.outlier_sats
    assert set(np.flatnonzero(hit & observations.usable)) <= set(found.source[~found.inliers])
    truth = simulation.trajectory.C_eb(np.array([found.time]))[0]
    assert rotation_angle(found.C_eb, truth) < found.result.bound


def test_too_little_to_align_with_is_one_line(noisy):
    _, stream, observations, pos_e = noisy
    few = observations.time < observations.time[0] + 0.5
    with pytest.raises(AlignmentError, match="fewer than two epochs"):
        align_inertial(stream, observations.take(few), pos_e[few])
    with pytest.raises(ConfigError, match="segments"):
        InertialOptions(segments=0)
    with pytest.raises(ConfigError, match="gyro_bias_sigma"):
        InertialOptions(gyro_bias_sigma=-1.0)
