"""Waiting for an attitude while driving."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.alignment.in_motion.rows import DopplerEpoch
from certnav.alignment.in_motion.unknowns import InertialOptions
from certnav.alignment.in_motion.waiting import (
    MotionAligner,
    MotionOptions,
    attempts,
    wait_for_alignment,
)
from certnav.alignment.problem import ClockModel
from certnav.alignment.solver.refinement import rotation_angle
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.errors import AlignmentError, ConfigError
from certnav.filters.strapdown import InertialStream
from certnav.velocity.range_rate import DopplerNoise, doppler_rows

INERTIAL = InertialOptions(noise=DopplerNoise(0.03, 0.02), clock=ClockModel("random-walk", 0.03))


def drive(seed, duration, **options):
    simulation = simulate(SimulationConfig(seed=seed, duration=duration, density="open", **options))
    imu, observations = simulation.imu, simulation.observations
    observations = observations.mark(observations.elevation < np.radians(10.0), "low")
    stream = InertialStream(imu.time, imu.gyro_b, imu.accel_b)
    lever = simulation.calibration.lever_antenna_b
    return simulation, stream, observations, simulation.trajectory.pos_e(observations.time, lever)


@pytest.fixture(scope="module")
def moving():
    return drive(3, 60.0, static_start=0.0, moving_start=True)


def test_waits_says_why_and_starts(moving):
    simulation, stream, observations, pos_e = moving
    lever, said = simulation.calibration.lever_antenna_b, []
    attitude = wait_for_alignment(
        stream, observations, pos_e, lever, MotionOptions(INERTIAL, every=4.0),
        report=lambda time, message: said.append((time, message)),
    ).initial_attitude()  # fmt: skip
    assert len(said) > 3
    assert np.all(np.diff([time for time, _ in said]) >= 4.0 - 1e-6)
    assert all(message.startswith("not aligned: ") for _, message in said[:-1])
    assert any("needs a turn" in message for _, message in said[:-1])
    assert said[-1] == (attitude.time, attitude.message)
    assert not any("\n" in message for _, message in said)
    truth = simulation.trajectory.C_eb(np.array([attitude.time]))[0]
    assert rotation_angle(attitude.C_eb, truth) < np.radians(5.0)
    assert attitude.sigma_heading <= np.radians(1.5)
    assert attitude.method == "certified"


def test_live_is_the_recording(moving):
    """Samples and epochs as they come, a twentieth of a second late: the same in every attempt."""
    simulation, stream, observations, pos_e = moving
    lever, options = simulation.calibration.lever_antenna_b, MotionOptions(INERTIAL, every=3.0)
    recorded = list(attempts(stream, observations, pos_e, lever, options))
    live = InertialStream.live(stream.edges[1] - stream.edges[0])
    aligner, reached, made = MotionAligner(live, lever, options), 0, []
    rows = doppler_rows(observations, pos_e, INERTIAL.noise)
    for time, here in observations.epochs():
        until = int(np.searchsorted(stream.edges[1:], time + 0.05))
        for k in range(reached, until):
            live.append(stream.edges[k + 1], stream.gyro[k], stream.accel[k])
        reached = until
        if stream.start <= time <= stream.end:
            epoch = rows.take((rows.row >= here.start) & (rows.row < here.stop))
            made.append(aligner.add(DopplerEpoch(time, pos_e[here.start], epoch)))
    made = [attempt for attempt in made if attempt is not None]
    assert [a.message for a in made] == [a.message for a in recorded]
    solved = [(a.alignment, b.alignment) for a, b in zip(made, recorded, strict=True)]
    assert sum(a is not None for a, _ in solved) > 5
    for a, b in solved:
        if a is not None:
            assert b is not None and a.passed == b.passed
            np.testing.assert_allclose(a.C_eb, b.C_eb, rtol=0.0, atol=1e-9)
            np.testing.assert_allclose(a.cov, b.cov, rtol=1e-9, atol=1e-9 * np.abs(b.cov).max())


def test_gives_up_with_the_last_reason_and_a_remedy(moving):
    simulation, stream, observations, pos_e = moving
    early = observations.time < observations.time[0] + 10.5
    with pytest.raises(AlignmentError, match=r"no attitude in motion after 6 attempts; at .*needs"):
        wait_for_alignment(
            stream, observations.take(early), pos_e[early],
            simulation.calibration.lever_antenna_b, MotionOptions(INERTIAL),
        )  # fmt: skip


def test_a_standstill_on_the_way_gives_the_gyro_bias():
    """To the Earth's rate; the start-up spread is thirty times that."""
    simulation, stream, observations, pos_e = drive(6, 40.0, static_start=15.0)
    lever = simulation.calibration.lever_antenna_b
    last = list(attempts(stream, observations, pos_e, lever, MotionOptions(INERTIAL, every=10.0)))[
        -1
    ]
    assert last.alignment is not None
    bias = simulation.gyro_bias[-1]
    off = np.degrees(last.alignment.gyro_bias - bias) * 3600.0
    assert np.all(np.abs(off) < 60.0)
    sigma = np.degrees(np.sqrt(np.diag(last.alignment.cov[6:9, 6:9]))) * 3600.0
    assert np.all(sigma < 25.0)


def test_ten_seconds_in_motion_are_looked_at_however_long_it_stood():
    """Three seconds after setting off nothing contradicts a facade; a canyon started 27° off."""
    simulation, stream, observations, pos_e = drive(6, 30.0, static_start=15.0)
    lever = simulation.calibration.lever_antenna_b
    tried = list(attempts(stream, observations, pos_e, lever, MotionOptions(INERTIAL)))
    speed = np.linalg.norm(simulation.reference.vel_e, axis=1)
    set_off = simulation.reference.time[np.argmax(speed > 0.1)]
    early = [a for a in tried if a.time < set_off + 9.0]
    assert all(a.alignment is None for a in early)
    assert early[0].message == "not aligned: at rest, needs motion"
    assert early[-1].message == "not aligned: in motion for 9 s, needs 10 s of it"
    first = next(a for a in tried if a.alignment is not None)
    assert set_off + 9.0 <= first.time <= set_off + 11.0


def test_window_slides(moving):
    simulation, stream, observations, pos_e = moving
    options = MotionOptions(INERTIAL, shortest=5.0, longest=12.0, every=4.0)
    lever = simulation.calibration.lever_antenna_b
    tried = list(attempts(stream, observations, pos_e, lever, options))
    spans = [a.time - a.start for a in tried]
    assert spans[0] == pytest.approx(5.0, abs=1e-3)
    assert spans[-1] == pytest.approx(12.0, abs=1e-3)
    np.testing.assert_allclose(np.diff([a.time for a in tried]), 4.0, atol=1e-3)


def test_no_doppler_is_one_line(moving):
    _, stream, observations, pos_e = moving
    later = observations.with_columns(time=observations.time + 1e4)
    with pytest.raises(AlignmentError, match="no Doppler with satellite states within the IMU"):
        wait_for_alignment(stream, later, pos_e)
    short = observations.time < observations.time[0] + 2.5
    with pytest.raises(AlignmentError, match="no 5 s of Doppler"):
        wait_for_alignment(stream, observations.take(short), pos_e[short])
    with pytest.raises(ConfigError, match="shortest ≤ longest"):
        MotionOptions(shortest=70.0)
    with pytest.raises(ConfigError, match="every"):
        MotionOptions(every=0.0)
