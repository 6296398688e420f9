"""From observations to levels beside the trajectory: a drive with one satellite wrong."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.datasets.great.writer import write_great
from certnav.datasets.loading import load
from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.nav.config_files import from_tables
from certnav.nav.engine import legs
from certnav.nav.evaluation.accuracy import evaluate
from certnav.nav.pipeline import navigate
from certnav.nav.results.summary import protection_figures
from oracles import gnss_breaks


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    """A minute in a suburb through the files of a receiver: sound, and with one orbit 53 m off."""
    config = SimulationConfig(seed=101, duration=70.0, density="suburb", static_start=10.0)
    sound, wrong = (tmp_path_factory.mktemp(name) for name in ("sound", "wrong"))
    simulation = simulate(config)
    for folder in (sound, wrong):
        write_great(simulation, folder)
    gnss_breaks.ephemeris(2e-6)(wrong, 0.0)
    return load(sound), load(wrong)


def errors_and_levels(sequence, **filter_tables):
    """Return horizontal and vertical error and level at the reference's times, and the solution."""
    config = from_tables({"alignment": {"method": "level+course"}, "filter": filter_tables})
    solution = navigate(sequence, config)
    found = evaluate(solution, sequence)
    off = found.error_pos_n
    error = np.column_stack([np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])])
    track = solution.trajectory
    levels = np.column_stack([np.interp(found.time, track.time, c) for c in track.protection.T])
    return error, levels, solution, found


def test_an_error_that_no_test_sees_moves_the_solution_less_than_the_level(drives):
    sound, levels, solution, found = errors_and_levels(drives[0])
    assert (sound < levels).all()
    assert np.median(levels[:, 0]) < 8.0
    assert protection_figures(solution, found)["horizontal_exceeded"] == 0.0
    assert "one satellite's pseudorange" in solution.protection.covers
    error, wider, told, _ = errors_and_levels(drives[1])
    assert not any("contradict" in note.text for note in told.notes)
    assert (error < wider).all()
    # Levels of the sound drive would not have held it; where it is worst its own are no wider
    # than it takes.
    assert (error > levels).any()
    assert error[:, 0].max() > 5.0 * sound[:, 0].max()
    worst = int(error[:, 0].argmax())
    assert wider[worst, 0] < 5.0 * error[worst, 0]


def test_the_filter_has_the_same_levels_whether_it_is_smoothed_or_not(drives, monkeypatch):
    """The smoother cuts predictions in pieces, which changes neither when levels are taken, nor
    when a fault may come and go.
    """
    filtered, made = [], legs._leg

    def kept(*arguments):
        filtered.append(made(*arguments))
        return filtered[-1]

    monkeypatch.setattr(legs, "_leg", kept)
    for smooth in (False, True):
        errors_and_levels(drives[1], smooth=smooth)
    without, with_tape = (leg.levels for leg in filtered)
    assert len(without) > 40
    np.testing.assert_allclose(with_tape, without, rtol=1e-6)


def test_smoothed_levels_hold_and_switched_off_there_are_none(drives):
    error, levels, solution, _ = errors_and_levels(drives[1], smooth=True)
    assert (error < levels).all()
    assert solution.separation is not None
    off = errors_and_levels(drives[1], smooth=True, protection_risk=0.0)[2]
    assert off.protection is None and np.isnan(off.trajectory.protection).all()
    # To follow a filter changes nothing of it.
    for name in ("pos_e", "cov_pos_n"):
        np.testing.assert_allclose(
            getattr(off.trajectory, name), getattr(solution.trajectory, name), rtol=1e-9
        )


def test_positions_without_satellites_get_k_sigma_and_say_so():
    simulation = simulate(SimulationConfig(seed=3, duration=60.0, density="open", static_start=5.0))
    time = np.arange(1.0, 59.0) + simulation.config.start_time
    fixes = fixes_from_truth(
        simulation.trajectory, time, simulation.config.lever_antenna_b, (1.0, 1.0, 2.0),
        (0.05, 0.05, 0.1), np.random.default_rng(3),
    )  # fmt: skip
    sequence = dataclasses.replace(simulation.sequence(fixes), observations=None)
    config = from_tables({"vehicle": {"nhc": "off"}, "alignment": {"method": "level+course"}})
    solution = navigate(sequence, config)
    assert solution.protection.covers == ()
    assert len(solution.protection.lacks) == 2
    cov = solution.trajectory.cov_pos_n
    worst = np.sqrt(np.linalg.eigvalsh(cov[:, :2, :2])[:, -1])
    ratio = solution.trajectory.protection[:, 0] / worst
    assert np.median(ratio) == pytest.approx(np.sqrt(2.0 * np.log(1e4)), rel=0.15)
    assert ratio.min() > np.sqrt(2.0 * np.log(1e4)) - 1e-6
