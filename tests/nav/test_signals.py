"""What became of satellite signals: residuals from exact data vanish, and reasons stay."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.nav.config_files import from_tables
from certnav.nav.pipeline import navigate
from certnav.nav.results.tables import read_signals, write_signals
from certnav.nav.signals import UNUSED, signal_log


@pytest.fixture(scope="module")
def exact():
    """Observations without noise, and where the antenna truly was and how fast."""
    simulation = simulate(SimulationConfig(seed=2, duration=40.0, density="open", noise=False))
    observations = simulation.observations
    t, step, lever_b = observations.time, 1e-3, simulation.calibration.lever_antenna_b
    after, here, before = (
        _antenna(simulation.trajectory, t + s, lever_b) for s in (step, 0, -step)
    )
    return observations, here, (after - before) / (2 * step)


def _antenna(trajectory, time, lever_b):
    return trajectory.pos_e(time) + trajectory.C_eb(time) @ lever_b


def test_exact_signals_have_no_residual_and_a_wrong_one_has_its_own(exact):
    observations, place, vel_e = exact
    middle = (observations.time > observations.time[0] + 5) & (
        observations.time < observations.time[-1] - 5
    )
    used = [(t, tuple(np.unique(observations.sat))) for t in np.unique(observations.time)]
    log = signal_log(observations, used, place, vel_e)
    assert np.abs(log.residual[middle]).max() < 0.03  # air near the horizon
    wrong = np.flatnonzero(middle)[3]
    rate = observations.range_rate.copy()
    rate[wrong] += 4.0
    marked = observations.with_columns(range_rate=rate).mark(
        np.arange(len(observations)) == wrong, "doppler residual"
    )
    log = signal_log(
        marked, [(t, s) for t, s in used if t != observations.time[wrong]], place, vel_e
    )
    assert log.reason[wrong] == "doppler residual"
    # Nothing of its epoch was used: nothing tells the receiver's clock.
    epoch = observations.time == observations.time[wrong]
    assert np.isnan(log.residual[epoch]).all()
    assert set(log.reason[epoch]) == {"doppler residual", UNUSED}
    log = signal_log(marked, [(t + 3e-4, s) for t, s in used], place, vel_e)
    assert abs(log.residual[wrong]) == pytest.approx(4.0, abs=0.05)
    # A receiver's clock is off by less than an epoch.
    assert (log.reason[middle & ~epoch] == "").all()


def test_a_run_keeps_what_became_of_its_signals(tmp_path):
    simulation = simulate(SimulationConfig(seed=3, duration=150.0, density="urban"))
    epochs = np.unique(simulation.observations.time)[1:]
    lever_b = simulation.calibration.lever_antenna_b
    fixes = fixes_from_truth(
        simulation.trajectory, epochs, lever_b, 1.0, 0.05, np.random.default_rng(4)
    )
    solution = navigate(simulation.sequence(fixes), from_tables({"gnss": {"velocity": "doppler"}}))
    log = solution.signals
    assert len(log) == len(simulation.observations)
    used = log.reason == ""
    assert used.any() and "weak signal" in log.reason
    known = used & np.isfinite(log.residual)
    assert np.median(np.abs(log.residual[known])) < 0.1
    write_signals(tmp_path / "signals.csv", log)
    back = read_signals(tmp_path / "signals.csv")
    np.testing.assert_array_equal(back.reason, log.reason)
    np.testing.assert_allclose(back.azimuth, log.azimuth, atol=1e-4)
    np.testing.assert_array_equal(back.sat, log.sat)
    assert read_signals(tmp_path / "none.csv") is None
