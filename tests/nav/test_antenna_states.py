"""The antenna's place and the time stamps of GNSS, estimated from a drive with turns."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.datasets.sequence import Sequence
from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.nav.config_files import from_tables
from certnav.nav.pipeline import navigate

WRONG_LEVER, SIGMA_LEVER = np.array([0.6, -0.5, 0.4]), 0.5
DELAY, SIGMA_DELAY = 0.08, 0.1


def drive(seed: int, delay: float) -> tuple[Sequence, np.ndarray]:
    """Return fixes stamped `delay` [s] early, with a lever declared wrongly, and the true one."""
    made = simulate(SimulationConfig(seed=seed, duration=240.0, density="open"))
    rng = np.random.default_rng([6, seed])
    true = made.calibration.lever_antenna_b
    epochs = made.imu.time[0] + np.arange(1.0, 238.0)
    fixes = fixes_from_truth(made.trajectory, epochs, true, 0.02, 0.03, rng)
    fixes = dataclasses.replace(fixes, time=fixes.time - delay)
    calibration = dataclasses.replace(
        made.calibration, lever_antenna_b=true + WRONG_LEVER, lever_antenna_sigma=SIGMA_LEVER
    )
    return Sequence("drive", made.imu, calibration, fixes=fixes, reference=made.reference), true


def run(sequence, sigma_delay=SIGMA_DELAY):
    gnss = {"delay_sigma_s": sigma_delay, "position_sigma_floor_m": 0.0}
    solution = navigate(sequence, from_tables({"gnss": gnss}))
    assert solution.installation is not None
    return solution, solution.installation.antenna


@pytest.fixture(scope="module")
def runs():
    return [(*run(sequence), true) for sequence, true in (drive(s, DELAY) for s in range(4))]


def test_lever_and_delay_are_recovered_within_their_sigma(runs):
    squares = []
    for solution, found, true in runs:
        off = np.append(found.lever_b - true, found.delay - DELAY)
        sigma = np.append(found.sigma, found.delay_sigma)
        assert np.all(np.abs(off[[0, 1, 3]]) < 4.0 * sigma[[0, 1, 3]])
        assert found.observed.tolist()[:2] == [True, True] and found.observed[3]
        assert np.all(found.sigma[:2] < 0.15) and found.delay_sigma < 0.01
        squares.append((off[[0, 1, 3]] / sigma[[0, 1, 3]]) ** 2)
        said = [note.text for note in solution.notes]
        assert any(t.startswith("antenna ") and "(estimated)" in t for t in said)
        assert any("later than stamped (estimated)" in t for t in said)
    # 12 numbers of unit variance: 0.3 … 2.1 are 99.8 % of chance.
    assert 0.1 < np.mean(squares) < 2.5


def test_what_is_exact_is_no_state_and_not_spoken_of():
    sequence, true = drive(0, 0.0)
    exact = dataclasses.replace(sequence.calibration, lever_antenna_b=true, lever_antenna_sigma=0.0)
    _, found = run(dataclasses.replace(sequence, calibration=exact), 0.0)
    assert not found.prior_sigma.any() and found.delay_prior_sigma == 0.0
    assert not found.lines()
    np.testing.assert_array_equal(found.lever_b, true)


def test_a_lever_that_straight_driving_cannot_show_is_not_observed():
    sequence, _ = drive(1, 0.0)
    first = sequence.span[0]
    standing = sequence.between(first, first + 45.0)  # 30 s at rest, then straight away
    _, found = run(standing, 0.0)
    assert not found.observed[2]
    assert "down (not observed)" in " ".join(found.lines())
