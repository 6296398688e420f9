"""Alignment from IMU and Doppler alone: recovery without noise, honesty with it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from alignment.inertial import align_inertial
from alignment.inertial_unknowns import InertialOptions
from alignment.problem import ClockModel
from alignment.refinement import rotation_angle
from datasets.simulator import SimulationConfig, simulate
from filters.errors import AlignmentError, ConfigError
from filters.sensors import imu_preset
from filters.strapdown import InertialStream
from velocity.range_rate import DopplerNoise

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
        rounds=12,
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
