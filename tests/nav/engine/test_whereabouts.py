"""A drive that never has a position: three satellites throughout, and a place within 100 km."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.alignment.reference.earth_windows import displaced
from certnav.datasets.series import Odometer
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.earth import ecef_to_lla
from certnav.filters.errors import AlignmentError, ConfigError
from certnav.nav.config_files import from_tables
from certnav.nav.engine.whereabouts import Whereabouts
from certnav.nav.evaluation.accuracy import evaluate
from certnav.nav.pipeline import navigate

#: 50 km off, in seconds that the filter has to make something of three satellites.
AWAY, DURATION = 5e4, 100.0


@pytest.fixture(scope="module")
def simulation():
    return simulate(
        SimulationConfig(
            seed=4, duration=DURATION, density="open", static_start=0.0, moving_start=True
        )
    )


@pytest.fixture(scope="module")
def near(simulation):
    """A place 50 km from the beginning, as the configuration takes it."""
    begin = np.array(simulation.reference.pos_e[0])
    latitude, longitude, height = ecef_to_lla(displaced(np.random.default_rng(4), begin, AWAY))
    return [float(np.degrees(latitude)), float(np.degrees(longitude)), float(height)]


def three_satellites(simulation, odometer=True):
    """The drive with Doppler of three satellites alone, and speeds that are 0.5 % too large."""
    sequence = simulation.sequence()
    observations = sequence.observations
    sats, count = np.unique(observations.sat, return_counts=True)
    all_the_time = sats[count >= 0.95 * count.max()]
    kept = np.random.default_rng(4).choice(all_the_time, 3, replace=False)
    observations = observations.take(np.isin(observations.sat, kept))
    assert max(e.stop - e.start for _, e in observations.epochs()) == 3
    wheels = None
    if odometer:
        time, calibration = simulation.imu.time[5:-5], simulation.calibration
        truth = simulation.trajectory.kinematics(time, calibration.lever_vehicle_b)
        forward = np.einsum("ni,ni->n", truth.vel_e, truth.C_eb[:, :, 0])
        wheels = Odometer(time, 1.005 * forward)
    return dataclasses.replace(
        sequence, observations=observations, odometer=wheels, navigation=(), fixes=None
    )


@pytest.mark.parametrize("odometer", [True, False])
def test_a_drive_starts_with_three_satellites_and_no_position(simulation, near, odometer):
    """Certified, its heading right, its position as far off as it says; a note says from what."""
    sequence = three_satellites(simulation, odometer)
    solution = navigate(sequence, from_tables({"gnss": {"near_deg": near}}))
    assert solution.alignment.method == "certified"
    metrics = evaluate(solution, sequence).metrics
    assert metrics["heading_rms_deg"] < 1.0
    (note,) = [n.text for n in solution.notes if "no position in the recording" in n.text]
    assert ("from Doppler and odometer" in note) is odometer
    trajectory = solution.trajectory
    truth = simulation.trajectory.kinematics(trajectory.time[-1:])
    off = float(np.linalg.norm(trajectory.pos_e[-1] - truth.pos_e[0]))
    sigma = float(np.sqrt(np.trace(trajectory.cov_pos_n[-1])))
    assert off < 3.0 * sigma
    assert off < (3e3 if odometer else 0.8 * AWAY)
    assert np.linalg.norm(trajectory.vel_e[-1] - truth.vel_e[0]) < 3.0


def test_without_a_place_it_says_what_to_give(simulation, near):
    sequence = three_satellites(simulation)
    with pytest.raises(ConfigError, match="near_deg"):
        navigate(sequence, from_tables({}))
    with pytest.raises(ConfigError, match="latitude and longitude"):
        from_tables({"gnss": {"near_deg": [100.0, 0.0]}})
    with pytest.raises(ConfigError, match="near_radius_km"):
        from_tables({"gnss": {"near_deg": near, "near_radius_km": 0.0}})


def test_what_is_missing_is_said_where_no_window_passes(simulation, near):
    """Ten seconds are too short: the refusal is that of the last attempt, not that of a fix."""
    sequence = three_satellites(simulation)
    short = sequence.between(sequence.imu.time[0], sequence.imu.time[0] + 10.0)
    with pytest.raises(AlignmentError, match="not certified in"):
        navigate(short, from_tables({"gnss": {"near_deg": near}}))


def test_positions_are_worth_less_the_longer_ago_they_are():
    where = Whereabouts(
        np.array([0.0, 100.0]), np.zeros((2, 3)), np.zeros(2), np.array([5.0, 10.0])
    )
    near_one, middle, after = where.sigma_at(np.array([0.0, 50.0, 110.0]))
    assert near_one == pytest.approx(5.0)
    assert middle == pytest.approx(np.hypot(7.5, 40.0 * 50.0))
    assert after == pytest.approx(np.hypot(10.0, 40.0 * 10.0))
    alone = Whereabouts(np.array([0.0]), np.zeros((1, 3)), np.zeros(1), np.array([5.0]))
    assert alone.sigma_at(np.array([3.0]))[0] == pytest.approx(np.hypot(5.0, 120.0))
