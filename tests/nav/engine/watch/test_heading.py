"""A filter with a wrong heading that it is sure of does not go on."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.loading import load
from certnav.datasets.simulation.simulator import SimulationConfig
from certnav.filters.rotation import matrix_from_rotvec
from certnav.nav.config_files import from_tables
from certnav.nav.evaluation.accuracy import evaluate
from certnav.nav.pipeline import navigate


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A drive under the open sky that is in motion when it begins."""
    folder = tmp_path_factory.mktemp("heading") / "open"
    made = SimulationConfig(name="open", seed=31, duration=150.0, density="open", moving_start=True)
    simulate_folder(made, folder)
    return load(folder)


def started(drive, heading_deg):
    """Run it from a heading that is given, sure to half a degree."""
    given = {"roll_deg": 0.0, "pitch_deg": 0.0, "heading_deg": heading_deg}
    config = from_tables({"alignment": {**given, "sigma_heading_deg": 0.5}})
    return navigate(drive, config)


@pytest.mark.parametrize("off_deg", [70.0, -120.0, 180.0])
def test_a_heading_far_off_is_noticed_and_mended(drive, off_deg):
    reference = drive.reference
    assert reference is not None
    true_deg = float(np.degrees(reference.rpy[0, 2]))
    solution = started(drive, true_deg + off_deg)
    assert solution.status == "restarted"
    (note,) = [n for n in solution.notes if n.severity == "lost"]
    assert "started again" in note.text
    late = drive.between(drive.span[1] - 20.0, drive.span[1])
    assert evaluate(solution, late).metrics["heading_rms_deg"] < 2.0


def seen_in_a_facade(drive, satellites, begin, end):
    """Return the drive with these satellites' Doppler as if it went 50° further to the left."""
    observations, reference = drive.observations, drive.reference
    here = np.column_stack([
        np.interp(observations.time, reference.time, column)
        for column in (*reference.pos_e.T, *reference.vel_e.T)
    ])  # fmt: skip
    pos_e, vel_e = here[:, :3], here[:, 3:]
    up = pos_e / np.linalg.norm(pos_e, axis=1, keepdims=True)
    turned = np.array([matrix_from_rotvec(np.radians(50.0) * u) for u in up])
    other_e = np.einsum("kij,kj->ki", turned, vel_e)
    los_e = observations.sat_pos_e - pos_e
    los_e /= np.linalg.norm(los_e, axis=1, keepdims=True)
    at = np.isin(observations.sat, satellites)
    at &= (observations.time > begin) & (observations.time < end)
    more = -np.einsum("ki,ki->k", los_e, other_e - vel_e)
    rates = observations.range_rate + np.where(at, more, 0.0)
    return dataclasses.replace(
        drive, observations=dataclasses.replace(observations, range_rate=rates)
    )


def test_more_reflections_than_direct_signals_do_not_make_a_sound_filter_lost(drive):
    """Seven of eleven say another course while the car brakes; four agree with the filter."""
    reference = drive.reference
    assert reference is not None
    names, often = np.unique(drive.observations.sat, return_counts=True)
    always = names[np.argsort(-often, kind="stable")]
    drop = np.isin(drive.observations.sat, always[11:])
    few = dataclasses.replace(drive, observations=drive.observations.mark(drop, "left out"))
    speed = np.linalg.norm(reference.vel_e, axis=1)
    later = reference.time > reference.time[0] + 60.0
    change = np.abs(np.gradient(speed, reference.time)) * later
    middle = reference.time[int(change.argmax())]
    wrong = seen_in_a_facade(few, always[:7], middle - 5.0, middle + 5.0)
    solution = started(wrong, float(np.degrees(reference.rpy[0, 2])))
    assert not [n for n in solution.notes if n.severity == "lost"]
    assert evaluate(solution, wrong).metrics["horizontal_rms_m"] < 3.0


def test_a_heading_that_is_right_is_left_alone(drive):
    reference = drive.reference
    assert reference is not None
    solution = started(drive, float(np.degrees(reference.rpy[0, 2])))
    assert solution.status in ("ok", "doubtful")
    assert not [n for n in solution.notes if n.severity == "lost"]
