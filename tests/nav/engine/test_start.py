"""How a run starts itself: certified in motion, levelled at rest, and why not, never silently."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.alignment.solver.refinement import rotation_angle
from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.error_model import ErrorModel
from certnav.filters.errors import AlignmentError
from certnav.filters.rotation import matrix_from_rotvec
from certnav.filters.strapdown import InertialStream
from certnav.nav.config import AlignmentConfig, Config
from certnav.nav.config_files import from_tables
from certnav.nav.engine.gnss import gnss_timeline
from certnav.nav.engine.start.finder import StartFinder, find_start
from certnav.nav.engine.start.state import start_filter
from certnav.nav.pipeline import navigate


def carried(simulation):
    """The drive with positions and velocities that it carries, and its Doppler."""
    fixes = fixes_from_truth(
        simulation.trajectory, np.unique(simulation.observations.time),
        simulation.calibration.lever_antenna_b, 1.0, 0.1, np.random.default_rng(3),
    )  # fmt: skip
    return simulation.sequence(fixes=fixes)


def ingredients(sequence, **alignment):
    imu = sequence.imu
    stream = InertialStream(imu.time, imu.gyro_b, imu.accel_b)
    model = ErrorModel(sequence.calibration.imu)
    return stream, sequence.calibration, AlignmentConfig(**alignment), model


@pytest.fixture(scope="module")
def moving():
    config = SimulationConfig(
        seed=4, duration=40.0, density="open", static_start=0.0, moving_start=True
    )
    simulation = simulate(config)
    return simulation, carried(simulation)


@pytest.fixture(scope="module")
def events(moving):
    return gnss_timeline(moving[1], Config().gnss).events


@pytest.fixture(scope="module")
def start(moving, events):
    return find_start(events, *ingredients(moving[1]))


def errors(simulation, start):
    """True − started: attitude [rad] and velocity of the IMU [m/s], biases; filter's axes."""
    at = np.array([start.state.time])
    truth = simulation.trajectory.kinematics(at)
    off = start.state.C_eb.T @ truth.C_eb[0]
    phi = 0.5 * np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]])
    return np.concatenate([
        phi, truth.vel_e[0] - start.state.vel_e,
        simulation.gyro_bias[0] - start.attitude.gyro_bias,
        simulation.accel_bias[0] - start.accel_bias,
    ])  # fmt: skip


def test_auto_starts_certified_in_motion(moving, start):
    simulation, _ = moving
    assert start.attitude.method == "certified"
    error = errors(simulation, start)
    assert error @ np.linalg.solve(start.joint_cov, error) < 32.9  # 99.9 % of χ²₁₂
    # Not so wide that nothing could fail: a rotation by 12° is outside.
    wrong = matrix_from_rotvec([0.0, 0.0, np.radians(12.0)])
    turned = dataclasses.replace(start.state, C_eb=start.state.C_eb @ wrong)
    error = errors(simulation, dataclasses.replace(start, state=turned))
    assert error @ np.linalg.solve(start.joint_cov, error) > 32.9
    true_pos = simulation.trajectory.kinematics(np.array([start.state.time])).pos_e[0]
    assert np.linalg.norm(start.state.pos_e - true_pos) < 5.0


def test_report_has_bound_verdicts_and_what_was_missing(moving, start):
    began = float(moving[1].imu.time[0])
    report = start.report(began)
    assert report.status == "aligned" and report.method == "certified"
    assert 0.0 < report.bound <= np.radians(10.0)
    names = [name for name, _ in report.verdicts]
    assert names[:5] == ["optimal", "unique", "unambiguous", "consistent", "bounded"]
    times = [time for time, _ in report.attempts]
    np.testing.assert_allclose(np.diff(times), 1.0, atol=1e-3)
    assert all(text.startswith("not aligned: ") for _, text in report.attempts[:-1])
    assert any("needs a turn" in text for _, text in report.attempts)
    assert report.message.startswith(report.attempts[-1][1])
    assert report.waited == pytest.approx(start.state.time - began)


def test_the_filter_gets_it_all(moving, start):
    stream, calibration, _, model = ingredients(moving[1])
    kalman = start_filter(start, stream, calibration, model, Config().filter)
    inner = np.r_[6:9, 3:6, 9:15]
    np.testing.assert_array_equal(kalman.P[np.ix_(inner, inner)], start.joint_cov)
    np.testing.assert_array_equal(kalman.bias[:3], start.attitude.gyro_bias)
    np.testing.assert_array_equal(kalman.bias[3:6], start.accel_bias)
    assert np.linalg.eigvalsh(kalman.P)[0] > 0.0


def test_without_velocities_it_starts_at_the_end_of_the_window(moving, events):
    """Velocity, its covariance and correlations are the window's own."""
    simulation, sequence = moving
    silent = tuple(
        dataclasses.replace(e, reason="left out") if e.kind == "velocity" else e for e in events
    )
    start = find_start(silent, *ingredients(sequence, method="certified"))
    assert start.state.time == start.certified.time == start.attempts[-1][0]
    error = errors(simulation, start)
    assert error @ np.linalg.solve(start.joint_cov, error) < 32.9
    assert np.abs(start.joint_cov[:3, 3:6]).max() > 0.0
    angle = rotation_angle(
        start.state.C_eb, simulation.trajectory.C_eb(np.array([start.state.time]))[0]
    )
    assert angle < start.certified.result.bound


def test_a_position_must_be_near(moving, events):
    """Otherwise it waits on, and says so."""
    _, sequence = moving
    first = [e for e in events if e.kind == "position"][:1]
    others = [e for e in events if e.kind != "position"]
    finder = StartFinder(*ingredients(sequence, method="certified"))
    assert all(finder.offer(event) is None for event in first + others)
    assert "no GNSS position within 2.5 s" in finder.waiting


def test_a_standstill_does_not_pre_empt_a_certificate():
    simulation = simulate(SimulationConfig(seed=6, duration=60.0, density="open"))
    sequence = carried(simulation)
    timeline = gnss_timeline(sequence, Config().gnss)
    start = find_start(timeline.events, *ingredients(sequence))
    assert start.attitude.method == "certified" and start.report(0.0).bound is not None
    levelled = find_start(timeline.events, *ingredients(sequence, method="level+course"))
    assert "at rest" in levelled.attitude.message
    assert levelled.certified is None and levelled.report(0.0).bound is None


def test_without_doppler_it_levels_and_certified_says_what_it_needs(moving):
    sequence = dataclasses.replace(moving[1], observations=None)
    solution = navigate(sequence, from_tables({}))
    assert solution.alignment.method == "level+course"
    assert solution.alignment.attempts == ()
    with pytest.raises(AlignmentError, match="needs raw Doppler with satellite states"):
        navigate(sequence, from_tables({"alignment": {"method": "certified"}}))


def test_what_no_window_passes_is_levelled_with_the_reason(moving, events):
    """A demand that cannot be met; two windows of 14 s are waited for, not the whole drive."""
    _, sequence = moving
    demand = {"max_sigma_heading_deg": 1e-3, "max_window_s": 14.0}
    finder = StartFinder(*ingredients(sequence, **demand))
    start, decided = None, None
    for event in events:
        start, decided = finder.offer(event), event.time
        if start is not None:
            break
    assert start is not None and start.attitude.method == "level+course"
    assert start.attitude.time == find_start(
        events, *ingredients(sequence, method="level+course")
    ).attitude.time  # fmt: skip
    assert "; not certified in " in start.attitude.message
    assert decided == pytest.approx(finder.attempts[0][0] - 5.0 + 28.0, abs=1.01)
    with pytest.raises(AlignmentError, match=r"not certified in .*needs a turn"):
        find_start(events, *ingredients(sequence, method="certified", **demand))


def test_a_given_attitude_wins(moving, events):
    angles = {"roll_deg": 1.0, "pitch_deg": -2.0, "heading_deg": 30.0}
    start = find_start(events, *ingredients(moving[1], **angles))
    assert start.report(0.0).status == "given"
    assert start.attempts == ()
